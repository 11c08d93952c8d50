"""Answers of the page Design: the displacement capacity that a target requires, under the classifier and verified."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from activefail.campaign.hazard import CAPACITY, FRICTION, Hazard, hazard_of, hazard_question
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import AMPLITUDE, PERIOD, Question
from activefail.execution.executor import CountingExecutor
from activefail.execution.local import local_executor
from activefail.explorer.answers import Answers, Slider
from activefail.explorer.pages import Answer
from activefail.explorer.questions import Reader, number, read
from activefail.explorer.verification import STEPS, Verification
from activefail.figures.axes import outcome_colour
from activefail.figures.curves import plot_required_value
from activefail.figures.svg import inline
from activefail.findings.quantities import Quantity, plain
from activefail.parameter import Parameter
from activefail.progress import Begin
from activefail.record.memory import MemoryStore
from activefail.reliability.integral import Boundaries, Standardised, boundary_of, existence
from activefail.risk.classifier_probability import classifier_probability
from activefail.risk.design.design_task import RISK_CATEGORIES, SIMULATIONS, Requirement, design_task
from activefail.risk.design.findings import DesignFindings
from activefail.risk.design.required_chart import least_value
from activefail.risk.design.search import find_design
from activefail.shares import percent, significant
from activefail.simulators.bearing import terms_of
from activefail.space import Array
from activefail.verification.probability_estimator import Estimator

_ALONG = 9
"""Values of the displacement capacity on the curve."""

_TRIALS = 3
"""Values between two of the curve whose probabilities are compared with the target."""

_TOWARDS_SAFETY = 0.05
"""Share of the way to a value that meets the target by which the next trial leaves the interpolated value."""

_ROUNDED = 1e-9
"""Rounding error of a displacement capacity [m]."""

_TARGETS = 0.001, 0.9
"""The least and the largest target."""

_NOTES = (
    "These numbers are the classifier's and have no interval; a verification by fresh simulations has one.",
    "T_p is the period of the acceleration pulse. Published periods of the velocity pulse are divided by 1.2247 to "
    "give T_p.",
)


MAGNITUDE = Slider("magnitude", "M", "", "magnitude, by the relation shahi-baker-2011", 5.5, 8.0, 7.0)
MEDIAN_PERIOD = Slider("median_period", "T_p", "s", "median period of the pulses", 0.25, 8.0, 2.7)
_PERIODS = (MAGNITUDE, MEDIAN_PERIOD)
_SPREADS = (
    Slider("period_dispersion", "β of T_p", "", "dispersion of the periods", 0.05, 1.0, 0.56),
    Slider("median_pgv", "PGV", "m/s", "median peak ground velocity", 0.1, 3.0, 1.0),
    Slider("pgv_dispersion", "β of PGV", "", "dispersion of the peak ground velocities", 0.05, 1.0, 0.25),
)
_FRICTION_BOUND = Slider("mu_lower", "factor on μ", "", "lower bound of the friction", 0.5, 1.0, 0.8)


Numbers = tuple[tuple[str, float], ...]
"""Numbers by name: hashable, so that answers to the same ones are kept."""


@dataclass(frozen=True, eq=False)
class _Watched(Estimator):
    """An estimator whose predictions are counted, and end when the verification must stop."""

    verification: Verification

    def standardised(self, outcome: str) -> Standardised:
        """An outcome's boundary as a function of designs."""
        return self._watched(super().standardised(outcome))

    @property
    def boundaries(self) -> Boundaries:
        """All boundaries as a function of designs."""
        return self._watched(super().boundaries)

    def _watched(self, of_designs: Boundaries) -> Boundaries:
        return _Counted(of_designs, self.verification.predicted)


@dataclass(frozen=True)
class _Counted:
    """Boundaries that count their designs."""

    of_designs: Boundaries
    count: Callable[[int], None]

    def __call__(self, X: Array) -> Array:
        self.count(len(X))
        return self.of_designs(X)

    @property
    def exists(self) -> Boundaries | None:
        return existence(self.of_designs)


