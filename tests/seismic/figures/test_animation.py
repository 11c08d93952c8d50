"""Films of one bearing: files that play, and refusals that say what to do."""

import numpy as np
import pytest
from PIL import Image

from activefail.seismic.bearing import Bearing, Pulse, Response, simulate_one
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.motion import Motion
from activefail.seismic.figures import animation
from activefail.seismic.figures.animation import HOLD, MOST_FRAMES, default_slow_motion, render, save_animation


@pytest.fixture(scope="module")
def failure() -> Response:
    return simulate_one(Bearing.from_table(4.0, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9), Pulse(2.5, 0.5 * GRAVITY))


@pytest.fixture
def few_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven frames a second, in real time."""
    monkeypatch.setattr(animation, "FRAMES_PER_SECOND", 7.0)
    monkeypatch.setattr(animation, "default_slow_motion", lambda duration: 1.0)


@pytest.mark.usefixtures("few_frames")
def test_a_gif_has_its_frames_its_size_and_its_duration(failure, tmp_path):
    path = save_animation(failure, tmp_path / "bearing.gif")
    motion = Motion(failure)
    with Image.open(path) as film:
        assert film.n_frames == round(7.0 * (motion.end - motion.onset)) + 1
        assert film.n_frames > 10
        assert film.size[0] == 800
        durations = []
        for frame in range(film.n_frames):
            film.seek(frame)
            durations.append(film.info["duration"] / 1000.0)
        assert "loop" in film.info
    assert sum(durations[:-1]) == pytest.approx(motion.end - motion.onset, abs=0.02)
    assert durations[-1] == pytest.approx(HOLD)
    assert path.stat().st_size < 1e6


def test_frames_move_and_the_last_one_has_the_word_failure_in_red(failure):
    motion = Motion(failure)
    times = np.array([motion.start, -0.4, motion.end])
    first, middle, last = (np.asarray(frame) for frame in render(motion, times, 1.0))
    assert first.dtype == np.uint8
    assert first.shape == middle.shape == last.shape
    assert (first != middle).any(axis=2).mean() > 0.02

    def vermilion(frame):
        return (np.abs(frame.astype(int) - (0xD5, 0x5E, 0x00)).max(axis=2) < 10).sum()

    assert vermilion(first) == 0
    assert vermilion(last) > 30


def test_a_long_film_keeps_its_speed_and_loses_frames(failure, monkeypatch, tmp_path):
    monkeypatch.setattr(animation, "MOST_FRAMES", 15)
    path = save_animation(failure, tmp_path / "slow.gif")
    motion = Motion(failure)
    slow_motion = default_slow_motion(motion.end - motion.onset)
    with Image.open(path) as film:
        assert film.n_frames == 15
        film.seek(3)
        assert film.info["duration"] == pytest.approx(
            1000.0 * slow_motion * (motion.end - motion.onset) / 14.0, abs=10.0
        )


def test_the_speed_chosen_gives_a_film_of_at_most_twelve_seconds_or_real_time():
    for duration in np.linspace(0.2, 30.0, 50):
        factor = default_slow_motion(duration)
        assert factor >= 1.0
        assert factor * duration <= max(12.0, duration)
    assert MOST_FRAMES / 28.0 > 25.0
