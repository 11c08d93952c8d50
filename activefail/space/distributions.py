"""Distributions of one variable by mean and standard deviation or by their own parameters; SciPy computes them."""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from scipy.stats.distributions import rv_frozen

Distribution = Literal[
    "uniform",
    "log_uniform",
    "truncated_normal",
    "normal",
    "lognormal",
    "gumbel_max",
    "gumbel_min",
    "weibull",
    "gamma",
    "beta",
    "exponential",
]


_BY_MEAN = ("mean", "sd"), ("mean", "cov")


class Family(NamedTuple):
    """What a family of distributions takes.

    Attributes:
        words: its name in a sentence.
        sets: alternative sets of parameters: each one defines the distribution between its bounds. `dispersion` is the
            standard deviation of the logarithm, and `location` of a Gumbel distribution its mode.
        is_bounded: whether it needs both bounds.
        is_positive: whether its values are.
        cov: coefficients of variation between which SciPy's quantiles are accurate in both tails.
    """

    words: str
    sets: tuple[tuple[str, ...], ...] = _BY_MEAN
    is_bounded: bool = False
    is_positive: bool = False
    cov: tuple[float, float] = (0.0, math.inf)


FAMILIES: dict[Distribution, Family] = {
    "uniform": Family("uniform", ((),), is_bounded=True),
    "log_uniform": Family("log-uniform", ((),), is_bounded=True),
    "truncated_normal": Family("truncated normal", is_bounded=True),
    "normal": Family("normal"),
    "lognormal": Family("lognormal", (*_BY_MEAN, ("median", "dispersion")), is_positive=True, cov=(1e-6, 1e3)),
    "gumbel_max": Family("Gumbel (max)", (*_BY_MEAN, ("location", "scale"))),
    "gumbel_min": Family("Gumbel (min)", (*_BY_MEAN, ("location", "scale"))),
    "weibull": Family("Weibull", (*_BY_MEAN, ("shape", "scale")), is_positive=True, cov=(1e-3, 100.0)),
    "gamma": Family("gamma", (*_BY_MEAN, ("shape", "scale")), is_positive=True, cov=(1e-3, 3.0)),
    "beta": Family("beta", (*_BY_MEAN, ("alpha", "beta")), is_bounded=True),
    "exponential": Family("exponential", (("mean",), ("rate",)), is_positive=True, cov=(1.0, 1.0)),
}

PARAMETERS = tuple(dict.fromkeys(name for family in FAMILIES.values() for names in family.sets for name in names))
"""Names of all parameters of distributions."""

_LARGEST = 1e100
"""Largest mean and sd."""

_BETA_SHAPES = (0.5, 500.0)
"""Range of a beta distribution's shapes between which SciPy's quantiles are accurate in both tails."""

_LEAST_SHAPE, _LARGEST_SHAPE = 0.1, 1e4
"""Range of a Weibull distribution's shape that holds its coefficients of variation."""


def checked_moments(
    distribution: Distribution, low: float | None, high: float | None, parameters: Mapping[str, float]
) -> tuple[float | None, float | None]:
    """Mean and standard deviation (see `moments`) of a distribution; None for one by its bounds alone.

    Args:
        distribution: name of the distribution.
        low, high: bounds of the variable, if any.
        parameters: the numbers by name.

    Raises:
        ValueError: if bounds and parameters do not define a distribution; the text is the rule and the value.
    """
    family = FAMILIES[distribution]
    name = f"{'an' if distribution == 'exponential' else 'a'} {family.words} distribution"
    if set(parameters) not in map(set, family.sets):
        needed = ", or ".join(" and ".join(f"`{one}`" for one in names) for names in family.sets if names)
        needs = f"{name} requires {needed}" if needed else f"{name} takes only `low` and `high`"
        shown = " and ".join(f"`{key} = {number:g}`" for key, number in parameters.items()) or "none of them"
        raise ValueError(f"{needs}; got {shown}")
    if family.is_bounded and (low is None or high is None):
        raise ValueError(f"{name} requires `low` and `high`")
    for key, number in parameters.items():
        if not math.isfinite(number):
            raise ValueError(f"`{key}` must be finite, got {number}")
        if not number > 0.0 and (family.is_positive if key == "mean" else key != "location"):
            raise ValueError(f"`{key} > 0` must hold, got {number}")
    if family.is_positive and low is not None and low < 0.0:
        raise ValueError(f"`low >= 0` must hold for {name}, got {low}")
    if not parameters:
        return None, None
    if "cov" in parameters and parameters["mean"] == 0.0:
        raise ValueError("a coefficient of variation requires a mean other than 0")
    try:
        mean, sd = moments(distribution, low, high, parameters)
    except OverflowError:
        mean = sd = math.inf
    if not (abs(mean) <= _LARGEST and sd <= _LARGEST):
        raise ValueError(f"mean and sd must be at most {_LARGEST:g}, got {mean:g} and {sd:g}")
    if sd < 1.0 / _LARGEST:
        raise ValueError(f"the sd must be at least {1.0 / _LARGEST:g}, got {sd:g}")
    if distribution == "beta" and low is not None and high is not None:
        # A beta distribution's variance is less than (mean − low)(high − mean).
        if not (low < mean < high and sd * sd < (mean - low) * (high - mean)):
            raise ValueError(f"no beta distribution between {low:g} and {high:g} has mean {mean:g} and sd {sd:g}")
        alpha, beta = beta_shapes(low, high, mean, sd)
        least, largest = _BETA_SHAPES
        if not (least <= alpha <= largest and least <= beta <= largest):
            raise ValueError(
                f"`alpha` and `beta` must lie between {least:g} and {largest:g}, got {alpha:.3g} and {beta:.3g}"
            )
    least, largest = family.cov
    if family.is_positive and not least <= sd / mean <= largest:
        raise ValueError(f"the coefficient of variation must lie between {least:g} and {largest:g}, got {sd / mean:g}")
    return mean, sd


