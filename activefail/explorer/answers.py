"""Answers to the explorer's requests: predictions, planes, fragility curves and simulations, as JSON values."""

import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from activefail.bearing.design import GRAVITY, TABLE_1, Model, Tolerance
from activefail.bearing.motion import Motion, describe_outcome
from activefail.bearing.simulation import Response
from activefail.errors import InputError
from activefail.explorer.pages import Answer
from activefail.explorer.questions import number, one_of
from activefail.figures.axes import outcome_colour
from activefail.figures.curves import plot_fragility
from activefail.figures.motion import (
    extent,
    plate_parts,
    plot_histories,
    slider_outline,
    slider_vertices,
    vertex_states,
)
from activefail.figures.outcome_planes import marks_in, plot_variable_plane
from activefail.figures.svg import inline
from activefail.findings import quantities
from activefail.findings.quantities import plain, words
from activefail.findings.results import Findings, at_the_boundary, interval, predict
from activefail.shares import percent
from activefail.simulators.bearing import DfpSimulator, terms_of
from activefail.space import Array, DesignSpace
from activefail.visible import or_worse, visible

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GRID, _CURVE, _FRAMES = 36, 81, 240

_OPEN = 0.1
"""Largest distance of a probability from one half at which the page may start."""

UNCERTAINTY = "uncertainty"
"""What a plane shows in place of an outcome's probability."""


