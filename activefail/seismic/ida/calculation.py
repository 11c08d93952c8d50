"""Incremental dynamic analysis of a bearing, or of what a campaign simulates, under the records of a set."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from activefail.campaign.provenance import simulation_versions
from activefail.errors import InputError
from activefail.seismic.bearing.accelerogram import Accelerogram
from activefail.seismic.ida.by_campaign import capacities_by_campaign
from activefail.seismic.ida.capacity import BISECTIONS, LEVELS, Capacities, Simulate, capacities, ladder
from activefail.seismic.ida.equivalent_pulse import (
    Prediction,
    check_campaign,
    compare_pulses,
    equivalent_pulse,
    predictions,
)
from activefail.seismic.ida.findings import IdaFindings
from activefail.seismic.ida.p695 import MarginRequest, normalised_intensity
from activefail.seismic.ida.simulations import BearingSubject, CampaignSubject, Kept
from activefail.seismic.motions.accelerogram_sets import RecordSet, digest_of
from activefail.seismic.motions.intensity import Intensity
from activefail.text.files import writing_to
from activefail.text.progress import Begin, uncounted

if TYPE_CHECKING:
    from activefail.session.session import Session


def analysis(
    subject: BearingSubject | CampaignSubject,
    records: RecordSet,
    intensity: Intensity,
    outcome: str | None = None,
    to: float | None = None,
    margin: MarginRequest | None = None,
    pulses: bool = False,
    run: "Session | None" = None,
    folder: Path | None = None,
    begin: Begin = uncounted,
) -> IdaFindings:
    """Find the intensity at which a bearing, or what a campaign simulates, fails, for each record of a set.

    Args:
        subject: the bearing, or the campaign with values of its variables.
        records: the set.
        intensity: by which the records are scaled.
        outcome: one of the subject's; the most severe if None.
        to: highest level; None for that of the intensity.
        margin: that is asked for.
        pulses: whether to compare a bearing's records with their equivalent pulses, and with predictions.
        run: of a campaign under pulses, whose classifier predicts the outcomes under the equivalent pulses; or of the
            subject, whose classifier predicts the capacities.
        folder: for the files from which an interrupted analysis continues; None keeps none.
        begin: called with the largest number of simulations; returns a callback for finished ones.

    Raises:
        SimulationError: if no simulation of a campaign gives an outcome.
    """
    outcomes = subject.outcomes
    outcome = outcomes[-1] if outcome is None else outcome
    if outcome not in outcomes[1:]:
        raise InputError(f"--outcome: must be one of {', '.join(outcomes[1:])}, got {outcome!r}.")
    severity, period = outcomes.index(outcome), subject.values.get("T_b", math.nan)
    if intensity.kind == "p695":
        intensity = replace(intensity, period=period, of_set=normalised_intensity(period, records.of_p695))
    if run is not None and isinstance(subject, BearingSubject):
        check_campaign(run.campaign, subject.values, subject.model)
    options = (margin or MarginRequest()).options(period, records.of_p695, intensity.kind == "p695")
    motions = [record.motion for record in records.records]
    levels = ladder(intensity, to)
    intensities = np.array([intensity.of_record(motion) for motion in motions])
    if folder is not None:
        with writing_to(folder):
            folder.mkdir(parents=True, exist_ok=True)
    progress = begin(len(motions) * (LEVELS + BISECTIONS) * (2 if pulses else 1))

    def capacities_under(ground: Sequence[Accelerogram]) -> Capacities:
        simulate: Simulate = partial(subject.simulate, ground, intensities, progress)
        if folder is not None:
            about = {"values": subject.values, "records": digest_of(ground), "intensities": intensities.tolist()}
            identity = {**subject.identity, **about, "versions": simulation_versions()}
            simulate = kept = Kept.of(simulate, folder, identity, progress)
            subject.answered = subject.answered or bool(kept.read())
        return capacities(simulate, len(ground), levels, BISECTIONS, severity)

    if run is not None and isinstance(subject, CampaignSubject):
        simulate = partial(subject.simulate, motions, intensities, progress)
        of_records = capacities_by_campaign(subject, run, simulate, len(motions), levels, severity)
    else:
        of_records = capacities_under(motions)
    compared, predicted = None, tuple[Prediction, ...]()
    if pulses and isinstance(subject, BearingSubject):
        nearest = [equivalent_pulse(motion) for motion in motions]
        of_pulses = capacities_under([one.motion for one in nearest])
        compared = compare_pulses(nearest, of_pulses, of_records, [record.event for record in records.records], levels)
        predicted = predictions(subject, motions, nearest, run, of_records, levels, intensities)
    top = float(levels[-1])
    return IdaFindings(subject, records, intensity, outcome, of_records, top, options, compared, predicted)
