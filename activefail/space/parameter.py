"""One variable of the design space: its name, distribution and unit, and its values if it has a step or choices."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.space.distributions import FAMILIES, Distribution, Family, checked_moments, law_of

if TYPE_CHECKING:
    from scipy.stats.distributions import rv_frozen

Array = NDArray[np.float64]

LARGEST = 1e75
"""Largest magnitude of a value, whose fourth power is still finite."""

_NARROWEST = 1e-9
"""Least width of a range relative to its larger bound: a narrower one contains too few numbers."""

_LEAST_MASS = 1e-6
"""Least probability of a distribution between its bounds: far out in a tail, rounding destroys its quantiles."""

_NORMAL = ("truncated_normal", "normal")

_MOST_VALUES = 10_000
"""Most values of a variable with a step."""

_ON_GRID = 1e-9
"""Largest distance of a value from that of a variable with a step, in steps: a table may have rounded it."""

_SUM = 1e-6
"""Largest distance of the sum of probabilities from 1."""

MOST_CHOICES, MOST_CARRIED = 100, 1000
"""Most choices that are features of the classifier, each by itself; and that have features, or are records."""

_LABEL = re.compile(r"""[^\W_](?:[^"'`\\$;|&<>*?!{}]*[^"'`\\$;|&<>*?!{}\s])?""")
"""A text among choices. Spreadsheets, shells and templates take it for nothing else."""

Choice = str | int | float
"""A value of a variable with choices, as the campaign file has it."""

Features = tuple[tuple[str, tuple[float, ...]], ...]
"""Quantities that follow from a choice: by name, the number of each choice."""


def exact(value: Choice) -> str:
    """A value as text with all digits."""
    return value if isinstance(value, str) else repr(value)


def _steps(low: float, high: float, step: float) -> Array:
    """The values low, low + step, ..., high, as decimal numbers are written.

    Raises:
        ValueError: if there are none, or very many.
    """
    if not (np.isfinite(step) and step > 0.0):
        raise ValueError(f"`step > 0` must hold, got {step}")
    first, last, width = (Decimal(repr(number)) for number in (low, high, step))
    count = (last - first) / width
    if count % 1 or count < 1:
        raise ValueError(f"`high - low` must be a multiple of `step`, got {low:g} to {high:g} in steps of {step:g}")
    if count >= _MOST_VALUES:
        raise ValueError(f"`step` must leave at most {_MOST_VALUES} values, got {int(count) + 1}")
    return np.array([float(first + k * width) for k in range(int(count) + 1)])


def _no_probabilities(shares: Sequence[float]) -> ValueError:
    rule = "`probabilities` must be positive with the sum 1"
    return ValueError(f"{rule}, got {list(shares)} with the sum {math.fsum(shares):.6g}")


def _check_choices(choices: Sequence[Choice], shares: Sequence[float], features: Features) -> None:
    """Check that choices, their probabilities and their features define a variable.

    Raises:
        ValueError: naming the rule and the value.
    """
    if len({isinstance(one, str) for one in choices}) > 1:
        raise ValueError(f"`choices` must be texts or numbers, not both, got {list(choices)}")
    for choice, times in Counter(choices).items():
        if times > 1:
            raise ValueError(f"`choices` must differ from each other, got {choice!r} twice")
        if isinstance(choice, str) and not (_LABEL.fullmatch(choice) and choice.isprintable()):
            raise ValueError(
                "a text in `choices` must begin with a letter or digit, and contain neither quotes nor any of "
                f"\\$;|&<>*?!{{}} nor a space at its end, got {choice!r}"
            )
    if len(shares) != len(choices):
        raise ValueError(f"`probabilities` must have one number for each of {len(choices)} choices, got {list(shares)}")
    if min(shares) < 0.0 or abs(math.fsum(shares) - 1.0) > _SUM:
        raise _no_probabilities(shares)
    for name, numbers in features:
        if not name.isidentifier():
            raise ValueError(f"a name in `features` must be an identifier, got {name!r}")
        if len(numbers) != len(choices):
            raise ValueError(
                f"`features` must have one number of {name} for each of {len(choices)} choices, got {list(numbers)}"
            )
    others = dict[tuple[float, ...], Choice]()
    for row, choice in zip(zip(*(numbers for _, numbers in features), strict=True), choices, strict=False):
        if (other := others.setdefault(row, choice)) != choice:
            raise ValueError(f"`features` must tell all choices apart, but those of {other!r} and {choice!r} are equal")


@contextmanager
def _naming(variable: str) -> Iterator[None]:
    """Name the variable whose rule a ValueError states; its cause is the rule alone."""
    try:
        yield
    except ValueError as rule:
        raise InputError(f"The variable {variable!r}: {rule}.") from rule


_FARTHEST = 9.0
"""Largest standard normal value of a variable's value: the probability beyond is 10⁻¹⁹."""


def _normal_quantile(p: Array, q: Array) -> Array:
    """Φ⁻¹ of the probabilities p below and q = 1 − p above a value, within ±`_FARTHEST`."""
    from scipy.special import ndtri

    z = np.where(p <= 0.5, ndtri(np.clip(p, 0.0, 1.0)), -ndtri(np.clip(q, 0.0, 1.0)))
    return np.asarray(np.clip(z, -_FARTHEST, _FARTHEST))


class Payload(Protocol):
    """What the choices of a variable stand for, such as the records of a set. To pickle it pickles no object.

    Its optional attribute `notes` are sentences on the objects, which `activefail check` shows.
    """

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
    def of_distribution(
        cls,
        name: str,
        distribution: Distribution,
        parameters: Mapping[str, float],
        low: float | None = None,
        high: float | None = None,
        unit: str = "",
        step: float | None = None,
        distance: float = math.inf,
    ) -> "Parameter":
        """A variable by the parameters of its distribution.

        Args:
            name, low, high, unit, distribution, step: see the class.
            parameters: numbers by name, one of the family's sets (`activefail.space.distributions.Family`).
            distance: where bounds lie that are left out, in standard deviations of a normal variable.
        """
        with _naming(name):
            mean, sd = checked_moments(distribution, low, high, parameters)
            if low is None or high is None:
                if step is not None:
                    raise ValueError("a variable with a `step` requires `low` and `high`")
                assert mean is not None
                law, beyond = law_of(distribution, 0.0, 0.0, mean, sd), 0.5 * math.erfc(distance / math.sqrt(2.0))
                low, high = (
                    float(law.ppf(beyond)) if low is None else low,
                    float(law.isf(beyond)) if high is None else high,
                )
        return cls(name, low, high, unit, distribution, mean, None if distribution == "exponential" else sd, step)

    @classmethod
    def of_choices(
        cls,
        name: str,
        choices: Sequence[Choice],
        probabilities: Sequence[float] = (),
        unit: str = "",
        features: Features = (),
        groups: tuple[str, ...] | None = None,
        most: int = MOST_CHOICES,
    ) -> "Parameter":
        """A variable with choices, equally probable unless given probabilities; `most` without features or groups."""
        with _naming(name):
            if not 2 <= len(choices) <= (most := MOST_CARRIED if features or groups else most):
                raise ValueError(f"`choices` must have 2 to {most} entries, got {list(choices)}")
            if 0.0 in probabilities:  # as only a question has them, of the choices that it leaves out
                raise _no_probabilities(probabilities)
        shares, last = tuple(probabilities) or (1.0 / len(choices),) * len(choices), len(choices) - 1.0
        one = cls(name, 0.0, last, unit, step=1.0, choices=tuple(choices), probabilities=shares)
        return replace(one, groups=groups, features=tuple(features))

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InputError(f"A variable's name must be an identifier, got {self.name!r}.")
        with _naming(self.name):
            self._check()

    def _check(self) -> None:
        if self.choices:
            _check_choices(self.choices, self.probabilities, self.features)
        low, high, is_log = self.low, self.high, self.distribution == "log_uniform"
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ValueError(f"`low < high` must hold, got {low} and {high}")
        if high - low < _NARROWEST * max(abs(low), abs(high)):
            rule = f"`high - low` must be at least {_NARROWEST:g} times the larger of |low| and |high|"
            raise ValueError(f"{rule}, got {low} and {high}")
        if is_log and low <= 0.0:
            raise ValueError(f"`low > 0` must hold for a log-uniform distribution, got {low}")
        numbers = {name: number for name, number in (("mean", self.mean), ("sd", self.sd)) if number is not None}
        checked_moments(self.distribution, low, high, numbers)
        if numbers and self.distribution != "beta" and not self._masses[1] >= _LEAST_MASS:
            raise ValueError(
                f"{low} to {high} must contain at least {_LEAST_MASS:g} of the {self._family.words} distribution, got "
                f"{self._masses[1]:.1g}"
            )
        if len(self.values) and is_log and low <= 0.5 * (self.step or 0.0):
            rule = "`low > step / 2` must hold for a log-uniform distribution"
            raise ValueError(f"{rule}, got {low:g} and {self.step:g}")

    @cached_property
    def values(self) -> Array:
        """The values of a variable with a step, or the numbers of choices; empty if it is continuous."""
        return np.empty(0) if self.step is None else _steps(self.low, self.high, self.step)

    @cached_property
    def continuous(self) -> "Parameter":
        """The variable before it is rounded to its step; itself without one, or with choices."""
        if self.step is None or self.choices:
            return self
        if self.distribution == "beta":
            return replace(self, step=None)
        low, high = self.low - 0.5 * self.step, self.high + 0.5 * self.step
        return replace(self, low=max(low, 0.0) if self._family.is_positive else low, high=high, step=None)

    @cached_property
    def shares(self) -> Array:
        """The probabilities of `values`; empty if the variable is continuous."""
        return np.array(self.probabilities) if self.choices or self.step is None else np.diff(self._ends)

    @cached_property
    def _ends(self) -> Array:
        """The probability of all values before each, and of all, (k + 1,); exactly 1 after the last possible choice."""
        if self.choices:
            shares = np.cumsum(self.probabilities)
            return np.concatenate([[0.0], shares / shares[-1]])
        of, half = self.continuous, 0.5 * (self.step or 0.0)
        return of.share(np.clip(np.append(self.values - half, self.values[-1] + half), of.low, of.high))

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
        """The number of a value that people wrote, the inverse of `written`; it may lie beyond the bounds.

        Raises:
            ValueError: if the variable cannot have it; the text is the rule.
        """
        if self.choices:
            choices: list[Choice] = list(self.choices)
            try:
                # A table may hold the text 1 as a number, or the number 1 as a text.
                return float(choices.index(str(value).strip() if self.has_texts else float(str(value))))
            except ValueError:
                raise ValueError(self.rule) from None
        is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (is_number and -LARGEST <= value <= LARGEST):  # type: ignore[operator]
            raise ValueError(f"must be a number between {-LARGEST:g} and {LARGEST:g}")
        if not self.on_grid(float(value)):  # type: ignore[arg-type]
            raise ValueError(self.rule)
        return float(value)  # type: ignore[arg-type]

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
        rounding = _ON_GRID * (self.step or 0.0)
        return np.asarray((self.low - rounding <= x) & (x <= self.high + rounding))

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

    @property
    def _family(self) -> Family:
        return FAMILIES[self.distribution]

    @property
    def _law(self) -> "rv_frozen":
        assert self.mean is not None
        return law_of(self.distribution, self.low, self.high, self.mean, self.sd)

    @cached_property
    def _masses(self) -> tuple[float, float, float]:
        """The probability of the unbounded distribution below, between and above the bounds."""
        if self.distribution in _NORMAL and self.mean is not None and self.sd is not None:
            # SciPy has other last bits, and so would the designs of a seed.
            normal, mirrored = NormalDist(self.mean, self.sd), NormalDist(-self.mean, self.sd)
            below = normal.cdf(self.low)
            return below, normal.cdf(self.high) - below, mirrored.cdf(-self.high)
        below, above = float(self._law.cdf(self.low)), float(self._law.sf(self.high))
        return below, 1.0 - below - above, above

    @property
    def outside(self) -> float:
        """The probability of the unbounded distribution outside the bounds; 0 for a distribution that has bounds."""
        below, _, above = (0.0, 1.0, 0.0) if self._family.is_bounded else self.continuous._masses
        return below + above

    def quantile(self, u: Array | float) -> Array:
        """Quantiles of the distribution at probabilities u of any shape."""
        p = np.asarray(u)
        # Of a truncated normal by the lower tail alone: the designs of a seed keep their last bits.
        return self._at(p, None if self.distribution == "truncated_normal" else 1.0 - p)

    def from_normal(self, z: Array) -> Array:
        """The variable's values at standard normal values z of any shape: F⁻¹(Φ(z)), accurate in both tails."""
        from scipy.special import ndtr

        return self._at(ndtr(z), ndtr(np.negative(z)))

    def _at(self, p: Array, q: Array | None) -> Array:
        """Values with probability p below and q = 1 − p above them; both are used, for accuracy in either tail."""
        if self.choices:
            # Below 1, which only choices without probability follow.
            return self.values[np.searchsorted(self._ends[1:-1], np.minimum(p, np.nextafter(1.0, 0.0)), side="right")]
        if self.step is not None:
            return self.rounded(self.continuous._at(p, q))
        if self.distribution == "uniform":
            return np.asarray(self.low + p * (self.high - self.low))
        if self.distribution == "log_uniform":
            return np.asarray(self.low * (self.high / self.low) ** p)
        below, mass, above = self._masses
        x = self._law.ppf(below + p * mass)
        x = x if q is None else np.where(p <= 0.5, x, self._law.isf(above + q * mass))
        return np.asarray(np.clip(x, self.low, self.high))

    def share(self, x: Array) -> Array:
        """The distribution function at values x of any shape, the inverse of `quantile`; see `_shares`."""
        return np.asarray(self._shares(x)[0])

    def to_normal(self, x: Array) -> Array:
        """Standard normal values at values x of any shape: Φ⁻¹(F(x)), the inverse of `from_normal`.

        They are finite at the bounds too.
        """
        return _normal_quantile(*self._shares(x))

    def _shares(self, x: Array) -> tuple[Array, Array]:
        """The probabilities below and above values x of any shape; of a step or a choice the middle of its own."""
        if self.step is not None:
            u = np.interp(x, self.values, 0.5 * (self._ends[:-1] + self._ends[1:]))
            return u, 1.0 - u
        if self.distribution == "uniform":
            u = (x - self.low) / (self.high - self.low)
            return u, 1.0 - u
        if self.distribution == "log_uniform":
            u = np.log(x / self.low) / np.log(self.high / self.low)
            return u, 1.0 - u
        below, mass, above = self._masses
        return (self._law.cdf(x) - below) / mass, (self._law.sf(x) - above) / mass

    def standardised(self, x: Array) -> Array:
        """Values in standard deviations from the middle.

        The middle of a truncated normal is its mean before truncation. A log-uniform variable enters as its logarithm,
        and a variable whose bounds are left out as its standard normal value.
        """
        of = self.continuous
        if of.distribution in _NORMAL and of.mean is not None and of.sd is not None:
            return np.asarray((x - of.mean) / of.sd)
        if of._family.is_bounded:
            return np.asarray(np.sqrt(12.0) * (of.share(x) - 0.5))
        return _normal_quantile(of._law.cdf(x), of._law.sf(x))

    def widened(self, x: Array, factor: float) -> Array:
        """Values stretched about the middle and clipped to the bounds; those of a bounded distribution do not change.

        A normal variable is stretched about its mean, another in standard normal values before truncation.

        Args:
            x: values.
            factor: factor of the standard deviation.
        """
        from scipy.special import ndtr

        of = self.continuous
        if of.distribution in _NORMAL and of.mean is not None:
            return self.rounded(np.clip(of.mean + factor * (x - of.mean), of.low, of.high))
        if of._family.is_bounded:
            return self.rounded(x)
        z = factor * of.standardised(x)
        stretched = np.where(z <= 0.0, of._law.ppf(ndtr(z)), of._law.isf(ndtr(-z)))
        return self.rounded(np.clip(stretched, of.low, of.high))

    @property
    def label(self) -> str:
        """The name with its unit, for tables and axes."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name
