"""A user names the folder of custom code once; for any other folder, file or code activefail requires it again."""

import json
import os
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from unittest import mock

import pytest
from commandline import CommandResult, activefail, refused

import activefail as af
from activefail.campaign.known_code import known_code
from activefail.errors import InputError

MODEL = """
import pathlib

import limit

pathlib.Path(__file__).with_name("ran").touch()


def run(design):
    return "failure" if design["x"] > limit.LIMIT else "safe"


def square(X, space):
    return X[:, :1] ** 2
"""

TOML = """
sampling = { initial = 4, budget = 4, batch = 2 }
validation = { size = 4 }
simulator = { python = "model:run" }
[space]
x = { low = 0.0, high = 1.0 }
y = { low = 0.0, high = 1.0 }
"""

PROGRAM = """
import sys
open(sys.argv[1], "w").write('{"outcome": "%s"}' % ("failure" if float(sys.argv[2]) > 0.5 else "safe"))
"""

NAMED = "name its folder with --code"


@pytest.fixture(scope="module", autouse=True)
def one_worker() -> Iterator[None]:
    """Commands start one worker process: to start another takes longer than these simulations."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.cpu_count", lambda: 1)
        yield


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder with a campaign file and the code that it names, with a link to it."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "model.py").write_text(MODEL)
    (folder / "limit.py").write_text("LIMIT = 0.5\n")
    (folder / "mine.toml").write_text(TOML)
    return folder


@pytest.fixture
def run(mine: Path, tmp_path: Path) -> Path:
    """The run folder of a campaign that this user has started; it has no simulations yet."""
    folder = tmp_path / "run"
    af.create_run(folder, mine / "mine.toml").close()
    (mine / "ran").unlink()
    return folder


def resumed(folder: Path, *words: str | Path) -> CommandResult:
    return activefail("resume", folder, "--budget", "6", "--workers", "1", *words)


def succeeded(result: CommandResult) -> None:
    assert result.code == 0, result.err


def failed(result: CommandResult, *parts: str) -> None:
    """Assert that a command ended in one message with all these parts; it may have shown its progress before."""
    refused(CommandResult(result.code, "", result.err), *parts)


def asks(folder: Path, mine: Path) -> None:
    """Assert that nothing is run for a run folder unless its user names the code, and that nothing is offered."""
    failed(resumed(folder), "model:run is custom code", NAMED)
    assert not (mine / "ran").exists()
    assert continuation(folder)[0] == "with `activefail resume`; name the folder of the custom code with --code"


def continuation(folder: Path) -> list[str]:
    """How `status` says to continue a campaign."""
    lines = activefail("status", folder).out.splitlines()
    (first,) = (number for number, line in enumerate(lines) if line.startswith("continue"))
    return [line[11:] for line in lines[first:]]


# --- the same user, folder and code ----------------------------------------------------------------------------------


def test_code_that_was_run_is_run_again_without_being_named(run: Path, mine: Path) -> None:
    succeeded(resumed(run))
    assert (mine / "ran").exists()
    for command in ("verify", "probability"):
        succeeded(activefail(command, run, "--simulations", "10"))
    succeeded(activefail("compare", run, "--budgets", "4,6", "--test", "10"))


def test_status_prints_the_command_that_continues_without_naming_code(run: Path) -> None:
    assert continuation(run) == [f"activefail resume {run}"]
    succeeded(activefail(*shlex.split(continuation(run)[0])[1:]))


def test_features_are_run_again_and_commands_that_only_read_run_no_simulator(mine: Path, tmp_path: Path) -> None:
    designs = tmp_path / "designs.csv"
    designs.write_text("x,y\n0.2,0.3\n")
    for features in ("", 'classifier.features = { python = "model:square" }'):
        (mine / "mine.toml").write_text(features + TOML)
        folder = tmp_path / f"run{len(features)}"
        succeeded(activefail("run", mine / "mine.toml", "--out", folder, "--workers", "1"))
        (mine / "ran").unlink()
        succeeded(activefail("predict", folder, "--csv", designs, "--out", tmp_path / "predicted.csv"))
        assert (mine / "ran").exists() == bool(features)


def test_a_program_is_run_again_from_the_folder_it_was_run_from(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    command = f"{shlex.quote(sys.executable)} {{here}}/program.py {{out}} {{x}}"
    simulator = json.dumps({"command": command}).replace('{"command":', "{ command =")
    (tmp_path / "mine.toml").write_text(TOML.replace('{ python = "model:run" }', simulator))
    succeeded(activefail("run", tmp_path / "mine.toml", "--out", tmp_path / "run", "--workers", "1"))
    succeeded(resumed(tmp_path / "run"))


def test_naming_code_is_enough_once_and_only_if_it_could_be_loaded(
    run: Path, mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another user's"))
    asks(run, mine)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "model.py").write_text("raise SystemExit")
    refused(resumed(run, "--code", tmp_path / "broken"), "cannot be imported")
    asks(run, mine)
    succeeded(activefail("export", run, "--csv", tmp_path / "all.csv", "--code", mine))
    succeeded(resumed(run))


def test_a_command_on_a_relative_path_is_about_the_same_run_folder(
    run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(run)
    for path in (Path("run"), Path("link"), tmp_path / "mine" / ".." / "run"):
        assert known_code(path) is not None


# --- settings in Python ----------------------------------------------------------------------------------------------


@pytest.fixture
def script(mine: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A script beside the code, as if it ran this test, from another folder that has a module of the same name."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "model.py").write_text("raise SystemExit('another module')")
    monkeypatch.chdir(tmp_path / "elsewhere")
    main = ModuleType("__main__")
    main.__file__ = str(mine / "script.py")
    monkeypatch.setitem(sys.modules, "__main__", main)
    return mine / "script.py"


SETTINGS = tomllib.loads(TOML)


def test_settings_in_python_run_the_code_beside_the_script(script: Path, tmp_path: Path) -> None:
    with af.create_run(tmp_path / "run", SETTINGS) as run:
        assert run.take(progress=False).finished
    assert script.with_name("ran").exists()
    succeeded(resumed(tmp_path / "run"))


def test_settings_in_python_without_a_script_run_the_code_in_the_current_folder(
    script: Path, mine: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delattr(sys.modules["__main__"], "__file__")
    with pytest.raises(InputError, match="model cannot be imported: SystemExit: another module"):
        af.create_run(tmp_path / "run", SETTINGS)
    monkeypatch.chdir(mine)
    af.create_run(tmp_path / "run", SETTINGS).close()


@pytest.mark.parametrize("remember", [True, False])
def test_a_script_that_runs_again_states_its_code_again(script: Path, tmp_path: Path, remember: bool) -> None:
    for budget in (4, 6):
        with af.create_run(tmp_path / "run", SETTINGS, exist_ok=True, remember=remember) as run:
            assert run.take(budget, progress=False).progress.done == budget


def test_code_that_has_changed_since_is_not_mixed_in_unless_it_is_named(
    script: Path, mine: Path, tmp_path: Path
) -> None:
    af.create_run(tmp_path / "run", SETTINGS).close()
    (mine / "limit.py").write_text("LIMIT = 0.6\n")
    with pytest.raises(InputError, match=f"has changed since .* or code={str(mine)!r} in Python"):
        af.create_run(tmp_path / "run", SETTINGS, exist_ok=True)
    af.create_run(tmp_path / "run", SETTINGS, exist_ok=True, code=mine).close()


def test_of_a_folder_with_another_campaign_nothing_is_run(script: Path, mine: Path, tmp_path: Path) -> None:
    (mine / "other.py").write_text(MODEL.replace('"ran"', '"other ran"'))
    other = SETTINGS | {"simulator": {"python": "other:run"}}
    af.create_run(tmp_path / "run", other).close()
    (mine / "other ran").unlink()
    with pytest.raises(InputError, match="holds another campaign: simulator differ"):
        af.create_run(tmp_path / "run", SETTINGS, exist_ok=True, code=mine)
    assert not (mine / "other ran").exists()


@pytest.mark.parametrize("simulator", [{"python": "model:run"}, {"command": "true {x} {y} {out}"}])
def test_a_folder_of_someone_else_is_refused_before_anything_begins(
    mine: Path, tmp_path: Path, simulator: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    af.create_run(tmp_path / "run", SETTINGS | {"simulator": simulator}, code=mine, remember=False).close()
    with (
        af.open_run(tmp_path / "run", write=True) as run,
        pytest.raises(InputError, match=f"is custom code.*{NAMED}, or code=FOLDER in Python") as refused,
    ):
        run.take()
    assert "\n" not in str(refused.value)
    assert len(refused.traceback) < 6
    assert capsys.readouterr() == ("", "")


def test_a_script_that_names_itself_is_told_what_to_move(script: Path, mine: Path, tmp_path: Path) -> None:
    creates = f"import activefail\nactivefail.create_run({str(tmp_path / 'run')!r}, {SETTINGS!r})\n"
    (mine / "model.py").write_text(f"{MODEL}\n{creates}")
    with pytest.raises(InputError, match="model creates a run while it is imported"):
        af.create_run(tmp_path / "run", SETTINGS)
    assert not (tmp_path / "run").exists()
    indented = creates.replace("\n", "\n    ")
    (mine / "model.py").write_text(f"{MODEL}\nif __name__ == '__main__':\n    {indented}\n")
    af.create_run(tmp_path / "run", SETTINGS).close()


# --- changed code ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["model.py", "limit.py"])
def test_changed_code_must_be_named_again(run: Path, mine: Path, source: str) -> None:
    with (mine / source).open("a") as file:
        file.write("changed = True\n")
    command = f"activefail resume {run} --code {mine}"
    refused(resumed(run), f"{run}: the custom code in {mine} has changed since", f"as in `{command}`")
    assert not (mine / "ran").exists()
    changed = "the code in that folder has changed since the campaign last ran with it"
    assert continuation(run) == [command, changed]
    assert f"`{command}` continues it" in activefail("report", run).err
    succeeded(activefail(*shlex.split(command)[1:]))
    succeeded(resumed(run))


def test_a_link_that_leads_to_other_code_since_counts_as_a_change(run: Path, mine: Path, tmp_path: Path) -> None:
    link = tmp_path / "code"
    link.symlink_to(mine)
    succeeded(resumed(run, "--code", link))
    shutil.copytree(mine, tmp_path / "other")
    link.unlink()
    link.symlink_to(tmp_path / "other")
    refused(resumed(run), f"the custom code in {link} has changed since")


def test_code_that_is_gone_is_asked_for(run: Path, mine: Path, tmp_path: Path) -> None:
    mine.rename(tmp_path / "elsewhere")
    asks(run, mine)


# --- another run folder ----------------------------------------------------------------------------------------------


def test_a_copy_of_a_run_folder_is_asked_for(run: Path, mine: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "copy")
    asks(tmp_path / "copy", mine)


def test_a_folder_that_someone_puts_in_its_place_is_asked_for(run: Path, mine: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "received")
    shutil.rmtree(run)
    shutil.copytree(tmp_path / "received", run)
    asks(run, mine)


@pytest.mark.parametrize("function", ["model:run", "model:square"])
def test_a_campaign_file_that_someone_unpacks_over_it_is_asked_for(run: Path, mine: Path, function: str) -> None:
    settings, before = run / "campaign.toml", os.stat(run / "campaign.toml")
    text = settings.read_text()
    settings.write_text(text.replace("model:run", function))
    os.utime(settings, ns=(before.st_atime_ns, before.st_mtime_ns))
    result = resumed(run)
    assert result.code in (1, 2)
    assert NAMED in result.err or "The settings were changed after the campaign began" in result.err
    assert not (mine / "ran").exists()


def test_a_run_folder_on_another_machine_is_asked_for(run: Path, mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.node", lambda: "elsewhere")
    asks(run, mine)


def test_code_in_the_run_folder_is_named_each_time(run: Path, mine: Path) -> None:
    shutil.copytree(mine, run / "code")
    with af.open_run(run, code=run / "code") as opened:
        assert opened.resume_command() == f"activefail resume {run} --code {run / 'code'}"
    asks(run, mine)


def test_a_module_outside_the_folder_of_the_code_is_named_each_time(run: Path, mine: Path, tmp_path: Path) -> None:
    path = str(shutil.copytree(mine, tmp_path / "library"))
    (tmp_path / "empty").mkdir()
    sys.path.insert(0, path)
    try:
        # Other tests have other modules of this name.
        with mock.patch.dict(sys.modules):
            af.open_run(run, code=tmp_path / "empty").close()
    finally:
        sys.path.remove(path)
    assert (tmp_path / "library" / "ran").exists()
    asks(run, mine)


# --- the notes -------------------------------------------------------------------------------------------------------


def note_in(state: Path) -> Path:
    (note,) = (state / "activefail").iterdir()
    return note


def test_notes_are_private_whatever_the_mask_of_new_files(mine: Path, tmp_path: Path, state: Path) -> None:
    before = os.umask(0o002)
    try:
        af.create_run(tmp_path / "run", mine / "mine.toml").close()
    finally:
        os.umask(before)
    assert note_in(state).stat().st_mode & 0o777 == 0o600
    assert note_in(state).parent.stat().st_mode & 0o777 == 0o700


def test_a_note_that_another_user_could_have_written_is_ignored(
    run: Path, mine: Path, state: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for mode in (0o620, 0o602):
        note_in(state).chmod(mode)
        asks(run, mine)
    note_in(state).chmod(0o600)
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: note_in(state).stat().st_uid + 1)
        asks(run, mine)
    # What changed the file's owner or mode did not change what it says.
    assert known_code(run) is not None


STRANGE = {
    "no object": b"[1]",
    "huge": b" " * 200_000,
    "sources of another form": b'{"sources": {"simulator.python": [1, 2]}}',
}


@pytest.mark.parametrize("content", STRANGE.values(), ids=STRANGE)
def test_a_note_that_says_something_else_is_ignored(run: Path, mine: Path, state: Path, content: bytes) -> None:
    note = note_in(state)
    try:
        changes = json.loads(content)
        content = json.dumps(json.loads(note.read_text()) | changes).encode()
    except (ValueError, TypeError, RecursionError):
        pass
    note.write_bytes(content)
    asks(run, mine)
    af.open_run(run, code=mine).close()
    assert known_code(run) is not None


@pytest.mark.parametrize("home", ["a file", "relative", "unknown"])
def test_without_a_place_for_notes_the_commands_name_the_folder_of_the_code(
    mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if home == "a file":
        monkeypatch.setenv("XDG_STATE_HOME", str(mine / "mine.toml"))
    else:
        monkeypatch.setenv("XDG_STATE_HOME", "here")
        monkeypatch.setenv("HOME", "here")
    if home == "unknown":

        def no_home() -> Path:
            raise RuntimeError("Could not determine home directory.")

        monkeypatch.setattr(Path, "home", no_home)
    folder = tmp_path / "run"
    with af.create_run(folder, mine / "mine.toml") as created:
        assert created.resume_command() == f"activefail resume {folder} --code {mine}"
    (mine / "ran").unlink()
    asks(folder, mine)
    succeeded(activefail(*shlex.split(created.resume_command())[1:]))
    assert not (tmp_path / "here").exists()


def test_notes_are_in_the_home_by_default(mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for value in ("", "relative"):
        monkeypatch.setenv("XDG_STATE_HOME", value)
        af.create_run(tmp_path / f"run{value}", mine / "mine.toml").close()
    assert len(list((tmp_path / "home" / ".local" / "state" / "activefail").iterdir())) == 2


# --- Python ----------------------------------------------------------------------------------------------------------


def test_a_run_in_python_and_the_command_line_remember_the_same(mine: Path, tmp_path: Path) -> None:
    af.create_run(tmp_path / "run", mine / "mine.toml").close()
    succeeded(activefail("resume", tmp_path / "run", "--workers", "1"))
    with af.open_run(tmp_path / "run", write=True) as run:
        assert run.campaign.code == mine
        assert run.take(budget=6).finished


def test_remembering_can_be_switched_off(mine: Path, tmp_path: Path, state: Path) -> None:
    folder = tmp_path / "run"
    af.create_run(folder, mine / "mine.toml", remember=False).close()
    af.open_run(folder, code=mine, remember=False).close()
    assert list(state.iterdir()) == []
    af.open_run(folder, code=mine).close()
    (mine / "ran").unlink()
    with (
        af.open_run(folder, write=True, remember=False) as run,
        pytest.raises(InputError, match=f"model:run is custom code.*{NAMED}"),
    ):
        run.take()
    assert not (mine / "ran").exists()


def test_a_campaign_without_custom_code_leaves_no_note(tmp_path: Path, state: Path) -> None:
    text = "sampling = { initial = 4, budget = 4, batch = 2 }\nspace.x = { low = 0, high = 1 }\n"
    (tmp_path / "made.toml").write_text(f"simulator.elsewhere = true\n{text}")
    af.create_run(tmp_path / "run", tmp_path / "made.toml").close()
    assert activefail("status", tmp_path / "run").code == 0
    af.open_run(tmp_path / "run", code=tmp_path).close()
    assert list(state.iterdir()) == []
