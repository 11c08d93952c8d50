"""Proposal of a batch: a criterion is maximised over the physical variables, one design at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from activefail.acquisition.by_margin import propose_by_margin
from activefail.acquisition.criteria import LookAhead, Pointwise, bald
from activefail.acquisition.unseen_search import search
from activefail.features import FeatureMap
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier, Latent
from activefail.surrogate.margin import MarginLatent
from activefail.surrogate.sites import Sites

POOL = 4096
"""Designs in the Sobol' pool of candidates; a power of two."""

SHORTLIST = 512
"""Designs from whose joint posterior the batch is chosen."""

REFERENCES = 1024
"""Designs in the Sobol' sample that represents the design measure in a look-ahead criterion; a power of two."""

_BY_BALD, _AT_RANDOM = 768, 256
"""Designs of the pool at which a look-ahead criterion is evaluated: the best by BALD, and a random part of the rest."""

LAZY_BLOCK = 64
"""Candidates whose look-ahead values are updated together."""

_REFINEMENTS = (0.05, 0.02, 0.008)
"""Standard deviations of the local searches around the best designs so far, in units of the variables' ranges."""

Answers = Callable[[Array], Array]
"""Scaled features, (n, m) -> probability of a result, (n,)."""

_NODES, _WEIGHTS = hermegauss(20)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def expected_site_precision(mean: float, sd: float) -> float:
    """λ = E_y E_f[−∂² log Φ(yf)/∂f²]: the expected gain in the posterior's precision at a point from a label there.

    The label has its predictive probability, the latent its present distribution.
    """
    f = mean + sd * _NODES
    p = float(np.exp(log_ndtr(mean / np.sqrt(1.0 + sd**2))))
    total = 0.0
    for y, probability in ((1.0, p), (-1.0, 1.0 - p)):
        z = y * f
        ratio = np.exp(-0.5 * z * z - 0.5 * np.log(2.0 * np.pi) - log_ndtr(z))
        total += probability * float(ratio * (ratio + z) @ _WEIGHTS)
    return total


def fantasise(mean: Array, covariance: Array, chosen: int) -> float:
    """Update the covariance, in place, for an unknown label at `chosen`; returns the precision of its site.

    The mean does not change; Σ loses Σ_·* Σ_*·/(Σ_** + 1/λ*).
    """
    variance = float(covariance[chosen, chosen])
    precision = expected_site_precision(float(mean[chosen]), float(np.sqrt(max(variance, 0.0))))
    column = covariance[:, chosen].copy()
    covariance -= np.outer(column, column) / (variance + 1.0 / max(precision, 1e-300))
    return precision


def fantasised(latent: Latent, F: Array) -> Latent:
    """The latent after unknown labels at scaled features F, (k, m), one after another.

    Each label becomes a site with the present mean as pseudo-observation: means do not change, covariances shrink.
    """
    mean, covariance = latent.joint(F)
    covariance = covariance.copy()
    added = torch.tensor([fantasise(mean, covariance, i) for i in range(len(F))], dtype=torch.float64)
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


def weighted(criterion: Pointwise, answers: Array | None) -> Pointwise:
    """A criterion whose values count as much as an answer is probable, (n,); the criterion itself if all are certain.

    Values that are never positive are ranked by Φ(value); of the others, negative ones count as nothing.
    """
    if answers is None:
        return criterion

    def of(mean: Array, sd: Array) -> Array:
        value = criterion(mean, sd)
        return np.asarray((np.maximum(value, 0.0) if value.max() > 0.0 else ndtr(value)) * answers)

    return of