class Slider(NamedTuple):
    """A number that a visitor chooses.

    Attributes:
        name: in requests.
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


def _listed(values: Array, digits: int) -> list[Any]:
    """Rounded numbers for JSON."""
    return np.round(values, digits).tolist()  # type: ignore[no-any-return]


class Answers:
    """Answers about one campaign; thread-safe.

    Attributes:
        findings: of the campaign.
        campaign, space, outcomes: of the findings.
        shown: what a plane can show.
        quantities: the variables, as shown to a reader.
        sliders: of the variables, in the middle of the space.
    """

    def __init__(self, findings: Findings) -> None:
        self.findings = findings
        self.campaign = findings.campaign
        self.space = findings.campaign.space
        self.outcomes = findings.campaign.simulator.outcomes
        self.shown = (*self.outcomes[1:], UNCERTAINTY)
        self.quantities = quantities.variables(findings.campaign)
        middle = middle_of(self.space)
        self.sliders = tuple(
            Slider(p.name, of.text, of.unit, of.meaning, p.low, p.high, start, p.step, tuple(map(str, p.choices)))
            for p, of, start in zip(self.space.parameters, self.quantities, middle, strict=True)
        )
        # Compile and load everything before the first request.
        self.predict(middle)
        if self.simulates:
            self.simulate(middle)

    @property
    def simulates(self) -> bool:
        """Whether the simulator's motion can be shown."""
        return isinstance(self.campaign.simulator, DfpSimulator)

    def point(self, name: str, values: Any) -> list[float]:
        """Read a design in a question.

        Raises:
            InputError: naming the variable, the rule and the value.
        """
        if not isinstance(values, list) or len(values) != self.space.dimension:
            raise InputError(f"{name}: must be a list of {self.space.dimension} numbers, got {values!r}.")
        values = [number(one.low, one.high)(one.name, x) for one, x in zip(self.space.parameters, values, strict=True)]
        return [float(one.rounded(x)) for one, x in zip(self.space.parameters, values, strict=True)]

    def variable(self, name: str, value: Any) -> int:
        """Read the name of a variable in a question; its column.

        Raises:
            InputError: if it is not a variable of the space.
        """
        return self.space.names.index(one_of(*self.space.names)(name, value))

    def about(self) -> Answer:
        """The data that the page contains from the start."""
        settings, findings, names = self.campaign.settings, self.findings, self.space.names
        # Choices have no axes.
        order = np.argsort(-findings.influence, kind="stable").tolist()
        ranking = [column for column in order if not self.space.parameters[column].choices]
        presets = [self._undecided]
        for row, _ in at_the_boundary(findings):
            text = f"{words(self.outcomes[findings.outcome[row]])}, near a boundary: simulation {findings.ids[row]}"
            presets.append((text, findings.X[row]))
        presets.append(("the middle of the space", np.array(middle_of(self.space))))
        return {
            "title": visible(settings.description or findings.folder.name),
            "simulations": len(findings.X),
            "variables": [slider._asdict() for slider in self.sliders],
            "outcomes": [
                {"name": name, "text": words(name), "colour": outcome_colour(self.outcomes, index)}
                for index, name in enumerate(self.outcomes)
            ],
            "beyond": findings.beyond,
            "presets": [{"text": text, "point": X.tolist()} for text, X in presets],
            "plane": [names[column] for column in ranking[:2]],
            "along": "A_p" if "A_p" in names else names[ranking[0]] if ranking else "",
            "simulates": self.simulates,
        }

    @property
    def _undecided(self) -> tuple[str, Array]:
        """What the design at which the page starts is, and that design, (d,).

        It is nearest to the middle of the space, of those whose outcome is most open.
        """
        findings = self.findings
        X = np.concatenate([findings.pool, findings.X[findings.answered]])
        apart = np.abs(predict(self.campaign, findings.classifier, X).beyond - 0.5)
        least = float(np.nanmin(apart))
        X = X[apart <= max(_OPEN, least)]
        away = np.linalg.norm(self.space.to_unit(X) - 0.5, axis=1)
        # Few digits: the page shows them.
        rounded = [float(f"{value:.4g}") for value in X[np.argmin(away)].tolist()]
        start = np.asarray(self.space.nearest(np.clip([rounded], self.space.low, self.space.high))[0])
        return "a design at the boundary" if least <= _OPEN else "the least certain design", start

    def predict(self, point: Sequence[float]) -> Answer:
        """Probabilities of outcomes, and of boundaries with their 95 % intervals, or why there is no such design."""
        quantities = self.space.quantities(dict(zip(self.space.names, point, strict=True)))
        if broken := [one.text for one in self.space.constraints if not one.holds(quantities)]:
            absent = f"No such design exists: it breaks {' and '.join(broken)}."
            return {"probabilities": [], "boundaries": [], "absent": absent}
        classifier, X = self.findings.classifier, np.array([point])
        exists = float(classifier.existence(X)[0])
        if exists < 0.5:
            absent = f"This design does not exist with a probability of {percent(1.0 - exists)}, by the simulations."
            return {"probabilities": [], "boundaries": [], "absent": absent}
        predicted, boundaries = classifier.predicted(X), []
        for severity, name in enumerate(self.outcomes[1:], start=1):
            low, high = (float(end[0]) for end in interval(predicted, severity))
            probability = float(predicted.beyond(severity)[0])
            text = or_worse(name, self.outcomes)
            boundaries.append({"text": text, "probability": probability, "low": low, "high": high})
        return {"probabilities": predicted.probabilities[0].tolist(), "boundaries": boundaries, "absent": ""}

    def plane(self, point: Sequence[float], x: int, y: int, shown: str) -> Answer:
        """A figure of the plane of two variables through a point, with the position of its axes.

        Args:
            point: a design.
            x, y: columns of the variables.
            shown: one of `shown`.

        Raises:
            InputError: if both variables are the same.
        """
        if x == y:
            raise InputError(f"A plane needs two different variables, got {self.space.names[x]} twice.")
        low, high = self.space.low, self.space.high
        along_x, along_y = np.linspace(low[x], high[x], _GRID), np.linspace(low[y], high[y], _GRID)
        grid_x, grid_y = np.meshgrid(along_x, along_y)
        rows = np.tile(np.array(point), (grid_x.size, 1))
        for column, values in ((x, grid_x), (y, grid_y)):
            rows[:, column] = self.space.parameters[column].rounded(values.ravel())
        prediction = predict(self.campaign, self.findings.classifier, rows)
        uncertain = shown == UNCERTAINTY
        if uncertain:
            shades, title = prediction.high - prediction.low, f"uncertainty of P({plain(self.findings.beyond)})"
        else:
            shades, title = prediction.probabilities[:, self.outcomes.index(shown)], f"P({plain(words(shown))})"
        axes_of = self.quantities[x], self.quantities[y]
        along, marks = (along_x, along_y), marks_in(self.findings, np.array(point), [x, y])
        figure = plot_variable_plane(
            axes_of, along, shades.reshape(grid_x.shape), title, marks, self.outcomes, uncertain
        )
        svg = inline(figure, "plane", f"{title} in the plane of {self.space.names[x]} and {self.space.names[y]}")
        return {"svg": str(svg), "axes": _place(figure.axes[0], figure.axes[0])}

    def fragility(self, point: Sequence[float], along: int) -> Answer:
        """A figure of the probability of lying beyond the target boundary against a variable."""
        values = np.linspace(self.space.low[along], self.space.high[along], _CURVE)
        rows = np.tile(np.array(point), (len(values), 1))
        rows[:, along] = self.space.parameters[along].rounded(values)
        prediction = predict(self.campaign, self.findings.classifier, rows)
        figure = plot_fragility(
            values,
            prediction,
            self.quantities[along],
            plain(self.findings.beyond),
            point[along],
            outcome_colour(self.outcomes, self.campaign.severity),
        )
        svg = inline(figure, "fragility", f"P({self.findings.beyond}) against {self.space.names[along]}")
        return {"svg": str(svg)}

    def simulate(self, point: Sequence[float]) -> Answer:
        """Simulate a bearing: its outcome, outlines and frames of its motion.

        Raises:
            InputError: if the campaign's simulator has no bearing to show.
        """
        simulator, response = self._simulated(point)
        terms = terms_of(simulator, self.space.quantities(dict(zip(self.space.names, point, strict=True))))
        answer: Answer = {
            "outcome": response.outcome_name,
            "description": describe_outcome(response),
            "terms": "" if terms is None else terms.text,
            "command": _command(simulator, point),
        }
        try:
            motion = Motion(response)
        except InputError:
            return answer | {"frames": None}
        plate, rims = plate_parts(motion)
        frames = np.linspace(motion.onset, motion.end, _FRAMES)
        at_frames = motion.position(frames)
        low, high = extent(motion)
        return answer | {
            "plate": _listed(plate, 4),
            "rims": [_listed(outline, 4) for outline in rims],
            "slider": _listed(slider_outline(response.bearing), 4),
            "low": low.tolist(),
            "high": high.tolist(),
            "frames": {
                "t": _listed(frames, 4),
                "q": _listed(at_frames, 5),
                "vertices": [_listed(slider_vertices(motion, row), 4) for row in at_frames],
                "states": [vertex_states(motion, time) for time in frames.tolist()],
                # A broken arc has no place.
                "arcs": [
                    [round(arc, 4) if math.isfinite(arc) else None for arc in arcs]
                    for arcs in motion.rims(frames).tolist()
                ],
                "ground": _listed(motion.ground(frames) / GRAVITY, 4),
            },
        }

    def histories(self, point: Sequence[float], narrow: bool) -> Answer:
        """A figure of the motion over time, with the position of its axes and the times [s] at their ends.

        Args:
            point: a design.
            narrow: whether the page is narrow; a narrower figure keeps its text legible.

        Raises:
            InputError: if the campaign's simulator has no bearing to show, or the response holds no motion.
        """
        _, response = self._simulated(point)
        figure = plot_histories(response, width=3.6 if narrow else 5.2)
        svg = inline(figure, "histories", "Displacement, ground acceleration, uplift and tilt over time")
        first, last = figure.axes[0], figure.axes[-1]
        return {"svg": str(svg), "axes": _place(first, last), "times": list(last.get_xlim())}

    def _simulated(self, point: Sequence[float]) -> tuple[DfpSimulator, Response]:
        if not isinstance(self.campaign.simulator, DfpSimulator):
            raise InputError("This campaign's simulator has no bearing to show.")
        return self.campaign.simulator, self.campaign.simulator.response(np.array(point))


