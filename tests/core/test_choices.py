"""Variables with choices: soil classes, systems, sizes of a catalogue."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from commandline import activefail, refused
from explorer.conftest import site_of
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from ran import ran_in
from scipy.stats import norm

from activefail import create_run, open_run
from activefail.analyses.design.design_task import DesignTask, Requirement, design_task
from activefail.analyses.design.search import cheapest
from activefail.campaign.assembly import Campaign
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.learning.features import feature_map
from activefail.pages.figures.outcome_planes import coordinates, marks_in, plot_outcome_planes
from activefail.simulators.returned import designs_by_name
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace
from activefail.text.csv_table import Table

SOIL = Parameter.of_choices("soil", ("A", "B", "soft clay"), (0.2, 0.5, 0.3))
DEPTH = Parameter.of_choices("depth", (0.5, 0.75, 2.0), unit="m")
LOAD = Parameter("load", 5.0, 60.0, "kN")
SPACE = DesignSpace((LOAD, SOIL, DEPTH))


def test_choices_have_their_probabilities() -> None:
    u = (np.arange(100_000) + 0.5) / 100_000
    for x in (SOIL.quantile(u), SOIL.from_normal(norm.ppf(u))):
        assert np.bincount(x.astype(int)) / len(u) == pytest.approx([0.2, 0.5, 0.3], abs=2e-5)
    assert SOIL.quantile(SOIL.share(SOIL.values)).tolist() == SOIL.from_normal(SOIL.to_normal(SOIL.values)).tolist()
    assert [SOIL.number_of(SOIL.written(x)) for x in SOIL.values] == SOIL.values.tolist()
    assert DesignSpace((SOIL, DEPTH)).design_count == 9


def test_a_choice_without_probability_does_not_occur() -> None:
    for shares in ((0.3333333, 0.6666661, 0.0), (0.9, 0.1, 0.0), (0.0, 0.7, 0.3000001)):
        soil = replace(SOIL, probabilities=shares)
        x = {*soil.quantile(np.array([0.0, 1.0 - 1e-8, 1.0])), *soil.from_normal(np.array([-9.0, 5.5, 9.0]))}
        assert {SOIL.choices[int(one)] for one, share in enumerate(shares) if share} >= {soil.written(one) for one in x}


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ('{ choices = ["A"] }', "`choices` must have 2 to 100 entries, got ['A']"),
        ('{ choices = ["A", "B", "A"] }', "`choices` must differ from each other, got 'A' twice"),
        ("{ choices = [1, 1.0] }", "`choices` must differ from each other, got 1 twice"),
        ('{ choices = ["A", 2] }', "`choices` must be texts or numbers, not both, got ['A', 2]"),
        ('{ choices = ["A", ""] }', "must begin with a letter or digit"),
        ('{ choices = ["A", "=B"] }', "must begin with a letter or digit"),
        ('{ choices = ["A", "B; rm x"] }', "got 'B; rm x'"),
        ('{ choices = ["A", "B "] }', "nor a space at its end, got 'B '"),
        ('{ choices = ["A", true] }', "must be texts, or numbers of at most 1e+75 in size, got True"),
        ('{ choices = ["A", "B"], probabilities = [0.5] }', "must have one number for each of 2 choices, got [0.5]"),
        ('{ choices = ["A", "B"], probabilities = [0.5, 0.6] }', "with the sum 1, got [0.5, 0.6] with the sum 1.1"),
        ('{ choices = ["A", "B"], probabilities = [0.0, 1.0] }', "must be positive with the sum 1, got [0.0, 1.0]"),
        ('{ choices = ["A", "B"], low = 1.0 }', "soil.low: a variable has `low` and `high`"),
        ('{ choices = ["A", "B"], distribution = "normal" }', "soil.distribution: a variable has `low`"),
        ("{ low = 1, high = 2, probabilities = [0.5, 0.5] }", "soil.probabilities: a variable has `low`"),
        ('{ value = "A" }', "soil.value: must be a number, got 'A'"),
    ],
)
def test_choices_that_make_no_sense_are_refused(line: str, rule: str) -> None:
    with pytest.raises(InputError, match=r"space\b.*soil") as refused:
        parse_settings(f'simulator = {{ python = "a:b" }}\n[space]\nsoil = {line}\nload = {{ low = 1, high = 2 }}', "f")
    assert rule in str(refused.value)


@pytest.mark.parametrize(
    ("keys", "rule"),
    [
        ('correlation = [["soil", "load", 0.5]]', "'soil' has choices, which have no order and so no correlation"),
        ('constraints = ["load * soil <= 2"]', "'soil' has texts as choices, which no expression takes"),
        ('classifier.features.expressions = { x = "load * soil" }', "'soil' has texts as choices"),
    ],
)
def test_what_needs_a_number_or_an_order_refuses_choices(keys: str, rule: str) -> None:
    space = '[space]\nsoil = { choices = ["A", "B"] }\nload = { low = 1, high = 2 }'
    with pytest.raises(InputError) as refused:
        Campaign.of(parse_settings(f"simulator = {{ elsewhere = true }}\n{keys}\n{space}", "f"))
    assert rule in str(refused.value)


def test_each_choice_is_a_feature_and_numbers_are_values_in_expressions() -> None:
    features = feature_map("design", SPACE)
    assert features.names == ("load", "soil=A", "soil=B", "soil=soft clay", "depth=0.5", "depth=0.75", "depth=2.0")
    assert features.raw(np.array([[20.0, 2.0, 0.0]])).tolist() == [[20.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]]
    two = DesignSpace((LOAD, Parameter.of_choices("system", ("frame", "wall"))))
    assert feature_map("design", two).names == ("load", "system=wall")
    text = (
        'simulator = { elsewhere = true }\nclassifier.features.expressions = { moment = "load * depth" }\n'
        'constraints = ["depth * 20 <= load"]\n[space]\nload = { low = 5, high = 60 }\ndepth = { choices = [0.5, 2] }'
    )
    campaign = Campaign.of(parse_settings(text, "f"))
    assert campaign.features.raw(np.array([[30.0, 1.0]])).tolist() == [[30.0, 1.0, 60.0]]
    assert campaign.space.meets_constraints(np.array([[30.0, 0.0], [30.0, 1.0]])).tolist() == [True, False]


def test_correlated_variables_beside_choices_are_decorrelated() -> None:
    space = DesignSpace((SOIL, LOAD, Parameter("width", 1.0, 2.0)), correlation=(("load", "width", 0.9),))
    features = feature_map("decorrelated", space)
    assert features.names == ("soil=A", "soil=B", "soil=soft clay", "load", "width_given_load")
    F = features(space.sobol(1024, np.random.default_rng(0)))
    assert abs(np.corrcoef(F[:, 3], F[:, 4])[0, 1]) < 0.05


CAMPAIGN = """
simulator = { KIND, margins = ["margin"] }
seed = 4

