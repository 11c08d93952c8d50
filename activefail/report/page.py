"""The report of a campaign: one HTML file that stands for itself."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from numpy.typing import NDArray

from activefail import __version__
from activefail.acquisition.criteria import bald
from activefail.bearing.motion import Motion, describe_outcome
from activefail.campaign import quantities
from activefail.campaign.assembly import Campaign
from activefail.campaign.findings import Findings, at_the_boundary
from activefail.campaign.prediction import predict
from activefail.campaign.progress import standing
from activefail.campaign.provenance import provenance
from activefail.campaign.quantities import significant, words
from activefail.campaign.settings import PythonFeatures, Sampling
from activefail.campaign.summary import Plan, Summary
from activefail.comparison.static import Score
from activefail.errors import InputError
from activefail.features import PAPER_FEATURES
from activefail.figures.contours import coordinates, plot_outcome_planes
from activefail.figures.curves import plot_learning_curves
from activefail.figures.length_scales import LONG, length_scales, plot_length_scales
from activefail.figures.motion import plot_snapshots
from activefail.figures.planes import PLANES, plot_reliability
from activefail.figures.samples import MOST_SHOWN, plot_counts, plot_pairs
from activefail.figures.svg import inline
from activefail.files import replacing, target_of
from activefail.record.store import Store
from activefail.report.evidence import Curve, Evidence
from activefail.shares import interval_percent, percent
from activefail.simulators.bearing import DfpSimulator
from activefail.space import Parameter
from activefail.visible import quoted, visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_PAIRED = 6
"""Features of the pair plot at the most: those with the shortest length scales."""

LISTED = 8
"""Designs in the table of the most uncertain ones."""

_CORRELATION = {"rbf": 61, "matern52": 52}
_SETS = {
    "test": "the fresh designs that `activefail compare` simulated",
    "validation": "the campaign's validation designs",
    "left out": "the designs of the seed, each left out of the training in turn",
}


@dataclass(frozen=True)
class Picture:
    """A figure of the page with what to see in it."""

    svg: Markup
    caption: str | Markup
    wide: bool = False


def _picture(figure: "Figure", name: str, alternative: str, caption: str | Markup) -> Picture:
    return Picture(inline(figure, name, alternative), caption, float(figure.get_size_inches()[0]) > 8.0)


def subscripts(text: str) -> Markup:
    """Text in which `_x` after a letter is a subscript, like D_tot."""
    parts = text.split("_")
    out = escape(parts[0])
    for part in parts[1:]:
        end = next((i for i, letter in enumerate(part) if not letter.isalnum()), len(part))
        out += Markup("<sub>{}</sub>{}").format(part[:end], part[end:])
    return out


def spread(parameter: Parameter) -> str:
    """How designs are spread over a variable, in words."""
    if parameter.mean is not None and parameter.sd is not None:
        return f"normal, {significant(parameter.mean)} ± {significant(parameter.sd)}, within the bounds"
    return parameter.distribution.replace("_", "-")


def _probability(p: float) -> str:
    return "< 0.01" if p < 0.005 else "> 0.99" if p > 0.995 else f"{p:.2f}"


def _counts(findings: Findings) -> dict[str, NDArray[np.int64]]:
    """Simulations by outcome and, last, without an answer, (outcomes + 1,), by the group's title."""
    k = len(findings.campaign.simulator.outcomes)
    groups = {
        "seed design": ~findings.chosen,
        "chosen by the learner": findings.chosen,
        "all": np.ones(len(findings.X), dtype=bool),
    }
    code = np.where(findings.answered, findings.outcome, k)
    return {title: np.bincount(code[rows], minlength=k + 1) for title, rows in groups.items()}


