"""Figures of one simulated bearing: its response over time, and its bodies to scale at an instant.

All lengths are in the frame of the bottom plate, as in `seismic.bearing`; forces and gaps come from its kernels.
Importing this module imports matplotlib, but not pyplot, so that any thread can draw.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Polygon

from activefail.pages.figures import style
from activefail.seismic.bearing import Accelerogram, Bearing, Response
from activefail.seismic.bearing.contact import gap, meets_rim
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.dynamics import lever, seen_by_plate
from activefail.seismic.bearing.motion import Motion, describe_design, describe_outcome, instants, minus, seconds
from activefail.space.space import Array

ARC_POINTS = 41
"""Points of a polygon along a spherical surface; the chords are within 0.1 mm of the arc."""

PLATE_THICKNESS = 0.15
"""Drawn thickness of the plates below their apex / D_sl; the model's plates have none."""

RIM_WIDTH = 0.12
"""Drawn width of the rims / D_sl; the model's rims are walls."""

FOOTNOTE = (
    "To scale, in the frame of the bottom plate. Bodies overlap where a contact spring is compressed; "
    "the model's plates never touch."
)
"""The note on the drawn bodies."""


# ---------------------------------------------------------------------------------------------------- over time


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


# ---------------------------------------------------------------------------------------------------- the bodies


def slider_outline(bearing: Bearing) -> Array:
    """Outline of the slider relative to its centre, shape (2 ARC_POINTS, 2) [m].

    Bottom arc from left to right, then top arc from right to left, both of radius R. Rows 0, ARC_POINTS − 1, ARC_POINTS
    and −1 are the vertices at the bottom left, bottom right, top right and top left.
    """
    half_width, half_height = bearing.slider_diameter / 2.0, bearing.slider_height / 2.0
    x = np.linspace(-half_width, half_width, ARC_POINTS)
    bulge = np.sqrt(bearing.radius**2 - x**2) - math.sqrt(bearing.radius**2 - half_width**2)
    bottom = np.column_stack((x, -half_height - bulge))
    return np.vstack((bottom, -bottom))


def plate_outline(bearing: Bearing, rims: bool = True) -> Array:
    """Outline of a plate, shape (ARC_POINTS + 6, 2): u from the dish's axis, w from its apex towards the slider [m].

    Args:
        bearing: the bearing.
        rims: whether the outline includes them.
    """
    half_dish = bearing.dish_diameter / 2.0
    u = np.linspace(-half_dish, half_dish, ARC_POINTS)
    w = bearing.radius - np.sqrt(bearing.radius**2 - u**2)
    top, back = w[-1] + rims * bearing.rim_height, -PLATE_THICKNESS * bearing.slider_diameter
    outer = half_dish + RIM_WIDTH * bearing.slider_diameter
    left = [(-outer, back), (-outer, top), (-half_dish, top)]
    right = [(half_dish, top), (outer, top), (outer, back)]
    return np.vstack((left, np.column_stack((u, w)), right))


def rim_outlines(bearing: Bearing) -> tuple[Array, Array]:
    """Outlines of a plate's left and right rim, shape (4, 2), in the coordinates of `plate_outline`."""
    half_dish = bearing.dish_diameter / 2.0
    edge = bearing.radius - math.sqrt(bearing.radius**2 - half_dish**2)
    outer, top = half_dish + RIM_WIDTH * bearing.slider_diameter, edge + bearing.rim_height
    right = np.array([(half_dish, edge), (outer, edge), (outer, top), (half_dish, top)])
    return right * (-1.0, 1.0), right


def plate_parts(motion: Motion) -> tuple[Array, tuple[Array, ...]]:
    """Outlines of a plate and of its rims, which are empty without rims; a rigid rim is part of the plate too."""
    bearing, kind = motion.response.bearing, motion.response.model.rim
    return plate_outline(bearing, kind == "rigid"), () if kind == "none" else rim_outlines(bearing)


def on_slider(outline: Array, q: Array) -> Array:
    """Transform an outline from the slider's centre, shape (n, 2), to the frame of the bottom plate."""
    cosine, sine = math.cos(q[2]), math.sin(q[2])
    rotated: Array = outline @ np.array(((cosine, sine), (-sine, cosine)))
    return rotated + q[:2]


