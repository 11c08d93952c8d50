"""The section `[bearing]` of a campaign file, and what follows from it."""

from typing import TYPE_CHECKING, ClassVar, Literal, Self

from pydantic import Field, model_validator

from activefail.campaign.named import NamedSettings
from activefail.campaign.section import built
from activefail.campaign.variables import AnyVariable, Variable
from activefail.seismic.bearing.design import (
    RELATIVE_TOLERANCES,
    TABLE_1,
    WIDEST_REGULARISATION,
    WIDEST_SLIDER,
    Model,
    Tolerance,
)
from activefail.space.space import DesignSpace

if TYPE_CHECKING:
    from activefail.seismic.simulator import DfpSimulator


class BearingSettings(NamedSettings):
    """Settings of the double friction pendulum (`activefail.seismic.bearing.Model` and `Tolerance`).

    Attributes:
        slider_diameter: D_sl [m], which Table 1 does not contain.
        restitution_coefficient: coefficient of restitution of the contacts, for the mass in the damper.
        restitution: mass in the damper: "pairwise", as published, or "assembly", the mass of the plate
            ([contact](../bearing.md#contact)).
        slider_density: density of the slider [kg/m³].
        friction_velocity: velocity over which Coulomb friction is regularised [m/s].
        loss_of_confinement: whether a slider that no rim of a plate holds any longer counts as failure.
        rim: "rigid", as published; "breaking" at `rim_strength`; "yielding" there, and broken at `rim_deformation`;
            or "none", a flat plate ([rims that yield and break](../bearing.md#rims-that-yield-and-break)).
        rim_strength: largest normal force on a rim, divided by the weight on the bearing; required with a rim that
            breaks or yields.
        rim_deformation: plastic deformation at which a yielding rim breaks [m]; required with one.
        tolerance: relative error per step of the integration.
    """

    section: ClassVar[str] = "bearing"
    features: ClassVar[tuple[str, ...]] = ("sliding", "collision")

    slider_diameter: float = Field(0.30, gt=0.0, lt=WIDEST_SLIDER)
    restitution_coefficient: float = Field(0.65, gt=0.0, le=1.0)
    restitution: Literal["pairwise", "assembly"] = "pairwise"
    slider_density: float = Field(7850.0, gt=0.0)
    friction_velocity: float = Field(1e-3, gt=0.0, le=WIDEST_REGULARISATION)
    loss_of_confinement: bool = True
    rim: Literal["rigid", "breaking", "yielding", "none"] = "rigid"
    rim_strength: float | None = Field(None, ge=0.0)
    rim_deformation: float | None = Field(None, gt=0.0)
    tolerance: float = Field(1e-4, ge=RELATIVE_TOLERANCES[0], le=RELATIVE_TOLERANCES[1])

    @model_validator(mode="after")
    def _is_a_model(self) -> Self:
        built(self.model)
        return self

    def model(self) -> Model:
        """The bearing model."""
        return Model(**self.model_dump(exclude={"tolerance"}))

    def integration(self) -> Tolerance:
        """The tolerance of the integration."""
        return Tolerance(relative=self.tolerance)

    def simulator(self, space: DesignSpace) -> "DfpSimulator":
        """The bearing on a design space; raises as `DfpSimulator.on` does."""
        from activefail.seismic.simulator import DfpSimulator

        return DfpSimulator.on(space, self.model(), self.integration())

    @classmethod
    def default_space(cls) -> dict[str, AnyVariable]:
        """The variables of Table 1."""
        return {one.name: Variable(low=one.low, high=one.high, unit=one.unit) for one in TABLE_1.parameters}

    @classmethod
    def sources(cls) -> dict[str, str]:
        """The digest of the bearing's physics."""
        from activefail.seismic.bearing.kernels import physics_digest

        return {"bearing_sources": physics_digest()}

    @classmethod
    def options(cls) -> dict[str, str]:
        """The options of numba."""
        from activefail.seismic.bearing.kernels import compiler_options

        return {"numba_options": compiler_options()}
