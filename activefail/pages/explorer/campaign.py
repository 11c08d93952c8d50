"""The page of one design of a campaign: what its classifier predicts, and how it moves."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from activefail.analyses.findings import quantities
from activefail.analyses.findings.results import Findings, at_the_boundary, interval, predict
from activefail.errors import InputError
from activefail.learning.model.moments import undecided
from activefail.pages.explorer.fields import Field, Values, chosen
from activefail.pages.explorer.pages import Panel, page
from activefail.pages.figures.axes import outcome_colour
from activefail.pages.figures.curves import plot_fragility, plot_learning_curves
from activefail.pages.figures.outcome_planes import marks_in, plot_variable_plane
from activefail.pages.figures.svg import inline, place_of
from activefail.pages.view import view_of
from activefail.simulators.interface import noun_of
from activefail.space.shares import percent
from activefail.space.space import Array
from activefail.text.quantities import plain
from activefail.visible import or_worse, visible, words

if TYPE_CHECKING:
    from activefail.analyses.findings.failure import FailureFindings
    from activefail.learning.model.classifier import Classifier
    from activefail.pages.report.evidence import Curve

_GRID, _CURVE = 36, 81

_WIDTH = 4.4
"""Width of figures [in], which are read on a phone too."""

_OPEN = 0.1
"""Largest distance of a probability from one half at which the page may start."""

UNCERTAINTY = "uncertainty"
"""What a plane shows in place of an outcome's probability."""


class Slow(NamedTuple):
    """What takes seconds, because it learns.

    Attributes:
        classifier: the whole one; the findings may have one for predictions alone.
        failure: what the campaign says of a probability; None if nothing.
        curve: the learning curve; None without one.
    """

    classifier: "Callable[[], Classifier]"
    failure: "Callable[[], FailureFindings | None]"
    curve: "Callable[[], Curve | None]"


