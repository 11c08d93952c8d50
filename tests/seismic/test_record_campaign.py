"""Campaigns whose ground motion is a record of a set: a variable with names, events, motions and intensities."""

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bearing.test_records import synthetic
from commandline import activefail, record, refused, table
from stripes.test_stripes import Stopping

import activefail as af
from activefail import create_run, open_run
from activefail.analyses.findings.tables import designs_of
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import read_campaign
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.execution.local import ThreadExecutor
from activefail.learning.features import CustomFeatures, feature_map
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.record_features import record_features
from activefail.seismic.motions.intensity import Intensity
from activefail.seismic.motions.motions import MEASURES, Motions

CAMPAIGNS = Path(__file__).parents[2] / "campaigns"

EVENTS = ("Alpha 1990", "Alpha 1990", "Beta 1994", "Beta 1994", "Gamma 1999", "Gamma 1999")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shipped campaign on a folder of synthetic records, as a user would copy and change it."""
    # Coarse: the features are computed for every candidate, and their accuracy is no claim of a campaign.
    monkeypatch.setattr("activefail.seismic.bearing.record_features.STEPS", 50)
    (tmp_path / "mine").mkdir()
    rows = ["file,unit,event,dt"]
    for seed, event in enumerate(EVENTS):
        motion = synthetic(seed, 0.4, dt=0.02, seconds=10.0)
        lines = (f"{value:.9g}" for value in motion.acceleration / GRAVITY)
        (tmp_path / "mine" / f"record{seed}.txt").write_text("\n".join(lines))
        rows.append(f"record{seed}.txt,g,{event},{motion.dt}")
    (tmp_path / "mine" / "records.csv").write_text("\n".join(rows) + "\n")
    settings = (CAMPAIGNS / "records.toml").read_text(encoding="utf-8")
    for old, new in (
        ('set = "farfield"', 'set = "mine"'),
        ("budget = 500", "initial = 20\nbudget = 30"),
        ("batch = 10", "batch = 5"),
        ("size = 500", "size = 0"),
    ):
        assert settings.count(old) == 1
        settings = settings.replace(old, new)
    (tmp_path / "records.toml").write_text(settings, encoding="utf-8")
    (tmp_path / "bearing_records.py").write_bytes((CAMPAIGNS / "bearing_records.py").read_bytes())
    return tmp_path


CODE = """
def run(design):
    motion = design["record"].motion
    assert abs(motion.peak_velocity / design["PGV"] - 1.0) < 1e-9
    failed = motion.peak > 4.0 + 2.0 * design["strength"]
    return {"outcome": "failure" if failed else "safe", "margins": {"number": int(design["record"].name[-1])}}
"""

CHEAP = """
simulator = { SIMULATOR }
sampling = { initial = 24, budget = 24 }

