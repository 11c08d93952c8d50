"""The report of a campaign, one self-contained HTML file: the values for `report.html.j2`, which holds the prose."""

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.analyses.comparison.equivalent import equivalent
from activefail.analyses.comparison.static import given_in_words, median_score
from activefail.analyses.findings import quantities
from activefail.analyses.findings.failure import FailureFindings
from activefail.analyses.findings.learned_from import source_in_words
from activefail.analyses.findings.results import Findings, at_the_boundary, information
from activefail.analyses.findings.summary import Summary, features_in_words, simulator_in_words, where_lost
from activefail.campaign.assembly import Campaign
from activefail.campaign.continuing import continue_command
from activefail.campaign.hazard import has_hazards
from activefail.campaign.provenance import provenance
from activefail.estimates.scores import error_in_words
from activefail.learning.model.margin_data import KERNEL as MARGIN_KERNEL
from activefail.learning.model.system import ByMargins
from activefail.loop.stop_rule import noted
from activefail.pages.figures.classifier import LONG, length_scales, plot_length_scales, plot_reliability
from activefail.pages.figures.curves import plot_learning_curves
from activefail.pages.figures.outcome_planes import coordinates, plot_outcome_planes
from activefail.pages.figures.samples import MOST_SHOWN, plot_counts, plot_pairs
from activefail.pages.figures.svg import inline, inlined
from activefail.pages.report.environment import page_environment
from activefail.pages.report.evidence import Curve, Evidence, Reliability
from activefail.pages.report.failure import failure_section
from activefail.pages.report.fragility_section import RiskFindings, fragility_section
from activefail.pages.view import view_of
from activefail.record.batch import ACTIVE, CHECK
from activefail.record.layout import SETTINGS
from activefail.record.store import Store
from activefail.simulators.interface import noun_of
from activefail.space.distributions import FAMILIES
from activefail.space.parameter import Parameter
from activefail.space.shares import choices_with_shares, significant
from activefail.text.numerals import outcomes_in_words
from activefail.text.quantities import plain
from activefail.version import __version__
from activefail.visible import quoted, visible, words

MOST_PAIRED = 6
"""Most features in the pair plot: those with the shortest length scales."""

LISTED = 8
"""Designs in the table of the most uncertain designs."""

_CORRELATION = {"rbf": 61, "matern52": 52}
"""Correlation at a distance of one length scale [%], by kernel."""


def spread(parameter: Parameter) -> str:
    """A variable's distribution in words."""
    if parameter.choices:
        return choices_with_shares(parameter)
    name = FAMILIES[parameter.distribution].words
    if parameter.step is not None:
        name = f"{name}, in steps of {parameter.step:g}"
    if parameter.mean is None:
        return name
    if parameter.sd is None:
        return f"{name}, mean {significant(parameter.mean)}, within the bounds"
    within = "" if parameter.distribution == "beta" else ", within the bounds"
    return f"{name}, {significant(parameter.mean)} ± {significant(parameter.sd)}{within}"


def _counts(summary: Summary) -> dict[str, Any]:
    """Simulations by outcome, numerical failures last, (outcomes + 1,), by the group's title."""
    groups = {"initial design": summary.initial, "active designs": summary.chosen}
    groups |= {"given": summary.given} if summary.given.any() else {}
    groups["all"] = summary.counts
    asked = (summary.initial + summary.chosen).tolist()
    texts = outcomes_in_words(asked, map(words, summary.outcomes))[: None if asked[-1] else -1]
    figure = plot_counts({title: values[:-1] for title, values in groups.items()}, summary.outcomes)
    return {"picture": inline(figure, "counts", "Shares of the outcomes"), "groups": groups, "asked": ", ".join(texts)}


