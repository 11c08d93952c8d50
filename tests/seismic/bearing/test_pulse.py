"""The ground motion against what is known of the antisymmetric Ricker pulse in closed form."""

import math

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.pulse import (
    HALF_DURATION,
    VELOCITY_PERIOD,
    amplitude_of,
    ground_acceleration,
    ground_jerk,
    velocity_of,
)

PERIODS = (0.25, 1.0, 5.0)


def motion(period: float, amplitude: float, half_duration: float):
    """Time, acceleration, velocity and displacement of a pulse cut at ± half_duration periods."""
    t = np.linspace(-half_duration * period, half_duration * period, 20_001)
    a = np.array([ground_acceleration(time, amplitude, period) for time in t])
    v = cumulative_simpson(a, x=t, initial=0.0)
    return t, a, v, cumulative_simpson(v, x=t, initial=0.0)


@pytest.mark.parametrize("period", PERIODS)
def test_the_peak_acceleration_exceeds_the_amplitude_only_by_the_papers_rounding(period):
    _, a, _, _ = motion(period, 3.0, HALF_DURATION)
    # |s² − 3| s exp(−s²/2) is largest at s² = 3 − √6.
    s = math.sqrt(3.0 - math.sqrt(6.0))
    exact = math.sqrt(6.0) * s * math.exp(-0.5 * s * s)
    assert exact == pytest.approx(1.380119, abs=5e-7)
    assert np.abs(a).max() / 3.0 == pytest.approx(exact / 1.38, abs=1e-6)
    assert np.abs(a).max() / 3.0 == pytest.approx(1.0001, abs=5e-5)


@pytest.mark.parametrize("period", PERIODS)
def test_peak_velocity_and_peak_displacement_are_the_known_multiples_and_nothing_remains(period):
    unit = period / (2.0 * math.pi)
    _, _, v, d = motion(period, 3.0, 5.0)
    assert np.abs(v).max() / (3.0 * unit) == pytest.approx(1.2551, abs=5e-5)
    assert np.abs(d).max() / (3.0 * unit**2) == pytest.approx(1.3185, abs=5e-5)
    assert abs(d[-1]) / (3.0 * unit**2) < 1e-10
    assert abs(v[-1]) / (3.0 * unit) < 1e-10


@pytest.mark.parametrize("period", PERIODS)
def test_cutting_the_pulse_leaves_the_known_residual_displacement(period):
    _, a, _, d = motion(period, 3.0, HALF_DURATION)
    assert abs(d[-1]) / (3.0 * (period / (2.0 * math.pi)) ** 2) == pytest.approx(2.6e-4, abs=5e-6)
    assert abs(a[-1]) / 3.0 == pytest.approx(4e-5, abs=5e-6)


def test_the_pulse_is_antisymmetric_and_scales_with_amplitude_and_period():
    for t in np.linspace(0.01, 3.0, 40):
        here = ground_acceleration(t, 2.0, 1.7)
        assert ground_acceleration(-t, 2.0, 1.7) == -here
        assert ground_acceleration(t, -2.0, 1.7) == -here
        assert ground_acceleration(t, 6.0, 1.7) == pytest.approx(3.0 * here, rel=1e-14)
        assert ground_acceleration(t / 1.7, 2.0, 1.0) == pytest.approx(here, rel=1e-12)


def test_the_first_push_is_to_the_left_just_after_the_centre():
    # (s² − 3) s is negative for small positive s: the sign that tells the pulse from its mirror image.
    assert ground_acceleration(0.1, 1.0, 1.0) < 0.0 < ground_acceleration(-0.1, 1.0, 1.0)


@pytest.mark.parametrize("period", PERIODS)
def test_the_jerk_is_the_derivative_of_the_acceleration(period):
    h = 1e-5 * period
    for t in np.linspace(-1.5 * period, 1.5 * period, 61):
        slope = (ground_acceleration(t + h, 3.0, period) - ground_acceleration(t - h, 3.0, period)) / (2.0 * h)
        # Truncation h²/6 times the third derivative, of the order of 100 A_p/T_p³.
        assert ground_jerk(t, 3.0, period) == pytest.approx(slope, rel=1e-7, abs=3e-8 * 3.0 / period)


@pytest.mark.parametrize("period", PERIODS)
def test_the_peak_ground_velocity_is_that_of_the_integrated_pulse(period):
    _, _, v, _ = motion(period, 0.4 * GRAVITY, HALF_DURATION)
    stated = velocity_of(np.array([0.4]), np.array([period]))[0]
    # The pulse is cut where 4e-5 of its peak acceleration remain.
    assert np.abs(v).max() == pytest.approx(stated, rel=5e-5)
    assert stated == pytest.approx(0.1997 * 0.4 * GRAVITY * period, rel=5e-4)
    assert amplitude_of(np.array([stated]), np.array([period]))[0] == pytest.approx(0.4, rel=1e-14)


@pytest.mark.parametrize("period", PERIODS)
def test_the_acceleration_spectrum_peaks_at_the_period_and_the_velocity_spectrum_at_its_root_of_1_5(period):
    t, a, v, _ = motion(period, 3.0, 5.0)
    # Zeros after the motion make the frequencies dense: steps of 1/(160 T_p).
    frequency = np.fft.rfftfreq(16 * len(t), t[1] - t[0])
    for series, peak in ((a, period), (v, VELOCITY_PERIOD * period)):
        spectrum = np.abs(np.fft.rfft(series, 16 * len(t)))
        assert frequency[spectrum.argmax()] * peak == pytest.approx(1.0, abs=0.5 * 1.5**0.5 / 160 + 1e-4)
    assert VELOCITY_PERIOD == 1.5**0.5
