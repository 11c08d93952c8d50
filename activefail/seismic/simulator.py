"""The double friction pendulum bearing as a campaign's simulator."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.seismic.bearing import outcome as o
from activefail.seismic.bearing.design import TABLE_1, Bearing, Model, Pulse, Tolerance
from activefail.seismic.bearing.simulation import Response, simulate, simulate_one
from activefail.seismic.bearing.terms import Terms
from activefail.seismic.quantities import VARIABLES
from activefail.simulators.interface import Results
from activefail.space.space import Array, DesignSpace

_LIMITS = "The bearing model is planar. {}, and there is no vertical ground motion."
_RIMS = {
    "rigid": "Its rims do not yield",
    "breaking": "Its rims break at a force of {strength:g} W",
    "yielding": "Its rims yield at a force of {strength:g} W and break at a plastic deformation of {deformation:g} m",
    "none": "It has no rims",
}


@dataclass(frozen=True)
class DfpSimulator:
    """The bearing model over the nine variables of Table 1, in any ranges; some may be features of choices.

    Attributes:
        space: design space.
    """

    space: DesignSpace
    model: Model
    tolerance: Tolerance

    outcomes = o.OUTCOMES
    margins = o.COLUMNS
    releases_gil = True
    noun = "bearing"
    title = "the double friction pendulum bearing"
    quantities = VARIABLES
    view = "dfp"

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes; those of rigid rims are as in records from before rims could break."""
        return o.CAUSES if self.model.rim_limits < (math.inf, math.inf) else o.CAUSES[: o.RIM_FRACTURE]

    @property
    def limits(self) -> tuple[str, ...]:
        """What the model leaves out, as sentences."""
        strength, deformation = self.model.rim_limits
        return (_LIMITS.format(_RIMS[self.model.rim].format(strength=strength, deformation=deformation)),)

    @classmethod
    def on(cls, space: DesignSpace, model: Model, tolerance: Tolerance) -> "DfpSimulator":
        """The simulator for a design space.

        Raises:
            InputError: if the space lacks a variable of Table 1, has an unknown one, contains values that are not
                positive, gives one choices, or contains a bearing that cannot be built.
        """
        for one in space.parameters:
            if one.choices and one.name in TABLE_1.names:
                raise InputError(
                    f"space.{one.name}.choices: a variable of the dfp simulator has numbers in order; use `step`, or "
                    "`features` of another variable with choices."
                )
        lowest, highest = np.transpose([space.range_of(name) for name in TABLE_1.names])
        carrying = {one.name for one in space.parameters if not {*dict(one.features)}.isdisjoint(TABLE_1.names)}
        for name in (*space.names, *space.fixed):
            if name not in TABLE_1.names and name not in carrying:
                raise InputError(
                    f"space.{name}: the dfp simulator has no such variable; its variables are "
                    f"{', '.join(TABLE_1.names)}, which may be `features` of choices."
                )
        for parameter in space.parameters:
            if parameter.name in carrying:
                continue
            unit = TABLE_1.parameters[TABLE_1.names.index(parameter.name)].unit
            if parameter.unit not in ("", unit):
                raise InputError(f"space.{parameter.name}.unit: must be {unit!r} or left out, got {parameter.unit!r}.")
        for name, low in zip(TABLE_1.names, lowest.tolist(), strict=True):
            if low <= 0.0:
                key = "value" if name in space.fixed else "low"
                key = f"{space.carriers[name]}.features.{name}" if name in space.carriers else f"{name}.{key}"
                raise InputError(f"space.{key}: must be positive for the dfp simulator, got {low}.")
        try:
            # The hardest bearing to build: small radius, wide dish, high slider.
            Bearing.from_row([lowest[0], *highest[1:7]], model.slider_diameter)
        except InputError as error:
            raise InputError(
                f"space: the bearing with the smallest T_b and the largest D_tot and h_sl_ratio cannot be built with "
                f"a bearing.slider_diameter of {model.slider_diameter:g} m. {error}"
            ) from None
        return cls(space, model, tolerance)

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, d), on the calling thread."""
        answers = simulate(self.space.table(X, TABLE_1.names), self.model, self.tolerance, threads=1)
        return Results(answers.outcome, answers.cause, answers.columns, answers.seconds)

    def terms(self, quantities: Mapping[str, float]) -> Terms | None:
        """The designer's terms of a bearing; None if one of `activefail.seismic.bearing.terms.NEEDED` has no value."""
        return Terms.of(quantities, self.model)

    def harmless(self, X: Array) -> NDArray[np.bool_]:
        """Designs, (n, d), whose pulse has an amplitude of at most the friction: nothing slides, and no rim is touched.

        What creeps in the regularised friction stays below a tenth of the capacity.
        """
        mu, A_p = self.space.table(X, ("mu", "A_p")).T
        return np.asarray(A_p <= mu)

    def check(self, X: Array) -> None:
        """Check that designs, (n, d), can be built and shaken."""
        for row in self.space.table(X, TABLE_1.names).tolist():
            Bearing.from_row(row, self.model.slider_diameter)
            Pulse.from_table(*row[7:])

    def response(self, design: Array) -> Response:
        """The motion of one design, (d,), to the end of the run."""
        row = self.space.table(design[None], TABLE_1.names)[0].tolist()
        return simulate_one(
            Bearing.from_row(row, self.model.slider_diameter),
            Pulse.from_table(*row[7:]),
            self.model,
            self.tolerance,
            to_the_end=True,
        )
