"""The campaigns that come with activefail."""

import zipfile
from pathlib import Path
from typing import Any

import pytest
from commandline import activefail, refused

from activefail import create_run
from activefail.campaign.on_disk import campaign_file, copy_shipped, read_campaign, shipped_campaigns, shipped_folder
from activefail.errors import InputError

NAMES = ["bearing", "building", "building_records", "catalogue", "frame", "opensees", "paper", "quick", "records"]

PROGRAMS = ("frame", "opensees")
"""Those that run a program in an interpreter of its own."""


def shipped(*without: str) -> list[Any]:
    """The shipped campaigns, but for some, as cases. Those with the far-field set need the records of FEMA P695."""
    texts = {name: path.read_text(encoding="utf-8") for name, path in shipped_campaigns().items()}
    marks = {name: [pytest.mark.needs("records")] if 'set = "farfield"' in texts[name] else [] for name in texts}
    return [pytest.param(name, marks=marks[name]) for name in texts if name not in without]


def test_every_shipped_campaign_is_listed_with_what_it_is() -> None:
    lines = activefail("campaigns").out.splitlines()
    assert [line.split()[0] for line in lines] == NAMES
    assert all(len(line.split()) > 3 for line in lines)


@pytest.mark.parametrize("name", shipped(*PROGRAMS))
def test_every_shipped_campaign_that_needs_no_program_can_be_read_from_a_copy(name: str, tmp_path: Path) -> None:
    copies = copy_shipped(tmp_path / "mine")
    assert tmp_path / "mine" / "hazards" / "near_fault.toml" in copies
    read_campaign(tmp_path / "mine" / f"{name}.toml", code=tmp_path / "mine")


def test_a_copy_overwrites_nothing(tmp_path: Path) -> None:
    refused(activefail("campaigns", "--copy", tmp_path), str(tmp_path), "exists already")
    with pytest.raises(InputError, match="exists already"):
        copy_shipped(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_name_stands_for_the_shipped_file_unless_the_user_has_a_file_of_that_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert campaign_file(Path("quick")) == shipped_folder() / "quick.toml" == shipped_campaigns()["quick"]
    with create_run("runs", "quick") as run:
        assert run.settings.sampling.budget == 100
    Path("quick").write_text("seed = 3\n")
    assert campaign_file(Path("quick")) == Path("quick")
    for other in ("quick.toml", "some/quick"):
        assert campaign_file(Path(other)) == Path(other)


@pytest.mark.parametrize("command", ["run", "create"])
def test_a_name_that_does_not_ship_is_refused_with_those_that_do(command: str, tmp_path: Path) -> None:
    result = activefail(command, "papr", "--out", tmp_path / "run")
    refused(result, f"papr: is neither a campaign file nor a shipped campaign ({', '.join(NAMES)})")
    assert not (tmp_path / "run").exists()


def test_the_wheel_has_the_campaigns(tmp_path: Path) -> None:
    from hatchling.builders.wheel import WheelBuilder

    root = Path(__file__).parents[3]
    (built,) = WheelBuilder(str(root)).build(directory=str(tmp_path), versions=["standard"])
    names = zipfile.ZipFile(built).namelist()
    campaigns = {path.relative_to(root).as_posix() for path in shipped_folder().rglob("*") if path.is_file()}
    kept = {f"activefail/{name}" for name in campaigns if "__pycache__" not in name}
    assert kept
    assert kept <= set(names)
    assert not [name for name in names if "__pycache__" in name]
    assert "activefail/py.typed" in names