[space]
load = { low = 5.0, high = 60.0, unit = "kN" }
storeys = { low = 1, high = 3, step = 1 }
soil = { choices = ["A", "B", "soft clay"], probabilities = [0.2, 0.5, 0.3] }
system = { choices = ["frame", "wall"] }

[sampling]
initial = 20
budget = 50
"""

CODE = """
FACTORS = {"A": 0.8, "B": 1.0, "soft clay": 1.7}

def frame(design):
    assert isinstance(design["storeys"], int)
    system = {"frame": 1.0, "wall": 0.7}[design["system"]]
    return 50.0 - FACTORS[design["soil"]] * system * design["load"] - 4.0 * design["storeys"]
"""


def truth(space: DesignSpace, X: np.ndarray) -> np.ndarray:
    """Which designs, (n, 4), fail."""
    columns = pd.DataFrame(space.columns(X))
    factor = columns["soil"].map({"A": 0.8, "B": 1.0, "soft clay": 1.7}).to_numpy(float)
    factor = factor * columns["system"].map({"frame": 1.0, "wall": 0.7}).to_numpy(float)
    return np.asarray(50.0 - factor * columns["load"] - 4.0 * columns["storeys"] <= 0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    campaign = CAMPAIGN.replace("KIND", 'python = "mine:frame"')
    return ran_in(tmp_path_factory.mktemp("choices"), campaign, CODE)


def test_a_campaign_with_choices_learns_and_answers(folder: Path) -> None:
    with open_run(folder / "run", write=True, code=folder) as run:
        table = run.simulations
        assert table["soil"].cat.categories.tolist() == ["A", "B", "soft clay"]
        assert not table.duplicated(["load", "storeys", "soil", "system"]).any()
        X = run.space.random(2000, np.random.default_rng(1))
        said = run.predict(pd.DataFrame(run.space.columns(X)))["p_failure"] > 0.5
        assert (said != truth(run.space, X)).mean() < 0.01
        estimate = run.probability(fixed={"soil": "soft clay"}).estimate
        there = X[X[:, 2] == 2.0]
        assert estimate.probability == pytest.approx(truth(run.space, there).mean(), abs=0.06)
        for request, rule in (
            (lambda: run.fragility(against="soil"), "against: soil has choices without order"),
            (lambda: run.design(0.2, free=["soil"], cost="soil"), "cost: 'soil' has texts as choices"),
            (lambda: run.probability(fixed={"soil": "D"}), "soil: must be one of A, B, soft clay, got 'D'"),
        ):
            with pytest.raises(InputError, match=rule):
                request()


def test_more_simulations_are_not_advised_where_the_next_choice_may_miss_the_target(folder: Path) -> None:
    with open_run(folder / "run", write=True, code=folder) as run:
        found = run.design(0.9, fixed={"system": "wall"}, free=["soil"], simulations=20)
    assert (found.designed.status, found.designed.values) == ("verified", {"soil": 0.0})
    assert found.designed.result.estimates[0].probability < 0.6
    assert "may verify" not in found.verdict


def test_pages_list_choices_and_have_no_axis_of_them(folder: Path) -> None:
    with open_run(folder / "run", code=folder) as run:
        site, planes = site_of(run.findings), coordinates(run.findings).planes
        assert run.findings.influence[0] == max(run.findings.influence)
        point = dict(zip(site.one.space.names, site.one.presets[0][1], strict=True))
        assert [field.choices for field in site.one.fields][2:] == [("A", "B", "soft clay"), ("frame", "wall")]
        axes = site.page("/").partition('id="across"')[2].partition("</select>")[0]
        assert all((f'value="{name}"' in axes) == (name in ("load", "storeys")) for name in site.one.space.names)
        assert {(plane.x, plane.y) for plane in planes} <= {(0, 1), (1, 0)}
        assert "<svg" in site.one.plane(point | {"across": "load", "up": "storeys", "shown": "failure"})


def test_a_plane_pales_the_designs_with_other_choices(folder: Path) -> None:
    with open_run(folder / "run", code=folder) as run:
        findings, design = run.findings, np.array([5.0, 3.0, 1.0, 0.0])
        pale, full = marks_in(findings, design, [0, 1])
        same = np.all(findings.history.designs[:, 2:] == design[2:], axis=1)
        assert sorted(full.places.tolist()) == sorted(findings.history.designs[same][:, :2].tolist())
        assert len(pale.places) + len(full.places) == len(findings.history.designs) > same.sum() > 0
        axes = run.plot_boundary("load", "storeys", {"soil": "B", "system": "frame"}, Figure().subplots())
        drawn = [marks for marks in axes.collections if isinstance(marks, PathCollection)]
        assert sum(len(marks.get_offsets()) for marks in drawn if marks.get_alpha() == 1.0) == same.sum()
        (plane,) = [
            plane for plane in coordinates(findings).planes if findings.campaign.space.names[plane.third] == "soil"
        ]
        figures = plot_outcome_planes(plane, coordinates(findings), findings)
        of_soil = [findings.history.designs[:, 2] == value for value in plane.values]
        drawn = [
            sum(
                len(marks.get_offsets())
                for marks in axes.collections
                if isinstance(marks, PathCollection) and marks.get_alpha() == 1.0
            )
            for axes in (figure.axes[0] for figure in figures)
        ]
        assert drawn == [int((rows & (findings.history.designs[:, 3] == 0.0)).sum()) for rows in of_soil]


def test_an_array_of_numbers_and_wrong_shapes_are_no_designs_where_variables_have_choices(folder: Path) -> None:
    with open_run(folder / "run", code=folder) as run:
        X = run.space.latin_hypercube(3, np.random.default_rng(0))
        table = run.space.columns(X)
        rows = [list(row) for row in zip(*table.values(), strict=True)]
        for labels in (rows, np.array(rows, dtype=object), np.array(rows)):
            pd.testing.assert_frame_equal(run.predict(labels), run.predict(table))
        assert len(run.predict(np.empty((0, 4)))) == 0
        for given, rule in (
            (X, r"choices of soil, system, got an array of numbers\. .* `space\.columns\(X\)`"),
            (list(X), "got an array of numbers"),
            ([*rows, rows[0][:2]], r"X: must be a table or an \(n, 4\) array .* got shape \(4,\)"),
            (np.empty((0, 2)), r"got shape \(0, 2\)"),
        ):
            with pytest.raises(InputError, match=rule):
                run.predict(given)


def test_a_question_has_some_of_the_choices_with_other_probabilities(folder: Path) -> None:
    with open_run(folder / "run", code=folder) as run:
        asked = {}
        for name, line in {
            "one": 'soil = { choices = ["soft clay", "A"], probabilities = [0.9, 0.1] }',
            "other": 'soil = { choices = ["A", "soft clay"] }',
            "certain": 'soil = { value = "soft clay" }',
        }.items():
            (folder / f"{name}.toml").write_text(f"[space]\n{line}\n")
            asked[name] = run.asked(folder / f"{name}.toml")
        assert isinstance(asked["one"], Question)
        assert asked["one"].space.parameters[2].probabilities == (0.1, 0.0, 0.9)
        assert len({question.digest for question in asked.values()}) == 3
        assert asked["certain"].fixed == {"soil": 2.0}
        (folder / "bad.toml").write_text('[space]\nsoil = { choices = ["A", "D"] }\n')
        with pytest.raises(InputError, match=r"space\.soil\.choices: must be one of A, B, soft clay, got 'D'"):
            run.asked(folder / "bad.toml")
        (folder / "bad.toml").write_text('[space]\nload = { value = "30" }\n')
        with pytest.raises(InputError, match=r"space\.load\.value: must be a number between .* got '30'"):
            run.asked(folder / "bad.toml")


def test_tables_have_the_choices_and_a_wrong_one_is_named(folder: Path, tmp_path: Path) -> None:
    run, table, out = str(folder / "run"), tmp_path / "d.csv", tmp_path / "p.csv"
    table.write_text("storeys,soil,load,system\n2,soft clay,30,wall\n2,D,30,wall\n")
    refused = activefail("predict", run, "--csv", str(table), "--out", str(out))
    assert "row 2 (line 3), column soil: must be one of A, B, soft clay, got 'D'" in refused.err
    table.write_text("storeys,soil,load,system\n2,soft clay,30,wall\n")
    assert activefail("predict", run, "--csv", str(table), "--out", str(out)).code == 0
    assert out.read_text().splitlines()[1].startswith("2,soft clay,30,wall,")
    assert activefail("export", run, "--csv", str(out)).code == 0
    assert activefail("export", run, "--parquet", str(tmp_path / "s.parquet")).code == 0
    assert set(pd.read_csv(out)["soil"]) == {"A", "B", "soft clay"}
    assert set(pd.read_parquet(tmp_path / "s.parquet")["system"]) == {"frame", "wall"}


def test_choices_are_simulated_elsewhere_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(CAMPAIGN.replace("KIND", "elsewhere = true"))
    with create_run(tmp_path / "run", tmp_path / "c.toml") as run:
        asked = run.ask(20)
        assert run.tell(asked.assign(margin=np.where(truth(run.space, _numbers(run.space, asked)), -1.0, 1.0))) == 20
        with pytest.raises(InputError, match=r"row 0, column soil: must be '\w.*', as handed out with id 0"):
            run.tell(asked.assign(margin=1.0, soil=np.where(asked["soil"] == "A", "B", "A"))[:1])
        new = {"load": [20.0], "storeys": [2], "soil": ["soft clay"], "system": ["wall"], "margin": [1.0]}
        assert run.add(new) == 1
        with pytest.raises(InputError, match=r"row 0, column soil: must be one of A, B, soft clay, got 'clay'"):
            run.add({**new, "soil": ["clay"]})
    assert activefail("ask", str(tmp_path / "run"), "--n", "2", "--csv", str(tmp_path / "a.csv")).code == 0
    table = pd.read_csv(tmp_path / "a.csv")
    assert set(table["soil"]) <= {"A", "B", "soft clay"}


def test_an_empty_cell_is_not_the_choice_none() -> None:
    brace = Parameter.of_choices("brace", ("Steel", "None"))
    table = Table.of_python({"brace": ["None", None]})
    assert table.value(0, brace) == 1.0
    with pytest.raises(InputError, match="row 1, column brace: must be one of Steel, None, got an empty cell"):
        table.value(1, brace)


def _numbers(space: DesignSpace, table: pd.DataFrame) -> np.ndarray:
    """Designs of a table, (n, d), by numbers of choices."""
    return Table.of_python(table).designs(space)


def test_a_program_gets_the_texts_in_its_command_its_environment_and_its_files(tmp_path: Path) -> None:
    command = 'sh -c "echo {soil} $AF_soil; cat design.json deck; echo margin=1"'
    text = CAMPAIGN.replace("KIND", f"command = '''{command}''', template = \"deck.in\", pattern = 'margin=(.*)'")
    (tmp_path / "c.toml").write_text(text)
    (tmp_path / "deck.in").write_text("soil {soil}, {storeys} storeys\n")
    with create_run(tmp_path / "run", tmp_path / "c.toml", code=tmp_path) as run:
        run.take(20, workers=2)
        for folder, soil in zip(run.simulations["folder"], run.simulations["soil"], strict=True):
            said = (Path(folder) / "stdout.txt").read_text()
            assert said.startswith(f"{soil} {soil}\n{{")
            assert json.loads((Path(folder) / "design.json").read_text())["soil"] == soil
            assert f"soil {soil}, " in said


# --- features and catalogues ----------------------------------------------------------------------------------------

CATALOGUE = """
simulator = { python = "mine:beam", margins = ["reserve"] }
seed = 5

