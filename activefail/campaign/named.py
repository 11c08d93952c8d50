"""Simulators that plug-ins bring by name, each with a section of the campaign file."""

from typing import Any, ClassVar, Protocol

from activefail.campaign.variables import AnyVariable
from activefail.plugins import brought
from activefail.simulators.interface import Simulator
from activefail.space.space import DesignSpace


class NamedSettings(Protocol):
    """The settings of a simulator that a plug-in brings by name (`SIMULATORS`): a section of the campaign file.

    Plug-ins bring subclasses of `Section` whose keys all have a default. Reading settings imports them, so they import
    libraries inside their methods.

    Attributes:
        section: name of the section.
        features: names of the plug-in's features that depend on the settings too.
    """

    section: ClassVar[str]
    features: ClassVar[tuple[str, ...]]

    @classmethod
    def default_space(cls) -> dict[str, AnyVariable]:
        """The variables of a campaign file that states none."""
        ...

    @classmethod
    def sources(cls) -> dict[str, str]:
        """Digests of the code that decides the result of a simulation, by their entries in the provenance."""
        ...

    @classmethod
    def options(cls) -> dict[str, str]:
        """Options, such as those of a compiler, that change the last bits of a result, by their entries likewise."""
        ...

    def check_unused(self) -> None:
        """Check that a campaign that uses neither the simulator nor its features states no settings of it.

        Raises:
            InputError: naming the key, if a value differs from the default. Frozen settings contain the defaults.
        """
        ...

    def model(self) -> Any:
        """What the plug-in's features get of the settings."""
        ...

    def simulator(self, space: DesignSpace) -> Simulator:
        """The simulator on a design space.

        Raises:
            InputError: if the space does not suit it.
        """
        ...


NAMED: dict[str, type[NamedSettings]] = {**brought("simulators")}
"""The settings of each simulator, by its name."""

DEFAULTS = brought("defaults")
"""The simulator and the features of a campaign file that states none; neither without a plug-in."""
