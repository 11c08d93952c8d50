"""The reproduction page: the paper's results compared with activefail's, as Markdown with SVG and PNG figures."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.stats import binomtest

from activefail.pages.figures.classifier import plot_reliability
from activefail.pages.report.analyses import write_folder
from activefail.pages.report.environment import markdown_environment
from activefail.seismic.bearing.design import GRAVITY, Model
from activefail.seismic.bearing.pulse import HALF_DURATION, ground_acceleration
from activefail.seismic.features import PAPER_FEATURES
from activefail.seismic.figures.paper_planes import FIGURES, SLICE, plot_plane
from activefail.seismic.ida.sample_mean import Estimate, contains
from activefail.seismic.paper import claims, published
from activefail.seismic.paper import study as paper
from activefail.seismic.paper.claims import (
    CONCLUSIONS,
    NOT_REPRODUCED,
    named,
    named_with_shares,
    percent_of,
    span,
    with_mean,
)
from activefail.seismic.paper.methods import LENGTH_SCALE
from activefail.seismic.paper.published import Table2Row
from activefail.seismic.paper.study import METHODS, Draw, Study, Variant
from activefail.space.space import Array
from activefail.text.files import writing_to

TITLES = {
    "laplace": "Laplace",
    "ep": "expectation propagation",
    "variational": "variational, the paper's features",
    "variational_log": "variational, ratios by their logarithm (the campaign's)",
}
_CAPTIONS = {
    "figure3": "The failure boundary in the plane of period ratio and pulse displacement, at three values of friction "
    "over the pulse's amplitude.",
    "figure4": "The same in the plane of friction and pulse displacement, at three ratios of bearing to pulse period.",
    "figure5": "The same in the plane of friction and period ratio, at three pulse displacements.",
}


def _p(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.2g}" if value < 0.1 else f"{value:.2f}"


def _percent(share: float, digits: int = 0) -> str:
    return f"{100 * share:.{digits}f} %"


def _significant(value: float) -> str:
    """Three significant digits, without a power of ten."""
    return np.format_float_positional(value, precision=3, fractional=False, trim="-")


def _with_one_sample(values: Array) -> str:
    """The mean with the 95 % prediction interval of one sample."""
    estimate = Estimate.over(values)
    return f"{_significant(estimate.mean)} ({_significant(estimate.of_one[0])} to {_significant(estimate.of_one[1])})"


def _has_printed_bounds(row: Table2Row, published_range: str) -> bool:
    """Whether the published range equals the attainable range of Table 1, to rounding."""
    return np.allclose([float(part) for part in published_range.split(" to ")], row.attainable, rtol=1e-3)


def _is_explained(row: Table2Row, published_median: float) -> bool:
    """Whether the published median lies in the interval of a tilted sample but not of a uniform one."""
    uniform, tilted = (Estimate.over(values).of_one for values in (row.median, row.tilted))
    return contains(tilted, published_median, 0.005) and not contains(uniform, published_median, 0.005)


def table_2(X: Array) -> list[dict[str, str]]:
    """The rows of the page's Table 2 from the designs of the draws, (draws, 250, 9)."""
    return [
        {
            "name": row.name,
            "paper_range": paper_range,
            "attainable": f"{_significant(row.attainable[0])} to {_significant(row.attainable[1])}",
            "range": f"{_significant(np.median(row.low))} to {_significant(np.median(row.high))}",
            "ranges": f"{_significant(row.low.min())}…{_significant(row.low.max())} to "
            f"{_significant(row.high.min())}…{_significant(row.high.max())}",
            "paper_median": f"{paper_median:g}",
            "si": _significant(float(row.median.mean()) / row.factor),
            "median": _with_one_sample(row.median),
            "tilted": _with_one_sample(row.tilted),
        }
        for (paper_range, paper_median), row in zip(published.TABLE_2, published.table_2(X), strict=True)
    ]


