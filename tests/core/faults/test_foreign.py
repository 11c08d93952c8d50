"""Run folders from someone else: their links are not followed, their text forges no line, their files stop nothing."""

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
import tomli_w
from commandline import CommandResult, activefail, refused, table
from faults.harness import Course, Victims, finished, traced
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from activefail.campaign.on_disk import open_campaign
from activefail.errors import InputError, StoreError
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.state import classifier_from_state
from activefail.loop.history import History
from activefail.loop.learning import learner_of
from activefail.loop.saved_learning import restore
from activefail.record.batch import INITIAL, Batch, Schema
from activefail.record.checkpoint import State, decode, encode
from activefail.record.layout import run_folder_owning
from activefail.record.run_folder import FolderStore
from activefail.simulators.command import LARGEST_ANSWER, CommandSimulator
from activefail.simulators.interface import Results, UnusableAnswerError
from activefail.simulators.placeholders import LONGEST_NUMBER, arguments
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace
from activefail.visible import quoted, visible

Survived = Callable[[], None]

CAMPAIGN = """
seed = 3
sampling = { initial = 8, budget = 12, batch = 4 }
validation = { size = 10 }
simulator = { python = "model:run", margins = ["m"] }
[space]
x = { low = 0.0, high = 1.0, unit = "m" }
y = { low = 0.0, high = 1.0 }
"""
MODEL = "def run(d):\n    return {'outcome': 'failure' if d['x'] > 0.5 else 'safe', 'margins': {'m': d['x']}}\n"

FORGED = "\nresults    forged\r\x1b[2J\x1b]0;title\x07\u202e\u2066\u2028\x85\x9b1m"
"""Text that would begin a line of its own, clear a terminal, name its window and turn its letters round."""

