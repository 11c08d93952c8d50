"""A simulated bearing on pages: its bodies at some moments, a film of its motion, and the command that repeats it."""

import shlex
from dataclasses import asdict, dataclass

import numpy as np
from markupsafe import Markup

from activefail.errors import InputError
from activefail.pages.view import Picture
from activefail.seismic.bearing import Response
from activefail.seismic.bearing.design import TABLE_1, Model, Tolerance
from activefail.seismic.bearing.motion import Motion, describe_outcome
from activefail.seismic.figures.bodies import MARKS
from activefail.seismic.simulator import DfpSimulator
from activefail.seismic.views.film import film, fragment, histories, stills
from activefail.space.space import Array


@dataclass(frozen=True)
class BearingView:
    """Shows the motion of bearings; implements `View`."""

    simulator: DfpSimulator

    legend = (
        "To scale: plates in grey, their rims dark, the slider blue; the arrow is the ground acceleration. Marks at "
        f"the slider's corners: {MARKS}."
    )

    def prepare(self, X: Array) -> None:
        """As `View.prepare`."""
        self.simulator.response(X)

    def picture(self, X: Array, name: str, of: str) -> Picture | None:
        """As `View.picture`: the bearing at some moments."""
        response = self.simulator.response(X)
        if _motion(response) is None:
            return None
        drawn = stills(response, f"Plates and slider of {of} at some moments")
        return Picture(drawn, describe_outcome(response), self._terms(X))

    def panel(self, X: Array, width: float) -> Markup:
        """As `View.panel`: its outcome, its motion as a film and over time, and the command that repeats it."""
        response = self.simulator.response(X)
        motion = _motion(response)
        return fragment(
            "simulate",
            outcome=response.outcome_name,
            description=describe_outcome(response),
            terms=self._terms(X),
            command=_command(self.simulator, X),
            motion=motion,
            film=motion and film(motion),
            histories=motion and histories(motion, width),
        )

    def _terms(self, X: Array) -> str:
        space = self.simulator.space
        terms = self.simulator.terms(space.quantities(dict(zip(space.names, X.tolist(), strict=True))))
        return "" if terms is None else terms.text


def _motion(response: Response) -> Motion | None:
    """The motion of a response; None if it failed at the start."""
    try:
        return Motion(response)
    except InputError:
        return None


def _command(simulator: DfpSimulator, X: Array) -> str:
    """The command that simulates this bearing: the design with all digits, and settings that are not the default."""
    (row,) = simulator.space.table(X[None], TABLE_1.names).tolist()
    defaults = asdict(Model()) | {"tolerance": Tolerance().relative}
    settings = asdict(simulator.model) | {"tolerance": simulator.tolerance.relative}
    unusual = {name: one for name, one in settings.items() if one != defaults[name]}
    arguments = ["activefail", "simulate"]
    for name, value in (dict(zip(TABLE_1.names, row, strict=True)) | unusual).items():
        option = name.lower().replace("_", "-")
        if isinstance(value, bool):
            arguments.append(f"--{'' if value else 'no-'}{option}")
        else:
            text = value if isinstance(value, str) else np.format_float_positional(value, trim="-")
            arguments += [f"--{option}", text]
    return shlex.join(arguments)
