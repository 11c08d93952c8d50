"""`ida` and `ida_of_campaign`: incremental dynamic analysis of a bearing, or of what a campaign simulates."""

import math
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from activefail.accelerogram_sets import RecordSet
from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import TABLE_1, Model, Tolerance
from activefail.bearing.outcome import OUTCOMES
from activefail.errors import InputError
from activefail.files import writing_to
from activefail.progress import Begin, uncounted
from activefail.risk.ida.capacity import BISECTIONS, LEVELS, Capacities, Simulate, capacities, ladder, on_ladder
from activefail.risk.ida.collapse import Fragility, fitted
from activefail.risk.ida.equivalent_pulse import EquivalentPulse, compare_pulses, equivalent_pulse
from activefail.risk.ida.findings import IdaFindings
from activefail.risk.ida.intensity import Intensity, unscaled
from activefail.risk.ida.kept import Kept
from activefail.risk.ida.p695 import Margin, MarginOptions, MarginRequest, collapse_margin
from activefail.risk.ida.predictions import Agreement, Learned, Prediction, Surrogate, predicted_by_reduced_model
from activefail.risk.ida.simulations import BearingUnderRecords, CampaignSimulations, CampaignUnderRecords
from activefail.space import Array

if TYPE_CHECKING:
    from activefail.execution.executor import Executor

KEPT, KEPT_OF_PULSES = "simulations.json", "simulations-of-pulses.json"
"""Files of an analysis from which it continues."""


def ida(
    bearing: Sequence[float] | Array,
    records: RecordSet,
    scale_to: Intensity | str = "pgv",
    outcome: str | None = None,
    to: float | None = None,
    margin: MarginRequest | None = None,
    pulses: bool = False,
    run: Learned | None = None,
    model: Model | None = None,
    tolerance: Tolerance | None = None,
    workers: int | None = None,
    begin: Begin = uncounted,
    folder: str | Path | None = None,
) -> IdaFindings:
    """Find the intensity at which a bearing fails, for each record of a set.

    Args:
        bearing: (7,) T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5].
        records: the set (`read_record_set`).
        scale_to: intensity by which records are scaled: "factor", "pga" [g], "pgv" [m/s], "sa:T" [g] with a period
            T [s], or "p695": all by one factor, to the spectral acceleration S_T(T_b) [g] of their set.
        outcome: "impact" or "failure", which is the default; worse outcomes count too.
        to: highest level of the intensity; by default 8, 3 g, 4 m/s, 2 g, or 12 times the set's.
        margin: the collapse margin of FEMA P695; None for none.
        pulses: whether to compare the records with their equivalent pulses, and with predictions.
        run: of a campaign under pulses, whose classifier predicts the outcomes under the equivalent pulses.
        model, tolerance: as for `simulate_records`.
        workers: number of threads; all cores if None.
        begin: called with the largest number of simulations; returns a callback for finished ones.
        folder: for the files from which an interrupted analysis continues; None keeps none.

    Raises:
        InputError: if an argument is invalid, or the folder has simulations of another analysis.
    """
    bearing = np.asarray(bearing, dtype=np.float64)
    if bearing.shape != (7,):
        raise InputError(
            f"bearing: must be the seven values {', '.join(TABLE_1.names[:7])}, got shape {bearing.shape}."
        )
    outcome = OUTCOMES[-1] if outcome is None else outcome
    intensity = Intensity.of(scale_to) if isinstance(scale_to, str) else scale_to
    intensity = intensity.on(float(bearing[0]), records.of_p695)
    severity, model, tolerance = _severity(outcome, OUTCOMES), model or Model(), tolerance or Tolerance()
    surrogate = None if run is None else Surrogate.of(run, severity, model)
    collective = intensity.kind == "p695"
    options = None if margin is None else margin.options(float(bearing[0]), records.of_p695, collective)
    motions = [record.motion for record in records.records]
    levels = ladder(intensity, to)
    intensities = unscaled(intensity, motions, float(levels[-1]))
    _make(folder)
    progress = begin(len(motions) * (LEVELS + BISECTIONS) * (2 if pulses else 1))

    def capacities_under(ground: Sequence[Accelerogram], name: str) -> Capacities:
        simulate = BearingUnderRecords(bearing, ground, intensities, model, tolerance, workers, progress)
        kept: Simulate = simulate
        if folder is not None:
            kept = Kept(simulate, Path(folder) / name, simulate.identity, progress)
        return capacities(kept, len(ground), levels, BISECTIONS, severity)

    of_records = capacities_under(motions, KEPT)
    fragility, margin_found = _curve(of_records, records, options)
    compared = None
    predictions: tuple[Prediction, ...] = ()
    if pulses:
        nearest = [equivalent_pulse(motion) for motion in motions]
        of_pulses = capacities_under([one.motion for one in nearest], KEPT_OF_PULSES)
        events = [record.event for record in records.records]
        compared = compare_pulses(nearest, of_pulses, of_records, events, levels, severity)
        predictions = _predictions(
            bearing, motions, nearest, surrogate, of_records, intensities, levels, severity, model
        )
    values = dict(zip(TABLE_1.names, bearing.tolist(), strict=False))
    return IdaFindings(
        values,
        model,
        tolerance,
        records,
        intensity,
        OUTCOMES,
        outcome,
        of_records,
        fragility,
        margin_found,
        options,
        compared,
        predictions,
    )


