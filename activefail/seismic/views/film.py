"""One bearing for a page: its bodies at some moments, a film, which the browser moves, and curves over time."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from activefail.pages.explorer.pages import page
from activefail.pages.figures.svg import inline, place_of
from activefail.seismic.bearing import Response
from activefail.seismic.bearing.motion import Motion, instants, seconds
from activefail.seismic.figures.bodies import (
    VERTEX_MARKS,
    extent,
    plate_parts,
    shapes,
    slider_outline,
    vertex_states,
)
from activefail.seismic.figures.motion import plot_histories
from activefail.space.space import Array

fragment = partial(page, package=__package__)
"""Renders a template of this package."""

_FRAMES = 240

_LONGEST = 10.0
"""A longer motion is sped up to so many seconds."""


def film(motion: Motion) -> Markup:
    """A drawing to scale, in the frame of the bottom plate."""
    times = np.linspace(motion.onset, motion.end, _FRAMES)
    q, arcs, ground = motion.position(times), motion.rims(times), motion.ground(times)
    (plate, rims), body = plate_parts(motion), slider_outline(motion.response.bearing)
    low, high = (end.tolist() for end in extent(motion))
    width = high[0] - low[0]
    # As `vertex_states` counts: bottom left, bottom right, top left, top right.
    corners = body[[0, len(body) // 2 - 1, -1, len(body) // 2]]
    looks = [
        [VERTEX_MARKS[state] for state in states]
        for states in np.transpose([vertex_states(motion, time) for time in times.tolist()]).tolist()
    ]
    return fragment(
        "film",
        low=low,
        high=high,
        width=width,
        line=0.003 * width,
        duration=min(_LONGEST, motion.end - motion.onset),
        plate=_rows(plate, " "),
        rims=[_rim(rims[number % 2], 2 * (number % 2) - 1, arcs[:, number]) for number in range(4 if rims else 0)],
        top=_rows(q[:, 3:]),
        slider=_rows(q[:, :2]),
        tilt=_rows(np.degrees(q[:, 2:3])),
        body=_rows(body, " "),
        height=float(body[:, 1].max()),
        corners=[
            (
                corner,
                _switched([f"M{_rows(mark, 'L')}Z" for mark, _ in look]),
                _switched([colour for _, colour in look]),
            )
            for corner, look in zip(corners.tolist(), looks, strict=True)
        ],
        arrow=[_arrow(share, width) for share in (ground / max(np.abs(ground).max(), 1e-12)).tolist()],
        ruler=_ruler(width),
    )


def stills(response: Response, alternative: str) -> Markup:
    """The drawing at the moments of `instants`, two in a row, with a text for screen readers."""
    motion = Motion(response)
    low, high = (end.tolist() for end in extent(motion))
    return fragment(
        "stills",
        alternative=alternative,
        low=low,
        high=high,
        width=high[0] - low[0],
        ruler=_ruler(high[0] - low[0]),
        moments=[
            (
                f"{name}, {seconds(time)}",
                [(_rows(outline, " "), *look) for outline, *look in shapes(motion, time)],
            )
            for name, time in instants(response).items()
        ],
    )


def _ruler(width: float) -> float:
    """The length of the bar that shows the scale of a drawing [m]."""
    return next((length for length in (0.5, 0.2, 0.1) if length < 0.15 * width), 0.05)


def _rim(outline: Array, side: int, arc: Array) -> dict[str, Any]:
    """A rim that moves outwards as it yields; of a broken one, whose arc has no place, the outline is left."""
    whole = np.isfinite(arc)
    moved = np.where(whole, side * arc, 0.0)
    return {
        "outline": _rows(outline, " "),
        "arc": _rows(np.column_stack((moved, np.zeros_like(moved)))) if moved.any() else "",
        "breaks": not whole.all(),
        "whole": _switched(np.where(whole, "visible", "hidden").tolist()),
        "broken": _switched(np.where(whole, "hidden", "visible").tolist()),
    }


def _arrow(share: float, width: float) -> str:
    """An arrow to the right or the left."""
    length = 0.3 * width * share
    head = np.sign(length) * min(abs(length), 0.024 * width)
    ends = f"{length - head:.4f},{head / 2:.4f}L{length:.4f},0L{length - head:.4f},{-head / 2:.4f}"
    return f"M0,0H{length:.4f}M{ends}"


def _rows(rows: Array, between: str = ";") -> str:
    """Rows of numbers as an attribute."""
    return between.join(",".join(f"{value:.5g}" for value in row) for row in rows.tolist())


def _switched(values: Sequence[str]) -> dict[str, list[Any]]:
    """The values without repetitions, and the share of the film at which each begins."""
    starts = [k for k, value in enumerate(values) if k == 0 or value != values[k - 1]]
    return {"each": [values[k] for k in starts], "begin": [k / len(values) for k in starts]}


def histories(motion: Motion, width: float) -> dict[str, Any]:
    """A figure over the time of the film, of a width [in], and where in it the film's ends are."""
    figure = plot_histories(motion.response, width)
    svg = inline(figure, "histories", "Displacement, ground acceleration, uplift and tilt over time")
    place, (first, last) = place_of(figure.axes[0], figure.axes[-1]), figure.axes[-1].get_xlim()
    place["right"] = place["left"] + (motion.end - first) / (last - first) * (place["right"] - place["left"])
    return {"svg": svg, "place": place}