often = hypothesis.settings(
    deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with everything that the commands write, and next to it the code that it names."""
    home = tmp_path_factory.mktemp("sent")
    (home / "model.py").write_text(MODEL)
    (home / "campaign.toml").write_text(CAMPAIGN)
    folder = home / "run"
    assert activefail("run", home / "campaign.toml", "--out", folder, "--workers", "1").code == 0
    assert activefail("compare", folder, "--budgets", "8,12", "--test", "10", "--code", home).code == 0
    assert activefail("report", folder).code == 0
    return folder


@pytest.fixture
def received(sent: Path, tmp_path: Path) -> Path:
    """A copy of it, with the code and a table of designs."""
    shutil.copy(sent.parent / "model.py", tmp_path)
    (tmp_path / "designs.csv").write_text("x,y\n0.2,0.3\n0.7,0.1\n")
    return Path(shutil.copytree(sent, tmp_path / "run"))


def commands(folder: Path) -> Iterator[list[str | Path]]:
    """Every command on a run folder, those that run code with the code that it names."""
    code = ["--code", folder.parent]
    yield ["status", folder]
    yield ["export", folder, "--csv", folder.parent / "all.csv"]
    yield ["predict", folder, "--csv", folder.parent / "designs.csv", "--out", folder.parent / "predicted.csv"]
    yield ["report", folder]
    yield ["explore", folder, "--port", "0"]
    yield ["verify", folder, "--simulations", "10", *code]
    yield ["probability", folder, "--simulations", "10", *code]
    yield ["design", folder, "--target", "0.5", "--free", "x", "--simulations", "50", "--no-chart", *code]
    yield ["fragility", folder, "--against", "x"]
    yield ["sensitivity", folder, "--samples", "16"]
    yield ["compare", folder, "--budgets", "8,12", "--test", "10", *code]
    yield ["resume", folder, "--budget", "14", *code]
    yield ["ask", folder, "--beyond", "--csv", folder.parent / "todo.csv", *code]
    yield ["drop", folder, "--ids", "14", *code]


def ended(words: list[str | Path], result: CommandResult) -> bool:
    """Whether a command did its work; a search for a design may end without one."""
    return result.code in ((0, 3) if words[0] == "design" else (0,))


def tree(folder: Path) -> dict[str, tuple[object, ...]]:
    """All that is in a folder: where links lead, contents, and which file each name stands for."""
    entries: dict[str, tuple[object, ...]] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            entries[str(path)] = ("link", os.readlink(path))
        else:
            entries[str(path)] = (path.stat().st_ino, path.read_bytes() if path.is_file() else b"")
    return entries


def unforged(result: CommandResult) -> None:
    """Assert that what the program said holds no control character but line ends, and no line that is not its own."""
    for text in (result.out, result.err):
        assert visible(text, keep="\n") == text
        assert not [line for line in text.splitlines() if line.startswith("results    forged")]
        text.encode()


# --- links -------------------------------------------------------------------------------------------------------

PLACES = (
    *("campaign.toml", "journal", "journal.quarantine", "checkpoint.h5", "report.html", "simulations", "compare"),
    *("compare/scores.csv", "compare/learning_curves.png", "simulations/0123"),
)


@pytest.mark.parametrize("there", [True, False], ids=["to what is there", "to nothing"])
@pytest.mark.parametrize("place", PLACES)
def test_a_link_in_a_run_folder_is_refused_by_every_command_and_what_it_leads_to_stays(
    received: Path, tmp_path: Path, place: str, there: bool, survived: Survived
) -> None:
    victim, link = tmp_path / "victim", received / place
    victim.mkdir()
    (victim / "mine.txt").write_text("mine")
    if there:
        if link.is_dir():
            shutil.copytree(link, victim / "thing")
            (victim / "thing" / ".tmp-0123456789abcdef").write_text("mine")
            shutil.copy(victim / "mine.txt", victim / "thing" / "000000099.h5")
        else:
            shutil.copy(link if link.exists() else victim / "mine.txt", victim / "thing")
    if link.is_dir():
        shutil.rmtree(link)
    link.unlink(missing_ok=True)
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(victim / "thing")
    before = tree(tmp_path)
    for words in commands(received):
        result = activefail(*words)
        refused(result, f"{link} is a symbolic link; activefail follows no links inside a run folder", code=1)
        assert tree(tmp_path) == before
        survived()


def test_a_run_folder_that_is_reached_through_a_link_is_a_run_folder(received: Path, tmp_path: Path) -> None:
    (tmp_path / "shortcut").symlink_to(received)
    for words in commands(tmp_path / "shortcut"):
        if words[0] != "explore":
            assert ended(words, activefail(*words)), words


def test_files_of_a_run_folder_that_have_another_name_elsewhere_are_never_written_in_place(
    received: Path, tmp_path: Path
) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    names = ["checkpoint.h5", "report.html"]
    names += ["compare/scores.csv", "compare/learning_curves.png", "compare/learning_curves.svg"]
    for number, name in enumerate(names):
        held = victim / str(number)
        shutil.copy(received / name, held)
        (received / name).unlink()
        os.link(held, received / name)
    before = {path.name: path.read_bytes() for path in victim.iterdir()}
    for words in commands(received):
        if words[0] != "explore":
            assert ended(words, activefail(*words)), words
    assert {path.name: path.read_bytes() for path in victim.iterdir()} == before


def test_an_output_that_is_a_link_in_a_run_folder_is_refused_and_a_link_of_the_users_elsewhere_is_followed(
    received: Path, tmp_path: Path
) -> None:
    victim = tmp_path / "victim.csv"
    victim.write_text("mine")
    for link in (received / "table.csv", received / "compare" / "table.csv", tmp_path / "mine.csv"):
        link.symlink_to(victim)
    other = Path(shutil.copytree(received, tmp_path / "other", symlinks=True))
    (received / "compare" / "table.csv").unlink()
    for target in (received / "table.csv", other / "table.csv", other / "compare" / "table.csv"):
        result = activefail("export", received, "--csv", target)
        refused(result, "--csv: ", f"{target} is a symbolic link in a run folder. No such link is followed")
    assert victim.read_text() == "mine"
    assert activefail("export", received, "--csv", tmp_path / "mine.csv").code == 0
    assert (tmp_path / "mine.csv").is_symlink()
    assert len(table(victim)) == 12


# --- text --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [FORGED, *(one for one in FORGED if not one.isprintable()), "\udcff", "\U000e0041"])
def test_every_character_that_is_no_letter_is_shown_as_an_escape(text: str) -> None:
    shown = visible(text)
    assert shown.isprintable()
    assert shown.encode().decode("unicode_escape") == text
    assert visible("μ in 10 kN, naïve “°C” – 東京") == "μ in 10 kN, naïve “°C” – 東京"


@pytest.mark.parametrize(
    "name", ["plain", "two words", "it's", "a\nb", "tab\there", "back\\slash", "run\udcff", "é\x1b"]
)
def test_a_word_for_the_shell_is_one_visible_line_that_names_the_same(name: str) -> None:
    assert quoted(name).isprintable()
    result = subprocess.run(["bash", "-c", f"printf %s {quoted(name)}"], capture_output=True, check=True).stdout
    assert result == os.fsencode(name)


def test_no_text_of_a_run_folder_forges_a_line_of_the_program(tmp_path: Path, survived: Survived) -> None:
    settings = tomllib.loads(CAMPAIGN)
    settings["description"] = f"quiet{FORGED}"
    settings["space"]["x"]["unit"] = f"m{FORGED}"
    settings["classifier"] = {"features": {"expressions": {f"twice{FORGED}": "2 * x"}}}
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "campaign.toml").write_text(tomli_w.dumps(settings))
    (tmp_path / "designs.csv").write_text("x,y\n0.2,0.3\n")
    folder = tmp_path / "run"
    assert activefail("run", tmp_path / "campaign.toml", "--out", folder, "--workers", "1").code == 0
    for words in commands(folder):
        if words[0] != "explore":
            result = activefail(*words)
            unforged(result)
            assert ended(words, result), result
            survived()
    assert r"quiet\nresults    forged\r\x1b[2J\x1b]0;title\x07\u202e" in activefail("status", folder).out
    page = (folder / "report.html").read_text()
    assert visible(page, keep="\n\t") == page
    assert not [line for line in page.splitlines() if line.startswith("results    forged")]
    # The difference to changed settings quotes both.
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace("budget = 12", "budget = 13") + "# \u202e\u2066\x85\n")
    result = activefail("export", folder, "--csv", tmp_path / "all.csv")
    unforged(result)
    assert "settings were changed" in result.err
    assert r"\u202e\u2066" in result.err


def test_no_message_of_a_simulator_forges_a_line_of_the_program(tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text(f"def run(d):\n    raise ValueError({FORGED!r})\n")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    result = activefail("run", tmp_path / "campaign.toml", "--out", tmp_path / "raises", "--workers", "1")
    unforged(result)
    assert (result.code, r"ValueError: \nresults    forged\r\x1b[2J" in result.err) == (1, True), result.err
    (tmp_path / "model.py").write_text(f"raise ImportError({FORGED!r})\n")
    result = activefail("run", tmp_path / "campaign.toml", "--out", tmp_path / "import", "--workers", "1")
    unforged(result)
    assert result.code == 2
    # A program's words on its error stream.
    (tmp_path / "program.py").write_text(f"import sys\nsys.stderr.buffer.write({FORGED.encode()!r})\nsys.exit(3)\n")
    settings = tomllib.loads(CAMPAIGN) | {"simulator": {"command": f"{sys.executable} {{here}}/program.py {{out}}"}}
    (tmp_path / "campaign.toml").write_text(tomli_w.dumps(settings))
    result = activefail("run", tmp_path / "campaign.toml", "--out", tmp_path / "program", "--workers", "1")
    unforged(result)
    assert (result.code, "exit code 3; " in result.err) == (1, True), result.err


def test_only_the_first_line_of_a_message_begins_at_the_margin(tmp_path: Path) -> None:
    folder = tmp_path / f"a{FORGED.replace('/', '')}"
    for words in (["status", folder], ["run", folder, "--out", tmp_path / "new"], ["compare", folder]):
        result = activefail(*words)
        unforged(result)
        assert [line for line in result.err.splitlines()[1:] if not line.startswith("  ")] == []


@pytest.mark.parametrize("name", [b"run\xff", b"a\nresults    forged", b"\x1b[2J"])
def test_a_folder_of_any_name_is_worked_with_by_every_command(received: Path, name: bytes) -> None:
    folder = received.rename(received.parent / os.fsdecode(name))
    for words in commands(folder):
        if words[0] == "explore":
            continue
        result = activefail(*words)
        unforged(result)
        assert ended(words, result), result
    page = (folder / "report.html").read_text()
    assert visible(page, keep="\n\t") == page
    assert f"activefail verify {quoted(folder)}".replace("'", "&#39;") in page


# --- settings ----------------------------------------------------------------------------------------------------

scalars = st.one_of(
    *(st.booleans(), st.integers(-(2**63), 2**63 - 1), st.just(10**400), st.floats(), st.dates()),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
)
values = st.one_of(
    scalars,
    st.lists(scalars, max_size=3),
    st.dictionaries(st.text("ab\n", min_size=1, max_size=2), scalars, max_size=2),
)


def paths(settings: dict[str, Any], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    entries = []
    for key, value in settings.items():
        entries.append((*above, key))
        if isinstance(value, dict):
            entries += paths(value, (*above, key))
    return entries


@often
@given(data=st.data())
def test_settings_of_any_shape_end_in_an_answer_or_one_message(
    sent: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, survived: Survived
) -> None:
    settings = tomllib.loads((sent / "campaign.toml").read_text())
    *above, key = data.draw(st.sampled_from(paths(settings)))
    section = settings
    for name in above:
        section = section[name]
    section[key] = data.draw(values)
    text = tomli_w.dumps(settings)
    home = tmp_path_factory.mktemp("settings")
    (home / "designs.csv").write_text("x,y\n0.2,0.3\n")
    # As a folder whose settings were changed, and as one whose record agrees with them.
    shutil.copytree(sent, home / "changed")
    (home / "changed" / "campaign.toml").write_text(text)
    schema = Schema(("x", "y"), ("safe", "failure"), ("",), ("m",))
    one = Results(np.ones(1, np.int8), np.zeros(1, np.int8), np.ones((1, 1)), np.ones(1))
    if "\0" not in text:
        with FolderStore.create(home / "forged", text, schema) as store:
            store.commit(Batch(0, np.zeros(1, np.int64), np.full((1, 2), 0.5), np.full(1, INITIAL, np.int8), one))
    for folder in (home / "changed", home / "forged"):
        for words in commands(folder):
            if words[0] in ("status", "export", "predict") and folder.exists():
                result = activefail(*words)
                unforged(result)
                assert result.code in (0, 1, 2)
                assert result.code == 0 or result.err.count("activefail: ") == 1
    survived()
    shutil.rmtree(home)


@pytest.mark.parametrize("kind", ["pipe", "endless", "folder"])
def test_a_campaign_file_that_is_none_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    path = folder / "campaign.toml"
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "endless":
            with path.open("wb") as file:
                file.truncate(300 * 2**30)
        case "folder":
            path.mkdir()
    for words in commands(folder):
        refused(activefail(*words), "campaign.toml")


# --- states ------------------------------------------------------------------------------------------------------


def rewritten(folder: Path, change: Callable[[dict[str, Any]], object]) -> int:
    """The newest state of a run folder changed, under a right digest; its iteration."""
    path = folder / "checkpoint.h5"
    with FolderStore.open(folder, write=False) as store:
        states = decode(path.read_bytes())
        iteration = max(states)
        state = dict(states[iteration].arrays)
        change(state)
        path.write_bytes(encode({**states, iteration: State(states[iteration].record, state)}, store.schema, ()))
    return iteration


@pytest.mark.parametrize(
    ("key", "array"),
    [
        ("covar_module.base_kernel.raw_lengthscale", np.full((1, 2), 1e300)),
        ("site_precision", np.full(12, np.nan)),
        ("site_linear", np.zeros(0)),
        ("inducing", np.array([99], dtype=np.int64)),
    ],
    ids=lambda value: value if isinstance(value, str) else f"{value.dtype}{value.shape}",
)
def test_a_state_that_no_training_gives_is_skipped_and_learned_again_by_every_command(
    received: Path, tmp_path: Path, key: str, array: np.ndarray, survived: Survived
) -> None:
    predict = next(words for words in commands(received) if words[0] == "predict")
    assert activefail(*predict).code == 0
    before = (tmp_path / "predicted.csv").read_text()
    iteration = rewritten(received, lambda state: state.update({f"failure/{key}": np.asarray(array)}))
    for words in commands(received):
        if words[0] in ("predict", "report", "verify", "resume"):
            folder = Path(shutil.copytree(received, tmp_path / str(words[0])))
            result = activefail(words[0], folder, *words[2:])
            assert result.code == 0, result
            assert f"warning: checkpoint.h5: the state of iteration {iteration} " in result.err
            assert "; it is skipped." in result.err
            survived()
    assert (tmp_path / "predicted.csv").read_text() == before


numbers = st.one_of(
    arrays.arrays(np.float64, arrays.array_shapes(min_dims=0, max_dims=2, min_side=0, max_side=13)),
    arrays.arrays(np.int64, arrays.array_shapes(min_dims=0, max_dims=2, min_side=0, max_side=13)),
    arrays.arrays(np.float64, st.sampled_from([(), (1, 2), (12,)])),
    arrays.arrays(np.int64, 3, elements=st.integers(-2, 13)),
)


@often
@given(data=st.data())
def test_arrays_of_any_kind_in_a_state_give_a_classifier_or_none(
    sent: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, survived: Survived
) -> None:
    folder = Path(shutil.copytree(sent, tmp_path_factory.mktemp("state") / "run"))
    keys = ["site_linear", "site_precision", "elbo", "learned_on", "inducing"]
    keys += ["mean_module.raw_constant", "covar_module.raw_outputscale", "covar_module.base_kernel.raw_lengthscale"]
    changes = data.draw(st.dictionaries(st.sampled_from(keys), numbers, min_size=1, max_size=3))
    rewritten(folder, lambda state: state.update({f"failure/{key}": array for key, array in changes.items()}))
    with open_campaign(folder, write=False, features=False) as (campaign, store):

        def restored(_: int, state: dict[str, Any], history: History) -> Classifier:
            known = history.training
            of = known.designs, known.outcome, campaign.simulator.outcomes, campaign.features
            return classifier_from_state(state, *of, learner_of(campaign))

        saved = restore(campaign, store, store.batches[-1].iteration, restored)
        if saved is not None:
            probabilities = saved[1].probabilities(np.random.default_rng(0).random((5, 2)))
            assert np.isfinite(probabilities).all()
    survived()
    shutil.rmtree(folder)


# --- programs ----------------------------------------------------------------------------------------------------

SPACE = DesignSpace((Parameter("y", 0.0, 1.0),))


@pytest.mark.parametrize(
    "form",
    [
        "3000000000f",
        "٩٩٩٩٩٩٩f",
        ">00000000000000101.3f",
    ],
)
def test_a_format_that_would_fill_the_memory_is_refused_before_it_is_used(received: Path, form: str) -> None:
    command = f"model {{y:{form}}} {{out}}"
    limit = rf"the format of {{y}} must have a width and a precision of at most {LONGEST_NUMBER}"
    with pytest.raises(InputError, match=re.escape(limit)):
        CommandSimulator(SPACE, command, None, Path("work"), ("safe", "failure"), ())
    text = (received / "campaign.toml").read_text()
    settings = tomllib.loads(text) | {"simulator": {"command": command, "margins": ["m"]}}
    (received / "campaign.toml").write_text(tomli_w.dumps(settings))
    for words in commands(received):
        if words[0] != "status":  # reads no command
            refused(activefail(*words), "campaign.toml: simulator.command: ", limit)


@pytest.mark.parametrize(
    "form",
    [
        ".4f",
        "100.100f",
        "+012.5g",
    ],
)
def test_a_format_of_ordinary_width_is_used(form: str, tmp_path: Path) -> None:
    paths = {"here": tmp_path, "out": tmp_path / "out"}
    assert len(arguments(f"model {{y:{form}}} {{out}}", {"y": 0.5}, paths)[1]) <= 103


def run_program(tmp_path: Path, script: str) -> Results:
    (tmp_path / "program.sh").write_text(script)
    simulator = CommandSimulator(
        SPACE, "sh {here}/program.sh {out}", tmp_path, tmp_path / "simulations", ("safe", "failure"), ()
    )
    return simulator.run(np.array([[0.5]]))


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        (f'head -c {LARGEST_ANSWER + 1} /dev/zero > "$1"', f"is larger than {LARGEST_ANSWER} bytes"),
        ('truncate -s 9G "$1"', f"is larger than {LARGEST_ANSWER} bytes"),
        ('mkfifo "$1"', "is not a regular file"),
        ('ln -s /dev/zero "$1"', "is not a regular file"),
        ('mkdir "$1"', "is not a regular file"),
        ("""head -c 900000 /dev/zero | tr '\\0' '[' > "$1\"""", "is not JSON"),
    ],
    ids=["large", "sparse", "pipe", "device", "folder", "deep"],
)
def test_an_answer_that_is_no_small_file_is_no_answer(tmp_path: Path, script: str, reason: str) -> None:
    with pytest.raises(UnusableAnswerError, match=reason):
        run_program(tmp_path, script)


