"""Quantities that may take the place of a variable in a question, such as a velocity that of an amplitude."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from activefail.errors import InputError
from activefail.plugins import brought
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace


@dataclass(frozen=True)
class Derived:
    """A quantity that a question may state in place of a variable of the campaign, which then follows from it.

    Attributes:
        quantity: its name, range and unit.
        replaces: name of the variable.
        units: of the variables of which one is replaced, by name.
        of: what these variables describe, such as "pulse".
        value: of the replaced variable, (n,), from the values of the quantity and the other variables, (n,) by name.
        largest_median: of the quantity.
        mistaken: unit that a larger median probably has.
    """

    quantity: Parameter
    replaces: str
    units: Mapping[str, str]
    of: str
    value: Callable[[Mapping[str, Array]], Array]
    largest_median: float
    mistaken: str

    def check(self, space: DesignSpace, what: str) -> None:
        """Check that a campaign has all these variables, with numbers in a range."""
        for name, unit in self.units.items():
            if (one := space.by_name.get(name)) is None:
                known = ", ".join(space.names)
                raise InputError(f"{what}: requires the variable {name!r} of a {self.of}; the campaign has {known}.")
            if one.unit not in ("", unit):
                raise InputError(f"{what}: {name} must be in {unit}, but the campaign has it in {one.unit!r}.")
            check_no_choices(name, space, what)

    def check_median(self, median: float) -> None:
        """Check the median of the quantity."""
        if median > self.largest_median:
            raise InputError(
                f"space.{self.quantity.name}: its median must be at most {self.largest_median:g} {self.quantity.unit}, "
                f"got {median:g}; is it in {self.mistaken}?"
            )


def derived_in(known: Iterable[str], variables: Collection[str]) -> Derived | None:
    """The quantity among known names that takes the place of a variable; None if all names are the campaign's."""
    others = [name for name in known if name not in variables]
    quantities = brought("derived") if others else {}
    return next((quantities[name] for name in others if name in quantities), None)


def check_no_choices(name: str, space: DesignSpace, what: str) -> None:
    """Check that a variable has no choices, because `what` gives it other values."""
    one = space.by_name.get(name)
    if one is not None and one.choices:
        raise InputError(f"{what}: requires {name} without choices, but it {one.rule} in the campaign.")
