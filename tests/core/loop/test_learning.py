"""What a campaign learns from the same simulations does not depend on what an earlier classifier made of fewer."""

from dataclasses import dataclass

import numpy as np
from campaign.stub import HIGH, LOW, Disc, disc

from activefail.campaign.random_streams import stream
from activefail.execution.local import ThreadExecutor
from activefail.loop.history import History
from activefail.loop.learning import accuracy, current, learn_from
from activefail.loop.running import run
from activefail.record.memory import MemoryStore
from activefail.simulators.interface import Results
from activefail.space.space import Array


@dataclass(frozen=True)
class Wave(Disc):
    """Broken below a wave of two periods; no margin."""

    margins = ()

    def run(self, X: Array) -> Results:
        """Answer designs (x, y), shape (n, 2)."""
        x, y = ((X - LOW) / (HIGH - LOW)).T
        broken = (y < 0.5 + 0.3 * np.sin(4.0 * np.pi * x)).astype(np.int8)
        return Results(broken, broken, np.empty((len(X), 0)), np.zeros(len(X)))


def test_a_campaign_whose_initial_design_showed_no_wave_finds_it_and_beats_a_static_design() -> None:
    # With this seed the likeliest classifier of the 40 initial designs is a straight boundary, right about 83 %.
    campaign = disc(Wave(), seed=2, initial=40, budget=80, batch=10)
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, 80)
    hypercube = campaign.space.latin_hypercube(80, stream(2, "static", 80))
    static = learn_from(campaign, History.of_sample(hypercube, campaign.simulator.run(hypercube)))
    X = campaign.space.sobol(4096, np.random.default_rng(0))
    broken = campaign.simulator.run(X).outcome
    active = accuracy(current(campaign, store, write=False).classifier, 1, X, broken)
    assert active > max(0.96, accuracy(static, 1, X, broken))
