"""Proposal of a batch: an acquisition function is maximised over the physical variables, one design at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.models.model import Model
from numpy.typing import NDArray
from torch import Tensor

from activefail.errors import InputError
from activefail.learning.criteria.by_margin import candidates_by_margin
from activefail.learning.criteria.criteria import Choosing, Make, PointwiseCriterion, bald
from activefail.learning.criteria.unseen_search import search
from activefail.learning.features import FeatureMap
from activefail.learning.model.boundary_gp import fantasised, keeping
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.moments import LARGEST_FEATURE
from activefail.learning.model.system import AnyLatent, ByMargins
from activefail.space.space import Array, DesignSpace

POOL = 4096
"""Designs in the Sobol' pool of candidates; a power of two."""

SHORTLIST = 512
"""Designs from which the batch is chosen."""

_BY_BALD, _AT_RANDOM = 768, 256
"""Designs of the pool at which a look-ahead criterion is evaluated: the best by BALD, and a random part of the rest."""

LAZY_BLOCK = 64
"""Candidates whose values are updated together."""

_REFINEMENTS = (0.05, 0.02, 0.008)
"""Standard deviations of the local searches around the best designs so far, in units of the variables' ranges."""

_SWAPPED = 0.25
"""Share of the choices that a local search draws again."""

Answers = Callable[[Array], Array]
"""Scaled features, (n, m) -> probability of a result, (n,)."""


def _weighted(value: Tensor, answers: Tensor | None, is_gain: bool) -> Tensor:
    """Values that count as much as an answer is probable, (n,).

    Negative gains count as nothing. Values that are never positive are ranked by Φ(value).
    """
    if answers is None:
        return value
    return (value.clamp_min(0.0) if is_gain else torch.special.ndtr(value)) * answers


@torch.no_grad()
def values(acquisition: AcquisitionFunction, F: Tensor, answers: Tensor | None = None) -> Tensor:
    """Values of an acquisition function at features, (n, m) -> (n,), which count as much as an answer is probable."""
    value = _checked(acquisition(F.unsqueeze(-2)), len(F))
    return _weighted(value, answers, bool(value.max() > 0.0))


def _checked(value: Tensor, n: int) -> Tensor:
    """Values of a criterion, (n,).

    Raises:
        InputError: if they are no n finite numbers: a custom criterion may be anything.
    """
    if not isinstance(value, Tensor) or value.shape != (n,) or not torch.isfinite(value).all():
        got = f"a tensor {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
        raise InputError(f"acquisition.criterion: must be a tensor ({n},) of finite values for {n} designs, got {got}.")
    return value


@torch.no_grad()
def best_batch(
    make: Callable[[Model], AcquisitionFunction],
    model: Model,
    F: Tensor,
    q: int,
    answers: Tensor | None = None,
    block: int | None = None,
) -> NDArray[np.intp]:
    """Rows of q candidates, features F (n, m), each the best given the ones before it.

    The model is fantasised at a chosen point: means stay, covariances shrink as after an unknown label there.

    Args:
        make: makes the acquisition function of a model.
        model: of the latent.
        F: the candidates.
        q: number of candidates to choose, at most n.
        answers: (n,) probabilities of a result; all are certain if None.
        block: candidates whose values are updated together, lazily [Minoux1978]: a candidate's value before a choice is
            taken as a bound of its value afterwards. This holds where references are nearly independent; elsewhere a
            batch loses about one per cent. All are updated after each choice if None.
    """
    acquired = _checked(make(model)(F.unsqueeze(-2)), len(F))
    is_gain = bool(acquired.max() > 0.0)
    value, current = _weighted(acquired, answers, is_gain).clone(), torch.ones(len(F), dtype=torch.bool)
    chosen: list[int] = []
    for _ in range(q):
        if chosen:
            model = fantasised(model, F[chosen[-1:]])
            acquisition = make(model)
        while not current[best := int(value.argmax())]:
            if block is None:
                rows, some = torch.arange(len(F)), F
            else:
                rows = torch.where(current, -torch.inf, value).topk(min(block, int((~current).sum()))).indices
                some = F[rows]
            updated = _checked(acquisition(some.unsqueeze(-2)), len(some))
            value[rows] = _weighted(updated, None if answers is None else answers[rows], is_gain)
            current[rows] = True
            value[chosen] = -torch.inf
        chosen.append(best)
        current[:] = False
        value[chosen], current[chosen] = -torch.inf, True
    return np.array(chosen, dtype=np.intp)


