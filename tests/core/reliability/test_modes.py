"""The shares of a system's modes in its failures, from fresh simulations."""

import numpy as np
import pytest
from scipy.special import ndtr

from activefail.estimates import modes
from activefail.estimates.estimate import deviation_of_margins, plan_estimate
from activefail.estimates.integral import boundary_of
from activefail.estimates.modes import Events, corrected_modes, counted_modes
from activefail.learning.criteria.population import population
from activefail.learning.features import feature_map
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.training import fit_system
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace
from activefail.space.systems import parse_system
from activefail.space.weighted import WeightedRows

SPACE = DesignSpace(tuple(Parameter(name, -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for name in ("x", "y")))
FEATURES = feature_map("design", SPACE)
SYSTEM = parse_system("min(a, max(b, c))", ["a", "b", "c"])


def margins(X):
    x, y = X.T
    return np.column_stack([3.0 - x + 0.2 * np.sin(3.0 * y), 2.4 - y - 0.1 * x**2, 1.0 + x - 0.3 * y])


@pytest.fixture(scope="module")
def truth():
    drawn = population(SPACE, 400_000, None, np.random.default_rng(9))
    events = Events.of(SYSTEM, margins(drawn.X))
    system, failed, decisive = (drawn.weight @ of for of in events)
    return np.array([failed / system, decisive / system])


def fresh(learned: int, m: int, seed: int):
    """Fresh simulations of a system of which few designs are known."""
    X = np.clip(2.0 * SPACE.latin_hypercube(learned, np.random.default_rng(seed)), -6.4, 6.4)
    latent, rng = fit_system(FEATURES(X), margins(X), SYSTEM), np.random.default_rng([seed, 1])
    standardised = boundary_of(Classifier(("safe", "failure"), FEATURES, (latent,)), FEATURES, "failure")
    plan = plan_estimate(standardised, SPACE, m, rng)
    of = margins(plan.designs)
    plan = plan.deviating(deviation_of_margins(latent, FEATURES, plan.designs, of))
    return plan, of, corrected_modes(SYSTEM, plan, of, lambda X: latent.sides(FEATURES(X)), SPACE, rng)


def numbers(found) -> np.ndarray:
    """(2, k, 3)."""
    return np.array([[mode.failed for mode in found], [mode.decisive for mode in found]])


def test_the_events_have_the_probabilities_of_independent_modes() -> None:
    z = np.array([[-1.0, 0.5, 0.2], [-2.0, -0.3, 1.0]])
    draws = (np.random.default_rng(0).random((200_000, 2, 3)) < ndtr(z)).astype(float)
    for row in range(2):
        seen, expected = Events.of(SYSTEM, 0.5 - draws[:, row]), Events.expected(SYSTEM, z)
        for of, probability in zip(seen, expected, strict=True):
            np.testing.assert_allclose(of.mean(axis=0), probability[row], atol=0.004)


def test_the_shares_are_those_of_the_system(truth, monkeypatch) -> None:
    monkeypatch.setattr(modes, "_ROUNDS", 4)
    found = numbers(fresh(25, 60, 0)[2].shares(0.9))
    np.testing.assert_allclose(found[..., 0], truth, atol=0.03)
    assert (found[..., 1] <= truth + 1e-3).all()
    assert (truth - 1e-3 <= found[..., 2]).all()


def test_shares_that_are_counted_have_wider_intervals(truth, monkeypatch) -> None:
    monkeypatch.setattr(modes, "_ROUNDS", 4)
    hold = 0
    for seed in range(4):
        plan, of, corrected = fresh(25, 200, seed)
        of_counts, of_regressions = (numbers(one.shares(0.9)) for one in (counted_modes(SYSTEM, plan, of), corrected))
        hold += ((of_counts[..., 1] <= truth) & (truth <= of_counts[..., 2])).all()
        assert (np.diff(of_counts[..., 1:]) > np.diff(of_regressions[..., 1:])).all()
    assert hold >= 3  # six nominal 90 % intervals each


def test_the_intervals_of_counted_shares_cover_though_a_mode_is_rare() -> None:
    square = DesignSpace(tuple(Parameter(name, 0.0, 1.0) for name in ("x", "y")))
    system = parse_system("min(a, b, c)", ["a", "b", "c"])

    def limit(X):
        return np.column_stack([X - 0.1, 1.83 - X.sum(axis=1)])

    beyond = np.array([0.1, 0.1, 0.5 * 0.17**2])
    share, covered = beyond / (beyond.sum() - 0.1 * 0.1), []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        plan = plan_estimate(lambda X: -system(limit(X)) / 0.01, square, 50, rng)
        found = numbers(counted_modes(system, plan, limit(plan.designs)).shares(0.9))[0]
        covered.append((found[:, 1] <= share) & (share <= found[:, 2]))
    # Nominal 54 of 60; fewer than 50 have a chance of 3 %.
    assert (np.sum(covered, axis=0) >= 50).all()


def test_shares_are_exact_where_all_rows_were_simulated() -> None:
    X = np.random.default_rng(0).normal(size=(40, 2))
    rows = WeightedRows(("x", "y"), X, np.r_[60.0, np.ones(39)])
    plan = plan_estimate(lambda X: X[:, 0] - 1.0, rows, 50, np.random.default_rng(0))
    system = parse_system("min(a, b)", ["a", "b"])
    (of_a, _) = counted_modes(system, plan, plan.designs).shares(0.9)
    fails, failed = ((X < 0.0).any(axis=1), X[:, 0] < 0.0)
    assert of_a.failed == pytest.approx(3 * (rows.weight @ failed / (rows.weight @ fails),))


def test_without_a_failure_there_are_no_shares() -> None:
    plan = plan_estimate(lambda X: X[:, 0] - 3.0, SPACE, 10, np.random.default_rng(0))
    assert counted_modes(SYSTEM, plan, np.ones((10, 3))).shares(0.9) == ()


@pytest.mark.exhaustive
def test_the_intervals_of_shares_cover_though_few_designs_were_learned(truth, monkeypatch) -> None:
    monkeypatch.setattr(modes, "_ROUNDS", 4)
    found = np.array([numbers(fresh(14, 50, seed)[2].shares(0.9)) for seed in range(20)])
    covered = (found[..., 1] <= truth + 1e-3) & (truth - 1e-3 <= found[..., 2])
    assert covered.mean() >= 0.85