def _curve(findings: Findings, evidence: Evidence) -> dict[str, Any]:
    curve = evidence.curve
    if curve is None:
        return {"picture": None, "rows": []}
    boundary = words(findings.boundary)
    figure = plot_learning_curves(curve.scores, quantities.plain(boundary), curve.test_size)
    both = len({score.sampling for score in curve.scores}) > 1
    text = (
        f"Share of {curve.test_size} fresh designs on the right side of the {boundary} boundary, against the number of "
        "simulations that were learned from. "
    )
    text += (
        "Where the solid line is above the dashed one, choosing the simulations was worth more than spreading them "
        "evenly; where the bands overlap, so many test designs cannot tell."
        if both
        else "How much the last simulations still added says whether more of them are worth their price."
    )
    outcomes = findings.campaign.simulator.outcomes
    rows = [
        {
            "simulations": score.simulations,
            "sampling": {"active": "active", "static": "static Latin hypercube"}.get(score.sampling, score.sampling),
            "accuracy": percent(score.accuracy, 2),
            "interval": interval_percent(score.low, score.high),
            "recall": [score.recall[name].in_words for name in outcomes if score.recall],
            "outcome_accuracy": percent(score.outcome_accuracy, 2),
            "log_score": f"{score.log_score:.4f}".replace("-", "−"),
        }
        for score in sorted(curve.scores, key=lambda score: (score.simulations, score.sampling))
    ]
    return {"picture": _picture(figure, "curve", "Learning curve", text), "rows": rows}


def _pairs(findings: Findings, scales: NDArray[np.float64]) -> Picture:
    campaign = findings.campaign
    features = campaign.features
    shown = sorted(np.argsort(scales[campaign.severity - 1], kind="stable")[:MOST_PAIRED].tolist())
    names = quantities.features(campaign)
    rows = findings.answered
    figure = plot_pairs(
        features.raw(findings.X[rows])[:, shown],
        findings.outcome[rows],
        findings.chosen[rows],
        [names[column] for column in shown],
        [bool(features.logarithmic[column]) for column in shown],
        campaign.simulator.outcomes,
    )
    of = (
        ""
        if len(shown) == len(names)
        else f" The {len(shown)} of {len(names)} features with the shortest length scales."
    )
    chosen = int(np.sum(findings.chosen))
    caption = (
        "The simulated designs in pairs of features: below the diagonal the seed design, which fills the space "
        "evenly; above it, mirrored, the designs that the learner chose."
        + (
            f" Of each at most {MOST_SHOWN} are shown, evenly picked."
            if max(chosen, len(findings.X) - chosen) > MOST_SHOWN
            else ""
        )
        + (
            " Compare a panel with its mirror image: the chosen designs gather where outcomes meet."
            if chosen
            else " None was chosen yet: the panels above the diagonal are empty."
        )
        + " On the diagonal how both are spread."
        + of
    )
    return _picture(figure, "pairs", "Designs in pairs of features", caption)


def _planes(findings: Findings) -> list[Picture]:
    c = coordinates(findings)
    severe = [words(name) for name in findings.campaign.simulator.outcomes[1:]]
    listed = " and ".join(f"P({name})" for name in severe)
    what = (
        f"{listed} by the classifier, and at the foot how sure it is: the width of the 95 % interval of the "
        f"probability of {findings.beyond}. Along the thick line the probability is one half: that is the boundary. "
        "Where the last row is dark, the classifier is least sure. Points are the simulated designs within the "
        "range of each column's title."
    )
    if len(severe) > 1:
        what += f" P({severe[0]}) is of {severe[0]} without {severe[-1]}: a ridge between the two boundaries."
    held = (
        "The other features are held at their medians; hatched is where no design of the space has these features."
        if c.planes is PLANES and findings.campaign.features.names == PAPER_FEATURES
        else "The other features are held at their medians. Features do not fix a design: each point stands for one "
        "near the middle of the space that has them; hatched is where none has."
        if c.planes is PLANES
        else "The other variables are held in the middle of their ranges."
    )
    pictures = []
    for number, plane in enumerate(c.planes, start=1):
        names = f"{c.quantities[plane.x].text} and {c.quantities[plane.y].text}"
        pictures.append(
            _picture(
                plot_outcome_planes(plane, c, findings),
                f"plane{number}",
                f"Probabilities in the plane of {names}",
                Markup("Plane of {}. {} {}").format(subscripts(names), what, held),
            )
        )
    return pictures


