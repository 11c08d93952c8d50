"""Searches for the cheapest design that meets its targets, such as the smallest D_tot, and verifies it."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit

from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.design.design_task import LOOKS, DesignTask, confidence_of_bound
from activefail.analyses.stripes.findings import StripeFindings
from activefail.analyses.stripes.stripe import Stripe
from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.estimates.confidence_bounds import upper_bound
from activefail.estimates.estimate import ProbabilityEstimate
from activefail.estimates.probability_estimator import Estimator, Sampled
from activefail.space.space import Array
from activefail.text.progress import Stage, silent

_GRID, _FINE_GRID = 13, 97
"""Values of the first free variable at which a line is scanned; and scanned again, with few points of an integral, if
none of these meets the aims."""

_COARSE_GRID, _COARSER = 7, 4
"""The same, and divisor of the points of an integral, while other free variables are searched."""

_SAMPLED, _REFINED = 16, 30
"""Lines that begin the search over each further free variable, and most lines of its refinement."""

_FINE_LINES, _APART = 6, 0.02
"""Best lines of a search that are judged again with all points, and their least distance in units of the ranges."""

_FAR = math.log(2.0)
"""Excess (`_excess`) by few points of an integral from which more points do not make a design feasible."""

_FINE = 2e-4
"""Accuracy of the first free variable, in units of its range."""

_IMAGINED = LOOKS + 1
"""Number of the sample of pulses that predicts the width of an interval and is not simulated."""

_LEAST = 1e-12
"""Least probability whose logarithm is taken."""

_HALVES, _OFF, _LEAST_AIM = 1.3, 0.025, 0.2
"""Distance of an aim from its target: half widths of the interval, which are wider where the classifier errs more than
it expects, and a share of the target, for the classifier's own error; and least aim over its target."""

_TRUSTED, _LARGEST = 0.5, 0.95
"""Largest error of the classifier at a look, over its distance from the target at the nearest design, both in log odds,
with which it is believed that no design meets the target; and largest probability that counts."""

WORTH, _ROOM = 0.05, 0.02
"""Least share of the cost that a smaller design must promise to save for a further look; and share of the cost that all
simulations that are left must save for more of them than a look of fewer."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A design that may meet the requirements.

    Attributes:
        values: of the free variables.
        model: (r,) the classifier's probabilities.
        is_feasible: whether these meet the aims; if not, no design does and this one comes nearest.
        ranges: (low, high) of the first free variable where they do, the others held; between and beyond these ranges
            they do not.
        compared: number of designs that this one was chosen from, where these are finitely many; 0 otherwise.
    """

    values: Mapping[str, float]
    model: Array
    is_feasible: bool
    ranges: tuple[tuple[float, float], ...] = ()
    compared: int = 0


Answer = ProbabilityEstimate | StripeFindings
"""A probability with its interval, from fresh simulations or a stripe."""


@dataclass(frozen=True, eq=False)
class Look:
    """Simulations of a candidate: fresh ones, or stripes."""

    candidate: Candidate
    sampled: tuple[Sampled, ...] | tuple[Stripe, ...]  # (r,) of each requirement
    of_bound: float  # confidence of each bound of the intervals
    size: int = 0  # fresh simulations that it asked for, of each requirement

    @cached_property
    def estimates(self) -> tuple[Answer, ...]:
        """The probability of each requirement's outcome."""
        return self.estimates_of(2.0 * self.of_bound - 1.0)

    def estimates_of(self, confidence: float) -> tuple[Answer, ...]:
        """The same with intervals of another confidence."""
        return tuple(
            StripeFindings(one, confidence) if isinstance(one, Stripe) else one.estimate(confidence)
            for one in self.sampled
        )

    @property
    def simulations(self) -> int:
        """Simulations of this look."""
        return sum(estimate.simulations for estimate in self.estimates)

    @property
    def surprising(self) -> int:
        """Fresh simulations that contradict the classifier where it was sure, by four standard deviations."""
        return sum(estimate.surprising for estimate in self.estimates)

    def ratios(self, targets: Array) -> Array:
        """The probabilities over their targets, (r,) each."""
        return np.array([estimate.probability for estimate in self.estimates]) / targets

    def above(self, targets: Array) -> NDArray[np.bool_]:
        """Whether even the lower bounds exceed their targets, (r,) each."""
        return np.array([estimate.low for estimate in self.estimates]) > targets