def propose(
    latent: AnyLatent,
    features: FeatureMap,
    space: DesignSpace,
    criterion: Choosing,
    q: int,
    rng: np.random.Generator,
    *,
    pending: Array | None = None,
    failed: Array | None = None,
    widening: float = 1.0,
    answers: Answers | None = None,
    repeatable: bool = True,
) -> Array:
    """q designs, (q, d), where a label, or a margin, is most valuable for the latent's boundary.

    The criterion is evaluated on a Sobol' pool over the design space. Local random searches, which need neither
    gradients nor smooth features, improve the best designs. The batch is chosen greedily from the results.

    A boundary that is learned from a margin has its own criterion (`by_margin`).

    Args:
        pending: (k, d) designs in flight, which are fantasised first.
        failed: (k, d) designs whose simulation was a numerical failure; they are not proposed again.
        widening: factor that stretches the normal variables of candidates and references, for a boundary that lies
            where the design measure has few designs.
        answers: probability of a result at scaled features; all are certain if None.
        repeatable: whether equal designs have equal results; otherwise known designs may be chosen again.
    """
    by_margin = isinstance(latent, ByMargins) and not criterion.is_custom
    model, sample = latent.model, _Sample(space, rng, widening)

    def scaled(X: Array) -> Array:
        return np.clip(features(X), -LARGEST_FEATURE, LARGEST_FEATURE)

    known = [X for X in ((pending, failed) if by_margin else (pending,)) if X is not None and len(X)]
    for X in known:
        model = fantasised(model, torch.from_numpy(scaled(X)))

    def certain(F: Array) -> Tensor | None:
        return None if answers is None else torch.from_numpy(answers(F))

    seen = np.concatenate([latent.features, *map(scaled, known)])[: None if repeatable else 0]
    if by_margin:
        X, references, make = candidates_by_margin(model, features, space, q, rng)
        F, block = scaled(X), None
    elif criterion.references:
        # It draws new candidates for each batch, so none is an earlier design.
        X, F = _candidates_by_bald(model, scaled, sample, certain)
        references, make, block = torch.from_numpy(scaled(sample(criterion.references))), criterion.make, LAZY_BLOCK
    else:
        X, F = _candidates_by_search(model, scaled, sample, criterion.make, q, seen, failed, certain)
        references, make, block = torch.empty(0, F.shape[1], dtype=torch.float64), criterion.make, None
    if space.design_count < np.inf and len(new := new_rows(X, F, seen, failed)):
        X, F = X[new], F[new]
    candidates = torch.from_numpy(F)
    with keeping(model, candidates, references):
        rows = best_batch(lambda model: make(model, references), model, candidates, min(q, len(F)), certain(F), block)
    return np.asarray(X[rows])


@dataclass(frozen=True)
class _Sample:
    """Draws designs of a Sobol' sequence, with the normal variables stretched."""

    space: DesignSpace
    rng: np.random.Generator
    widening: float

    def __call__(self, n: int) -> Array:
        """n designs, (n, d)."""
        X = self.space.sobol(n, self.rng)
        if self.widening == 1.0:
            return X
        wide = self.space.widened(X, self.widening)
        return np.where(self.space.meets_constraints(wide)[:, None], wide, X)


def _candidates_by_search(
    model: Model,
    features: Callable[[Array], Array],
    sample: _Sample,
    make: Make,
    q: int,
    known: Array,
    failed: Array | None,
    certain: Callable[[Array], Tensor | None],
) -> tuple[Array, Array]:
    """Candidates, (n, d), and their features, (n, m): the best of a pool, improved by random searches around each.

    They repeat none of the `known` features, (l, m), unless there are no others.
    """
    acquisition = make(model, torch.empty(0, known.shape[1], dtype=torch.float64))

    def value(X: Array) -> Array:
        F = features(X)
        return np.asarray(values(acquisition, torch.from_numpy(F), certain(F)).numpy())

    space, rng, pool = sample.space, sample.rng, sample(POOL)
    of_pool = value(pool)
    for spread in _REFINEMENTS:
        best = np.argsort(-of_pool, kind="stable")[:SHORTLIST]
        unit = space.to_unit(pool[best])
        moved = space.from_unit(np.clip(unit + spread * rng.standard_normal(unit.shape), 0.0, 1.0))
        moved = space.swapped(moved, _SWAPPED, rng)
        moved = np.where(space.meets_constraints(moved)[:, None], moved, pool[best])
        of_moved = value(moved)
        # Each search replaces its own start, so that the shortlist stays spread over the whole boundary.
        improved = of_moved > of_pool[best]
        pool = np.where(improved[:, None], moved, pool[best])
        of_pool = np.where(improved, of_moved, of_pool[best])
    F = features(pool)
    new = new_rows(pool, F, known, failed)
    if len(new) < q:
        # The searches ended at a few known corners; add other candidates.
        pool = np.concatenate([pool[new], sample(POOL)])
        F = features(pool)
        new = new_rows(pool, F, known, failed)[:SHORTLIST]
    if len(new) < q:
        # All values of discrete features are known; repeating some still adds information.
        others = np.setdiff1d(np.arange(len(pool)), new)
        failures = set() if failed is None else {row.tobytes() for row in failed}
        new = np.concatenate([new, [row for row in others if pool[row].tobytes() not in failures][: q - len(new)]])
        new = new.astype(np.intp)
    return pool[new], F[new]


def new_rows(X: Array, F: Array, known: Array, failed: Array | None) -> NDArray[np.intp]:
    """Rows of designs X, (n, d), with features F, (n, m), that repeat no known features, (l, m), failed design
    or earlier row.

    A search may end in a corner where a design was simulated or is in flight; repeating it would add nothing.
    """
    seen = {row.tobytes() for row in known}
    # Failures are compared by design: they may depend on a variable that the features omit.
    failures = set() if failed is None else {row.tobytes() for row in failed}
    rows = []
    for row, (design, feature) in enumerate(zip(X, F, strict=True)):
        content = feature.tobytes()
        if content not in seen and design.tobytes() not in failures:
            rows.append(row)
            seen.add(content)
    return np.array(rows, dtype=np.intp)


def _candidates_by_bald(
    model: Model, features: Callable[[Array], Array], sample: _Sample, certain: Callable[[Array], Tensor | None]
) -> tuple[Array, Array]:
    """Candidates, (n, d), and their features, (n, m): the best of a pool by BALD, and some of the others.

    Not by entropy, which ignores the wide latents that look-ahead criteria prefer.
    """
    pool = sample(POOL)
    F = features(pool)
    value = values(PointwiseCriterion(model, bald), torch.from_numpy(F), certain(F)).numpy()
    order = np.argsort(-value, kind="stable")
    rows = np.concatenate([order[:_BY_BALD], sample.rng.choice(order[_BY_BALD:], _AT_RANDOM, replace=False)])
    return pool[rows], F[rows]


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
    criterion: Choosing,
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
                repeatable=classifier.repeatable,
            )
            chosen = np.concatenate([chosen, proposed])
    return chosen