def _reliability(findings: Findings, evidence: Evidence) -> Picture | None:
    found = evidence.reliability
    if found is None:
        return None
    beyond = findings.beyond
    name = quantities.plain(beyond)
    title = f"{len(found.beyond)} designs"
    labels = (f"share with {name} [–]", f"predicted P({name}) [–]")
    figure = plot_reliability({title: found.probability}, found.beyond, 1, labels=labels)
    caption = (
        f"Of the designs to which the classifier gave a probability, how many went that way: {len(found.beyond)} "
        f"designs, {_SETS[found.source].replace('`', '')}. On the dotted diagonal probabilities mean what they "
        f"say; above it {beyond} is more frequent than predicted. The band is Wilson's 95 % interval. Below: how many "
        "designs are behind each point; few in the middle means that the classifier is rarely undecided."
    )
    return _picture(figure, "reliability", "Reliability diagram", caption)


def _scales(findings: Findings, scales: NDArray[np.float64]) -> dict[str, Any]:
    campaign = findings.campaign
    features = campaign.features
    names = quantities.features(campaign)
    boundaries = campaign.simulator.outcomes[1:]

    def own(length: float, column: int, unit: str) -> str:
        if length > LONG:
            return "more than its range"
        step = length * float(features.spread[column])
        if features.logarithmic[column]:
            return f"a factor of {significant(float(np.exp(step)), 2)}"
        return f"± {significant(step, 2)} {unit}".rstrip()

    rows = []
    for column in np.argsort(scales[campaign.severity - 1], kind="stable").tolist():
        cells = [
            {"length": significant(float(row[column]), 2), "own": own(float(row[column]), column, names[column].unit)}
            for row in scales
        ]
        rows.append({"quantity": names[column], "cells": cells, "matters": bool((scales[:, column] <= LONG).any())})
    caption = (
        "How far a feature must move, all others kept, before a boundary's latent function may have become another: "
        "the further left, the more the outcome hangs on the feature. In the grey range a length scale is longer than "
        "the feature's whole range: the classifier hardly uses it."
    )
    return {
        "picture": _picture(
            plot_length_scales(scales, names, campaign.simulator.outcomes), "scales", "Length scales", caption
        ),
        "rows": rows,
        "boundaries": [words(name) for name in boundaries],
        "correlation": _CORRELATION[campaign.settings.classifier.kernel],
    }


def _uncertain(findings: Findings) -> list[dict[str, Any]]:
    prediction = findings.pool_prediction
    tells = bald(prediction.mean, prediction.sd)
    rows = np.argsort(-tells, kind="stable")[:LISTED]
    return [
        {
            "design": [significant(float(value)) for value in findings.pool[row]],
            "probabilities": [_probability(float(p)) for p in prediction.probabilities[row]],
            "interval": f"{_probability(prediction.low[row])} to {_probability(prediction.high[row])}",
            "tells": f"{tells[row]:.2f}",
        }
        for row in rows.tolist()
    ]


def _gallery(findings: Findings) -> list[Picture]:
    if not isinstance(findings.campaign.simulator, DfpSimulator):
        return []
    pictures = []
    for number, (row, why) in enumerate(at_the_boundary(findings), start=1):
        response = findings.campaign.simulator.response(findings.X[row])
        try:
            Motion(response)
        except InputError:
            continue  # it ended at its start: there is nothing to draw
        prediction = predict(findings.campaign, findings.classifier, findings.X[row : row + 1])
        told = ", ".join(
            f"P({words(name)}) {_probability(float(p))}"
            for name, p in zip(findings.campaign.simulator.outcomes, prediction.probabilities[0], strict=True)
        )
        origin = f"iteration {findings.iteration[row]}" if findings.chosen[row] else "seed design"
        pictures.append(
            _picture(
                plot_snapshots(response),
                f"bearing{number}",
                f"Plates and slider of simulation {row} at four instants",
                f"{why}: simulation {row} ({origin}). {describe_outcome(response)}. The classifier, which has "
                f"learned from it, says {told}. Plates in grey, their rims dark, the slider blue; the marks at "
                "its corners say what each of them does.",
            )
        )
    return pictures


