"""`activefail probability`: the probability of an outcome, with an interval from fresh simulations."""

from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import AsJson, Code, Fixed, RunFolder, opened_run, print_json, show_unseen
from activefail.shares import percent
from activefail.visible import or_worse, visible


def probability(
    folder: RunFolder,
    simulations: Annotated[
        int,
        typer.Option(
            help="Fresh simulations, outside the budget; a question may add a mode check.", min=10, max=1_000_000
        ),
    ] = 50,
    confidence: Annotated[float, typer.Option(help="Confidence of the interval.", min=0.5, max=0.999)] = 0.9,
    outcome: Annotated[
        str | None,
        typer.Option(
            help="Outcome whose probability is estimated. Default: the outcome of the target boundary.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
    question: Annotated[
        Path | None,
        typer.Option(
            help="File with other distributions of the variables (docs/probability.md), or a hazard file "
            "(docs/hazard.md).",
            show_default=False,
        ),
    ] = None,
    hazard: Annotated[
        Path | None,
        typer.Option(help="Hazard file; the distribution is that of its pulses (docs/hazard.md).", show_default=False),
    ] = None,
    fixed: Fixed = None,
    code: Code = None,
) -> None:
    """Estimate the probability of an outcome, with an interval.

    The estimate combines the campaign's classifier with fresh simulations.
    """
    from activefail.findings.probability import rounded_up

    with opened_run(folder, write=True, code=code) as opened:
        findings = opened.probability(simulations, confidence, outcome, question, fixed=fixed, hazard=hazard)
        summary = opened.summary
        boundaries = opened.campaign.simulator.outcomes
    show_unseen(summary)
    if as_json:
        print_json({"outcomes": {findings.outcome: findings.as_json()}})
        return
    estimate = findings.estimate
    name = visible(or_worse(findings.outcome, boundaries))
    learned = f"the margin {visible(findings.learned_from)}" if findings.learned_from else "the outcomes"
    failed = f"; {estimate.unanswered} failed numerically" if estimate.unanswered else ""
    under = f" under {visible(findings.question)}" if findings.question else ""
    print(f"probability of {name}{under}: {estimate.probability:.3g}")
    interval = f"{estimate.low:.3g} to {estimate.high:.3g}"
    if findings.is_extrapolated:
        print(f"interval   0 to {rounded_up(findings.high)}, without a model; {interval} under the classifier")
    else:
        print(f"interval   {interval}, with {100 * confidence:g} % confidence")
    print(
        f"from       {findings.learned} simulations of the campaign ({findings.seen} ended in {name}) and "
        f"{estimate.simulations} fresh simulations ({estimate.beyond} ended in {name}{failed})"
    )
    print(
        f"classifier {findings.model.probability:.3g}, learned from {learned}, without an interval; "
        f"contradictions by fresh simulations: {estimate.wrong}"
    )
    if check := estimate.check:
        print(
            f"check      {check.simulations} more designs under the question, far from all others; "
            f"contradictions: {check.contradictions}"
        )
    print(
        f"recall     {percent(estimate.recall)} of the estimated probability lies where {name} is predicted; "
        f"at least {percent(estimate.recall_low)} with {100 * confidence:g} % confidence"
    )
    print(
        f"bound      {rounded_up(findings.bound.high)} without a model, one-sided at 90 %, from the "
        f"{findings.bound.in_words} alone"
    )
    for sentence in findings.assumptions:
        print(f"note       {sentence}")
