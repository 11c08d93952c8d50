"""Draw the bearing model of docs/bearing.md: `python docs/images/bearing_model.py` writes bearing_model.svg."""

import math
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon

from activefail.pages.figures import style
from activefail.seismic.bearing import Bearing
from activefail.seismic.figures.bodies import on_slider, on_top_plate, plate_outline, slider_outline

FILE = Path(__file__).with_name("bearing_model.svg")

BEARING = Bearing.from_table(T_b=3.2, mu=0.06, D_tot=0.42, h_sl_ratio=0.85, h_rim_ratio=0.2, p=45.0, k=2e9)
TILT = math.radians(6.0)
Q = np.array([0.075, 0.142, TILT, 0.15, 0.284])
"""Position of the bodies in the drawing, chosen for legibility: (x_s, z_s, θ, x_t, z_t)."""

ARROW = {"arrowstyle": "-|>", "color": style.BLACK, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
DIMENSION = ARROW | {"arrowstyle": "<|-|>", "linewidth": 0.8}
THIN = {"color": style.GREY, "linewidth": 0.7}


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], **look: object) -> None:
    """An arrow between two points [m]."""
    axes.annotate("", end, start, arrowprops=ARROW | look)


def dimension(axes: Axes, start: tuple, end: tuple, text: str, aside: tuple[float, float]) -> None:
    """A dimension line between two points [m], its text `aside` of its middle."""
    axes.annotate("", end, start, arrowprops=DIMENSION)
    middle = (np.add(start, end) / 2.0) + aside
    axes.text(*middle, text, ha="center", va="center", fontsize=11)


def draw_bodies(axes: Axes) -> None:
    """The plates and the slider at `Q`."""
    plate = plate_outline(BEARING)
    for outline, colour in (
        (plate, style.BLUE),
        (on_top_plate(plate, Q), style.ORANGE),
        (on_slider(slider_outline(BEARING), Q), style.GREY),
    ):
        axes.add_patch(Polygon(outline, closed=True, facecolor=colour, alpha=0.25, edgecolor="none"))
        axes.add_patch(Polygon(outline, closed=True, facecolor="none", edgecolor=colour, linewidth=1.2))


def turned(across: float, along: float) -> np.ndarray:
    """A point of the slider, given across and along its axis from its centre [m]."""
    cosine, sine = math.cos(TILT), math.sin(TILT)
    return np.add(Q[:2], (cosine * across - sine * along, sine * across + cosine * along))


def draw_model(axes: Axes) -> None:
    """Bodies, coordinates and dimensions."""
    draw_bodies(axes)
    half_dish, half_width = BEARING.dish_diameter / 2.0, BEARING.slider_diameter / 2.0
    half_height = BEARING.slider_height / 2.0
    edge = BEARING.radius - math.sqrt(BEARING.radius**2 - half_dish**2)
    top = edge + BEARING.rim_height
    # The frame of the bottom plate, and the coordinates of the bodies in it.
    arrow(axes, (0.0, 0.0), (0.0, 0.47))
    arrow(axes, (0.0, 0.0), (0.66, 0.0))
    axes.text(0.67, 0.0, "$x$", va="center", fontsize=11)
    axes.text(0.0, 0.48, "$z$", ha="center", fontsize=11)
    axes.plot(*Q[:2], "o", color=style.BLACK, markersize=4)
    axes.text(Q[0] + 0.012, Q[1] - 0.026, r"$(x_s, z_s)$", fontsize=11)
    axes.plot(Q[3], Q[4], "o", color=style.ORANGE, markeredgecolor=style.BLACK, markersize=5)
    axes.text(Q[3] + 0.012, Q[4] + 0.016, r"$(x_t, z_t)$", fontsize=11)
    axes.plot(*np.transpose([turned(0.0, -0.02), turned(0.0, 0.105)]), color=style.BLACK, linewidth=0.8)
    axes.plot([Q[0], Q[0]], [Q[1], Q[1] + 0.105], **THIN, linestyle="--")
    axes.add_patch(Arc(Q[:2], 0.19, 0.19, theta1=90.0, theta2=90.0 + math.degrees(TILT)))
    axes.text(Q[0] - 0.028, Q[1] + 0.085, r"$\theta$", fontsize=11)
    # The slider's vertices.
    for number, (across, along) in enumerate([(-1, -1), (1, -1), (-1, 1), (1, 1)], start=1):
        point = turned(across * half_width, along * half_height)
        axes.plot(*point, "o", color=style.BLACK, markersize=4)
        beside = turned(across * (half_width - 0.022), along * (half_height - 0.024))
        axes.text(*beside, str(number), ha="center", va="center", fontsize=9)
    # Dimensions.
    low = -0.15 * BEARING.slider_diameter - 0.035
    dimension(axes, (-half_dish, low), (half_dish, low), r"$D_{out}$", (0.0, -0.022))
    side = half_dish + 0.065
    dimension(axes, (-side, edge), (-side, top), r"$h_{rim}$", (-0.036, 0.0))
    for height in (edge, top):
        axes.plot([-side - 0.01, -half_dish], [height, height], **THIN)
    out = half_width + 0.035
    dimension(axes, tuple(turned(out, -half_height)), tuple(turned(out, half_height)), r"$h_{sl}$", (0.028, 0.0))
    dimension(axes, tuple(turned(-half_width, 0.03)), tuple(turned(half_width, 0.03)), r"$D_{sl}$", (-0.06, 0.012))
    away = math.radians(-102.0)  # of the point of the dish, from the centre of its sphere
    on_dish = np.array([BEARING.radius * math.cos(away), BEARING.radius * (1.0 + math.sin(away))])
    inward = (np.array([0.0, BEARING.radius]) - on_dish) / BEARING.radius
    arrow(axes, tuple(on_dish + 0.2 * inward), tuple(on_dish), color=style.BLUE)
    axes.text(*(on_dish + 0.215 * inward), "$R$", color=style.BLUE, ha="center", fontsize=11)
    # Loads.
    arrow(axes, (Q[3], 0.47), (Q[3], 0.365), color=style.ORANGE)
    axes.text(Q[3] + 0.015, 0.43, "$M g$", color=style.ORANGE, fontsize=11)
    arrow(axes, (0.42, low - 0.005), (0.54, low - 0.005), color=style.BLUE)
    axes.text(0.55, low - 0.005, r"$\ddot u_g$", color=style.BLUE, va="center", fontsize=11)
    axes.set(xlim=(-0.55, 0.72), ylim=(-0.13, 0.52), title="Bodies, coordinates, dimensions")