def ida_of_campaign(
    asked: CampaignUnderRecords,
    outcome: str | None = None,
    to: float | None = None,
    margin: MarginRequest | None = None,
    workers: int | None = None,
    executor: "Executor | None" = None,
    begin: Begin = uncounted,
    folder: str | Path | None = None,
) -> IdaFindings:
    """Find the peak ground velocity at which what a campaign simulates, such as a building, fails, for each record.

    Args:
        asked: campaign, values and records (`campaign_under_records`).
        outcome: one of the campaign's, the most severe if None; worse outcomes count too.
        to: highest level [m/s]; 4 by default.
        margin: as for `ida`.
        workers: number of processes, or of threads for a compiled simulator; all cores if None.
        executor: runs the simulations; None for `workers` on this machine.
        begin, folder: as for `ida`.

    Raises:
        InputError: as `ida` does.
        SimulationError: if no simulation gives an outcome, or as the executor does.
    """
    from activefail.execution.local import local_executor

    campaign, records = asked.campaign, asked.records
    outcomes = tuple(campaign.simulator.outcomes)
    outcome = outcomes[-1] if outcome is None else outcome
    severity, intensity = _severity(outcome, outcomes), Intensity("pgv")
    values = {**campaign.space.fixed, **asked.values}
    options = None if margin is None else margin.options(values.get("T_b", math.nan), records.of_p695, False)
    levels = ladder(intensity, to)
    unscaled(intensity, [record.motion for record in records.records], float(levels[-1]))
    _make(folder)
    progress = begin(len(records.records) * (LEVELS + BISECTIONS))
    local = nullcontext(executor) if executor else local_executor(campaign.simulator, workers, campaign.time_limit)
    with local as pool:
        simulate = CampaignSimulations(asked, pool, progress)
        ask: Simulate = simulate
        if folder is not None:
            ask = kept = Kept(simulate, Path(folder) / KEPT, simulate.identity, progress)
            simulate.answered = bool(kept.read())
        of_records = capacities(ask, len(records.records), levels, BISECTIONS, severity)
    fragility, margin_found = _curve(of_records, records, options)
    return IdaFindings(
        values,
        None,
        None,
        records,
        intensity,
        outcomes,
        outcome,
        of_records,
        fragility,
        margin_found,
        options,
        simulator=asked.name,
        fault=simulate.first_fault,
    )


def _make(folder: str | Path | None) -> None:
    """Make the folder of the kept simulations.

    Raises:
        InputError: if it cannot be made.
    """
    if folder is not None:
        with writing_to(Path(folder)):
            Path(folder).mkdir(parents=True, exist_ok=True)


def _severity(outcome: str, outcomes: Sequence[str]) -> int:
    """The severity of an outcome.

    Raises:
        InputError: if it is not one of the outcomes, or the least severe.
    """
    if outcome not in outcomes[1:]:
        raise InputError(f"--outcome: must be one of {', '.join(outcomes[1:])}, got {outcome!r}.")
    return list(outcomes).index(outcome)


def _curve(
    of_records: Capacities, records: RecordSet, options: MarginOptions | None
) -> tuple[Fragility | None, Margin | None]:
    """The curve of the capacities, and its margin if it has options."""
    fragility = fitted(of_records.below, of_records.capacity, [record.event for record in records.records])
    if fragility is None or options is None:
        return fragility, None
    return fragility, collapse_margin(fragility.fit.median, options.mce, options.shape_factor, options.total_dispersion)


def _predictions(
    bearing: Array,
    motions: Sequence[Accelerogram],
    pulses: Sequence[EquivalentPulse],
    surrogate: Surrogate | None,
    of_records: Capacities,
    intensities: Array,
    levels: Array,
    severity: int,
    model: Model,
) -> tuple[Prediction, ...]:
    """What predicts the outcomes at the ladder's levels without simulating them."""
    outcome = on_ladder(of_records, levels).ravel()
    which, factors = np.repeat(np.arange(len(motions)), len(levels)), (levels / intensities[:, None]).ravel()
    answered = outcome >= 0
    fails, which, factors = outcome[answered] >= severity, which[answered], factors[answered]
    predictions = []
    if surrogate is not None:
        period, amplitude = (np.array([getattr(one, name) for one in pulses]) for name in ("period", "amplitude"))
        predicted, outside = surrogate.under_pulses(bearing, period[which], factors * amplitude[which])
        predictions.append(Prediction("classifier", "classifier at the pulse", Agreement.of(fails, predicted), outside))
    predicted = predicted_by_reduced_model(bearing, motions, which, factors, severity, model)
    predictions.append(Prediction("reduced", "reduced model", Agreement.of(fails, predicted)))
    return tuple(predictions)