def test_of_an_endless_error_stream_the_end_alone_is_read(tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RuntimeError, match=r"exit code 3; .*stderr\.txt ends with '.*the reason'") as raised:
        run_program(tmp_path, "truncate -s 9G stderr.txt; echo the reason >> stderr.txt; exit 3")
    assert len(str(raised.value)) < 3000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


# --- locks -------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("strace")
@pytest.mark.parametrize("error", ["ENOSYS", "EOPNOTSUPP"])
def test_without_flock_a_kill_locks_nothing_and_a_lock_made_elsewhere_is_not_busy(
    victims: Victims, uninterrupted: Course, tmp_path: Path, error: str
) -> None:
    folder = tmp_path / "run"
    no_flock = ["-e", "trace=flock", "-e", f"inject=flock:error={error}", "-o", str(tmp_path / "trace")]
    # Begun where flock works.
    victim = victims.start(folder, "", commits=1)
    victim.go_on()
    assert victim.end() == 0
    victim = victims.start(folder, "commit 1", commits=2)
    os.kill(victim.pid, signal.SIGKILL)
    assert victim.end() == -signal.SIGKILL
    for commits in (2, 3):
        victim = victims.start(folder, "", commits=commits)
        with traced(victim.pid, *no_flock):
            victim.go_on()
            assert victim.end() == 0, victim.reports
        assert "has no locks: make sure that only one process writes" in victim.reports[-1]
    assert "(INJECTED)" in (tmp_path / "trace").read_text()
    assert finished(folder) == uninterrupted


