"""Incremental dynamic analysis: capacities under records, the fragility that follows, and its figures."""

import json
import math
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commandline import activefail, refused
from scipy.integrate import solve_ivp
from scipy.stats import norm

import activefail as af
from activefail import create_run, open_run
from activefail.analyses.fragility.capacities import LARGEST, fit_lognormal, fitted
from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Accelerogram, simulate_records
from activefail.seismic.bearing.design import GRAVITY, Model, Tolerance
from activefail.seismic.bearing.outcome import CAUSES
from activefail.seismic.bearing.pulse import ground_acceleration
from activefail.seismic.ida import simulations as module
from activefail.seismic.ida.capacity import (
    BISECTIONS,
    Agreement,
    Answers,
    Capacities,
    Runs,
    capacities,
    capacities_near,
    ladder,
)
from activefail.seismic.ida.capacity import LEVELS as LADDER
from activefail.seismic.ida.equivalent_pulse import compare_pulses, equivalent_pulse
from activefail.seismic.ida.p695 import MarginOptions
from activefail.seismic.ida.simulations import BearingSubject, Kept
from activefail.seismic.motions.intensity import Intensity, spectral_acceleration
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.text.json_text import json_text

BEARING = np.array([3.5, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9])
SUBJECT = BearingSubject(BEARING, Model(), Tolerance())
TOML = "T_b = 3.5\nmu = 0.06\nD_tot = 0.6\nh_sl_ratio = 0.6\nh_rim_ratio = 0.1\np = 45\nk = 2e9\n"


def pulse(period: float, dt: float = 0.02) -> Accelerogram:
    """A sampled pulse of 0.1 g."""
    t = np.arange(0.0, 4.0 * period, dt)
    a = [ground_acceleration(x - 2.0 * period, 0.1 * GRAVITY, period) for x in t]
    return Accelerogram(np.array(a), dt, f"pulse {period:g}")


# --- intensities -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.5, 3.0])
def test_the_spectral_acceleration_is_that_of_an_integrated_oscillator(period: float) -> None:
    motion, omega = pulse(1.5), 2.0 * np.pi / period
    end = motion.duration + 2.0 * period

    def rate(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -2.0 * 0.05 * omega * y[1] - omega**2 * y[0] - float(motion.at(np.array([t]))[0])]

    times = np.arange(0.0, end, 0.005)
    found = solve_ivp(rate, (0.0, end), [0.0, 0.0], t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.02)
    assert spectral_acceleration(motion, period) == pytest.approx(omega**2 * np.abs(found.y[0]).max(), rel=1e-3)


@pytest.mark.parametrize("period", [0.03, 0.05, 0.1, 0.4])
def test_a_peak_of_a_short_oscillator_between_two_samples_is_seen(period: float) -> None:
    rng, dt = np.random.default_rng(5), 0.01
    coarse = Accelerogram(rng.standard_normal(400), dt)
    parts = math.ceil(1000 * dt / period)
    t = np.arange(399 * parts + 1) * (dt / parts)
    fine = Accelerogram(np.interp(t, np.arange(400) * dt, coarse.acceleration), dt / parts)
    assert spectral_acceleration(coarse, period) == pytest.approx(spectral_acceleration(fine, period), rel=6e-4)


@pytest.mark.parametrize("kind", ["factor", "pga", "pgv", "sa:2.5"])
def test_scaling_a_record_scales_its_intensity(kind: str) -> None:
    intensity, motion = Intensity.of(kind), pulse(1.5)
    factor = 3.0 if kind != "factor" else 1.0
    assert intensity.of_record(motion.scaled(3.0)) == pytest.approx(factor * intensity.of_record(motion))


@pytest.mark.parametrize("text", ["sa", "sa:x", "sa:101"])
def test_an_intensity_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--scale-to: "):
        Intensity.of(text)


def test_a_record_without_motion_has_no_intensity() -> None:
    for kind in ("pgv", "factor"):
        with pytest.raises(InputError, match="still: does not move the ground, so it cannot be scaled"):
            Intensity.of(kind).of_record(Accelerogram(np.zeros(5), 0.01, "still"))


# --- capacities --------------------------------------------------------------------------------------------------


LEVELS = np.array([1.0, 2.0, 4.0, 8.0])


def found(outcome_at: Callable[[float], int], severity: int = 2, bisections: int = 6) -> tuple[Capacities, list[float]]:
    """The capacities of one record with made-up outcomes, and the levels that were asked."""
    asked: list[float] = []

    def simulate(pairs: Runs) -> Answers:
        levels = [level for _, level in pairs]
        asked.extend(levels)
        return Answers(np.array([outcome_at(x) for x in levels], dtype=np.int8), np.zeros(len(levels), dtype=bool))

    return capacities(simulate, 1, LEVELS, bisections, severity), asked