[space]
load = { low = 5, high = 60, step = 5, unit = "kN" }
width = { low = 0.2, high = 1.0, step = 0.2, unit = "m" }
steel = { choices = ["soft", "hard, hot rolled", "special"], features = "steels.csv" }

[sampling]
initial = 20
budget = 50
"""

BEAM = """
def beam(design):
    assert design["steel"] in ("soft", "hard, hot rolled", "special")
    return design["strength"] * design["width"] + 1.0 - design["load"]
"""

STEELS = 'price,steel,strength\n1.5,"hard, hot rolled",60\n1,soft,40\n2.5,special,90\n'

STRENGTH, PRICE = (
    {"soft": 40, "hard, hot rolled": 60, "special": 90},
    {"soft": 1, "hard, hot rolled": 1.5, "special": 2.5},
)


def share_failing(width: float, steel: str) -> float:
    """The probability that a beam fails under the loads of the catalogue's campaign."""
    return float(np.mean(STRENGTH[steel] * width + 1.0 <= np.arange(5, 65, 5)))


@pytest.fixture(scope="module")
def beams(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("beams")
    (home / "steels.csv").write_text(STEELS)
    return ran_in(home, CATALOGUE, BEAM)


def test_features_of_choices_come_from_a_file_which_the_run_folder_needs_no_longer(beams: Path) -> None:
    (beams / "steels.csv").rename(beams / "gone.csv")
    try:
        with open_run(beams / "run", code=beams) as run:
            assert run.campaign.features.names == ("load", "width", "price", "strength")
            steel = run.space.parameters[2]
            assert dict(steel.features) == {"price": (1.0, 1.5, 2.5), "strength": (40.0, 60.0, 90.0)}
            X = run.space.random(200, np.random.default_rng(0))
            table = run.space.columns(X)
            truth = np.array([STRENGTH[one] for one in table["steel"]]) * table["width"] + 1.0 <= table["load"]
            assert ((run.predict(pd.DataFrame(table))["p_failure"] > 0.5) != truth).mean() <= 0.02
    finally:
        (beams / "gone.csv").rename(beams / "steels.csv")


@pytest.mark.parametrize(
    ("steels", "rule"),
    [
        ('"hard, hot rolled",60\nsoft,40\n', "must have a row for each choice, but lacks special"),
        ('"hard, hot rolled",60\nsoft,40\nspecial,90\nsoft,50\n', "must be another choice than in"),
        ('"hard, hot rolled",60\nsoft,40\nspecial,much\n', "column strength: must be a number, got 'much'"),
        ('"hard, hot rolled",60\nsoft,40\nspecial,\n', "column strength: must be a finite number, got an empty cell"),
        ('"hard, hot rolled",60\nsoft,40\nspecial,60\n', "those of 'hard, hot rolled' and 'special' are equal"),
        ('"hard, hot rolled",60\nsoft,40\nwood,90\n', "column steel: must be one of soft, hard, hot rolled, special"),
        (None, "steels.csv: cannot be read"),
    ],
)
def test_a_file_of_features_that_says_too_little_is_refused(tmp_path: Path, steels: str | None, rule: str) -> None:
    if steels is not None:
        (tmp_path / "steels.csv").write_text(f"steel,strength\n{steels}")
    with pytest.raises(InputError) as refused:
        Campaign.of(parse_settings(CATALOGUE, "f"), tmp_path)
    assert rule in str(refused.value)
    assert "steel" in str(refused.value)


@pytest.mark.parametrize(
    ("features", "rule"),
    [
        ('"../steels.csv"', "space.steel.features: must be a file in the folder of the campaign file"),
        ('"steel.csv"', "steel.csv: column 'steel': required, but missing"),
        ("{ load = [1, 2, 3] }", "space.steel.features.load: 'load' is already the name of the quantity space.load"),
        ("{ reserve = [1, 2, 3] }", "'reserve' is already the name of the quantity space.steel.features.reserve"),
        ("{ p_failure = [1, 2, 3] }", "'p_failure' is already the name of a column that `activefail predict` adds"),
        ("{ strength = [1, 2] }", "must have one number of strength for each of 3 choices, got [1.0, 2.0]"),
        ("{ strength = [1, 2, 1] }", "those of 'soft' and 'special' are equal"),
        ('{ "the strength" = [1, 2, 3] }', "must be an identifier, got 'the strength'"),
        ("{}", "space.steel.features: must have at least 1 entry"),
        ("{ strength = [1, 2, nan] }", "space.steel.features.strength.2"),
        ("7", "space.steel.features"),
    ],
)
def test_features_that_make_no_sense_are_refused(tmp_path: Path, features: str, rule: str) -> None:
    (tmp_path / "steel.csv").write_text("strength\n3\n")
    (tmp_path / "mine.py").write_text(BEAM)
    with pytest.raises(InputError) as refused:
        Campaign.of(parse_settings(CATALOGUE.replace('"steels.csv"', features), "f"), tmp_path)
    assert rule in str(refused.value)


def test_constraints_know_features_of_a_file_and_an_unknown_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "steels.csv").write_text(STEELS)
    (tmp_path / "mine.py").write_text(BEAM)
    settings = parse_settings('constraints = ["strength * width <= 60"]\n' + CATALOGUE, "f")
    space = Campaign.of(settings, tmp_path).space
    assert {*space.constraints[0].names} == {"steel", "width"}
    X = np.array([[5.0, 0.6, 2.0], [5.0, 0.8, 2.0], [5.0, 1.0, 1.0]])
    assert space.meets_constraints(X).tolist() == [True, False, True]
    asked = Inquiry.of(Campaign.of(settings, tmp_path), fixed={"width": 0.8}).question
    assert asked.space.names == ("load", "steel")
    assert not asked.space.meets_constraints(np.array([[5.0, 2.0]])).any()
    with pytest.raises(InputError, match=r"constraints: 'strength . width <= 60' must hold, got .*steel = special"):
        Inquiry.of(Campaign.of(settings, tmp_path), fixed={"width": 0.8, "steel": "special"})
    with pytest.raises(InputError, match="unknown name 'weight'"):
        Campaign.of(parse_settings('constraints = ["weight <= 60"]\n' + CATALOGUE, "f"), tmp_path)


