"""Animation of one simulated bearing, as GIF or MP4."""

import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from numpy.typing import NDArray
from PIL import Image

from activefail.errors import ActivefailError, InputError
from activefail.pages.figures import style
from activefail.seismic.bearing import Response
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.motion import Motion, seconds
from activefail.seismic.figures.motion import (
    LIMIT_LINE,
    BearingDrawing,
    extent,
    figure_legend,
    mark_events,
    mark_limits,
    plot_plates,
    titled_figure,
)
from activefail.text.progress import Begin, uncounted

Frame = NDArray[np.uint8]

FRAMES_PER_SECOND = 25.0

MOST_FRAMES = 750
"""Longer animations get fewer frames per second; a GIF of this length is under 6 MB and takes less than 30 s."""

PALETTE = ("white", style.BLACK, style.VERMILION, style.ORANGE, style.YELLOW, style.PURPLE, style.BLUE)
"""Colours that a GIF keeps even if few pixels have them."""

HOLD = 1.0
"""Duration of the last frame [s]."""

WIDTH = 8.0
"""Width of a frame [inch], at 100 pixels per inch."""


def save_animation(response: Response, path: Path, begin: Begin = uncounted) -> Path:
    """Write an animation of the bearing, from just before it moves to its failure or the end of the simulation.

    Args:
        response: from `activefail.seismic.bearing.simulate_one`.
        path: file to write, an MP4 if it ends in .mp4, which requires ffmpeg, else a GIF.
        begin: called with the number of frames; returns a callback for drawn frames.

    Returns:
        The path.

    Raises:
        InputError: if ffmpeg is missing for an MP4, or the response holds no motion.
        ActivefailError: if ffmpeg fails.
    """
    ffmpeg = find_ffmpeg() if path.suffix.lower() == ".mp4" else ""
    motion = Motion(response)
    slow_motion = default_slow_motion(motion.end - motion.onset)
    film = (motion.end - motion.onset) * slow_motion  # [s]
    count = int(np.clip(round(FRAMES_PER_SECOND * film) + 1, 12, MOST_FRAMES))
    interval = film / (count - 1)
    advance = begin(count)

    def counted() -> Iterator[Frame]:
        for frame in render(motion, np.linspace(motion.onset, motion.end, count), slow_motion):
            yield frame
            advance(1)

    if ffmpeg:
        _write_mp4(path, counted(), interval, ffmpeg)
    else:
        _write_gif(path, counted(), count, interval)
    return path


def default_slow_motion(duration: float) -> float:
    """The largest of a few round factors that keeps the animation of a motion [s] within 12 s; at least 1."""
    return next((factor for factor in (10.0, 5.0, 2.0) if duration * factor <= 12.0), 1.0)