@dataclass(frozen=True, eq=False)
class _Curve:
    """The probability beyond the target boundary against the displacement capacity, for one site and bearing.

    Attributes:
        boundary: as a function of designs.
        hazard, question: of the site and the bearing.
        outside: share of the question's distribution outside the campaign's design space.
        capacity: the variable.
        grid: (n,) values of it.
        P: (n,) their probabilities.
    """

    boundary: Standardised
    hazard: Hazard
    question: Question
    outside: float
    capacity: Parameter
    grid: Array

    @cached_property
    def P(self) -> Array:
        return np.array([self.probability(at) for at in self.grid.tolist()])

    def probability(self, at: float) -> float:
        """At a displacement capacity."""
        return classifier_probability(self.boundary, self.question.at({CAPACITY: at}))

    def least(self, target: float) -> float:
        """The least capacity that meets a target, as do all larger ones of the grid; NaN if there is none."""
        value = self._least_between(target)
        # What is made: the next of the variable's steps.
        steps = self.capacity.values
        return float(steps[np.searchsorted(steps, value - _ROUNDED)]) if len(steps) and np.isfinite(value) else value

    def _least_between(self, target: float) -> float:
        value = least_value(self.grid, self.P, target)
        if not self.grid[0] < value < self.grid[-1]:
            return value
        k = int(np.searchsorted(self.grid, value))
        safe, of_safe = float(self.grid[k]), float(self.P[k])
        for _ in range(_TRIALS):
            # Between two values of the grid the curve may bend upwards.
            found = self.probability(value)
            if found <= target:
                return value
            value = least_value(np.array([value, safe]), np.array([found, of_safe]), target)
            value += _TOWARDS_SAFETY * (safe - value)
        return safe


