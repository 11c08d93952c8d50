"""A summary counts what the whole record holds, and says nothing where only the record can."""

import os
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import Disc, disc

from activefail.campaign.settings import parse_settings
from activefail.execution.local import ThreadExecutor
from activefail.findings.summary import SettingsInBrief, Summary, read_summary
from activefail.loop.batches import run
from activefail.record import compaction
from activefail.record.batch import ACTIVE, CHECK, GIVEN, INITIAL, Batch
from activefail.record.run_folder import FolderStore


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a campaign with numerical failures, merged files and small ones."""
    folder = tmp_path_factory.mktemp("summary") / "run"
    campaign = disc(Disc(blind=-1.5), extra="limits.numerical_failures = 1.0")
    patch = pytest.MonkeyPatch()
    patch.setattr(compaction, "COMPACT_AT", 3)
    with FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store, ThreadExecutor(1) as executor:
        run(campaign, store, executor, 28)
    patch.undo()
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "run"))


def whole(folder: Path) -> Summary:
    with FolderStore.open(folder, write=False) as store:
        assert store.schema is not None
        return Summary.of(store.settings, store.schema.variables, store.schema.outcomes, store.batches, store.asked)


def values(summary: Summary | None) -> dict[str, object]:
    assert summary is not None
    # The names of margins and the digests are for a reader of the files alone.
    fields = asdict(summary).items()
    return {name: np.asarray(value).tolist() for name, value in fields if name not in ("margins", "known")}


def test_a_summary_says_what_the_whole_record_says(folder: Path) -> None:
    summary = read_summary(folder)
    assert values(summary) == values(whole(folder))
    assert summary is not None
    assert (summary.done, summary.iteration, int(summary.initial.sum())) == (28, 4, 12)
    assert summary.counts[-1] > 0
    assert len(list((folder / "segments").iterdir())) > 1


def test_designs_are_counted_by_who_asked_for_them_not_by_when_they_were_answered(tmp_path: Path) -> None:
    campaign = disc(Disc(), asynchronous=True)
    X = campaign.space.from_unit(np.random.default_rng(0).random((20, 2)))
    # As without batches: the last initial designs are answered when the first chosen ones are out.
    parts = [(0, [INITIAL] * 10), (1, [INITIAL, ACTIVE, INITIAL]), (2, [ACTIVE] * 4), (3, [GIVEN, ACTIVE, CHECK])]
    first = 0
    with FolderStore.create(tmp_path, campaign.settings.text(), campaign.schema) as store:
        for iteration, origins in parts:
            designs = X[first : first + len(origins)]
            first += len(origins)
            store.commit(Batch(iteration, designs, np.array(origins, dtype=np.int8), Disc().run(designs)))
    summary = read_summary(tmp_path)
    assert values(summary) == values(whole(tmp_path))
    assert summary is not None
    assert (int(summary.initial.sum()), int(summary.chosen.sum()), int(summary.given.sum())) == (12, 7, 1)
    assert summary.done == 19


@pytest.mark.parametrize(
    "fault",
    [
        "cut",
        "missing",
        "first missing",
        "settings",
        "twice",
        "empty",
        "no text",
        "pipe",
        "no end",
        "digits",
        "weight",
        "other",
    ],
)
def test_where_only_the_record_can_say_what_is_wrong_there_is_no_summary(folder: Path, fault: str) -> None:
    first, *_, last = sorted((folder / "segments").iterdir())
    settings = folder / "campaign.toml"
    match fault:
        case "cut":
            last.write_bytes(last.read_bytes()[:-1])
        case "missing":
            sorted((folder / "segments").iterdir())[1].unlink()
        case "first missing":
            first.unlink()
        case "settings":
            settings.write_text(settings.read_text().replace("seed = 1", "seed = 2"))
        case "twice":
            with FolderStore.open(folder, write=False) as store:
                one = store.batches[0]
            inputs = FolderStore.create(folder.with_name("copy"), settings.read_text(), disc().schema)
            inputs.commit(Batch(0, one.designs, np.full(len(one), INITIAL, dtype=np.int8), one.results))
            inputs.close()
            (path,) = (folder.with_name("copy") / "segments").iterdir()
            path.rename(folder / "segments" / path.name)
        case "empty":
            for path in (folder / "segments").iterdir():
                path.unlink()
        case "no text":
            settings.write_bytes(b"\xff")
        case "no end":
            settings.write_text("a = " + "[" * 100_000)
        case "digits":
            settings.write_text(f"seed = {'9' * 5000}")
        case "weight":
            boundary = 'boundary = "broken"'
            assert boundary in settings.read_text()
            settings.write_text(settings.read_text().replace(boundary, f"boundary = {{ broken = 1{'0' * 400} }}"))
        case "pipe":
            settings.unlink()
            os.mkfifo(settings)
        case "other":
            settings.unlink()
    assert read_summary(folder) is None


def test_counting_loads_neither_learning_nor_physics(folder: Path) -> None:
    script = "import sys; from activefail.cli import main\ntry: main()\nfinally: print(sorted(sys.modules))"
    words = [sys.executable, "-c", script, "status", str(folder)]
    output = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "28 of 28 simulations" in output
    loaded = output[output.index("['") :]
    assert [name for name in ("torch", "numba", "scipy", "matplotlib") if f"'{name}'" in loaded] == []


@pytest.mark.parametrize(
    ("features", "words"),
    [
        ('"sliding"', "sliding"),
        ('{ expressions = { ratio = "T_b / T_p", slip = "mu / A_p" } }', "variables, ratio, slip"),
        ('{ expressions = { ratio = "T_b / T_p" }, variables = false }', "ratio"),
        ('{ python = "mine:physics" }', "variables, mine:physics"),
        ('{ python = "mine:physics", variables = false }', "mine:physics"),
    ],
)
def test_the_settings_in_brief_name_all_that_the_classifier_sees(features: str, words: str) -> None:
    settings = parse_settings(f"classifier.features = {features}", "test")
    brief = SettingsInBrief.of(settings.text())
    assert brief.features == words
    assert brief.custom_code == ("python" in features)