def test_the_capacity_is_bracketed_by_the_ladder_and_halved_by_each_bisection() -> None:
    one, asked = found(lambda x: 2 if x >= 2.7 else 0)
    assert one.below[0] < 2.7 <= one.capacity[0]
    assert one.capacity[0] - one.below[0] == pytest.approx(2.0 / 2**6)
    assert one.runs == len(asked) == len(set(asked)) == 10
    assert (one.resurrections[0], one.numerical_failures[0]) == (0, 0)


def test_an_outcome_that_is_worse_counts_too() -> None:
    assert 1.0 < found(lambda x: 0 if x < 1.5 else 2, severity=1)[0].capacity[0] <= 1.6


def test_a_bearing_that_survives_a_higher_level_is_counted_and_has_the_lowest_failing_one() -> None:
    one, _ = found(lambda x: 2 if 1.7 <= x < 3.0 else 1)
    assert one.below[0] < 1.7 <= one.capacity[0]
    assert one.resurrections[0] == 2  # the levels 4 and 8


def test_records_that_never_fail_and_that_always_fail() -> None:
    never, _ = found(lambda _: 0)
    assert (never.below[0], never.capacity[0], never.runs) == (8.0, math.inf, 4)
    always, _ = found(lambda _: 2, bisections=3)
    assert (always.below[0], always.capacity[0], always.runs) == (0.0, 0.125, 7)


def test_a_numerical_failure_is_neither_survived_nor_failed() -> None:
    one, _ = found(lambda x: -1 if x in (2.0, 3.0) else 2 if x >= 2.5 else 0, bisections=2)
    # The ladder gives 1 and 4; the first bisection, 2.5, fails, the second, 1.75, is survived.
    assert (one.below[0], one.capacity[0], one.numerical_failures[0]) == (1.75, 2.5, 1)


def test_a_program_that_gives_up_beyond_collapse_has_its_capacities_if_lost_levels_fail() -> None:
    one, _ = found(lambda x: -1 if x >= 1.7 else 0)
    assert one.capacity[0] == math.inf
    lost = one.if_lost_fail
    assert lost.below[0] < 1.7 <= lost.capacity[0] < math.inf


def test_a_plate_that_lifts_above_its_rim_before_a_touch_is_a_failure_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lifting(X, records, *_):
        strong = np.array([record.acceleration[1] for record in records])
        # Without vertical motion a numerical failure of the kernel; with it a failure without a touch.
        outcome = np.select([strong >= 3.0, strong >= 2.7], [2, -1], 0)
        never = np.full(len(strong), np.nan)
        return SimpleNamespace(outcome=outcome, cause=np.where(outcome < 0, 7, 0), margin=lambda _: never)

    monkeypatch.setattr(module, "simulate_records", lifting)
    unit = Accelerogram(np.array([0.0, 1.0, 0.0]), 0.01, "unit")
    one = capacities(partial(SUBJECT.simulate, [unit], np.ones(1), print), 1, LEVELS, 6, 2)
    assert one.below[0] < 2.7 <= one.capacity[0]
    assert (one.lifted[0], one.numerical_failures[0]) == (5, 0)
    assert CAUSES[7] == "failure_without_rim_touch"


def test_capacities_of_a_bearing_lie_where_its_simulations_say() -> None:
    motions, intensity = [pulse(1.5), pulse(2.5)], Intensity.of("pgv")
    own = np.array([intensity.of_record(motion) for motion in motions])
    one = capacities(partial(SUBJECT.simulate, motions, own, lambda _: None), 2, ladder(intensity), 4, 2)
    assert np.isfinite(one.capacity).all()
    for motion, below, above in zip(motions, one.below, one.capacity, strict=True):
        scaled = [motion.scaled(level / intensity.of_record(motion)) for level in (below, above)]
        assert simulate_records(np.tile(BEARING, (2, 1)), scaled).outcome.tolist()[1] == 2
        assert simulate_records(BEARING[None], scaled[:1]).outcome[0] < 2


# --- kept simulations --------------------------------------------------------------------------------------------


class Counting:
    """A made-up simulation that counts what it is asked, and may stop after some of it."""

    def __init__(self, outcome: int = 1, stop_after: int = 10**9) -> None:
        self.asked: list[tuple[int, float]] = []
        self.outcome, self.stop_after = outcome, stop_after

    def __call__(self, asked: Runs) -> Answers:
        if len(self.asked) >= self.stop_after:
            raise KeyboardInterrupt
        self.asked += asked
        return Answers(np.full(len(asked), self.outcome, dtype=np.int8), np.array([k == 3 for k, _ in asked]))


MANY = [(k, 0.1 * k) for k in range(250)]


def kept(simulate: Counting, folder: Path, shown: Callable[[int], None] = lambda _: None, mu: float = 0.06) -> Kept:
    return Kept.of(simulate, folder, {"values": {"mu": mu}}, shown)


