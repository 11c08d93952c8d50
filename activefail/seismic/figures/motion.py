"""Figures of one simulated bearing: its response over time; forces and gaps come from the kernels.

Importing this module imports matplotlib, but not pyplot, so that any thread can draw.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from activefail.pages.figures import style
from activefail.seismic.bearing import Accelerogram, Response
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.motion import Motion, describe_design, describe_outcome, minus
from activefail.space.space import Array


@style.styled()
def plot_response(response: Response) -> Figure:
    """Displacement, ground acceleration, uplift, tilt and rim force over time, and the hysteresis loop.

    Raises:
        InputError: if the response holds no motion.
    """
    motion = Motion(response)
    t = motion.fine_times()
    q = motion.position(t)
    gaps, rims = motion.contacts(t)
    figure = titled_figure(response, width=10.5, height=8.4)
    (shift, ground), (uplift, tilt), (rim, loop) = figure.subplots(3, 2)
    _plot_displacement(shift, motion, t, q)
    _plot_ground(ground, motion, t)
    _plot_uplift(uplift, motion, t, gaps)
    _plot_tilt(tilt, motion, t, q)
    _plot_rim_force(rim, t, rims / (motion.system.plate_mass * GRAVITY))
    for panel in (shift, ground, uplift, tilt, rim):
        mark_events(panel, response)
        panel.set_xlim(motion.start, motion.end + 0.01 * (motion.end - motion.start))
        panel.set_xlabel(motion.time_label)
    _zoom_on_failure(response, (uplift, tilt, rim))
    _legend_above(ground)
    _plot_loop(loop, motion, t, q)
    return figure


@style.styled()
def plot_histories(response: Response, width: float = 5.2) -> Figure:
    """Displacement, ground acceleration, uplift and tilt from the start of the motion, one above the other.

    The four axes share the time axis and their horizontal position.

    Args:
        response: with its motion.
        width: of the figure [inch].

    Raises:
        InputError: if the response holds no motion.
    """
    motion = Motion(response)
    t = motion.fine_times()
    q = motion.position(t)
    figure = Figure(figsize=(width, 6.6), layout="constrained")
    shift, ground, uplift, tilt = panels = figure.subplots(4, 1, sharex=True)
    _plot_displacement(shift, motion, t, q)
    _plot_ground(ground, motion, t)
    _plot_uplift(uplift, motion, t, motion.contacts(t)[0])
    _plot_tilt(tilt, motion, t, q)
    labels = ("Displacement [m]", "Ground [g]", "Gap [mm]", "Tilt [°]")
    for panel, label in zip(panels, labels, strict=True):
        mark_events(panel, response)
        # A narrow figure has no room for titles next to the legend.
        panel.set(title="", ylabel=label)
    _legend_above(ground)
    tilt.set_xlim(motion.onset, motion.end + 0.01 * (motion.end - motion.onset))
    tilt.set_xlabel(motion.time_label)
    figure.align_ylabels()
    return figure


PLATE_LINES: tuple[dict[str, Any], ...] = (
    {"label": "bottom plate", "color": style.BLUE, "linestyle": "-"},
    {"label": "top plate", "color": style.ORANGE, "linestyle": (0, (4, 1.5))},
)
"""Line styles of curves for the two plates."""

LIMIT_LINE: dict[str, Any] = {"color": style.GREY, "linestyle": "--", "linewidth": 1.0}
"""Line style of limits."""


def titled_figure(response: Response, width: float, height: float) -> Figure:
    """An empty figure of this size [inch] with the outcome and the design as title."""
    figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(rect=(0.0, 0.0, 1.0, 1.0 - 0.58 / height)))
    FigureCanvasAgg(figure)
    colour = {"failure": style.VERMILION, "numerical_failure": style.GREY}.get(response.outcome_name, style.BLACK)
    lines: tuple[tuple[float, str, float, dict[str, Any]], ...] = (
        (0.19, describe_outcome(response), min(12.0, 1.3 * width), {"weight": "bold", "color": colour}),
        (0.44, describe_design(response), min(8.5, width), {}),
    )
    for down, text, size, look in lines:
        title = figure.text(0.5, 1.0 - down / height, text, ha="center", va="center", fontsize=size, **look)
        # A record has a name, which may be long.
        room = 0.98 * figure.bbox.width / title.get_window_extent().width
        title.set_fontsize(size * min(1.0, room))
    return figure


def mark_events(axes: Axes, response: Response) -> None:
    """Mark the first rim touch and the failure, if any, on a time axis."""
    touch, failure = response.margins.first_touch_time, response.margins.failure_time
    if math.isfinite(touch):
        axes.axvline(touch, color=style.PURPLE, linestyle=":", linewidth=1.5, label="first rim touch")
    if math.isfinite(failure):
        axes.axvline(failure, color=style.VERMILION, linewidth=1.2, label="failure")


def plot_plates(axes: Axes, t: Array, values: Array) -> None:
    """Plot a curve for each of the two plates, (n, 2)."""
    for side, line in enumerate(PLATE_LINES):
        axes.plot(t, values[:, side], **line)


def mark_limits(draw: Callable[..., object], value: float, label: str) -> None:
    """Draw lines at a limit and at its negative."""
    draw(value, **LIMIT_LINE, label=label)
    draw(-value, **LIMIT_LINE)


def _zoom_on_failure(response: Response, panels: Sequence[Axes]) -> None:
    """Limit the time axis to the last moments if the failure soon follows the first rim touch; add this to titles."""
    duration = response.margins.failure_time - response.margins.first_touch_time
    if not duration < 0.2 * (response.t[-1] - response.t[0]):
        return
    for panel in panels:
        panel.set_xlim(response.margins.first_touch_time - 0.5 * duration, response.t[-1] + 0.02 * duration)
        panel.set_title(f"{panel.get_title(loc='left')} (last {1.5 * duration:.2f} s)")


def _legend_above(axes: Axes) -> None:
    """Put the legend next to the panel's title, where it hides no curve."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.01, 0.98), ncols=4, columnspacing=1.0, handlelength=1.8)


