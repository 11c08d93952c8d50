"""The report's section on the probability of failure."""

import math
from contextlib import suppress
from typing import Any

from scipy.special import ndtri

from activefail.analyses.findings import quantities
from activefail.analyses.findings.estimates import modes_in_words, rounded_up
from activefail.analyses.findings.failure import FailureFindings
from activefail.analyses.findings.results import Findings
from activefail.errors import InputError
from activefail.estimates.estimate import ProbabilityEstimate
from activefail.estimates.integral import boundary_of
from activefail.pages.figures.failure import plane_of, plot_failure_domain, plot_probability
from activefail.pages.figures.svg import inline
from activefail.space.shares import alike, percent, significant
from activefail.text.quantities import plain


def failure_section(findings: Findings, failure: FailureFindings | None, width: float = 5.4) -> dict[str, Any] | None:
    """The numbers of the section and its pictures, of a width [in]; None if nothing is said of a probability."""
    if failure is None:
        return None
    estimate, asked = failure.estimate, failure.asked
    low, high = float(failure.low[-1]), float(failure.high[-1])
    shown: dict[str, Any] = {"estimate": None, "asked": None}
    if estimate is not None:
        is_extrapolated = not failure.seen[-1] and not estimate.beyond
        shown["estimate"] = _texts(estimate, max(estimate.high, failure.bound) if is_extrapolated else None)
    if asked is not None:
        shown["asked"] = _texts(asked.estimate, asked.high if asked.is_extrapolated else None)
        shown["asked"] |= {"question": asked.question, "outside": percent(asked.extrapolated)}
    model, *ends = alike(float(failure.probability[-1]), low, high)
    figure = plot_probability(failure, plain(findings.beyond), width)
    return shown | {
        "is_rare": failure.is_rare,
        "model": model,
        "model_interval": None if math.isnan(low) else " to ".join(ends),
        "asks": bool(findings.campaign.question.digest),
        "bound": rounded_up(failure.bound) if findings.history.initial.any() else "",
        "seen": int(failure.seen[-1]),
        "simulations": len(findings.history),
        "picture": inline(figure, "probability", "Probability against simulations"),
        "point": _point(findings, failure, width),
    }


def _texts(estimate: ProbabilityEstimate, bound: float | None) -> dict[str, Any]:
    """An estimate from fresh simulations as texts.

    Args:
        estimate: the estimate.
        bound: upper bound without a model if no simulation ended beyond the boundary: then it alone rests on them.
    """
    probability, low, high = alike(estimate.probability, estimate.low, estimate.high)
    if bound is not None:
        low, high = "0", rounded_up(bound)
    beta = [f"{-ndtri(p):.2f}".replace("-", "−") for p in (estimate.probability, estimate.high, estimate.low)]
    return {
        "of": estimate,
        "modes": modes_in_words(estimate.modes),
        "probability": probability,
        "interval": f"{low} to {high}",
        "beta": beta[0] if bound is None and estimate.low > 0.0 else "",
        "beta_interval": f"{beta[1]} to {beta[2]}",
        "extrapolated": bound is not None,
        "confidence": f"{100.0 * estimate.confidence:g} %",
    }


def _point(findings: Findings, failure: FailureFindings, width: float) -> dict[str, Any] | None:
    point, campaign = failure.point, findings.campaign
    if point is None:
        return None
    space, names = campaign.space, quantities.variables(campaign)
    drawn, plane = None, ""
    # The plane's corners lie farther out than the search, where features may not be finite.
    with suppress(InputError):
        if space.dimension > 1:
            latent = boundary_of(findings.classifier, campaign.features, findings.boundary)
            figure = plot_failure_domain(point, latent, findings, names, width)
            drawn = inline(figure, "domain", "Failure domain through the design point")
            plane = " and ".join(names[column].text for column in plane_of(point, space))
    # The variables of a correlated space have no shares.
    shares = point.importance.tolist() if space.factor is None else [None] * space.dimension
    return {
        "beta": significant(point.beta),
        "probability": alike(point.probability)[0],
        "rows": list(zip(names, point.X.tolist(), shares, strict=True)),
        "plane": plane,
        "variables": space.dimension,
        "picture": drawn,
    }
