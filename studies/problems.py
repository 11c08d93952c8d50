"""Limit states as simulators: failure where they are at most 0.

RP problems are those of the reliability challenge of Rozsás and Slobbe (2019) under their numbers there; the
four-branch system is from Waarts (2000) with k = 7. All others are made up.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from scipy.stats import ncx2, norm
from study import campaign_of

from activefail.learning.criteria.population import population
from activefail.simulators.interface import Results
from activefail.space.space import Array

ROOT = 2.0**0.5

Variables = dict[str, dict[str, Any]]


def variables(*each: tuple[str, float, float]) -> Variables:
    """A design space x1, x2, ... as settings: distributions with mean and sd, or with bounds if uniform."""
    keys = {"uniform": ("low", "high"), "exponential": ("mean",)}
    return {
        f"x{number}": {"distribution": name} | dict(zip(keys.get(name, ("mean", "sd")), numbers, strict=False))
        for number, (name, *numbers) in enumerate(each, start=1)
    }


def normals(*means_and_sds: tuple[float, float]) -> Variables:
    """A design space of normal variables."""
    return variables(*(("normal", mean, sd) for mean, sd in means_and_sds))


def standard(d: int) -> Variables:
    """A design space of d standard normal variables."""
    return normals(*[(0.0, 1.0)] * d)


@dataclass(frozen=True)
class Problem:
    """A limit state as a simulator.

    Attributes:
        limit: of designs, (n, d) -> (n,).
        space: its variables as settings.
        probability: of failure; None where `true_probability` gives it.
        correlation: of the variables' values.
        questions: other variables, by title.
        shown: the margin that the simulator reports, from the limit state; None if it reports none.
    """

    limit: Callable[[Array], Array]
    space: Variables
    probability: float | None = None
    correlation: tuple[tuple[str, str, float], ...] = ()
    questions: dict[str, Variables] = field(default_factory=dict)
    shown: Callable[[Array], Array] | None = np.asarray

    outcomes = ("safe", "failure")
    causes = ("",)
    releases_gil = True

    @property
    def margins(self) -> tuple[str, ...]:
        """Names of the margins."""
        return ("g",) if self.shown else ()

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, d)."""
        g, nothing = self.limit(X), np.zeros(len(X))
        margins = self.shown(g)[:, None] if self.shown else np.empty((len(X), 0))
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), margins, nothing)

    def campaign(self, space: Variables | None = None, **settings: Any) -> Any:
        """A campaign on it, on its own or other variables; in the settings `__` stands for a dot."""
        own = {"space": space or self.space, "correlation": [list(pair) for pair in self.correlation]}
        return campaign_of(self, **own, classifier__features="design", **settings)


PARTS, PART = 10, 500_000
"""Populations of a true probability, and their sizes."""


@cache
def true_probability(name: str, question: str = "") -> float:
    """The failure probability of a problem, or of one of its questions: published, or from a weighted sample."""
    problem = problem_of(name)
    if not question and problem.probability is not None:
        return problem.probability
    space = problem.campaign(problem.questions[question] if question else None).space
    rng, parts = np.random.default_rng(0), []
    for _ in range(PARTS):
        drawn = population(space, PART, None, rng)
        parts.append((drawn.weight * (problem.limit(drawn.X) <= 0.0)).mean())
    assert np.std(parts) < 0.02 * PARTS**0.5 * np.mean(parts), f"{name}: the sample is too small."
    return float(np.mean(parts))


def _four_branch(X):
    x, y = X.T
    bent = 3.0 + 0.1 * (x - y) ** 2
    return np.min([bent - (x + y) / ROOT, bent + (x + y) / ROOT, x - y + 7 / ROOT, y - x + 7 / ROOT], axis=0)


def _rp38(X):
    a, b, c, d, e, f, g = X.T
    load = d**2 - 4.0 * e * f * g**2 + d * (f + 4.0 * e + 2.0 * f * g)
    return 15.59e4 - a * b**3 / (2.0 * c**3) * load / (d * e * (d + f + 2.0 * f * g))


