"""Limit states of reliability problems: failure where they are at most 0.

RP problems are those of the reliability challenge of Rozsás and Slobbe (2019) under their numbers there; the
four-branch system is from Waarts (2000) with k = 7. The others are made up: a parabola in ten dimensions, a half-space
with a disc hidden in the bulk, and two opposite half-spaces in five dimensions.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from activefail.simulators.interface import Results
from activefail.space import Array

ROOT = 2.0**0.5

Variable = tuple[str, float, float]
"""Distribution, and its mean and sd (of an exponential distribution the mean counts), or its bounds if uniform."""


def _normal(mean: float = 0.0, sd: float = 1.0) -> Variable:
    return "normal", mean, sd


def _lognormal(mean: float, sd: float) -> Variable:
    return "lognormal", mean, sd


@dataclass(frozen=True)
class Problem:
    """A limit state as a simulator.

    Attributes:
        variables: of the design space.
        limit: limit state of designs, (n, d) -> (n,).
        probability: of failure, from `reliability.py --references`.
        truncated: whether simulations end at failure, so that no margin is below 0.
        labels: whether the simulator reports no margin.
    """

    variables: tuple[Variable, ...]
    limit: Callable[[Array], Array]
    probability: float
    truncated: bool = False
    labels: bool = False

    outcomes = ("safe", "failure")
    causes = ("",)
    releases_gil = True

    @property
    def margins(self) -> tuple[str, ...]:
        """Names of the margins."""
        return () if self.labels else ("g",)

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, d)."""
        g = self.limit(X)
        margin = np.maximum(g, 0.0) if self.truncated else g
        nothing = np.zeros(len(X))
        margins = np.empty((len(X), 0)) if self.labels else margin[:, None]
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), margins, nothing)

    @property
    def space(self) -> dict[str, dict[str, object]]:
        """The design space as settings."""
        return {
            f"x{number}": {"distribution": name, "low": one, "high": other}
            if name == "uniform"
            else {"distribution": name, "mean": one}
            if name == "exponential"
            else {"distribution": name, "mean": one, "sd": other}
            for number, (name, one, other) in enumerate(self.variables, start=1)
        }


def _four_branch(X: Array) -> Array:
    x, y = X.T
    bent = 3.0 + 0.1 * (x - y) ** 2
    return np.asarray(
        np.min([bent - (x + y) / ROOT, bent + (x + y) / ROOT, x - y + 7 / ROOT, y - x + 7 / ROOT], axis=0)
    )


def _rp38(X: Array) -> Array:
    a, b, c, d, e, f, g = X.T
    load = d**2 - 4.0 * e * f * g**2 + d * (f + 4.0 * e + 2.0 * f * g)
    return np.asarray(15.59e4 - a * b**3 / (2.0 * c**3) * load / (d * e * (d + f + 2.0 * f * g)))


def _rp55(X: Array) -> Array:
    x, y = X.T
    bent = 0.2 + 0.6 * (x - y) ** 4
    sides = [bent - (x - y) / ROOT, bent + (x - y) / ROOT, x - y + 5.0 / ROOT - 2.2, y - x + 5.0 / ROOT - 2.2]
    return np.asarray(np.min(sides, axis=0))


def _rp60(X: Array) -> Array:
    a, b, c, d, load = X.T
    pairs = np.min([b - 0.5 * load, c - 0.5 * load, d - 0.5 * load], axis=0)
    alone = np.maximum(d - load, np.minimum(b - load, c - load))
    return np.asarray(np.minimum(a - load, np.maximum(pairs, alone)))


_UP, _DOWN = np.ones(5) / 5.0**0.5, np.array([1.0, -1.0, 1.0, -1.0, 1.0]) / 5.0**0.5

