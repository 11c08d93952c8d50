"""A summary counts what the whole record holds, and says nothing where only the record can."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import Disc, disc

from activefail.analyses.findings.status import read_status
from activefail.analyses.findings.summary import features_in_words
from activefail.campaign.settings import parse_settings
from activefail.errors import ActivefailError
from activefail.execution.local import ThreadExecutor
from activefail.loop.running import run
from activefail.record.batch import ACTIVE, CHECK, GIVEN, INITIAL, Batch
from activefail.record.run_folder import FolderStore


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a campaign with numerical failures."""
    folder = tmp_path_factory.mktemp("summary") / "run"
    campaign = disc(Disc(blind=-1.5), extra="limits.numerical_failures = 1.0")
    with FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store, ThreadExecutor(1) as executor:
        run(campaign, store, executor, 28)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "run"))


def test_a_summary_counts_what_the_record_holds(folder: Path) -> None:
    summary = read_status(folder).summary
    assert (summary.done, summary.iteration, int(summary.initial.sum())) == (28, 4, 12)
    assert summary.counts[-1] > 0


def test_designs_are_counted_by_who_asked_for_them_not_by_when_they_were_answered(tmp_path: Path) -> None:
    campaign = disc(Disc(), asynchronous=True)
    X = campaign.space.from_unit(np.random.default_rng(0).random((20, 2)))
    # As without batches: the last initial designs are answered when the first chosen ones are out.
    parts = [(0, [INITIAL] * 10), (1, [INITIAL, ACTIVE, INITIAL]), (2, [ACTIVE] * 4), (3, [GIVEN, ACTIVE, CHECK])]
    first = 0
    with FolderStore.create(tmp_path, campaign.settings.text(), campaign.schema) as store:
        for iteration, origins in parts:
            ids = first + np.arange(len(origins))
            designs = X[ids]
            first += len(origins)
            store.commit(Batch(iteration, ids, designs, np.array(origins, dtype=np.int8), Disc().run(designs)))
    summary = read_status(tmp_path).summary
    assert (int(summary.initial.sum()), int(summary.chosen.sum()), int(summary.given.sum())) == (12, 7, 1)
    assert summary.done == 19


def test_settings_that_no_campaign_has_are_refused(folder: Path) -> None:
    settings = folder / "campaign.toml"
    settings.write_text(settings.read_text().replace("seed = 1", "seed = 2"))
    with pytest.raises(ActivefailError):
        read_status(folder)
    settings.unlink()
    with pytest.raises(ActivefailError):
        read_status(folder)


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
        ('"decorrelated"', "decorrelated"),
        ('{ expressions = { ratio = "T_b / T_p", slip = "mu / A_p" } }', "variables, ratio, slip"),
        ('{ expressions = { ratio = "T_b / T_p" }, variables = false }', "ratio"),
        ('{ python = "mine:physics" }', "variables, mine:physics"),
        ('{ python = "mine:physics", variables = false }', "mine:physics"),
    ],
)
def test_the_settings_in_brief_name_all_that_the_classifier_sees(features: str, words: str) -> None:
    text = "simulator.elsewhere = true\nspace.T_b = { low = 1, high = 5 }\nspace.T_p = { low = 1, high = 5 }\n"
    settings = parse_settings(f"{text}classifier.features = {features}", "test")
    assert features_in_words(settings) == words
    assert settings.needs_code == ("python" in features)
