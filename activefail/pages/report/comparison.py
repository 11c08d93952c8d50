"""The page of a comparison over seeds: tables of all measures, learning curves, and equivalent static designs."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from activefail.analyses.comparison.measures import DISPLACEMENT, NEIGHBOURS
from activefail.analyses.comparison.seeds import (
    STATIC,
    ArmScore,
    ComparisonPlan,
    Point,
    compare_seeds,
    curves,
    simulations_to_reach,
)
from activefail.pages.figures.curves import plot_sampling_curves
from activefail.pages.report.analyses import write_folder
from activefail.pages.report.environment import markdown_environment
from activefail.record.layout import SCORES
from activefail.text.csv_table import Target, writing
from activefail.text.files import writing_to

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


Curves = dict[tuple[str, str], list[Point]]
"""Points of a measure by features and sampling."""


def _measured(by_measure: dict[str, Curves]) -> list[list[str]]:
    """A row for each sampling and number of simulations: the measures."""
    return [
        [*key, str(point.simulations), *(_range(points_by_key[key][index]) for points_by_key in by_measure.values())]
        for key, points in by_measure["accuracy"].items()
        for index, point in enumerate(points)
    ]


def _to_reach(levels: Curves, others: Curves) -> list[list[str]]:
    """A row for each point of some curves: the simulations with which each other curve reaches its accuracy."""
    rows = []
    for key, points in levels.items():
        for point in points:
            level = float(np.median(point.values))
            needed = [_needed(other, level) for other in others.values()]
            rows.append([_title(*key), str(point.simulations), f"{level:.4f}", *needed])
    return rows


def _title(features: str, sampling: str) -> str:
    return f"{sampling}, {features}"


def _titles(names: list[str], boundary: str) -> dict[str, str]:
    """Column titles of all measures: those of `MEASURES`, of the other boundaries, and of the outcomes."""
    main = {*MEASURES, f"accuracy_{boundary}"}
    others = [name.removeprefix("accuracy_") for name in names if name.startswith("accuracy_") and name not in main]
    recalls = [name.removeprefix("recall_of_") for name in names if name.startswith("recall_of_")]
    titles = MEASURES | {f"accuracy_{name}": f"accuracy, {name} boundary" for name in others}
    return titles | {f"recall_of_{name}": f"recall of {name}" for name in recalls}


def comparison_text(plan: ComparisonPlan, scores: list[ArmScore]) -> str:
    """The page as Markdown."""
    boundary = plan.settings.acquisition.main_boundary
    titles = _titles(list(scores[0].measures), boundary)
    by_measure = {name: curves(scores, name) for name in titles}
    active, fixed = (
        {key: points for key, points in by_measure["accuracy"].items() if (key[1] == STATIC) == static}
        for static in (False, True)
    )
    return (
        markdown_environment()
        .get_template("comparison.md.j2")
        .render(
            plan=plan,
            boundary=boundary,
            targets=plan.settings.acquisition.boundaries,
            neighbours=NEIGHBOURS,
            displacement=DISPLACEMENT,
            titles=list(titles.values()),
            measured=_measured(by_measure),
            campaigns=[_title(*key) for key in active],
            hypercubes=[_title(*key) for key in fixed],
            to_reach=_to_reach(fixed, active) if active else [],
            to_match=_to_reach({key: points[-1:] for key, points in active.items()}, fixed),
        )
    )


def comparison_json(plan: ComparisonPlan, scores: list[ArmScore]) -> dict[str, object]:
    """The comparison as JSON: every score, and the spread of each measure over the seeds (docs/reference/json.md)."""
    spreads: dict[tuple[str, str, int], dict[str, object]] = {}
    for name in scores[0].measures:
        for (features, sampling), points in curves(scores, name).items():
            for point in points:
                values = point.values[~np.isnan(point.values)]
                of_seeds = (np.median(values), values.min(), values.max()) if len(values) else (np.nan,) * 3
                spread = dict(zip(("median", "lowest", "highest"), map(float, of_seeds), strict=True))
                spreads.setdefault((features, sampling, point.simulations), {})[name] = spread
    return {
        "boundary": plan.settings.acquisition.main_boundary,
        "test_designs": plan.test,
        "scores": [
            {
                "features": score.arm.features,
                "sampling": score.arm.sampling,
                "seed": score.arm.seed,
                "simulations": score.simulations,
                "measures": score.measures,
            }
            for score in scores
        ],
        "over_seeds": [
            {"features": features, "sampling": sampling, "simulations": simulations, "measures": measures}
            for (features, sampling, simulations), measures in spreads.items()
        ],
        "interval": None,
        "interval_reason": "The lowest and highest values show how much seeds differ; there is no interval.",
    }


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


@dataclass(frozen=True)
class ComparedOverSeeds:
    """A comparison over seeds: its plan, the scores of its arms, and its page."""

    plan: ComparisonPlan
    scores: list[ArmScore]
    page: Path

    exit_code = 0

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        return [*comparison_lines(self.scores), f"page       {self.page}"]

    def as_json(self) -> dict[str, object]:
        """The findings as JSON values."""
        return comparison_json(self.plan, self.scores) | {"page": str(self.page)}


def run_comparison(
    plan: ComparisonPlan,
    out: Path,
    jobs: int | None = None,
    stage: Callable[[str], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> ComparedOverSeeds | None:
    """Score the arms of a comparison and write its page; None if stopped, with the scores so far saved.

    Args:
        plan: the comparison.
        out: its folder.
        jobs: parallel arms; None uses all cores.
        stage: called with each stage of the work.
        stop: whether to stop.

    Raises:
        InputError: as `compare_seeds` does, or if the folder cannot be written.
        SimulationError: if a worker process dies.
    """
    with writing_to(out):
        scores = compare_seeds(
            plan,
            out,
            jobs or os.cpu_count() or 1,
            stage,
            lambda done, total: stage(f"{done} of {total} campaigns and static designs scored"),
            stop,
        )
        return None if scores is None else ComparedOverSeeds(plan, scores, write_comparison(plan, scores, out))


def write_comparison(plan: ComparisonPlan, scores: list[ArmScore], out: Path) -> Path:
    """Write `comparison.md`, `scores.csv` and the curves (SVG, PNG) into the folder; returns the page's path."""
    boundary = plan.settings.acquisition.main_boundary
    about = f"Lines: medians over {plan.seeds} seeds; bands: minimum to maximum; {plan.test} fresh designs"
    labels = {
        "accuracy": f"accuracy for {boundary} on fresh designs",
        "log_score": f"mean log probability of the true side of {boundary} [nat]",
    }
    figures = {name: plot_sampling_curves(curves(scores, name), label, about) for name, label in labels.items()}
    files: dict[str, str | Callable[[Path], None]] = {
        SCORES: partial(_write_scores, scores),
        "comparison.md": comparison_text(plan, scores),
    }
    write_folder(out, files, figures)
    return out / "comparison.md"


def _write_scores(scores: list[ArmScore], target: Target) -> None:
    names = list(scores[0].measures)
    with writing(target, ["features", "sampling", "seed", "simulations", *names]) as write:
        write(
            [
                [row.arm.features, row.arm.sampling, row.arm.seed, row.simulations, *(row.measures[n] for n in names)]
                for row in scores
            ]
        )
