from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from activefail.acquisition import batch_proposal
from activefail.acquisition.batch_proposal import (
    SEARCH_SHARE,
    Search,
    apportion,
    expected_site_precision,
    fantasised,
    greedy_batch,
    greedy_look_ahead,
    propose,
    propose_shared,
)
from activefail.acquisition.criteria import LookAhead, bald, criterion, entropy, globalmi
from activefail.features import feature_map
from activefail.parameter import Parameter
from activefail.space import DesignSpace
from activefail.surrogate.classifier import train

SPACE = DesignSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))


@pytest.fixture(autouse=True)
def few_references(monkeypatch):
    """In two variables fewer are enough."""
    monkeypatch.setattr(batch_proposal, "REFERENCES", 256)


def beyond(X):
    return (np.hypot(X[:, 0] - 0.3, X[:, 1] - 0.4) < 0.35).astype(np.int8)


@pytest.fixture(scope="module")
def learned():
    X = SPACE.latin_hypercube(60, np.random.default_rng(0))
    return train(X, beyond(X), ("out", "in"), feature_map("design", SPACE), "rbf")


def test_the_expected_precision_of_a_label_is_that_of_sampling():
    rng = np.random.default_rng(0)
    for mean, sd in [(0.0, 1.0), (1.5, 0.4), (-2.0, 2.0)]:
        f = mean + sd * rng.standard_normal(400_000)
        y = np.where(rng.uniform(size=f.size) < norm.cdf(mean / np.sqrt(1 + sd**2)), 1.0, -1.0)
        ratio = np.exp(norm.logpdf(f) - norm.logcdf(y * f))
        assert expected_site_precision(mean, sd) == pytest.approx(np.mean(ratio * (ratio + y * f)), rel=0.02)


def test_the_first_of_a_batch_is_the_criterions_best():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((30, 30))
    mean, covariance = rng.standard_normal(30), A @ A.T / 30
    first = greedy_batch(mean, covariance, 1, bald)[0]
    assert first == np.argmax(bald(mean, np.sqrt(covariance.diagonal())))


def test_the_second_of_a_batch_is_best_under_exact_conditioning_on_the_first():
    rng = np.random.default_rng(2)
    A = rng.standard_normal((25, 25))
    mean, covariance = 0.2 * rng.standard_normal(25), A @ A.T / 25
    first, second = greedy_batch(mean, covariance, 2, bald)
    noise = 1.0 / expected_site_precision(mean[first], np.sqrt(covariance[first, first]))
    # Conditioning by the precision matrix instead of the rank-one downdate.
    precision = np.linalg.inv(covariance + 1e-12 * np.eye(25))
    precision[first, first] += 1.0 / noise
    value = bald(mean, np.sqrt(np.linalg.inv(precision).diagonal()))
    value[first] = -np.inf
    assert second == np.argmax(value)


def test_a_batch_holds_no_design_twice_even_where_all_are_alike():
    mean, covariance = np.zeros(8), np.ones((8, 8))
    assert sorted(greedy_batch(mean, covariance, 8, entropy)) == list(range(8))


def nearest(X):
    distance = np.linalg.norm(X[:, None] - X[None], axis=2)
    return np.min(distance + np.diag(np.full(len(X), np.inf)), axis=1)


def test_a_batch_does_not_pile_up(learned):
    latent, features = learned.latent("in"), learned.features
    designs = propose(latent, features, SPACE, bald, 8, np.random.default_rng(3))
    pool = SPACE.sobol(4096, np.random.default_rng(4))
    greediest = pool[np.argsort(-bald(*latent.moments(features(pool))))[:8]]
    assert np.median(nearest(designs)) > 3.0 * np.median(nearest(greediest))


def test_a_batch_by_entropy_is_spread_along_the_boundary(learned):
    designs = propose(learned.latent("in"), learned.features, SPACE, entropy, 8, np.random.default_rng(3))
    # Eight random points of a curve of length L have their nearest neighbour at about L/16; a pile has it at once.
    assert np.mean(nearest(designs)) > 0.3 * (2.0 * np.pi * 0.35 / 16.0)


def test_proposals_lie_in_the_space_and_near_the_learned_boundary(learned):
    designs = propose(learned.latent("in"), learned.features, SPACE, entropy, 10, np.random.default_rng(5))
    assert designs.shape == (10, 2)
    assert SPACE.contains(designs).all()
    moments = learned.latent("in").moments(learned.features(designs))
    fresh = learned.latent("in").moments(learned.features(SPACE.sobol(4096, np.random.default_rng(6))))
    assert np.abs(moments.mean).max() < np.quantile(np.abs(fresh.mean), 0.05)


