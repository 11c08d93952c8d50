"""A campaign on the disc, run once for all tests that only read it."""

from dataclasses import dataclass

import numpy as np
import pytest
from campaign.stub import Disc, disc

from activefail.campaign.assembly import Campaign
from activefail.execution.local import ThreadExecutor
from activefail.loop.learning import current
from activefail.loop.running import run
from activefail.record.memory import MemoryStore
from activefail.surrogate.classifier import Classifier
from activefail.surrogate.threads import one_thread


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