def find_ffmpeg() -> str:
    """The path of ffmpeg, from PATH or the package imageio-ffmpeg.

    Raises:
        InputError: if neither has it.
    """
    if (path := shutil.which("ffmpeg")) is not None:
        return path
    try:
        return str(import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # no package, or a package without the program
        raise InputError(
            "MP4 requires ffmpeg, which was not found. Install it with `pip install 'activefail[video]'` or put ffmpeg "
            "on PATH. GIF requires no other program."
        ) from None


def render(motion: Motion, times: NDArray[np.float64], slow_motion: float) -> Iterator[Frame]:
    """Render frames at these times, (height, width, 3) each, with even height and width."""
    response = motion.response
    low, high = extent(motion)
    stage_height = np.clip(0.93 * WIDTH * (high[1] - low[1]) / (high[0] - low[0]), 1.5, 5.0)
    # MP4's usual pixel format needs an even number of pixels.
    height = round((stage_height + 3.25) * 50.0) / 50.0
    with style.styled():
        figure = titled_figure(response, WIDTH, height)
        rows = figure.add_gridspec(2, 1, height_ratios=(stage_height + 0.6, 1.5))
        stage = figure.add_subplot(rows[0])
        drawing = BearingDrawing(stage, motion)
        figure_legend(figure, stage)
        cells = rows[1].subgridspec(1, 3)
        strips = [figure.add_subplot(cells[column]) for column in range(3)]
        _plot_strips(strips, motion)
        cursors = [strip.axvline(times[0], color=style.PURPLE, linewidth=1.4, zorder=6) for strip in strips]
        for strip in strips:
            strip.set_xlim(times[0], times[-1])
        clock = stage.set_title(seconds(times[0]), loc="left", fontsize=11, family="DejaVu Sans Mono")
        state = stage.set_title("at rest", loc="right", fontsize=10, fontweight="bold")
        speed = "real time" if slow_motion == 1.0 else f"{slow_motion:g}× slow motion"
        stage.set_title(speed, loc="center", fontsize=8.5, color=style.GREY)
        moving: list[Artist] = [*drawing.moving, *cursors, clock, state]
        for artist in moving:
            artist.set_animated(True)
        canvas: Any = figure.canvas  # Agg's, from `titled_figure`; its methods are not typed
        canvas.draw()
        background = canvas.copy_from_bbox(figure.bbox)
    moving.sort(key=lambda artist: artist.get_zorder())
    for time in times.tolist():
        drawing.move_to(time)
        for cursor in cursors:
            cursor.set_xdata([time, time])
        clock.set_text(seconds(time))
        text, colour = _state(response, time)
        state.set(text=text, color=colour)
        canvas.restore_region(background)
        for artist in moving:
            figure.draw_artist(artist)
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _plot_strips(strips: Sequence[Axes], motion: Motion) -> None:
    """Small plots of ground acceleration, displacement and uplift over time."""
    ground, shift, uplift = strips
    response = motion.response
    t = motion.fine_times()
    ground.plot(t, motion.ground(t) / GRAVITY, color=style.BLACK)
    ground.set_title("Ground acceleration [g]")
    capacity = response.bearing.displacement_capacity
    shift.plot(t, motion.position(t)[:, 3], color=style.ORANGE)
    mark_limits(shift.axhline, capacity, "capacity")
    shift.set_title(r"Top plate [m], capacity $\pm D_{tot}$")
    plot_plates(uplift, t, 1e3 * motion.contacts(t)[0])
    uplift.axhline(1e3 * response.bearing.rim_height, **LIMIT_LINE)
    uplift.set_title("Uplift [mm]")
    key: dict[str, Any] = {"bbox_to_anchor": (1.02, 0.97), "fontsize": 7, "columnspacing": 0.6, "handlelength": 1.4}
    uplift.legend(uplift.get_lines()[:3], ("bottom", "top", "$h_{rim}$"), loc="lower right", ncols=3, **key)
    for strip in strips:
        mark_events(strip, response)
        strip.set_xlabel("Time [s]")
        strip.tick_params(labelsize=7.5)
        strip.set_title(strip.get_title(loc="left"), fontsize=8.5)


def _state(response: Response, time: float) -> tuple[str, str]:
    """The state at a time, as text and colour."""
    touch, failure = response.margins.first_touch_time, response.margins.failure_time
    if time >= failure:
        return f"FAILURE: {response.cause_name.replace('_', ' ')}", style.VERMILION
    if time >= touch:
        return "rim touched", style.PURPLE
    return "no impact", style.BLACK


def _palette(frame: Image.Image) -> Image.Image:
    """An image with the colours of a frame and of `PALETTE`, which a frame may lack."""
    sample = frame.copy()
    for column, colour in enumerate(PALETTE):
        sample.paste(colour, (60 * column, 0, 60 * column + 60, 60))
    return sample.quantize(64, method=Image.Quantize.MEDIANCUT)


def _write_gif(path: Path, frames: Iterator[Frame], count: int, interval: float) -> None:
    # GIF durations are in hundredths of a second; rounding their sum keeps the speed.
    ticks = np.diff(np.round(np.arange(count + 1) * interval * 100.0).astype(int))
    durations = np.maximum(ticks, 2) * 10  # [ms]; browsers slow down shorter frames
    durations[-1] = 1000.0 * HOLD
    first = Image.fromarray(next(frames))
    palette = _palette(first)
    # One palette and no dithering, so that unchanged pixels cost nothing.
    images = (Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    first.quantize(palette=palette, dither=Image.Dither.NONE).save(
        path, format="GIF", save_all=True, append_images=images, duration=durations.tolist(), loop=0, disposal=1
    )


def _write_mp4(path: Path, frames: Iterator[Frame], interval: float, ffmpeg: str) -> None:
    frame = next(frames)
    height, width, _ = frame.shape
    command = [ffmpeg, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    command += ["-r", f"{1.0 / interval:.6f}", "-i", "-", "-an", "-c:v", "libx264", "-crf", "20"]
    command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        # If the pipe breaks, ffmpeg failed; its error output gives the reason.
        with suppress(BrokenPipeError):
            process.stdin.write(frame.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
            process.stdin.write(round(HOLD / interval) * frame.tobytes())
            process.stdin.close()
        message = process.stderr.read().decode(errors="replace").strip()
    if process.returncode != 0:
        raise ActivefailError(f"ffmpeg could not write {str(path)!r}: {message or 'no reason given'}.")
