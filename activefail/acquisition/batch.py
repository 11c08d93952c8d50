"""A batch of designs to simulate next: a criterion maximised over the physical variables, point after point."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.special import log_ndtr

from activefail.acquisition.criteria import LookAhead, Pointwise, bald
from activefail.acquisition.search import search
from activefail.features import FeatureMap
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier, Latent
from activefail.surrogate.sites import Sites

POOL = 4096
"""Designs of the Sobol' pool that is screened first; a power of two."""

SHORTLIST = 512
"""Designs whose joint posterior the batch is chosen from."""

REFERENCES = 1024
"""Designs of the Sobol' sample that stands for the design measure in a look-ahead criterion; a power of two."""

_BY_BALD, _AT_RANDOM = 768, 256
"""Designs of the pool that a look-ahead criterion is evaluated at: the best by BALD, and some of the others."""

_LAZY_BLOCK = 64
"""Candidates whose look-ahead value is brought up to date together."""

_REFINEMENTS = (0.05, 0.02, 0.008)
"""Standard deviations of the local searches around the best designs so far, in units of the variables' ranges."""

_NODES, _WEIGHTS = hermegauss(20)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def expected_site_precision(mean: float, sd: float) -> float:
    """λ = E_y E_f[−∂² log Φ(yf)/∂f²]: what one label at a point would add to the posterior's precision there.

    The label's probability is the predictive one, the latent's distribution the present one.
    """
    f = mean + sd * _NODES
    p = float(np.exp(log_ndtr(mean / np.sqrt(1.0 + sd**2))))
    total = 0.0
    for y, probability in ((1.0, p), (-1.0, 1.0 - p)):
        z = y * f
        ratio = np.exp(-0.5 * z * z - 0.5 * np.log(2.0 * np.pi) - log_ndtr(z))
        total += probability * float(ratio * (ratio + z) @ _WEIGHTS)
    return total


def _fantasise(mean: Array, covariance: Array, chosen: int) -> float:
    """Take a label of yet unknown value at `chosen` into the covariance, in place; returns its site's precision.

    The mean stays; Σ loses Σ_·* Σ_*·/(Σ_** + 1/λ*).
    """
    variance = float(covariance[chosen, chosen])
    precision = expected_site_precision(float(mean[chosen]), float(np.sqrt(max(variance, 0.0))))
    column = covariance[:, chosen].copy()
    covariance -= np.outer(column, column) / (variance + 1.0 / max(precision, 1e-300))
    return precision


def fantasised(latent: Latent, F: Array) -> Latent:
    """The latent as if labels of yet unknown values had been seen at scaled features F, (k, m), one after another.

    Each becomes a site of its own with the present mean as its pseudo-observation: all means stay, covariances shrink.
    """
    mean, covariance = latent.joint(F)
    covariance = covariance.copy()
    added = torch.tensor([_fantasise(mean, covariance, i) for i in range(len(F))], dtype=torch.float64)
    at = torch.from_numpy(mean)
    trained = latent.trained
    return Latent(
        replace(
            trained,
            features=torch.cat([trained.features, torch.from_numpy(F)]),
            labels=torch.cat([trained.labels, torch.where(at > 0.0, 1.0, -1.0).double()]),
            sites=Sites(torch.cat([trained.sites.linear, added * at]), torch.cat([trained.sites.precision, added])),
            elbo=float("nan"),
        )
    )


def greedy_batch(mean: Array, covariance: Array, q: int, criterion: Pointwise) -> NDArray[np.intp]:
    """Rows of q candidates, each the criterion's best given those before it.

    A chosen point is fantasised by its site: the mean stays, the covariance loses
    Σ_·* Σ_*·/(Σ_** + 1/λ*), as if a label of yet unknown value had been seen there.

    Args:
        mean: (n,) latent means of the candidates.
        covariance: (n, n) their joint covariance.
        q: how many to choose, at most n.
        criterion: (mean, sd) -> value, larger is better.
    """
    covariance = covariance.copy()
    chosen: list[int] = []
    for _ in range(q):
        sd = np.sqrt(np.clip(covariance.diagonal(), 0.0, None))
        value = criterion(mean, sd)
        value[chosen] = -np.inf
        best = int(np.argmax(value))
        chosen.append(best)
        _fantasise(mean, covariance, best)
    return np.array(chosen, dtype=np.intp)


