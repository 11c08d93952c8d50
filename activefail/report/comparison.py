"""The page of a comparison over seeds: tables of every measure, learning curves, and what a static design needs."""

from pathlib import Path

import numpy as np

from activefail.comparison.score import DISPLACEMENT, NEIGHBOURS
from activefail.comparison.seeds import STATIC, Plan, Point, Score, curves, simulations_to_reach
from activefail.csv_table import writing
from activefail.figures.curves import plot_sampling_curves
from activefail.figures.style import save_figure
from activefail.files import replacing

MEASURES = {
    "accuracy": "accuracy",
    "accuracy_near": "near the boundary",
    "recall_small": "recall of small regions",
    "log_score": "log score",
    "calibration_error": "calibration error",
    "outcome_accuracy": "accuracy of outcomes",
    "outcome_log_score": "log score of outcomes",
}
"""Columns of the table, by measure."""


def _range(point: Point) -> str:
    """Median and, of several seeds, least and largest."""
    values = point.values[~np.isnan(point.values)]
    if not len(values):
        return "–"
    text = f"{np.median(values):.4f}"
    return text if len(values) == 1 else f"{text} ({values.min():.4f} to {values.max():.4f})"


def _needed(points: list[Point], level: float) -> str:
    needed = simulations_to_reach(points, level)
    return f"> {points[-1].simulations}" if needed is None else f"{needed:.0f}"


def _command(plan: Plan) -> str:
    lists = {"criteria": plan.criteria, "features": plan.features, "static": plan.static}
    options = " ".join(f"--{name} {','.join(map(str, values))}" for name, values in lists.items())
    return f"activefail compare CAMPAIGN.toml --seeds {plan.seeds} {options} --test {plan.test} --out DIR"


def _sought(plan: Plan) -> str:
    shares = plan.settings.acquisition.boundaries
    if len(shares) == 1:
        return next(iter(shares))
    return ", ".join(f"{name} with {share:.0%} of the chosen designs" for name, share in shares.items())


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def comparison_text(plan: Plan, scores: list[Score]) -> str:
    """The page as Markdown."""
    boundary = plan.settings.acquisition.main_boundary
    own = {*MEASURES, f"accuracy_{boundary}"}
    others = [name for name in scores[0].measures if name.startswith("accuracy_") and name not in own]
    titles = MEASURES | {name: f"accuracy, {name.removeprefix('accuracy_')} boundary" for name in others}
    by_measure = {name: curves(scores, name) for name in titles}
    lines = [
        f"# Samplings compared: {plan.settings.description or 'a campaign'}",
        "",
        f"Boundary sought: {_sought(plan)}. Judged at the {boundary} boundary. Median over {plan.seeds} seeds (least "
        f"to largest), on {plan.test} fresh designs that all share. *Near the boundary*: designs for which one of "
        f"{NEIGHBOURS} designs displaced by {DISPLACEMENT:.0%} of the ranges is on the other side. *Small regions*: "
        "designs beyond the boundary for which half of these are not. Written by",
        "",
        "    " + _command(plan),
        "",
        _row(["features", "sampling", "simulations", *titles.values()]),
        "|" + "---|" * (3 + len(titles)),
    ]
    for (features, sampling), points in by_measure["accuracy"].items():
        for place, point in enumerate(points):
            cells = [_range(by_measure[name][features, sampling][place]) for name in titles]
            lines.append(_row([features, sampling, str(point.simulations), *cells]))
    found = by_measure["accuracy"]
    active = {key: points for key, points in found.items() if key[1] != STATIC}
    fixed = {key: points for key, points in found.items() if key[1] == STATIC}
    if active and fixed:
        lines += [
            "",
            f"Simulations to reach the {boundary} accuracy of a static Latin hypercube (medians, interpolated):",
            "",
            _row(["static, features", "simulations", "accuracy", *(f"{s}, {f}" for f, s in active)]),
            "|" + "---|" * (3 + len(active)),
        ]
        for (features, _), points in fixed.items():
            for point in points:
                level = float(np.median(point.values))
                needed = [_needed(campaign, level) for campaign in active.values()]
                lines.append(_row([features, str(point.simulations), f"{level:.4f}", *needed]))
        lines += [
            "",
            "And how many a static Latin hypercube needs for the accuracy that a campaign ends with:",
            "",
            _row(["campaign", "simulations", "accuracy", *(f"static, {f}" for f, _ in fixed)]),
            "|" + "---|" * (3 + len(fixed)),
        ]
        for (features, sampling), points in active.items():
            level = float(np.median(points[-1].values))
            needed = [_needed(static, level) for static in fixed.values()]
            lines.append(_row([f"{sampling}, {features}", str(points[-1].simulations), f"{level:.4f}", *needed]))
    return "\n".join([*lines, "", "![Learning curves](accuracy.svg)", ""])


def comparison_lines(scores: list[Score]) -> list[str]:
    """The gist for a terminal: medians of accuracy, accuracy near the boundary and log score."""
    shown = ("accuracy", "accuracy_near", "log_score")
    found = {name: curves(scores, name) for name in shown}
    lines = [f"{'features':<12} {'sampling':<10} {'simulations':>11}" + "".join(f" {MEASURES[n]:>18}" for n in shown)]
    for (features, sampling), points in found["accuracy"].items():
        for place, point in enumerate(points):
            medians = (float(np.median(found[name][features, sampling][place].values)) for name in shown)
            cells = "".join(f" {median:>18.4f}" for median in medians)
            lines.append(f"{features:<12} {sampling:<10} {point.simulations:>11}{cells}")
    return lines


def write_comparison(plan: Plan, scores: list[Score], out: Path) -> Path:
    """Write `comparison.md`, `scores.csv` and the curves (SVG, PNG) into the folder; the page's path."""
    names = list(scores[0].measures)
    with writing(out / "scores.csv", ["features", "sampling", "seed", "simulations", *names]) as write:
        write(
            [
                [row.arm.features, row.arm.sampling, row.arm.seed, row.simulations, *(row.measures[n] for n in names)]
                for row in scores
            ]
        )
    boundary = plan.settings.acquisition.main_boundary
    about = f"Lines: medians over {plan.seeds} seeds; bands: least to largest; {plan.test} shared fresh designs"
    for measure, label in (
        ("accuracy", f"accuracy for {boundary} on fresh designs"),
        ("log_score", f"mean log probability of the true side of {boundary} [nat]"),
    ):
        figure = plot_sampling_curves(curves(scores, measure), label, about)
        for suffix in ("svg", "png"):
            save_figure(figure, out / f"{measure}.{suffix}")
    page = out / "comparison.md"
    with replacing(page) as file:
        file.write(comparison_text(plan, scores))
    return page