class DesignAnswers:
    """Answers of the page Design about one campaign with a pulse and a displacement capacity; thread-safe."""

    def __init__(self, answers: Answers) -> None:
        self._answers, self.campaign, self.space = answers, answers.campaign, answers.space
        self._boundary = answers.findings.boundary
        # A target alone changes no curve.
        self._curve = lru_cache(64)(self._curve_of)

    @property
    def _quantity(self) -> Quantity:
        return self._answers.quantities[self.space.names.index(CAPACITY)]

    @property
    def _others(self) -> tuple[Slider, ...]:
        """The sliders of the site but for that of the periods."""
        friction = next((one for one in self.space.parameters if one.name == FRICTION), None)
        return _SPREADS if friction is None or friction.choices else (*_SPREADS, _FRICTION_BOUND)

    @property
    def _bearing(self) -> tuple[Slider, ...]:
        """The sliders of the other variables, from the middle of the space."""
        chosen = (PERIOD, AMPLITUDE, CAPACITY)
        return tuple(slider for slider in self._answers.sliders if slider.name not in chosen)

    def about(self) -> Answer:
        """The data that the page contains from the start."""
        about = self._answers.about()
        return {
            "title": about["title"],
            "simulations": about["simulations"],
            "periods": [slider._asdict() for slider in _PERIODS],
            "site": [slider._asdict() for slider in self._others],
            "bearing": [slider._asdict() for slider in self._bearing],
            "targets": [
                {"text": f"{100.0 * p:g} % (risk category {name})", "value": p} for name, p in RISK_CATEGORIES.items()
            ],
            "low": _TARGETS[0],
            "high": _TARGETS[1],
            "required": self._quantity.text,
            "unit": self._quantity.unit,
            "beyond": self._answers.findings.beyond,
            "unverified": self.unverified,
            "most": SIMULATIONS,
            "steps": STEPS,
        }

    @property
    def readers(self) -> dict[str, Reader]:
        """Of the values of a question: numbers of the site, values of the bearing's other variables, and the target."""
        return {"site": self._site, "bearing": _numbers(self._bearing), "target": number(*_TARGETS)}

    def _site(self, name: str, values: Any) -> Numbers:
        period = next((one for one in _PERIODS if isinstance(values, dict) and one.name in values), MAGNITUDE)
        return _numbers((period, *self._others))(name, values)  # type: ignore[no-any-return]

    def required(self, site: Numbers, bearing: Numbers, target: float) -> Answer:
        """The displacement capacity that a target requires under the classifier, and the curve that it is read off.

        Args:
            site: numbers of the hazard.
            bearing: values of the other variables.
            target: largest acceptable probability.
        """
        curve = self._curve(site, bearing)
        value = curve.least(target)
        is_met = bool(np.isfinite(value))
        # A smaller one may meet the target where a larger one does not: failure is not monotone.
        nearest = curve.grid[-1] if curve.P.min() <= target else curve.grid[np.argmin(curve.P)]
        at = value if is_met else float(nearest)
        probability = curve.probability(at)
        terms = terms_of(self.campaign.simulator, self.space.quantities({**dict(bearing), CAPACITY: at}))
        return {
            "required": value if is_met else None,
            "probability": probability,
            "value": self._with_unit(significant(value)) if is_met else "none",
            "text": self._sentence(is_met, at, probability, target),
            "grid": curve.grid.tolist(),
            "curve": curve.P.tolist(),
            "median_period": curve.hazard.median_period,
            "outside_text": percent(curve.outside),
            "notes": [
                *([] if terms is None else [f"{CAPACITY} = {self._with_unit(significant(at))}: {terms.text}."]),
                *_NOTES,
                *curve.hazard.assumptions,
            ],
            "svg": self._drawn(curve, target, value),
        }

    def verified(self, verification: Verification, site: Numbers, bearing: Numbers, target: float) -> Answer:
        """Search the design and verify it, as `activefail design` does; nothing is stored.

        Args:
            verification: told of the progress; ends the work when it must stop.
            site, bearing, target: as for `required`.

        Raises:
            StoppedError: if it must stop.
            SimulationError: if no simulation gives an outcome.
        """
        campaign, findings = self.campaign, self._answers.findings
        curve = self._curve(site, bearing)
        asked = Inquiry(campaign, curve.question, curve.hazard)
        task = design_task(asked, (Requirement(self._boundary, target),), (CAPACITY,))
        last = int(findings.iteration[-1])

        def counting() -> nullcontext[Begin]:
            return nullcontext(lambda _: verification.simulated)

        with CountingExecutor(local_executor(campaign.simulator), counting) as executor:
            store = MemoryStore(campaign.schema)
            estimator = _Watched(campaign, store, executor, findings.classifier, last, verification)
            designed = find_design(estimator, task, verification.stage)
        of_design = DesignFindings(designed, designed.question.outside(self.space))
        numbers, value = of_design.as_json(), designed.values[CAPACITY]
        return {
            "status": designed.status,
            "verdict": of_design.verdict,
            "value": value,
            "text": (
                f"{self._quantity.text} = {self._with_unit(significant(value))}: P({findings.beyond}) = "
                f"{percent(numbers['probability'])}, between {percent(numbers['low'])} and {percent(numbers['high'])} "
                f"({100.0 * numbers['confidence_of_each_bound']:.3g} % confidence each), from "
                f"{numbers['simulations']} fresh simulations."
            ),
            "assumptions": of_design.assumptions,
        }

    @property
    def unverified(self) -> str:
        """Why the explorer verifies nothing; empty if it does. It runs activefail's own bearing model only."""
        if self._answers.simulates:
            return ""
        return (
            "The explorer simulates only activefail's own bearing model, so it cannot verify this design. "
            "`activefail design` can, if the campaign's simulator runs on this machine."
        )

    @property
    def _range(self) -> tuple[float, float]:
        column = self.space.names.index(CAPACITY)
        return float(self.space.low[column]), float(self.space.high[column])

    def _curve_of(self, site: Numbers, bearing: Numbers) -> _Curve:
        boundary = boundary_of(self._answers.findings.classifier, self.campaign.features, self._boundary)
        hazard = _hazard(site)
        question = hazard_question(hazard, self.space, dict(bearing))
        capacity = self.space.parameters[self.space.names.index(CAPACITY)]
        grid = np.unique(capacity.rounded(np.linspace(*self._range, _ALONG)))
        # D_tot stays within its range.
        outside = question.at({CAPACITY: self._range[1]}).share_outside(self.space)
        return _Curve(boundary, hazard, question, outside, capacity, grid)

    def _sentence(self, is_met: bool, at: float, probability: float, target: float) -> str:
        event = f"P({self._answers.findings.beyond})"
        here = f"{self._quantity.text} = {self._with_unit(significant(at))}"
        if not is_met:
            low, high = (significant(end) for end in self._range)
            return (
                f"No {self._quantity.text} from {low} to {self._with_unit(high)} is large enough that it and every "
                f"larger one meet the target. {event} = {percent(probability)} at {here}."
            )
        if at == self._range[0]:
            return f"{here}, the lower end of the range, meets the target: {event} = {percent(probability)} there."
        return f"The target {100.0 * target:g} % requires {here}. {event} = {percent(probability)} there."

    def _with_unit(self, number: str) -> str:
        return f"{number} {self._quantity.unit}".strip()

    def _drawn(self, curve: _Curve, target: float, value: float) -> str:
        answers = self._answers
        beyond, colour = plain(answers.findings.beyond), outcome_colour(answers.outcomes, self.campaign.severity)
        figure = plot_required_value(curve.grid, curve.P, target, value, self._quantity, beyond, colour)
        return str(inline(figure, "required", f"P({answers.findings.beyond}) against {CAPACITY}, with the target"))


def _hazard(site: Numbers) -> Hazard:
    """The hazard with these numbers."""
    of = dict(site)
    values: dict[str, Any] = {
        "description": "the site of the page",
        "pgv": {"median_m_s": of["median_pgv"], "dispersion": of["pgv_dispersion"]},
    }
    dispersion = {"dispersion": of["period_dispersion"]}
    if MAGNITUDE.name in of:
        values["magnitude"] = {"M": of[MAGNITUDE.name]} | dispersion
    else:
        values["pulse_period"] = {"median_s": of[MEDIAN_PERIOD.name], "definition": "acceleration"} | dispersion
    if _FRICTION_BOUND.name in of:
        values["properties"] = {_FRICTION_BOUND.name: of[_FRICTION_BOUND.name]}
    return hazard_of(values, Path("site"))


def _numbers(sliders: tuple[Slider, ...]) -> Reader:
    """The numbers of all these sliders."""
    readers = {slider.name: number(slider.low, slider.high) for slider in sliders}
    return lambda name, values: tuple(read(values, readers, name).items())