def greedy_batch(mean: Array, covariance: Array, q: int, criterion: Pointwise) -> NDArray[np.intp]:
    """Rows of q candidates, each the criterion's best given the ones before it.

    A chosen point is fantasised: the mean does not change, the covariance loses Σ_·* Σ_*·/(Σ_** + 1/λ*), as after an
    unknown label there.

    Args:
        mean: (n,) latent means of the candidates.
        covariance: (n, n) their joint covariance.
        q: number of candidates to choose, at most n.
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
        fantasise(mean, covariance, best)
    return np.array(chosen, dtype=np.intp)


def greedy_look_ahead(
    mean: Array, covariance: Array, n: int, q: int, criterion: LookAhead, answers: Array | None = None
) -> NDArray[np.intp]:
    """Rows of q of the first n points, each the criterion's best given the ones before it; the others are references.

    Chosen points are fantasised as in `greedy_batch`. Values are updated lazily [Minoux1978]: a candidate's value
    before a choice is taken as a bound of its value afterwards. This holds where references are nearly independent;
    elsewhere a batch loses about one per cent.

    Args:
        mean: (n + R,) latent means of candidates and references.
        covariance: (n + R, n + R) their joint covariance.
        n: number of candidates.
        q: number of candidates to choose, at most n.
        criterion: a look-ahead criterion.
        answers: (n,) probabilities of a result; all are certain if None.
    """
    covariance = covariance.copy()

    def evaluate(rows: NDArray[np.intp]) -> Array:
        sd = np.sqrt(np.clip(covariance.diagonal(), 0.0, None))
        gain: Array = criterion.gain(mean[rows], sd[rows], mean[n:], sd[n:], covariance[rows, n:])
        return gain if answers is None else gain * answers[rows]

    value, current = evaluate(np.arange(n)), np.ones(n, dtype=bool)
    chosen: list[int] = []
    for _ in range(q):
        while not current[best := int(np.argmax(value))]:
            stale = np.where(current, -np.inf, value)
            block = np.argsort(-stale, kind="stable")[: min(LAZY_BLOCK, n - int(current.sum()))]
            value[block] = evaluate(block)
            current[block] = True
        chosen.append(best)
        fantasise(mean, covariance, best)
        current[:] = False
        value[chosen], current[chosen] = -np.inf, True
    return np.array(chosen, dtype=np.intp)


def propose(
    latent: Latent | MarginLatent,
    features: FeatureMap,
    space: DesignSpace,
    criterion: Pointwise | LookAhead,
    q: int,
    rng: np.random.Generator,
    *,
    pending: Array | None = None,
    failed: Array | None = None,
    widening: float = 1.0,
    answers: Answers | None = None,
) -> Array:
    """q designs, (q, d), where a label, or a margin, is most valuable for the latent's boundary.

    The criterion is evaluated on a Sobol' pool over the design space. Local random searches, which need neither
    gradients nor smooth features, improve the best designs. The batch is chosen greedily from the results.

    A boundary that is learned from a margin has its own criterion (`propose_by_margin`).

    Args:
        pending: (k, d) designs in flight, which are fantasised first.
        failed: (k, d) designs whose simulation was a numerical failure; they are not proposed again.
        widening: factor that stretches the normal variables of candidates and references, for a boundary that lies
            where the design measure has few designs.
        answers: probability of a result at scaled features; all are certain if None.
    """
    if isinstance(latent, MarginLatent):
        return propose_by_margin(latent, features, space, q, rng, pending=pending, failed=failed, answers=answers)
    if pending is not None and len(pending) > 0:
        latent = fantasised(latent, features(pending))
    if isinstance(criterion, LookAhead):
        # It draws new candidates for each batch, so none is an earlier design.
        return _propose_ahead(latent, features, space, criterion, q, rng, widening, answers)
    return _propose_pointwise(latent, features, space, criterion, q, rng, failed, widening, answers)


def _sample(space: DesignSpace, n: int, rng: np.random.Generator, widening: float) -> Array:
    """n designs of a Sobol' sequence, (n, d), with the normal variables stretched."""
    X = space.sobol(n, rng)
    return X if widening == 1.0 else space.widened(X, widening)


def _propose_pointwise(
    latent: Latent,
    features: FeatureMap,
    space: DesignSpace,
    criterion: Pointwise,
    q: int,
    rng: np.random.Generator,
    failed: Array | None,
    widening: float,
    answers: Answers | None,
) -> Array:
    def value(F: Array) -> Array:
        return np.asarray(weighted(criterion, None if answers is None else answers(F))(*latent.moments(F)))

    pool = _sample(space, POOL, rng, widening)
    values = value(features(pool))
    for spread in _REFINEMENTS:
        best = np.argsort(-values, kind="stable")[:SHORTLIST]
        unit = space.to_unit(pool[best])
        moved = space.from_unit(np.clip(unit + spread * rng.standard_normal(unit.shape), 0.0, 1.0))
        moved_values = value(features(moved))
        # Each search replaces its own start, so that the shortlist stays spread over the whole boundary.
        improved = moved_values > values[best]
        pool = np.where(improved[:, None], moved, pool[best])
        values = np.where(improved, moved_values, values[best])
    F = features(pool)
    new = new_rows(pool, F, latent, failed)
    if len(new) < q:
        # The searches ended at a few known corners; add other candidates.
        pool = np.concatenate([pool[new], _sample(space, POOL, rng, widening)])
        F = features(pool)
        new = new_rows(pool, F, latent, failed)[:SHORTLIST]
    if len(new) < q:
        # All values of discrete features are known; repeating some still adds information.
        others = np.setdiff1d(np.arange(len(pool)), new)
        failures = set() if failed is None else {row.tobytes() for row in failed}
        new = np.concatenate([new, [row for row in others if pool[row].tobytes() not in failures][: q - len(new)]])
        new = new.astype(np.intp)
    pool, F = pool[new], F[new]
    mean, covariance = latent.joint(F)
    of_batch = weighted(criterion, None if answers is None else answers(F))
    return np.asarray(pool[greedy_batch(mean, covariance, q, of_batch)])


def new_rows(X: Array, F: Array, latent: Latent, failed: Array | None) -> NDArray[np.intp]:
    """Rows of designs X, (n, d), with features F, (n, m), that repeat no training point, failed design or earlier row.

    A search may end in a corner where a design was simulated or is in flight; repeating it would add nothing.
    """
    seen = {row.tobytes() for row in latent.trained.features.numpy()}
    # Failures are compared by design: they may depend on a variable that the features omit.
    failures = set() if failed is None else {row.tobytes() for row in failed}
    rows = []
    for row, (design, feature) in enumerate(zip(X, F, strict=True)):
        content = feature.tobytes()
        if content not in seen and design.tobytes() not in failures:
            rows.append(row)
            seen.add(content)
    return np.array(rows, dtype=np.intp)


