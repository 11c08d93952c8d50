"""Distributions of one variable by mean and standard deviation or by their own parameters; SciPy computes them."""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

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

NATURAL_PARAMETERS: dict[Distribution, tuple[str, ...]] = {
    "lognormal": ("median", "dispersion"),
    "gumbel_max": ("location", "scale"),
    "gumbel_min": ("location", "scale"),
    "weibull": ("shape", "scale"),
    "gamma": ("shape", "scale"),
    "beta": ("alpha", "beta"),
    "exponential": ("rate",),
}
"""Parameters that define a distribution without mean and sd.

`dispersion` is the standard deviation of the logarithm. `location` of a Gumbel distribution is its mode.
"""

BOUNDED = ("uniform", "log_uniform", "truncated_normal", "beta")
"""Distributions that need both bounds."""

POSITIVE = ("lognormal", "weibull", "gamma", "exponential")
"""Distributions of positive variables."""

_BY_BOUNDS_ALONE = ("uniform", "log_uniform")

_IN_WORDS = {
    "log_uniform": "log-uniform",
    "gumbel_max": "Gumbel (max)",
    "gumbel_min": "Gumbel (min)",
    "weibull": "Weibull",
}


def in_words(distribution: Distribution) -> str:
    """The distribution's name in a sentence."""
    return _IN_WORDS.get(distribution, distribution.replace("_", " "))


PARAMETERS = ("mean", "sd", "cov", *dict.fromkeys(name for names in NATURAL_PARAMETERS.values() for name in names))
"""Names of all parameters of distributions."""

_LARGEST = 1e100
"""Largest mean and sd."""

_COV = {"lognormal": (1e-6, 1e3), "weibull": (1e-3, 100.0), "gamma": (1e-3, 3.0), "exponential": (1.0, 1.0)}
"""Coefficients of variation between which SciPy's quantiles are accurate in both tails."""

_BETA_SHAPES = (0.5, 500.0)
"""Range of a beta distribution's shapes, for the same reason."""

_LEAST_SHAPE, _LARGEST_SHAPE = 0.1, 1e4
"""Range of a Weibull distribution's shape that holds these coefficients of variation."""


def sets_of_parameters(distribution: Distribution) -> tuple[tuple[str, ...], ...]:
    """The alternative sets of parameters: each one defines the distribution between its bounds."""
    if distribution in _BY_BOUNDS_ALONE:
        return ((),)
    by_mean = (("mean",),) if distribution == "exponential" else (("mean", "sd"), ("mean", "cov"))
    return (*by_mean, *((NATURAL_PARAMETERS[distribution],) if distribution in NATURAL_PARAMETERS else ()))


def parameters_fault(
    distribution: Distribution, low: float | None, high: float | None, parameters: Mapping[str, float]
) -> str:
    """Why bounds and parameters do not define a distribution; empty if they do.

    Args:
        distribution: name of the distribution.
        low, high: bounds of the variable, if any.
        parameters: the numbers by name.
    """
    sets = sets_of_parameters(distribution)
    name = f"{'an' if distribution == 'exponential' else 'a'} {in_words(distribution)} distribution"
    if set(parameters) not in map(set, sets):
        needed = ", or ".join(" and ".join(f"`{one}`" for one in names) for names in sets if names)
        needs = f"{name} requires {needed}" if needed else f"{name} takes only `low` and `high`"
        shown = " and ".join(f"`{key} = {number:g}`" for key, number in parameters.items()) or "none of them"
        return f"{needs}; got {shown}"
    if distribution in BOUNDED and (low is None or high is None):
        return f"{name} requires `low` and `high`"
    for key, number in parameters.items():
        if not math.isfinite(number):
            return f"`{key}` must be finite, got {number}"
        positive = key not in ("mean", "location") or (key == "mean" and distribution in POSITIVE)
        if positive and not number > 0.0:
            return f"`{key} > 0` must hold, got {number}"
    if "cov" in parameters and parameters["mean"] == 0.0:
        return "a coefficient of variation requires a mean other than 0"
    if parameters:
        try:
            mean, sd = moments(distribution, low, high, parameters)
        except OverflowError:
            mean = sd = math.inf
        if not (abs(mean) <= _LARGEST and sd <= _LARGEST):
            return f"mean and sd must be at most {_LARGEST:g}, got {mean:g} and {sd:g}"
        if sd < 1.0 / _LARGEST:
            return f"the sd must be at least {1.0 / _LARGEST:g}, got {sd:g}"
    if distribution in POSITIVE and low is not None and low < 0.0:
        return f"`low >= 0` must hold for {name}, got {low}"
    if distribution == "beta" and low is not None and high is not None:
        # A beta distribution's variance is less than (mean − low)(high − mean).
        possible = low < mean < high and sd * sd < (mean - low) * (high - mean)
        if not possible:
            return f"no beta distribution between {low:g} and {high:g} has mean {mean:g} and sd {sd:g}"
    if distribution == "beta":
        assert low is not None
        assert high is not None
        shapes = beta_shapes(low, high, mean, sd)
        if not all(_BETA_SHAPES[0] <= shape <= _BETA_SHAPES[1] for shape in shapes):
            return (
                f"`alpha` and `beta` must lie between {_BETA_SHAPES[0]:g} and {_BETA_SHAPES[1]:g}, got "
                f"{shapes[0]:.3g} and {shapes[1]:.3g}"
            )
    if distribution in POSITIVE:
        least, largest = _COV[distribution]
        if not least <= sd / mean <= largest:
            return f"the coefficient of variation must lie between {least:g} and {largest:g}, got {sd / mean:g}"
    return ""


