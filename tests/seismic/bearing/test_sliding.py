"""The sliding block against motions known in closed form, its own convergence, and the bearing model."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Bearing, Model
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.ground import Ricker
from activefail.seismic.bearing.pulse import ground_acceleration
from activefail.seismic.bearing.sliding import STEPS, slide, sliding_features

NO_STOP = math.inf
FINE = 20_000


def ricker_spectrum(frequency: float, amplitude: float, period: float) -> float:
    """|∫ ü_g exp(−iωt) dt| of the pulse [m/s]."""
    spread = 2.0 * math.pi / (math.sqrt(3.0) * period)
    w = frequency / spread
    # (s³ − 3s) exp(−s²/2) is minus the third derivative of exp(−s²/2), whose transform is √(2π) exp(−w²/2).
    return amplitude / 1.38 / spread * math.sqrt(2.0 * math.pi) * w**3 * math.exp(-0.5 * w * w)


@pytest.mark.parametrize(("natural_period", "period"), [(4.0, 0.5), (4.0, 2.0), (2.5, 2.5), (5.5, 3.0)])
def test_a_pendulum_without_friction_or_stop_swings_on_by_the_pulses_fourier_amplitude(natural_period, period):
    frequency = 2.0 * math.pi / natural_period
    # Friction enters only the rest after the pulse, and there as nothing; the peak is at least the residual swing.
    speed, push, peak, *_ = slide(frequency**2, 0.0, NO_STOP, 0.65, Ricker(3.0, period), FINE)
    assert (speed, push) == (0.0, 0.0)
    residual = ricker_spectrum(frequency, 3.0, period) / frequency
    t = np.linspace(-1.5 * period, 1.5 * period, 40_001)
    during = np.abs(duhamel(t, frequency, 3.0, period)).max()
    assert peak == pytest.approx(max(residual, during), rel=1e-3)


def duhamel(t, frequency, amplitude, period):
    """x(t) = −∫ ü_g(τ) sin ω(t − τ)/ω dτ by cumulative trapezoids."""
    s = 2.0 * math.pi / math.sqrt(3.0) * t / period
    ground = amplitude / 1.38 * (s * s - 3.0) * s * np.exp(-0.5 * s * s)
    step = t[1] - t[0]

    def integral(f):
        return np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1])) * step])

    cosine, sine = integral(ground * np.cos(frequency * t)), integral(ground * np.sin(frequency * t))
    return -(np.sin(frequency * t) * cosine - np.cos(frequency * t) * sine) / frequency


@pytest.mark.parametrize("share", [0.1, 0.9, 0.99])
def test_a_block_that_the_pulse_pushes_less_than_friction_holds_does_not_move(share):
    friction = 0.6
    assert slide(2.5, friction, 0.5, 0.65, Ricker(share * friction, 1.0), STEPS)[:4] == (0.0, 0.0, 0.0, 0.0)


def test_a_block_that_the_pulse_pushes_more_than_friction_holds_moves():
    assert slide(2.5, 0.6, 0.5, 0.65, Ricker(1.1 * 0.6, 1.0), STEPS)[2] > 0.0


@pytest.mark.parametrize(
    ("frequency", "period", "share"),
    [(1.2, 1.0, 0.97), (1.6, 2.5, 0.8), (1.6, 2.5, 0.9), (2.5, 1.5, 0.9), (2.5, 4.0, 0.8)],
)
def test_a_stop_is_met_with_the_speed_that_the_free_motion_has_there(frequency, period, share):
    amplitude = 4.0
    t = np.linspace(-1.5 * period, 1.5 * period, 40_001)
    x = duhamel(t, frequency, amplitude, period)
    stop = share * np.abs(x).max()
    touch = np.argmax(np.abs(x) > stop)
    # A stop that returns nothing, in cases where the swing after it is slower: the first arrival is the fastest.
    speed, push, peak, *_ = slide(frequency**2, 0.0, stop, 0.0, Ricker(amplitude, period), FINE)
    assert peak == stop
    assert speed == pytest.approx(abs(np.gradient(x, t)[touch]), rel=2e-3)
    assert push == pytest.approx(
        -math.copysign(1.0, x[touch]) * ground_acceleration(t[touch], amplitude, period), rel=2e-3, abs=2e-3 * amplitude
    )


def test_a_stop_just_beyond_the_peak_is_not_met_and_one_just_before_it_is():
    for A_p, period in ((3.0, 2.0), (7.0, 0.5), (5.0, 4.0)):
        _, _, peak, *_ = slide(2.5, 0.5, NO_STOP, 0.65, Ricker(A_p, period), STEPS)
        assert slide(2.5, 0.5, 1.001 * peak, 0.65, Ricker(A_p, period), STEPS)[0] == 0.0
        assert slide(2.5, 0.5, 0.999 * peak, 0.65, Ricker(A_p, period), STEPS)[0] > 0.0


def test_what_a_stop_gives_back_matters_where_a_stop_is_reached_and_nowhere_else():
    X = TABLE_1.latin_hypercube(200, np.random.default_rng(3))
    soft = sliding_features(X, Model(restitution_coefficient=0.1))
    hard = sliding_features(X, Model(restitution_coefficient=1.0))
    missed = soft[:, 0] <= 0.0
    assert hard[missed].tolist() == soft[missed].tolist()
    assert np.mean(hard[~missed, 0] != soft[~missed, 0]) > 0.3


def test_the_pulse_reversed_in_sign_gives_the_same_features():
    X = TABLE_1.latin_hypercube(50, np.random.default_rng(2))
    mirrored = X.copy()
    mirrored[:, 8] *= -1.0
    assert sliding_features(mirrored).tolist() == sliding_features(X).tolist()


def test_the_error_falls_with_the_step_and_is_small_at_the_one_used():
    X = TABLE_1.latin_hypercube(300, np.random.default_rng(5))

    def peaks(steps):
        designs = (Bearing.from_row(row, 0.30) for row in X.tolist())
        lengths = [2.0 * math.sqrt(b.radius**2 - 0.0225) - b.slider_height for b in designs]
        return np.array(
            [
                slide(GRAVITY / L, row[1] * GRAVITY, NO_STOP, 0.65, Ricker(row[8] * GRAVITY, row[7]), steps)[2] / row[2]
                for L, row in zip(lengths, X.tolist(), strict=True)
            ]
        )

    exact = peaks(FINE)
    errors = [np.mean(np.abs(peaks(steps) - exact)) for steps in (STEPS // 4, STEPS // 2, STEPS)]
    # Onsets and ends of sliding fall between steps: first order.
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.4)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.4)
    assert errors[2] < 1e-3


def test_the_unstopped_peak_predicts_impact_in_98_of_100_samples(designs, production):
    predicted = sliding_features(designs)[:, 0] > 0.0
    assert np.mean(predicted == (production.outcome >= 1)) >= 0.98


def test_faster_impacts_fail_more_often(designs, production):
    v = sliding_features(designs)[:, 0]
    failed = production.outcome == 2
    shares = [failed[(v > low) & (v <= high)].mean() for low, high in ((0.0, 0.7), (0.7, 1.5), (1.5, np.inf))]
    assert shares == sorted(shares)
    assert shares[2] - shares[0] > 0.4


def test_v_is_the_arrival_over_the_speed_that_lifts_a_weight_over_the_rim():
    X = TABLE_1.latin_hypercube(200, np.random.default_rng(8))
    higher = X.copy()
    higher[:, 4] *= 1.5
    v, a = sliding_features(X).T
    v_higher, a_higher = sliding_features(higher).T
    assert_allclose(v_higher, v / math.sqrt(1.5), rtol=1e-12)
    assert a_higher.tolist() == a.tolist()
    assert np.all(a[v <= 0.0] == 0.0)


def test_a_design_that_cannot_be_built_has_no_features():
    X = TABLE_1.latin_hypercube(8, np.random.default_rng(0))
    X[2, 0] = 0.5  # a radius of 3 cm
    X[5, 7] = np.nan
    answer = sliding_features(X)
    assert np.flatnonzero(np.isnan(answer).any(axis=1)).tolist() == [2, 5]
    assert np.isnan(answer[[2, 5]]).all()


def test_designs_of_another_shape_are_refused():
    with pytest.raises(InputError, match=r"must be an array of shape \(n, 9\) .* got shape \(9,\)"):
        sliding_features(np.zeros(9))
