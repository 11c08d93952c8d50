"""The bearing as a campaign's simulator: what its physics says for certain, and what follows."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from activefail import TABLE_1
from activefail.analyses.design.findings import DesignFindings
from activefail.analyses.findings.results import predict
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.estimates.integral import BoundariesOf, integrate
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import learn_from
from activefail.seismic.hazard.hazard import read_hazard
from activefail.seismic.simulator import DfpSimulator
from activefail.simulators.interface import terms_of
from activefail.space.space import Array, DesignSpace

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


CATALOGUE = Path(__file__).parents[3] / "campaigns" / "catalogue.toml"


def test_a_bearing_of_a_catalogue_is_the_bearing_with_the_numbers_of_its_choices() -> None:
    campaign = Campaign.of(parse_settings(CATALOGUE.read_text(), "catalogue"))
    space = campaign.space
    X = space.random(40, np.random.default_rng(3))
    liner, rim = (X[:, space.names.index(name)].astype(int) for name in ("liner", "rim"))
    D_tot, T_p, A_p = (X[:, space.names.index(name)] for name in ("D_tot", "T_p", "A_p"))
    mu, h_rim = np.array([0.03, 0.06, 0.10])[liner], np.array([0.05, 0.1, 0.2])[rim]
    rest = [np.full(40, value) for value in (4.0, 0.6, 45.0, 2e9)]
    table = np.column_stack([rest[0], mu, D_tot, rest[1], h_rim, rest[2], rest[3], T_p, A_p])
    direct = DfpSimulator.on(TABLE_1, campaign.simulator.model, campaign.simulator.tolerance).run(table)
    results = campaign.simulator.run(X)
    assert results.outcome.tolist() == direct.outcome.tolist()
    np.testing.assert_array_equal(results.margins, direct.margins)
    assert campaign.simulator.harmless(X).tolist() == (A_p <= mu).tolist()
    assert {"mu", "h_rim_ratio", "liner_price"} < {*campaign.features.names}
    terms = terms_of(campaign.simulator, space.quantities(dict(zip(space.names, X[0].tolist(), strict=True))))
    assert terms is not None
    assert terms == terms_of(campaign.simulator, dict(zip(TABLE_1.names, table[0].tolist(), strict=True)))


def test_the_terms_of_a_design_of_a_catalogue_are_those_of_the_numbers_of_its_choices() -> None:
    numbered = CATALOGUE.read_text().replace('["A", "B", "C"]', "[10, 20, 30]")
    campaign = Campaign.of(parse_settings(numbered, "catalogue"))
    asked = SimpleNamespace(campaign=campaign, hazard=None)
    question = SimpleNamespace(fixed={"D_tot": 0.6, "liner": 2.0, "rim": 1.0})
    designed = SimpleNamespace(task=SimpleNamespace(asked=asked), question=question)
    terms = DesignFindings(designed, None).terms  # type: ignore[arg-type]
    assert terms is not None
    assert terms.nominal_force == pytest.approx(0.10 + 0.6 * (2.0 * np.pi / 4.0) ** 2 / 9.81, rel=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "rule"),
    [
        ("mu = [0.03, 0.06, 0.10], ", "", "space: lacks the variable 'mu'"),
        ("mu = [0.03,", "mu = [-0.03,", "space.liner.features.mu: must be positive for the dfp simulator, got -0.03"),
        ("rim_price = [", "mu = [", "space.rim.features.mu: 'mu' is already"),
        (
            "T_b = { value = 4.0, unit = ",
            "T_b = { choices = [3.0, 4.0], unit = ",
            "space.T_b.choices: a variable of the",
        ),
        (
            "T_b = { value = 4.0, unit = ",
            'T_b = { choices = ["A", "B"], unit = ',
            "use `step`, or `features` of another",
        ),
        ("T_b = { value = 4.0", "T_b = { value = 0.5", "cannot be built"),
    ],
)
def test_a_catalogue_that_is_no_bearing_is_refused(old: str, new: str, rule: str) -> None:
    text = CATALOGUE.read_text()
    assert text.count(old) == 1
    with pytest.raises(InputError) as refused:
        Campaign.of(parse_settings(text.replace(old, new), "catalogue"))
    assert rule in str(refused.value)


def test_property_bounds_lead_between_steps_but_not_between_choices() -> None:
    hazard = read_hazard(CATALOGUE.parent / "hazards" / "near_fault.toml")
    text = CATALOGUE.read_text()
    with pytest.raises(InputError, match="mu_lower: cannot be applied, because the campaign has mu as a feature of"):
        hazard.question(Campaign.of(parse_settings(text, "catalogue")).space, {})
    liner = next(line for line in text.splitlines() if line.startswith("liner"))
    space = Campaign.of(parse_settings(text.replace(liner, "mu = { low = 0.02, high = 0.12, step = 0.02 }"), "f")).space
    given = {"D_tot": 0.6, "rim": 1.0}
    between, beyond = (hazard.question(space, {**given, "mu": mu}).outside(space) for mu in (0.08, 0.02))
    assert between.share < 0.5
    assert beyond.share == 1.0