def middle_of(space: DesignSpace) -> list[float]:
    """The middle of a space, without the digits that are the rounding of a sum: 0.07, not 0.06999999999999999."""
    return [float(f"{value:.12g}") for value in space.from_unit(np.full(space.dimension, 0.5)).tolist()]


def _place(upper: "Axes", lower: "Axes") -> dict[str, float]:
    """Position of axes in their figure, as shares of its width from the left and of its height from the top."""
    top, bottom = upper.get_position(), lower.get_position()
    return {"left": top.x0, "right": top.x1, "top": 1.0 - top.y1, "bottom": 1.0 - bottom.y0}


def _command(simulator: DfpSimulator, point: Sequence[float]) -> str:
    """The command that simulates this bearing: the design with all digits, and settings that are not the default."""
    (row,) = simulator.space.table(np.array([point]), TABLE_1.names).tolist()
    design = dict(zip(TABLE_1.names, row, strict=True))
    defaults = asdict(Model()) | {"tolerance": Tolerance().relative}
    settings = asdict(simulator.model) | {"tolerance": simulator.tolerance.relative}
    arguments = ["activefail", "simulate"]
    for name, value in (design | {name: one for name, one in settings.items() if one != defaults[name]}).items():
        option = name.lower().replace("_", "-")
        if isinstance(value, bool):
            arguments.append(f"--{'' if value else 'no-'}{option}")
        else:
            text = value if isinstance(value, str) else np.format_float_positional(value, trim="-")
            arguments += [f"--{option}", text]
    return shlex.join(arguments)
