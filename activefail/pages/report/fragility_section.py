"""The report's section on the fragility under a site's hazard, if there is one: its values. It simulates nothing."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from activefail.analyses.design.design_task import RISK_CATEGORIES, Requirement, default_free, design_task, read_targets
from activefail.analyses.design.required_chart import RequiredChart, chart_of
from activefail.analyses.design.stored import StoredDesign, stored_designs
from activefail.analyses.findings.quantities import by_name
from activefail.analyses.fragility.calculation import fragility
from activefail.analyses.fragility.findings import FragilityFindings
from activefail.analyses.fragility.levels import ladder_of
from activefail.campaign.inquiry import Inquiry
from activefail.errors import InputError
from activefail.estimates.probability_estimator import Estimator
from activefail.pages.figures.risk import marks_of_stored, plot_fragility_findings, plot_required
from activefail.pages.figures.svg import inlined
from activefail.pages.report.analyses import curves_shown
from activefail.text.quantities import Quantity
from activefail.visible import quoted

_CONFIDENCE = 0.95
"""Of the intervals at verified levels."""


class RiskOptions(NamedTuple):
    """What is asked of the section.

    Attributes:
        site: hazard and values of variables, as options of a command.
        target: as the user gave it; None for the risk categories.
        requirement: the target, or that of the first risk category.
    """

    site: str
    target: str | None
    requirement: Requirement

    @property
    def options(self) -> str:
        """The options of the command that makes the section."""
        return self.site + (f" --target {quoted(self.target)}" if self.target is not None else "")


@dataclass(frozen=True, eq=False)
class RiskFindings:
    """What a hazard means for a bearing of a campaign.

    Attributes:
        request: what the report shows.
        shown: the variables, by name.
        fragility: the curves, with the levels that earlier verifications stored.
        chart: of the values that targets require; None if there is none.
        why_no_chart: a sentence; empty if there is a chart.
        designs: the last verified design of each target of the chart, if its simulations are stored.
    """

    request: RiskOptions
    shown: Mapping[str, Quantity]
    fragility: FragilityFindings
    chart: RequiredChart | None
    why_no_chart: str
    designs: Sequence[StoredDesign]


def risk_options(
    hazard: object, fixed: object, target: float | str | None, outcomes: Sequence[str], boundary: str
) -> RiskOptions:
    """Check what is asked.

    Args:
        hazard, fixed: files, or values that no file has.
        target: a probability or a risk category; None for all risk categories.
        outcomes: of the campaign.
        boundary: outcome of a target without a name.
    """
    text = next(iter(RISK_CATEGORIES)) if target is None else str(target)
    requirements = read_targets(text, outcomes, boundary)
    if len(requirements) > 1 or requirements[0].years is not None:
        raise InputError(f"target: must be one target, a probability under loads of the hazard, got {text!r}.")
    files = {"--hazard": (hazard, "HAZARD.toml")} | ({} if fixed is None else {"--fixed": (fixed, "DESIGN.toml")})
    names = {option: quoted(one) if isinstance(one, Path | str) else name for option, (one, name) in files.items()}
    site = " ".join(f"{option} {name}" for option, name in names.items())
    return RiskOptions(site, None if target is None else text, requirements[0])


def risk_findings(
    estimator: Estimator,
    asked: Inquiry,
    request: RiskOptions,
    stage: Callable[[str], None] = lambda _: None,
) -> RiskFindings:
    """The section's findings, from the classifier and from stored simulations.

    Args:
        estimator: of the campaign; it need not simulate.
        asked: the hazard, with the bearing's values.
        request: what the report shows.
        stage: called with each stage of the work.
    """
    campaign, requirement = estimator.campaign, request.requirement
    curves = fragility(estimator, asked, ladder_of(asked), requirement.outcome, None, _CONFIDENCE, stage)
    chart, why, designs = None, "", []
    free = default_free(campaign.space)
    if not free:
        why = "the campaign has no variable whose required value a chart could show."
    elif (chart := chart_of(estimator, design_task(asked, (requirement,)), {}, stage)) is None:
        why = f"a chart requires values of two variables besides {free[0]}; --fixed gives them."
    else:
        requirements = [Requirement(requirement.outcome, target) for target in chart.targets.tolist()]
        designs = stored_designs(estimator, asked.question, free[0], requirements)
    return RiskFindings(request, by_name(campaign), curves, chart, why, designs)


def fragility_section(findings: RiskFindings | None) -> dict[str, Any] | None:
    """The findings, texts and pictures of the section; None without a hazard."""
    if findings is None:
        return None
    chart, shown, drawn = findings.chart, findings.shown, None
    if chart is not None:
        figures = plot_required(chart, shown, marks_of_stored(chart, findings.designs))
        drawn = inlined(figures.values(), "required", f"Required {chart.name} against {chart.across}")
    return {
        "found": findings,
        "curves": curves_shown(findings.fragility, plot_fragility_findings(findings.fragility, shown), shown),
        "required": "" if chart is None else chart.name,
        "chart": drawn,
    }
