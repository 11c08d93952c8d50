"""The tables of `[space]`, each of which states a variable or a fixed quantity; some name files beside the campaign."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator, model_validator

from activefail.campaign.section import NAME, NUMBER, RANGE, WITH, Section, built, by_key, name_or, shown
from activefail.errors import InputError, naming
from activefail.space.distributions import PARAMETERS, Distribution
from activefail.space.parameter import LARGEST, MOST_CARRIED, MOST_CHOICES, Choice, Parameter
from activefail.text.csv_table import Table
from activefail.text.trust import path_beside

ReadSet = Callable[[str, str, str | None, float | None], Any]
"""Reads the objects behind a variable with a set: name, place, unit and interval -> `records` and their `digest`."""

_WIDEST = 9.0
"""Largest distance of a bound from the median in standard deviations: the probability beyond is 10⁻¹⁹."""


class Entry(Section):
    """A table of `space`; the class has what most of them lack."""

    @property
    def is_bounded(self) -> bool:
        """Whether the file gives both bounds, or the values."""
        return True

    @property
    def quantities(self) -> dict[str, list[float]]:
        """The features of the choices whose numbers are known."""
        return {}

    @property
    def has_texts(self) -> bool:
        """Whether the values are texts."""
        return False

    @property
    def file(self) -> str:
        """The file of features that has not been read; empty if there is none."""
        return ""

    def completed(self, name: str, folder: Path, read_set: ReadSet | None) -> Self:
        """The table of a variable with what its file says, as run folders have it.

        Args:
            name: of the variable.
            folder: of the campaign file.
            read_set: reads the records of a set; None if the table must have them, because it may come from someone
                else.
        """
        return self


class Variable(Entry):
    """One variable of the design space: its distribution and its bounds (`activefail.space.space.Parameter`).

    Distributions are stated by mean and sd, by mean and coefficient of variation, or by their own parameters
    (`activefail.space.distributions`). Only uniform, log-uniform, truncated normal and beta variables need bounds.

    Attributes:
        low: lower bound, in the unit of the variable. It truncates a distribution that needs no bounds.
        high: upper bound, likewise.
        unit: unit as text, for tables and figures; nothing is converted.
        step: distance of the values low, low + step, ..., high of a variable that is not continuous, such as 1 for a
            whole number. Each has the probability of all values that are rounded to it.
        distribution: name of the distribution.
        mean: mean, before truncation.
        sd: standard deviation, before truncation.
        cov: coefficient of variation, sd / abs(mean), in place of `sd`.
        median: median of a lognormal variable.
        dispersion: standard deviation of the logarithm of a lognormal variable.
        location: mode of a Gumbel variable.
        shape: shape of a Weibull or gamma variable.
        scale: scale of a Gumbel, Weibull or gamma variable.
        alpha: first shape of a beta variable between its bounds.
        beta: second shape of a beta variable.
        rate: rate of an exponential variable, 1 / mean.
    """

    low: float | None = None
    high: float | None = None
    unit: str = ""
    step: float | None = None
    distribution: Distribution = "uniform"
    mean: float | None = None
    sd: float | None = None
    cov: float | None = None
    median: float | None = None
    dispersion: float | None = None
    location: float | None = None
    shape: float | None = None
    scale: float | None = None
    alpha: float | None = None
    beta: float | None = None
    rate: float | None = None

    @model_validator(mode="after")
    def _is_a_variable(self) -> Self:
        # The widest reach that settings allow; bounds in the file do not depend on it.
        one = built(lambda: self.parameter("it", _WIDEST))
        if max(-one.low, one.high) > LARGEST:
            rule = f"the range must lie between {-LARGEST:g} and {LARGEST:g}"
            raise ValueError(f"{rule}, got {one.low:g} to {one.high:g}")
        return self

    @property
    def is_bounded(self) -> bool:
        """Whether the file gives both bounds."""
        return self.low is not None and self.high is not None

    def parameter(self, name: str, distance: float) -> Parameter:
        """The variable of the design space, under a name.

        Args:
            name: of the variable.
            distance: where bounds lie that the file leaves out, in standard deviations of a normal variable.
        """
        given = {key: number for key in PARAMETERS if (number := getattr(self, key)) is not None}
        bounds = self.low, self.high
        return Parameter.of_distribution(name, self.distribution, given, *bounds, self.unit, self.step, distance)


def _is_a_choice(value: object) -> object:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not isinstance(value, str) and not (is_number and abs(value) <= LARGEST):  # type: ignore[arg-type]
        raise ValueError(f"must be texts, or numbers of at most {LARGEST:g} in size, got {shown(value)}")
    return value


class Choices(Entry):
    """A variable whose values are texts or numbers without order.

    Attributes:
        choices: the values, which have neither bounds nor a distribution.
        probabilities: of the choices; equal if left out.
        features: quantities that follow from the choice, from a CSV file beside the campaign file or as numbers
            ([choices](../distributions.md#choices)). activefail writes the numbers to run folders.
        unit: unit as text.
    """

    choices: list[Annotated[Choice, BeforeValidator(_is_a_choice)]]
    probabilities: list[float] | None = None
    features: (
        Annotated[
            Annotated[str, Tag(NAME)] | Annotated[dict[str, list[float]], Field(min_length=1), Tag(NUMBER)],
            Discriminator(name_or(NUMBER)),
        ]
        | None
    ) = None
    unit: str = ""

    @model_validator(mode="before")
    @classmethod
    def _as_older_folders_have_it(cls, values: Any) -> Any:
        # They have the default of a key that choices do not have.
        is_older = isinstance(values, dict) and values.get("distribution") == "uniform"
        return {key: value for key, value in values.items() if key != "distribution"} if is_older else values

    @model_validator(mode="after")
    def _is_a_variable(self) -> Self:
        built(lambda: self.parameter("it"))
        return self

    @property
    def has_texts(self) -> bool:
        """Whether the choices are texts."""
        return isinstance(self.choices[0], str)

    @property
    def quantities(self) -> dict[str, list[float]]:
        """The features of the choices whose numbers are known."""
        return self.features if isinstance(self.features, dict) else {}

    @property
    def file(self) -> str:
        """The file of the features, if it has not been read."""
        return self.features if isinstance(self.features, str) else ""

    def parameter(self, name: str, _: float = 0.0) -> Parameter:
        """The variable of the design space, under a name (see `Variable.parameter`)."""
        features = tuple((feature, tuple(numbers)) for feature, numbers in self.quantities.items())
        most = MOST_CARRIED if self.features is not None else MOST_CHOICES
        return Parameter.of_choices(name, self.choices, self.probabilities or (), self.unit, features, most=most)

    def completed(self, name: str, folder: Path, read_set: ReadSet | None) -> Self:
        """The choices with the numbers of their file of features, which has a row for each."""
        if not self.file:
            return self
        with naming(f"space.{name}.features: "):
            path = path_beside(folder, self.file, "campaign file")
            table, one = Table.of_csv(path, MOST_CARRIED), self.parameter(name)
            table.require([name])
            rows: dict[float, int] = {}
            for row in range(len(table.rows)):
                choice = table.value(row, one)
                if choice in rows:
                    rule = f"must be another choice than in {table.places[rows[choice]]}"
                    raise table.broken(row, name, rule, one.written(choice))
                rows[choice] = row
            if missing := [one.written(choice) for choice in one.values.tolist() if choice not in rows]:
                raise InputError(f"{path}: must have a row for each choice, but lacks {', '.join(map(str, missing))}.")
            features = {
                column: [table.finite(rows[choice], column) for choice in one.values.tolist()]
                for column in table.columns
                if column != name
            }
        return self.model_copy(update={"features": features})


_MEASURE = re.compile(r"factor|pga|pgv|sa:(\d+(?:\.\d+)?)")
"""An intensity to which records are scaled (`activefail.seismic.motions.intensity`)."""


class SetVariable(Entry):
    """A variable whose values are the records of a set of ground motions, without order.

    Attributes:
        set: a set of FEMA P695 (farfield, nearfield, nearfield-pulse or nearfield-no-pulse), or a folder of records
            beside the campaign file.
        unit: unit of accelerations in files that state none: g, m/s2, cm/s2 or mm/s2.
        dt: interval of samples in files that state none [s].
        scaled_to: the variable or fixed quantity to which each record is scaled, with the intensity that it is: factor,
            pga [g], pgv [m/s] or sa:T [g], as in { PGV = "pgv" }. If left out, the records are as they are.
        probabilities: of the records; equal if left out.
        digest: SHA-256 of the records' samples and intervals; other records are refused. activefail writes it to run
            folders.
        records: the events of the records, by their names; activefail writes them to run folders.
    """

    set: str = Field(min_length=1)
    unit: str | None = None
    dt: float | None = Field(None, gt=0.0)
    scaled_to: dict[str, str] | None = Field(None, min_length=1, max_length=1)
    probabilities: list[float] | None = None
    digest: str | None = None
    records: dict[str, str] | None = None

    @field_validator("scaled_to")
    @classmethod
    def _names_a_measure(cls, scaled_to: dict[str, str] | None) -> dict[str, str] | None:
        for name, measure in (scaled_to or {}).items():
            match = _MEASURE.fullmatch(measure)
            if not match or (match[1] and not 0.01 <= float(match[1]) <= 100.0):
                raise ValueError(
                    f"{name} must be factor, pga, pgv, or sa:T with a period T from 0.01 to 100 s, got {measure!r}"
                )
        return scaled_to

    @model_validator(mode="after")
    def _is_known(self) -> Self:
        if self.records is not None and self.digest is None:
            raise ValueError("`records` requires `digest`; activefail writes both")
        try:
            if self.records is not None:
                built(lambda: self.parameter("it"))
        except ValueError as rule:
            said = str(rule).replace("`choices`", "the names of records").replace("choices", "records")
            raise ValueError(said) from None
        return self

    @property
    def choices(self) -> list[Choice]:
        """The names of the records, if they are known."""
        return [*(self.records or {})]

    @property
    def has_texts(self) -> bool:
        """Whether the values are texts."""
        return True

    def parameter(self, name: str, _: float = 0.0) -> Parameter:
        """The variable of the design space, under a name (see `Variable.parameter`), without the motions themselves.

        Raises:
            InputError: if the records are not known.
        """
        if self.records is None:
            raise InputError(f"space.{name}.set: cannot be read here; state it in a campaign file.")
        events = tuple(self.records.values())
        return Parameter.of_choices(name, self.choices, self.probabilities or (), groups=events)

    def completed(self, name: str, folder: Path, read_set: ReadSet | None) -> Self:
        """The set with the names, events and digest of its records."""
        if self.records is not None:
            return self
        if read_set is None:
            raise InputError(f"space.{name}.set: requires `records` and `digest`, as activefail writes them.")
        beside = folder / self.set
        place = str(beside.absolute()) if beside.exists() else self.set
        found = read_set(name, place, self.unit, self.dt)
        events, fault = {record.name: record.event for record in found.records}, ""
        if self.digest not in (None, found.digest):
            fault = f"the digest of {self.set} must be {self.digest}, as `digest` says, got {found.digest}"
        if len(events) < len(found.records):
            fault = f"the {len(found.records)} records of {self.set} must have different names"
        if fault:
            raise InputError(f"space.{name}.set: {fault}.")
        return self.model_copy(update={"set": place, "digest": found.digest, "records": events})


class FixedVariable(Entry):
    """A quantity of the simulator that is the same for every design.

    Attributes:
        value: the value, in its unit; in a question one of the choices, if the variable has some.
        unit: unit as text.
    """

    value: Annotated[
        Annotated[float, Field(ge=-LARGEST, le=LARGEST), Tag(NUMBER)] | Annotated[str, Tag(NAME)],
        Discriminator(name_or(NUMBER)),
    ]
    unit: str = ""


VARIABLES: dict[str, type[Section]] = {"value": FixedVariable, "set": SetVariable, "choices": Choices}
"""Tables of `space` that are no distributions, by the key that only they have."""

AnyVariable = Annotated[
    Annotated[Variable, Tag(RANGE)]
    | Annotated[Choices, Tag(f"{WITH}choices")]
    | Annotated[SetVariable, Tag(f"{WITH}set")]
    | Annotated[FixedVariable, Tag(f"{WITH}value")],
    by_key(VARIABLES, RANGE),
]