def on_top_plate(outline: Array, q: Array) -> Array:
    """Transform an outline from the top plate's coordinates, shape (n, 2), to the frame of the bottom plate."""
    return outline * (1.0, -1.0) + q[3:]


def slider_vertices(motion: Motion, q: Array) -> Array:
    """The slider's vertices in the frame of the bottom plate, shape (4, 2): bottom left, right, top left, right [m]."""
    return np.array([q[:2] + lever(motion.system, vertex, q[2]) for vertex in range(4)])


BEARS, ON_RIM, OVER_RIM, LIFTED = range(4)
"""States of a vertex: bears on the dish alone, presses on the rim, has escaped over the rim, or touches neither."""

VERTEX_MARK: dict[str, Any] = {"linestyle": "none", "markersize": 4.5, "markeredgecolor": style.BLACK, "zorder": 5}
VERTEX_MARKS: tuple[dict[str, Any], ...] = (
    {"label": "bears on the dish", "marker": "o", "markerfacecolor": style.BLACK},
    {"label": "presses on the rim", "marker": "s", "markerfacecolor": style.VERMILION},
    {"label": "escaped over the rim", "marker": "D", "markerfacecolor": style.YELLOW},
    {"label": "lifted off", "marker": "o", "markerfacecolor": "white"},
)