def verifies(estimates: Sequence[Answer], targets: Sequence[float]) -> bool:
    """Whether a look verifies a design: the rule of "verified".

    All upper bounds meet their targets, and no simulation contradicts the classifier where it was sure.

    Args:
        estimates, targets: (r,) from one look, and the largest acceptable probabilities.
    """
    meets = all(estimate.high <= target for estimate, target in zip(estimates, targets, strict=True))
    return meets and not any(estimate.surprising for estimate in estimates)


@dataclass(frozen=True, eq=False)
class Designed:
    """The result of a search for a design.

    Attributes:
        task: what was asked.
        looks: at candidates, in the order in which they were proposed.
        number: of the look at the result, from 1 on: the cheapest verified design; or else the last look, or the safest
            if no design meets the targets by the classifier, and simulations show that the nearest exceeds one.
        status: "verified"; "not verified" if every look's upper bound exceeded a target, or a simulation contradicted
            the classifier where it was sure; "out of reach" if no design meets the targets by the classifier, and
            simulations show that those at all ends of the ranges exceed a target. By stripes "met", or "out of reach".
    """

    task: DesignTask
    looks: tuple[Look, ...]
    number: int
    status: Literal["verified", "not verified", "out of reach", "met"]

    @property
    def result(self) -> Look:
        """The look at the result."""
        return self.looks[self.number - 1]

    @property
    def by_stripes(self) -> bool:
        """Whether stripes were simulated."""
        return not isinstance(self.result.sampled[0], Sampled)

    @property
    def values(self) -> Mapping[str, float]:
        """The values of the free variables."""
        return self.result.candidate.values

    @property
    def question(self) -> Question:
        """The distribution of the variables at the result."""
        return self.task.question.at(self.values)

    @property
    def simulations(self) -> int:
        """All simulations of this search."""
        return sum(look.simulations for look in self.looks)

    @property
    def missable(self) -> float:
        """Largest share of the distribution that may fail unseen where the classifier is sure; 0 if all of it is known.

        The confidence is that of the result's bound.
        """
        surest = [one.plan.surest for one in self.result.sampled if isinstance(one, Sampled)]
        shares = (share * upper_bound(0, count, self.result.of_bound) for count, share in surest)
        return min(1.0, max(shares, default=0.0))

    @property
    def at_limit(self) -> dict[str, str]:
        """Free variables whose value is a limit of their range, and which limit."""
        return _sides(self.task, self.values)

    @property
    def is_above(self) -> bool:
        """Whether even the lower bound of the result exceeds a target."""
        return bool(self.result.above(self.task.targets).any())


def _sides(task: DesignTask, values: Mapping[str, float]) -> dict[str, str]:
    """The free variables, but choices, whose value is a limit of their range, and which limit."""
    sides = {}
    for name, value in values.items():
        if name in task.choices:
            continue
        near = 2.0 * _FINE * (task.high[name] - task.low[name])
        if value <= task.low[name] + near:
            sides[name] = "lower"
        elif value >= task.high[name] - near:
            sides[name] = "upper"
    return sides


Model = Callable[[Mapping[str, float], int], Array]
"""The classifier's probability of each requirement's outcome, (r,), at values of the free variables, by some points."""


def _has_designs(task: DesignTask, values: Mapping[str, float]) -> bool:
    """Whether values of the free variables leave designs that meet the constraints."""
    return task.allows(values) and task.question.at(values).has_designs


def _model_of(estimator: Estimator, task: DesignTask) -> Model:
    known: dict[tuple[object, ...], Array] = {}
    standardised = [estimator.standardised(one.outcome) for one in task.requirements]

    def model(values: Mapping[str, float], points: int) -> Array:
        key = (*values.items(), points)
        if key not in known:
            question = task.question.at(values)
            known[key] = (
                np.array([classifier_probability(of, question, points) for of in standardised])
                if _has_designs(task, values)
                else np.ones(len(standardised))  # meets no target
            )
        return known[key]

    return model


