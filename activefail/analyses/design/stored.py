"""Verified designs whose fresh simulations are in the record: where to find them, and reading them again."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

from activefail.analyses.design.design_task import LOOKS, Requirement, confidence_of_bound
from activefail.analyses.design.search import Designed, verifies
from activefail.campaign.question import Question
from activefail.estimates.estimate import ProbabilityEstimate
from activefail.estimates.probability_estimator import Estimator
from activefail.estimates.scores import fits
from activefail.record.store import Store

_IDENTITY = ("verified designs",)


@dataclass(frozen=True, eq=False)
class StoredDesign:
    """A verified design."""

    requirement: Requirement  # that it meets
    bearing: dict[str, float]  # the values of all variables that are certain, by name
    estimate: ProbabilityEstimate  # from the stored simulations
    confidence: float  # of the result, one-sided


def remember_design(store: Store, designed: Designed) -> None:
    """Add the result of a search to a record's verified designs.

    A design that is not verified is not added, nor one whose targets were risks in a number of years. An entry says
    where a look was, not what it found: that is in the stored simulations alone.
    """
    if designed.status != "verified" or designed.task.rate is not None:
        return
    new = [
        {
            "outcome": one.outcome,
            "target": one.target,
            "free": {name: float(value) for name, value in designed.values.items()},
            "look": designed.number,
            "unguided": designed.task.unguided,
            "confidence": designed.task.confidence,
        }
        for one in designed.task.requirements
    ]
    former = _entries(store)
    store.remember(_IDENTITY, [*(entry for entry in former if entry not in new), *new])


def _entries(store: Store) -> list[dict[str, Any]]:
    """The entries of verified designs; what is none, in a stranger's record, is left out."""
    kept, shape = (
        store.recall(_IDENTITY),
        {"outcome": str, "target": Real, "free": dict, "look": int, "unguided": int, "confidence": Real},
    )
    entries = [one for one in kept if fits(one, shape)] if isinstance(kept, list) else []
    known = [one for one in entries if 0 < one["look"] <= LOOKS]
    return [one for one in known if all(fits(value, Real) for value in one["free"].values())]


def stored_designs(
    estimator: Estimator, question: Question, free: str, requirements: Sequence[Requirement]
) -> list[StoredDesign]:
    """The last verified design of each requirement under a question, from stored simulations; nothing is simulated.

    A design is found only if its simulations belong to the present classifier and to this question.

    Args:
        estimator: reads.
        question: the distribution of the variables; the free one gets a value.
        free: the free variable. Designs with other free variables are left out.
        requirements: the targets.
    """
    designs = []
    for requirement in requirements:
        for entry in reversed(_entries(estimator.store)):
            if (entry["outcome"], entry["target"]) != requirement[:2] or entry["free"].keys() != {free}:
                continue
            at_design = question.at(entry["free"])
            of_bound = confidence_of_bound(entry["confidence"], entry["look"] - 1)
            draw = at_design.drawn(entry["look"], entry["unguided"])
            estimate = estimator.stored(requirement.outcome, draw, 2.0 * of_bound - 1.0)
            if estimate is not None and verifies([estimate], [requirement.target]):
                designs.append(StoredDesign(requirement, dict(at_design.fixed), estimate, entry["confidence"]))
                break
    return designs