def _rp55(X):
    x, y = X.T
    bent = 0.2 + 0.6 * (x - y) ** 4
    sides = [bent - (x - y) / ROOT, bent + (x - y) / ROOT, x - y + 5.0 / ROOT - 2.2, y - x + 5.0 / ROOT - 2.2]
    return np.min(sides, axis=0)


def _rp60(X):
    a, b, c, d, load = X.T
    pairs = np.min([b - 0.5 * load, c - 0.5 * load, d - 0.5 * load], axis=0)
    alone = np.maximum(d - load, np.minimum(b - load, c - load))
    return np.minimum(a - load, np.maximum(pairs, alone))


_UP, _DOWN = np.ones(5) / 5.0**0.5, np.array([1.0, -1.0, 1.0, -1.0, 1.0]) / 5.0**0.5

BENCHMARK = {
    "four-branch": Problem(_four_branch, standard(2), 2.222795e-3),
    "RP8": Problem(
        lambda X: X @ [1.0, 2.0, 2.0, 1.0, -5.0, -5.0],
        variables(*[("lognormal", 120.0, 12.0)] * 4, ("lognormal", 50.0, 10.0), ("lognormal", 40.0, 8.0)),
        7.8977e-4,
    ),
    "RP22": Problem(
        lambda X: 2.5 - (X[:, 0] + X[:, 1]) / ROOT + 0.1 * (X[:, 0] - X[:, 1]) ** 2, standard(2), 4.207306e-3
    ),
    "RP25": Problem(
        lambda X: np.maximum(X[:, 0] ** 2 - 8.0 * X[:, 1] + 16.0, -16.0 * X[:, 0] + X[:, 1] + 32.0),
        standard(2),
        4.148566e-5,
    ),
    "RP33": Problem(lambda X: np.minimum(3.0 * 3.0**0.5 - X.sum(axis=1), 3.0 - X[:, 2]), standard(3), 2.575598e-3),
    "RP38": Problem(
        _rp38, normals(*((mean, 0.1 * mean) for mean in (350.0, 50.8, 3.81, 173.0, 9.38, 33.1, 0.036))), 8.0524e-3
    ),
    "RP53": Problem(
        lambda X: np.sin(2.5 * X[:, 0]) + 2.0 - (X[:, 0] ** 2 + 4.0) * (X[:, 1] - 1.0) / 20.0,
        normals((1.5, 1.0), (2.5, 1.0)),
        3.132049e-2,
    ),
    "RP55": Problem(_rp55, variables(*[("uniform", -1.0, 1.0)] * 2), 5.600144e-1),
    "RP60": Problem(
        _rp60,
        variables(
            ("lognormal", 2200.0, 220.0),
            ("lognormal", 2100.0, 210.0),
            ("lognormal", 2300.0, 230.0),
            ("lognormal", 2000.0, 200.0),
            ("lognormal", 1200.0, 480.0),
        ),
        4.483966e-2,
    ),
    "parabola-10d": Problem(lambda X: 3.5 - X[:, 0] + 0.05 * (X[:, 1:] ** 2).sum(axis=1), standard(10), 5.22365e-5),
    "hidden disc": Problem(
        lambda X: np.minimum(3.2 - X[:, 0], np.hypot(X[:, 0] + 2.2, X[:, 1] - 2.4) - 0.6), standard(2), 1.954360e-3
    ),
    "two modes 5d": Problem(lambda X: np.minimum(3.2 - X @ _UP, 3.4 + X @ _DOWN), standard(5), 1.024057e-3),
}
"""Their probabilities are exact to the digits given: integrals of one variable, the others in closed form. RP8, RP38
and RP60 are means over 16, 16 and 8 scrambled Sobol' sequences of 2^18, 2^18 and 2^17 points, one variable in closed
form, with standard errors of 2.5e-7, 1.4e-6 and 3e-8. `reliability.py --references` checks them."""