def _what_was_run(findings: Findings, done: int) -> list[tuple[str, str]]:
    settings = findings.campaign.settings
    plan = Plan.of(settings.text())
    sampling = settings.sampling
    sought = " and ".join(
        f"the {words(name)} boundary" + (f" ({percent(share, 0)})" if share < 1.0 else "")
        for name, share in settings.acquisition.boundaries.items()
    )
    return [
        ("simulator", f"{plan.simulator}, {findings.campaign.space.dimension} variables"),
        ("simulations", _planned(done, sampling)),
        ("chosen by the learner", _chosen(findings, sampling)),
        ("learner", f"Gaussian process classifier, {settings.classifier.kernel} covariance"),
        ("features", plan.features),
        ("sought", f"{sought}, by the criterion {settings.acquisition.criterion}"),
        ("seed", str(settings.seed)),
    ]


def _planned(done: int, sampling: Sampling) -> str:
    beyond = (
        f"{done}, beyond the {sampling.budget} planned"
        if done > sampling.budget
        else f"{done} of {sampling.budget} planned"
    )
    return f"{beyond}, from a Latin hypercube of {sampling.initial} on"


def _chosen(findings: Findings, sampling: Sampling) -> str:
    chosen = int(np.sum(findings.chosen))
    if sampling.asynchronous:
        return f"{chosen} designs, each as soon as an answer came, up to {sampling.batch} in flight"
    batches = int(findings.iteration.max())
    return f"{chosen} designs in {batches} {'batch' if batches == 1 else 'batches'} of {sampling.batch}"


def _same_again(findings: Findings, sampling: Sampling) -> str:
    """What running the same campaign again gives, and why it may not be the same."""
    if sampling.asynchronous:
        return (
            "Another run chooses other designs: each is chosen from the answers that have come by then, and these come "
            "in another order."
        )
    _, sizes = np.unique(findings.iteration[findings.chosen], return_counts=True)
    said = "The same versions on the same kind of processor give the same bits"
    if np.any(sizes[:-1] < sampling.batch):
        return (
            f"{said} where the campaign is extended as this one was: it ended before in a batch of fewer than "
            f"{sampling.batch}, and a run to the whole number at once chooses other designs from there on."
        )
    return f"{said}."


def _in_short(findings: Findings, evidence: Evidence, done: int) -> list[tuple[str, str]]:
    """The numbers that a reader in a hurry wants."""
    boundary = words(findings.boundary)
    lines = [("simulations", str(done))]
    if evidence.curve is not None:
        last = max(evidence.curve.scores, key=lambda score: (score.sampling == "active", score.simulations))
        lines.append((f"right about {boundary}", f"{_right(last, evidence.curve)} simulations"))
        lines += _recall_lines(last, "")
        static = [s for s in evidence.curve.scores if s.sampling == "static" and s.simulations == last.simulations]
        if static and last not in static:
            lines.append(("static sampling of that size", f"{_right(static[0], evidence.curve)} ones"))
            lines += _recall_lines(static[0], ", static sampling")
    if evidence.error is not None:
        error = evidence.error
        lines.append(
            (
                "verified error",
                f"{percent(error.error, 2)} of the design space ({interval_percent(error.low, error.high)} "
                f"with 90 % confidence, {error.in_words})",
            )
        )
    expected = f"{percent(findings.expected, 2)} of the design space, without an interval"
    lines.append(("error that it expects itself", expected))
    return lines


def _right(score: Score, curve: Curve) -> str:
    interval = interval_percent(score.low, score.high)
    right = f"{percent(score.accuracy)} of {curve.test_size} fresh designs ({interval} with 95 % confidence)"
    return f"{right}, after {score.simulations} {score.sampling}"


def _recall_lines(score: Score, of: str) -> list[tuple[str, str]]:
    return [(f"recall of {words(name)}{of}", one.in_words) for name, one in score.recall.items()]


def _features_need_code(campaign: Campaign) -> bool:
    return isinstance(campaign.settings.classifier.features, PythonFeatures)


