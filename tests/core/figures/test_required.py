"""The chart of required values: each design is in the legend once, single values are visible, nothing overlaps."""

import numpy as np

from activefail.analyses.design.required_chart import RequiredChart
from activefail.pages.figures.risk import Mark, plot_required
from activefail.text.quantities import Quantity, custom_quantity

SHOWN = {
    "D_tot": Quantity("D_tot", "$D_{tot}$", "D_tot", "m", "displacement capacity"),
    "T_b": Quantity("T_b", "$T_b$", "T_b", "s", "period"),
    "mu": Quantity("mu", r"$\mu$", "μ", "", "friction coefficient"),
}


def chart(targets: int = 3, name: str = "mu") -> RequiredChart:
    required = np.full((targets, 3, 4), np.nan)
    required[:, 0] = [0.5, 0.6, 0.7, 0.8]
    required[:, 1, 0] = 0.7
    x, values = np.array([2.0, 3.0, 4.0, 5.0]), np.array([0.1, 0.06, 0.03])
    return RequiredChart("D_tot", "T_b", name, x, values, np.array([0.1, 0.05, 0.025][:targets]), "failure", required)


def test_a_chart_needs_no_design():
    figures = plot_required(chart(), SHOWN)
    assert list(figures) == ["required_10", "required_5", "required_2.5"]
    titles = [figure.axes[0].get_title(loc="left") for figure in figures.values()]
    assert titles == [f"P(failure) ≤ {p} %" for p in ("10", "5", "2.5")]
    assert len({(figure.axes[0].get_xlim(), figure.axes[0].get_ylim()) for figure in figures.values()}) == 1


def test_an_empty_panel_says_why_in_a_line_that_it_holds():
    made = chart()
    made.required[2] = np.nan
    figures = list(plot_required(made, SHOWN).values())
    assert [[text.get_text().replace("\n", " ") for text in figure.axes[0].texts] for figure in figures] == [
        [],
        [],
        ["no $D_{tot}$ in its range meets this target"],
    ]
    figures[2].draw_without_rendering()
    panel = figures[2].axes[0]
    why, frame = panel.texts[0].get_window_extent(), panel.get_window_extent()
    assert frame.x0 <= why.x0 <= why.x1 <= frame.x1


def test_every_design_is_in_the_figure_of_its_target_and_once_in_its_legend():
    marks = [
        Mark(3.5, 0.6, None, 0.05, "other look"),
        Mark(3.5, 0.65, 0.1, 0.05, "verified"),
        Mark(3.5, 0.75, 0.1, 0.025, "verified"),
    ]
    figures = plot_required(chart(), SHOWN, marks).values()
    labels = [[text.get_text() for text in figure.legends[0].get_texts()] for figure in figures]
    # No value of the third line meets a target.
    lines = ["$\\mu$ = 0.1", "$\\mu$ = 0.06", "$\\mu$ = 0.03: none"]
    verified = "verified: $\\mu$ = 0.1"
    assert labels == [lines, [*lines, "other look", verified], [*lines, verified]]
    assert [len(figure.axes[0].lines) for figure in figures] == [3, 5, 4]


def test_a_line_with_a_single_value_has_a_marker():
    for line in plot_required(chart(), SHOWN)["required_10"].axes[0].lines:
        assert line.get_marker() not in ("None", ".", "")
        assert line.get_markersize() >= 3


def test_a_wide_legend_takes_more_rows_and_covers_no_panel():
    name = "a_variable_with_quite_a_long_name"
    shown = SHOWN | {name: custom_quantity(name)}
    (figure,) = plot_required(chart(1, name), shown, [Mark(3.5, 0.65, 0.1, 0.1, "not verified")]).values()
    figure.draw_without_rendering()
    legend, panel = figure.legends[0].get_window_extent(), figure.axes[0].get_tightbbox()
    assert panel is not None
    assert legend.y1 <= panel.y0
    assert legend.x0 >= 0.0
    assert legend.x1 <= figure.bbox.x1
