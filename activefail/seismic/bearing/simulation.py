"""Integrates bearings until they fail or their outcome is settled, and follows whether a lifted plate comes down inside
its rims: a single response, or a batch on all cores."""

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError, naming
from activefail.seismic.bearing import outcome as o
from activefail.seismic.bearing.accelerogram import STILL, Accelerogram
from activefail.seismic.bearing.barrier import barrier
from activefail.seismic.bearing.course import (
    at_sample,
    from_sample,
    is_over,
    longest_step,
    rises,
    shaking,
    to_come,
)
from activefail.seismic.bearing.design import GRAVITY, TABLE_1, Bearing, Model, Pulse, Tolerance, check_designs
from activefail.seismic.bearing.dynamics import COORDINATES, energy, equilibrium, system
from activefail.seismic.bearing.integrator import ACCEPTED, TOO_MANY_STEPS, Control, acceleration, advance, start
from activefail.seismic.bearing.kernels import KERNEL, check_compiled, kernel
from activefail.seismic.bearing.rims import most_deformed, yielded
from activefail.space.space import Array

FREE_PERIODS = 2.5
"""Duration of a run after the pulse, in T_b."""

EVENT_STEP = 0.01
"""Longest step while a plate has no contact or a vertex is on a rim [s]: events are detected at the ends of steps."""

HISTORY = 1 + 3 * COORDINATES + 4
"""Columns of a history: time, coordinates, velocities, accelerations, deformations of the rims."""


SCALE_Q, SCALE_V = (0.1, 0.1, 0.2, 0.025, 0.025), (1.0, 1.0, 2.0, 0.25, 0.25)
"""Coordinates [m, rad] and velocities below which errors are absolute: of the order of sliding motions.

Errors of the plate weigh four times those of the light slider: energy and outcome depend on the plate. A rotation of
the slider by one radian moves a vertex by at most half a metre.
"""


class KernelResult(NamedTuple):
    """The kernel's result of one simulation."""

    outcome: int
    cause: int
    margins: o.Margins
    statistics: o.Statistics
    recorded: int  # rows of a complete history, which may exceed the rows available


@kernel(**KERNEL)
def _record(history, row, system, state):
    """Write a state into a row of the history, if the row exists."""
    if row < history.shape[0]:
        a = acceleration(system, state.t, state.q, state.v)
        history[row, 0] = state.t
        for i in range(COORDINATES):
            history[row, 1 + i] = state.q[i]
            history[row, 6 + i] = state.v[i]
            history[row, 11 + i] = a[i]
        history[row, 16], history[row, 17] = system.bottom.left, system.bottom.right
        history[row, 18], history[row, 19] = system.top.left, system.top.right


