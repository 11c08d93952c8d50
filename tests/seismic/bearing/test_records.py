"""Bearings under records: the physics that holds for any ground motion, and the early end of a run."""

from collections.abc import Callable

import numpy as np
import pytest

from activefail.errors import InputError
from activefail.seismic.bearing import (
    TABLE_1,
    Accelerogram,
    Bearing,
    Model,
    Pulse,
    Tolerance,
    simulate,
    simulate_one,
    simulate_records,
)
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.ground import samples
from activefail.seismic.bearing.motion import describe_outcome, instants
from activefail.seismic.bearing.pulse import ground_acceleration
from activefail.space.space import Array

MIRROR = np.array([-1.0, 1.0, -1.0, -1.0, 1.0])


def synthetic(seed: int, peak: float = 0.4, dt: float = 0.01, seconds: float = 15.0) -> Accelerogram:
    """A pulse with filtered noise, in an envelope."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, dt)
    noise = np.convolve(rng.standard_normal(len(t)), np.exp(-np.arange(0.0, 1.0, dt) / 0.1), mode="same")
    noise *= np.exp(-0.5 * ((t - 6.0) / 2.5) ** 2)
    pulse = np.array([ground_acceleration(time - 5.0, 1.0, 2.0) for time in t])
    a = pulse + 0.5 * noise / np.abs(noise).max()
    return Accelerogram(peak * GRAVITY * a / np.abs(a).max(), dt, f"synthetic {seed}")


def bearings(n: int, seed: int = 0) -> Array:
    return TABLE_1.from_unit(np.random.default_rng(seed).random((n, 9)))[:, :7]


def sampled(period: float, amplitude: float, dt: float) -> Accelerogram:
    t = np.arange(0.0, 3.0 * period + dt, dt) - 1.5 * period
    return Accelerogram(np.array([ground_acceleration(time, amplitude * GRAVITY, period) for time in t]), dt)


def bearing_of(row: Array) -> Bearing:
    return Bearing.from_row(row.tolist(), Model().slider_diameter)


def test_the_impulse_to_come_is_the_integral_of_the_linear_interpolation() -> None:
    a = np.array([0.3, -0.5, 0.0, 0.0, 2.0, 2.5, -1.0])
    fine = np.linspace(0.0, 6.0, 600_001)
    line = np.abs(np.interp(fine, np.arange(7.0), a))
    area = np.concatenate([np.cumsum((0.5 * (line[1:] + line[:-1]) * 1e-5)[::-1])[::-1], [0.0]])
    assert samples(a, 1.0).impulse == pytest.approx(area[::100_000], abs=1e-8)


def rising(seed: int, peak: float = 0.4, vertical: float = 0.3) -> Accelerogram:
    """A synthetic record with a vertical component."""
    return synthetic(seed, peak).with_vertical(synthetic(seed + 100, vertical))


@pytest.mark.slow
@pytest.mark.parametrize("is_rising", [False, True])
def test_a_run_that_may_end_early_has_the_outcome_of_the_whole_one(is_rising: bool) -> None:
    X, peaks = bearings(120), np.geomspace(0.08, 1.2, 120)
    records = [
        rising(k % 12, peak, 0.7 * peak) if is_rising else synthetic(k % 12, peak) for k, peak in enumerate(peaks)
    ]
    early, whole = (simulate_records(X, records, to_the_end=to_the_end) for to_the_end in (False, True))
    assert early.outcome.tolist() == whole.outcome.tolist()
    assert set(early.outcome.tolist()) == {0, 1, 2}
    assert early.statistic("steps").sum() < (1.0 if is_rising else 0.9) * whole.statistic("steps").sum()


@pytest.mark.parametrize("record", [synthetic, rising])
def test_a_mirrored_record_mirrors_the_motion(record: Callable[..., Accelerogram]) -> None:
    for seed, row in enumerate(bearings(4, 1)):
        ground = record(seed, 0.3)
        mirrored = Accelerogram(-ground.acceleration, ground.dt, vertical=ground.vertical)
        one, other = (simulate_one(bearing_of(row), motion) for motion in (ground, mirrored))
        assert other.outcome == one.outcome
        assert other.t == pytest.approx(one.t, abs=1e-9)
        assert other.q == pytest.approx(one.q * MIRROR, abs=1e-7)


def test_energy_is_conserved_under_records() -> None:
    found = simulate_records(bearings(60, 2), [synthetic(k, 0.5) for k in range(60)])
    assert (found.outcome >= 0).all()
    assert found.statistic("energy_error").max() < 5e-3
    finer = simulate_records(
        bearings(60, 2), [synthetic(k, 0.5) for k in range(60)], tolerance=Tolerance(relative=1e-6)
    )
    assert np.median(finer.statistic("energy_error")) < 0.1 * np.median(found.statistic("energy_error"))
    assert (finer.outcome == found.outcome).mean() >= 0.98


def test_a_vertical_component_without_motion_changes_no_bit() -> None:
    plain = [synthetic(k, 0.5) for k in range(20)]
    still = [one.with_vertical(one.scaled(0.0)) for one in plain]
    one, other = (simulate_records(bearings(20, 3), records) for records in (plain, still))
    assert one.columns.tobytes() == other.columns.tobytes()
    assert one.outcome.tolist() == other.outcome.tolist()


def test_a_constant_vertical_acceleration_is_more_gravity() -> None:
    # A pendulum's period is proportional to 1/√(g + vertical acceleration). Friction is small.
    row = bearings(1)[0]
    row[1], row[2] = 0.002, 3.0
    push = np.zeros(3000)
    push[:40] = 2.0
    periods = []
    for vertical in (0.0, 0.5 * GRAVITY):
        record = Accelerogram(push, 0.01, vertical=np.full(3000, vertical))
        response = simulate_one(bearing_of(row), record, to_the_end=True)
        within = (response.t > 1.0) & (response.t < 29.0)
        t, x = response.t[within], response.q[within, 3]
        crossings = t[1:][np.sign(x[1:]) != np.sign(x[:-1])]
        periods.append(2.0 * float(np.mean(np.diff(crossings))))
    assert periods[0] / periods[1] == pytest.approx(np.sqrt(1.5), rel=0.01)


def test_in_free_fall_nothing_presses_on_the_dishes() -> None:
    record = Accelerogram(np.full(200, 1.0), 0.01, vertical=np.full(200, -GRAVITY))
    response = simulate_one(bearing_of(bearings(1)[0]), record, to_the_end=True)
    # The contacts release their small energy; then the ground moves away from slider and plate alike.
    late = (response.t > 0.5) & (response.t < 1.9)
    assert response.a[late][:, [0, 3]] == pytest.approx(-1.0, abs=1e-6)
    assert response.a[late][:, [1, 4]] == pytest.approx(0.0, abs=1e-6)


def test_energy_is_conserved_under_vertical_motion() -> None:
    found = simulate_records(bearings(60, 2), [rising(k, 0.5) for k in range(60)])
    assert (found.outcome >= 0).all()
    assert found.statistic("energy_error").max() < 5e-3


def lifting(push: float, vertical: float, dt: float = 0.005) -> Accelerogram:
    """A horizontal push [m/s2] of 0.4 s, then a fall of the ground for 0.25 s by an acceleration [g]."""
    t = np.arange(0.0, 3.0, dt)
    across, up = np.where(t < 0.4, push, 0.0), np.where((t >= 0.4) & (t < 0.65), -vertical * GRAVITY, 0.0)
    return Accelerogram(across, dt, vertical=up)


def test_a_centred_bearing_that_vertical_motion_lifts_over_its_rims_height_and_that_comes_down_has_not_failed() -> None:
    for row in bearings(8):
        response = simulate_one(bearing_of(row), lifting(0.1, 2.5), to_the_end=True)
        assert response.margins.peak_gap_ratio > 2.0
        assert response.outcome_name == "no_impact"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_bearing_that_moves_over_its_rims_while_lifted_has_escaped_without_a_rim_touch(side: float) -> None:
    for row in bearings(8):
        response = simulate_one(bearing_of(row), lifting(side * 3.0, 3.5))
        assert (response.outcome_name, response.cause_name) == ("failure", "escape")
        assert np.isnan(response.margins.first_touch_time)
        assert "nan" not in describe_outcome(response)
        assert list(instants(response)) == ["at rest", "failure"]


def test_what_a_rim_throws_off_is_lost_with_vertical_motion_as_without() -> None:
    plain = [synthetic(k, peak) for k, peak in enumerate(np.geomspace(0.5, 1.0, 60))]
    nearly = [one.with_vertical(synthetic(k + 100, 1e-5)) for k, one in enumerate(plain)]
    X = bearings(60, 4)
    one, other = (simulate_records(X, records) for records in (plain, nearly))
    assert (one.outcome == 2).sum() >= 20
    assert (one.outcome != other.outcome).sum() <= 1


def test_components_of_other_lengths_are_continued_with_zeros_and_other_intervals_refused() -> None:
    short, long = Accelerogram(np.ones(3), 0.1), Accelerogram(np.full(5, 2.0), 0.1)
    assert short.with_vertical(long).acceleration.tolist() == [1.0, 1.0, 1.0, 0.0, 0.0]
    padded = long.with_vertical(short).scaled(3.0)
    assert padded.vertical is not None
    assert padded.vertical.tolist() == [3.0, 3.0, 3.0, 0.0, 0.0]
    with pytest.raises(InputError, match=r"interval of the horizontal component, 0.1 s, got 0.2 s"):
        short.with_vertical(Accelerogram(np.ones(3), 0.2))
    with pytest.raises(InputError, match=r"vertical: must have as many samples as acceleration, 3, got 5"):
        Accelerogram(np.ones(3), 0.1, vertical=np.ones(5))


def test_no_step_crosses_a_sample() -> None:
    record = synthetic(3, dt=0.02)
    t = simulate_one(bearing_of(bearings(1)[0]), record).t
    within = t[t < record.duration]
    crossed = np.floor(within[1:] / record.dt - 1e-6) - np.floor(within[:-1] / record.dt + 1e-6)
    assert crossed.max() <= 0


def test_a_sampled_pulse_gives_the_outcome_and_the_peak_of_the_analytic_one() -> None:
    X = TABLE_1.from_unit(np.random.default_rng(3).random((200, 9)))
    records = [sampled(period, amplitude, 0.005) for period, amplitude in X[:, 7:]]
    pulses, found = simulate(X), simulate_records(X[:, :7], records)
    assert (pulses.outcome != found.outcome).sum() <= 1
    for row in X[:20]:
        bearing, pulse = bearing_of(row), Pulse.from_table(*row[7:].tolist())
        exact = simulate_one(bearing, pulse, to_the_end=True)
        near = simulate_one(bearing, sampled(row[7], row[8], 0.005), to_the_end=True)
        if exact.outcome == near.outcome == 0:
            peaks = [run.margins.peak_displacement_ratio for run in (exact, near)]
            assert peaks[1] == pytest.approx(peaks[0], rel=5e-3)


def test_the_order_of_the_method_holds_within_a_segment() -> None:
    # A record of one long segment: the error falls with the tolerance as without samples.
    record = Accelerogram(np.array([0.0, 1.5]), 1.2)
    bearing = bearing_of(TABLE_1.from_unit(np.full((1, 9), 0.5))[0])
    ends = [
        simulate_one(bearing, record, tolerance=Tolerance(relative=tolerance)).margins.peak_displacement_ratio
        for tolerance in (1e-4, 1e-6, 1e-10)
    ]
    assert abs(ends[1] - ends[2]) < 0.1 * abs(ends[0] - ends[2]) + 1e-9


@pytest.mark.parametrize(
    ("acceleration", "dt", "message"),
    [
        ([1.0], 0.01, "at least 2 samples"),
        ([0.0, float("nan")], 0.01, "sample 2 must be finite"),
        ([0.0, 1.0], 0.0, "dt: must be positive"),
    ],
)
def test_what_is_no_record_is_refused(acceleration: list[float], dt: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Accelerogram(acceleration, dt)  # type: ignore[arg-type]


def test_bearings_and_records_must_match() -> None:
    with pytest.raises(InputError, match="records: must be 2, one for each bearing, got 1"):
        simulate_records(bearings(2), [synthetic(0)])
    with pytest.raises(InputError, match=r"\(n, 7\) with the columns"):
        simulate_records(np.ones((2, 9)), [synthetic(0)] * 2)
    with pytest.raises(InputError, match="scale: must be finite"):
        synthetic(0).scaled(float("nan"))
    for factor in (1e300, -1e76):
        with pytest.raises(InputError, match=r"scale: must keep accelerations of up to .* below 1e\+75 m/s2, got "):
            synthetic(0).scaled(factor)
