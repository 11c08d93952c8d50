"""Simulators that plug-ins bring by name, each with a section of the campaign file."""

from typing import Any, ClassVar

from activefail.campaign.section import Section
from activefail.campaign.variables import AnyVariable
from activefail.errors import InputError
from activefail.simulators.interface import Simulator
from activefail.space.space import DesignSpace


class NamedSettings(Section):
    """The settings of a simulator that a plug-in brings by name (`SIMULATORS`): a section of the campaign file.

    Plug-ins bring subclasses whose keys all have a default. Reading settings imports them, so they import libraries
    inside their methods.

    Attributes:
        section: name of the section.
        features: names of the plug-in's features that depend on the settings too.
    """

    section: ClassVar[str]
    features: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def default_space(cls) -> dict[str, AnyVariable]:
        """The variables of a campaign file that states none; empty if it must."""
        return {}

    @classmethod
    def sources(cls) -> dict[str, str]:
        """Digests of the code that decides the result of a simulation, by their entries in the provenance."""
        return {}

    @classmethod
    def options(cls) -> dict[str, str]:
        """Options, such as those of a compiler, that change the last bits of a result, by their entries likewise."""
        return {}

    def check_unused(self, name: str) -> None:
        """Check that a campaign that uses neither the simulator nor its features states no settings of it.

        Args:
            name: of the simulator.

        Raises:
            InputError: naming the key, if a value differs from the default. Frozen settings contain the defaults.
        """
        features = f", or the features `{'` or `'.join(self.features)}`" if self.features else ""
        for key, value in self:
            if value != type(self).model_fields[key].default:
                raise InputError(f'{self.section}.{key}: requires `simulator = "{name}"`{features}, got {value!r}.')

    def model(self) -> Any:
        """What the plug-in's features get of the settings."""
        return self

    def simulator(self, space: DesignSpace) -> Simulator:
        """The simulator on a design space.

        Raises:
            InputError: if the space does not suit it.
        """
        raise NotImplementedError