def draw_contact(axes: Axes) -> None:
    """A vertex that penetrates a dish, with the quantities of the force law."""
    u = np.linspace(-0.5, 1.0, 80)
    radius = 1.5
    dish = radius - np.sqrt(radius**2 - u**2)
    axes.fill_between(u, dish, -0.25, facecolor=style.BLUE, alpha=0.25)
    axes.plot(u, dish, color=style.BLUE, linewidth=1.2)
    centre, angle = np.array([0.0, radius]), math.radians(22.0)
    normal = np.array([-math.sin(angle), math.cos(angle)])
    tangent = np.array([normal[1], -normal[0]])
    surface, vertex = centre - radius * normal, centre - (radius + 0.13) * normal
    body = [vertex, *np.add(vertex, [(-0.75, 0.1), (-0.83, 0.72), (-0.08, 0.62)])]
    axes.add_patch(Polygon(body, facecolor=style.GREY, alpha=0.25, edgecolor=style.GREY))
    axes.plot(*vertex, "o", color=style.BLACK, markersize=5)
    axes.plot(*np.transpose([surface, vertex]), color=style.VERMILION, linewidth=2.0)
    axes.text(*(surface + 0.04 * normal + 0.07 * tangent), r"$\delta$", color=style.VERMILION, fontsize=12)
    arrow(axes, tuple(vertex), tuple(vertex + 0.62 * normal))
    axes.text(*(vertex + 0.66 * normal), "$N$", ha="center", va="bottom", fontsize=12)
    arrow(axes, tuple(vertex), tuple(vertex + 0.42 * tangent))
    axes.text(*np.add(vertex + 0.46 * tangent, (0.02, 0.0)), "$T$", va="center", fontsize=12)
    arrow(axes, (0.0, 0.0), (0.0, 0.95), **{"color": style.GREY})
    arrow(axes, (0.0, 0.0), (0.95, 0.0), **{"color": style.GREY})
    axes.text(0.97, 0.0, "$u$", va="center", fontsize=11)
    axes.text(0.0, 0.97, "$w$", ha="center", fontsize=11)
    axes.text(*np.add(vertex, (0.03, -0.09)), "$(u, w)$", fontsize=11)
    axes.set(xlim=(-0.5, 1.1), ylim=(-0.25, 1.08), title="A vertex on a dish, in the frame of its plate")


def draw() -> Figure:
    """The drawing of the model."""
    with style.styled():
        figure = Figure(figsize=(7.0, 7.6), layout="constrained")
        model, contact = figure.subplots(2, 1, height_ratios=[1.25, 1.0])
        draw_model(model)
        draw_contact(contact)
        for axes in (model, contact):
            axes.set_aspect("equal")
            axes.set_axis_off()
    return figure


if __name__ == "__main__":
    with matplotlib.rc_context({"svg.hashsalt": "activefail"}):  # the same bytes each time
        style.save_figure(draw(), FILE, metadata={"Date": None})
