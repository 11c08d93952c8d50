"""Capacities of records that begin where a campaign's classifier predicts them; their simulations join its record."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.learning.criteria.population import finite
from activefail.loop.telling import add
from activefail.seismic.ida.capacity import Capacities, Simulate, capacities_near
from activefail.seismic.ida.simulations import CampaignSubject
from activefail.session.session import Session, recording
from activefail.space.space import Array

_LEVELS = 200
"""Levels at which the classifier is asked."""


def capacities_by_campaign(
    subject: CampaignSubject, run: Session, simulate: Simulate, records: int, rungs: Array, severity: int
) -> Capacities:
    """The capacities of n records.

    Args:
        subject: the campaign with values of its variables.
        run: its open run folder, which keeps the simulations.
        simulate: the outcomes of records at levels.
        records: their number n.
        rungs: levels of the ladder, of which the lowest and highest count.
        severity: of the outcome that is sought, or a worse one.

    Raises:
        InputError: if a value lies outside the campaign's space.
    """
    for one in run.space.parameters:
        if not one.choices and not one.contains(value := subject.values.get(one.name, one.low)):
            raise InputError(f"{one.name}: {one.rule}, got {value:g}; the simulations join the campaign.")
    level = run.space.parameters[run.space.names.index(subject.ground.level)]
    rungs = np.clip(rungs, level.low, level.high)
    subject.keep, subject.answered = partial(add, run.campaign, run.store), bool(run.history.answered.any())
    levels = np.geomspace(rungs[0], rungs[-1], _LEVELS)
    X = subject.designs([(k, level) for k in range(records) for level in levels.tolist()])
    latent = run.classifier.latents[severity - 1]
    beyond = (latent.moments(finite(run.campaign.features, X)).mean > 0.0).reshape(records, _LEVELS)
    starts = levels[np.where(beyond.any(axis=1), beyond.argmax(axis=1), _LEVELS - 1)]
    known = [_known(subject, run, k) for k in range(records)]
    with recording(run):
        return capacities_near(simulate, known, starts, (float(rungs[0]), float(rungs[-1])), severity)


def _known(subject: CampaignSubject, run: Session, k: int) -> tuple[Array, NDArray[np.int8]]:
    """The rising levels of a record in the run folder at the subject's values, and their outcomes."""
    history = run.history
    place = run.space.names.index(subject.ground.level)
    others = np.delete(history.designs, place, axis=1) == np.delete(subject.designs([(k, 1.0)]), place, axis=1)
    rows = np.flatnonzero(others.all(axis=1))
    rows = rows[np.argsort(history.designs[rows, place], kind="stable")]
    return history.designs[rows, place], history.outcome[rows]