class OneDesign:
    """The page of one design; thread-safe.

    Attributes:
        findings: of the campaign.
        campaign, space, outcomes: of the findings.
        quantities: the variables, as shown to a reader.
        view: shows simulated designs; None if the simulator has none.
        fields: of the variables, in the middle of the space.
    """

    def __init__(self, findings: Findings, slow: Slow) -> None:
        self.findings, self._slow = findings, slow
        self.campaign, self.space = findings.campaign, findings.campaign.space
        self.outcomes = findings.campaign.simulator.outcomes
        self.quantities = quantities.variables(findings.campaign)
        self.view = view_of(self.campaign.simulator)
        middle = self.space.middle.tolist()
        self.fields = tuple(map(Field.of, self.space.parameters, self.quantities, middle))
        # Compile and load everything before the first request.
        values = self._named(middle)
        self.predict(values)
        if self.view is not None:
            self.view.prepare(self.point(values))

    @property
    def simulates(self) -> bool:
        """Whether designs can be simulated and shown."""
        return self.view is not None

    @cached_property
    def learned(self) -> Findings:
        """The findings with the whole classifier."""
        return replace(self.findings, classifier=self._slow.classifier())

    @cached_property
    def title(self) -> str:
        """The campaign's name."""
        return visible(self.campaign.settings.description or self.findings.folder.name)

    def page(self, **links: Any) -> str:
        """The page, with its links to others."""
        names, presets = self.space.names, self.presets
        # Choices have no axes.
        order = np.argsort(-self.findings.influence, kind="stable").tolist()
        ranking = [names[column] for column in order if not self.space.parameters[column].choices]
        return page(
            "campaign",
            title=self.title,
            simulations=len(self.findings.history.designs),
            fields=[field._replace(start=start) for field, start in zip(self.fields, presets[0][1], strict=True)],
            starts=[(text, json.dumps(self._named(X))) for text, X in presets],
            axes=[field for field in self.fields if not field.choices],
            plane=ranking[:2],
            along=ranking[0] if ranking else "",
            outcomes=self.outcomes,
            beyond=self.findings.beyond,
            simulates=self.simulates,
            noun=noun_of(self.campaign.simulator),
            **links,
        )

    @property
    def panels(self) -> Mapping[str, Panel]:
        """Its panels by name."""
        shown = (self.predict, self.plane, self.fragility, self.history, self.failure, self.simulate)
        return {one.__name__: one for one in shown}

    @cached_property
    def presets(self) -> list[tuple[str, list[float]]]:
        """Designs to start from: what each is, and its values."""
        history, found = self.findings.history, [self._undecided]
        for row, _ in at_the_boundary(self.findings):
            text = f"{words(self.outcomes[history.outcome[row]])}, near a boundary: simulation {history.id[row]}"
            found.append((text, history.designs[row].tolist()))
        return [*found, ("the middle of the space", self.space.middle.tolist())]

    @property
    def _undecided(self) -> tuple[str, list[float]]:
        """The design at which the page starts: nearest to the middle, of those whose outcome is most open."""
        findings = self.findings
        X = np.concatenate([findings.pool, findings.history.training.designs])
        apart = np.abs(predict(self.campaign, findings.classifier, X).beyond - 0.5)
        least = float(np.nanmin(apart))
        X = X[apart <= max(_OPEN, least)]
        away = np.linalg.norm(self.space.to_unit(X) - 0.5, axis=1)
        # Few digits: the page shows them.
        rounded = [float(f"{value:.4g}") for value in X[np.argmin(away)].tolist()]
        start = self.space.nearest(np.clip([rounded], self.space.low, self.space.high))[0]
        return "a design at the boundary" if least <= _OPEN else "the least certain design", start.tolist()

    def point(self, values: Values) -> Array:
        """The design in a form, (d,)."""
        read = zip(self.space.parameters, self.fields, strict=True)
        return np.array([float(one.rounded(field.read(values))) for one, field in read])

    def _named(self, X: list[float]) -> dict[str, float]:
        return dict(zip(self.space.names, X, strict=True))

    # --- what is predicted -------------------------------------------------------------------------------------------

    def predict(self, values: Values) -> str:
        """Probabilities of outcomes, and of boundaries with their 95 % intervals, or why there is no such design."""
        point = self.point(values)
        named = self.space.quantities(self._named(point.tolist()))
        broken = [one.text for one in self.space.constraints if not one.holds(named)]
        if broken:
            return page("predict", absent=f"No such design exists: it breaks {' and '.join(broken)}.")
        classifier, X = self.findings.classifier, point[None]
        exists = float(classifier.existence(X)[0])
        if exists < 0.5:
            absent = f"This design does not exist with a probability of {percent(1.0 - exists)}, by the simulations."
            return page("predict", absent=absent)
        predicted, boundaries = classifier.predicted(X), []
        for severity, name in enumerate(self.outcomes[1:], start=1):
            low, high = (float(end[0]) for end in interval(predicted, severity))
            boundaries.append((or_worse(name, self.outcomes), float(predicted.beyond(severity)[0]), low, high))
        colours = [outcome_colour(self.outcomes, index) for index in range(len(self.outcomes))]
        return page(
            "predict",
            absent="",
            undecided=bool(undecided(classifier, X)[0]),
            beyond=self.findings.beyond,
            target=boundaries[self.campaign.severity - 1],
            outcomes=list(zip(self.outcomes, predicted.probabilities[0].tolist(), colours, strict=True)),
            boundaries=boundaries,
        )

    def plane(self, values: Values) -> str:
        """A figure of the plane of two variables through a design.

        Raises:
            InputError: if both variables are the same.
        """
        shown = chosen(values, "shown", (*self.outcomes[1:], UNCERTAINTY))
        x, y = (self._axis(values, name) for name in ("across", "up"))
        if x == y:
            raise InputError(f"A plane needs two different variables, got {self.space.names[x]} twice.")
        point = self.point(values)
        along = [self._along(column, point, _GRID) for column in (x, y)]
        grid = np.meshgrid(*along)
        prediction = self._predicted(point, {x: grid[0].ravel(), y: grid[1].ravel()})
        uncertain = shown == UNCERTAINTY
        if uncertain:
            shades, title = prediction.high - prediction.low, f"uncertainty of P({plain(self.findings.beyond)})"
        else:
            shades, title = prediction.probabilities[:, self.outcomes.index(shown)], f"P({plain(words(shown))})"
        figure = plot_variable_plane(
            (self.quantities[x], self.quantities[y]),
            (along[0], along[1]),
            shades.reshape(grid[0].shape),
            prediction.undecided.reshape(grid[0].shape),
            title,
            marks_in(self.findings, point, [x, y]),
            self.outcomes,
            uncertain,
        )
        names = self.space.names[x], self.space.names[y]
        svg = inline(figure, "plane", f"{title} in the plane of {names[0]} and {names[1]}")
        return page("plane", svg=svg, place=place_of(figure.axes[0]), names=names)

    def fragility(self, values: Values) -> str:
        """A figure of the probability of lying beyond the target boundary against a variable."""
        column, point = self._axis(values, "along"), self.point(values)
        along = self._along(column, point, _CURVE)
        figure = plot_fragility(
            along,
            self._predicted(point, {column: along}),
            self.quantities[column],
            plain(self.findings.beyond),
            float(point[column]),
            outcome_colour(self.outcomes, self.campaign.severity),
        )
        return inline(figure, "fragility", f"P({self.findings.beyond}) against {self.space.names[column]}")

    def _along(self, column: int, point: Array, count: int) -> Array:
        """Values of a variable over its usual range and that of a design, (d,); (count,)."""
        low, high = (end[column] for end in self.space.usual)
        return np.linspace(min(low, point[column]), max(high, point[column]), count)

    def _axis(self, values: Values, name: str) -> int:
        """The column of a variable that a form names."""
        return self.space.names.index(chosen(values, name, self.space.names))

    def _predicted(self, point: Array, varied: Mapping[int, Array]) -> Any:
        """Predictions at a design in which some columns have other values."""
        rows = np.tile(point, (len(next(iter(varied.values()))), 1))
        for column, along in varied.items():
            rows[:, column] = self.space.parameters[column].rounded(along)
        return predict(self.campaign, self.findings.classifier, rows)

    # --- what the campaign learned -----------------------------------------------------------------------------------

    def history(self, _: Values) -> str:
        """The learning curve as a figure; empty without one."""
        curve = self._slow.curve()
        if curve is None:
            return ""
        boundary = plain(words(self.findings.boundary))
        return inline(plot_learning_curves(curve.scores, boundary, curve.test_size, _WIDTH), "curve", "Learning curve")

    def failure(self, _: Values) -> str:
        """What the campaign says of the probability of failure, and its design point as a start; empty if nothing."""
        from activefail.pages.report.failure import failure_section

        found = self._slow.failure()
        section = failure_section(self.learned, found, _WIDTH)
        if section is None or found is None:
            return ""
        point = None if found.point is None else json.dumps(self._named(found.point.X.tolist()))
        refused = self.campaign.settings.refused
        return page("failure", failure=section, beyond=self.findings.beyond, refused=refused, start=point)

    # --- how it moves ------------------------------------------------------------------------------------------------

    def simulate(self, values: Values) -> str:
        """Simulate a design and show it.

        Raises:
            InputError: if the campaign's simulator has no view.
        """
        if self.view is None:
            raise InputError(f"This campaign's simulator has no {noun_of(self.campaign.simulator)} to show.")
        return self.view.panel(self.point(values), _WIDTH)
