"""Animation of one simulated bearing, as GIF."""

from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from activefail.pages.figures import style
from activefail.seismic.bearing import Response
from activefail.seismic.bearing.motion import Motion, describe_outcome, seconds
from activefail.seismic.figures.bodies import MARKS, extent, shapes
from activefail.space.space import Array
from activefail.text.progress import Begin, uncounted

FRAMES_PER_SECOND = 25.0

MOST_FRAMES = 750
"""Longer animations get fewer frames per second."""

PALETTE = ("#ffffff", style.BLACK, style.VERMILION, style.ORANGE, style.YELLOW, style.PURPLE, style.BLUE)
"""Colours that a GIF keeps even if few pixels have them."""

HOLD = 1.0
"""Duration of the last frame [s]."""

WIDTH = 800
"""Width of a frame in pixels."""

_SHARPER = 2
"""Pixels of the drawing for one of a frame, which smooth its lines."""


def save_animation(response: Response, path: Path, begin: Begin = uncounted) -> Path:
    """Write an animation of the bearing, from just before it moves to its failure or the end of the simulation.

    Args:
        response: from `activefail.seismic.bearing.simulate_one`.
        path: GIF to write.
        begin: called with the number of frames; returns a callback for drawn frames.

    Returns:
        The path.

    Raises:
        InputError: if the response holds no motion.
    """
    motion = Motion(response)
    slow_motion = default_slow_motion(motion.end - motion.onset)
    film = (motion.end - motion.onset) * slow_motion  # [s]
    count = int(np.clip(round(FRAMES_PER_SECOND * film) + 1, 12, MOST_FRAMES))
    advance = begin(count)
    # GIF durations are in hundredths of a second; rounding their sum keeps the speed.
    ticks = np.diff(np.round(np.linspace(0.0, 100.0 * film, count)).astype(int))
    durations = [*(np.maximum(ticks, 2) * 10).tolist(), int(1000.0 * HOLD)]  # [ms]; browsers slow down shorter frames
    frames = render(motion, np.linspace(motion.onset, motion.end, count), slow_motion)
    first = next(frames)
    palette = first.copy()
    for column, colour in enumerate(PALETTE):
        palette.paste(colour, (60 * column, 0, 60 * column + 60, 60))
    palette = palette.quantize(64, method=Image.Quantize.MEDIANCUT)

    def quantized() -> Iterator[Image.Image]:
        # One palette and no dithering, so that unchanged pixels cost nothing.
        for frame in (first, *frames):
            yield frame.quantize(palette=palette, dither=Image.Dither.NONE)
            advance(1)

    images = quantized()
    next(images).save(path, "GIF", save_all=True, append_images=images, duration=durations, loop=0, disposal=1)
    return path


def default_slow_motion(duration: float) -> float:
    """The largest of a few round factors that keeps the animation of a motion [s] within 12 s; at least 1."""
    return next((factor for factor in (10.0, 5.0, 2.0) if duration * factor <= 12.0), 1.0)


def render(motion: Motion, times: Array, slow_motion: float) -> Iterator[Image.Image]:
    """The frames at these times."""
    low, high = extent(motion)
    scale = WIDTH / (high[0] - low[0])
    arrow = (-low[0] * scale, 56 + scale * (high[1] + 0.45 * motion.response.bearing.slider_diameter))
    top, height = 56, round(scale * (high[1] - low[1])) + 84
    speed = "real time" if slow_motion == 1.0 else f"{slow_motion:g}× slow motion"
    fonts = Path(matplotlib.get_data_path(), "fonts/ttf")
    large, small = (ImageFont.truetype(fonts / "DejaVuSans.ttf", size) for size in (16, 12))
    for time in times.tolist():
        stage = Image.new("RGB", (_SHARPER * WIDTH, _SHARPER * height), "white")
        draw = ImageDraw.Draw(stage, "RGBA")
        for outline, fill, edge, opacity in shapes(motion, time):
            pixels = _SHARPER * ((outline - (low[0], high[1])) * (scale, -scale) + (0.0, top))
            points = [*map(tuple, pixels.tolist())]
            if fill:
                draw.polygon(points, f"{fill}{round(255.0 * opacity):02x}")
            draw.line([*points, points[0]], edge, _SHARPER)
        frame = stage.reduce(_SHARPER)
        draw = ImageDraw.Draw(frame)
        state, colour = _state(motion.response, time)
        draw.text((12, 8), describe_outcome(motion.response), style.BLACK, large)
        draw.text((12, 34), f"{seconds(time)}   {speed}", style.GREY, small)
        draw.text((WIDTH - 12, 34), state, colour, small, anchor="ra")
        draw.text((12, height - 22), f"To scale. Marks: {MARKS}.", style.GREY, small)
        draw.text(arrow, "ground acceleration", style.BLACK, small, anchor="mt")
        yield frame


def _state(response: Response, time: float) -> tuple[str, str]:
    """The state at a time, as text and colour."""
    touch, failure = response.margins.first_touch_time, response.margins.failure_time
    if time >= failure:
        return f"FAILURE: {response.cause_name.replace('_', ' ')}", style.VERMILION
    if time >= touch:
        return "rim touched", style.PURPLE
    return "no impact", style.BLACK