def _p_values(study: Study) -> list[dict[str, str]]:
    rows: list[dict[str, str]] = [{"name": name} for name in PAPER_FEATURES]
    for boundary, theirs in published.P_VALUES.items():
        medians = paper.median_p_values(study.draws, boundary)
        shares = paper.significant_share(study.draws, boundary)
        for row, printed, median, share in zip(rows, theirs, medians, shares, strict=True):
            row[f"{boundary}_paper"], row[boundary] = _p(printed), _p(median)
            row[f"{boundary}_share"] = percent_of(share, len(study.draws))
    return rows


def _process(draws: list[Draw], method: str) -> dict[str, str]:
    def of(name: str) -> Array:
        return claims.process(draws, method, name)

    low, high = Estimate.over(of("calibration_slope")).of_mean
    caution = "underconfident" if low > 1.0 else "overconfident" if high < 1.0 else "neither over- nor underconfident"
    return {
        "title": TITLES[method],
        "held_out": with_mean(of("held_out"), share=True),
        "fresh": with_mean(of("fresh"), share=True),
        "gain": with_mean(100 * claims.fresh_gain(draws, method), 1),
        "log_score": with_mean(of("log_score")),
        "error": with_mean(of("calibration_error"), share=True),
        "slope": with_mean(of("calibration_slope"), 2),
        "caution": caution,
        "unconverged": str(int(np.sum(of("converged") == 0))),
    }


def _length_scales(study: Study) -> list[dict[str, Any]]:
    def cell(method: str, i: int) -> str:
        lengths = claims.process(study.draws, method, "length_scales")[:, i]
        off = claims.process(study.draws, method, "switched_off")[:, i]
        # A median at the bound is only a lower limit.
        mark = "> " if np.mean(off) > 0.5 else ""
        return f"{mark}{_significant(float(np.median(lengths)))}" + (f" ({int(off.sum())})" if off.any() else "")

    return [{"name": name, "lengths": [cell(method, i) for method in METHODS]} for i, name in enumerate(PAPER_FEATURES)]


def _length_ratios(study: Study) -> str:
    texts = []
    for method in METHODS:
        ratios = claims.length_ratio(study.draws, method)
        middle = f"{_significant(np.quantile(ratios, 0.25))} to {_significant(np.quantile(ratios, 0.75))}"
        texts.append(
            f"{TITLES[method]} {_significant(float(np.median(ratios)))} (half of the samples: {middle}), "
            f"10 or more in {_percent(float(np.mean(ratios >= 10.0)))}"
        )
    return "; ".join(texts)


def _variant(variant: Variant) -> dict[str, Any]:
    draws = variant.draws
    # One split of each draw, the same in every variant.
    first_split = claims.held_out(draws)[:, 0]
    return {
        "name": variant.name,
        "moved": "–" if variant.moved is None else _percent(variant.moved, 1),
        "shares": " / ".join(f"{100 * share:.0f}" for share in variant.data.shares) + " %",
        "impact": with_mean(claims.logistic(draws, "impact", "in_sample"), share=True),
        "failure": with_mean(claims.logistic(draws, "failure", "in_sample"), share=True),
        "held_out": with_mean(first_split, share=True),
        "fresh": with_mean(claims.process(draws, "laplace", "fresh"), share=True),
        "gain": with_mean(100 * claims.fresh_gain(draws), 1),
        "papers_gain": with_mean(100 * claims.papers_gain(draws)[:, 0], 1),
        "impact_features": named_with_shares(draws, "impact"),
        "failure_features": named_with_shares(draws, "failure"),
        "hold": ["yes" if holds(draws) else "**no**" for holds in CONCLUSIONS.values()],
    }


def _moving(study: Study) -> list[str]:
    """A sentence for each conclusion: the choices that overturn it."""
    sentences = []
    for conclusion, holds in CONCLUSIONS.items():
        against = [variant.name for variant in study.variants if not holds(variant.draws)]
        sentences.append(f"{conclusion}: " + (f"not under {'; '.join(against)}." if against else "under every choice."))
    return sentences