def test_capacities_are_in_the_order_of_the_rims_and_without_rims_nothing_is_lifted() -> None:
    runs = [(0, float(level)) for level in np.geomspace(1.0, 8.0, 24)]
    strong = BearingSubject(BEARING, Model(rim="breaking", rim_strength=1.5), Tolerance())
    subjects = [SUBJECT, strong, BearingSubject(BEARING, Model(rim="none"), Tolerance())]
    answers = [one.simulate([pulse(2.5)], np.array([1.0]), lambda n: None, runs) for one in subjects]
    assert not any(one.lifted.any() for one in answers)
    lowest = [int((one.outcome == 2).argmax()) for one in answers]
    assert lowest == sorted(lowest, reverse=True)
    assert lowest[0] > lowest[2] == int((answers[0].outcome > 0).argmax())


def test_simulations_before_an_interruption_are_kept(tmp_path: Path) -> None:
    first, second, shown = Counting(stop_after=200), Counting(), list[int]()
    with pytest.raises(KeyboardInterrupt):
        kept(first, tmp_path)(MANY)
    answers = kept(second, tmp_path, shown.append)(MANY)
    assert first.asked + second.asked == MANY
    assert shown == [200]
    assert answers.outcome.tolist() == [1] * 250
    assert np.flatnonzero(answers.lifted).tolist() == [3]


def test_a_damaged_file_is_replaced(tmp_path: Path) -> None:
    kept(Counting(), tmp_path)(MANY)
    one = kept(Counting(), tmp_path)
    assert len(one.read()) == 250
    for damaged in (b"", b"[1]", one.file.read_bytes()[:-9]):
        one.file.write_bytes(damaged)
        assert one.read() == {}


def test_the_simulations_of_another_analysis_are_not_used_and_stay(tmp_path: Path) -> None:
    kept(Counting(), tmp_path)(MANY)
    assert kept(Counting(outcome=2), tmp_path, mu=0.07)(MANY).outcome.tolist() == [2] * 250
    assert kept(Counting(outcome=2), tmp_path)(MANY).outcome.tolist() == [1] * 250


def test_numerical_failures_are_simulated_again(tmp_path: Path) -> None:
    kept(Counting(outcome=-1), tmp_path)(MANY)
    again = Counting()
    assert kept(again, tmp_path)(MANY).outcome.tolist() == [1] * 250
    assert again.asked == MANY


# --- the fragility -----------------------------------------------------------------------------------------------


def test_the_fit_of_finely_known_capacities_is_that_of_their_logarithms() -> None:
    capacity = np.random.default_rng(4).lognormal(0.3, 0.5, 400)
    fit = fit_lognormal(0.999 * capacity, 1.001 * capacity)
    assert fit is not None
    assert math.log(fit.median) == pytest.approx(np.log(capacity).mean(), abs=1e-3)
    assert fit.dispersion == pytest.approx(np.log(capacity).std(), abs=1e-3)


def test_records_that_never_fail_enter_as_capacities_above_the_highest_level() -> None:
    capacity = np.random.default_rng(5).lognormal(0.0, 0.4, 4000)
    limit = 1.2
    low, high = np.where(capacity < limit, 0.98 * capacity, limit), np.where(capacity < limit, capacity, np.inf)
    fit = fit_lognormal(low, high)
    assert fit is not None
    assert fit.median == pytest.approx(1.0, rel=0.03)
    assert fit.dispersion == pytest.approx(0.4, rel=0.05)


def test_too_few_failing_records_have_no_curve_and_too_few_events_no_interval() -> None:
    high = np.array([1.0, np.inf, np.inf])
    assert fit_lognormal(np.array([0.9, 4.0, 4.0]), high) is None
    assert fitted(np.array([0.9, 4.0, 4.0]), high, ["a", "b", "c"]) is None
    capacity = np.array([1.0, 1.5, 2.0, 2.5])
    two = fitted(0.95 * capacity, capacity, ["a", "a", "b", "b"])
    assert two is not None
    assert two.median == two.dispersion == ()


def test_records_that_fail_at_every_level_alone_have_no_curve() -> None:
    high = np.array([1.0, 1.1, 1.2, 1.3])
    assert fit_lognormal(np.zeros(4), high) is None
    assert fit_lognormal(np.array([0.9, 0.0, 0.0, 0.0]), high) is None
    fit = fit_lognormal(np.array([0.9, 1.0, 0.0, 0.0]), high)
    assert fit is not None
    assert 0.5 < fit.median < 1.3


def test_a_record_without_an_answer_says_nothing() -> None:
    capacity = np.array([1.0, 1.2, 1.5, 1.9])
    known, more = 0.98 * capacity, np.append(capacity, math.inf)
    assert fit_lognormal(np.append(known, 0.0), more) == fit_lognormal(known, capacity)


def test_few_events_bound_the_dispersion_from_below_only() -> None:
    capacity = np.array([1.0, 1.1, 2.9, 3.0, 1.5, 1.6])
    one = fitted(0.98 * capacity, capacity, ["a", "a", "b", "b", "c", "c"])
    assert one is not None
    assert one.dispersion[0] < one.fit.dispersion < one.dispersion[1] == LARGEST


