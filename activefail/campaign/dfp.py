"""The double friction pendulum bearing as a campaign's simulator."""

from dataclasses import dataclass

import numpy as np

from activefail.bearing import outcome as o
from activefail.bearing.design import TABLE_1, Bearing, Model, Tolerance
from activefail.bearing.simulation import simulate
from activefail.campaign.simulator import Results
from activefail.errors import InputError
from activefail.space import Array, DesignSpace


@dataclass(frozen=True)
class DfpSimulator:
    """The bearing model over the nine variables of Table 1, whatever ranges a campaign gives them.

    Attributes:
        columns: of a design, in Table 1's order.
    """

    model: Model
    tolerance: Tolerance
    columns: tuple[int, ...]

    outcomes = o.OUTCOMES
    causes = o.CAUSES
    margins = o.MARGINS
    releases_gil = True

    @classmethod
    def on(cls, space: DesignSpace, model: Model, tolerance: Tolerance) -> "DfpSimulator":
        """The simulator for designs of a space.

        Raises:
            InputError: if the space lacks a variable of Table 1, has another one, or reaches to zero or below.
        """
        columns = space.select(TABLE_1.names)
        for parameter in space.parameters:
            if parameter.name not in TABLE_1.names:
                raise InputError(
                    f"space.{parameter.name}: the dfp simulator has no such variable; "
                    f"it has {', '.join(TABLE_1.names)}."
                )
            unit = TABLE_1.parameters[TABLE_1.names.index(parameter.name)].unit
            if parameter.unit not in ("", unit):
                raise InputError(f"space.{parameter.name}.unit: must be {unit!r} or left out, got {parameter.unit!r}.")
            if parameter.low <= 0.0:
                raise InputError(
                    f"space.{parameter.name}.low: must be positive for the dfp simulator, got {parameter.low}."
                )
        low, high = space.low[columns], space.high[columns]
        try:
            # The hardest to build of all: small radius, wide dish, high slider.
            Bearing.from_row([low[0], high[1], high[2], high[3], *high[4:7]], model.slider_diameter)
        except InputError as impossible:
            raise InputError(
                f"space: the corner of least T_b, largest D_tot and h_sl_ratio cannot be built. {impossible}"
            ) from None
        return cls(model, tolerance, tuple(columns.tolist()))

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, 9), on the calling thread."""
        answers = simulate(np.asarray(X)[:, self.columns], self.model, self.tolerance, threads=1)
        return Results(answers.label, answers.cause, answers.margins, answers.seconds)