def _peak_displacement() -> float:
    """Peak displacement of the pulse over A_p·(T_p/2π)², by integrating the acceleration twice."""
    # Twice the span of a simulation: the pulse has decayed at both ends.
    t = np.linspace(-2.0 * HALF_DURATION, 2.0 * HALF_DURATION, 20_001)
    acceleration = np.array([ground_acceleration(instant, (2.0 * np.pi) ** 2, 1.0) for instant in t])
    velocity = cumulative_trapezoid(acceleration, t, initial=0.0)
    return float(np.abs(cumulative_trapezoid(velocity, t, initial=0.0)).max())


def _table_2_numbers(study: Study) -> dict[str, Any]:
    rows = published.table_2(study.data.X)
    return {
        "table2": table_2(study.data.X),
        "low_mu": int(np.sum(rows[2].median <= published.TABLE_2[2][1])),
        "low_h": int(np.sum(rows[3].median <= published.TABLE_2[3][1])),
        "paper_mu": published.TABLE_2[2][1],
        "paper_h": published.TABLE_2[3][1],
        "medians_outside": named(claims.medians_outside(study)),
        "explained": named([i for i, row in enumerate(rows) if _is_explained(row, published.TABLE_2[i][1])]),
        "printed_bounds": named([i for i, row in enumerate(rows) if _has_printed_bounds(row, published.TABLE_2[i][0])]),
        "d_ratio_factor": _significant(1.0 / rows[0].factor),
        "k_norm_factor": _significant(1.0 / rows[5].factor),
    }


def _logistic(draws: list[Draw], boundary: str) -> dict[str, Any]:
    def of(name: str) -> Array:
        return claims.logistic(draws, boundary, name)

    return {
        "boundary": boundary,
        "paper": f"{published.LOGISTIC[boundary]:.2f}",
        "in_sample": with_mean(of("in_sample"), share=True),
        "one": span(Estimate.over(of("in_sample")).of_one, share=True),
        "fresh": with_mean(of("fresh"), share=True),
        "separated": int(np.sum(of("separated"))),
        "without": int(np.sum(np.isnan(of("p_values")).any(axis=1))),
    }


def _significant_features(draws: list[Draw], boundary: str) -> dict[str, Any]:
    ours, theirs = claims.majority(draws, boundary), claims.papers_significant(boundary)
    return {"ours": named(ours), "paper": named(theirs), "same": ours == theirs}


def _process_numbers(study: Study) -> dict[str, Any]:
    draws, quarter = study.draws, _quarter(study)
    held_out = claims.held_out(draws)
    papers_interval = binomtest(round(published.HELD_OUT * quarter), quarter).proportion_ci(method="exact")
    gain, papers_gain = 100 * claims.fresh_gain(draws), 100 * claims.papers_gain(draws)

    def ep_over_laplace(name: str) -> Array:
        ep, laplace = (claims.process(draws, method, name) for method in ("ep", "laplace"))
        return ep - laplace

    return {
        "held_out_paper": f"{published.HELD_OUT:.2f}",
        "held_out_paper_interval": span((papers_interval.low, papers_interval.high), 2),
        "held_out": with_mean(held_out, share=True),
        "held_out_one": span(Estimate.over(held_out).of_one, share=True),
        "held_out_as_high": int(np.sum(held_out >= published.HELD_OUT - claims.PERCENT)),
        "held_out_number": held_out.size,
        "processes": [_process(draws, method) for method in METHODS],
        "gain": with_mean(gain, 1),
        "gain_one": span(Estimate.over(gain).of_one, 1),
        "papers_gain": with_mean(papers_gain, 1),
        "papers_gain_one": span(Estimate.over(papers_gain).of_one, 1),
        "paper_gain": f"{100 * published.GAIN:.0f}",
        "gain_as_high": int(np.sum(gain >= 100 * (published.GAIN - claims.PERCENT))),
        "ep_log_score": with_mean(ep_over_laplace("log_score")),
        "ep_accuracy": with_mean(100 * ep_over_laplace("fresh"), 2),
    }


