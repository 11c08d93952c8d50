from dataclasses import dataclass
from typing import get_args

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from surrogate.labelled import RBF

from activefail.learning.criteria import batch_proposal, criteria
from activefail.learning.criteria.batch_proposal import (
    SEARCH_SHARE,
    Search,
    apportion,
    best_batch,
    propose,
    propose_shared,
    values,
)
from activefail.learning.criteria.criteria import criterion
from activefail.learning.features import feature_map
from activefail.learning.model.boundary_gp import fantasised
from activefail.learning.model.likelihoods import expected_precision
from activefail.learning.model.training import train
from activefail.learning.names import Criterion
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SPACE = DesignSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))
FEATURES = feature_map("design", SPACE)
BALD, ENTROPY = criterion("bald"), criterion("entropy")


@pytest.fixture(autouse=True)
def few_references(monkeypatch):
    """In two variables fewer are enough."""
    monkeypatch.setattr(criteria, "REFERENCES", 256)


def learned_from(X, beyond):
    return train(X, beyond.astype(np.int8), ("out", "in"), FEATURES, RBF)


@pytest.fixture(scope="module")
def learned():
    X = SPACE.latin_hypercube(60, np.random.default_rng(0))
    return learned_from(X, np.hypot(X[:, 0] - 0.3, X[:, 1] - 0.4) < 0.35)


def drawn(n, seed):
    """Scaled features of random designs."""
    return torch.from_numpy(FEATURES(np.random.default_rng(seed).random((n, 2))))


def on(name, references):
    """Makes the named acquisition function of a model, as a batch is chosen by it."""
    return lambda model: criterion(name).make(model, references)


@pytest.mark.parametrize("name", ["bald", "eavc", "globalmi", "sur"])
def test_the_second_of_a_batch_is_best_under_exact_conditioning_on_the_first(learned, name):
    model, F, references = learned.latent("in").model, drawn(40, 2), drawn(30, 3)
    first, second = best_batch(on(name, references), model, F, 2)
    assert first == int(values(on(name, references)(model), F).argmax())
    mean, covariance = (of.numpy() for of in model.joint(torch.cat([F, references])))
    # Conditioning by the precision matrix instead of a downdate.
    precision = np.linalg.inv(covariance)
    precision[first, first] += float(expected_precision(model.likelihood, *model.joint(F[[first]])))
    after = np.linalg.inv(precision)
    sd = np.sqrt(after.diagonal())
    at_references = (mean[40:], sd[40:], after[:40, 40:]) if criterion(name).references else ()
    arrays = mean[:40], sd[:40], *at_references
    value = getattr(criteria, name)(*(torch.from_numpy(array) for array in arrays)).numpy()
    value[first] = -np.inf
    assert second == np.argmax(value)


def test_a_batch_holds_no_design_twice_even_where_all_are_alike(learned):
    F = torch.zeros(8, 2, dtype=torch.float64)
    assert sorted(best_batch(on("entropy", F), learned.latent("in").model, F, 8)) == list(range(8))


def nearest(X):
    distance = np.linalg.norm(X[:, None] - X[None], axis=2)
    return np.min(distance + np.diag(np.full(len(X), np.inf)), axis=1)


def bald(latent, X):
    return values(on("bald", None)(latent.model), torch.from_numpy(FEATURES(X))).numpy()


def test_a_batch_does_not_pile_up(learned):
    latent, features = learned.latent("in"), learned.features
    designs = propose(latent, features, SPACE, BALD, 8, np.random.default_rng(3))
    pool = SPACE.sobol(4096, np.random.default_rng(4))
    greediest = pool[np.argsort(-bald(latent, pool))[:8]]
    assert np.median(nearest(designs)) > 3.0 * np.median(nearest(greediest))


@pytest.mark.parametrize("name", ["entropy", "joint_entropy"])
def test_a_batch_by_entropy_is_spread_along_the_boundary(learned, name):
    designs = propose(learned.latent("in"), learned.features, SPACE, criterion(name), 8, np.random.default_rng(3))
    # Eight random points of a curve of length L have their nearest neighbour at about L/16; a pile has it at once.
    assert np.mean(nearest(designs)) > 0.3 * (2.0 * np.pi * 0.35 / 16.0)


def test_a_batch_by_joint_entropy_begins_as_one_by_entropy_and_holds_no_near_copies_even_of_labels_that_are_noise():
    X = SPACE.latin_hypercube(30, np.random.default_rng(2))
    noisy = learned_from(X, np.random.default_rng(3).random(30) < 0.5).latent("in")

    def batch(name, q):
        return propose(noisy, FEATURES, SPACE, criterion(name), q, np.random.default_rng(4))

    assert batch("joint_entropy", 1).tobytes() == batch("entropy", 1).tobytes()
    assert batch("joint_entropy", 8)[0].tobytes() == batch("entropy", 1)[0].tobytes()
    assert nearest(batch("joint_entropy", 8)).min() > 0.05 > 0.01 > nearest(batch("entropy", 8)).min()