def find_design(estimator: Estimator, task: DesignTask, stage: Stage = silent) -> Designed:
    """Find the cheapest design that meets its targets, and verify it.

    The classifier proposes a design whose probabilities lie below the targets, by as much as the verification needs.
    Fresh simulations verify it, or not, and correct the classifier for the next proposal, which may be larger or
    smaller and is looked at with fresh simulations of its own: those that chose a design never verify it. A look asks
    for as few as would hardly make its design dearer than many would. The looks share the probability of a false
    result. The search ends when looks or simulations are spent, or when a design is verified and the next proposal
    would be cheaper by less than `WORTH`. The cheapest verified design is the result.

    If no design meets the targets by the classifier, and the nearest one exceeds them by simulations, the ends of the
    ranges are looked at, the safest first, because the classifier may be wrong there, and about which one is safest.
    """
    model = _model_of(estimator, task)
    looks: list[Look] = []
    refuted: list[Look] = []
    verified: list[tuple[float, int]] = []
    imagined: dict[int, Array] = {}
    searching = "searching for the design of look {}"
    stage(searching.format(1))
    nearest = cheapest(task, model, task.targets).values
    if not _has_designs(task, nearest):
        raise InputError(f"constraints: no value of {', '.join(task.free)} was found that meets them.")

    def half_widths(size: int) -> Array:
        """Expected half widths of the intervals of the next look with so many simulations, (r,)."""
        confidence = 2.0 * confidence_of_bound(task.confidence, len(looks)) - 1.0
        if looks:
            # What the last look showed; the classifier would only say how unsure it is.
            ratio = math.sqrt(looks[-1].size / size)
            estimates = looks[-1].estimates_of(confidence)
            return np.array([ratio * (estimate.high - estimate.probability) for estimate in estimates])
        if size not in imagined:
            question = task.question.at(nearest).drawn(_IMAGINED, task.unguided)
            plans = [estimator.plan(one.outcome, size, question) for one in task.requirements]
            widths = [plan.expected_half_width(confidence, np.random.default_rng(0)) for plan in plans]
            imagined[size] = np.array(widths)
        return imagined[size]

    def aims_of(size: int) -> Array:
        """The classifier's probabilities, (r,), below which such a look is expected to verify a design."""
        aims = np.maximum((1.0 - _OFF) * task.targets - _HALVES * half_widths(size), _LEAST_AIM * task.targets)
        if not looks:
            return aims
        found = np.array([estimate.probability for estimate in looks[-1].estimates])
        aims = _corrected(aims, looks[-1].candidate.model, found)
        for look in refuted:
            # Whatever the last look corrects, a design that is no safer by the classifier is not proposed again.
            safer = np.minimum(aims, (1.0 - _OFF) * look.candidate.model)
            aims = np.where(look.above(task.targets), safer, aims)
        return aims

    def needed(sizes: list[int]) -> int:
        """The fewest simulations whose design is hardly dearer than that of the most, by the classifier.

        If it knows no design, the fewest of all, which may show that it is wrong.
        """
        best = cheapest(task, model, aims_of(sizes[-1]))
        if not best.is_feasible:
            return sizes[0]
        most = task.cost(best.values) + _ROOM * abs(task.cost(best.values))
        held = {} if task.choices else {name: best.values[name] for name in task.free[1:]}
        lines = ((size, cheapest(task, model, aims_of(size), held)) for size in sizes)
        return next((size for size, one in lines if one.is_feasible and task.cost(one.values) <= most), sizes[-1])

    def exact(candidate: Candidate) -> Array:
        """The classifier's probabilities, (r,), as every other place shows them."""
        question = task.question.at(candidate.values)
        return np.array([estimator.probability(one.outcome, question) for one in task.requirements])

    status: Literal["not verified", "out of reach"] = "not verified"
    ends, last, shown = list[dict[str, float]](), 0, 0
    while len(looks) < LOOKS and (sizes := task.sizes(sum(one.size for one in looks), last)):
        if looks:
            stage(searching.format(len(looks) + 1))
        simulations = needed(sizes)
        aims = aims_of(simulations)
        candidate = cheapest(task, model, aims)
        if ends and not candidate.is_feasible:
            values = min(ends, key=lambda end: _excess(model(end, task.points), aims))
            candidate = Candidate(values, model(values, task.points), is_feasible=False)
        if candidate.is_feasible:
            # The search's integrals have few points; how far off they are hardly depends on the design.
            of_search = np.maximum(candidate.model, _LEAST)
            candidate = cheapest(task, model, aims * of_search / np.maximum(exact(candidate), _LEAST))
        if verified:
            least = min(verified)[0]
            if not candidate.is_feasible or least - task.cost(candidate.values) <= WORTH * abs(least):
                break
        candidate = replace(candidate, model=exact(candidate))
        stage(f"verifying with {simulations * len(task.requirements)} simulations")
        draw = task.question.at(candidate.values).drawn(len(looks) + 1, task.unguided)
        sampled = tuple(estimator.sample(one.outcome, simulations, draw) for one in task.requirements)
        look = Look(candidate, sampled, confidence_of_bound(task.confidence, len(looks)), simulations)
        looks.append(look)
        last, shown = simulations, len(looks)
        if look.above(task.targets).any():
            refuted.append(look)
        if verifies(look.estimates, task.targets.tolist()):
            verified.append((task.cost(candidate.values), len(looks)))
        # What the classifier missed where it was sure, any look may miss by chance: no design is built on it, and those
        # that former looks verified rest on it.
        if look.surprising:
            verified.clear()
            break
        # Of the nearest design even a lower bound exceeds a target: only the ends of the ranges may still help.
        if not candidate.is_feasible and look in refuted:
            shown = 1 + looks.index(min(refuted, key=lambda one: max(one.ratios(task.targets))))
            ends = [] if task.choices else _ends(task, [one.candidate.values for one in refuted])
            if not (ends or task.choices) and _is_believed(task, model(nearest, task.points), looks):
                status = "out of reach"
            # Where constraints leave out an end, what they do allow may still help.
            ends = [end for end in ends if _has_designs(task, end)]
            if not ends:
                break
            # A look at another end need not be larger.
            last = 0
    if verified:
        return Designed(task, tuple(looks), min(verified)[1], "verified")
    return Designed(task, tuple(looks), shown, status)


