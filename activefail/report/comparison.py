"""The page of a comparison over seeds: tables of all measures, learning curves, and equivalent static designs."""

from pathlib import Path

import numpy as np

from activefail.comparison.score import DISPLACEMENT, NEIGHBOURS
from activefail.comparison.seeds import STATIC, ArmScore, ComparisonPlan, Point, curves, simulations_to_reach
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
"""Column titles, by measure."""


def _range(point: Point) -> str:
    """Median, with minimum and maximum over several seeds."""
    values = point.values[~np.isnan(point.values)]
    if not len(values):
        return "–"
    text = f"{np.median(values):.4f}"
    return text if len(values) == 1 else f"{text} ({values.min():.4f} to {values.max():.4f})"


def _needed(points: list[Point], level: float) -> str:
    simulations = simulations_to_reach(points, level)
    return f"> {points[-1].simulations}" if simulations is None else f"{simulations:.0f}"


def _command(plan: ComparisonPlan) -> str:
    lists = {"criteria": plan.criteria, "features": plan.features, "static": plan.static}
    options = " ".join(f"--{name} {','.join(map(str, values))}" for name, values in lists.items())
    return f"activefail compare CAMPAIGN.toml --seeds {plan.seeds} {options} --test {plan.test} --out DIR"


def _sought(plan: ComparisonPlan) -> str:
    shares = plan.settings.acquisition.boundaries
    if len(shares) == 1:
        return next(iter(shares))
    return ", ".join(f"{name} with {share:.0%} of the active designs" for name, share in shares.items())


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def comparison_text(plan: ComparisonPlan, scores: list[ArmScore]) -> str:
    """The page as Markdown."""
    boundary = plan.settings.acquisition.main_boundary
    main = {*MEASURES, f"accuracy_{boundary}"}
    others = [name for name in scores[0].measures if name.startswith("accuracy_") and name not in main]
    titles = MEASURES | {name: f"accuracy, {name.removeprefix('accuracy_')} boundary" for name in others}
    by_measure = {name: curves(scores, name) for name in titles}
    lines = [
        f"# Samplings compared: {plan.settings.description or 'a campaign'}",
        "",
        f"Target boundary: {_sought(plan)}. Accuracy refers to the {boundary} boundary. Medians over {plan.seeds} "
        f"seeds (minimum to maximum), on the same {plan.test} fresh designs. *Near the boundary*: designs with one of "
        f"{NEIGHBOURS} copies, displaced by {DISPLACEMENT:.0%} of the ranges, on the other side. *Small regions*: "
        "designs beyond the boundary with half of these copies on the other side. Written by",
        "",
        "    " + _command(plan),
        "",
        _row(["features", "sampling", "simulations", *titles.values()]),
        "|" + "---|" * (3 + len(titles)),
    ]
    for (features, sampling), points in by_measure["accuracy"].items():
        for index, point in enumerate(points):
            cells = [_range(by_measure[name][features, sampling][index]) for name in titles]
            lines.append(_row([features, sampling, str(point.simulations), *cells]))
    accuracy = by_measure["accuracy"]
    active = {key: points for key, points in accuracy.items() if key[1] != STATIC}
    fixed = {key: points for key, points in accuracy.items() if key[1] == STATIC}
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
            "Simulations of a static Latin hypercube to reach a campaign's final accuracy:",
            "",
            _row(["campaign", "simulations", "accuracy", *(f"static, {f}" for f, _ in fixed)]),
            "|" + "---|" * (3 + len(fixed)),
        ]
        for (features, sampling), points in active.items():
            level = float(np.median(points[-1].values))
            needed = [_needed(static, level) for static in fixed.values()]
            lines.append(_row([f"{sampling}, {features}", str(points[-1].simulations), f"{level:.4f}", *needed]))
    return "\n".join([*lines, "", "![Learning curves](accuracy.svg)", ""])


def comparison_lines(scores: list[ArmScore]) -> list[str]:
    """A summary for a terminal: medians of accuracy, accuracy near the boundary and log score."""
    shown = ("accuracy", "accuracy_near", "log_score")
    by_measure = {name: curves(scores, name) for name in shown}
    lines = [f"{'features':<12} {'sampling':<10} {'simulations':>11}" + "".join(f" {MEASURES[n]:>18}" for n in shown)]
    for (features, sampling), points in by_measure["accuracy"].items():
        for index, point in enumerate(points):
            medians = (float(np.median(by_measure[name][features, sampling][index].values)) for name in shown)
            cells = "".join(f" {median:>18.4f}" for median in medians)
            lines.append(f"{features:<12} {sampling:<10} {point.simulations:>11}{cells}")
    return lines


def write_comparison(plan: ComparisonPlan, scores: list[ArmScore], out: Path) -> Path:
    """Write `comparison.md`, `scores.csv` and the curves (SVG, PNG) into the folder; returns the page's path."""
    names = list(scores[0].measures)
    with writing(out / "scores.csv", ["features", "sampling", "seed", "simulations", *names]) as write:
        write(
            [
                [row.arm.features, row.arm.sampling, row.arm.seed, row.simulations, *(row.measures[n] for n in names)]
                for row in scores
            ]
        )
    boundary = plan.settings.acquisition.main_boundary
    about = f"Lines: medians over {plan.seeds} seeds; bands: minimum to maximum; {plan.test} fresh designs"
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
