"""One variable of the design space: its name, distribution and unit, and its values if it has a step or choices."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from activefail.distributions import BOUNDED, POSITIVE, Distribution, frozen, in_words, parameters_fault
from activefail.errors import InputError

if TYPE_CHECKING:
    from scipy.stats.distributions import rv_frozen

Array = NDArray[np.float64]

_LEAST_MASS = 1e-6
"""Least probability of a distribution between its bounds: far out in a tail, rounding destroys its quantiles."""


_NARROWEST = 1e-9
"""Least width of a range relative to its larger bound: a narrower one contains too few numbers."""


def distribution_fault(
    low: float, high: float, distribution: Distribution, mean: float | None, sd: float | None
) -> str:
    """Why the numbers of a `Parameter` do not define a distribution; empty if they do."""
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        return f"`low < high` must hold, got {low} and {high}"
    if high - low < _NARROWEST * max(abs(low), abs(high)):
        return (
            f"`high - low` must be at least {_NARROWEST:g} times the larger of |low| and |high|, got {low} and {high}"
        )
    if distribution == "log_uniform" and low <= 0.0:
        return f"`low > 0` must hold for a log-uniform distribution, got {low}"
    numbers = {name: number for name, number in (("mean", mean), ("sd", sd)) if number is not None}
    if fault := parameters_fault(distribution, low, high, numbers):
        return fault
    if mean is not None and distribution != "beta":
        _, mass, _ = _masses(distribution, low, high, mean, sd)
        if not mass >= _LEAST_MASS:
            return (
                f"{low} to {high} must contain at least {_LEAST_MASS:g} of the {in_words(distribution)} "
                f"distribution, got {mass:.1g}"
            )
    return ""


_MOST_VALUES = 10_000
"""Most values of a variable with a step."""

_ON_GRID = 1e-9
"""Largest distance of a value from that of a variable with a step, in steps: a table may have rounded it."""


def step_fault(low: float, high: float, step: float, distribution: Distribution) -> str:
    """Why bounds and a step do not define the values of a variable; empty if they do."""
    if not (np.isfinite(step) and step > 0.0):
        return f"`step > 0` must hold, got {step}"
    steps = (Decimal(repr(high)) - Decimal(repr(low))) / Decimal(repr(step))
    if steps % 1 or steps < 1:
        return f"`high - low` must be a multiple of `step`, got {low:g} to {high:g} in steps of {step:g}"
    if steps >= _MOST_VALUES:
        return f"`step` must leave at most {_MOST_VALUES} values, got {int(steps) + 1}"
    if distribution == "log_uniform" and low <= 0.5 * step:
        return f"`low > step / 2` must hold for a log-uniform distribution, got {low:g} and {step:g}"
    return ""


Choice = str | int | float
"""A value of a variable with choices, as the campaign file has it."""


def exact(value: Choice) -> str:
    """A value as text with all digits."""
    return value if isinstance(value, str) else repr(value)


MOST_CHOICES, MOST_WITH_FEATURES = 100, 1000
"""Most choices that are features of the classifier, each by itself; and that have features."""

_LABEL = re.compile(r"""[^\W_](?:[^"'`\\$;|&<>*?!{}]*[^"'`\\$;|&<>*?!{}\s])?""")
"""A text among choices. Spreadsheets, shells and templates take it for nothing else."""


def choices_fault(choices: Sequence[Choice], probabilities: Sequence[float], most: int = MOST_CHOICES) -> str:
    """Why choices and their probabilities, if there are any, do not define a variable; empty if they do."""
    listed = list(choices)
    if not 2 <= len(listed) <= most:
        return f"`choices` must have 2 to {most} entries, got {listed}"
    if len({isinstance(one, str) for one in listed}) > 1:
        return f"`choices` must be texts or numbers, not both, got {listed}"
    for one in listed:
        if listed.count(one) > 1:
            return f"`choices` must differ from each other, got {one!r} twice"
        if isinstance(one, str) and not (_LABEL.fullmatch(one) and one.isprintable()):
            return (
                "a text in `choices` must begin with a letter or digit, and contain neither quotes nor any of "
                f"\\$;|&<>*?!{{}} nor a space at its end, got {one!r}"
            )
    if not probabilities:
        return ""
    if len(probabilities) != len(listed):
        return f"`probabilities` must have one number for each of {len(listed)} choices, got {list(probabilities)}"
    if min(probabilities) <= 0.0 or abs(math.fsum(probabilities) - 1.0) > _SUM:
        total = math.fsum(probabilities)
        return f"`probabilities` must be positive with the sum 1, got {list(probabilities)} with the sum {total:.6g}"
    return ""


_SUM = 1e-6
"""Largest distance of the sum of probabilities from 1."""


class Payload(Protocol):
    """What the choices of a variable stand for, such as the records of a set. To pickle it pickles no object."""

    @property
    def level(self) -> str:
        """The quantity that scales the object; empty if none does."""
        ...

    @property
    def feature_names(self) -> tuple[str, ...]:
        """The names of the features by which the classifier sees the variable."""
        ...

    def __call__(self) -> Sequence[Any]:
        """The object of each choice."""
        ...

    def factors(self, which: NDArray[np.intp], quantities: Mapping[str, Any]) -> Array:
        """By what the object of each design is multiplied, (n,); see `features`."""
        ...

    def in_design(self, number: int, quantities: Mapping[str, Any]) -> Any:
        """The object of a choice, as a simulator gets it in a design with these quantities."""
        ...

    def features(self, which: NDArray[np.intp], quantities: Mapping[str, Any]) -> Array:
        """The positive features of designs, (n, m), by the number of their choice, (n,), and their quantities."""
        ...


Features = tuple[tuple[str, tuple[float, ...]], ...]
"""Quantities that follow from a choice: by name, the number of each choice."""


def features_fault(features: Mapping[str, Sequence[float]], choices: Sequence[Choice]) -> str:
    """Why quantities by name do not tell choices apart; empty if they do."""
    for name, numbers in features.items():
        if not name.isidentifier():
            return f"a name in `features` must be an identifier, got {name!r}"
        if len(numbers) != len(choices):
            return f"`features` must have one number of {name} for each of {len(choices)} choices, got {list(numbers)}"
    rows = list(zip(*features.values(), strict=True))
    for row, choice in zip(rows, choices, strict=False):
        if (other := choices[rows.index(row)]) != choice:
            return f"`features` must tell all choices apart, but those of {other!r} and {choice!r} are equal"
    return "" if rows else "`features` must have at least one quantity"


def _masses(
    distribution: Distribution, low: float, high: float, mean: float, sd: float | None
) -> tuple[float, float, float]:
    """Mass of a distribution below the lower bound, between the bounds, and above the upper bound."""
    if distribution in ("truncated_normal", "normal"):
        assert sd is not None
        normal = NormalDist(mean, sd)
        below = normal.cdf(low)
        return below, normal.cdf(high) - below, NormalDist(-mean, sd).cdf(-high)
    law = frozen(distribution, low, high, mean, mean if sd is None else sd)
    below, above = float(law.cdf(low)), float(law.sf(high))
    return below, 1.0 - below - above, above


_FARTHEST = 9.0
"""Largest standard normal value of a variable's value: the probability beyond is 10⁻¹⁹."""


def _normal_quantile(p: Array, q: Array) -> Array:
    """Φ⁻¹ of the probabilities p below and q = 1 − p above a value, within ±`_FARTHEST`."""
    from scipy.special import ndtri

    z = np.where(p <= 0.5, ndtri(np.clip(p, 0.0, 1.0)), -ndtri(np.clip(q, 0.0, 1.0)))
    return np.asarray(np.clip(z, -_FARTHEST, _FARTHEST))


@dataclass(frozen=True)
class Parameter:
    """One variable of the design space, between `low` and `high` (in `unit`).

    Its distribution is the named one conditional on these bounds.

    With a step, the values are low, low + step, ..., high. Each has the probability of all values that are rounded to
    it: of the named distribution between half a step below `low` and half a step above `high`, or of a beta
    distribution between the bounds.

    With choices, which have no order, the values are their numbers 0, 1, ..., so that designs are arrays. `written` and
    `number_of` lead to the choices and back, at every place where people or simulators see them.

    Attributes:
        name: an identifier.
        low, high: bounds, in the unit.
        unit: for tables and axes; empty for a number without one.
        distribution: name of the distribution.
        mean, sd: mean and standard deviation of the unbounded distribution, or of a beta distribution; None for uniform
            and log-uniform variables. The sd of an exponential variable is None.
        step: distance of the values, in the unit; None if the variable is continuous.
        choices: texts or numbers; empty for other variables.
        probabilities: of the choices.
        groups: of each choice, what it belongs to: the event of a record. Choices of one group are not independent
            samples of their kind. None if the choices are no sample.
        payload: what the choices stand for; None if they are nothing but texts or numbers.
        features: quantities that follow from the choice. The classifier sees them in place of the choice.

    Raises:
        InputError: if the name is not an identifier or the numbers do not define a distribution.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    distribution: Distribution = "uniform"
    mean: float | None = None
    sd: float | None = None
    step: float | None = field(default=None, repr=False)  # questions are identified by what is shown of variables
    choices: tuple[Choice, ...] = field(default=(), repr=False)
    probabilities: tuple[float, ...] = field(default=(), repr=False)
    groups: tuple[str, ...] | None = field(default=None, repr=False)
    payload: Payload | None = field(default=None, repr=False)
    features: Features = field(default=(), repr=False)

    @classmethod
    def of_choices(
        cls,
        name: str,
        choices: Sequence[Choice],
        probabilities: Sequence[float] = (),
        unit: str = "",
        features: Features = (),
    ) -> "Parameter":
        """A variable with choices, equally probable unless probabilities are given.

        Raises:
            InputError: if they break a rule.
        """
        fault = choices_fault(choices, probabilities, MOST_CHOICES if not features else MOST_WITH_FEATURES)
        if fault := fault or (features_fault(dict(features), choices) if features else ""):
            raise InputError(f"The variable {name!r}: {fault}.")
        shares, last = tuple(probabilities) or (1.0 / len(choices),) * len(choices), len(choices) - 1.0
        return cls(
            name, 0.0, last, unit, step=1.0, choices=tuple(choices), probabilities=shares, features=tuple(features)
        )

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InputError(f"A variable's name must be an identifier, got {self.name!r}.")
        fault = distribution_fault(self.low, self.high, self.distribution, self.mean, self.sd)
        if not fault and self.step is not None:
            fault = step_fault(self.low, self.high, self.step, self.distribution)
        if fault:
            raise InputError(f"The variable {self.name!r}: {fault}.")

    @cached_property
    def values(self) -> Array:
        """The values of a variable with a step, as decimal numbers are written; empty if it is continuous."""
        if self.step is None:
            return np.empty(0)
        low, high, step = (Decimal(repr(number)) for number in (self.low, self.high, self.step))
        return np.array([float(low + k * step) for k in range(int((high - low) / step) + 1)])

    @cached_property
    def continuous(self) -> "Parameter":
        """The variable before it is rounded to its step; itself without one, or with choices."""
        if self.step is None or self.choices:
            return self
        if self.distribution == "beta":
            return replace(self, step=None)
        low, high = self.low - 0.5 * self.step, self.high + 0.5 * self.step
        return replace(self, low=max(low, 0.0) if self.distribution in POSITIVE else low, high=high, step=None)

    @cached_property
    def shares(self) -> Array:
        """The probabilities of `values`; empty if the variable is continuous."""
        if self.step is None or self.choices:
            return np.array(self.probabilities)
        of, half = self.continuous, 0.5 * self.step
        ends = of.share(np.clip(np.append(self.values - half, self.values[-1] + half), of.low, of.high))
        return np.asarray(np.diff(ends))

    @property
    def _is_rounded(self) -> bool:
        return self.step is not None and not self.choices

    @property
    def is_whole(self) -> bool:
        """Whether all values are whole numbers."""
        is_whole = self.step is not None and float(self.low).is_integer() and float(self.step).is_integer()
        return is_whole and not self.choices

    @property
    def has_texts(self) -> bool:
        """Whether the choices are texts."""
        return bool(self.choices) and isinstance(self.choices[0], str)

    def column(self, x: Array) -> NDArray[Any]:
        """Values, (n,), as people and simulators see them: choices, whole numbers as integers, or the values."""
        if self.choices:
            choices = np.array(self.choices, dtype=object if self.has_texts else None)
            return np.asarray(choices[np.asarray(x).astype(int)])
        return np.rint(x).astype(np.int64) if self.is_whole and self.on_grid(x).all() else x

    def written(self, x: float) -> Choice:
        """A value as people and simulators see it (see `column`)."""
        (written,) = self.column(np.array([x])).tolist()
        return written  # type: ignore[no-any-return]

    def number_of(self, value: object) -> float:
        """The number of a choice, the inverse of `written`.

        Raises:
            ValueError: if it is no choice; the text is the rule.
        """
        choices: list[Choice] = list(self.choices)
        try:
            # A table may hold the text 1 as a number, or the number 1 as a text.
            return float(choices.index(str(value).strip() if self.has_texts else float(str(value))))
        except ValueError:
            raise ValueError(self.rule) from None

    def quantities(self, x: Any) -> Any:
        """Values of any shape as expressions and formulas take them: numbers among choices; other values stay."""
        if not self.choices or self.has_texts:
            return x
        return np.asarray(np.array(self.choices, dtype=np.float64)[np.asarray(x).astype(int)])

    def carried(self, x: Any) -> dict[str, Any]:
        """The features of choices of any shape, by name."""
        return {name: np.array(numbers)[np.asarray(x).astype(int)] for name, numbers in self.features}

    def indicators(self, x: Array) -> Array:
        """Which choice each value is, (n,) -> (n, k), as 0 and 1; of two choices the second, (n, 1)."""
        which = np.asarray(x).astype(int)
        return np.asarray(np.eye(len(self.choices))[which, len(self.choices) == 2 :])

    def rounded(self, x: Array | float) -> Array:
        """Values of any shape, each as the nearest value of the variable; unchanged if it is continuous."""
        if self.step is None:
            return np.asarray(x)
        place = np.clip(np.rint((np.asarray(x) - self.low) / self.step), 0, len(self.values) - 1)
        return np.asarray(np.where(np.isnan(place), np.nan, self.values[np.nan_to_num(place).astype(int)]))

    def contains(self, x: Array | float) -> NDArray[np.bool_]:
        """Which values of any shape the variable can have."""
        return np.asarray(self.spans(x) & self.on_grid(x))

    def spans(self, x: Array | float) -> NDArray[np.bool_]:
        """Which values of any shape lie between the bounds, also between steps."""
        return np.asarray((self.low - self._rounding <= x) & (x <= self.high + self._rounding))

    @property
    def _rounding(self) -> float:
        return 0.0 if self.step is None else _ON_GRID * self.step

    def on_grid(self, x: Array | float) -> NDArray[np.bool_]:
        """Which values of any shape are whole steps from `low`; all if the variable is continuous."""
        if self.step is None:
            return np.ones(np.shape(x), dtype=bool)
        steps = (np.asarray(x) - self.low) / self.step
        return np.asarray(np.abs(steps - np.rint(steps)) <= _ON_GRID)

    @property
    def rule(self) -> str:
        """Which values the variable can have, for messages."""
        if self.choices:
            return f"must be one of {', '.join(map(str, self.choices))}"
        steps = "" if self.step is None else f" in steps of {self.step:g}"
        return f"`{self.low:g} <= {self.name} <= {self.high:g}`{steps} must hold"

    @cached_property
    def _shares_below(self) -> Array:
        """The probability of all choices before each, and of all, (k + 1,); exactly 1 after the last possible one."""
        shares = np.cumsum(self.probabilities)
        return np.concatenate([[0.0], shares / shares[-1]])

    @property
    def _moments(self) -> tuple[float, float]:
        """Mean and standard deviation of a distribution that has them."""
        assert self.mean is not None
        return self.mean, self.mean if self.sd is None else self.sd

    def _masses(self) -> tuple[float, float, float]:
        return _masses(self.distribution, self.low, self.high, *self._moments)

    @property
    def _law(self) -> "rv_frozen":
        return frozen(self.distribution, self.low, self.high, *self._moments)

    @property
    def outside(self) -> float:
        """The probability of the unbounded distribution outside the bounds; 0 for a distribution that has bounds."""
        if self.distribution in BOUNDED:
            return 0.0
        below, _, above = self.continuous._masses()
        return below + above

    def quantile(self, u: Array | float) -> Array:
        """Quantiles of the distribution at probabilities u of any shape."""
        u = np.asarray(u)
        if self.choices:
            # Below 1, which only choices without probability follow.
            u = np.minimum(u, np.nextafter(1.0, 0.0))
            return np.searchsorted(self._shares_below[1:-1], u, side="right").astype(np.float64)
        if self._is_rounded:
            return self.rounded(self.continuous.quantile(u))
        match self.distribution:
            case "uniform":
                return np.asarray(self.low + u * (self.high - self.low))
            case "log_uniform":
                return np.asarray(self.low * (self.high / self.low) ** u)
            case "truncated_normal":
                from scipy.special import ndtri

                (mean, sd), (below, mass, _) = self._moments, self._masses()
                return np.asarray(mean + sd * ndtri(below + u * mass))
            case _:
                return self._between(u, 1.0 - u)

    def share(self, x: Array) -> Array:
        """The distribution function at values x of any shape, the inverse of `quantile`.

        With a step, the middle of the probabilities that are rounded to x. With choices, the middle of that of x.
        """
        if self.choices:
            return np.interp(x, self.values, 0.5 * (self._shares_below[:-1] + self._shares_below[1:]))
        if self.step is not None:
            of, half = self.continuous, 0.5 * self.step
            ends = [of.share(np.clip(np.asarray(x) + side, of.low, of.high)) for side in (-half, half)]
            return np.asarray(0.5 * (ends[0] + ends[1]))
        match self.distribution:
            case "uniform":
                return np.asarray((x - self.low) / (self.high - self.low))
            case "log_uniform":
                return np.asarray(np.log(x / self.low) / np.log(self.high / self.low))
            case "truncated_normal":
                from scipy.special import ndtr

                (mean, sd), (below, mass, _) = self._moments, self._masses()
                return np.asarray((ndtr((x - mean) / sd) - below) / mass)
            case _:
                below, mass, _ = self._masses()
                return np.asarray((self._law.cdf(x) - below) / mass)

    def _between(self, p: Array, q: Array) -> Array:
        """Values with probability p below and q = 1 − p above them; both are used, for accuracy in either tail."""
        below, mass, above = self._masses()
        law = self._law
        x = np.where(p <= 0.5, law.ppf(below + p * mass), law.isf(above + q * mass))
        return np.asarray(np.clip(x, self.low, self.high))

    def from_normal(self, z: Array) -> Array:
        """The variable's values at standard normal values z of any shape: F⁻¹(Φ(z)), accurate in both tails."""
        from scipy.special import ndtr

        if self._is_rounded:
            return self.rounded(self.continuous.from_normal(z))
        if self.distribution in ("uniform", "log_uniform"):
            return self.quantile(ndtr(z))
        return self._between(ndtr(z), ndtr(-z))

    def to_normal(self, x: Array) -> Array:
        """Standard normal values at values x of any shape: Φ⁻¹(F(x)), the inverse of `from_normal`.

        They are finite at the bounds too.
        """
        if self.step is not None or self.distribution in ("uniform", "log_uniform"):
            u = self.share(x)
            return _normal_quantile(u, 1.0 - u)
        below, mass, above = self._masses()
        law = self._law
        return _normal_quantile((law.cdf(x) - below) / mass, (law.sf(x) - above) / mass)

    def standardised(self, x: Array) -> Array:
        """Values in standard deviations from the middle.

        The middle of a truncated normal is its mean before truncation. A log-uniform variable enters as its logarithm,
        and a variable whose bounds are left out as its standard normal value.
        """
        if self._is_rounded:
            return self.continuous.standardised(x)
        if self.distribution in ("truncated_normal", "normal"):
            mean, sd = self._moments
            return np.asarray((x - mean) / sd)
        if self.distribution in BOUNDED:
            return np.asarray(np.sqrt(12.0) * (self.share(x) - 0.5))
        return _normal_quantile(self._law.cdf(x), self._law.sf(x))

    def widened(self, x: Array, factor: float) -> Array:
        """Values stretched about the middle and clipped to the bounds; those of a bounded distribution do not change.

        A normal variable is stretched about its mean, another in standard normal values before truncation.

        Args:
            x: values.
            factor: factor of the standard deviation.
        """
        if self._is_rounded:
            return self.rounded(self.continuous.widened(x, factor))
        if self.distribution in ("truncated_normal", "normal"):
            mean, _ = self._moments
            return np.asarray(np.clip(mean + factor * (x - mean), self.low, self.high))
        if self.distribution in BOUNDED:
            return np.asarray(x)
        from scipy.special import ndtr

        z = factor * self.standardised(x)
        stretched = np.where(z <= 0.0, self._law.ppf(ndtr(z)), self._law.isf(ndtr(-z)))
        return np.asarray(np.clip(stretched, self.low, self.high))

    @property
    def label(self) -> str:
        """The name with its unit, for tables and axes."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name