def moments(
    distribution: Distribution, low: float | None, high: float | None, parameters: Mapping[str, float]
) -> tuple[float, float]:
    """Mean and standard deviation of an unbounded distribution, or of a beta between its bounds, by any parameters.

    Args:
        distribution: name of the distribution; one that has parameters.
        low, high: bounds of the variable; only a beta distribution needs and uses them.
        parameters: the numbers by name, one of `sets_of_parameters`.

    Raises:
        KeyError: if a parameter is missing.
        OverflowError: if a moment exceeds the largest number.
    """
    if "mean" in parameters:
        mean = parameters["mean"]
        if distribution == "exponential":
            return mean, mean
        return mean, parameters["sd"] if "sd" in parameters else parameters["cov"] * abs(mean)
    if distribution == "beta":
        assert low is not None
        assert high is not None
        alpha, beta = parameters["alpha"], parameters["beta"]
        share = alpha / (alpha + beta)
        return low + (high - low) * share, (high - low) * math.sqrt(share * (1.0 - share) / (alpha + beta + 1.0))
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


def quantiles_at(distribution: Distribution, mean: float, sd: float, distance: float) -> tuple[float, float]:
    """The quantiles of an unbounded distribution that correspond to ∓`distance` standard deviations of a normal one.

    Args:
        distribution: name of the distribution; not beta.
        mean, sd: its moments, as for `frozen`.
        distance: not negative.
    """
    beyond = 0.5 * math.erfc(distance / math.sqrt(2.0))
    law = frozen(distribution, 0.0, 0.0, mean, sd)
    return float(law.ppf(beyond)), float(law.isf(beyond))


@lru_cache(maxsize=1024)
def frozen(distribution: Distribution, low: float, high: float, mean: float, sd: float) -> "rv_frozen":
    """SciPy's distribution with a mean and a standard deviation.

    Args:
        distribution: name of the distribution; a truncated normal one gives the normal distribution before truncation.
        low, high: bounds of a beta distribution; others ignore them.
        mean, sd: its moments, for which `parameters_fault` finds no fault.

    Raises:
        ValueError: if no Weibull distribution with a shape between 0.1 and 10,000 has these moments.
    """
    # Imported here: importing scipy.stats takes longer than a thousand simulations of a bearing.
    from scipy import stats
    from scipy.optimize import brentq

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
            target = sd / mean
            log_shape: Any = brentq(
                lambda k: _weibull_cov(math.exp(k)) - target,
                math.log(_LEAST_SHAPE),
                math.log(_LARGEST_SHAPE),
                xtol=1e-14,
            )
            shape = math.exp(log_shape)
            return stats.weibull_min(shape, scale=mean / math.gamma(1.0 + 1.0 / shape))
        case "gamma":
            return stats.gamma((mean / sd) ** 2, scale=sd * sd / mean)
        case "beta":
            return stats.beta(*beta_shapes(low, high, mean, sd), low, high - low)
        case "exponential":
            return stats.expon(scale=mean)
        case _:
            return stats.norm(mean, sd)
