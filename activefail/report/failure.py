"""The report's section on the probability of failure."""

import math
from contextlib import suppress
from typing import Any

from activefail.errors import InputError
from activefail.figures.failure import plane_of, plot_failure_domain, plot_probability
from activefail.findings import quantities
from activefail.findings.failure import FailureFindings
from activefail.findings.probability import rounded_up
from activefail.findings.quantities import significant
from activefail.findings.results import Findings
from activefail.reliability.estimate import ProbabilityEstimate
from activefail.reliability.integral import boundary_of
from activefail.report.picture import picture
from activefail.shares import percent


def failure_section(findings: Findings, failure: FailureFindings | None) -> dict[str, Any] | None:
    """The numbers and pictures of the section; None if the campaign says nothing of a probability."""
    if failure is None:
        return None
    beyond, estimate, asked = quantities.plain(findings.beyond), failure.estimate, failure.asked
    low, high = float(failure.low[-1]), float(failure.high[-1])
    shown: dict[str, Any] = {"estimate": None, "asked": None}
    if estimate is not None:
        is_extrapolated = not failure.seen[-1] and not estimate.beyond
        shown["estimate"] = _texts(estimate, max(estimate.high, failure.bound) if is_extrapolated else None)
    if asked is not None:
        shown["asked"] = _texts(asked.estimate, asked.high if asked.is_extrapolated else None)
        shown["asked"] |= {"question": asked.question, "outside": percent(asked.extrapolated)}
    return shown | {
        "is_rare": failure.is_rare,
        "is_known": failure.is_known,
        "model": f"{failure.probability[-1]:.3g}",
        "model_interval": None if math.isnan(low) else f"{low:.3g} to {high:.3g}",
        "asks": bool(findings.campaign.question.digest),
        "bound": rounded_up(failure.bound),
        "seen": int(failure.seen[-1]),
        "picture": picture(plot_probability(failure, beyond), "probability", "Probability against simulations"),
        "point": _point(findings, failure),
    }


def _texts(estimate: ProbabilityEstimate, bound: float | None) -> dict[str, Any]:
    """An estimate as texts.

    Args:
        estimate: from fresh simulations.
        bound: upper bound without a model if no simulation ended beyond the boundary: then it alone rests on them.
    """
    low, high = (0.0, rounded_up(bound)) if bound is not None else (estimate.low, f"{estimate.high:.3g}")
    return {
        "probability": f"{estimate.probability:.3g}",
        "interval": f"{low:.3g} to {high}",
        "extrapolated": bound is not None,
        "check": estimate.check,
        "confidence": f"{100.0 * estimate.confidence:g} %",
        "simulations": estimate.simulations,
        "wrong": estimate.wrong,
        "surprising": estimate.surprising,
        "recall": percent(estimate.recall),
        "recall_low": percent(estimate.recall_low),
    }


def _point(findings: Findings, failure: FailureFindings) -> dict[str, Any] | None:
    point, campaign = failure.point, findings.campaign
    if point is None:
        return None
    space, names = campaign.space, quantities.variables(campaign)
    drawn, plane = None, ""
    # The plane's corners lie farther out than the search, where features may not be finite.
    with suppress(InputError):
        if space.dimension > 1:
            latent = boundary_of(findings.classifier, campaign.features, findings.boundary)
            figure = plot_failure_domain(point, latent, findings, names)
            drawn = picture(figure, "domain", "Failure domain through the design point")
            plane = " and ".join(names[column].text for column in plane_of(point, space))
    shares = point.importance if space.factor is None else [math.nan] * space.dimension
    return {
        "beta": significant(point.beta),
        "first_order": f"{point.probability:.3g}",
        "rows": [
            {"quantity": name, "value": significant(float(value)), "share": percent(float(share), 0)}
            for name, value, share in zip(names, point.X, shares, strict=True)
        ],
        "correlated": space.factor is not None,
        "plane": plane,
        "variables": space.dimension,
        "picture": drawn,
    }