def test_intervals_cover_medians_and_dispersions_of_records_that_share_events() -> None:
    rng, covered = np.random.default_rng(6), np.zeros(2)
    for _ in range(40):
        z = np.sqrt(0.7) * rng.normal(size=(10, 1)) + np.sqrt(0.3) * rng.normal(size=(10, 2))
        capacity = 1.5 * np.exp(0.4 * z.ravel())
        one = fitted(0.98 * capacity, capacity, np.repeat(np.arange(10), 2).tolist())
        assert one is not None
        covered += one.median[0] <= 1.5 <= one.median[1], one.dispersion[0] <= 0.4 <= one.dispersion[1]
    # 95 % of 40 are 38; fewer than 34 would have a probability of 0.003.
    assert covered.min() >= 34


def test_the_acceptable_margins_are_those_of_the_standard() -> None:
    # Φ of the logarithm of the margin over β is the share that does not collapse.
    for share in (0.10, 0.20):
        least = MarginOptions(0.9, 1.2, 0.5).acceptable(share)
        assert norm.cdf(math.log(least) / 0.5) == pytest.approx(1.0 - share)


# --- equivalent pulses -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("period", "amplitude", "late"), [(0.8, 2.0, 1.0), (2.7, -0.5, 9.0)])
def test_the_equivalent_pulse_of_a_pulse_is_itself(period: float, amplitude: float, late: float) -> None:
    t = np.arange(0.0, 5.0 * period + late, 0.005)
    a = np.array([ground_acceleration(x - 2.0 * period - late, amplitude, period) for x in t])
    found = equivalent_pulse(Accelerogram(a, 0.005, "pulse"))
    assert found.period == pytest.approx(period, rel=2e-3)
    assert found.amplitude == pytest.approx(amplitude, rel=5e-3)
    assert found.explained == pytest.approx(1.0, abs=1e-3)
    assert np.abs(found.motion.acceleration).max() == pytest.approx(abs(amplitude), rel=5e-3)


def test_the_explained_share_is_what_least_squares_leaves() -> None:
    t = np.arange(0.0, 12.0, 0.01)
    a = np.array([ground_acceleration(x - 6.0, 1.0, 2.0) for x in t])
    noise = 0.6 * np.sin(17.0 * t) * np.exp(-((t - 5.0) ** 2) / 4.0)
    record = Accelerogram(a + noise, 0.01, "noisy")
    found = equivalent_pulse(record)
    v = np.cumsum(record.acceleration) * 0.01
    w = np.zeros(len(v))
    pulse_velocity = np.cumsum(np.interp(np.arange(0, 3.0 * found.period, 0.01), *_times(found))) * 0.01
    best = min(
        float(((v - np.roll(np.append(pulse_velocity, w)[: len(v)], k)) ** 2).sum()) for k in range(0, len(v) - 300, 2)
    )
    assert 0.3 < found.explained < 0.999
    assert 1.0 - best / float(v @ v) == pytest.approx(found.explained, abs=0.02)


def _times(found):
    motion = found.motion
    return motion.dt * np.arange(len(motion.acceleration)), motion.acceleration


def made(*outcomes: list[int]) -> Capacities:
    """The capacities of records with these outcomes at LEVELS."""
    rows = tuple(np.array(one, dtype=np.int8) for one in outcomes)
    return Capacities(2, (LEVELS,) * len(rows), rows, np.zeros(len(rows), dtype=np.int64))


def test_levels_are_counted_by_the_outcomes_of_record_and_pulse() -> None:
    records, pulses = made([0, 2, 2, 2], [0, 0, 0, 2]), made([0, 0, 2, 2], [0, -1, 2, 2])
    found = compare_pulses([], pulses, records, ["a", "b"], LEVELS)
    assert found.levels == Agreement(both_fail=3, both_survive=2, missed=1, false=1)
    assert found.mean == pytest.approx(0.5 * (math.log(2.0) + math.log(0.5)))
    assert (found.interval, found.compared) == ((), 2)