@kernel(nogil=True, **KERNEL)
def integrate(system, samples, capacity, free_time, confinement, tolerance, longest, most, to_the_end, history):
    """Integrate one bearing from rest until it fails, its outcome is settled or, with `to_the_end`, its time is over.

    `samples` are those of an accelerogram, None for a pulse.

    The accepted steps are written to `history`, shape (rows, 20), as far as it has rows. Returns a `KernelResult`.
    """
    t, motion_end, first = shaking(system, samples)
    end = motion_end + free_time
    sample = 0
    state = start(t, first, equilibrium(system), (0.0, 0.0, 0.0, 0.0, 0.0))
    control = Control(tolerance, SCALE_Q, SCALE_V, most)

    weight = system.plate_mass * GRAVITY
    strength, deformed = system.bottom.strength, 0.0
    levels = barrier(system, confinement)
    # √(kinetic energy) increases by at most this factor times the ground's impulse.
    growth = math.sqrt(0.5 * (system.plate_mass + system.slider_mass))
    at_rest, seen_before = o.examine(system, t, state.q, state.v)
    before = at_rest
    work_in, dissipated, peak_work, peak_imbalance = 0.0, 0.0, 0.0, 0.0

    first_touch_time, first_touch_velocity, failure_time = math.nan, math.nan, math.nan
    peak_displacement, peak_rim_force, peak_gap, peak_tilt = 0.0, 0.0, 0.0, 0.0
    outcome, cause, touched, rows = o.NO_IMPACT, o.NONE, False, 0
    # A plate that vertical motion lifts may come down on the slider; one that a rim throws off is lost (records.md).
    lifts = rises(samples)
    thrown = not lifts
    while True:
        sample = at_sample(samples, t, sample)
        now = from_sample(system, samples, sample)
        _record(history, rows, now, state)
        rows += 1
        if t >= end:
            break
        # The outcome is settled after an impact if failure is impossible, and after the pulse if a rim touch is.
        if (touched or is_over(samples, t, motion_end)) and not to_the_end:
            # A rim breaks only at a touch, after the plastic work that it can still do.
            fracture = levels.touch + strength * (system.rim_deformation - deformed)
            reach = min(levels.failure, fracture if touched else levels.touch)
            pushed = growth * to_come(now, samples, t, sample)
            if math.sqrt(max(0.0, before.stored - levels.least)) + pushed < math.sqrt(reach - levels.least):
                break
        bound = longest_step(now, samples, t, state.step, sample, motion_end, longest)
        if seen_before.confinement_gap > 0.0 or seen_before.touch > 0.0:
            bound = min(bound, EVENT_STEP)
        began = state.q
        status, state, middle_q, middle_v = advance(now, state, control, min(bound, end - t))
        if status != ACCEPTED:
            outcome, cause = o.NUMERICAL_FAILURE, o.STEPS if status == TOO_MANY_STEPS else o.UNDERFLOW
            break
        step = state.t - t
        t = state.t
        after, seen = o.examine(now, t, state.q, state.v)
        if not math.isfinite(after.stored):
            outcome, cause = o.NUMERICAL_FAILURE, o.NOT_FINITE
            break

        halfway, seen_middle = o.examine(now, t - 0.5 * step, middle_q, middle_v)
        peak_displacement = max(peak_displacement, abs(state.q[3]), abs(middle_q[3]))
        peak_rim_force = max(peak_rim_force, seen.rim_force, seen_middle.rim_force)
        peak_gap = max(peak_gap, seen.confinement_gap)
        peak_tilt = max(peak_tilt, seen.tilt)
        if seen.touch > 0.0 and not touched:
            touched, outcome = True, o.IMPACT
            fraction = o.crossing(seen_before.touch, seen.touch, 0.0)
            first_touch_time = t - (1.0 - fraction) * step
            slowing = seen_before.touch_velocity - seen.touch_velocity
            first_touch_velocity = seen.touch_velocity + (1.0 - fraction) * slowing
        if lifts and seen.confinement_gap <= system.rim_height:
            clear = seen.confinement_gap <= 0.0 and seen.touch <= -system.rim_height
            thrown = seen.touch > 0.0 or (thrown and not clear)
        cause = o.failure_cause(seen, system, confinement and thrown)
        if max(seen.rim_demand, seen_middle.rim_demand) > strength:
            system = yielded(system, began, middle_q, middle_v, 0.5 * step)
            system = yielded(system, middle_q, state.q, state.v, 0.5 * step)
            deformed, stored = most_deformed(system), after.stored
            now = from_sample(system, samples, sample)
            after = energy(now, t, state.q, state.v)
            dissipated += stored - after.stored
            if cause == o.NONE and deformed == math.inf:
                cause = o.RIM_FRACTURE

        work_in += step / 6.0 * (before.input + 4.0 * halfway.input + after.input)
        dissipated += step / 6.0 * (before.dissipation + 4.0 * halfway.dissipation + after.dissipation)
        peak_work = max(peak_work, abs(work_in))
        # A vertex that escapes over the rim removes the rim's elastic energy from the balance.
        if cause != o.ESCAPE:
            peak_imbalance = max(peak_imbalance, abs(after.stored - at_rest.stored - work_in + dissipated))
        if cause != o.NONE:
            # A slider leaves a dish without a rim untouched.
            if touched or lifts or system.bottom.rim_top == -math.inf:
                outcome = o.FAILURE
                failure_time = t - (1.0 - o.failure_fraction(seen_before, seen, cause, system)) * step
            else:
                outcome, cause = o.NUMERICAL_FAILURE, o.NO_TOUCH
            _record(history, rows, now, state)
            rows += 1
            break
        before, seen_before = after, seen

    margins = o.Margins(
        first_touch_time=first_touch_time,
        first_touch_velocity=first_touch_velocity,
        peak_displacement_ratio=peak_displacement / capacity,
        peak_rim_force_ratio=peak_rim_force / weight,
        peak_gap_ratio=peak_gap / system.rim_height,
        peak_tilt=peak_tilt,
        failure_time=failure_time,
        end_time=t,
    )
    statistics = o.Statistics(
        energy_error=peak_imbalance / max(peak_work, weight * 1e-3),
        steps=state.attempts,
        rejected_steps=state.rejections,
        evaluations=state.evaluations,
    )
    return KernelResult(outcome, cause, margins, statistics, rows)


def _simulate(
    bearing: Bearing,
    pulse: Pulse | Accelerogram,
    model: Model,
    tolerance: Tolerance,
    history: Array,
    to_the_end: bool = False,
) -> KernelResult:
    # T_b as in the paper's eq. 2, without the slider's height.
    free_time = FREE_PERIODS * 2.0 * math.pi * math.sqrt(2.0 * bearing.radius / GRAVITY)
    run: KernelResult = integrate(
        system(bearing, pulse if isinstance(pulse, Pulse) else STILL, model),
        None if isinstance(pulse, Pulse) else pulse.samples,
        bearing.displacement_capacity,
        free_time,
        model.loss_of_confinement,
        tolerance.relative,
        tolerance.longest_step,
        int(tolerance.most_steps),
        to_the_end,
        history,
    )
    return run