PROBLEMS = {
    "four-branch": Problem((_normal(),) * 2, _four_branch, 2.2225e-3),
    "RP8": Problem(
        (*(_lognormal(120.0, 12.0),) * 4, _lognormal(50.0, 10.0), _lognormal(40.0, 8.0)),
        lambda X: X[:, 0] + 2.0 * X[:, 1] + 2.0 * X[:, 2] + X[:, 3] - 5.0 * X[:, 4] - 5.0 * X[:, 5],
        7.9e-4,
    ),
    "RP22": Problem(
        (_normal(),) * 2, lambda X: 2.5 - (X[:, 0] + X[:, 1]) / ROOT + 0.1 * (X[:, 0] - X[:, 1]) ** 2, 4.16e-3
    ),
    "RP25": Problem(
        (_normal(),) * 2,
        lambda X: np.maximum(X[:, 0] ** 2 - 8.0 * X[:, 1] + 16.0, -16.0 * X[:, 0] + X[:, 1] + 32.0),
        4.148566e-5,
    ),
    "RP33": Problem((_normal(),) * 3, lambda X: np.minimum(3.0 * 3.0**0.5 - X.sum(axis=1), 3.0 - X[:, 2]), 2.57e-3),
    "RP38": Problem(
        tuple(_normal(mean, 0.1 * mean) for mean in (350.0, 50.8, 3.81, 173.0, 9.38, 33.1, 0.036)), _rp38, 8.1e-3
    ),
    "RP53": Problem(
        (_normal(1.5), _normal(2.5)),
        lambda X: np.sin(2.5 * X[:, 0]) + 2.0 - (X[:, 0] ** 2 + 4.0) * (X[:, 1] - 1.0) / 20.0,
        3.13e-2,
    ),
    "RP55": Problem((("uniform", -1.0, 1.0),) * 2, _rp55, 5.6e-1),
    "RP60": Problem(
        (
            _lognormal(2200.0, 220.0),
            _lognormal(2100.0, 210.0),
            _lognormal(2300.0, 230.0),
            _lognormal(2000.0, 200.0),
            _lognormal(1200.0, 480.0),
        ),
        _rp60,
        4.5e-2,
    ),
    "parabola-10d": Problem((_normal(),) * 10, lambda X: 3.5 - X[:, 0] + 0.05 * (X[:, 1:] ** 2).sum(axis=1), 5.4e-5),
    "hidden disc": Problem(
        (_normal(),) * 2,
        lambda X: np.minimum(3.2 - X[:, 0], np.hypot(X[:, 0] + 2.2, X[:, 1] - 2.4) - 0.6),
        1.99e-3,
    ),
    "two modes 5d": Problem((_normal(),) * 5, lambda X: np.minimum(3.2 - X @ _UP, 3.4 + X @ _DOWN), 1.02e-3),
}


HELD_OUT = ("RP14", "RP24", "RP31", "RP35", "RP54", "RP57", "RP75", "RP89", "RP110")
"""Problems on which nothing was chosen; otbenchmark defines them."""


def problem_of(name: str) -> Problem:
    """The problem of a name.

    Raises:
        ImportError: if it is held out and otbenchmark is not installed.
    """
    return _held_out(name) if name in HELD_OUT else PROBLEMS[name]


@cache
def _held_out(name: str) -> Problem:
    import openturns
    import otbenchmark

    defined = getattr(otbenchmark, f"ReliabilityProblem{name.removeprefix('RP')}")()
    event = defined.getEvent()
    distribution, function = event.getAntecedent().getDistribution(), event.getFunction()
    assert distribution.hasIndependentCopula()
    assert event.getOperator().compare(-1.0, 0.0), "failure must be below the threshold"

    def variable(marginal: openturns.Distribution) -> Variable:
        if marginal.getName() == "Uniform":
            low, high = marginal.getRange().getLowerBound()[0], marginal.getRange().getUpperBound()[0]
            return "uniform", low, high
        kinds = {"Normal": "normal", "Gumbel": "gumbel_max", "Exponential": "exponential"}
        # A distribution by mean and sd has no accessor for its kind.
        (title,) = {kind for name, kind in kinds.items() if re.search(rf"\b{name}", str(marginal))}
        return title, marginal.getMean()[0], marginal.getStandardDeviation()[0]

    variables = tuple(variable(distribution.getMarginal(i)) for i in range(distribution.getDimension()))
    threshold = event.getThreshold()
    return Problem(
        variables, lambda X: np.asarray(function(openturns.Sample(X)))[:, 0] - threshold, defined.getProbability()
    )