def greedy_look_ahead(mean: Array, covariance: Array, n: int, q: int, criterion: LookAhead) -> NDArray[np.intp]:
    """Rows of q of the first n points, each the criterion's best given those before it; the others are references.

    Chosen points are fantasised as in `greedy_batch`. Values are brought up to date lazily (Minoux 1978): what a
    candidate was worth before a choice is taken for a bound of what it is worth after. Where few references depend on
    each other it is one; elsewhere a batch loses a per cent or so.

    Args:
        mean: (n + R,) latent means of candidates and references.
        covariance: (n + R, n + R) their joint covariance.
        n: how many of them are candidates.
        q: how many to choose, at most n.
        criterion: a look-ahead criterion.
    """
    covariance = covariance.copy()

    def evaluate(rows: NDArray[np.intp]) -> Array:
        sd = np.sqrt(np.clip(covariance.diagonal(), 0.0, None))
        return criterion.gain(mean[rows], sd[rows], mean[n:], sd[n:], covariance[rows, n:])

    value, current = evaluate(np.arange(n)), np.ones(n, dtype=bool)
    chosen: list[int] = []
    for _ in range(q):
        while not current[best := int(np.argmax(value))]:
            stale = np.where(current, -np.inf, value)
            block = np.argsort(-stale, kind="stable")[: min(_LAZY_BLOCK, n - int(current.sum()))]
            value[block] = evaluate(block)
            current[block] = True
        chosen.append(best)
        _fantasise(mean, covariance, best)
        current[:] = False
        value[chosen], current[chosen] = -np.inf, True
    return np.array(chosen, dtype=np.intp)


def propose(
    latent: Latent,
    features: FeatureMap,
    space: DesignSpace,
    criterion: Pointwise | LookAhead,
    q: int,
    rng: np.random.Generator,
    pending: Array | None = None,
    failed: Array | None = None,
) -> Array:
    """q designs, (q, d), where one more label is worth most for the latent's boundary.

    A Sobol' pool over the design space is screened; the best of it are improved by local random searches, which need
    neither gradients nor smooth features; the batch is chosen greedily from the best of all.

    Args:
        pending: (k, d) designs in flight, whose labels are not known yet: fantasised by their sites before.
        failed: (k, d) designs that were simulated and have no label: not proposed again.
    """
    if pending is not None and len(pending) > 0:
        latent = fantasised(latent, features(pending))
    if isinstance(criterion, LookAhead):
        # Its candidates are drawn anew for each batch: none of them is one of before.
        return _propose_ahead(latent, features, space, criterion, q, rng)
    return _propose_pointwise(latent, features, space, criterion, q, rng, failed)


def _propose_pointwise(
    latent: Latent,
    features: FeatureMap,
    space: DesignSpace,
    criterion: Pointwise,
    q: int,
    rng: np.random.Generator,
    failed: Array | None,
) -> Array:
    pool = space.sobol(POOL, rng)
    values = criterion(*latent.moments(features(pool)))
    for spread in _REFINEMENTS:
        best = np.argsort(-values, kind="stable")[:SHORTLIST]
        unit = space.to_unit(pool[best])
        moved = space.from_unit(np.clip(unit + spread * rng.standard_normal(unit.shape), 0.0, 1.0))
        moved_values = criterion(*latent.moments(features(moved)))
        # A search from each start replaces its start: the shortlist stays spread over the whole boundary.
        improved = moved_values > values[best]
        pool = np.where(improved[:, None], moved, pool[best])
        values = np.where(improved, moved_values, values[best])
    F = features(pool)
    new = _not_seen(pool, F, latent, failed)
    if len(new) < q:
        # All searches ended at a few corners that are known: elsewhere, then.
        pool = np.concatenate([pool[new], space.sobol(POOL, rng)])
        F = features(pool)
        new = _not_seen(pool, F, latent, failed)[:SHORTLIST]
    if len(new) < q:
        # Features with few values, all of them known: another design with the same ones tells how sure they are.
        others = np.setdiff1d(np.arange(len(pool)), new)
        failures = set() if failed is None else {row.tobytes() for row in failed}
        new = np.concatenate([new, [row for row in others if pool[row].tobytes() not in failures][: q - len(new)]])
        new = new.astype(np.intp)
    pool, F = pool[new], F[new]
    mean, covariance = latent.joint(F)
    return np.asarray(pool[greedy_batch(mean, covariance, q, criterion)])


def _not_seen(X: Array, F: Array, latent: Latent, failed: Array | None) -> NDArray[np.intp]:
    """Rows of designs X, (n, d), of features F, (n, m), not among the latent's points, failed designs or rows before.

    A search may end in a corner where a design has been simulated or is in flight: a second time would tell nothing.
    """
    seen = {row.tobytes() for row in latent.trained.features.numpy()}
    # By the design itself: what fails may hang on a variable that the features leave out.
    failures = set() if failed is None else {row.tobytes() for row in failed}
    rows = []
    for row, (design, feature) in enumerate(zip(X, F, strict=True)):
        content = feature.tobytes()
        if content not in seen and design.tobytes() not in failures:
            rows.append(row)
            seen.add(content)
    return np.array(rows, dtype=np.intp)