def test_records_that_fail_at_every_level_are_not_compared_with_their_pulses() -> None:
    records, pulses = made([2, 2, 2, 2], [0, 2, 2, 2], [0, 2, 2, 2]), made([0, 2, 2, 2], [2, 2, 2, 2], [0, 0, 2, 2])
    found = compare_pulses([], pulses, records, ["a", "b", "c"], LEVELS)
    assert (found.compared, found.mean) == (1, pytest.approx(math.log(2.0)))


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set of eight pulses of four events, and a bearing."""
    folder = tmp_path_factory.mktemp("ida")
    (folder / "set").mkdir()
    rows = ["file,unit,event,dt"]
    for event in range(4):
        for component, size in (("a", 1.0), ("b", 0.7)):
            motion = pulse(1.3 + 0.4 * event).scaled(size)
            name = f"{event}{component}.txt"
            np.savetxt(folder / "set" / name, motion.acceleration)
            rows.append(f"{name},m/s2,{event},{motion.dt}")
    (folder / "set" / "records.csv").write_text("\n".join(rows) + "\n")
    (folder / "bearing.toml").write_text(TOML)
    return folder


def test_the_command_finds_capacities_and_a_fragility_with_intervals(case: Path, tmp_path: Path) -> None:
    words = ("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--mce", "0.8", "--ssf", "1.1")
    result = activefail(*words, "--out", tmp_path / "out")
    assert result.code == 0, result.err
    assert "8 from 4 events, scaled to PGV" in result.out
    assert "95 % interval" in result.out
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"ida.html", "ida.json", "ida.csv", "ida.png", "ida.svg"}
    numbers = json.loads(activefail(*words, "--json").out)
    page = (tmp_path / "out" / "ida.html").read_text()
    assert f"<b>{numbers['acmr']:.3g}</b> (" in page
    assert f"<b>{numbers['median']:.3g} m/s</b> (" in page
    for one in numbers["records"]:
        assert f'<th scope="row">{one["record"]}</th><td>{one["event"]}</td>' in page
    assert json.loads((tmp_path / "out" / "ida.json").read_text()) == numbers
    levels = np.sort([one["capacity"] for one in numbers["records"]])
    curve = norm.cdf(np.log(levels / numbers["median"]) / numbers["dispersion"])
    after, before = np.arange(1, 9) / 8, np.arange(8) / 8
    assert numbers["misfit"] == pytest.approx(max(abs(curve - after).max(), abs(curve - before).max()))
    low, high = numbers["median_interval"]
    assert low < numbers["median"] < high
    assert numbers["acmr"] == pytest.approx(1.1 * numbers["median"] / 0.8)
    assert numbers["cmr_interval"] == pytest.approx([low / 0.8, high / 0.8])
    capacity = [one["capacity"] for one in numbers["records"]]
    # Two components of one event differ by a factor alone, so they fail at one velocity.
    assert capacity[::2] == pytest.approx(capacity[1::2])
    header = (tmp_path / "out" / "ida.csv").read_text().splitlines()[0]
    assert header == "record,event,intensity,below,capacity,resurrections,numerical_failures,lifted"


def test_vertical_components_change_capacities_and_the_notes_say_how_they_are_scaled(
    case: Path, tmp_path: Path
) -> None:
    shutil.copytree(case / "set", tmp_path / "set")
    table = tmp_path / "set" / "records.csv"
    header, *rows = table.read_text().splitlines()
    table.write_text("\n".join([f"{header},vertical", *(f"{row},up.txt" for row in rows)]) + "\n")
    np.savetxt(tmp_path / "set" / "up.txt", np.random.default_rng(1).uniform(-0.3, 0.3, 300))
    words = ("ida", "--records", tmp_path / "set", "--bearing", case / "bearing.toml", "--pulses", "--json")
    found = [json.loads(activefail(*words, *more).out) for more in ([], ["--vertical"])]
    assert [one["vertical"] for one in found] == [False, True]
    capacities = [[record["capacity"] for record in one["records"]] for one in found]
    assert capacities[0] != capacities[1]
    assert capacities[0] == pytest.approx(capacities[1], rel=0.5)
    assert any("The vertical ones are scaled by the same factors" in note for note in found[1]["notes"])
    assert any("have no vertical component" in note for note in found[1]["notes"])
    assert any("are used with --vertical only" in note for note in found[0]["notes"])


def test_records_that_are_pulses_have_the_capacities_of_their_equivalent_pulses(case: Path) -> None:
    words = ("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--pulses")
    numbers = json.loads(activefail(*words, "--json").out)["pulses"]
    assert all(one["explained"] > 0.98 for one in numbers["pulses"])
    assert abs(numbers["mean_log_ratio"]) < 0.05
    shown = activefail(*words).out
    assert "a pulse alone causes the outcome at" in shown
    assert "record and pulse cause the same outcome at " in shown


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign under pulses."""
    folder = tmp_path_factory.mktemp("pulses") / "run"
    with create_run(folder, {"seed": 1, "sampling": {"initial": 60, "budget": 60}}) as run:
        run.take()
    return folder