def test_a_program_gets_features_by_name_and_a_question_changes_none(tmp_path: Path) -> None:
    (tmp_path / "steels.csv").write_text(STEELS)
    command = CATALOGUE.replace('python = "mine:beam"', 'command = "prog {strength} {steel}"')
    simulator = Campaign.of(parse_settings(command, "f"), tmp_path).simulator
    assert designs_by_name(simulator.space, np.array([[5.0, 0.6, 2.0]]))[0] == {
        **{"load": 5, "width": 0.6, "steel": "special"},
        **{"price": 2.5, "strength": 90.0},
    }
    question = '[space]\nsteel = { choices = ["soft", "special"], features = { strength = [1, 2] } }'
    (tmp_path / "question.toml").write_text(question)
    with pytest.raises(InputError, match=r"space.steel.features: must be left out"):
        Inquiry.of(Campaign.of(parse_settings(command, "f"), tmp_path), question=tmp_path / "question.toml")


@pytest.mark.parametrize("wrong", [None, 0.01])
def test_of_a_catalogue_the_cheapest_design_that_meets_the_target_is_found(beams: Path, wrong: float | None) -> None:
    widths = (0.2, 0.4, 0.6, 0.8, 1.0)
    meets = [(width * PRICE[one], width, one) for width in widths for one in PRICE if share_failing(width, one) <= 0.3]
    _, width, steel = min(meets)
    with open_run(beams / "run", write=True, code=beams) as run:
        found = run.design(0.3, free=["width", "steel"], cost="width * price", wrong=wrong)
        assert found.bearing == {"width": width, "steel": steel}
        assert found.exit_code == 0
        numbers = found.as_json()
        assert numbers["free"] == {"width": [0.2, 1.0], "steel": ["soft", "hard, hot rolled", "special"]}
        one = run.design(0.3, free=["steel"], fixed={"width": 1.0}, wrong=wrong)
        assert one.bearing == {"width": 1.0, "steel": "hard, hot rolled"}
        nothing = run.design(0.05, free=["steel"], fixed={"width": 0.2}, wrong=wrong)
        assert (nothing.exit_code, nothing.bearing["steel"]) == (3, "special")