def vertex_states(motion: Motion, time: float) -> list[int]:
    """The state of each of the four vertices at a time [s]: `BEARS`, `ON_RIM`, `OVER_RIM` or `LIFTED`."""
    states, q, plates = [], motion.position(time), motion.plates(time)
    for vertex in range(4):
        plate = plates[vertex // 2]
        u, w = seen_by_plate(vertex, *lever(motion.system, vertex, q[2]), q)
        if meets_rim(u, w, plate):
            states.append(ON_RIM)
        elif abs(u) >= plate.rim_distance and w >= plate.rim_top:
            states.append(OVER_RIM)
        else:
            states.append(LIFTED if gap(u, w, plate) > 0.0 else BEARS)
    return states


def extent(motion: Motion) -> tuple[Array, Array]:
    """Lower left and upper right corner of a drawing of the whole motion, with a margin, shape (2,) each."""
    bearing = motion.response.bearing
    (plate, rims), body = plate_parts(motion), slider_outline(bearing)
    plate = np.vstack((plate, *rims))
    q = motion.position(motion.fine_times())
    bodies = [plate]
    # The polygons are outermost near the extremes of the coordinates; the margin covers the difference.
    for row in {int(extreme) for column in q.T for extreme in (column.argmin(), column.argmax())}:
        bodies += [on_top_plate(plate, q[row]), on_slider(body, q[row])]
    points = np.vstack(bodies)
    margin = 0.12 * bearing.slider_diameter
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    # Room for the arrow of the ground acceleration and its label.
    low[1] -= 0.45 * bearing.slider_diameter
    return low, high


class BearingDrawing:
    """A drawing of a bearing's bodies on matplotlib axes, to scale, in the frame of the bottom plate.

    Attributes:
        slider: the slider's polygon, its vertices in the order of `slider_outline`.
        moving: the artists that `move_to` changes.
    """

    def __init__(self, axes: Axes, motion: Motion) -> None:
        self.motion = motion
        bearing = motion.response.bearing
        (self._plate, self._rims), self._body = plate_parts(motion), slider_outline(bearing)
        steel: dict[str, Any] = {"facecolor": style.LIGHT_GREY, "edgecolor": style.GREY, "linewidth": 0.9}
        ring: dict[str, Any] = {"facecolor": style.GREY, "edgecolor": style.GREY, "linewidth": 0.9}
        axes.add_patch(Polygon(self._plate, **steel, zorder=2))
        self._bottom_rims = [Polygon(outline, **ring, zorder=2.1) for outline in self._rims]
        # Upper bodies are translucent: bodies overlap where contact springs are compressed.
        self._top = Polygon(self._plate, **steel, alpha=0.8, zorder=3)
        self._top_rims = [Polygon(outline, **ring, alpha=0.8, zorder=3.1) for outline in self._rims]
        self.slider = Polygon(
            self._body, facecolor=style.SKY_BLUE, edgecolor=style.BLUE, linewidth=1.0, alpha=0.9, zorder=4
        )
        self._arrow = Polygon([(0.0, 0.0)] * 3, facecolor=style.PURPLE, edgecolor="none", zorder=3)
        for patch in (*self._bottom_rims, self._top, *self._top_rims, self.slider, self._arrow):
            axes.add_patch(patch)
        (self._axis,) = axes.plot([], [], color=style.BLUE, linewidth=0.8, linestyle="-.", zorder=4.1)
        self._marks = [axes.plot([], [], **VERTEX_MARK, **mark)[0] for mark in VERTEX_MARKS]
        bodies = [*self._bottom_rims, self._top, *self._top_rims, self.slider]
        self.moving: list[Artist] = [*bodies, self._axis, *self._marks, self._arrow]
        low, high = extent(motion)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set(xlabel="x [m]", ylabel="z [m]")
        axes.grid(False)
        below = self._arrow_height - 0.1 * bearing.slider_diameter
        axes.text(0.0, below, "ground acceleration", fontsize=8, ha="center", va="top")

    @property
    def _arrow_height(self) -> float:
        return -(PLATE_THICKNESS + 0.2) * self.motion.response.bearing.slider_diameter

    def move_to(self, time: float) -> None:
        """Show the state at a time [s], clipped to the simulated motion."""
        q = self.motion.position(time)
        self._top.set_xy(on_top_plate(self._plate, q))
        arcs = self.motion.rims(time).tolist()
        for patches, places in ((self._bottom_rims, arcs[:2]), (self._top_rims, arcs[2:])):
            for patch, outline, arc, side in zip(patches, self._rims, places, (-1.0, 1.0), strict=False):
                whole = math.isfinite(arc)
                at = outline + np.array((side * arc if whole else 0.0, 0.0))
                patch.set_xy(at if patches is self._bottom_rims else on_top_plate(at, q))
                edge, line = (style.GREY, "-") if whole else (style.VERMILION, "--")
                patch.set(fill=whole, edgecolor=edge, linestyle=line)
        self.slider.set_xy(on_slider(self._body, q))
        half = 0.5 * self.motion.response.bearing.slider_height
        self._axis.set_data(*on_slider(np.array([(0.0, -half), (0.0, half)]), q).T)
        vertices, states = slider_vertices(self.motion, q), np.array(vertex_states(self.motion, time))
        for state, mark in enumerate(self._marks):
            mark.set_data(*vertices[states == state].T)
        self._arrow.set_xy(self._arrow_outline(time))

    def _arrow_outline(self, time: float) -> Array:
        """An arrow below the bottom plate, proportional to the ground acceleration, shape (7, 2)."""
        bearing, pulse = self.motion.response.bearing, self.motion.response.pulse
        share = float(self.motion.ground(np.array([time]))[0]) / max(pulse.peak, 1e-12)
        length, half = 0.4 * bearing.dish_diameter * share, 0.03 * bearing.slider_diameter
        neck = length - math.copysign(min(abs(length), 5.0 * half), length)
        x = np.array((0.0, neck, neck, length, neck, neck, 0.0))
        z = np.array((1.0, 1.0, 2.5, 0.0, -2.5, -1.0, -1.0)) * half
        return np.column_stack((x, z + self._arrow_height))


@style.styled()
def plot_snapshots(response: Response) -> Figure:
    """Draw the bearing at the moments of `instants`.

    Raises:
        InputError: if the response holds no motion.
    """
    motion, chosen = Motion(response), instants(response)
    rows = math.ceil(len(chosen) / 2)
    low, high = extent(motion)
    panel_height = 4.8 * (high[1] - low[1]) / (high[0] - low[0]) + 0.35
    figure = titled_figure(response, width=10.5, height=1.75 + panel_height * rows)
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True, sharey=True)
    for panel, (name, time) in zip(panels.flat, chosen.items(), strict=False):
        drawing = BearingDrawing(panel, motion)
        drawing.move_to(time)
        panel.set_title(f"{name}, {seconds(time)}")
        panel.label_outer()
    for panel in panels.flat[len(chosen) :]:
        panel.set_axis_off()
    figure_legend(figure, panels[0, 0])
    return figure


def figure_legend(figure: Figure, axes: Axes) -> None:
    """Add a legend of the vertex marks, with the note on the drawing, at the foot of the figure."""
    handles, labels = axes.get_legend_handles_labels()
    columns = len(labels)
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, title=FOOTNOTE, title_fontsize=8)
