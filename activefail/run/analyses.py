"""The analyses of a run folder: what can be asked, with which options, and which package answers."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from activefail.errors import InputError
from activefail.learning.model.threads import one_thread
from activefail.plugins import brought
from activefail.record.layout import COMPARISON, CURVES, REPORT, SCORES, check_output
from activefail.run.analysis import REQUIRED, Option, analysis, option
from activefail.session.arguments import names_of
from activefail.session.session import Session, boundary_named, check_can_be_asked, estimating, executor_of, recording
from activefail.text.files import check_file, path_of, writing_to
from activefail.text.progress import Begin, Stage, silent, uncounted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from activefail.analyses.comparison.equivalent import ComparisonFindings
    from activefail.analyses.design.findings import DesignFindings
    from activefail.analyses.findings.estimates import ErrorFindings, ProbabilityFindings, SurfaceFindings
    from activefail.analyses.fragility.findings import FragilityFindings
    from activefail.analyses.sensitivity.findings import SensitivityFindings
    from activefail.analyses.stripes.findings import StripeFindings
    from activefail.analyses.stripes.stripe import Stripes
    from activefail.campaign.hazard import Hazard
    from activefail.campaign.question import Question
    from activefail.execution.executor import Executor
    from activefail.pages.report.evidence import ReportFindings

SIMULATIONS = "Fresh simulations, outside the budget"
QUESTION = "File with other distributions of the variables (docs/probability.md)"
TARGET_BOUNDARY = "Default: the outcome of the target boundary."

FIXED: Any = Option(
    None,
    "Values of variables, such as load=4,depth=0.3, or a TOML file with them; in Python also values by name.",
    Path,
    names=("--fixed", "--bearing"),
)
WRONG: Any = Option(
    None,
    "Over finitely many values, such as records: simulate the doubtful ones until so large a share is expected to be "
    "predicted wrongly, such as 0.01 (docs/stripes.md).",
    float,
    low=0.0,
    high=0.5,
)
AT_ONCE: Any = Option(
    3,
    "With --wrong: values that are simulated at a time, before the classifier learns again.",
    int,
    low=1,
    needs="wrong",
)
WORKERS: Any = Option(None, "Parallel simulations; all cores by default.", int, low=1)
EXECUTOR: Any = Option(
    "local",
    "Where simulations run: this machine, or a Dask cluster.",
    Literal["local", "dask"],
    names=("--executor",),
)
SCHEDULER: Any = Option(None, "Address of the Dask cluster, such as tcp://head:8786.", metavar="ADDRESS")


def confidence_of(what: str, default: float) -> Any:
    """The option `confidence`."""
    return option(default, f"Confidence {what}.", low=0.5, high=0.999)


@analysis("runs/first --simulations 400")
def verify(
    run: Session,
    simulations: int = option(200, f"{SIMULATIONS}.", low=10, high=1_000_000),
    confidence: float = confidence_of("of the interval", 0.9),
    *,
    executor: "Executor | None" = None,
    stage: Stage = silent,
) -> "ErrorFindings | SurfaceFindings":
    """Estimate the classifier's error over the design space.

    Fresh simulations give the estimate and its interval. If the simulator does not repeat, no design is wrong; they
    score the classifier's probabilities.
    """
    from activefail.analyses.findings.estimates import ErrorFindings, SurfaceFindings
    from activefail.analyses.findings.summary import Summary
    from activefail.estimates import error, surface

    with estimating(run, executor, stage) as estimator:
        of = run.boundary, Summary.of_run(run).done, estimator.iteration
        if not estimator.classifier.repeatable:
            return SurfaceFindings(surface.verify_surface(estimator, simulations, confidence), *of)
        return ErrorFindings(error.verify(estimator, simulations, confidence), *of)


@analysis("runs/first --question question.toml")
def probability(
    run: Session,
    simulations: int = option(
        50, f"{SIMULATIONS}; a question may add a mode check.", low=10, high=1_000_000, bars="wrong"
    ),
    confidence: float = confidence_of("of the interval", 0.9),
    outcome: str | None = option(None, f"Outcome whose probability is estimated. {TARGET_BOUNDARY}"),
    question: "Question | Path | str | None" = option(None, f"{QUESTION}, or a hazard file (docs/hazard.md).", Path),
    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file; the distribution is that of its loads (docs/hazard.md).", Path
    ),
    fixed: "Mapping[str, float] | Path | str | None" = FIXED,
    wrong: float | None = WRONG,
    at_once: int = AT_ONCE,
    *,
    executor: "Executor | None" = None,
    stage: Stage = silent,
) -> "ProbabilityFindings | StripeFindings":
    """Estimate the probability of an outcome, with an interval.

    The estimate combines the campaign's classifier with fresh simulations. The probability is that of the outcome or a
    more severe one. With --wrong the doubtful ones of finitely many values are simulated, and the campaign learns from
    them.
    """
    from activefail.analyses.findings.estimates import ProbabilityFindings
    from activefail.analyses.findings.status import estimate_of
    from activefail.analyses.stripes.findings import StripeFindings
    from activefail.campaign.inquiry import Inquiry

    outcome = boundary_named(run, outcome)
    asked = Inquiry.of(run.campaign, hazard, question, fixed).question
    if wrong is not None:
        with asking_stripes(run, at_once, executor, stage) as stripes:
            return StripeFindings(stripes.ask(asked, outcome, wrong), confidence)
    with estimating(run, executor, stage) as estimator:
        estimate = estimator.sample(outcome, simulations, asked, checks=True).estimate(confidence)
        findings = ProbabilityFindings.of(run.campaign, run.history, estimator.classifier, outcome, estimate, asked)
    if run.writes and hazard is None and question is None and fixed is None:
        run.store.remember(estimate_of(outcome, run.store.digest), findings.numbers)
    return findings


def _range(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError("must be two numbers separated by a comma") from None
    return low, high


@analysis(
    "runs/first --hazard hazard.toml --bearing bearing.toml --out figures",
    table="Table of the curves to write; - is standard output.",
    pages="Folder for the page fragility.html, its pictures, fragility.json, tables, and files for pelicun and "
    "OpenQuake.",
    writer="activefail.pages.report.analyses:write_fragility",
)
def fragility(
    run: Session,
    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file; the curves are against the intensity of its loads (docs/hazard.md).", Path, bars="wrong"
    ),
    fixed: "Mapping[str, float] | Path | str | None" = FIXED,
    against: str | None = option(None, "Without --hazard: the variable of the curves.", metavar="VARIABLE"),
    bounds: tuple[float, float] | None = option(
        None,
        "With --against: range of the variable; that of the campaign by default.",
        names=("--range",),
        metavar="LOW,HIGH",
        parse=_range,
        needs="against",
    ),
    question: "Question | Path | str | None" = option(
        None, "With --against: file with other distributions (docs/probability.md).", Path, needs="against"
    ),
    verify: int = option(0, f"{SIMULATIONS}, for intervals.", low=0, high=1_000_000, bars="wrong"),
    confidence: float = confidence_of("of the intervals", 0.95),
    outcome: str | None = option(None, f"Outcome whose curve is verified. {TARGET_BOUNDARY}"),
    wrong: float | None = WRONG,
    at_once: int = AT_ONCE,
    *,
    executor: "Executor | None" = None,
    stage: Stage = silent,
) -> "FragilityFindings":
    """Show the probability of each outcome against intensity.

    The curves are for the outcome or a more severe one, against the intensity of loads or another variable.
    """
    from activefail.analyses.fragility import calculation
    from activefail.analyses.fragility.band import LEAST
    from activefail.analyses.fragility.by_stripes import fragility_by_stripes
    from activefail.analyses.fragility.levels import ladder_of
    from activefail.campaign.inquiry import Inquiry, check_designs_of

    outcome = boundary_named(run, outcome)
    asked = Inquiry.of(run.campaign, hazard, question, fixed)
    ladder = ladder_of(asked, against, bounds)
    if 0 < verify < LEAST:
        raise InputError(f"verify: must be at least {LEAST}, got {verify}.")
    if bounds is not None:
        for end in ladder.levels[[0, -1]].tolist():
            check_designs_of(asked.question.at({ladder.name: end}), run.campaign.simulator, "bounds (--range)")
    if wrong is not None:
        with asking_stripes(run, at_once, executor, stage) as stripes:
            return fragility_by_stripes(stripes, asked, ladder, outcome, wrong, confidence)
    with estimating(run, executor, stage, bool(verify)) as estimator:
        return calculation.fragility(estimator, asked, ladder, outcome, verify, confidence, stage)


_FREE = f"Variables to design, separated by commas; by default {' or '.join(brought('free')) or 'none'}."


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


@analysis(
    "runs/first --hazard hazard.toml --target 0.02 --free D_tot",
    pages="Folder for the page design.html, its pictures, and design.json and design.toml.",
    writer="activefail.pages.report.analyses:write_design",
)
def design(
    run: Session,
    target: float | str = option(
        REQUIRED,
        "Largest acceptable probability of failure, such as 0.10 or 10%; a risk category, II, III or IV; a "
        "risk such as '1% in 50 years'; or one for each outcome, such as failure=0.05,impact=0.3, where "
        "impact means impact or worse.",
    ),
    hazard: "Hazard | Path | str | None" = option(None, "Hazard file of the site (docs/hazard.md).", Path),
    question: "Question | Path | str | None" = option(
        None, "Question file instead of a hazard (docs/probability.md).", Path
    ),
    fixed: "Mapping[str, float] | Path | str | None" = FIXED,
    free: "Sequence[str]" = option((), _FREE, str, parse=_names),
    cost: str = option(
        "", "Expression to minimise, such as 'area * (1 + 20 * price)'; the first free variable by default."
    ),
    confidence: float = confidence_of("that the target is met", 0.95),
    simulations: int = option(
        1000,
        "Maximum number of fresh simulations for each target; not part of the budget.",
        low=10,
        high=1_000_000,
        bars="wrong",
    ),
    chart: bool = option(False, "Compute the chart of required values.", with_out=True, bars="wrong"),
    wrong: float | None = WRONG,
    at_once: int = AT_ONCE,
    *,
    executor: "Executor | None" = None,
    stage: Stage = silent,
) -> "DesignFindings":
    """Find and verify the smallest design that meets a target.

    The target is a probability of an outcome, such as failure. Free variables stay within the campaign's ranges; the
    first one is made as small as the targets allow while the others are held.
    """
    from activefail.analyses.design.by_stripes import design_by_stripes
    from activefail.analyses.design.design_task import default_free, design_task, read_targets
    from activefail.analyses.design.findings import DesignFindings
    from activefail.analyses.design.risk_target import at_risk
    from activefail.analyses.design.search import find_design
    from activefail.analyses.design.stored import remember_design
    from activefail.campaign.inquiry import Inquiry

    campaign, names = run.campaign, names_of("free", free)
    requirements = read_targets(str(target), campaign.simulator.outcomes, run.boundary)
    sought, rate = names or default_free(run.space), None
    asked = Inquiry.of(campaign, hazard, question, fixed, sought)
    if any(one.years is not None for one in requirements):
        site, requirements, rate = at_risk(asked.hazard, requirements)
        asked = Inquiry.of_hazard(campaign, site, asked.fixed, sought)
    task = design_task(asked, requirements, names, cost, confidence, simulations, rate)
    if wrong is not None:
        with asking_stripes(run, at_once, executor, stage) as stripes:
            return DesignFindings.of(design_by_stripes(stripes, task, wrong))
    with estimating(run, executor, stage) as estimator:
        designed = find_design(estimator, task, stage)
        findings = DesignFindings.beside(estimator, designed, chart, stage)
    if run.writes:
        remember_design(run.store, designed)
    return findings


@analysis(
    "runs/first --hazard hazard.toml --out figures",
    writes=False,
    counts="evaluating",
    table="CSV table to write; - is standard output.",
    pages="Folder for a page with pictures.",
    writer="activefail.pages.report.analyses:write_sensitivity",
)
def sensitivity(
    run: Session,
    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file (docs/hazard.md); the sensitivity of a design's probability, averaged over the loads.", Path
    ),
    question: "Question | Path | str | None" = option(None, f"{QUESTION}.", Path),
    fixed: "Mapping[str, float] | Path | str | None" = FIXED,
    outcome: str | None = option(None, f"Outcome whose probability is explained. {TARGET_BOUNDARY}"),
    samples: int | None = option(
        None,
        "Points of the sample: a power of two, at least 16. Default: as many as take about two minutes.",
        int,
        low=16,
    ),
    confidence: float = confidence_of("of the intervals", 0.95),
    *,
    begin: Begin = uncounted,
) -> "SensitivityFindings":
    """Show which variables affect a probability most.

    The classifier gives Sobol' indices, and the effect of one variable at a time; nothing is simulated. Needs SALib.
    """
    from activefail.analyses.sensitivity import calculation
    from activefail.analyses.sensitivity.logistic import variable_p_values
    from activefail.campaign.inquiry import Inquiry
    from activefail.estimates.integral import BoundariesOf

    outcome = boundary_named(run, outcome)
    asked = Inquiry.of(run.campaign, hazard, question, fixed, run.space.names)
    with one_thread():
        severity = run.campaign.simulator.outcomes.index(outcome)
        p_values = variable_p_values(run.space, run.history, severity)
        beyond = run.history.outcome[run.history.answered] >= severity
        boundaries, options = BoundariesOf(run.classifier, run.campaign.features), (samples, confidence, begin)
        return calculation.sensitivity(asked, boundaries, outcome, *options, run.classifier, p_values, beyond)


def _sizes(text: str) -> list[int]:
    try:
        return sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise ValueError("must be whole numbers separated by commas") from None


@analysis("runs/first --static 500,1000,2000")
def compare(
    run: Session,
    budgets: "Sequence[int]" = option(
        (),
        "Numbers of simulations of the campaign, such as 250,500; six by default.",
        str,
        parse=_sizes,
    ),
    test_designs: int = option(2000, "Number of fresh test designs.", low=10, high=1_000_000, names=("--test",)),
    static: "Sequence[int]" = option((), "Sizes of the static designs; the budgets by default.", str, parse=_sizes),
    hypercubes: int = option(1, "Number of static designs of each size.", low=1, high=100, names=("--seeds",)),
    *,
    executor: "Executor | None" = None,
    stage: Stage = silent,
) -> "ComparisonFindings":
    """Compare the campaign with static designs on the same fresh designs.

    Ends with the size of a static design that is as accurate. Writes a table and a figure to the subfolder `compare`
    of the run folder.
    """
    from activefail.analyses.comparison.equivalent import ComparisonFindings
    from activefail.analyses.comparison.static import compare, remember_scores, write_scores
    from activefail.pages.figures.curves import plot_learning_curves
    from activefail.pages.figures.style import save_png_and_svg

    with executor_of(run, executor) as pool:
        scores = compare(run.campaign, run.store, pool, list(budgets), test_designs, stage, static, hypercubes)
    results = run.folder / COMPARISON
    figure = plot_learning_curves(scores, run.boundary, scores[0].test_designs)
    with writing_to(results):
        results.mkdir(exist_ok=True)
        write_scores(scores, test_designs, results / SCORES)
        save_png_and_svg(figure, results, CURVES)
    remember_scores(run.store, scores, test_designs)
    return ComparisonFindings(scores, run.boundary, results)


@analysis("runs/first --out report.html", writes=False)
def report(
    run: Session,
    page: "Path | str | None" = option(
        None, "File to write; report.html in the run folder by default.", Path, names=("--out",)
    ),
    hazard: "Hazard | Path | str | None" = option(
        None, "Hazard file (docs/hazard.md): adds fragility curves and the design that each target requires.", Path
    ),
    fixed: "Mapping[str, float] | Path | str | None" = FIXED._replace(needs="hazard"),  # noqa: B008
    target: "float | str | None" = option(
        None,
        "With --hazard: largest acceptable probability, such as 0.10, or a risk category; by default all three "
        "categories.",
        needs="hazard",
    ),
    *,
    stage: Stage = silent,
) -> "ReportFindings":
    """Write a campaign's results to one HTML file.

    The file needs no other file and no network.
    """
    from activefail.analyses.findings.failure import failure_findings
    from activefail.analyses.findings.results import findings_of
    from activefail.campaign.inquiry import Inquiry
    from activefail.pages.report.analyses import write_folder
    from activefail.pages.report.evidence import ReportFindings, evidence_of
    from activefail.pages.report.fragility_section import risk_findings, risk_options
    from activefail.pages.report.page import render

    file = run.folder / REPORT if page is None else path_of("page", page)
    if page is not None:
        check_output("--out", file)
        check_file(file, "a report", (".html", ".htm"))
    risk = None
    if hazard is not None:
        wanted = risk_options(hazard, fixed, target, run.campaign.simulator.outcomes, run.boundary)
        asked = Inquiry.of(run.campaign, hazard, None, fixed)
        with estimating(run, stage=stage, simulates=False) as estimator:
            risk = risk_findings(estimator, asked, wanted, stage)
    known = failure_findings(run, stage)
    with one_thread():
        evidence = evidence_of(run.campaign, run.store, run.classifier, stage)
        findings = findings_of(run.folder, run.campaign, run.store, run.classifier)
        text = render(findings, evidence, run.store, stage, known, risk)
    with writing_to(file):
        write_folder(file.parent, {file.name: text}, {})
    return ReportFindings(evidence, file)


@contextmanager
def asking_stripes(run: Session, at_once: int, executor: "Executor | None", stage: Stage) -> "Iterator[Stripes]":
    """What asks over finitely many values; their simulations join the record.

    Raises:
        InputError: if the initial design is not finished.
    """
    from activefail.analyses.stripes.stripe import Stripes

    check_can_be_asked(run)
    with executor_of(run, executor) as pool, recording(run), one_thread():
        yield Stripes(run.campaign, run.store, pool, lambda: run.learn(stage).classifier, at_once, stage)