def _curve(findings: Findings, curve: Curve | None) -> dict[str, Any]:
    if curve is None:
        return {"picture": None}
    scores = sorted(curve.scores, key=lambda score: (score.simulations, score.sampling))
    last = max(scores, key=lambda score: (score.sampling == "active", score.simulations))
    static = [score for score in scores if score.sampling == "static" and score.simulations == last.simulations]
    boundary = plain(words(findings.boundary))
    figure = plot_learning_curves(curve.scores, boundary, curve.test_size)
    return {
        "picture": inline(figure, "curve", "Learning curve"),
        "scores": scores,
        "last": last,
        "static": median_score(static) if static and last not in static else None,
        "both": len({score.sampling for score in scores}) > 1,
        "test_size": curve.test_size,
        "given": given_in_words(scores),
        "equivalent": same.in_words(boundary) if (same := equivalent(scores)) else "",
    }


def _pairs(findings: Findings, scales: NDArray[np.float64] | None) -> dict[str, Any]:
    campaign = findings.campaign
    features, names = campaign.features, quantities.features(campaign)
    first = range(len(names)) if scales is None else np.argsort(scales[campaign.severity - 1], kind="stable")
    shown = sorted(int(column) for column in first[:MOST_PAIRED])
    history = findings.history
    rows = history.answered & ~history.given
    drawn = history[rows if rows.any() else history.answered]
    figure = plot_pairs(
        features.raw(drawn.designs)[:, shown],
        drawn.outcome,
        drawn.chosen,
        [names[column] for column in shown],
        [bool(features.logarithmic[column]) for column in shown],
        campaign.simulator.outcomes,
    )
    return {
        "picture": inline(figure, "pairs", "Designs in pairs of features"),
        "chosen": history.chosen.any(),
        "most_shown": MOST_SHOWN,
        "thinned": max(history.chosen.sum(), history.initial.sum()) > MOST_SHOWN,
        "features_shown": len(shown),
        "features": len(names),
    }


def _planes(findings: Findings) -> dict[str, Any]:
    c = coordinates(findings)
    pictures = []
    for number, plane in enumerate(c.planes, start=1):
        names = f"{c.quantities[plane.x].text} and {c.quantities[plane.y].text}"
        alternative = f"Probabilities in the plane of {names}"
        drawn = inlined(plot_outcome_planes(plane, c, findings), f"plane{number}", alternative)
        pictures.append((names, drawn))
    return {
        "pictures": pictures,
        "of_features": c.are_features,
        "of_the_classifier": findings.campaign.features.names == tuple(one.name for one in c.quantities),
    }


def _reliability(findings: Findings, reliability: Reliability | None) -> dict[str, Any] | None:
    if reliability is None:
        return None
    name, designs = plain(findings.beyond), len(reliability.beyond)
    labels = f"share with {name} [–]", f"predicted P({name}) [–]"
    figure = plot_reliability({f"{designs} designs": reliability.probability}, reliability.beyond, 1, labels=labels)
    picture = inline(figure, "reliability", "Reliability diagram")
    return {"picture": picture, "designs": designs, "source": reliability.source}


def _scales(findings: Findings, scales: NDArray[np.float64]) -> dict[str, Any]:
    campaign = findings.campaign
    features, names = campaign.features, quantities.features(campaign)

    def in_units(length: float, column: int) -> str:
        if length > LONG:
            return "more than its range"
        step = length * float(features.scaling[1][column])
        if features.logarithmic[column]:
            return f"a factor of {significant(float(np.exp(step)), 2)}"
        return f"± {significant(step, 2)} {names[column].unit}".rstrip()

    order = np.argsort(scales[campaign.severity - 1], kind="stable").tolist()
    figure = plot_length_scales(scales, names, campaign.simulator.outcomes)
    return {
        "picture": inline(figure, "scales", "Length scales"),
        "rows": [
            (names[column], [(length, in_units(length, column)) for length in scales[:, column].tolist()])
            for column in order
        ],
        "long": LONG,
        "correlations": sorted({_CORRELATION[kernel] for _, _, kernel in _learned_from(findings)}),
    }


def _uncertain(findings: Findings) -> list[tuple[Any, ...]]:
    """The designs of the pool that would tell the most: with probabilities, their interval, and information [bit]."""
    of_pool, predicted = findings.pool_prediction, findings.classifier.predicted(findings.pool)
    bits = information(predicted, findings.campaign.severity)
    columns = (of_pool.probabilities, of_pool.low, of_pool.high, bits)
    rows = np.argsort(-bits, kind="stable")[:LISTED]
    designs = [findings.campaign.space.row(X) for X in findings.pool[rows]]
    return list(zip(designs, *(column[rows].tolist() for column in columns), strict=True))