def moments(
    distribution: Distribution, low: float | None, high: float | None, parameters: Mapping[str, float]
) -> tuple[float, float]:
    """Mean and standard deviation of an unbounded distribution, or of a beta between its bounds, by any parameters.

    Args:
        distribution: name of the distribution; one that has parameters.
        low, high: bounds of the variable; only a beta distribution needs and uses them.
        parameters: the numbers by name, one of the family's `sets`.

    Raises:
        KeyError: if a parameter is missing.
        OverflowError: if a moment exceeds the largest number.
    """
    if "mean" in parameters:
        mean = parameters["mean"]
        if distribution == "exponential":
            return mean, mean
        return mean, parameters["sd"] if "sd" in parameters else parameters["cov"] * abs(mean)
    match distribution:
        case "lognormal":
            variance = parameters["dispersion"] ** 2
            mean = parameters["median"] * math.exp(0.5 * variance)
            return mean, mean * math.sqrt(math.expm1(variance))
        case "gumbel_max" | "gumbel_min":
            sign = 1.0 if distribution == "gumbel_max" else -1.0
            mean = parameters["location"] + sign * np.euler_gamma * parameters["scale"]
            return mean, parameters["scale"] * math.pi / math.sqrt(6.0)
        case "weibull":
            mean = parameters["scale"] * math.gamma(1.0 + 1.0 / parameters["shape"])
            return mean, mean * _weibull_cov(parameters["shape"])
        case "gamma":
            return parameters["shape"] * parameters["scale"], math.sqrt(parameters["shape"]) * parameters["scale"]
        case "beta":
            assert low is not None
            assert high is not None
            alpha, beta = parameters["alpha"], parameters["beta"]
            share = alpha / (alpha + beta)
            return low + (high - low) * share, (high - low) * math.sqrt(share * (1.0 - share) / (alpha + beta + 1.0))
        case _:
            return 1.0 / parameters["rate"], 1.0 / parameters["rate"]


def _weibull_cov(shape: float) -> float:
    """Coefficient of variation of a Weibull distribution."""
    return math.sqrt(math.expm1(math.lgamma(1.0 + 2.0 / shape) - 2.0 * math.lgamma(1.0 + 1.0 / shape)))


def beta_shapes(low: float, high: float, mean: float, sd: float) -> tuple[float, float]:
    """Alpha and beta of a beta distribution between two bounds.

    Args:
        low, high: the bounds.
        mean, sd: its moments; both results are positive if low < mean < high and sd² < (mean − low)(high − mean).
    """
    share = (mean - low) / (high - low)
    total = share * (1.0 - share) * ((high - low) / sd) ** 2 - 1.0
    return share * total, (1.0 - share) * total


@lru_cache(maxsize=1024)
def law_of(distribution: Distribution, low: float, high: float, mean: float, sd: float | None) -> "rv_frozen":
    """SciPy's distribution before truncation.

    Args:
        distribution: name of the distribution; neither uniform nor log-uniform.
        low, high: bounds of a beta distribution; others ignore them.
        mean, sd: its moments, for which `checked_moments` finds no fault.

    Raises:
        ValueError: if no Weibull distribution with a shape between 0.1 and 10,000 has these moments.
    """
    # Imported here: importing scipy.stats takes longer than a thousand simulations of a bearing.
    from scipy import stats
    from scipy.optimize import brentq

    sd = mean if sd is None else sd
    match distribution:
        case "lognormal":
            dispersion = math.sqrt(math.log1p((sd / mean) ** 2))
            return stats.lognorm(dispersion, scale=mean * math.exp(-0.5 * dispersion**2))
        case "gumbel_max" | "gumbel_min":
            scale = sd * math.sqrt(6.0) / math.pi
            if distribution == "gumbel_max":
                return stats.gumbel_r(mean - np.euler_gamma * scale, scale)
            return stats.gumbel_l(mean + np.euler_gamma * scale, scale)
        case "weibull":
            cov, ends = sd / mean, (math.log(_LEAST_SHAPE), math.log(_LARGEST_SHAPE))
            shape = math.exp(brentq(lambda k: _weibull_cov(math.exp(k)) - cov, *ends, xtol=1e-14))
            return stats.weibull_min(shape, scale=mean / math.gamma(1.0 + 1.0 / shape))
        case "gamma":
            return stats.gamma((mean / sd) ** 2, scale=sd * sd / mean)
        case "beta":
            return stats.beta(*beta_shapes(low, high, mean, sd), low, high - low)
        case "exponential":
            return stats.expon(scale=mean)
        case _:
            return stats.norm(mean, sd)