def test_the_refinement_never_makes_the_best_design_worse(learned):
    latent, features = learned.latent("in"), learned.features
    rng = np.random.default_rng(7)
    pool = SPACE.sobol(4096, np.random.default_rng(7))
    best = propose(latent, features, SPACE, bald, 1, rng)
    assert bald(*latent.moments(features(best)))[0] >= bald(*latent.moments(features(pool))).max() - 1e-9


# --- looking ahead -----------------------------------------------------------------------------------------------


def joint(n, references, seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n + references, 8))
    return 0.7 * rng.standard_normal(n + references), A @ A.T / 4.0 + 0.02 * np.eye(n + references)


def gains(mean, covariance, n, name):
    sd = np.sqrt(covariance.diagonal())
    return criterion(name).gain(mean[:n], sd[:n], mean[n:], sd[n:], covariance[:n, n:])


@pytest.mark.parametrize("name", ["eavc", "globalmi", "sur"])
def test_the_second_choice_that_looks_ahead_is_best_under_exact_conditioning_on_the_first(name):
    n = 40
    mean, covariance = joint(n, 30, seed=3)
    first, second = greedy_look_ahead(mean, covariance, n, 2, criterion(name))
    assert first == np.argmax(gains(mean, covariance, n, name))
    precision = np.linalg.inv(covariance)
    precision[first, first] += expected_site_precision(mean[first], np.sqrt(covariance[first, first]))
    value = gains(mean, np.linalg.inv(precision), n, name)
    value[first] = -np.inf
    assert second == np.argmax(value)


@pytest.mark.parametrize("name", ["eavc", "globalmi", "sur"])
def test_bringing_values_up_to_date_lazily_loses_next_to_nothing(name, monkeypatch):
    n = 300
    mean, covariance = joint(n, 100, seed=4)

    def worth(chosen):
        after, total = covariance.copy(), 0.0
        for row in chosen:
            total += gains(mean, after, n, name)[row]
            batch_proposal.fantasise(mean, after, row)
        return total

    monkeypatch.setattr(batch_proposal, "LAZY_BLOCK", 20)
    lazy = greedy_look_ahead(mean, covariance, n, 12, criterion(name))
    monkeypatch.setattr(batch_proposal, "LAZY_BLOCK", n)
    always = greedy_look_ahead(mean, covariance, n, 12, criterion(name))
    # Eight factors drive all 400 points here: after a choice many candidates are worth more than before.
    assert worth(lazy) > 0.97 * worth(always)
    assert len(set(lazy.tolist())) == 12


def expected_information(latent, features, designs, references):
    """GlobalMI of designs as a batch, each after those before it."""
    total = 0.0
    for i in range(len(designs)):
        given = latent if i == 0 else fantasised(latent, features(designs[:i]))
        mean, covariance = given.joint(features(np.concatenate([designs[i : i + 1], references])))
        total += gains(mean, covariance, 1, "globalmi")[0]
    return total


def test_a_batch_by_global_information_tells_more_of_the_whole_space_than_one_by_entropy(learned):
    latent, features = learned.latent("in"), learned.features
    references = SPACE.sobol(512, np.random.default_rng(11))
    ahead, greedy = (
        expected_information(
            latent, features, propose(latent, features, SPACE, c, 4, np.random.default_rng(12)), references
        )
        for c in (LookAhead(globalmi), entropy)
    )
    assert ahead > 1.2 * greedy


@pytest.mark.parametrize("name", ["entropy", "u", "straddle", "bald", "eavc", "globalmi", "sur"])
def test_every_criterion_proposes_distinct_designs_of_the_space_and_the_same_ones_again(learned, name):
    first, repeated = (
        propose(learned.latent("in"), learned.features, SPACE, criterion(name), 5, np.random.default_rng(8))
        for _ in range(2)
    )
    assert np.array_equal(first, repeated)
    assert first.shape == (5, 2)
    assert SPACE.contains(first).all()
    assert len(np.unique(first, axis=0)) == 5


# --- designs in flight -------------------------------------------------------------------------------------------


def test_a_fantasy_keeps_the_mean_and_conditions_the_covariance_on_noisy_observations(learned):
    latent, features = learned.latent("in"), learned.features
    rng = np.random.default_rng(13)
    pending, elsewhere = features(rng.random((6, 2))), features(rng.random((20, 2)))
    mean, covariance = latent.joint(np.concatenate([pending, elsewhere]))
    after_mean, after = fantasised(latent, pending).joint(np.concatenate([pending, elsewhere]))
    assert after_mean == pytest.approx(mean, abs=1e-6)
    # Textbook conditioning, with the noise of each site: the precision that its label adds after those before it.
    exact, noise = covariance, []
    for i in range(6):
        noise.append(1.0 / expected_site_precision(mean[i], np.sqrt(exact[i, i])))
        gain = np.linalg.solve(covariance[: i + 1, : i + 1] + np.diag(noise), covariance[: i + 1])
        exact = covariance - covariance[:, : i + 1] @ gain
    assert after == pytest.approx(exact, abs=1e-4)
    assert (np.diag(after)[:6] < 0.9 * np.diag(covariance)[:6]).any()