def _gallery(findings: Findings) -> list[dict[str, Any]]:
    view, shown, history = view_of(findings.campaign.simulator), list[dict[str, Any]](), findings.history
    if view is None:
        return shown
    for number, (row, why) in enumerate(at_the_boundary(findings), start=1):
        X = history.designs[row]
        picture = view.picture(X, f"bearing{number}", f"simulation {history.id[row]}")
        if picture is None:
            continue
        entered = "given" if history.given[row] else f"iteration {history.iteration[row]}"
        shown.append(
            {
                "picture": picture.drawn,
                "legend": view.legend,
                "why": why,
                "simulation": int(history.id[row]),
                "entered": "initial design" if history.initial[row] else entered,
                "result": picture.result,
                "terms": picture.terms,
                "probabilities": findings.classifier.probabilities(X[None])[0].tolist(),
            }
        )
    return shown


def _learned_from(findings: Findings) -> list[tuple[str, str, str]]:
    """For each boundary its outcome, the margin that it is learned from (or nothing), and the kernel."""
    campaign, classifier = findings.campaign, findings.classifier
    rows = []
    for number, latent in enumerate(classifier.latents):
        is_margin = isinstance(latent, ByMargins)
        name = source_in_words(campaign.learnable[classifier.choices[number].margin]) if is_margin else ""
        kernel = MARGIN_KERNEL if is_margin else campaign.settings.classifier.name
        rows.append((campaign.simulator.outcomes[number + 1], name, kernel))
    return rows


def _learner(findings: Findings) -> dict[str, Any]:
    """Numbers of active designs and batches, and what each boundary is learned from."""
    history = findings.history
    _, sizes = np.unique(history.iteration[history.origin == ACTIVE], return_counts=True)
    checks = history.iteration[history.origin == CHECK]
    return {
        "chosen": sizes.sum(),
        "batches": len(sizes),
        "of_a_size": sizes.max(initial=0) <= findings.campaign.settings.sampling.batch,
        "checked": len(checks),
        "checks": len(np.unique(checks)),
        "ended_within_a_batch": bool(np.any(sizes[:-1] < findings.campaign.settings.sampling.batch)),
        "learned": _learned_from(findings),
    }


def _commands(findings: Findings, evidence: Evidence, done: int, risk: RiskFindings | None) -> list[str]:
    """The commands that reproduce the campaign of so many simulations, the evidence and the page."""
    campaign, folder = findings.campaign, quoted(findings.folder)
    budget = f" --budget {done}" if done != campaign.settings.sampling.budget else ""
    commands = [f"activefail {'create' if campaign.is_elsewhere else 'run'} campaign.toml --out {folder}{budget}"]
    if campaign.is_elsewhere:
        continues = continue_command(findings.folder, campaign)
        commands += [continues, f"activefail tell {folder} --csv answers.csv"]
    if (curve := evidence.curve) is not None and curve.source == "compare":
        budgets = ",".join(str(n) for n in sorted({score.simulations for score in curve.scores}))
        commands.append(f"activefail compare {folder} --budgets {budgets} --test {curve.test_size + curve.unanswered}")
    if error := evidence.error or (evidence.surface and evidence.surface.as_json()):
        asked = f"--simulations {error['simulations'] + error['numerical_failures'] + error.get('nonexistent', 0)}"
        asked += f" --confidence {error['confidence']:g}" if error["confidence"] != 0.9 else ""
        commands.append(f"activefail verify {folder} {asked}")
    return [*commands, f"activefail report {folder}{f' {risk.request.options}' if risk else ''}"]


def _verifies(campaign: Campaign) -> str:
    """What `verify` does with the campaign."""
    if campaign.settings.is_repeatable:
        return "estimates with an interval how much of the design space the classifier gets wrong"
    return "scores the classifier's probabilities by fresh simulations"


