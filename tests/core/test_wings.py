"""The tests of both wings are run, and the core's do without the plug-in."""

import re
from pathlib import Path

import pytest
import wings

TESTS = Path(__file__).parent


def test_no_test_of_the_core_names_the_plug_in() -> None:
    # In two parts each: this file is one of the tests.
    names = re.compile(r"activefail\.(seis" r"mic|bear" r"ing)|d" r"fp|D" r"fp")
    named = {path.name for path in TESTS.rglob("*.py") if names.search(path.read_text(encoding="utf-8"))}
    assert named == set()


@pytest.mark.parametrize(
    ("core", "seismic", "both"), [(0, 0, 0), (1, 0, 1), (0, 1, 1), (-9, 0, -9), (5, 1, 1), (0, 5, 0), (5, 5, 5)]
)
def test_both_wings_are_run_and_a_failure_in_either_fails(
    core: int, seismic: int, both: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    statuses, run = {"tests/core": core, "tests/seismic": seismic}, []

    def run_pytest(folder: Path, tests: str, words: list[str]) -> int:
        run.append((tests, words))
        return statuses[tests]

    monkeypatch.setattr(wings, "run_pytest", run_pytest)
    monkeypatch.setattr(wings, "copy_the_core", lambda: None)
    assert wings.run_both(["-q"]) == both
    assert run == [("tests/core", ["-q"]), ("tests/seismic", ["-q"])]