def test_fantasies_one_after_the_other_are_the_fantasies_at_once(learned):
    latent, features = learned.latent("in"), learned.features
    F = features(np.random.default_rng(14).random((5, 2)))
    at_once, in_turn = fantasised(latent, F), fantasised(fantasised(latent, F[:2]), F[2:])
    elsewhere = features(SPACE.sobol(64, np.random.default_rng(15)))
    assert at_once.moments(elsewhere).sd == pytest.approx(in_turn.moments(elsewhere).sd, rel=1e-5)


@pytest.mark.parametrize("name", ["bald", "straddle", "eavc", "globalmi"])
def test_designs_in_flight_are_not_proposed_again(learned, name):
    latent, features = learned.latent("in"), learned.features

    def proposed(pending):
        return propose(latent, features, SPACE, criterion(name), 4, np.random.default_rng(16), pending=pending)

    def gap(X, Y):
        return np.linalg.norm(X[:, None] - Y[None], axis=2).min(axis=1).mean()

    first = proposed(None)
    assert gap(proposed(None), first) == 0.0
    assert gap(proposed(first), first) > 0.05


# --- shares ------------------------------------------------------------------------------------------------------


weights = st.lists(st.floats(0.01, 1.0), min_size=1, max_size=4).map(lambda w: [x / sum(w) for x in w])


@given(shares=weights, sizes=st.lists(st.integers(1, 12), min_size=1, max_size=20))
def test_batches_of_any_sizes_add_up_to_the_shares_to_within_a_design(shares, sizes):
    given_out, first = np.zeros(len(shares)), 0
    for q in sizes:
        counts = apportion(shares, first, q)
        assert sum(counts) == q
        given_out, first = given_out + counts, first + q
    assert given_out.tolist() == apportion(shares, 0, first)
    assert np.abs(given_out - np.multiply(shares, first)).max() < len(shares) - 0.99 or len(shares) == 1


@pytest.fixture(scope="module")
def nested():
    """Two boundaries, far apart: the discs of radius 0.4 and 0.15."""
    X = SPACE.latin_hypercube(120, np.random.default_rng(0))
    distance = np.hypot(X[:, 0] - 0.5, X[:, 1] - 0.5)
    outcome = (distance < 0.4).astype(np.int8) + (distance < 0.15).astype(np.int8)
    return train(X, outcome, ("out", "ring", "core"), feature_map("design", SPACE), "rbf")


def shared(classifier, boundaries, q, seed, criterion=entropy, **options):
    """`propose_shared` from the seed, without exploration, as in the first batch unless the options say otherwise."""
    options = {"exploration": 0.0, "first": 0} | options
    rng = np.random.default_rng(seed)
    return propose_shared(classifier, SPACE, criterion, boundaries=boundaries, q=q, rng=rng, **options)


@pytest.mark.parametrize("name", ["entropy", "globalmi"])
def test_designs_are_shared_between_the_boundaries_by_their_weights(nested, name):
    designs = shared(nested, {"core": 0.25, "ring": 0.75}, 12, 1, criterion(name))
    distance = np.hypot(*(designs - 0.5).T)
    assert np.count_nonzero(distance < 0.275) == 3
    assert np.abs(distance[distance > 0.275] - 0.4).max() < 0.12


def test_one_boundary_without_exploration_is_what_propose_gives(nested):
    designs = shared(nested, {"core": 1.0}, 6, 2, first=30)
    alone = propose(nested.latent("core"), nested.features, SPACE, entropy, 6, np.random.default_rng(2))
    assert np.array_equal(designs, alone)


def test_exploration_is_a_latin_hypercube_of_its_share(nested):
    designs = shared(nested, {"core": 1.0}, 10, 3, exploration=0.5)
    strata = np.sort(np.floor(5 * SPACE.to_unit(designs[:5])), axis=0)
    assert np.array_equal(strata, np.column_stack([np.arange(5), np.arange(5)]))
    assert np.abs(np.hypot(*(designs[5:] - 0.5).T) - 0.15).max() < 0.1


def test_designs_for_one_boundary_are_in_flight_for_the_next(nested):
    pending = np.array([[0.5, 0.9]])
    calls = []

    def spy(latent, features, space, criterion, q, rng, *, pending, **options):
        calls.append((q, pending))
        return np.full((q, 2), 0.1 * len(calls))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch_proposal, "propose", spy)
        designs = shared(nested, {"core": 0.5, "ring": 0.5}, 4, 4, pending=pending)
    assert [q for q, _ in calls] == [2, 2]
    assert np.array_equal(calls[0][1], pending)
    assert np.array_equal(calls[1][1], np.concatenate([pending, designs[:2]]))