HELD_OUT = ("RP14", "RP24", "RP31", "RP35", "RP54", "RP57", "RP75", "RP89", "RP110")
"""Problems on which nothing was chosen; otbenchmark defines them."""


def _polygon(X):
    angles = np.array([0.3, 1.0, 2.1, 2.9, 3.8, 4.6, 5.5])
    offsets = np.array([3.1, 3.3, 3.0, 3.6, 3.2, 3.4, 3.1])
    return (offsets - X @ np.stack([np.cos(angles), np.sin(angles)])).min(axis=1)


def _disc(X, x, y, radius):
    return np.hypot(X[:, 0] - x, X[:, 1] - y) - radius


def _planes(X):
    directions = np.random.default_rng(5).standard_normal((12, X.shape[1]))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return (3.4 + 0.3 * np.arange(12) / 11.0 - X @ directions.T).min(axis=1)


def _pair(X):
    along = X.sum(axis=1) / 6**0.5
    return np.minimum(3.2 - along, 1.5 * (3.2 + along))


def _noise(X):
    return 2.8 - X[:, 0] + 0.4 * np.modf(np.sin(X @ np.array([127.1, 311.7])) * 43758.5453)[0]


def _bent(X):
    return 3.0 - X[:, 0] - 0.3 * X[:, 1] ** 2


def _heavy(count, cov):
    return variables(*[("lognormal", 1.0, cov)] * count)


_PRODUCT, _COV, _RHO = 150.0, 1.0, 0.6
_SD_OF_LOG = np.sqrt(3.0 * np.log1p(_COV**2) + 6.0 * np.log1p(_RHO * _COV**2))

