"""The analyses of a run folder: what can be asked, with which options, and which room answers."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from activefail.arguments import names_of, site_and_question
from activefail.csv_table import Target
from activefail.errors import InputError
from activefail.progress import Stage, silent
from activefail.request import REQUIRED, Request, option
from activefail.surrogate.threads import one_thread

if TYPE_CHECKING:
    from activefail.campaign.hazard import Hazard
    from activefail.campaign.question import Question
    from activefail.execution.executor import Executor
    from activefail.findings.error import ErrorFindings
    from activefail.findings.probability import ProbabilityFindings
    from activefail.risk.design.findings import DesignFindings
    from activefail.risk.fragility.findings import FragilityFindings
    from activefail.risk.sensitivity.findings import SensitivityFindings
    from activefail.run import Run
    from activefail.verification.probability_estimator import Estimator

SIMULATIONS = "Fresh simulations, outside the budget"
HAZARD = "Hazard file (docs/hazard.md)"
QUESTION = "File with other distributions of the variables (docs/probability.md)"
TARGET_BOUNDARY = "Default: the outcome of the target boundary."


def confidence(default: float, of: str = "of the intervals") -> Any:
    """The option `confidence`."""
    return option(default, f"Confidence {of}.", low=0.5, high=0.999)


def fixed_values() -> Any:
    """The option `fixed`."""
    return option(
        None,
        "TOML file with values of variables, such as T_b = 4.0; in Python also values by name.",
        Path,
        names=("--fixed", "--bearing"),
    )


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _range(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--range: must be two numbers separated by a comma, got {text!r}.") from None
    return low, high


@dataclass(frozen=True)
class VerifyRequest(Request["ErrorFindings"]):
    """Estimate the classifier's error over the design space.

    Fresh simulations give the estimate and its interval.
    """

    simulations: int = option(200, f"{SIMULATIONS}.", low=10, high=1_000_000)
    confidence: float = confidence(0.9, "of the interval")

    def answer(self, run: "Run") -> "ErrorFindings":
        from activefail.findings.error import ErrorFindings
        from activefail.verification.error import verify

        with estimating(run, self.executor, self.stage) as estimator:
            assert estimator.executor is not None
            error = verify(
                run.campaign, run.store, estimator.executor, estimator.classifier, estimator.iteration,
                self.simulations, self.confidence,
            )  # fmt: skip
        return ErrorFindings(error, run.boundary, run.summary.done, estimator.iteration)


@dataclass(frozen=True)
class ProbabilityRequest(Request["ProbabilityFindings"]):
    """Estimate the probability of an outcome, with an interval.

    The estimate combines the campaign's classifier with fresh simulations. The probability is that of the outcome or a
    more severe one.
    """

    simulations: int = option(50, f"{SIMULATIONS}; a question may add a mode check.", low=10, high=1_000_000)
    confidence: float = confidence(0.9, "of the interval")
    outcome: str | None = option(None, f"Outcome whose probability is estimated. {TARGET_BOUNDARY}", str)
    question: "Question | Path | str | None" = option(None, f"{QUESTION}, or a hazard file (docs/hazard.md).", Path)
    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file; the distribution is that of its pulses (docs/hazard.md).", Path
    )
    fixed: "Mapping[str, float] | Path | str | None" = fixed_values()

    def answer(self, run: "Run") -> "ProbabilityFindings":
        from activefail.findings.probability import ProbabilityFindings

        outcome = run._boundary_named(self.outcome)
        _, asked = site_and_question(run.campaign, self.hazard, self.question, self.fixed)
        with estimating(run, self.executor, self.stage) as estimator:
            sample = estimator.sample(outcome, self.simulations, asked, checks=True)
            findings = ProbabilityFindings.of(
                run.campaign, run.history, estimator.classifier, outcome, sample.estimate(self.confidence), asked
            )
        if self.hazard is None and self.question is None and self.fixed is None:
            run._save_estimate(findings)
        return findings


@dataclass(frozen=True)
class FragilityRequest(Request["FragilityFindings"]):
    """Show the probability of each outcome against intensity.

    The curves are for the outcome or a more severe one, against the intensity of the pulse or another variable.
    """

    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file; the curves are against the intensity of its pulses (docs/hazard.md).", Path
    )
    fixed: "Mapping[str, float] | Path | str | None" = fixed_values()
    intensity: Literal["pgv", "a_p"] = option(
        "pgv", "With --hazard: peak ground velocity, or amplitude of the pulses.", Literal["pgv", "a_p"]
    )
    against: str | None = option(None, "Without --hazard: the variable of the curves.", str, metavar="VARIABLE")
    bounds: tuple[float, float] | None = option(
        None, "With --against: range of the variable; that of the campaign by default.", str, names=("--range",),
        metavar="LOW,HIGH", parse=_range,
    )  # fmt: skip
    question: "Question | Path | str | None" = option(
        None, "With --against: file with other distributions (docs/probability.md).", Path
    )
    verify: int = option(0, f"{SIMULATIONS}, for intervals.", low=0, high=1_000_000)
    confidence: float = confidence(0.95)
    outcome: str | None = option(None, f"Outcome whose curve is verified. {TARGET_BOUNDARY}", str)

    table: ClassVar = "Table of the curves to write; - is standard output."
    pages: ClassVar = (
        "Folder for the page fragility.html, its pictures, fragility.json, tables, and files for pelicun and OpenQuake."
    )

    def answer(self, run: "Run") -> "FragilityFindings":
        from activefail.campaign.question_files import check_designs_of
        from activefail.risk.fragility.calculation import checked_ladder, fragility

        outcome, campaign = run._boundary_named(self.outcome), run.campaign
        site, asked = site_and_question(campaign, self.hazard, self.question, self.fixed)
        ladder = checked_ladder(site, asked, run.space, self.intensity, self.against, self.bounds, self.verify)
        if self.against is not None:
            for end in self.bounds or ():
                check_designs_of(asked.at({self.against: end}), campaign.simulator, "bounds (--range)")
        with estimating(run, self.executor, self.stage, bool(self.verify)) as estimator:
            return fragility(
                estimator, site, asked, self.intensity, ladder, outcome, self.verify, self.confidence, self.stage
            )

    def write_table(self, findings: "FragilityFindings", target: Target) -> None:
        from activefail.risk.fragility.curve_files import write_curves

        write_curves(findings, target)

    def write_pages(self, findings: "FragilityFindings", run: "Run", out: Path) -> list[Path]:
        from activefail.report.fragility import write_fragility

        return write_fragility(findings, out)


@dataclass(frozen=True)
class DesignRequest(Request["DesignFindings"]):
    """Find and verify the smallest design that meets a target.

    The target is a probability of an outcome, such as failure. Free variables stay within the campaign's ranges; the
    first one is made as small as the targets allow while the others are held.
    """

    target: float | str = option(
        REQUIRED,
        "Largest acceptable probability of failure, such as 0.10 or 10%; a risk category, II, III or IV; a "
        "risk such as '1% in 50 years'; or one for each outcome, such as failure=0.05,impact=0.3, where "
        "impact means impact or worse.",
        str,
    )
    hazard: "Hazard | Path | str | None" = option(None, "Hazard file of the site (docs/hazard.md).", Path)
    question: "Question | Path | str | None" = option(
        None, "Question file instead of a hazard (docs/probability.md).", Path
    )
    fixed: "Mapping[str, float] | Path | str | None" = fixed_values()
    free: "Sequence[str]" = option((), "Variables to design, such as D_tot,mu; D_tot by default.", str, parse=_names)
    cost: str = option(
        "", "Expression to minimise, such as 'D_tot * (1 + 20 * mu)'; the first free variable by default."
    )
    confidence: float = confidence(0.95, "that the target is met")
    simulations: int = option(
        1000, "Maximum number of fresh simulations for each target; not part of the budget.", low=10, high=1_000_000
    )
    chart: bool = option(False, "Compute the chart of required values, with --out.", with_out=True)

    pages: ClassVar = "Folder for the page design.html, its pictures, and design.json and design.toml."

    def answer(self, run: "Run") -> "DesignFindings":
        from activefail.risk.design.calculation import search_design
        from activefail.risk.design.design_task import DEFAULT_FREE, design_task, read_targets
        from activefail.risk.design.risk_target import at_risk

        campaign, names = run.campaign, names_of("free", self.free)
        requirements = read_targets(str(self.target), campaign.simulator.outcomes, run.boundary)
        site, asked = site_and_question(campaign, self.hazard, self.question, self.fixed, names or (DEFAULT_FREE,))
        rate = None
        if any(one.years is not None for one in requirements):
            site, requirements, rate = at_risk(site, requirements)
            site, asked = site_and_question(campaign, site, None, self.fixed, names or (DEFAULT_FREE,))
        task = design_task(campaign, asked, requirements, names, self.cost, self.confidence, self.simulations, rate)
        with estimating(run, self.executor, self.stage) as estimator:
            findings = search_design(estimator, task, site, self.chart, self.stage)
        run._save_design(findings)
        return findings

    def write_pages(self, findings: "DesignFindings", run: "Run", out: Path) -> list[Path]:
        from activefail.report.design import write_design

        return write_design(findings, out)


@dataclass(frozen=True)
class SensitivityRequest(Request["SensitivityFindings"]):
    """Show which variables affect a probability most.

    The classifier gives Sobol' indices, and the effect of one variable at a time; nothing is simulated. Needs SALib.
    """

    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file (docs/hazard.md); the sensitivity of a design's probability, averaged over the pulses.", Path
    )
    question: "Question | Path | str | None" = option(None, f"{QUESTION}.", Path)
    fixed: "Mapping[str, float] | Path | str | None" = fixed_values()
    outcome: str | None = option(None, f"Outcome whose probability is explained. {TARGET_BOUNDARY}", str)
    samples: int | None = option(
        None,
        "Points of the sample: a power of two, at least 16. Default: as many as take about two minutes.",
        int,
        low=16,
    )
    confidence: float = confidence(0.95)

    records: ClassVar = False
    counts: ClassVar = "evaluating"
    table: ClassVar = "CSV table to write; - is standard output."
    pages: ClassVar = "Folder for a page with pictures."

    def answer(self, run: "Run") -> "SensitivityFindings":
        from activefail.paper.p_values import variable_p_values
        from activefail.risk.sensitivity.calculation import sensitivity

        outcome = run._boundary_named(self.outcome)
        site, asked = site_and_question(run.campaign, self.hazard, self.question, self.fixed, run.space.names)
        with one_thread():
            found = sensitivity(
                run.campaign, run.classifier, outcome, site or asked, run.fixed_values(self.fixed), self.samples,
                self.confidence, self.begin,
            )  # fmt: skip
            severity = run.campaign.simulator.outcomes.index(outcome)
            return found.with_p_values(variable_p_values(run.space, run.history, severity))

    def write_table(self, findings: "SensitivityFindings", target: Target) -> None:
        from activefail.risk.sensitivity.findings import write_csv

        write_csv(findings, target)

    def write_pages(self, findings: "SensitivityFindings", run: "Run", out: Path) -> list[Path]:
        from activefail.report.sensitivity import write_sensitivity

        return write_sensitivity(findings, run.campaign, out)


@contextmanager
def estimating(
    run: "Run", executor: "Executor | None" = None, stage: Stage = silent, simulates: bool = True
) -> Iterator["Estimator"]:
    """What estimates probabilities with the present classifier, and simulates unless nothing is to be simulated.

    Raises:
        InputError: if the initial design is not finished.
    """
    from activefail.verification.probability_estimator import Estimator

    run._check_initial_design()
    with nullcontext(executor) if executor or not simulates else run._shown_executor() as pool, one_thread():
        learned, last = run.learn(stage), run.history.last_iteration
        yield Estimator(run.campaign, run.store, pool, learned.classifier, last)
