"""The page Design: the displacement capacity that a target requires, under the classifier and verified."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.design.design_task import LOOKS, RISK_CATEGORIES, SIMULATIONS, Requirement, design_task
from activefail.analyses.design.findings import DesignFindings
from activefail.analyses.design.required_chart import least_value
from activefail.analyses.design.search import find_design
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.estimates.integral import Boundaries, Standardised, boundary_of, existence
from activefail.estimates.probability_estimator import Estimator
from activefail.execution.executor import CountingExecutor
from activefail.execution.local import local_executor
from activefail.pages.explorer.campaign import OneDesign
from activefail.pages.explorer.fields import Field, Values, chosen
from activefail.pages.explorer.jobs import Job, Jobs
from activefail.pages.explorer.pages import Panel
from activefail.pages.explorer.pages import page as page_of
from activefail.pages.figures.axes import outcome_colour
from activefail.pages.figures.curves import plot_required_value
from activefail.pages.figures.svg import inline
from activefail.record.memory import MemoryStore
from activefail.seismic.hazard.hazard import CAPACITY, FRICTION, Hazard
from activefail.seismic.hazard.velocity import AMPLITUDE, PERIOD
from activefail.simulators.interface import terms_of
from activefail.space.parameter import Parameter
from activefail.space.shares import percent, significant
from activefail.space.space import Array
from activefail.text.progress import Begin
from activefail.text.quantities import plain

_ALONG = 9
"""Values of the displacement capacity on the curve."""

_TRIALS = 3
"""Values between two of the curve whose probabilities are compared with the target."""

_TOWARDS_SAFETY = 0.05
"""Share of the way to a value that meets the target by which the next trial leaves the interpolated value."""

_ROUNDED = 1e-9
"""Rounding error of a displacement capacity [m]."""

_NOTES = (
    "These numbers are the classifier's and have no interval; a verification by fresh simulations has one.",
    "T_p is the period of the acceleration pulse. Published periods of the velocity pulse are divided by 1.2247 to "
    "give T_p.",
)

_ELSEWHERE = (
    "The explorer simulates only activefail's own bearing model, so it cannot verify this design. "
    "`activefail design` can, if the campaign's simulator runs on this machine."
)

PERIODS = (
    Field("magnitude", "M", "", "magnitude, by the relation shahi-baker-2011", 5.5, 8.0, 7.0),
    Field("median_period", "T_p", "s", "median period of the pulses", 0.25, 8.0, 2.7),
)
"""Alternatives: the form names one of them as `period`."""

_SPREADS = (
    Field("period_dispersion", "β of T_p", "", "dispersion of the periods", 0.05, 1.0, 0.56),
    Field("median_pgv", "PGV", "m/s", "median peak ground velocity", 0.1, 3.0, 1.0),
    Field("pgv_dispersion", "β of PGV", "", "dispersion of the peak ground velocities", 0.05, 1.0, 0.25),
)
_FRICTION_BOUND = Field("mu_lower", "factor on μ", "", "lower bound of the friction", 0.5, 1.0, 0.8)
TARGET = Field("target", "target", "%", "largest acceptable probability", 0.1, 90.0, 10.0)

Numbers = tuple[tuple[str, float], ...]
"""Numbers by name: hashable, so that answers to the same ones are kept."""


@dataclass(frozen=True)
class Asked:
    """What a form asks: numbers of the hazard, values of the other variables, the largest acceptable probability."""

    site: Numbers
    bearing: Numbers
    target: float


@dataclass(frozen=True, eq=False)
class _Watched(Estimator):
    """An estimator whose predictions are counted, and end when the verification must stop."""

    job: Job

    def standardised(self, outcome: str) -> Standardised:
        """An outcome's boundary as a function of designs."""
        return _Counted(super().standardised(outcome), self.job.predicted)

    @property
    def boundaries(self) -> Boundaries:
        """All boundaries as a function of designs."""
        return _Counted(super().boundaries, self.job.predicted)


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
    """

    boundary: Standardised
    hazard: Hazard
    question: Question
    outside: float
    capacity: Parameter

    @cached_property
    def grid(self) -> Array:
        """(n,) values of the capacity."""
        return np.unique(self.capacity.rounded(np.linspace(self.capacity.low, self.capacity.high, _ALONG)))

    @cached_property
    def P(self) -> Array:
        """(n,) their probabilities."""
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


class DesignPage:
    """The page Design of a campaign with a pulse and a displacement capacity; thread-safe."""

    def __init__(self, one: OneDesign, jobs: Jobs) -> None:
        self._findings, self._jobs = one.learned, jobs
        self.campaign, self.space, self._one = one.campaign, one.space, one
        column = self.space.names.index(CAPACITY)
        self._capacity, self._quantity = self.space.parameters[column], one.quantities[column]
        friction = next((of for of in self.space.parameters if of.name == FRICTION), None)
        self.site = _SPREADS if friction is None or friction.choices else (*_SPREADS, _FRICTION_BOUND)
        self.bearing = tuple(of for of in one.fields if of.name not in (PERIOD, AMPLITUDE, CAPACITY))
        # A target alone changes no curve.
        self._curve = lru_cache(64)(self._curve_of)

    def page(self, **links: Any) -> str:
        """The page, with its links to others."""
        targets = [(f"{100.0 * p:g} % (risk category {name})", 100.0 * p) for name, p in RISK_CATEGORIES.items()]
        return _page(
            "design",
            title=self._one.title,
            simulations=len(self._findings.history.designs),
            beyond=self._findings.beyond,
            capacity=self._quantity.text,
            periods=PERIODS,
            site=self.site,
            bearing=self.bearing,
            target=TARGET,
            simulates=self._one.simulates,
            most=SIMULATIONS,
            targets=[(text, json.dumps({TARGET.name: value})) for text, value in targets],
            **links,
        )

    @property
    def panels(self) -> Mapping[str, Panel]:
        """Its panels by name."""
        return {"required": self.required, "verify": self.verify}

    def asked(self, values: Values) -> Asked:
        """What a form asks."""
        period = chosen(values, "period", [one.name for one in PERIODS])
        site = (*(one for one in PERIODS if one.name == period), *self.site)
        target = float(f"{TARGET.read(values) / 100.0:.12g}")
        return Asked(_read(site, values), _read(self.bearing, values), target)

    # --- by the classifier -------------------------------------------------------------------------------------------

    def required(self, values: Values) -> str:
        """The displacement capacity that a target requires under the classifier, and the curve that it is read off."""
        asked = self.asked(values)
        curve = self._curve(asked.site, asked.bearing)
        value, beyond = curve.least(asked.target), self._findings.beyond
        is_met = bool(np.isfinite(value))
        # A smaller one may meet the target where a larger one does not: failure is not monotone.
        nearest = curve.grid[-1] if curve.P.min() <= asked.target else curve.grid[np.argmin(curve.P)]
        at = value if is_met else float(nearest)
        probability, here = curve.probability(at), self._with_unit(significant(at))
        terms = terms_of(self.campaign.simulator, self.space.quantities({**dict(asked.bearing), CAPACITY: at}))
        figure = plot_required_value(
            curve.grid,
            curve.P,
            asked.target,
            value,
            self._quantity,
            plain(beyond),
            outcome_colour(self._one.outcomes, self.campaign.severity),
        )
        return _page(
            "required",
            required=value if is_met else None,
            probability=probability,
            value=self._with_unit(significant(value)) if is_met else "none",
            text=self._sentence(is_met, at, percent(probability), asked.target),
            median_period=significant(curve.hazard.median_period),
            outside=percent(curve.outside),
            notes=[
                *([] if terms is None else [f"{CAPACITY} = {here}: {terms.text}."]),
                *_NOTES,
                *curve.hazard.assumptions,
            ],
            svg=inline(figure, "required", f"P({beyond}) against {CAPACITY}, with the target"),
            beyond=beyond,
            capacity=self._quantity.text,
        )

    def _curve_of(self, site: Numbers, bearing: Numbers) -> _Curve:
        boundary = boundary_of(self._findings.classifier, self.campaign.features, self._findings.boundary)
        hazard = _hazard(dict(site))
        question = hazard.question(self.space, dict(bearing))
        # The capacity stays within its range.
        outside = question.at({CAPACITY: self._capacity.high}).share_outside(self.space)
        return _Curve(boundary, hazard, question, outside, self._capacity)

    def _sentence(self, is_met: bool, at: float, probability: str, target: float) -> str:
        name, event = self._quantity.text, f"P({self._findings.beyond}) = {probability}"
        here = f"{name} = {self._with_unit(significant(at))}"
        if not is_met:
            low, high = significant(self._capacity.low), self._with_unit(significant(self._capacity.high))
            return (
                f"No {name} from {low} to {high} is large enough that it and every larger one meet the target. "
                f"{event} at {here}."
            )
        if at == self._capacity.low:
            return f"{here}, the lower end of the range, meets the target: {event} there."
        return f"The target {100.0 * target:g} % requires {here}. {event} there."

    def _with_unit(self, number: str) -> str:
        return f"{number} {self._quantity.unit}".strip()

    # --- by simulations ----------------------------------------------------------------------------------------------

    def verify(self, values: Values) -> str:
        """Start or stop a verification if a button was pressed; the progress or the result of the last one."""
        asked, folder, job = self.asked(values), self._findings.folder, self._jobs.last
        match values.get("do"):
            case "verify" if self._one.simulates:
                self._jobs.start(lambda job: self.verified(job, asked), (folder, self.campaign, asked))
            case "verify":
                raise InputError(_ELSEWHERE)
            case "stop" if job is not None:
                job.must_stop = True
        job = self._jobs.last
        return _page(
            "verify",
            steps=2 * LOOKS,
            job=job if job is not None and job.asked[0] == folder else None,
            # A campaign that has learned meanwhile is opened again, as another object.
            is_of_these=job is not None and job.asked[1] is self.campaign and job.asked[2] == asked,
            elsewhere="" if self._one.simulates else _ELSEWHERE,
        )

    def verified(self, job: Job, asked: Asked) -> dict[str, Any]:
        """Search the design and verify it, as `activefail design` does; nothing is stored.

        Raises:
            StoppedError: if it must stop.
            SimulationError: if no simulation gives an outcome.
        """
        campaign, findings = self.campaign, self._findings
        curve = self._curve(asked.site, asked.bearing)
        inquiry = Inquiry(campaign, curve.question, curve.hazard)
        task = design_task(inquiry, (Requirement(findings.boundary, asked.target),), (CAPACITY,))

        def counting() -> nullcontext[Begin]:
            return nullcontext(lambda _: job.simulated)

        with CountingExecutor(local_executor(campaign.simulator), counting) as executor:
            store, last = MemoryStore(campaign.schema), int(findings.history.iteration[-1])
            estimator = _Watched(campaign, store, executor, findings.classifier, last, job)
            designed = find_design(estimator, task, job.stage)
        of_design = DesignFindings(designed, designed.question.outside(self.space))
        numbers, value = of_design.as_json(), designed.values[CAPACITY]
        confidence = f"{100.0 * numbers['confidence_of_each_bound']:.3g} % confidence each"
        return {
            "status": designed.status,
            "verdict": of_design.verdict,
            "value": value,
            "text": (
                f"{self._quantity.text} = {self._with_unit(significant(value))}: P({findings.beyond}) = "
                f"{percent(numbers['probability'])}, between {percent(numbers['low'])} and {percent(numbers['high'])} "
                f"({confidence}), from {numbers['simulations']} fresh simulations."
            ),
            "assumptions": of_design.assumptions,
        }


_page = partial(page_of, package=__package__)


def _read(fields: Sequence[Field], values: Values) -> Numbers:
    return tuple((one.name, one.read(values)) for one in fields)


def _hazard(site: Mapping[str, float]) -> Hazard:
    """The hazard with these numbers."""
    values: dict[str, Any] = {
        "description": "the site of the page",
        "pgv": {"median_m_s": site["median_pgv"], "dispersion": site["pgv_dispersion"]},
    }
    dispersion = {"dispersion": site["period_dispersion"]}
    if "magnitude" in site:
        values["magnitude"] = {"M": site["magnitude"]} | dispersion
    else:
        values["pulse_period"] = {"median_s": site["median_period"], "definition": "acceleration"} | dispersion
    if _FRICTION_BOUND.name in site:
        values["properties"] = {_FRICTION_BOUND.name: site[_FRICTION_BOUND.name]}
    return Hazard.of(values, Path("site"))
