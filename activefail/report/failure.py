"""The report's section on the probability of failure."""

import math
from contextlib import suppress
from typing import Any

from activefail.errors import InputError
from activefail.figures.failure import plane_of, plot_failure_domain, plot_probability
from activefail.findings import quantities
from activefail.findings.failure import FailureFindings
from activefail.findings.probability import ProbabilityFindings, rounded_up
from activefail.findings.quantities import significant
from activefail.findings.results import Findings
from activefail.reliability.integral import boundary_of
from activefail.report.picture import picture
from activefail.shares import percent
from activefail.visible import visible


def failure_section(findings: Findings, failure: FailureFindings | None) -> dict[str, Any] | None:
    """The numbers and pictures of the section; None if the campaign says nothing of a probability."""
    if failure is None:
        return None
    beyond = quantities.plain(findings.beyond)
    low, high = float(failure.low[-1]), float(failure.high[-1])
    return {
        "is_rare": failure.is_rare,
        "is_known": failure.is_known,
        "model": f"{failure.probability[-1]:.3g}",
        "model_interval": None if math.isnan(low) else f"{low:.3g} to {high:.3g}",
        "estimate": _estimate(failure),
        "asks": bool(findings.campaign.question.digest),
        "asked": _asked(failure.asked),
        "bound": rounded_up(failure.bound),
        "seen": int(failure.seen[-1]),
        "picture": picture(plot_probability(failure, beyond), "probability", "Probability against simulations"),
        "point": _point(findings, failure),
    }


def _estimate(failure: FailureFindings) -> dict[str, Any] | None:
    estimate = failure.estimate
    if estimate is None:
        return None
    # Without any simulation beyond the boundary, only the bound without a model rests on simulations.
    extrapolated = not failure.seen[-1] and not estimate.beyond
    high = rounded_up(max(estimate.high, failure.bound)) if extrapolated else f"{estimate.high:.3g}"
    return {
        "probability": f"{estimate.probability:.3g}",
        "interval": f"{0.0 if extrapolated else estimate.low:.3g} to {high}",
        "extrapolated": extrapolated,
        "check": None,
        "confidence": f"{100.0 * estimate.confidence:g} %",
        "simulations": estimate.simulations,
        "wrong": estimate.wrong,
        "surprising": estimate.surprising,
        "recall": percent(estimate.recall),
        "recall_low": percent(estimate.recall_low),
    }


def _asked(asked: ProbabilityFindings | None) -> dict[str, Any] | None:
    if asked is None:
        return None
    estimate = asked.estimate
    high = rounded_up(asked.high) if asked.is_extrapolated else f"{estimate.high:.3g}"
    return {
        "question": visible(asked.question),
        "probability": f"{estimate.probability:.3g}",
        "interval": f"{0.0 if asked.is_extrapolated else estimate.low:.3g} to {high}",
        "confidence": f"{100.0 * estimate.confidence:g} %",
        "simulations": estimate.simulations,
        "wrong": estimate.wrong,
        "surprising": estimate.surprising,
        "extrapolated": asked.is_extrapolated,
        "check": estimate.check,
        "recall": percent(estimate.recall),
        "recall_low": percent(estimate.recall_low),
        "outside": percent(asked.extrapolated),
    }


def _point(findings: Findings, failure: FailureFindings) -> dict[str, Any] | None:
    point, campaign = failure.point, findings.campaign
    if point is None:
        return None
    space, names = campaign.space, quantities.variables(campaign)
    figure = None
    if space.dimension > 1:
        rows = findings.answered
        # The plane's corners lie farther out than the search, where features may not be finite.
        with suppress(InputError):
            figure = plot_failure_domain(
                point,
                space,
                boundary_of(findings.classifier, campaign.features, findings.boundary),
                findings.X[rows],
                findings.outcome[rows],
                campaign.simulator.outcomes,
                names,
                quantities.plain(findings.beyond),
            )
    shares = point.importance if space.factor is None else [math.nan] * space.dimension
    return {
        "beta": significant(point.beta),
        "first_order": f"{point.probability:.3g}",
        "rows": [
            {"quantity": name, "value": significant(float(value)), "share": percent(float(share), 0)}
            for name, value, share in zip(names, point.X, shares, strict=True)
        ],
        "correlated": space.factor is not None,
        "plane": " and ".join(names[column].text for column in plane_of(point, space)) if figure else "",
        "variables": space.dimension,
        "picture": None if figure is None else picture(figure, "domain", "Failure domain through the design point"),
    }