MISLEADING = {
    # Thin regions and corners.
    "sliver": Problem(
        lambda X: np.abs(X[:, 0] + 0.3 * X[:, 1] - 2.6) - 0.04,
        standard(2),
        float(np.diff(norm.cdf(np.array([2.56, 2.64]) / np.sqrt(1.09)))[0]),
    ),
    "finger": Problem(lambda X: np.maximum(1.5 - X[:, 0], np.abs(X[:, 1] - 0.3 * X[:, 0]) - 0.04), standard(2)),
    "ring": Problem(lambda X: np.abs(np.hypot(X[:, 0], X[:, 1]) - 3.0) - 0.04, standard(2)),
    "corner": Problem(
        lambda X: np.maximum(2.2 - X[:, 0], 2.0 - X[:, 1]), standard(2), float(norm.sf(2.2) * norm.sf(2.0))
    ),
    "polygon": Problem(_polygon, standard(2)),
    "planes": Problem(_planes, standard(5)),
    # Several regions.
    "opposite": Problem(lambda X: 3.2 - np.abs(X[:, 0]), standard(2), 2.0 * float(norm.sf(3.2))),
    "ten modes": Problem(
        lambda X: 3.5 - np.abs(X).max(axis=1), standard(5), float(1.0 - (1.0 - 2.0 * norm.sf(3.5)) ** 5)
    ),
    "skew pair": Problem(_pair, standard(6), 2.0 * float(norm.sf(3.2))),
    "islands": Problem(
        lambda X: np.min([_disc(X, 2.2, 1.0, 0.2), _disc(X, -2.0, 1.6, 0.25), _disc(X, 0.3, -2.7, 0.3)], 0),
        standard(2),
    ),
    "jump": Problem(lambda X: np.where(_disc(X, -1.6, -1.0, 0.3) <= 0.0, -1.0, 3.0 - X[:, 0]), standard(2)),
    "decoy": Problem(
        lambda X: np.minimum(0.1 + 0.2 * ((X[:, 0] + 2.0) ** 2 + X[:, 1] ** 2), 1.5 * (3.2 - X[:, 0])),
        standard(2),
        float(norm.sf(3.2)),
    ),
    # Margins that are not smooth, or whose size misleads.
    "ripple": Problem(lambda X: 3.0 - X[:, 0] - 0.3 * np.sin(20.0 * X[:, 1]), standard(2)),
    "noise": Problem(_noise, standard(2)),
    "steps": Problem(lambda X: np.ceil(4.0 * _bent(X)) / 4.0, standard(2)),
    "root": Problem(lambda X: np.cbrt(_bent(X)), standard(2)),
    "cube": Problem(lambda X: _bent(X) ** 3, standard(2)),
    "exponential": Problem(lambda X: np.exp(4.0 * _bent(X)) - 1.0, standard(2)),
    "late": Problem(lambda X: 4.0 - X[:, 0] - 2.0 * np.maximum(0.0, X[:, 0] - 1.5) * X[:, 1], standard(2)),
    "oscillation": Problem(lambda X: 3.6 - X[:, 0] * np.cos(2.0 * X[:, 1]) - 0.5 * np.abs(X[:, 0]), standard(2)),
    # Correlated and heavy-tailed variables.
    "difference": Problem(
        lambda X: 3.0 * 0.02**0.5 - (X[:, 0] - X[:, 1]), standard(2), float(norm.sf(3.0)), (("x1", "x2", 0.99),)
    ),
    "product": Problem(
        lambda X: _PRODUCT - X.prod(axis=1),
        _heavy(3, _COV),
        float(norm.sf((np.log(_PRODUCT) + 1.5 * np.log1p(_COV**2)) / _SD_OF_LOG)),
        (("x1", "x2", _RHO), ("x1", "x3", _RHO), ("x2", "x3", _RHO)),
    ),
    "heavy sum": Problem(lambda X: 60.0 - X.sum(axis=1), _heavy(4, 2.0)),
    "weakest link": Problem(
        lambda X: X.min(axis=1) - 1e-3, variables(*[("exponential", 1.0)] * 4), float(-np.expm1(-4e-3))
    ),
    "tails": Problem(
        lambda X: X[:, 1] - X[:, 0],
        variables(("gumbel_max", 1.0, 0.6), ("weibull", 9.0, 2.7)),
        correlation=(("x1", "x2", -0.7),),
    ),
    # Questions away from where the campaign learned: a plane and a kink that only larger values of x2 meet.
    "plane behind": Problem(
        lambda X: np.minimum(3.0 - X[:, 0], 7.5 - X[:, 1] + 0.5 * np.sin(3.0 * X[:, 0])),
        standard(2),
        float(norm.sf(3.0)),
        questions={"wider": normals((0.0, 1.0), (0.0, 2.5)), "far": normals((0.0, 0.8), (6.0, 0.5))},
    ),
    "kink behind": Problem(
        lambda X: 3.0 - X[:, 0] + 2.0 * np.maximum(0.0, X[:, 1] - 3.5),
        standard(2),
        questions={"far": normals((0.0, 1.5), (4.5, 0.7)), "wider": normals((0.0, 2.0), (0.0, 2.0))},
    ),
}
"""Made to mislead."""

QUESTIONED = {name: MISLEADING[name] for name in ("plane behind", "kink behind")} | {
    "lobe": Problem(
        lambda X: np.minimum(3.2 - X[:, 0], 4.0 * _disc(X, -1.0, 6.5, 1.5)),
        standard(2),
        questions={"wider": normals((0.0, 1.2), (1.0, 2.2)), "far": normals((-1.0, 0.8), (4.0, 0.8))},
    ),
    "behind 5": Problem(
        lambda X: np.minimum(3.0 - X.sum(axis=1) / 5**0.5, 4.0 * (5.5 - 0.8 * X[:, 4] + 0.6 * X[:, 0])),
        standard(5),
        questions={"wider": normals((0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.5), (0.0, 2.0))},
    ),
    "bowl 2": Problem(
        lambda X: 3.0 - X[:, 0] - 0.15 * X[:, 1] ** 2,
        standard(2),
        questions={"wider": normals((0.0, 1.3), (0.0, 2.0)), "far": normals((0.5, 0.7), (3.0, 0.7))},
    ),
    "bowl 5": Problem(
        lambda X: 3.5 - X[:, :3].sum(axis=1) / 3**0.5 - 0.05 * X[:, 3] ** 2 + 0.1 * X[:, 4],
        standard(5),
        questions={
            "wider": normals(*[(0.0, 1.4)] * 5),
            "far": normals((1.0, 0.8), (1.0, 0.8), (0.0, 1.0), (3.0, 1.0), (-2.0, 1.0)),
        },
    ),
}
"""With questions far from where a campaign learns. "lobe" and "behind 5" hide a second region; bowls have none."""