[space]
strength = { low = 0.0, high = 1.0 }
record = { set = "mine", scaled_to = { PGV = "pgv" } }
PGV = { low = 0.2, high = 2.0, unit = "m/s", distribution = "log_uniform" }
"""

PYTHON = 'python = "cheap:run", margins = ["number"]'


@pytest.fixture
def cheap(folder: Path) -> Callable[..., Path]:
    """Writes the campaign of a cheap simulator on the same records, with a simulator and other changes."""

    def written(simulator: str = PYTHON, *changes: tuple[str, str]) -> Path:
        text = CHEAP.replace("SIMULATOR", simulator)
        for old, new in changes:
            assert text.count(old) == 1
            text = text.replace(old, new)
        (folder / "cheap.toml").write_text(text)
        (folder / "cheap.py").write_text(CODE)
        return folder / "cheap.toml"

    return written


def campaign_of(file: Path) -> Campaign:
    return read_campaign(file, code=file.parent)


# --- a campaign -----------------------------------------------------------------------------------------------------


def test_a_campaign_learns_from_records_and_resumes_to_the_same_bits(folder: Path) -> None:
    whole, stopped = folder / "whole", folder / "stopped"
    ran = activefail("run", folder / "records.toml", "--out", whole, "--workers", "1")
    assert ran.code == 0, ran.err
    assert activefail("run", folder / "records.toml", "--out", stopped, "--workers", "1", "--budget", "25").code == 0
    assert activefail("resume", stopped, "--budget", "30", "--workers", "1").code == 0
    assert record(stopped) == record(whole)
    rows = table(whole.with_suffix(".csv"))
    assert {row["outcome"] for row in rows} == {"no_impact", "impact", "failure"}
    assert {row["record"] for row in rows} == {f"record{number}" for number in range(6)}


def test_a_design_has_the_name_of_its_record_wherever_people_see_it(cheap: Callable[..., Path]) -> None:
    file = cheap()
    assert activefail("run", file, "--out", file.parent / "run", "--workers", "1").code == 0
    with open_run(file.parent / "run") as run:
        frame = run.simulations
        assert isinstance(frame["record"].dtype, pd.CategoricalDtype)
        assert {*frame["record"]} == {f"record{number}" for number in range(6)}
        assert [int(name[-1]) for name in frame["record"]] == frame["number"].tolist()
        one = run.predict([{"strength": 0.5, "record": "record3", "PGV": 1.0}])
        assert one["record"].tolist() == ["record3"]
        assert designs_of(run.campaign, one[["strength", "record", "PGV"]])[0].tolist() == [0.5, 3.0, 1.0]
    shown = activefail("check", file)
    assert "record: 6 records of 3 events" in shown.out, shown.err


def test_the_space_knows_the_events_of_the_records(cheap: Callable[..., Path]) -> None:
    _, of_record, of_velocity = campaign_of(cheap()).space.parameters
    assert of_record.groups == EVENTS
    assert of_velocity.groups is None


def test_probabilities_of_records_are_those_of_the_file(cheap: Callable[..., Path]) -> None:
    shares = [0.5, 0.1, 0.1, 0.1, 0.1, 0.1]
    campaign = campaign_of(cheap(PYTHON, ('set = "mine"', f'set = "mine", probabilities = {shares}')))
    which = campaign.space.sobol(2**12, np.random.default_rng(0))[:, 1].astype(int)
    assert np.bincount(which) / len(which) == pytest.approx(shares, abs=0.01)


# --- the records are those of the campaign ----------------------------------------------------------------------------


def test_changed_records_are_refused(folder: Path, cheap: Callable[..., Path]) -> None:
    assert activefail("create", cheap(), "--out", folder / "run").code == 0
    path = folder / "mine" / "record3.txt"
    path.write_text(path.read_text().replace("\n", "1\n", 2))
    resumed = activefail("resume", folder / "run", "--workers", "1")
    assert resumed.code == 2
    assert "space.record.set: the records of" in resumed.err
    assert "are not those of the campaign: their digest is" in resumed.err
    # What needs no motion still works.
    assert activefail("status", folder / "run").code == 0


def test_no_folder_that_a_run_folder_from_someone_else_names_is_read_unless_the_user_permits_it(
    cheap: Callable[..., Path], tmp_path: Path
) -> None:
    file = cheap()
    assert activefail("run", file, "--out", file.parent / "run", "--workers", "1").code == 0
    designs, out, received = tmp_path / "designs.csv", tmp_path / "out.csv", tmp_path / "received" / "run"
    designs.write_text("strength,record,PGV\n0.5,record3,1.0\n")
    assert activefail("predict", file.parent / "run", "--csv", designs, "--out", out).code == 0
    shutil.copytree(file.parent / "run", received)
    refusal = "mine is a folder of records. A run folder may come from someone else"
    for words in (["predict", received, "--csv", designs, "--out", out], ["report", received]):
        result = activefail(*words)
        assert (result.code, refusal in result.err) == (2, True), result.err
    assert activefail("status", received).code == 0
    assert activefail("predict", received, "--csv", designs, "--out", out, "--code", file.parent).code == 0
    text = (received / "campaign.toml").read_text()
    (received / "campaign.toml").write_text(
        text[: text.index("[space.record")] + '[space.record]\nset = "../../../etc"\n'
    )
    for words in (
        ["predict", received, "--csv", designs, "--out", out],
        ["report", received],
        ["export", received, "--csv", out],
    ):
        result = activefail(*words)
        assert (result.code, "set: requires `records` and `digest`" in result.err) == (2, True), result.err


def test_a_digest_in_the_file_names_the_records(folder: Path, cheap: Callable[..., Path]) -> None:
    digest = campaign_of(cheap()).settings.space["record"].digest
    assert campaign_of(cheap(PYTHON, ('"mine"', f'"mine", digest = "{digest}"'))).space.names[1] == "record"
    with pytest.raises(InputError, match=r"space\.record\.set: the digest of mine must be 0123"):
        campaign_of(cheap(PYTHON, ('"mine"', '"mine", digest = "0123"')))


def test_a_record_that_cannot_be_read_is_named(folder: Path) -> None:
    path = folder / "mine" / "record3.txt"
    path.write_text(path.read_text().replace("\n", "\nnan\n", 1))
    refused(activefail("run", folder / "records.toml", "--out", folder / "run"), "record3.txt", "line 2")


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ('{ set = "nowhere" }', "nowhere: is not a folder of records. The sets of FEMA P695 are farfield"),
        ('{ set = "empty" }', "must have at least 2 records, got 0"),
        ('{ set = "single" }', "must have at least 2 records, got 1"),
        ('{ set = "odd" }', "a text in the names of records must begin with a letter or digit"),
        ('{ set = "unknown" }', "unit: the header states none, so it is required (`unit`, one of"),
        ('{ set = "mine", choices = ["A", "B"] }', "space.record.choices: a variable has `low` and `high`, `choices`"),
        ('{ set = "mine", low = 0 }', "space.record.low: a variable has `low` and `high`, `choices`, `set` or `value`"),
        ('{ set = "mine", scaled_to = { load = "pgv" } }', "scaled_to: must name a variable with numbers of the space"),
        ('{ set = "mine", scaled_to = { record = "pgv" } }', "scaled_to: must name a variable with numbers"),
        ('{ set = "mine", scaled_to = { x = "PGV" } }', "x must be factor, pga, pgv, or sa:T with a period T from"),
        ('{ set = "mine", scaled_to = { x = "sa:0" } }', "x must be factor, pga, pgv, or sa:T with a period T from"),
        ('{ set = "mine", probabilities = [1.0] }', "must have one number for each of 6 records, got [1.0]"),
        ('{ set = "mine", records = { a = "A", b = "B" } }', "`records` requires `digest`; activefail writes both"),
    ],
)
def test_sets_that_make_no_sense_are_refused(folder: Path, line: str, rule: str) -> None:
    lines = "\n".join(f"{value:.3f}" for value in np.sin(np.arange(40.0)))
    for place, names in {
        "empty": (),
        "single": ("a.txt",),
        "odd": ("_a.txt", "b.txt"),
        "unknown": ("a.txt", "b.txt"),
    }.items():
        (folder / place).mkdir()
        for name in names:
            (folder / place / name).write_text(f"UNITS: g\nDT= 0.01\n{lines}\n" if place != "unknown" else lines)
    text = f"simulator = {{ elsewhere = true }}\n[space]\nrecord = {line}\nx = {{ low = 1, high = 2 }}"
    with pytest.raises(InputError, match=r"space\b.*record") as raised:
        Campaign.of(parse_settings(text, "f"), folder)
    assert rule in str(raised.value)


@pytest.mark.parametrize(
    ("keys", "rule"),
    [
        ('correlation = [["record", "x", 0.5]]', "'record' has choices, which have no order and so no correlation"),
        ('constraints = ["x * record <= 2"]', "'record' has texts as choices, which no expression takes"),
    ],
)
def test_what_needs_a_number_or_an_order_refuses_records(folder: Path, keys: str, rule: str) -> None:
    space = 'space = { record = { set = "mine" }, x = { low = 1, high = 2 } }'
    text = f"simulator = {{ elsewhere = true }}\n{keys}\n{space}"
    with pytest.raises(InputError) as raised:
        Campaign.of(parse_settings(text, "f"), folder)
    assert rule in str(raised.value)


# --- what a simulator gets --------------------------------------------------------------------------------------------


def test_a_simulator_is_pickled_without_its_records_which_a_process_reads_once(
    cheap: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator = campaign_of(cheap()).simulator
    loaded = pickle.loads(pickle.dumps(simulator))
    assert len(pickle.dumps(simulator)) < 5000
    record = simulator.space.parameters[1].payload()[0]
    assert record.motion.acceleration.nbytes > 0
    monkeypatch.setattr("activefail.seismic.motions.motions.read_record_set", lambda *_: pytest.fail("read again"))
    X = simulator.space.latin_hypercube(8, np.random.default_rng(0))
    assert loaded.run(X).outcome.tolist() == simulator.run(X).outcome.tolist()


def test_without_scaled_to_a_simulator_gets_the_record_as_it_is(cheap: Callable[..., Path]) -> None:
    campaign = campaign_of(cheap(PYTHON, (', scaled_to = { PGV = "pgv" }', "")))
    payload = campaign.space.parameters[1].payload
    assert payload is not None
    assert payload.in_design(2, {"PGV": 9.0}) is payload()[2]
    assert payload()[2].event == "Beta 1994"


def test_an_intensity_that_all_records_have_changes_nothing(cheap: Callable[..., Path]) -> None:
    # The synthetic records have one PGA, but for the rounding in their files.
    campaign = campaign_of(cheap(PYTHON, (', scaled_to = { PGV = "pgv" }', "")))
    F = campaign.features(campaign.space.sobol(64, np.random.default_rng(0)))
    assert campaign.features.names[1] == "record PGA"
    assert np.abs(F[:, 1]).max() < 1e-6
    assert np.ptp(F[:, 2:-1], axis=0).min() > 1.0


PROGRAM = """
import json, os, sys
import numpy as np
path, dt = sys.argv[1], float(sys.argv[2])
a = np.loadtxt(path)
assert os.environ["AF_record"] == path and float(os.environ["AF_record_dt"]) == dt == 0.02
design = json.load(open("design.json"))
assert design["record"] == path and design["record_name"] == os.environ["AF_record_name"]
assert open("deck.txt").read() == f"{path} 0.0200 {design['record_name']}"
velocity = float(np.abs(np.cumsum(0.5 * dt * (a[1:] + a[:-1]))).max())
assert abs(velocity / float(os.environ["AF_PGV"]) - 1.0) < 1e-12
answer = {"outcome": "failure" if np.abs(a).max() > 5.0 else "safe", "margins": {"peak": float(np.abs(a).max())}}
json.dump(answer, open(os.environ["AF_OUT"], "w"))
"""


def test_a_program_gets_the_path_of_the_scaled_accelerations_and_their_interval(
    folder: Path, cheap: Callable[..., Path]
) -> None:
    (folder / "program.py").write_text(PROGRAM)
    (folder / "deck.txt.in").write_text("{record} {record_dt:.4f} {record_name}")
    command = 'command = "python3 {here}/program.py {record} {record_dt}", template = "deck.txt.in", margins = ["peak"]'
    ran = activefail("run", cheap(command), "--out", folder / "run", "--workers", "1")
    assert ran.code == 0, ran.err
    with open_run(folder / "run") as run:
        frame, space = run.simulations, run.campaign.space
        X = designs_of(run.campaign, frame[[*space.names]])
    assert not frame["peak"].isna().any(), activefail("status", folder / "run").out
    records, which = space.objects(X, "record")
    peaks = [records[k].motion.peak / records[k].motion.peak_velocity for k in which]
    assert frame["peak"].to_numpy() == pytest.approx(peaks * frame["PGV"], rel=1e-12)


def test_a_program_s_variables_must_not_have_the_names_of_what_it_gets(cheap: Callable[..., Path]) -> None:
    with pytest.raises(InputError, match=r"space\.record_dt: tells a program of the variable record; rename it"):
        campaign_of(cheap('command = "true {record}"', ("strength", "record_dt")))


def test_elsewhere_the_table_has_the_names(folder: Path, cheap: Callable[..., Path]) -> None:
    assert activefail("create", cheap("elsewhere = true"), "--out", folder / "run").code == 0
    asked = activefail("ask", folder / "run", "--n", "24", "--csv", folder / "todo.csv")
    assert asked.code == 0, asked.err
    rows = pd.read_csv(folder / "todo.csv")
    assert set(rows["record"]) <= {f"record{number}" for number in range(6)}
    rows.assign(outcome=np.where(rows["PGV"] > 1.0, "failure", "safe")).to_csv(folder / "done.csv", index=False)
    told = activefail("tell", folder / "run", "--csv", folder / "done.csv")
    assert told.code == 0, told.err
    with open_run(folder / "run") as run:
        assert len(run.simulations) == 24


# --- features ---------------------------------------------------------------------------------------------------------


def test_the_classifier_sees_intensities_of_the_scaled_record(cheap: Callable[..., Path]) -> None:
    campaign = campaign_of(cheap())
    space, features = campaign.space, campaign.features
    # That of the level is a variable already.
    assert features.names == ("strength", "record PGA", "record Sa(0.3 s)", "record Sa(1 s)", "record Sa(3 s)", "PGV")
    assert features.logarithmic.tolist() == [False, True, True, True, True, True]
    X = space.sobol(16, np.random.default_rng(0))
    records, which = space.objects(X, "record")
    for x, row, k in zip(X, features.raw(X), which, strict=True):
        motion = records[k].motion.scaled(x[2] / records[k].motion.peak_velocity)
        intensities = [Intensity.of(text).of_record(motion) for text in MEASURES if text != "pgv"]
        assert row == pytest.approx([x[0], *intensities, x[2]], rel=1e-9)


@pytest.mark.parametrize("measure", ["factor", "pga", "sa:1.0"])
def test_a_record_is_scaled_to_the_intensity_that_the_file_names(cheap: Callable[..., Path], measure: str) -> None:
    payload = campaign_of(cheap(PYTHON, ('PGV = "pgv"', f'PGV = "{measure}"'))).space.parameters[1].payload
    assert payload is not None
    scaled, plain = payload.in_design(3, {"PGV": 0.7}).motion, payload()[3].motion
    of = Intensity.of(measure)
    reached = scaled.peak / plain.peak if measure == "factor" else of.of_record(scaled)
    assert reached == pytest.approx(0.7)
    assert len(payload.feature_names) == (5 if measure == "factor" else 4)


def test_collision_features_are_those_of_the_cheap_models_under_the_scaled_record(folder: Path) -> None:
    campaign = campaign_of(folder / "records.toml")
    space = campaign.space
    X = space.sobol(16, np.random.default_rng(0))
    X = np.concatenate([X, X[:3]])
    records, which = space.objects(X, "record")
    factors = X[:, -1] / [records[k].motion.peak_velocity for k in which]
    expected = record_features(X[:, :7], [one.motion for one in records], which, factors)
    assert campaign.features.names == (*space.names[:7], "PGV", "v*", "a*", "m*")
    assert campaign.features.raw(X)[:, -3:].tolist() == expected.tolist()


def test_a_function_of_features_gets_the_records_of_designs(cheap: Callable[..., Path]) -> None:
    space = campaign_of(cheap()).space

    def durations(X, space):
        records, which = space.objects(X, "record")
        return np.array([[len(one.event) + one.motion.peak] for one in records])[which]

    features = feature_map(CustomFeatures("durations", durations), space)
    X = space.sobol(8, np.random.default_rng(0))
    records = space.parameters[1].payload()
    assert features.raw(X)[:, -1].tolist() == [len(EVENTS[int(k)]) + records[int(k)].motion.peak for k in X[:, 1]]
    with pytest.raises(InputError, match="'strength' is no variable with a `set`"):
        space.objects(X, "strength")


# --- questions --------------------------------------------------------------------------------------------------------


@pytest.fixture
def done(folder: Path, cheap: Callable[..., Path]) -> Path:
    """A run folder of the cheap simulator."""
    file = cheap(PYTHON, ("initial = 24, budget = 24", "initial = 60, budget = 60"))
    assert activefail("run", file, "--out", folder / "run", "--workers", "1").code == 0
    return folder / "run"


NOTE = "record: the probability and its interval are those of these 6 records of 3 events, not of other earthquakes."


def test_questions_on_a_campaign_under_records_say_of_which_records_they_are(done: Path, folder: Path) -> None:
    (folder / "weak.toml").write_text("strength = 0.2\n")
    (folder / "some.toml").write_text(
        'space.record = { choices = ["record1", "record4"], probabilities = [0.3, 0.7] }\nspace.PGV.value = 0.8\n'
    )
    (folder / "one.toml").write_text('space.record.value = "record2"\n')
    for words, note in (
        ((), NOTE),
        (("--fixed", folder / "weak.toml"), NOTE),
        (("--question", folder / "some.toml"), NOTE.replace("6 records of 3", "2 records of 2")),
        (("--question", folder / "one.toml"), ""),
    ):
        shown = activefail("probability", done, "--simulations", "20", *words)
        assert shown.code == 0, shown.err
        assert note in shown.out
        assert ("of these" in shown.out) == bool(note), shown.out
    (folder / "other.toml").write_text('space.record = { set = "mine" }\n')
    refused(
        activefail("probability", done, "--question", folder / "other.toml"),
        "space.record.set: must be left out; `choices` name some of the campaign's records",
    )


def test_a_fragility_and_a_design_are_found_under_records(done: Path, folder: Path) -> None:
    (folder / "weak.toml").write_text("strength = 0.2\n")
    curve = activefail("fragility", done, "--against", "PGV", "--fixed", folder / "weak.toml", "--json")
    assert curve.code == 0, curve.err
    assert NOTE in json.loads(curve.out)["assumptions"]
    (folder / "level.toml").write_text("space.PGV.value = 0.8\n")
    words = ("design", done, "--free", "strength", "--target", "failure=0.5", "--question", folder / "level.toml")
    found = activefail(*words, "--json")
    assert found.code == 0, found.err
    assert 0.0 <= json.loads(found.out)["bearing"]["strength"] <= 1.0
    refused(
        activefail(*words[:3], "record", *words[4:]),
        "free: record has the records of a set, which the designer cannot choose",
    )


# --- incremental dynamic analysis -------------------------------------------------------------------------------------


def test_an_incremental_dynamic_analysis_takes_the_records_of_the_campaign(
    folder: Path, cheap: Callable[..., Path]
) -> None:
    (folder / "values.toml").write_text("strength = 0.2\n")
    words = ("ida", "--simulator", cheap(), "--bearing", folder / "values.toml", "--workers", "1", "--json")
    shown = activefail(*words)
    assert shown.code == 0, shown.err
    numbers = json.loads(shown.out)
    assert [one["event"] for one in numbers["records"]] == list(EVENTS)
    records = campaign_of(folder / "cheap.toml").space.parameters[1].payload()
    for one, known in zip(numbers["records"], records, strict=True):
        exact = 4.4 * known.motion.peak_velocity / known.motion.peak
        assert one["record"] == known.name
        assert one["capacity"] == pytest.approx(exact, rel=0.05)
    assert json.loads(activefail(*words, "--records", folder / "mine").out) == numbers
    (folder / "fewer").mkdir()
    for number in range(3):
        (folder / "fewer" / f"record{number}.txt").write_bytes((folder / "mine" / f"record{number}.txt").read_bytes())
    refused(
        activefail(*words, "--records", folder / "fewer", "--unit", "g", "--dt", "0.02"),
        "--records: must be those of the campaign, mine; leave them out",
    )
    refused(activefail(*words, "--scale-to", "pga"), "--scale-to: must be pgv with this campaign, got 'pga'")
    refused(activefail(*words, "--unit", "g"), "--unit: requires --records.")
    refused(activefail("ida", "--bearing", folder / "values.toml"), "--records: required, unless a campaign has")
    # A campaign's classifier says where to begin, and the simulations join its record.
    run = folder / "begun"
    assert activefail("run", folder / "cheap.toml", "--out", run).code == 0
    of_run = ("ida", "--campaign", run, "--code", folder, "--bearing", folder / "values.toml", "--json")
    before = len(record(run))
    few = json.loads(activefail(*of_run).out)
    assert few["simulations"] < 0.5 * numbers["simulations"]
    assert len(record(run)) - before <= few["simulations"]
    assert [row["origin"] for row in record(run)[before:]] == ["given"] * (len(record(run)) - before)
    for one, exact in zip(few["records"], numbers["records"], strict=True):
        assert one["capacity"] == pytest.approx(exact["capacity"], rel=0.04)
    after = len(record(run))
    assert json.loads(activefail(*of_run).out)["records"] == few["records"]
    assert len(record(run)) == after
    refused(activefail(*of_run[:-1], "--simulator", folder / "cheap.toml"), "simulator: cannot be combined with")
    unscaled = cheap(PYTHON, (', scaled_to = { PGV = "pgv" }', ""))
    refused(activefail(*words[:2], unscaled, *words[3:]), "space.record.scaled_to names a variable")


def test_the_simulations_of_an_interrupted_round_of_an_analysis_join_the_record(
    folder: Path, cheap: Callable[..., Path]
) -> None:
    with create_run(folder / "run", cheap()) as run, ThreadExecutor(1) as executor:
        run.take(executor=executor, progress=False)
        with pytest.raises(KeyboardInterrupt):
            af.ida({"strength": 0.2}, run=run, executor=Stopping(1))
        assert len(run.simulations) == 25
        assert run.simulations["origin"].tolist()[-1] == "given"


@pytest.mark.needs("records")
def test_the_shipped_campaigns_name_the_far_field_set(tmp_path: Path) -> None:
    for name in ("records", "building_records"):
        campaign = campaign_of(CAMPAIGNS / f"{name}.toml")
        (record,) = (one for one in campaign.space.parameters if one.groups)
        assert isinstance(record.payload, Motions)
        assert (len(record.choices), len(set(record.groups or ()))) == (44, 14)
        assert campaign.space.objects(campaign.space.low[None], record.name)[0][0].name == "farfield 1a"