def test_a_design_that_was_simulated_or_is_in_flight_is_not_proposed_again(monkeypatch):
    corners = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    X = np.concatenate([corners[:2], [[0.5, 0.5], [0.45, 0.5]]])
    few = train(X, np.array([0, 0, 0, 1], dtype=np.int8), ("out", "in"), feature_map("design", SPACE), "rbf")

    def chosen(q):
        rng = np.random.default_rng(3)
        rows = propose(few.latent("in"), few.features, SPACE, criterion("entropy"), q, rng, pending=corners[2:])
        return [row.tobytes() for row in rows]

    known = {row.tobytes() for row in (*X, *corners)}
    for q in (1, 6, 40):
        assert len(set(chosen(q))) == q
        assert not known & set(chosen(q))
    # The searches do end in corners: nothing else keeps these from being proposed.
    monkeypatch.setattr(batch_proposal, "new_rows", lambda X, F, latent, failed: np.arange(len(F)))
    assert known & set(chosen(40))


def test_a_design_that_failed_is_not_proposed_again():
    X = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.5], [0.45, 0.5]])
    few = train(X, np.array([0, 0, 0, 1], dtype=np.int8), ("out", "in"), feature_map("design", SPACE), "rbf")

    def chosen(failed):
        return {row.tobytes() for row in shared(few, {"in": 1.0}, 40, 3, failed=failed)}

    corners = np.array([[0.0, 1.0], [1.0, 1.0]])
    # The searches end there.
    assert {row.tobytes() for row in corners} <= chosen(None)
    assert chosen(np.empty((0, 2))) == chosen(None)
    spared = chosen(corners)
    assert len(spared) == 40
    assert not {row.tobytes() for row in corners} & spared


@pytest.mark.parametrize("q", [1, 5, 10])
@pytest.mark.parametrize("known_side", ["both", "one"])
def test_designs_that_search_take_turns_in_their_widths_whatever_the_size_of_a_batch(
    learned, monkeypatch, q, known_side
):
    numbers = []

    def noted(space, known, first, count, rng):
        numbers.extend(range(first, first + count))
        return space.latin_hypercube(count, rng)

    monkeypatch.setattr(batch_proposal, "search", noted)
    X = SPACE.latin_hypercube(20, np.random.default_rng(0))
    classifier = learned
    if known_side == "one":
        classifier = train(X, np.zeros(20, dtype=np.int8), ("out", "in"), feature_map("design", SPACE), "rbf")
    for first in range(0, 40, q):
        designs = shared(classifier, {"in": 1.0}, q, first, first=first, unseen=Search(X, ("in",)))
        assert designs.shape == (q, 2)
    # One after the other, without a gap: the widths take turns by these numbers.
    assert numbers == list(range(40 if known_side == "one" else round(40 * SEARCH_SHARE)))


@dataclass(frozen=True)
class Storeys:
    """Features with ten values, as a number of storeys has."""

    names = ("storeys",)

    def __call__(self, X):
        return np.round(9.0 * X[:, :1])


def test_where_all_values_of_the_features_are_known_other_designs_with_them_are_proposed():
    X = SPACE.sobol(64, np.random.default_rng(0))
    few = train(X, (X[:, 0] > 0.5).astype(np.int8), ("out", "in"), Storeys(), "rbf")
    failed = SPACE.sobol(8, np.random.default_rng(1))
    for name in ("entropy", "globalmi"):
        designs = propose(
            few.latent("in"), few.features, SPACE, criterion(name), 12, np.random.default_rng(2), failed=failed
        )
        assert designs.shape == (12, 2)
        assert len(np.unique(designs, axis=0)) == 12
        assert not {row.tobytes() for row in designs} & {row.tobytes() for row in (*X, *failed)}


def test_a_widened_proposal_reaches_a_boundary_of_which_the_design_measure_has_no_candidates():
    space = DesignSpace(tuple(Parameter(v, -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for v in ("x", "y")))
    # Labels far out: the boundary lies between 4 and 5 standard deviations, near -y as far as any label says.
    X = np.array([[0.0, 0.0], [4.0, 0.0], [5.0, 0.0], [5.2, 1.0], [-3.0, 0.5], [1.0, -4.0], [0.5, 3.0]])
    beyond = (X[:, 0] > 4.5).astype(np.int8)
    learned = train(X, beyond, ("out", "in"), feature_map("design", space), "rbf")

    def proposed(widening):
        return propose(
            learned.latent("in"),
            learned.features,
            space,
            criterion("eavc"),
            8,
            np.random.default_rng(2),
            widening=widening,
        )

    plain, wide = proposed(1.0), proposed(2.0)
    assert space.contains(wide).all()
    assert np.linalg.norm(wide, axis=1).max() > np.linalg.norm(plain, axis=1).max()
    assert np.abs(wide).max() > 4.2