def test_a_batch_by_joint_entropy_counts_the_entropy_that_exact_values_of_the_earlier_designs_leave(learned):
    model, F = learned.latent("in").model, drawn(40, 2)
    chosen = best_batch(on("joint_entropy", None), model, F, 3)
    covariance = model.joint(F)[1].numpy()
    earlier = chosen[:2]
    explained = covariance[:, earlier] @ np.linalg.solve(covariance[np.ix_(earlier, earlier)], covariance[earlier])
    left = np.maximum(1.0 - explained.diagonal() / covariance.diagonal(), 1e-9)
    after = fantasised(fantasised(model, F[earlier[:1]]), F[earlier[1:]])
    z = criteria.entropy(*after.moments(F)).numpy()
    value = criteria._SHARED * np.log(left) - z**2 / (np.pi * np.log(2.0))
    value[earlier] = -np.inf
    assert chosen[2] == np.argmax(value)


def test_proposals_lie_in_the_space_and_near_the_learned_boundary(learned):
    designs = propose(learned.latent("in"), learned.features, SPACE, ENTROPY, 10, np.random.default_rng(5))
    assert designs.shape == (10, 2)
    assert SPACE.contains(designs).all()
    moments = learned.latent("in").moments(learned.features(designs))
    fresh = learned.latent("in").moments(learned.features(SPACE.sobol(4096, np.random.default_rng(6))))
    assert np.abs(moments.mean).max() < np.quantile(np.abs(fresh.mean), 0.05)


def test_the_refinement_never_makes_the_best_design_worse(learned):
    latent, features = learned.latent("in"), learned.features
    rng = np.random.default_rng(7)
    pool = SPACE.sobol(4096, np.random.default_rng(7))
    best = propose(latent, features, SPACE, BALD, 1, rng)
    assert bald(latent, best)[0] >= bald(latent, pool).max() - 1e-9


# --- looking ahead -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["eavc", "globalmi", "sur"])
def test_bringing_values_up_to_date_lazily_loses_next_to_nothing(learned, name):
    model, F, references = learned.latent("in").model, drawn(300, 4), drawn(100, 5)

    def worth(chosen):
        given, total = model, 0.0
        for row in chosen:
            total += float(values(on(name, references)(given), F[[row]]))
            given = fantasised(given, F[[row]])
        return total

    lazy, always = (best_batch(on(name, references), model, F, 12, block=block) for block in (20, None))
    assert worth(lazy) > 0.97 * worth(always)
    assert len(set(lazy.tolist())) == 12


def expected_information(latent, designs, references):
    """GlobalMI of designs as a batch, each after those before it."""
    model, total = latent.model, 0.0
    for F in torch.from_numpy(FEATURES(designs)).split(1):
        total += float(values(on("globalmi", references)(model), F))
        model = fantasised(model, F)
    return total


def test_a_batch_by_global_information_tells_more_of_the_whole_space_than_one_by_entropy(learned):
    latent, features = learned.latent("in"), learned.features
    references = torch.from_numpy(features(SPACE.sobol(512, np.random.default_rng(11))))
    ahead, greedy = (
        expected_information(latent, propose(latent, features, SPACE, c, 4, np.random.default_rng(12)), references)
        for c in (criterion("globalmi"), ENTROPY)
    )
    assert ahead > 1.2 * greedy


@pytest.mark.parametrize("name", get_args(Criterion))
def test_every_criterion_proposes_distinct_designs_of_the_space_and_the_same_ones_again(learned, name):
    first, repeated = (
        propose(learned.latent("in"), learned.features, SPACE, criterion(name), 5, np.random.default_rng(8))
        for _ in range(2)
    )
    assert np.array_equal(first, repeated)
    assert first.shape == (5, 2)
    assert SPACE.contains(first).all()
    assert len(np.unique(first, axis=0)) == 5


@pytest.mark.parametrize("name", ["joint_entropy", "bald", "straddle", "eavc", "globalmi"])
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
    return train(X, outcome, ("out", "ring", "core"), FEATURES, RBF)


def shared(classifier, boundaries, q, seed, criterion=ENTROPY, **options):
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
    alone = propose(nested.latent("core"), nested.features, SPACE, ENTROPY, 6, np.random.default_rng(2))
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
    few = learned_from(X, np.array([0, 0, 0, 1]))

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
    few = learned_from(X, np.array([0, 0, 0, 1]))

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
        classifier = learned_from(X, np.zeros(20))
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

    to_learn = __call__


def test_where_all_values_of_the_features_are_known_other_designs_with_them_are_proposed():
    X = SPACE.sobol(64, np.random.default_rng(0))
    few = train(X, (X[:, 0] > 0.5).astype(np.int8), ("out", "in"), Storeys(), RBF)
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
    learned = train(X, beyond, ("out", "in"), feature_map("design", space), RBF)

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
