"""Capacities under records, with the fitted fragility and its interval."""

import numpy as np
from matplotlib.figure import Figure
from scipy.special import ndtr

from activefail.figures.axes import legend_outside, panel
from activefail.figures.style import BLACK, BLUE, GREY, VERMILION, styled
from activefail.risk.ida.findings import IdaFindings


@styled()
def plot_ida(findings: IdaFindings) -> Figure:
    """The share of records that have failed against the intensity, the lognormal curve, and its median's interval."""
    figure, axes = panel(6.4, 4.6)
    levels, share = findings.empirical
    axes.step(
        [0.0, *levels, findings.highest],
        [0.0, *share, share[-1] if len(share) else 0.0],
        where="post",
        color=BLACK,
        linewidth=1.2,
        label="share of records",
    )
    if (fragility := findings.fragility) is not None:
        x = np.linspace(1e-3, 1.0, 400) * findings.highest
        axes.plot(
            x,
            ndtr(np.log(x / fragility.fit.median) / fragility.fit.dispersion),
            color=VERMILION,
            linestyle="--",
            label="lognormal fit",
        )
        if fragility.median:
            axes.plot(fragility.median, [0.5, 0.5], color=BLUE, linewidth=3.0, label="median, 95 % interval")
    if findings.options is not None:
        axes.axvline(findings.options.mce, color=GREY, linestyle="-.", label="maximum considered earthquake")
    unit = f" [{findings.intensity.unit}]" if findings.intensity.unit else ""
    worse = "" if findings.is_of_worst else " or worse"
    axes.set(
        xlabel=f"{findings.intensity.name}{unit}",
        ylabel=f"probability of {findings.outcome}{worse} [–]",
        xlim=(0.0, findings.highest),
        ylim=(-0.02, 1.02),
    )
    axes.set_title(f"{len(findings.capacities.capacity)} records from {findings.records.events} events", fontsize=9)
    legend_outside(figure)
    return figure
