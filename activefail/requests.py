"""The analyses of a run folder: what can be asked, with which options, and which package answers."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from activefail.arguments import executor_named, names_of
from activefail.csv_table import Target
from activefail.errors import InputError, naming
from activefail.files import check_file, path_of, writing_to
from activefail.names import INTENSITIES
from activefail.numerals import counted
from activefail.progress import Stage, silent
from activefail.record.layout import COMPARISON, CURVES, REPORT, SCORES, check_output
from activefail.request import REQUIRED, Option, Request, declared, function_of, option, options
from activefail.surrogate.threads import one_thread

if TYPE_CHECKING:
    from activefail.accelerogram_sets import RecordSet
    from activefail.bearing.design import Model, Tolerance
    from activefail.campaign.hazard import Hazard
    from activefail.campaign.question import Question
    from activefail.comparison.equivalent import ComparisonFindings
    from activefail.execution.executor import Executor
    from activefail.findings.estimates import ErrorFindings, ProbabilityFindings, SurfaceFindings
    from activefail.intensity import Intensity
    from activefail.report.evidence import ReportFindings
    from activefail.risk.design.by_stripes import DesignByStripes
    from activefail.risk.design.findings import DesignFindings
    from activefail.risk.fragility.by_stripes import FragilityByStripes
    from activefail.risk.fragility.findings import FragilityFindings
    from activefail.risk.hazard_summary import HazardSummary
    from activefail.risk.ida.findings import IdaFindings
    from activefail.risk.ida.p695 import MarginRequest
    from activefail.risk.ida.simulations import Values
    from activefail.risk.sensitivity.findings import SensitivityFindings
    from activefail.run import Run
    from activefail.stripes.findings import StripeFindings
    from activefail.stripes.stripe import Stripes
    from activefail.verification.probability_estimator import Estimator

SIMULATIONS = "Fresh simulations, outside the budget"
HAZARD = "Hazard file (docs/hazard.md)"
QUESTION = "File with other distributions of the variables (docs/probability.md)"
TARGET_BOUNDARY = "Default: the outcome of the target boundary."

MODEL = Option(
    "Choices of the bearing model.",
    "activefail.bearing.design:Model",
    parts={
        "slider_diameter": Option("Slider diameter D_sl [m].", float, default=0.30),
        "restitution_coefficient": Option("Coefficient of restitution of the contacts.", float, default=0.65),
        "slider_density": Option("Density of the slider [kg/m³].", float, default=7850.0),
        "loss_of_confinement": Option(
            "Count the bearing as failed once no rim restrains the slider.", bool, default=True
        ),
        "restitution": Option("Mass that sets the contact damping: pairwise or assembly.", str, default="pairwise"),
        "friction_velocity": Option("Velocity over which friction is regularised [m/s].", float, default=1e-3),
        "rim": Option("Type of the rims: rigid, breaking, yielding or none.", str, default="rigid"),
        "rim_strength": Option("Force at which a rim breaks or yields, over the weight.", float),
        "rim_deformation": Option("Plastic deformation at which a yielding rim breaks [m].", float),
    },
)
TOLERANCE = Option(
    "Accuracy of the integration.",
    "activefail.bearing.design:Tolerance",
    parts={"relative": Option("Relative tolerance of the integration.", float, names=("--tolerance",), default=1e-4)},
)


MARGIN = Option(
    "Collapse margin of FEMA P695.",
    "activefail.risk.ida.p695:MarginRequest",
    parts={
        "mce": Option(
            "Intensity of the maximum considered earthquake; adds the collapse margin ratio of FEMA P695.", float
        ),
        "ssf": Option("Spectral shape factor of FEMA P695, with --mce; 1 by default.", float),
        "sdc": Option(
            "Seismic design category (dmax, dmin, cmax, cmin, bmax, bmin), to compute the shape factor and --mce; "
            "requires --scale-to p695.",
            str,
        ),
        "ductility": Option("Period-based ductility of FEMA P695, for --sdc and --ratings.", float),
        "beta_total": Option("Total dispersion β, with --mce; 0.5 by default.", float),
        "ratings": Option(
            "Ratings A to D of design requirements, test data and model, such as B,B,C, to compute β.", str
        ),
    },
)

WORKERS = Option("Parallel simulations; all cores by default.", int, low=1)
EXECUTOR = Option(
    "Where simulations run: this machine, or a Dask cluster.",
    Literal["local", "dask"],
    names=("--executor",),
    default="local",
)
SCHEDULER = Option("Address of the Dask cluster, such as tcp://head:8786.", str, metavar="ADDRESS")
FIXED = Option(
    "Values of variables, such as T_b=4.0,mu=0.05, or a TOML file with them; in Python also values by name.",
    Path,
    names=("--fixed", "--bearing"),
)

WRONG = Option(
    "Over finitely many values, such as records: simulate the doubtful ones until so large a share is expected to be "
    "predicted wrongly, such as 0.01 (docs/stripes.md).",
    float,
    low=0.0,
    high=0.5,
)
AT_ONCE = Option(
    "With --wrong: values that are simulated at a time, before the classifier learns again.",
    int,
    low=1,
    default=3,
    needs="wrong",
)


def confidence(default: float, of: str = "of the intervals") -> Any:
    """The option `confidence`."""
    return option(default, f"Confidence {of}.", low=0.5, high=0.999)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _range(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--range: must be two numbers separated by a comma, got {text!r}.") from None
    return low, high


@dataclass(frozen=True)
class VerifyRequest(Request["ErrorFindings | SurfaceFindings"]):
    """Estimate the classifier's error over the design space.

    Fresh simulations give the estimate and its interval. If the simulator does not repeat, no design is wrong; they
    score the classifier's probabilities.
    """

    simulations: int = option(200, f"{SIMULATIONS}.", low=10, high=1_000_000)
    confidence: float = confidence(0.9, "of the interval")

    def answer(self, run: "Run") -> "ErrorFindings | SurfaceFindings":
        from activefail.findings.estimates import ErrorFindings, SurfaceFindings
        from activefail.verification.error import verify
        from activefail.verification.surface import verify_surface

        asked = self.simulations, self.confidence
        with estimating(run, self.executor, self.stage) as estimator:
            of = run.boundary, run.summary.done, estimator.iteration
            if not estimator.classifier.repeatable:
                return SurfaceFindings(verify_surface(estimator, *asked), *of)
            return ErrorFindings(verify(estimator, *asked), *of)


@dataclass(frozen=True)
class ProbabilityRequest(Request["ProbabilityFindings | StripeFindings"]):
    """Estimate the probability of an outcome, with an interval.

    The estimate combines the campaign's classifier with fresh simulations. The probability is that of the outcome or a
    more severe one. With --wrong the doubtful ones of finitely many values are simulated, and the campaign learns from
    them.
    """

    simulations: int = option(
        50, f"{SIMULATIONS}; a question may add a mode check.", low=10, high=1_000_000, bars="wrong"
    )
    confidence: float = confidence(0.9, "of the interval")
    outcome: str | None = option(None, f"Outcome whose probability is estimated. {TARGET_BOUNDARY}", str)
    question: "Question | Path | str | None" = option(None, f"{QUESTION}, or a hazard file (docs/hazard.md).", Path)
    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file; the distribution is that of its pulses (docs/hazard.md).", Path
    )
    fixed: "Mapping[str, float] | Path | str | None" = declared(FIXED)
    wrong: float | None = declared(WRONG)
    at_once: int = declared(AT_ONCE)

    def answer(self, run: "Run") -> "ProbabilityFindings | StripeFindings":
        from activefail.campaign.inquiry import Inquiry
        from activefail.findings.estimates import ProbabilityFindings
        from activefail.findings.status import estimate_of
        from activefail.stripes.findings import StripeFindings

        outcome = run._boundary_named(self.outcome)
        asked = Inquiry.of(run.campaign, self.hazard, self.question, self.fixed).question
        if self.wrong is not None:
            with asking_stripes(run, self.at_once, self.executor, self.stage) as stripes:
                stripe = stripes.ask(asked, outcome, self.wrong)
            return StripeFindings.of(run.campaign, stripe, self.confidence)
        with estimating(run, self.executor, self.stage) as estimator:
            sample = estimator.sample(outcome, self.simulations, asked, checks=True)
            findings = ProbabilityFindings.of(
                run.campaign, run.history, estimator.classifier, outcome, sample.estimate(self.confidence), asked
            )
        if run.writes and self.hazard is None and self.question is None and self.fixed is None:
            run.store.remember(estimate_of(outcome, run.store.digest), findings.numbers)
        return findings


@dataclass(frozen=True)
class FragilityRequest(Request["FragilityFindings | FragilityByStripes"]):
    """Show the probability of each outcome against intensity.

    The curves are for the outcome or a more severe one, against the intensity of the pulse or another variable.
    """

    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file; the curves are against the intensity of its pulses (docs/hazard.md).", Path, bars="wrong"
    )
    fixed: "Mapping[str, float] | Path | str | None" = declared(FIXED)
    intensity: Literal["pgv", "a_p"] = option(
        "pgv", "With --hazard: peak ground velocity, or amplitude of the pulses.", Literal["pgv", "a_p"],
        needs="hazard",
    )  # fmt: skip
    against: str | None = option(None, "Without --hazard: the variable of the curves.", str, metavar="VARIABLE")
    bounds: tuple[float, float] | None = option(
        None, "With --against: range of the variable; that of the campaign by default.", str, names=("--range",),
        metavar="LOW,HIGH", parse=_range, needs="against",
    )  # fmt: skip
    question: "Question | Path | str | None" = option(
        None, "With --against: file with other distributions (docs/probability.md).", Path, needs="against"
    )
    verify: int = option(0, f"{SIMULATIONS}, for intervals.", low=0, high=1_000_000, bars="wrong")
    confidence: float = confidence(0.95)
    outcome: str | None = option(None, f"Outcome whose curve is verified. {TARGET_BOUNDARY}", str)
    wrong: float | None = declared(WRONG)
    at_once: int = declared(AT_ONCE)

    table: ClassVar = "Table of the curves to write; - is standard output."
    pages: ClassVar = (
        "Folder for the page fragility.html, its pictures, fragility.json, tables, and files for pelicun and "
        "OpenQuake; with --wrong the page, its picture and fragility.json."
    )

    def answer(self, run: "Run") -> "FragilityFindings | FragilityByStripes":
        from activefail.campaign.inquiry import Inquiry, check_designs_of
        from activefail.risk.fragility.band import LEAST
        from activefail.risk.fragility.calculation import fragility
        from activefail.risk.fragility.levels import ladder_of

        outcome = run._boundary_named(self.outcome)
        asked = Inquiry.of(run.campaign, self.hazard, self.question, self.fixed)
        ladder = ladder_of(asked, self.intensity, self.against, self.bounds)
        if 0 < self.verify < LEAST:
            raise InputError(f"verify: must be at least {LEAST}, got {self.verify}.")
        if self.bounds is not None:
            for end in ladder.levels[[0, -1]].tolist():
                question = asked.question.at({ladder.name: end})
                check_designs_of(question, run.campaign.simulator, "bounds (--range)")
        if self.wrong is not None:
            from activefail.risk.fragility.by_stripes import fragility_by_stripes

            with asking_stripes(run, self.at_once, self.executor, self.stage) as stripes:
                return fragility_by_stripes(stripes, asked.question, ladder, outcome, self.wrong, self.confidence)
        with estimating(run, self.executor, self.stage, bool(self.verify)) as estimator:
            return fragility(estimator, asked, ladder, outcome, self.verify, self.confidence, self.stage)

    def write_table(self, findings: "FragilityFindings | FragilityByStripes", target: Target) -> None:
        from activefail.risk.fragility.by_stripes import FragilityByStripes
        from activefail.risk.fragility.exports import write_curves

        if isinstance(findings, FragilityByStripes):
            findings.write_table(target)
        else:
            write_curves(findings, target)

    def write_pages(self, findings: "FragilityFindings | FragilityByStripes", run: "Run", out: Path) -> list[Path]:
        from activefail.report.analyses import write_fragility

        return write_fragility(findings, out)


@dataclass(frozen=True)
class DesignRequest(Request["DesignFindings | DesignByStripes"]):
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
    fixed: "Mapping[str, float] | Path | str | None" = declared(FIXED)
    free: "Sequence[str]" = option((), "Variables to design, such as D_tot,mu; D_tot by default.", str, parse=_names)
    cost: str = option(
        "",
        "Expression to minimise, such as 'D_tot * (1 + 20 * mu)'; the first free variable by default.",
    )
    confidence: float = confidence(0.95, "that the target is met")
    simulations: int = option(
        1000,
        "Maximum number of fresh simulations for each target; not part of the budget.",
        low=10,
        high=1_000_000,
        bars="wrong",
    )
    chart: bool = option(False, "Compute the chart of required values, with --out.", with_out=True, bars="wrong")
    wrong: float | None = declared(WRONG)
    at_once: int = declared(AT_ONCE)

    pages: ClassVar = (
        "Folder for the page design.html, its pictures, and design.json and design.toml; with --wrong the last two."
    )

    def answer(self, run: "Run") -> "DesignFindings | DesignByStripes":
        from activefail.campaign.inquiry import Inquiry
        from activefail.risk.design.design_task import DEFAULT_FREE, design_task, read_targets
        from activefail.risk.design.findings import DesignFindings
        from activefail.risk.design.risk_target import at_risk
        from activefail.risk.design.search import find_design
        from activefail.risk.design.stored import remember_design

        campaign, names = run.campaign, names_of("free", self.free)
        requirements = read_targets(str(self.target), campaign.simulator.outcomes, run.boundary)
        free, rate = names or (DEFAULT_FREE,), None
        asked = Inquiry.of(campaign, self.hazard, self.question, self.fixed, free)
        if any(one.years is not None for one in requirements):
            site, requirements, rate = at_risk(asked.hazard, requirements)
            asked = Inquiry.of_hazard(campaign, site, asked.fixed, free)
        task = design_task(asked, requirements, names, self.cost, self.confidence, self.simulations, rate)
        if self.wrong is not None:
            from activefail.risk.design.by_stripes import design_by_stripes

            with asking_stripes(run, self.at_once, self.executor, self.stage) as stripes:
                return design_by_stripes(stripes, task, self.wrong)
        with estimating(run, self.executor, self.stage) as estimator:
            designed = find_design(estimator, task, self.stage)
            findings = DesignFindings.of(estimator, designed, self.chart, self.stage)
        if run.writes:
            remember_design(run.store, designed)
        return findings

    def write_pages(self, findings: "DesignFindings | DesignByStripes", run: "Run", out: Path) -> list[Path]:
        from activefail.report.analyses import write_design

        return write_design(findings, run.campaign, out)


@dataclass(frozen=True)
class SensitivityRequest(Request["SensitivityFindings"]):
    """Show which variables affect a probability most.

    The classifier gives Sobol' indices, and the effect of one variable at a time; nothing is simulated. Needs SALib.
    """

    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file (docs/hazard.md); the sensitivity of a design's probability, averaged over the pulses.", Path
    )
    question: "Question | Path | str | None" = option(None, f"{QUESTION}.", Path)
    fixed: "Mapping[str, float] | Path | str | None" = declared(FIXED)
    outcome: str | None = option(None, f"Outcome whose probability is explained. {TARGET_BOUNDARY}", str)
    samples: int | None = option(
        None,
        "Points of the sample: a power of two, at least 16. Default: as many as take about two minutes.",
        int,
        low=16,
    )
    confidence: float = confidence(0.95)

    writes: ClassVar = False
    counts: ClassVar = "evaluating"
    table: ClassVar = "CSV table to write; - is standard output."
    pages: ClassVar = "Folder for a page with pictures."

    def answer(self, run: "Run") -> "SensitivityFindings":
        from activefail.campaign.inquiry import Inquiry
        from activefail.paper.study import variable_p_values
        from activefail.reliability.integral import BoundariesOf
        from activefail.risk.sensitivity.calculation import sensitivity

        outcome = run._boundary_named(self.outcome)
        asked = Inquiry.of(run.campaign, self.hazard, self.question, self.fixed, run.space.names)
        with one_thread():
            severity = run.campaign.simulator.outcomes.index(outcome)
            p_values = variable_p_values(run.space, run.history, severity)
            beyond = run.history.outcome[run.history.answered] >= severity
            boundaries = BoundariesOf(run.classifier, run.campaign.features)
            options = self.samples, self.confidence, self.begin
            return sensitivity(asked, boundaries, outcome, *options, run.classifier, p_values, beyond)

    def write_table(self, findings: "SensitivityFindings", target: Target) -> None:
        from activefail.risk.sensitivity.findings import write_csv

        write_csv(findings, target)

    def write_pages(self, findings: "SensitivityFindings", run: "Run", out: Path) -> list[Path]:
        from activefail.report.analyses import write_sensitivity

        return write_sensitivity(findings, run.campaign, out)


@dataclass(frozen=True)
class IdaRequest(Request["IdaFindings"]):
    """Find the intensity at which a bearing fails, for each record.

    The intensities give a fragility curve.
    """

    bearing: "Values" = option(
        REQUIRED,
        "TOML file with the bearing: T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k. With --simulator: the campaign's "
        "variables. In Python also the values, in this order or by name.",
        Path,
    )
    records: "RecordSet | Path | str | None" = option(
        None,
        "Folder of records (docs/records.md); or farfield, nearfield, nearfield-pulse or nearfield-no-pulse of FEMA "
        "P695. Default: those of the campaign of --simulator.",
        Path,
    )
    scale_to: "Intensity | str | None" = option(
        None,
        f"Intensity of the levels: {', '.join(f'{kind} {of.unit}'.strip() for kind, of in INTENSITIES.items())}; sa:T "
        "has a period [s]; p695 is one factor for all records, by their S_T(T_b). Default: pgv, or that to which the "
        "campaign of --simulator scales its records.",
        str,
    )
    outcome: str | None = option(
        None,
        "Outcome that is sought, or a worse one: failure, impact, or one of the campaign's. Default: the most severe.",
        str,
    )
    to: float | None = option(
        None,
        f"Highest level. Default: {', '.join(f'{of.highest:g} ({kind})' for kind, of in INTENSITIES.items())}, "
        "p695 over S_NRT.",
        float,
    )
    margin: "MarginRequest | None" = declared(MARGIN)
    pulses: bool = option(
        False, "Compare each record with the pulse nearest to it.", names=("--pulses",), bars="simulator"
    )
    unit: str | None = option(None, "Unit of records that state none: g, m/s2, cm/s2 or mm/s2.", str, needs="records")
    dt: float | None = option(None, "Interval of records without times [s].", float, needs="records")
    vertical: bool = option(
        False,
        "Use the vertical components that records.csv names (docs/records.md).",
        names=("--vertical",),
        bars="simulator",
    )
    simulator: Path | str | None = option(
        None,
        "Campaign file under records, such as building_records, whose simulator replaces the bearing model; activefail "
        "executes its code.",
        Path,
        metavar="CAMPAIGN.toml",
    )
    model: "Model | None" = declared(MODEL._replace(bars="simulator"))
    tolerance: "Tolerance | None" = declared(TOLERANCE._replace(bars="simulator"))
    workers: int | None = declared(WORKERS)
    where: Literal["local", "dask"] = declared(EXECUTOR._replace(needs="simulator"))
    scheduler: str | None = declared(SCHEDULER._replace(needs="simulator"))
    folder: Path | str | None = option(
        None, "Folder that keeps the simulations, so that the same analysis continues.", Path, with_out=True
    )

    of_run: ClassVar = Option(
        "Run folder of a campaign under records, which simulates, says where each record begins, and keeps the "
        "simulations. With --pulses: of a campaign under pulses, whose classifier predicts each level.",
        Path,
        names=("--campaign",),
    )
    counts: ClassVar = "simulating"
    pages: ClassVar = (
        "Folder for the page ida.html, ida.json, ida.csv, ida.png, ida.svg, and the simulations: the same command "
        "continues."
    )

    def answer(self, run: "Run | None" = None) -> "IdaFindings":
        from activefail.accelerogram_sets import RecordSet, read_record_set
        from activefail.bearing.design import Model, Tolerance
        from activefail.intensity import Intensity
        from activefail.risk.ida.calculation import analysis
        from activefail.risk.ida.simulations import (
            BearingSubject,
            CampaignSubject,
            Ground,
            campaign_of,
            values_under_records,
        )

        if by_campaign := run is not None and not self.pulses:
            for one, of in options(type(self)):
                if "simulator" in (one.name, of.bars) and of.is_given(getattr(self, one.name)):
                    raise InputError(f"{one.name}: cannot be combined with --campaign without --pulses.")
        model, tolerance = self.model or Model(), self.tolerance or Tolerance()
        folder = None if self.folder is None else path_of("folder", self.folder)
        ground, records = Ground(), self.records
        if run is not None and by_campaign:
            name, campaign = run.folder.name, run.campaign
            if not run.writes:
                raise InputError("run: must be open for writing, because the simulations join its record.")
            run._check_initial_design()
        elif self.simulator is not None:
            name, campaign = campaign_of(self.simulator)
        if is_campaigns := by_campaign or self.simulator is not None:
            ground = Ground.of(campaign)
        measure = self.scale_to or ground.measure
        intensity = Intensity.of(measure) if isinstance(measure, str) else measure
        if is_campaigns and intensity.name != Intensity.of(ground.measure).name:
            raise InputError(f"--scale-to: must be {ground.measure} with this campaign, got {self.scale_to!r}.")
        if records is None:
            if ground.records is None:
                raise InputError("--records: required, unless a campaign has a variable with a `set`.")
            records = ground.records
        if not isinstance(records, RecordSet):
            if folder is not None and folder.resolve() == Path(records).resolve():
                raise InputError(f"--out: must differ from --records, got {folder}.")
            records = read_record_set(records, self.unit, self.dt, self.vertical)
        about = (intensity, self.outcome, self.to, self.margin, self.pulses, run, folder, self.begin)
        try:
            if not is_campaigns:
                bearing = BearingSubject.of(self.bearing, model, tolerance, self.workers)
                return analysis(bearing, records, *about)
            values = values_under_records(campaign, ground, self.bearing, records)
            if run is not None and by_campaign:
                pool = self.executor or run._local_executor(self.workers)
            else:
                pool = self.executor or executor_named(campaign, self.workers, self.where, self.scheduler, self.stage)
            with nullcontext(self.executor) if self.executor else pool:
                return analysis(CampaignSubject(name, campaign, ground, values, pool), records, *about)
        except KeyboardInterrupt:
            is_kept = folder is not None or by_campaign
            kept = "the same command continues" if is_kept else "nothing is kept without --out"
            raise KeyboardInterrupt(kept) from None

    def write_pages(self, findings: "IdaFindings", run: "Run | None", out: Path) -> list[Path]:
        from activefail.report.analyses import write_ida

        return write_ida(findings, out)

    @classmethod
    def is_written(cls, words: "Mapping[str, Any]") -> bool:
        return not words.get("pulses")


ida = function_of("ida", IdaRequest)


@dataclass(frozen=True)
class HazardRequest(Request["HazardSummary"]):
    """Check a hazard file and show its pulses.

    With a run folder, also shows which share of the pulses lies outside the campaign's design space.
    """

    hazard: "Hazard | Path | str" = option(REQUIRED, f"{HAZARD}.", Path, is_argument=True, metavar="FILE")
    fixed: "Mapping[str, float] | Path | str | None" = declared(FIXED)

    writes: ClassVar = False
    of_run: ClassVar = Option(
        "Run folder; shows the share of the pulses outside its design space.", Path, is_argument=True, metavar="DIR"
    )
    pages: ClassVar = "Folder for the figure: hazard.png and hazard.svg."

    def answer(self, run: "Run | None" = None) -> "HazardSummary":
        from activefail.campaign.hazard import Hazard, read_hazard
        from activefail.campaign.question import values_of
        from activefail.risk.hazard_summary import HazardSummary

        if run is None and self.fixed is not None:
            raise InputError("fixed: requires a run folder, whose variables it fixes.")
        hazard = self.hazard if isinstance(self.hazard, Hazard) else read_hazard(path_of("hazard", self.hazard))
        space = None if run is None else run.space
        fixed = values_of(self.fixed, run.space) if run else {}
        with naming("" if hazard is self.hazard else f"{self.hazard}: "):
            return HazardSummary.of(hazard, space, fixed)

    def write_pages(self, findings: "HazardSummary", run: "Run | None", out: Path) -> list[Path]:
        from activefail.figures.hazard import plot_hazard
        from activefail.figures.style import save_png_and_svg

        out.mkdir(parents=True, exist_ok=True)
        return save_png_and_svg(plot_hazard(findings, None if run is None else run.space), out, "hazard")


hazard = function_of("hazard", HazardRequest)


@dataclass(frozen=True)
class CompareRequest(Request["ComparisonFindings"]):
    """Compare the campaign with static designs on the same fresh designs.

    Writes a table and a figure to the subfolder `compare` of the run folder.
    """

    budgets: "Sequence[int]" = option((), "Numbers of simulations of the campaign; six by default.")
    test_designs: int = option(2000, "Number of fresh test designs.", low=10, high=1_000_000)
    static: "Sequence[int]" = option((), "Sizes of the static designs; the budgets by default.")
    hypercubes: int = option(1, "Number of static designs of each size.", low=1)

    def answer(self, run: "Run") -> "ComparisonFindings":
        from activefail.comparison.equivalent import ComparisonFindings
        from activefail.comparison.static import compare, remember_scores, write_scores
        from activefail.figures.curves import plot_learning_curves
        from activefail.figures.style import save_png_and_svg

        with nullcontext(self.executor) if self.executor else run._shown_executor() as pool:
            scores = compare(
                run.campaign, run.store, pool, list(self.budgets), self.test_designs, self.stage, self.static,
                self.hypercubes,
            )  # fmt: skip
        results = run.folder / COMPARISON
        figure = plot_learning_curves(scores, run.boundary, scores[0].test_designs)
        with writing_to(results):
            results.mkdir(exist_ok=True)
            write_scores(scores, self.test_designs, results / SCORES)
            save_png_and_svg(figure, results, CURVES)
        remember_scores(run.store, scores, self.test_designs)
        return ComparisonFindings(scores, run.boundary, results)


@dataclass(frozen=True)
class ReportRequest(Request["ReportFindings"]):
    """Write a campaign's results to one HTML file.

    The file needs no other file and no network.
    """

    page: "Path | str | None" = option(
        None, "File to write; report.html in the run folder by default.", Path, names=("--out",)
    )
    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file (docs/hazard.md): adds fragility curves and the bearing that each target requires.", Path
    )
    fixed: "Mapping[str, float] | Path | str | None" = declared(FIXED._replace(needs="hazard"))
    target: "float | str | None" = option(
        None,
        "With --hazard: largest acceptable probability, such as 0.10, or a risk category; by default all three "
        "categories.",
        str,
        needs="hazard",
    )

    writes: ClassVar = False

    def answer(self, run: "Run") -> "ReportFindings":
        from activefail.campaign.inquiry import Inquiry
        from activefail.report.analyses import write_folder
        from activefail.report.evidence import ReportFindings, evidence_of
        from activefail.report.fragility_section import risk_findings, risk_options
        from activefail.report.page import render

        page = run.folder / REPORT if self.page is None else path_of("page", self.page)
        if self.page is not None:
            check_output("--out", page)
            check_file(page, "a report", (".html", ".htm"))
        risk = None
        if self.hazard is not None:
            wanted = risk_options(self.hazard, self.fixed, self.target, run.campaign.simulator.outcomes, run.boundary)
            asked = Inquiry.of(run.campaign, self.hazard, None, self.fixed)
            with estimating(run, stage=self.stage, simulates=False) as estimator:
                risk = risk_findings(estimator, asked, wanted, self.stage)
        failure = run.failure(self.stage)
        with one_thread():
            evidence = evidence_of(run.campaign, run.store, run.classifier, self.stage)
            text = render(run.findings, evidence, run.store, self.stage, failure, risk)
        with writing_to(page):
            write_folder(page.parent, {page.name: text}, {})
        return ReportFindings(evidence, page)


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
        workers, kept = getattr(pool, "workers", 1), list[str]()

        def announce(simulations: int) -> None:
            kept[:] = ["simulations are kept; the same command continues"]
            stage(f"simulating {counted(simulations, 'fresh design')}{run._duration_of(simulations, workers)}")

        try:
            yield Estimator(run.campaign, run.store, pool, learned.classifier, last, announce=announce)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(*kept) from None


@contextmanager
def asking_stripes(run: "Run", at_once: int, executor: "Executor | None", stage: Stage) -> "Iterator[Stripes]":
    """What asks over finitely many values; their simulations join the record.

    Raises:
        InputError: if the initial design is not finished.
    """
    from activefail.stripes.stripe import Stripes

    run._check_initial_design()
    with nullcontext(executor) if executor else run._shown_executor() as pool, run._turn, one_thread():
        try:
            yield Stripes(run.campaign, run.store, pool, lambda: run.learn(stage).classifier, at_once, stage)
        finally:
            run._predicts = None
