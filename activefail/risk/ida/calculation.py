"""Incremental dynamic analysis of one bearing, or of what a campaign under records simulates."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from activefail.accelerogram_sets import RecordSet
from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import TABLE_1, Model, Tolerance
from activefail.bearing.outcome import OUTCOMES
from activefail.errors import InputError
from activefail.risk.ida.capacity import Capacities, Simulate, capacities, on_ladder
from activefail.risk.ida.collapse import Fragility, Margin, collapse_margin, fitted
from activefail.risk.ida.equivalent_pulse import EquivalentPulse, compare_pulses, equivalent_pulse
from activefail.risk.ida.findings import LOWEST, IdaFindings
from activefail.risk.ida.intensity import Intensity
from activefail.risk.ida.p695 import MarginOptions
from activefail.risk.ida.predictions import Agreement, Prediction, Surrogate, predicted_by_reduced_model
from activefail.risk.ida.simulations import BearingUnderRecords, CampaignUnderRecords, Kept
from activefail.space import Array

LEVELS, BISECTIONS = 10, 5
"""Levels of the ladder, and of the bisection after it."""

KEPT, KEPT_OF_PULSES = "simulations.json", "simulations-of-pulses.json"
"""Files of an analysis from which it continues."""

_LARGEST = {"factor": 8.0, "pga": 3.0, "pgv": 4.0, "sa": 2.0}
"""Highest level of the ladder by default, by the kind of the intensity."""


def ladder(intensity: Intensity, highest: float | None = None) -> Array:
    """The rising levels of an analysis, with equal ratios between them.

    Raises:
        InputError: if the highest level is not positive.
    """
    top = _LARGEST[intensity.kind] if highest is None else highest
    if not (np.isfinite(top) and top > 0.0):
        raise InputError(f"--to: must be positive, got {top:g}.")
    return np.geomspace(LOWEST * top, top, LEVELS)


def analyse(
    bearing: Array,
    records: RecordSet,
    intensity: Intensity,
    outcome: str = OUTCOMES[-1],
    highest: float | None = None,
    options: MarginOptions | None = None,
    pulses: bool = False,
    surrogate: Surrogate | None = None,
    model: Model | None = None,
    tolerance: Tolerance | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    folder: Path | None = None,
) -> IdaFindings:
    """The incremental dynamic analysis of a bearing under a set of records.

    Args:
        bearing: (7,) T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5].
        records: the set.
        intensity: by which records are scaled.
        outcome: "impact" or "failure"; worse outcomes count too.
        highest: level of the ladder; by default 8, 3 g, 4 m/s or 2 g.
        options: of the collapse margin; None for none.
        pulses: whether to compare the records with their equivalent pulses, and with predictions.
        surrogate: a campaign's classifier, to predict the outcomes under the equivalent pulses.
        model, tolerance, threads, progress: as for `simulate_records`.
        folder: of the files from which an interrupted analysis continues; None keeps none.

    Raises:
        InputError: if an argument is invalid.
    """
    severity = _severity(outcome, OUTCOMES)
    model, tolerance = model or Model(), tolerance or Tolerance()
    motions = [record.motion for record in records.records]
    levels = ladder(intensity, highest)
    intensities = np.array([intensity.of_record(motion) for motion in motions])

    def capacities_under(ground: Sequence[Accelerogram], name: str) -> Capacities:
        simulate = BearingUnderRecords(bearing, ground, intensities, model, tolerance, threads, progress)
        kept: Simulate = simulate
        if folder is not None:
            kept = Kept(simulate, folder / name, simulate.identity, progress)
        return capacities(kept, len(ground), levels, BISECTIONS, severity)

    of_records = capacities_under(motions, KEPT)
    fragility, margin = _curve(of_records, records, options)
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
        margin,
        options,
        compared,
        predictions,
    )


def analyse_campaign(
    simulate: CampaignUnderRecords,
    name: str,
    records: RecordSet,
    outcome: str | None = None,
    highest: float | None = None,
    options: MarginOptions | None = None,
    folder: Path | None = None,
) -> IdaFindings:
    """The incremental dynamic analysis of what a campaign under records simulates, such as a building.

    Args:
        simulate: the simulations.
        name: of the campaign.
        records: the campaign's set.
        outcome: one of the campaign's, the most severe if None; worse outcomes count too.
        highest: level of the ladder [m/s]; 4 by default.
        options, folder: as for `analyse`.

    Raises:
        InputError: if an argument is invalid.
        SimulationError: if no simulation gives an outcome, or as the executor does.
    """
    outcomes = tuple(simulate.campaign.simulator.outcomes)
    outcome = outcomes[-1] if outcome is None else outcome
    severity, intensity = _severity(outcome, outcomes), Intensity("pgv")
    levels = ladder(intensity, highest)
    ask: Simulate = simulate
    if folder is not None:
        ask = kept = Kept(simulate, folder / KEPT, simulate.identity, simulate.progress)
        simulate.answered = bool(kept.read())
    of_records = capacities(ask, len(records.records), levels, BISECTIONS, severity)
    fragility, margin = _curve(of_records, records, options)
    values = {**simulate.campaign.space.fixed, **simulate.values}
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
        margin,
        options,
        simulator=name,
        fault=simulate.first_fault,
    )


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
