"""Drawings of incremental dynamic analyses: the records that have failed against intensity."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtr

from activefail.pages.figures.axes import legend_outside, panel
from activefail.pages.figures.risk import SIZE
from activefail.pages.figures.style import BLACK, BLUE, GREY, VERMILION, styled
from activefail.seismic.ida.collapse import Fragility
from activefail.seismic.ida.findings import IdaFindings
from activefail.text.quantities import Quantity, custom_quantity, plain


@styled()
def plot_ida(findings: IdaFindings) -> Figure:
    """The share of records that have failed against the intensity, the lognormal curve, and its median's interval."""
    figure, axes = panel(*SIZE)
    levels, share = findings.empirical
    axes.step(
        [0.0, *levels, findings.highest],
        [0.0, *share, share[-1] if len(share) else 0.0],
        where="post",
        color=BLACK,
        linewidth=1.2,
        label="share of records",
    )
    if findings.options is not None:
        axes.axvline(findings.options.mce, color=GREY, linestyle="-.", label="maximum considered earthquake")
    variable = custom_quantity(findings.intensity.name, findings.intensity.unit)
    _draw_fit(axes, findings.fragility, (0.0, findings.highest), variable, findings.event)
    axes.set_title(f"{len(findings.capacities.capacity)} records from {findings.records.events} events", fontsize=9)
    legend_outside(figure)
    return figure


def _draw_fit(axes: Axes, fit: Fragility | None, ends: tuple[float, float], variable: Quantity, event: str) -> None:
    """A lognormal curve, if there is one, with the interval of its median; and the axes."""
    if fit is not None:
        x = np.linspace(max(ends[0], 1e-3 * ends[1]), ends[1], 400)
        curve = ndtr(np.log(x / fit.fit.median) / fit.fit.dispersion)
        axes.plot(x, curve, color=VERMILION, linestyle="--", label="lognormal fit")
        if fit.median:
            axes.plot(fit.median, [0.5, 0.5], color=BLUE, linewidth=3.0, label="median, 95 % interval")
    axes.set(xlabel=variable.axis, ylabel=f"probability of {plain(event)} [–]", xlim=ends, ylim=(-0.02, 1.02))