def _judging(findings: Findings, evidence: Evidence, folder: str, code: str) -> list[str]:
    """The commands by which a campaign was judged as the page says, and the page's own.

    Args:
        folder: of the run.
        code: what a command that simulates has to be given, so that it may run the campaign's own code.
    """
    commands = []
    if evidence.curve is not None and evidence.curve.source == "compare":
        budgets = ",".join(str(n) for n in sorted({score.simulations for score in evidence.curve.scores}))
        test = evidence.curve.test_size + evidence.curve.unanswered
        commands.append(f"activefail compare {folder} --budgets {budgets} --test {test}{code}")
    if evidence.error is not None:
        commands.append(f"activefail verify {folder} --simulations {evidence.error.asked}{code}")
    return [*commands, f"activefail report {folder}{code if _features_need_code(findings.campaign) else ''}"]


def render(findings: Findings, evidence: Evidence, store: Store, stage: Callable[[str], None] = lambda _: None) -> str:
    """The page as HTML."""
    campaign, folder = findings.campaign, findings.folder
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    settings, outcomes = campaign.settings, campaign.simulator.outcomes
    done = standing(campaign, store.batches, 0).done
    counts = _counts(findings)
    scales = length_scales(findings.classifier)
    run_folder = quoted(folder)
    stage("drawing")
    budget = f" --budget {done}" if done != settings.sampling.budget else ""
    versions = provenance()
    code = " --code FOLDER" if _features_need_code(campaign) or not isinstance(settings.simulator, str) else ""
    numbers: dict[str, Any] = {
        "title": visible(settings.description or folder.name),
        "version": __version__,
        "in_short": _in_short(findings, evidence, done),
        "run": _what_was_run(findings, done),
        "variables": [
            {"quantity": names, "low": significant(p.low), "high": significant(p.high), "spread": spread(p)}
            for names, p in zip(quantities.variables(campaign), campaign.space.parameters, strict=True)
        ],
        "fixed": [
            {"quantity": names, "value": significant(value)}
            for names, value in zip(quantities.fixed(campaign), campaign.space.fixed.values(), strict=True)
        ],
        "outcomes": [words(name) for name in outcomes],
        "boundary": words(findings.boundary),
        "counts": {title: values.tolist() for title, values in counts.items()},
        "counts_picture": _picture(
            plot_counts({title: values[:-1] for title, values in counts.items()}, outcomes),
            "counts",
            "Shares of the outcomes",
            "Shares of the outcomes, with the number of simulations in each bar. The seed design shows how frequent an "
            "outcome is in the design space; what the learner chose is a mixture, as both sides of a boundary are.",
        ),
        "curve": _curve(findings, evidence),
        "pairs": _pairs(findings, scales),
        "planes": _planes(findings),
        "reliability": _reliability(findings, evidence),
        "scales": _scales(findings, scales),
        "uncertain": _uncertain(findings),
        "pool": len(findings.pool),
        "beyond": findings.beyond,
        "missing": evidence.missing,
        "done": done,
        "unseen": Summary.of(settings.text(), outcomes, store.batches).unseen_warning,
        "left": max(0, settings.sampling.budget - done),
        "folder": run_folder,
        "commands": [
            f"activefail run campaign.toml --out {run_folder}{budget}",
            *_judging(findings, evidence, run_folder, code),
        ],
        "same": _same_again(findings, settings.sampling),
        "code": code,
        "drawn": isinstance(campaign.simulator, DfpSimulator),
        "settings": visible(text, keep="\n"),
        "digest": hashlib.sha256(text.encode()).hexdigest(),
        "versions": {
            name: value for name, value in versions.items() if name not in ("processor_features", "bearing_sources")
        },
    }
    stage("simulating the gallery")
    numbers["gallery"] = _gallery(findings)
    environment = Environment(
        loader=PackageLoader("activefail.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["subscripts"] = subscripts
    return environment.get_template("report.html.j2").render(numbers)


def write_report(page: str, path: Path) -> None:
    """Write the page under its name only once it is whole.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(target_of(path)) as file:
        file.write(page)