SATURATED = {
    "distance": np.asarray,
    "clipped": lambda g: np.minimum(g, 0.4),
    "smooth": lambda g: 0.4 * np.tanh(g / 0.4),
    "outcomes": None,
}
"""What the simulator reports of the distance to a half-plane and a disc; within 0.4 of the disc nothing of the disc."""


def half_plane_and_disc(kind: str, seed: int) -> Problem:
    """A half-plane, and on its other side a disc that has 20 to 90 % of the failure probability."""
    rng = np.random.default_rng([seed, 3])
    while True:
        angle, away = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5 * np.pi, 1.5 * np.pi)
        offset, far, radius = rng.uniform(2.6, 3.2), rng.uniform(1.2, 2.2), rng.uniform(0.1, 0.4)
        direction = np.array([np.cos(angle), np.sin(angle)])
        centre = far * np.array([np.cos(angle + away), np.sin(angle + away)])
        disc = float(ncx2.cdf(radius**2, 2, far**2))
        probability = float(norm.sf(offset)) + disc
        if 0.2 <= disc / probability <= 0.9:
            break
    return Problem(
        lambda X: np.minimum(offset - X @ direction, _disc(X, *centre, radius)),
        standard(2),
        probability,
        shown=SATURATED[kind],
    )


SETS = {
    "benchmark": tuple(BENCHMARK),
    "held-out": HELD_OUT,
    "misleading": tuple(MISLEADING),
    "saturated": tuple(SATURATED),
}


def problem_of(name: str, seed: int = 0) -> Problem:
    """The problem of a name; a saturated one is drawn by a seed.

    Raises:
        ImportError: if it is held out and otbenchmark is not installed.
    """
    if name in SATURATED:
        return half_plane_and_disc(name, seed)
    return _held_out(name) if name in HELD_OUT else (BENCHMARK | MISLEADING | QUESTIONED)[name]


@cache
def _held_out(name: str) -> Problem:
    import openturns
    import otbenchmark

    defined = getattr(otbenchmark, f"ReliabilityProblem{name.removeprefix('RP')}")()
    event = defined.getEvent()
    distribution, function = event.getAntecedent().getDistribution(), event.getFunction()
    assert distribution.hasIndependentCopula()
    assert event.getOperator().compare(-1.0, 0.0), "failure must be below the threshold"

    def variable(marginal):
        if marginal.getName() == "Uniform":
            return "uniform", marginal.getRange().getLowerBound()[0], marginal.getRange().getUpperBound()[0]
        kinds = {"Normal": "normal", "Gumbel": "gumbel_max", "Exponential": "exponential"}
        # A distribution by mean and sd has no accessor for its kind.
        (title,) = {kind for name, kind in kinds.items() if re.search(rf"\b{name}", str(marginal))}
        return title, marginal.getMean()[0], marginal.getStandardDeviation()[0]

    space = variables(*(variable(distribution.getMarginal(i)) for i in range(distribution.getDimension())))
    threshold = event.getThreshold()
    return Problem(
        lambda X: np.asarray(function(openturns.Sample(X)))[:, 0] - threshold, space, defined.getProbability()
    )
