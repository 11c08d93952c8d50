"""Verified designs whose fresh simulations are in the run folder: where to find them, and reading them again."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from activefail.campaign.question import Question
from activefail.files import read_regular
from activefail.record.layout import DESIGNS
from activefail.reliability.estimate import ProbabilityEstimate
from activefail.risk.design.design_task import LOOKS, Requirement, confidence_of_bound
from activefail.risk.design.search import Designed, verifies
from activefail.verification.probability_estimator import Estimator

_LARGEST, _MOST = 1_000_000, 1_000
"""Most bytes of the file, and most designs in it."""


@dataclass(frozen=True, eq=False)
class StoredDesign:
    """A verified design.

    Attributes:
        requirement: what it meets.
        bearing: the values of all variables that are certain, by name.
        estimate: of the probability, from the stored simulations.
        confidence: of the result, one-sided.
    """

    requirement: Requirement
    bearing: dict[str, float]
    estimate: ProbabilityEstimate
    confidence: float


def designs_text(folder: Path, designed: Designed) -> str | None:
    """The file of a run folder's verified designs with one more; None if there is nothing to add.

    A design that is not verified is not added, nor one whose targets were risks in a number of years.

    The file says where a look was, not what it found: that is in the stored simulations alone.

    Args:
        folder: the run folder.
        designed: the result of a search.
    """
    if designed.status != "verified" or designed.task.rate is not None:
        return None
    entries = _entries(folder)
    for one in designed.task.requirements:
        entry = {
            "outcome": one.outcome,
            "target": one.target,
            "free": {name: float(value) for name, value in designed.values.items()},
            "look": designed.number,
            "confidence": designed.task.confidence,
        }
        entries = [*(other for other in entries if other != entry), entry]
    return json.dumps({"designs": entries[-_MOST:]}, indent=1)


def stored_designs(
    estimator: Estimator, folder: Path, question: Question, free: str, requirements: Sequence[Requirement]
) -> list[StoredDesign]:
    """The last verified design of each requirement under a question, from stored simulations; nothing is simulated.

    A design is found only if its simulations belong to the present classifier and to this question.

    Args:
        estimator: reads.
        folder: the run folder.
        question: the distribution of the variables; the free one gets a value.
        free: the free variable. Designs with other free variables are left out.
        requirements: the targets.
    """
    designs = []
    for requirement in requirements:
        for entry in reversed(_entries(folder)):
            if (entry["outcome"], entry["target"]) != requirement[:2] or entry["free"].keys() != {free}:
                continue
            at_design = question.at(entry["free"])
            of_bound = confidence_of_bound(entry["confidence"], entry["look"] - 1)
            estimate = estimator.stored(requirement.outcome, at_design.drawn(entry["look"]), 2.0 * of_bound - 1.0)
            if estimate is not None and verifies([estimate], [requirement.target]):
                designs.append(StoredDesign(requirement, dict(at_design.fixed), estimate, entry["confidence"]))
                break
    return designs


def _entries(folder: Path) -> list[dict[str, Any]]:
    """The entries of the file; those that `designs_text` did not write are left out."""
    try:
        saved = json.loads(read_regular(folder / DESIGNS, _LARGEST))["designs"]
        return [entry for entry in saved if _is_entry(entry)]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return []


def _is_entry(entry: Any) -> bool:
    if not isinstance(entry, dict) or entry.keys() != {"outcome", "target", "free", "look", "confidence"}:
        return False
    free, numbers = entry["free"], [entry["target"], entry["confidence"]]
    if not isinstance(free, dict) or not isinstance(entry["outcome"], str) or type(entry["look"]) is not int:
        return False
    is_numeric = all(type(value) is float and math.isfinite(value) for value in (*numbers, *free.values()))
    return is_numeric and 0.5 <= entry["confidence"] < 1.0 and 1 <= entry["look"] <= len(LOOKS)