def _next_step(
    campaign: Campaign, evidence: Evidence, folder: str, failure: FailureFindings | None, has_risk: bool
) -> tuple[str, str]:
    """What a reader of the page about a complete campaign in a run folder (quoted) does next: a command, and why."""
    if failure is not None and "probability" not in campaign.settings.refused:
        if failure.estimate is None and failure.asked is None:
            return f"activefail probability {folder}", "estimates the probability with an interval"
        return f"activefail sensitivity {folder}", "says which variables matter"
    if "error" in evidence.missing:
        return f"activefail verify {folder}", _verifies(campaign)
    if "curve" in evidence.missing:
        return f"activefail compare {folder}", "compares the campaign with static designs"
    if has_hazards(campaign.space) and not has_risk:
        command = f"activefail report {folder} --hazard HAZARD.toml --fixed DESIGN.toml"
        return command, "adds the fragility of a design at a site"
    return f"activefail predict {folder} --csv designs.csv --out predictions.csv", "predicts other designs"


def render(
    findings: Findings,
    evidence: Evidence,
    store: Store,
    stage: Callable[[str], None] = lambda _: None,
    failure: FailureFindings | None = None,
    risk: RiskFindings | None = None,
) -> str:
    """The page as HTML.

    Args:
        findings: of the campaign.
        evidence: of the classifier's accuracy.
        store: the record.
        stage: called with each stage of the work.
        failure: what the campaign says of a probability.
        risk: what a hazard means for the campaign's bearing.
    """
    campaign, folder = findings.campaign, quoted(findings.folder)
    text = (findings.folder / SETTINGS).read_text(encoding="utf-8")
    settings, history = campaign.settings, findings.history
    summary = Summary.of(settings, campaign.schema, history, store.asked)
    done, scales = history.asked_for, length_scales(findings.classifier)
    left = 0 if noted(store) else max(0, settings.sampling.budget - done)
    continues = continue_command(findings.folder, campaign)
    next_step = _next_step(campaign, evidence, folder, failure, risk is not None)
    if left:
        next_step = continues, f"continues the campaign: {left} of the planned simulations are left"
    hidden = ("processor_features", "bearing_sources")
    stage("drawing")
    numbers: dict[str, Any] = {
        "title": visible(settings.description or findings.folder.name),
        "version": __version__,
        "findings": findings,
        "evidence": evidence,
        "campaign": campaign,
        "simulator": simulator_in_words(settings),
        "features": features_in_words(settings),
        "learner": _learner(findings),
        "variables": list(zip(quantities.variables(campaign), campaign.space.parameters, strict=True)),
        "constraints": [one.text for one in campaign.space.constraints],
        "fixed": list(zip(quantities.fixed(campaign), campaign.space.fixed.values(), strict=True)),
        "counts": _counts(summary),
        "lost": where_lost(campaign.space.names, history.designs, ~history.answered, settings.without_order),
        "failure": failure_section(findings, failure),
        "risk": fragility_section(risk),
        "has_pulse": has_hazards(campaign.space),
        "curve": _curve(findings, evidence.curve),
        "pairs": _pairs(findings, scales),
        "planes": _planes(findings),
        "verified": evidence.error and error_in_words(evidence.error),
        "reliability": _reliability(findings, evidence.reliability),
        "scales": None if scales is None else _scales(findings, scales),
        "uncertain": _uncertain(findings),
        "done": done,
        "unseen": summary.unseen_warning,
        "left": left,
        "folder": folder,
        "continues": continues,
        "next_step": next_step,
        "verifies": _verifies(campaign),
        "commands": _commands(findings, evidence, done, risk),
        "has_meanings": hasattr(campaign.simulator, "quantities"),
        "drawn": view_of(campaign.simulator) and noun_of(campaign.simulator).capitalize(),
        "frozen": text,
        "digest": hashlib.sha256(text.encode()).hexdigest(),
        "versions": {name: value for name, value in provenance().items() if name not in hidden},
    }
    stage("simulating the gallery")
    numbers["gallery"] = _gallery(findings)
    environment = page_environment()
    environment.filters["spread"] = spread
    return environment.get_template("report.html.j2").render(numbers)
