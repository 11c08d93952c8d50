"""Campaigns that are run once for all tests that only read them."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import Disc, disc

from activefail import create_run
from activefail.campaign.assembly import Campaign
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import current
from activefail.loop.running import run
from activefail.record.memory import MemoryStore


def ran_in(home: Path, campaign: str, code: str) -> Path:
    """A folder with the code of a campaign, module `mine`, and its run folder `run`."""
    (home / "mine.py").write_text(code)
    (home / "mine.toml").write_text(campaign)
    with create_run(home / "run", home / "mine.toml", code=home) as opened:
        opened.take(workers=1)
    return home


@pytest.fixture(scope="module")
def simulations_in_this_process() -> Iterator[None]:
    """Simulate in a thread, where numbers and messages are claimed: starting processes takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("activefail.execution.local.ProcessExecutor", lambda *_: ThreadExecutor(1))
        yield


@dataclass(frozen=True)
class Run:
    campaign: Campaign
    store: MemoryStore
    classifier: Classifier


@pytest.fixture(scope="session")
def ran() -> Run:
    """A campaign on a disc half a unit of which lies in fog, run to its 40 simulations, and what it learned."""
    campaign = disc(Disc(blind=-1.5), initial=20, budget=40, batch=10, extra="limits.numerical_failures = 0.5")
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(2) as executor:
        run(campaign, store, executor, 40)
    assert any(np.any(batch.results.outcome < 0) for batch in store.batches)
    with one_thread():
        return Run(campaign, store, current(campaign, store, write=False).classifier)