def _propose_ahead(
    latent: Latent, features: FeatureMap, space: DesignSpace, criterion: LookAhead, q: int, rng: np.random.Generator
) -> Array:
    pool = space.sobol(POOL, rng)
    # Not by entropy, which passes over the wide latents that the look-ahead criteria like best.
    order = np.argsort(-bald(*latent.moments(features(pool))), kind="stable")
    others = rng.choice(order[_BY_BALD:], _AT_RANDOM, replace=False)
    candidates = pool[np.concatenate([order[:_BY_BALD], others])]
    references = space.sobol(REFERENCES, rng)
    mean, covariance = latent.joint(features(np.concatenate([candidates, references])))
    n = len(candidates)
    return np.asarray(candidates[greedy_look_ahead(mean, covariance, n, min(q, n), criterion)])


def apportion(shares: Sequence[float], first: int, q: int) -> list[int]:
    """How many of the designs number `first` to `first` + q − 1 fall to each claimant.

    Each design goes to the claimant whose share is furthest behind, the earlier one of equals: what a batch is too
    small to divide is carried over to the next, and the same designs always fall to the same claimants.

    Args:
        shares: not negative, of sum 1.
        first: designs given out before.
    """
    given = np.zeros(len(shares))
    claimants = np.empty(first + q, dtype=np.intp)
    for number in range(first + q):
        # Rounded: equal claims must tie, whatever the last bits of their sums.
        claimants[number] = np.argmax(np.round(np.multiply(shares, number + 1) - given, 9))
        given[claimants[number]] += 1.0
    return [int(n) for n in np.bincount(claimants[first:], minlength=len(shares))]


SEARCH_SHARE = 0.2
"""Share of the designs that search for an outcome that was never seen, where the sought boundaries can be learned."""


@dataclass(frozen=True)
class Search:
    """What a search for outcomes that were never seen needs to know.

    Attributes:
        known: (n, d) designs that were simulated, with and without an answer.
        outcomes: those that no simulation ended in.
    """

    known: Array
    outcomes: tuple[str, ...]


def propose_shared(
    classifier: Classifier,
    space: DesignSpace,
    criterion: Pointwise | LookAhead,
    boundaries: Mapping[str, float],
    exploration: float,
    first: int,
    q: int,
    rng: np.random.Generator,
    pending: Array | None = None,
    failed: Array | None = None,
    unseen: Search | None = None,
) -> Array:
    """q designs, (q, d), shared out between exploration, the search for unseen outcomes and the boundaries.

    First those for exploration, a Latin hypercube of the design space, then those that search, then those for one
    boundary after the other. A simulation teaches all boundaries: the designs chosen before are pending for those that
    follow. Of a boundary only one side of which was ever seen there is nothing to learn: its designs search as well.

    Args:
        boundaries: outcome -> its share of what is neither exploration nor search; of sum 1.
        exploration: share of the designs that no classifier has a say in, 0 to 1.
        first: designs that were proposed in batches before this one.
        pending, failed: as for `propose`.
        unseen: the outcomes to search for; None where all were seen.
    """
    searching = SEARCH_SHARE if unseen is not None else 0.0
    learned = (1.0 - exploration) * (1.0 - searching)
    shares = [exploration, (1.0 - exploration) * searching, *(learned * share for share in boundaries.values())]
    one_sided = [unseen is not None and _is_one_sided(classifier.latent(outcome)) for outcome in boundaries]
    searches = np.array([False, True, *one_sided])
    before, now = np.array(apportion(shares, 0, first)), np.array(apportion(shares, first, q))
    explored, searched, counts = int(now[0]), int(now[searches].sum()), now[2:].tolist()
    chosen = space.latin_hypercube(explored, rng) if explored else np.empty((0, space.dimension))
    if unseen is not None and searched:
        in_flight = [unseen.known, chosen] if pending is None else [unseen.known, pending, chosen]
        number = int(before[searches].sum())
        chosen = np.concatenate([chosen, search(space, np.concatenate(in_flight), number, searched, rng)])
    for outcome, count, of_one_side in zip(boundaries, counts, one_sided, strict=True):
        if count and not of_one_side:
            known = chosen if pending is None else np.concatenate([pending, chosen])
            latent = classifier.latent(outcome)
            more = propose(latent, classifier.features, space, criterion, count, rng, known, failed)
            chosen = np.concatenate([chosen, more])
    return chosen


def _is_one_sided(latent: Latent) -> bool:
    labels = latent.trained.labels
    return bool((labels == labels[0]).all())
