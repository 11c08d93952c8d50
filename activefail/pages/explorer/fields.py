"""What a visitor enters: the fields of a page's form, and how the server reads them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from activefail.errors import InputError
from activefail.space.parameter import Parameter
from activefail.text.quantities import Quantity

Values = Mapping[str, Any]
"""What a page sends: the values of its form by name; numbers may be texts."""


class Field(NamedTuple):
    """A number that a visitor enters by a slider or as text, or chooses from a list.

    Attributes:
        name: in the form.
        text: plain text with `_` before a subscript.
        unit: empty for a dimensionless number.
        meaning: a few words.
        low, high: its range.
        start: where it stands at first.
        step: distance of the values, if there are none between them.
        choices: texts of a list, in place of a range; the number is that of one of them.
    """

    name: str
    text: str
    unit: str
    meaning: str
    low: float
    high: float
    start: float
    step: float | None = None
    choices: tuple[str, ...] = ()

    @classmethod
    def of(cls, variable: Parameter, shown: Quantity, start: float) -> "Field":
        """The field of a variable of a campaign."""
        ends = variable.low, variable.high, start
        return cls(
            variable.name, shown.text, shown.unit, shown.meaning, *ends, variable.step, (*map(str, variable.choices),)
        )

    def read(self, values: Values) -> float:
        """Its number in a form."""
        value = values.get(self.name)
        try:
            number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not self.low <= number <= self.high:
            raise InputError(f"{self.name}: must lie between {self.low:g} and {self.high:g}, got {value!r}.")
        return number


def chosen(values: Values, name: str, choices: Sequence[str]) -> str:
    """One of some texts in a form."""
    value = values.get(name)
    if value not in choices:
        raise InputError(f"{name}: must be one of {', '.join(choices)}, got {value!r}.")
    return str(value)
