"""The bearing as a campaign's simulator: what its physics says for certain, and what follows."""

import numpy as np

from activefail import TABLE_1
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.findings.results import predict
from activefail.loop.history import History
from activefail.loop.learning import learn_from
from activefail.reliability.integral import BoundariesOf, integrate
from activefail.simulators.bearing import DfpSimulator
from activefail.space import Array, DesignSpace
from activefail.surrogate.threads import one_thread

CAMPAIGN = 'seed = 1\nsampling = { initial = 40, budget = 40 }\nclassifier.features = "paper"'


def below_friction(n: int) -> Array:
    """Bearings under pulses of at most their friction, far outside Table 1 too: (n, 9)."""
    rng = np.random.default_rng(5)
    X = TABLE_1.from_unit(rng.random((n, TABLE_1.dimension)))
    X[:, 1] = rng.uniform(0.01, 0.3, n)
    X[:, 7] = np.exp(rng.uniform(np.log(0.1), np.log(20.0), n))
    X[:, 8] = X[:, 1] * rng.uniform(0.7, 1.0, n)
    return X


def test_a_pulse_below_the_friction_is_harmless() -> None:
    campaign = Campaign.of(parse_settings(CAMPAIGN, "bearing"))
    X = below_friction(300)
    results = campaign.simulator.run(X)
    assert (results.outcome == 0).all()
    assert isinstance(campaign.simulator, DfpSimulator)
    assert campaign.simulator.harmless(X).all()
    X[:, 8] = 1.01 * X[:, 1]
    assert not campaign.simulator.harmless(X).any()


def test_no_number_puts_a_pulse_below_the_friction_beyond_a_boundary() -> None:
    campaign = Campaign.of(parse_settings(CAMPAIGN, "bearing"))
    designs = campaign.space.latin_hypercube(40, np.random.default_rng(1))
    history = History.of_sample(designs, campaign.simulator.run(designs))
    with one_thread():
        classifier = learn_from(campaign, history)
        X = below_friction(500)
        # By the latents alone, some of them would lie beyond.
        F = campaign.features(X)
        assert any((latent.moments(F).side > -3.0).any() for latent in classifier.latents)
        prediction = predict(campaign, classifier, X)
        assert (prediction.probabilities[:, 1:] < 1e-300).all()
        assert (prediction.high < 1e-300).all()
        boundaries = BoundariesOf(classifier, campaign.features)
        assert (boundaries(X) <= -37.0).all()
        narrow = DesignSpace(tuple(p for p in TABLE_1.parameters if p.name != "A_p"), {"A_p": 0.02})
        assert (
            integrate(boundaries, narrow, designs=lambda U: np.column_stack([U, np.full(len(U), 0.02)])).probability
            < 1e-300
        ).all()