@dataclass(frozen=True)
class Response:
    """The outcome of one simulation and its motion.

    Attributes:
        outcome: 0 no impact, 1 impact, 2 failure, -1 numerical failure.
        cause: index into `activefail.seismic.bearing.outcome.CAUSES`.
        margins: limit-state margins and other observations of the motion.
        statistics: statistics of the solver.
        t: (n,) times of the accepted steps, 0 at the pulse's centre or at the record's first sample [s].
        q: (n, 5) x_s, z_s, theta, x_t, z_t [m, rad].
        v: (n, 5) their velocities [m/s, rad/s].
        a: (n, 5) their accelerations relative to the ground [m/s2, rad/s2].
        rims: (n, 4) plastic deformations of the rims' arcs, bottom left and right, top left and right [m]; infinite for
            a broken one.
    """

    bearing: Bearing
    pulse: Pulse | Accelerogram
    model: Model
    outcome: int
    cause: int
    margins: o.Margins
    statistics: o.Statistics
    t: Array
    q: Array
    v: Array
    a: Array
    rims: Array

    @property
    def outcome_name(self) -> str:
        """One of `activefail.seismic.bearing.outcome.OUTCOME_NAMES`."""
        return o.OUTCOME_NAMES[self.outcome]

    @property
    def cause_name(self) -> str:
        """Why the bearing failed or the simulation was abandoned; empty otherwise."""
        return o.CAUSES[self.cause]


@dataclass(frozen=True)
class Responses:
    """Outcomes of n simulations.

    Attributes:
        outcome: (n,) int8: 0 no impact, 1 impact, 2 failure, -1 numerical failure.
        cause: (n,) int8, index into `activefail.seismic.bearing.outcome.CAUSES`.
        margins: (n, 8) float64, columns as in `activefail.seismic.bearing.outcome.Margins`.
        statistics: (n, 4) float64, columns as in `activefail.seismic.bearing.outcome.Statistics`.
        seconds: (n,) float64, wall time of each simulation [s].
    """

    outcome: NDArray[np.int8]
    cause: NDArray[np.int8]
    margins: Array
    statistics: Array
    seconds: Array

    @property
    def outcome_name(self) -> NDArray[np.str_]:
        """Names of the outcomes, shape (n,)."""
        return np.array(o.OUTCOME_NAMES)[self.outcome]

    @property
    def cause_name(self) -> NDArray[np.str_]:
        """Names of the causes, shape (n,)."""
        return np.array(o.CAUSES)[self.cause]

    @property
    def columns(self) -> Array:
        """Margins, then statistics, as in `activefail.seismic.bearing.outcome.COLUMNS`, shape (n, 12)."""
        return np.hstack((self.margins, self.statistics))

    def margin(self, name: str) -> Array:
        """One margin by name, shape (n,)."""
        return self.margins[:, o.Margins._fields.index(name)]

    def statistic(self, name: str) -> Array:
        """One of the solver's statistics by name, shape (n,)."""
        return self.statistics[:, o.Statistics._fields.index(name)]


def simulate_one(
    bearing: Bearing,
    pulse: Pulse | Accelerogram,
    model: Model | None = None,
    tolerance: Tolerance | None = None,
    to_the_end: bool = False,
) -> Response:
    """Simulate one bearing under one pulse or record and keep its motion.

    Args:
        bearing: the bearing.
        pulse: the ground motion, a pulse or a record.
        model: settings of the model.
        tolerance: accuracy of the integration.
        to_the_end: whether to continue, unlike `simulate`, until 2.5 T_b after the pulse once the outcome is settled.

    Raises:
        InputError: if `NUMBA_DISABLE_JIT` is set.
    """
    check_compiled()
    model, tolerance = model or Model(), tolerance or Tolerance()
    history = np.empty((4096, HISTORY))
    run = _simulate(bearing, pulse, model, tolerance, history, to_the_end)
    if run.recorded > len(history):
        history = np.empty((run.recorded, HISTORY))
        run = _simulate(bearing, pulse, model, tolerance, history, to_the_end)
    history = history[: run.recorded]
    return Response(
        bearing,
        pulse,
        model,
        outcome=run.outcome,
        cause=run.cause,
        margins=run.margins,
        statistics=run.statistics,
        t=history[:, 0],
        q=history[:, 1:6],
        v=history[:, 6:11],
        a=history[:, 11:16],
        rims=history[:, 16:],
    )


def _design(row: int, values: list[float], model: Model) -> tuple[Bearing, Pulse]:
    with naming(f"Row {row}: "):
        return Bearing.from_row(values, model.slider_diameter), Pulse.from_table(*values[7:])