def _propose_ahead(
    latent: Latent,
    features: FeatureMap,
    space: DesignSpace,
    criterion: LookAhead,
    q: int,
    rng: np.random.Generator,
    widening: float,
    answers: Answers | None,
) -> Array:
    pool = _sample(space, POOL, rng, widening)
    # Not by entropy, which ignores the wide latents that look-ahead criteria prefer.
    F = features(pool)
    order = np.argsort(-weighted(bald, None if answers is None else answers(F))(*latent.moments(F)), kind="stable")
    others = rng.choice(order[_BY_BALD:], _AT_RANDOM, replace=False)
    candidates = pool[np.concatenate([order[:_BY_BALD], others])]
    references = _sample(space, REFERENCES, rng, widening)
    mean, covariance = latent.joint(features(np.concatenate([candidates, references])))
    n = len(candidates)
    certain = None if answers is None else answers(features(candidates))
    return np.asarray(candidates[greedy_look_ahead(mean, covariance, n, min(q, n), criterion, certain)])


def apportion(shares: Sequence[float], first: int, q: int) -> list[int]:
    """How many of the designs `first` to `first` + q − 1 each claimant gets.

    Each design goes to the claimant that is furthest behind its share, the first in a tie. So remainders carry over to
    the next batch, and each design's claimant does not depend on the batch size.

    Args:
        shares: not negative, with sum 1.
        first: number of designs assigned before.
    """
    if max(shares) == 1.0:
        return [q if share == 1.0 else 0 for share in shares]
    assigned, now = [0] * len(shares), [0] * len(shares)
    for number in range(first + q):
        # Rounded, so that equal claims tie despite rounding errors of their sums.
        claims = [round((share * (number + 1) - n) * 1e9) for share, n in zip(shares, assigned, strict=True)]
        claimant = claims.index(max(claims))
        assigned[claimant] += 1
        now[claimant] += number >= first
    return now


SEARCH_SHARE = 0.2
"""Share of the designs that search for unseen outcomes while other boundaries can be learned."""


@dataclass(frozen=True)
class Search:
    """The input of a search for unseen outcomes.

    Attributes:
        known: (n, d) simulated designs, including numerical failures.
        outcomes: outcomes of no simulation yet.
    """

    known: Array
    outcomes: tuple[str, ...]


def propose_shared(
    classifier: Classifier,
    space: DesignSpace,
    criterion: Pointwise | LookAhead,
    *,
    boundaries: Mapping[str, float],
    exploration: float,
    first: int,
    q: int,
    rng: np.random.Generator,
    pending: Array | None = None,
    failed: Array | None = None,
    unseen: Search | None = None,
    widening: float = 1.0,
) -> Array:
    """q designs, (q, d), divided among exploration, the search for unseen outcomes, and the boundaries.

    Exploration designs, a Latin hypercube of the design space, come first, then search designs, then the designs of
    each boundary. Every simulation informs all boundaries, so designs chosen earlier are pending for later ones. A
    boundary with labels of one side only cannot be learned: its designs search too.

    Args:
        boundaries: outcome -> its share of the designs that neither explore nor search; with sum 1.
        exploration: share of the designs chosen without a classifier, 0 to 1.
        first: number of designs proposed in earlier batches.
        pending, failed, widening: as for `propose`.
        unseen: the outcomes to search for; None if all were seen.
    """
    searching = SEARCH_SHARE if unseen is not None else 0.0
    learned = (1.0 - exploration) * (1.0 - searching)
    shares = [exploration, (1.0 - exploration) * searching, *(learned * share for share in boundaries.values())]
    one_sided = [unseen is not None and classifier.latent(outcome).is_one_sided for outcome in boundaries]
    searches = np.array([False, True, *one_sided])
    before, now = np.array(apportion(shares, 0, first)), np.array(apportion(shares, first, q))
    n_explore, n_search, counts = int(now[0]), int(now[searches].sum()), now[2:].tolist()
    chosen = space.latin_hypercube(n_explore, rng) if n_explore else np.empty((0, space.dimension))
    if unseen is not None and n_search:
        known = [unseen.known, chosen] if pending is None else [unseen.known, pending, chosen]
        number = int(before[searches].sum())
        chosen = np.concatenate([chosen, search(space, np.concatenate(known), number, n_search, rng)])
    for outcome, count, is_one_sided in zip(boundaries, counts, one_sided, strict=True):
        if count and not is_one_sided:
            in_flight = chosen if pending is None else np.concatenate([pending, chosen])
            latent = classifier.latent(outcome)
            proposed = propose(
                latent,
                classifier.features,
                space,
                criterion,
                count,
                rng,
                pending=in_flight,
                failed=failed,
                widening=widening,
                answers=classifier.answers if classifier.loses else None,
            )
            chosen = np.concatenate([chosen, proposed])
    return chosen