def test_the_command_designs_over_choices_and_takes_one_with_a_comma(beams: Path, tmp_path: Path) -> None:
    words = ("design", beams / "run", "--code", beams, "--target", "30%", "--simulations", "60")
    shown = activefail(*words, "--free", "steel", "--fixed", "width=1.0", "--out", tmp_path / "out", "--json")
    assert shown.code == 0, shown.err
    numbers = json.loads(shown.out)
    assert numbers["bearing"]["steel"] == "hard, hot rolled"
    assert numbers["cost"] == {"expression": "the place of steel among soft, hard, hot rolled, special", "value": 1.0}
    found = activefail("probability", beams / "run", "--code", beams, "--fixed", tmp_path / "out" / "design.toml")
    again = activefail("probability", beams / "run", "--code", beams, "--fixed", "width=1.0,steel=hard, hot rolled")
    assert found.code == again.code == 0, again.err
    assert found.out.splitlines()[0] == again.out.splitlines()[0]
    refused(activefail(*words, "--free", "width,steel,load"), "question: fixes every variable, so nothing is uncertain")


def task_over(*free: Parameter, cost: str) -> DesignTask:
    """A task under an uncertain load."""
    campaign = SimpleNamespace(space=DesignSpace((LOAD, *free)))
    asked = Inquiry(campaign, Question.of_space(campaign.space))  # type: ignore[arg-type]
    return design_task(asked, (Requirement("failure", 0.1),), [one.name for one in free], cost)