def _plot_displacement(axes: Axes, motion: Motion, t: Array, q: Array) -> None:
    capacity = motion.response.bearing.displacement_capacity
    axes.plot(t, q[:, 3], color=style.ORANGE, label="top plate $x_t$")
    axes.plot(t, q[:, 0], color=style.BLACK, linewidth=1.0, label="slider $x_s$")
    mark_limits(axes.axhline, capacity, r"capacity $\pm D_{tot}$")
    axes.set(title="Displacement", ylabel="Displacement [m]")
    _legend_above(axes)


def _plot_ground(axes: Axes, motion: Motion, t: Array) -> None:
    record = motion.response.pulse
    if isinstance(record, Accelerogram) and record.vertical is not None:
        up = replace(record, acceleration=record.vertical).at(t)
        axes.plot(t, up / GRAVITY, color=style.SKY_BLUE, linewidth=0.9, label="vertical")
    axes.plot(t, motion.ground(t) / GRAVITY, color=style.BLACK, label="horizontal" if axes.lines else None)
    # A shorter title leaves room for the longer legend.
    axes.set(title="Ground" if len(axes.lines) > 1 else "Ground motion", ylabel="Ground acceleration [g]")


def _plot_uplift(axes: Axes, motion: Motion, t: Array, gaps: Array) -> None:
    plot_plates(axes, t, 1e3 * gaps)
    axes.axhline(1e3 * motion.response.bearing.rim_height, **LIMIT_LINE, label="rim height $h_{rim}$")
    axes.axhline(0.0, color=style.BLACK, linewidth=0.6)
    axes.set(title="Uplift", ylabel="Confinement gap [mm]\n(< 0: contact compressed)")
    _legend_above(axes)


def _plot_tilt(axes: Axes, motion: Motion, t: Array, q: Array) -> None:
    limit = math.degrees(math.atan2(motion.system.half_width, motion.system.half_height))
    axes.plot(t, np.degrees(q[:, 2]), color=style.BLACK)
    mark_limits(axes.axhline, limit, "overturning limit")
    axes.set(title="Tilt of the slider", ylabel="Tilt, counter-clockwise [°]")
    _legend_above(axes)


def _plot_rim_force(axes: Axes, t: Array, ratios: Array) -> None:
    plot_plates(axes, t, ratios)
    axes.set(title="Force on the rim", ylabel="Rim force / $Mg$ [-]")
    axes.set_ylim(0.0, max(1.08 * float(ratios.max()), 0.1))
    if not ratios.any():
        axes.text(0.5, 0.5, "no rim contact", transform=axes.transAxes, ha="center", color=style.GREY)
    _legend_above(axes)


def _plot_loop(axes: Axes, motion: Motion, t: Array, q: Array) -> None:
    """Plot the hysteresis loop: the resisting force, hence the minus, which rises with the displacement."""
    response = motion.response
    force = -motion.force_ratio(t)
    axes.plot(q[:, 3], force, color=style.BLUE, linewidth=1.0)
    capacity = response.bearing.displacement_capacity
    mark_limits(axes.axvline, capacity, r"capacity $\pm D_{tot}$")
    axes.set(title="Hysteresis loop", xlabel="Displacement of the top plate $x_t$ [m]")
    axes.set_ylabel(r"Force $-M(\ddot{x}_t + \ddot{u}_g)/Mg$ [-]")
    # Impact forces are many times those of sliding; the axis is scaled to the loop.
    touch = response.margins.first_touch_time
    shown = 2.0 * float(np.abs(force[t < touch]).max()) if math.isfinite(touch) else math.inf
    peak = float(force[np.abs(force).argmax()])
    if abs(peak) > shown:
        axes.set_ylim(-shown, shown)
        axes.set_title(f"Hysteresis loop (impacts cut off, peak {minus(f'{peak:.1f}')})")
    _legend_above(axes)