def _is_believed(task: DesignTask, nearest: Array, looks: Sequence[Look]) -> bool:
    """Whether the classifier, by its errors at the looks, may be believed that no design meets the targets.

    Ends of the ranges do not show what lies between them.

    Args:
        nearest: (r,) its probabilities at the design that comes nearest to the targets.
        looks: at designs.
    """

    def log_odds(P: Array) -> Array:
        return np.asarray(logit(np.clip(P, _LEAST, _LARGEST)))

    errors = [0.0]
    for look in looks:
        low, high = log_odds(np.array([(one.low, one.high) for one in look.estimates])).T
        own = log_odds(look.candidate.model)
        errors.append(float(np.maximum(low - own, own - high).max()))
    return max(errors) <= _TRUSTED * float((log_odds(nearest) - log_odds(task.targets)).max())


def _ends(task: DesignTask, refuted: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """The ends of the ranges of all free variables, which have no choices, without some."""
    corners = itertools.product(*zip(task.low.values(), task.high.values(), strict=True))
    ends = [dict(zip(task.free, corner, strict=True)) for corner in corners]
    return [end for end in ends if end not in refuted]


def _corrected(aims: Array, model: Array, found: Array) -> Array:
    """The classifier's probabilities that correspond to aims, (r,), by those at one design.

    What the classifier adds is the same for all designs: it comes from parts of the distribution where it is unsure of
    survival whatever the design. What it lacks is in proportion to its probability.

    Args:
        aims, model, found: (r,) each; of the classifier, and by simulations, at the design.
    """
    return np.where(found < model, aims + model - found, aims * np.maximum(model, _LEAST) / np.maximum(found, _LEAST))


def cheapest(task: DesignTask, model: Model, aims: Array, held: Mapping[str, float] | None = None) -> Candidate:
    """The cheapest design whose probabilities under the classifier meet the aims, (r,), some free variables held.

    Finitely many designs are all candidates. Otherwise each combination of choices is searched.
    """
    held = held or {}
    names = [name for name in task.free if name not in held]
    choices = [name for name in names if name in task.choices]
    if task.is_finite and (choices or len(names) > 1):
        return _of_all(task, model, aims, held)
    found = [_searched(task, model, {**held, **one}, aims) for one in task.combinations(choices)]
    if feasible := [one for one in found if one.is_feasible]:
        return min(feasible, key=lambda one: task.cost(one.values))
    return min(found, key=lambda one: _excess(one.model, aims))


def _of_all(task: DesignTask, model: Model, aims: Array, held: Mapping[str, float]) -> Candidate:
    """The cheapest of finitely many designs, and of equally cheap ones the safest; the safest if none meets aims."""
    candidates, nearest = task.candidates(held), list[Candidate]()
    for _, equal in itertools.groupby(candidates, key=task.rank):
        judged = []
        for values in equal:
            P = model(values, task.points // _COARSER)
            judged.append((model(values, task.points) if _excess(P, aims) < _FAR else P, values))
        P, values = min(judged, key=lambda one: _excess(one[0], aims))
        nearest.append(Candidate(values, P, _excess(P, aims) <= 0.0, compared=len(candidates)))
        if nearest[-1].is_feasible:
            return nearest[-1]
    return min(nearest, key=lambda one: _excess(one.model, aims))


def _searched(task: DesignTask, model: Model, chosen: Mapping[str, float], aims: Array) -> Candidate:
    """The cheapest design, some free variables held.

    A failure probability need not fall with every increase of a variable, so a line along the first free variable may
    have several ranges that meet them. Further free variables are searched by a Sobol' sample of lines and the simplex
    method [NelderMead1965].
    """
    first, *others = [name for name in task.free if name not in chosen]
    if not others:
        return _on_line(task, model, chosen, aims)
    from scipy.optimize import minimize
    from scipy.stats import qmc

    low, high = (np.array([side[name] for name in others]) for side in (task.low, task.high))
    seen: list[tuple[bool, float, dict[str, float], Array]] = []

    def price(u: Array) -> float:
        u = np.clip(u, 0.0, 1.0)
        values = zip(others, (low + u * (high - low)).tolist(), strict=True)
        held = {name: float(task.stepped[name].rounded(x)) if name in task.stepped else x for name, x in values}
        held |= chosen
        candidate = _on_line(task, model, held, aims, coarse=True)
        value = task.cost(candidate.values) if candidate.is_feasible else _excess(candidate.model, aims)
        seen.append((not candidate.is_feasible, value, held, u))
        # For the simplex alone: any feasible design is better than all others.
        return value / scale if candidate.is_feasible else 1e9 * (1.0 + value)

    middle = {name: 0.5 * (task.low[name] + task.high[name]) for name in (first, *others)} | dict(chosen)
    scale = max(abs(task.cost(middle)), 1e-300)
    count = 2 ** math.ceil(math.log2(_SAMPLED * len(others)))
    for u in qmc.Sobol(len(others), rng=np.random.default_rng(0)).random(count):
        price(u)
    start = min(seen, key=lambda one: one[:2])[3]
    step = np.where(start > 0.5, -0.15, 0.15)
    simplex = np.vstack([start, start + np.diag(step)])
    minimize(
        price,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": _REFINED * len(others), "xatol": 0.005, "fatol": 1e-6},
    )
    # With more points the best of these lines may be infeasible, above all where the first variable is at its limit.
    fine: list[Candidate] = []
    tried: list[Array] = []
    for _, _, held, u in sorted(seen, key=lambda one: one[:2]):
        # The simplex leaves many lines beside each other, which would all fail for the same reason.
        if any(np.abs(u - other).max() < _APART for other in tried):
            continue
        tried.append(u)
        fine.append(_on_line(task, model, held, aims))
        if fine[-1].is_feasible:
            return fine[-1]
        if len(fine) == _FINE_LINES:
            break
    return min(fine, key=lambda one: _excess(one.model, aims))


def _excess(model: Array, aims: Array) -> float:
    """Largest logarithm of a probability over its aim."""
    return float(np.max(np.log(np.maximum(model, _LEAST) / aims)))


def _on_line(task: DesignTask, model: Model, held: Mapping[str, float], aims: Array, coarse: bool = False) -> Candidate:
    """The cheapest design along the only free variable not held; the safest one if none meets the aims.

    A few values bracket the ends of the ranges that meet them. Roots are found between; of a variable with steps, those
    between are halved.
    """
    from scipy.optimize import brentq, minimize_scalar

    (name,) = (one for one in task.free if one not in held)
    low, high = task.low[name], task.high[name]
    points, size = (task.points // _COARSER, _COARSE_GRID) if coarse else (task.points, _GRID)

    def probabilities(x: float) -> Array:
        return model({name: x, **held}, points)

    def excess(x: float) -> float:
        return _excess(probabilities(x), aims)

    def cost(x: float) -> float:
        return task.cost({name: x, **held})

    steps = task.stepped[name].values if name in task.stepped else None
    if steps is not None:
        steps = steps[[task.allows({name: x, **held}) for x in steps.tolist()]] if task.constraints else steps
        steps = steps if len(steps) else task.stepped[name].values[:1]  # infeasible

    def at(place: float) -> float:
        """The value at a place, which is the number of a step, or the value itself."""
        return float(place) if steps is None else float(steps[round(place)])

    def scanned(size: int) -> Array:
        """So many places from one end of the line to the other."""
        if steps is None:
            return np.linspace(low, high, size)
        return np.unique(np.linspace(0, len(steps) - 1, size).round())

    places = scanned(size)
    grid = np.array([at(place) for place in places])
    excesses = np.array([excess(x) for x in grid.tolist()])
    if excesses.min() > 0.0 and not coarse:
        # A dip of the probability, or the limit of a constraint, may lie between two values.
        fine = scanned(_FINE_GRID)
        rough = [_excess(model({name: at(place), **held}, points // _COARSER), aims) for place in fine]
        least = int(np.argmin(rough))
        near = {"xatol": 0.5 if steps is not None else _FINE * (high - low)}
        beside = fine[max(least - 1, 0)], fine[min(least + 1, len(fine) - 1)]
        of = minimize_scalar(lambda u: excess(at(u)), bounds=beside, method="bounded", options=near)
        places = np.union1d(places, [fine[least], of.x if steps is None else round(of.x)])
        grid = np.array([at(place) for place in places])
        excesses = np.array([excess(x) for x in grid.tolist()])
    if excesses.min() > 0.0:
        x = float(grid[np.argmin(excesses)])
        return Candidate({name: x, **held}, probabilities(x), is_feasible=False)

    def end(inside: int, outside: int) -> float:
        """The end of a range between two values of the grid; the inner one if there is no outer one."""
        if not 0 <= outside < len(grid):
            return float(grid[inside])
        if steps is not None:
            meets, misses = int(places[inside]), int(places[outside])
            while abs(meets - misses) > 1:
                middle = (meets + misses) // 2
                meets, misses = (middle, misses) if excess(float(steps[middle])) <= 0.0 else (meets, middle)
            return float(steps[meets])
        root = float(brentq(excess, grid[inside], grid[outside], xtol=_FINE * (high - low)))
        # On the safe side of the root's tolerance, with few digits, so that the printed design is the verified one.
        towards = 1.0 if grid[inside] > grid[outside] else -1.0
        digit = 10.0 ** math.floor(math.log10(_FINE * (high - low)) + 0.5)
        root = towards * digit * math.ceil(towards * (root + towards * _FINE * (high - low)) / digit)
        return min(max(round(root, 12), low), high)

    edges = np.flatnonzero(np.diff(np.pad(excesses <= 0.0, 1)))
    ranges, values = [], []
    for first, last in zip(edges[::2], edges[1::2] - 1, strict=True):
        ends = end(first, first - 1), end(last, last + 1)
        ranges.append(ends)
        values += [*ends, *grid[first : last + 1].tolist()]
        if steps is not None:
            values += steps[(steps >= ends[0]) & (steps <= ends[1])].tolist()
        elif ends[0] < ends[1]:
            values.append(float(minimize_scalar(cost, bounds=ends, method="bounded").x))
    for x in sorted(values, key=cost):
        # Between two values of the grid that meet the aims, others may miss them.
        if _excess(P := probabilities(x), aims) <= 0.0:
            break
    return Candidate({name: x, **held}, P, is_feasible=True, ranges=tuple(ranges))