def test_predictions_stand_beside_the_outcomes_under_records(case: Path, campaign: Path) -> None:
    words = ("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--pulses", "--campaign", campaign)
    result = activefail(*words, "--json")
    assert result.code == 0, result.err
    numbers = json.loads(result.out)
    classifier, reduced = numbers["predictions"]
    assert (classifier["by"], reduced["by"]) == ("classifier at the pulse", "reduced model")
    for one in numbers["predictions"]:
        assert sum(one[name] for name in ("both_fail", "both_survive", "missed", "false")) == 80
    # The records are pulses, so the reduced model sees what the bearing does.
    assert reduced["missed"] + reduced["false"] <= 4
    assert reduced["outside"] is None
    periods = [1.3 + 0.4 * (k // 2) for k in range(8)]
    amplitude = ladder(Intensity.of("pgv"))[None, :] / (0.1997 * 9.81 * np.array(periods)[:, None])
    expected = np.mean((amplitude < 0.1) | (amplitude > 0.8))
    assert classifier["outside"] == pytest.approx(expected, abs=0.03)
    X = np.column_stack([np.tile(BEARING, (80, 1)), np.repeat(periods, 10), amplitude.ravel()])
    with open_run(campaign) as run, pytest.warns(UserWarning, match="designs lie outside the design space"):
        fails = run.predict(X)["p_failure"].to_numpy() >= 0.5
    assert classifier["both_fail"] + classifier["false"] == pytest.approx(fails.sum(), abs=2)
    shown = activefail(*words).out
    assert "% of these pulses lie outside the campaign's design space" in shown
    assert "the reduced model predicts " in shown


def test_a_campaign_that_does_not_fit_is_refused(case: Path, campaign: Path, tmp_path: Path) -> None:
    words = ("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--campaign")
    space = {p.name: {"low": p.low, "high": p.high} for p in TABLE_1.parameters} | {"k": {"value": 3e9}}
    with create_run(tmp_path / "run", {"space": space, "sampling": {"initial": 40, "budget": 40}}) as run:
        run.take()
    fixed = activefail(*words, tmp_path / "run", "--pulses")
    refused(fixed, "--campaign: ", "fixes k to 3e+09, but the bearing has 2e+09")
    with create_run(
        tmp_path / "other", {"space": {"x": {"low": 0, "high": 1}}, "simulator": {"elsewhere": True}}
    ) as run:
        run.add({"x": [0.1, 0.9], "outcome": ["safe", "failure"]})
    refused(activefail(*words, tmp_path / "other", "--pulses"), "--campaign: ", "must be a campaign under pulses")
    refused(activefail(*words, campaign), "must be a campaign under records, with a variable that has a `set`")
    refused(activefail(*words, campaign, "--rim", "none"), "model: cannot be combined with --campaign without")
    other = activefail(*words, campaign, "--pulses", "--slider-diameter", "0.4")
    refused(other, "--campaign: its [bearing] settings differ from this command's options")


def test_levels_begin_at_a_prediction_and_bracket_the_capacity() -> None:
    """Whatever the prediction, and whatever is known; levels without an outcome are not simulated again."""
    capacity, lost = np.array([0.8, 1.0, 3.0, 9.0, 0.01, 2.0, 2.0]), (5, 2.0)
    asked: list[tuple[int, float]] = []

    def simulate(runs: Runs) -> Answers:
        asked.extend(runs)
        outcome = [2 if level >= capacity[k] else 0 for k, level in runs]
        outcome = [NUMERICAL_FAILURE if one == lost else value for one, value in zip(runs, outcome, strict=True)]
        return Answers(np.array(outcome, dtype=np.int8), np.zeros(len(runs), dtype=bool))

    none = np.empty(0), np.empty(0, dtype=np.int8)
    known = [none] * 6 + [(np.array([1.0, 1.98, 2.01]), np.array([0, 0, 2], dtype=np.int8))]
    starts = np.array([0.82, 1.0, 1.5, 2.0, 1.0, 2.0, 4.0])
    found = capacities_near(simulate, known, starts, (0.25, 4.0), 2)
    runs = np.bincount([k for k, _ in asked], minlength=7)
    inside = found.capacity[[0, 1, 2, 5]] / found.below[[0, 1, 2, 5]]
    assert (inside < 1.025).all()
    assert ((found.below < capacity) & (capacity <= found.capacity))[[0, 1, 2, 5, 6]].all()
    assert (found.below[3], found.capacity[3]) == (4.0, np.inf)
    assert (found.below[4], found.capacity[4]) == (0.0, 0.25)
    assert runs[[0, 1, 6]].tolist() == [4, 4, 0]
    assert len(set(asked)) == len(asked)
    assert runs.max() < LADDER + BISECTIONS
    again = capacities_near(simulate, list(zip(found.levels, found.outcomes, strict=True)), starts, (0.25, 4.0), 2)
    assert again.runs == found.runs


@pytest.mark.parametrize("start", [0.5, 1.0, 1.2, 1.6, 4.0])
def test_runs_without_an_outcome_near_a_capacity_do_not_hide_it(start: float) -> None:
    def simulate(runs: Runs) -> Answers:
        levels = np.array([level for _, level in runs])
        outcome = np.where(levels < 1.3, 0, 2).astype(np.int8)
        outcome[((levels > 1.08) & (levels < 1.12)) | ((levels > 1.3) & (levels < 1.37))] = NUMERICAL_FAILURE
        return Answers(outcome, np.zeros(len(levels), dtype=bool))

    none = np.empty(0), np.empty(0, dtype=np.int8)
    found = capacities_near(simulate, [none], np.array([start]), (0.25, 4.0), 2)
    assert found.below[0] < 1.3 < found.capacity[0] < 2.0


@pytest.mark.parametrize(("to", "reached", "advice"), [("0.05", 0, "Raise"), ("1e6", 8, "Lower")])
def test_a_set_of_which_all_survive_or_fail_at_every_level_has_no_curve_and_says_so(
    case: Path, to: str, reached: int, advice: str
) -> None:
    result = activefail("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--to", to)
    assert result.code == 0
    assert f"{reached} of 8 records reach it" in result.out
    assert f"so there is no curve. {advice} the levels with --to." in result.out
    assert "median" not in result.out


def test_an_interrupted_analysis_continues_to_the_same_numbers(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--out")
    assert activefail(*words, tmp_path / "whole").code == 0
    real, asked = module.simulate_records, list[int]()

    def stopping(X, *arguments):
        if len(asked) == 2:
            raise KeyboardInterrupt
        asked.append(len(X))
        return real(X, *arguments)

    monkeypatch.setattr(module, "simulate_records", stopping)
    stopped = activefail(*words, tmp_path / "stopped")
    assert (stopped.code, stopped.err) == (130, "activefail: stopped; the same command continues\n")
    assert "nothing is kept without --out" in activefail(*words[:-1]).err
    monkeypatch.setattr(module, "simulate_records", lambda X, *rest: asked.append(len(X)) or real(X, *rest))
    assert activefail(*words, tmp_path / "stopped").code == 0
    assert (tmp_path / "stopped" / "ida.json").read_bytes() == (tmp_path / "whole" / "ida.json").read_bytes()
    assert sum(asked) == json.loads((tmp_path / "whole" / "ida.json").read_text())["simulations"]
    # Another outcome of the same simulations needs only those of its own bisections.
    asked.clear()
    assert activefail(*words, tmp_path / "stopped", "--outcome", "impact").code == 0
    assert sum(asked) <= 5 * 8


@pytest.fixture
def plate(case: Path, tmp_path: Path) -> Path:
    """A campaign under the eight records, whose plate bends by its own rule."""
    (tmp_path / "plate.toml").write_text(
        'simulator = { python = "plate:run", outcomes = ["fine", "bent", "broken"] }\n'
        "[space]\nstrength = { low = 0.5, high = 2.0 }\nmass = { value = 2.0 }\n"
        "record = { low = 0.0, high = 8.0 }\nPGV = { low = 0.1, high = 3.0 }\n"
        "[sampling]\ninitial = 8\nbudget = 16\n"
    )
    (tmp_path / "plate.py").write_text(
        "def run(design):\n"
        "    if design['PGV'] > 3.9:\n"
        "        raise ValueError('too strong')\n"
        "    x = design['PGV'] * design['mass'] / design['strength'] / (1.0 + 0.1 * int(design['record']))\n"
        "    return 'broken' if x > 2.0 else 'bent' if x > 1.0 else 'fine'\n"
    )
    (tmp_path / "strength.toml").write_text("strength = 1.5\n")
    return tmp_path


def test_the_simulator_of_a_campaign_under_records_takes_the_bearings_place(case: Path, plate: Path) -> None:
    words = ("ida", "--records", case / "set", "--simulator", plate / "plate.toml", "--bearing", plate)
    words = (*words[:-1], plate / "strength.toml", "--workers", "1", "--out", plate / "out")
    result = activefail(*words, "--json", "--outcome", "bent")
    assert result.code == 0, result.err
    numbers = json.loads(result.out)
    # The rule's own capacities: PGV = strength / mass times the record's factor.
    capacities = [record["capacity"] for record in numbers["records"]]
    assert capacities == pytest.approx(0.75 * (1.0 + 0.1 * np.arange(8)), rel=0.03)
    assert (numbers["bearing"], numbers["simulator"]) == ({"mass": 2.0, "strength": 1.5}, "plate.toml")
    assert (numbers["model"], numbers["events"], numbers["records"][7]["event"]) == (None, 4, "3")
    assert [record["numerical_failures"] for record in numbers["records"]] == [1] * 8
    assert [note for note in numbers["notes"] if "too strong" in note]
    # The most severe outcome is the default, and needs no level of the ladder again but those without an outcome.
    worst = activefail(*words)
    assert "broken      8 of 8 records reach it" in worst.out, worst.err


def test_what_is_no_campaign_under_these_records_is_refused(case: Path, plate: Path) -> None:
    words = ("ida", "--records", case / "set", "--bearing", plate / "strength.toml", "--simulator")
    settings = (plate / "plate.toml").read_text()
    for old, new, message in (
        ("high = 8.0", "high = 7.0", "--records: must be the 7 records of the campaign, got 8."),
        ("PGV", "velocity", "with a variable that has a `set`, or the variables record and PGV; got"),
    ):
        (plate / "other.toml").write_text(settings.replace(old, new))
        refused(activefail(*words, plate / "other.toml"), message)
    for options, message in (
        (("--pulses",), "--pulses: cannot be combined with --simulator."),
        (("--scale-to", "pga"), "--scale-to: must be pgv with this campaign, got 'pga'."),
        (("--rim", "none"), "--slider-diameter or"),
    ):
        refused(activefail(*words, plate / "plate.toml", *options), message)


def test_a_simulator_whose_code_changed_is_simulated_again(case: Path, plate: Path) -> None:
    words = ("ida", "--records", case / "set", "--workers", "1", "--out", plate / "out", "--json")
    words = (*words, "--bearing", plate / "strength.toml", "--simulator", plate / "plate.toml")
    before = json.loads(activefail(*words).out)
    code = (plate / "plate.py").read_text()
    (plate / "plate.py").write_text(code.replace("x > 2.0", "x > 1.5"))
    assert json.loads(activefail(*words).out)["median"] == pytest.approx(0.75 * before["median"], rel=0.05)
    assert len(list((plate / "out").glob("simulations-*.json"))) == 2


def test_python_finds_the_numbers_of_the_command(case: Path, plate: Path, campaign: Path) -> None:
    records, words = af.read_record_set(str(case / "set")), ("--records", case / "set", "--json")
    margin = af.MarginRequest(mce=0.8)
    with open_run(campaign) as run:
        found = af.ida(BEARING.tolist(), records, margin=margin, pulses=True, run=run, folder=plate / "new" / "out")
    options = ("--bearing", case / "bearing.toml", "--mce", "0.8", "--pulses", "--campaign", campaign)
    assert json_text({"version": 1, **found.as_json()}) == activefail("ida", *words, *options).out.rstrip("\n")
    other = af.ida({"strength": 1.5}, records, outcome="bent", simulator=plate / "plate.toml", workers=1)
    options = ("--bearing", plate / "strength.toml", "--simulator", plate / "plate.toml", "--outcome", "bent")
    assert json_text({"version": 1, **other.as_json()}) == activefail("ida", *words, *options).out.rstrip("\n")
    with pytest.raises(InputError, match=r"bearing: must be the seven values T_b, .*, k, got shape \(9,\)"):
        af.ida(np.ones(9), records)


def test_a_simulator_that_never_answers_is_named(case: Path, plate: Path) -> None:
    (plate / "plate.py").write_text("def run(design):\n    raise ValueError('no licence')\n")
    words = ("--bearing", plate / "strength.toml", "--simulator", plate / "plate.toml", "--workers", "1")
    result = activefail("ida", "--records", case / "set", *words)
    assert result.code == 1
    assert "None of 4 simulations gave an outcome." in result.err
    assert "no licence" in result.err


def test_the_output_folder_is_made_before_any_simulation(case: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "simulate_records", lambda *_: pytest.fail("simulated first"))
    words = ("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--out")
    refused(activefail(*words, case / "bearing.toml"), "bearing.toml must be a folder, but is a file.")
    refused(activefail(*words, case / "set" / ".." / "set"), "--out: must differ from --records")


def test_model_and_tolerance_are_those_of_the_options(case: Path) -> None:
    words = ("ida", "--records", case / "set", "--bearing", case / "bearing.toml", "--json")
    usual = json.loads(activefail(*words).out)
    assert (usual["tolerance"], usual["model"]["slider_diameter"]) == (1e-4, 0.3)
    assert usual["bearing"] == dict(zip(TABLE_1.names, BEARING.tolist(), strict=False))
    # A slider of twice the diameter has rims twice as high.
    changed = json.loads(activefail(*words, "--slider-diameter", "0.6", "--tolerance", "1e-6").out)
    assert (changed["tolerance"], changed["model"]["slider_diameter"]) == (1e-6, 0.6)
    assert changed["median"] > 1.02 * usual["median"]
    accurate = json.loads(activefail(*words, "--tolerance", "1e-6").out)
    assert accurate["median"] == pytest.approx(usual["median"], rel=0.01)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (TOML, ("--outcome", "collapse"), "outcome: must be one of impact, failure, got 'collapse'"),
        (TOML, ("--to", "1e75"), "scale: must keep accelerations"),
        (TOML.replace("p = 45\n", ""), (), "bearing.toml: requires p."),
        (TOML + "T_p = 2.0\n", (), "bearing.toml: T_p: belongs to a pulse"),
    ],
)
def test_options_or_a_bearing_that_break_a_rule_are_refused(
    case: Path, tmp_path: Path, text: str, options: tuple[str, ...], message: str
) -> None:
    (tmp_path / "bearing.toml").write_text(text)
    refused(activefail("ida", "--records", case / "set", "--bearing", tmp_path / "bearing.toml", *options), message)