def test_a_journal_that_is_no_file_is_refused(received: Path) -> None:
    (received / "journal").unlink()
    os.mkfifo(received / "journal")
    for write in (True, False):
        with pytest.raises(StoreError, match=r"journal is not a regular file"):
            FolderStore.open(received, write=write)


# --- names and limits --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line", ["a" + ".a" * 40_000 + " = 1", "[a" + ".a" * 200_000 + "]", "x = {a" + ".a" * 9_000 + " = 1}"]
)
def test_a_key_of_thousands_of_parts_is_refused_at_once(
    sent: Path, tmp_path: Path, line: str, survived: Survived
) -> None:
    folder = Path(shutil.copytree(sent, tmp_path / "run"))
    settings = folder / "campaign.toml"
    settings.write_text(f"{settings.read_text()}\n{line}\n")
    for command in (("status", folder), ("export", folder, "--csv", tmp_path / "out.csv")):
        result = activefail(*command)
        assert result.code == 2
        assert "must have at most 200 dots" in result.err
    survived(1)


def test_a_file_of_a_run_folder_is_known_by_the_file_system_and_not_by_its_spelling(
    sent: Path, tmp_path: Path, survived: Survived
) -> None:
    folder = Path(shutil.copytree(sent, tmp_path / "run"))
    # As on a file system that ignores case: another name of the same file or folder.
    os.link(folder / "campaign.toml", folder / "Campaign.toml")
    assert run_folder_owning(folder / "Campaign.toml") == folder
    (tmp_path / "elsewhere").mkdir()
    assert run_folder_owning(folder / "simulations" / "new.csv") == folder
    assert run_folder_owning(folder / "mine.csv") is None
    assert run_folder_owning(tmp_path / "elsewhere" / "campaign.toml") is None
    result = activefail("export", folder, "--csv", folder / "Campaign.toml")
    assert (result.code, "is one of the run folder's own files" in result.err) == (2, True)
    survived(1)