@contextmanager
def _mapping(threads: int) -> Iterator[Callable[..., Iterable[int]]]:
    """`map` over threads; with one thread, on the calling thread."""
    if threads == 1:
        yield map
        return
    with ThreadPoolExecutor(threads) as pool:
        try:
            yield pool.map
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def simulate(
    X: Array,
    model: Model | None = None,
    tolerance: Tolerance | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Responses:
    """Simulate a batch of designs on all cores; a row's result depends neither on other rows nor on the threads.

    A run ends at failure, after 2.5 T_b of free motion, or as soon as the energy settles its outcome: after an impact
    when the bearing can no longer fail, without one when the pulse is over and no rim can be touched. The margins cover
    the run only: a bearing with an impact may still swing further than its `peak_displacement_ratio`.

    Args:
        X: (n, 9) designs: T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5], T_p [s], A_p [g].
        model: settings of the model.
        tolerance: accuracy of the integration.
        threads: number of threads; None uses all cores.
        progress: called with the number of newly completed rows, from the calling thread.

    Raises:
        InputError: if `NUMBA_DISABLE_JIT` is set, X has the wrong shape, an entry breaks a rule (the text names row,
            column, rule and value), a row's bearing cannot be built, or `threads` is not positive.
    """
    check_compiled()
    X = check_designs(X)
    model = model or Model()
    designs = [_design(row, values, model) for row, values in enumerate(X.tolist())]
    return _simulated(designs, model, tolerance or Tolerance(), threads, progress)


def simulate_records(
    X: Array,
    records: Sequence[Accelerogram],
    model: Model | None = None,
    tolerance: Tolerance | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    to_the_end: bool = False,
) -> Responses:
    """Simulate bearings under records on all cores; as `simulate`, with one record for each row.

    Without a rim touch a run ends as soon as the energy to come cannot reach a rim, at any time of the record. The
    margins of such a run cover only what was simulated.

    Args:
        X: (n, 7) bearings: T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5].
        records: n records; `Accelerogram.scaled` scales one.
        model, tolerance, threads, progress: as for `simulate`.
        to_the_end: whether to continue once the outcome is settled, as for `simulate_one`.

    Raises:
        InputError: as `simulate` does, or if the numbers of bearings and records differ.
    """
    check_compiled()
    X = np.asarray(X)
    if X.ndim != 2 or X.shape[1] != TABLE_1.dimension - 2:
        raise InputError(
            f"bearings: must be an array of shape (n, {TABLE_1.dimension - 2}) with the columns "
            f"{', '.join(TABLE_1.names[:-2])}, got shape {X.shape}."
        )
    if len(records) != len(X):
        raise InputError(f"records: must be {len(X)}, one for each bearing, got {len(records)}.")
    # Values of a pulse that every check accepts; a record takes its place.
    X = check_designs(np.column_stack([X, np.ones((len(X), 2))]))
    model = model or Model()
    bearings = [_design(row, values, model)[0] for row, values in enumerate(X.tolist())]
    return _simulated(
        list(zip(bearings, records, strict=True)), model, tolerance or Tolerance(), threads, progress, to_the_end
    )


def _simulated(
    designs: Sequence[tuple[Bearing, Pulse | Accelerogram]],
    model: Model,
    tolerance: Tolerance,
    threads: int | None,
    progress: Callable[[int], None] | None,
    to_the_end: bool = False,
) -> Responses:
    if threads is not None and threads < 1:
        raise InputError(f"`threads` must be at least 1, got {threads}.")
    n = len(designs)
    outcome, cause, seconds = np.empty(n, dtype=np.int8), np.empty(n, dtype=np.int8), np.empty(n)
    margins, statistics = np.empty((n, len(o.Margins._fields))), np.empty((n, len(o.Statistics._fields)))
    no_history = np.empty((0, HISTORY))

    def run(rows: range) -> int:
        for row in rows:
            began = time.perf_counter()
            answer = _simulate(*designs[row], model, tolerance, no_history, to_the_end)
            outcome[row], cause[row] = answer.outcome, answer.cause
            margins[row], statistics[row] = answer.margins, answer.statistics
            seconds[row] = time.perf_counter() - began
        return len(rows)

    if designs:
        # Compile on one thread, before timing starts.
        _simulate(*designs[0], model, Tolerance(most_steps=1), no_history)
    # Short chunks: a keyboard interrupt waits for the running ones only.
    chunks = [range(first, min(first + 16, n)) for first in range(0, n, 16)]
    with _mapping(threads or os.cpu_count() or 1) as mapped:
        for done in mapped(run, chunks):
            if progress is not None:
                progress(done)
    return Responses(outcome, cause, margins, statistics, seconds)