def _quarter(study: Study) -> int:
    """Held-out designs of a draw."""
    size = int(study.data.X.shape[1])
    return size - round(paper.TRAINING_SHARE * size)


def _context(study: Study) -> dict[str, Any]:
    draws = study.draws
    lines = claims.claims(study)
    return {
        **study.command,
        "size": paper.SIZE,
        "splits": claims.held_out(draws).shape[1],
        "quarter": _quarter(study),
        "training_share": _percent(paper.TRAINING_SHARE),
        "significance": _percent(paper.SIGNIFICANCE),
        "gravity": GRAVITY,
        "slider_diameter": f"{Model().slider_diameter:.2f}",
        "peak_displacement": f"{_peak_displacement():.4f}",
        "simulations": study.data.simulations,
        "answered_fresh": int(np.sum(study.data.outcome_fresh >= 0)),
        "numerical_failures": study.data.numerical_failures,
        "claims": [line.cells for line in lines],
        "not_reproduced": [line.item for line in lines if line.verdict == NOT_REPRODUCED],
        "by_chance": [line.item for line in lines if line.verdict == claims.BY_CHANCE],
        "shares": "{:.1f} % no impact, {:.1f} % impact, {:.1f} % failure".format(*(100 * study.data.shares)),
        **_table_2_numbers(study),
        "ordered": sum(paper.orders_as_the_paper(draw.processes["laplace"]) for draw in draws),
        "significant_names": named(claims.papers_significant("failure")),
        "tilted": paper.TILTED,
        "logistic": [_logistic(draws, boundary) for boundary in published.LOGISTIC],
        "p_values": _p_values(study),
        "significant": {boundary: _significant_features(draws, boundary) for boundary in published.P_VALUES},
        **_process_numbers(study),
        "length_titles": [TITLES[method] for method in METHODS],
        "length_scales": _length_scales(study),
        "length_ratios": _length_ratios(study),
        "length_bound": f"{LENGTH_SCALE[1]:g}",
        "slice": _percent(SLICE),
        "planes": [
            {"name": one.name, "title": f"Figure {one.name[-1]}", "caption": _CAPTIONS[one.name]} for one in FIGURES
        ],
        "variants": [_variant(variant) for variant in study.variants],
        "variant_failures": sum(variant.data.numerical_failures for variant in study.variants),
        "conclusions": list(CONCLUSIONS),
        "moving": _moving(study),
        "first_sample": {
            "logistic": {name: fitted.in_sample for name, fitted in draws[0].logistic.items()},
            "p_values": {name: fitted.p_values.tolist() for name, fitted in draws[0].logistic.items()},
            "held_out": draws[0].held_out.tolist(),
        },
    }


def render(numbers: dict[str, Any]) -> str:
    """Render the page with these numbers."""
    return markdown_environment("activefail.seismic.paper").get_template("reproduction.md.j2").render(numbers)


def write_reproduction(study: Study, out: Path, stage: Callable[[str], None] = lambda _: None) -> Path:
    """Write the page `out/reproduction.md`, with figures and numbers in `out/reproduction`; returns the page's path.

    Args:
        study: the results.
        out: folder of the page.
        stage: called when drawing begins.
    """
    stage("drawing")
    trained = paper.typical_process(study)
    figures = {one.name: plot_plane(one, trained) for one in FIGURES}
    y_fresh = np.tile(study.data.outcome_fresh[study.data.outcome_fresh >= 0] == 2, len(study.draws))
    pooled = {TITLES[method]: claims.process(study.draws, method, "probability").ravel() for method in METHODS}
    figures["reliability"] = plot_reliability(pooled, y_fresh, len(study.draws))
    numbers = _context(study)
    with writing_to(out):
        text = json.dumps(numbers, indent=1, ensure_ascii=False) + "\n"
        write_folder(out / "reproduction", {"numbers.json": text}, figures)
        write_folder(out, {"reproduction.md": render(numbers)}, {})
    return out / "reproduction.md"