def test_of_equally_cheap_designs_the_safest_is_taken_though_rounding_parts_their_costs() -> None:
    steel = Parameter.of_choices("steel", ("good", "soft"), features=(("price", (3.0, 1.0)),))
    task = task_over(Parameter("width", 0.1, 0.3, step=0.1), steel, cost="width * price")
    good, soft = {"width": 0.1, "steel": 0.0}, {"width": 0.3, "steel": 1.0}
    assert task.cost(soft) < task.cost(good) < task.cost(soft) + 1e-15

    def model(values: dict[str, float], points: int) -> np.ndarray:
        return np.array([0.01 if values == good else 0.05 if task.rank(values) >= 0.3 else 0.5])

    assert cheapest(task, model, np.array([0.1])).values == good


def test_few_combinations_of_choices_beside_a_continuous_variable_are_searched() -> None:
    width, *others = Parameter("width", 0.1, 1.0), *(Parameter.of_choices(name, range(11)) for name in ("a", "b"))
    with pytest.raises(InputError, match="free: the values of a, b must make at most 100 combinations, got 121"):
        task_over(width, *others, cost="width")
    assert len(task_over(width, others[0], cost="width").choices) == 1
    assert task_over(*others, cost="a").is_finite


def test_choices_beside_a_continuous_variable_are_searched_one_by_one() -> None:
    steel = Parameter.of_choices("steel", ("soft", "hard", "special"), features=(("price", (1.0, 1.5, 2.5)),))
    task = task_over(Parameter("width", 0.1, 1.0), steel, cost="width * price")

    def model(values: dict[str, float], points: int) -> np.ndarray:
        needed = {0.0: 2.0, 1.0: 0.6, 2.0: 0.5}[values["steel"]]  # of soft steel no beam is wide enough
        return np.array([0.01 if values["width"] > needed else 0.5])

    found = cheapest(task, model, np.array([0.1]))
    assert found.is_feasible
    assert found.values["steel"] == 1.0
    assert found.values["width"] == pytest.approx(0.6, abs=1e-3)
