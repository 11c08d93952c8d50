"""What a probability depends on: findings in numbers and words."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from activefail.analyses.findings.lines import aligned, titled
from activefail.analyses.sensitivity.sobol import Estimate, Index
from activefail.space.shares import percent, significant
from activefail.text.csv_table import Target, writing
from activefail.text.json_text import json_values
from activefail.visible import or_worse

LOW, HIGH = 0.1, 0.9
"""Shares of a variable's distribution below the values to which it is moved."""

_NONE = "–"


class Move(NamedTuple):
    """The probability at two values of one variable, with the others at their base values."""

    name: str
    value: float  # that the variable has otherwise
    low: float  # its 10 % quantile in the campaign
    high: float  # 90 %
    at_low: float  # the probabilities there
    at_high: float


@dataclass(frozen=True)
class SensitivityFindings:
    """What a probability depends on, by the classifier alone.

    Attributes:
        outcome: its name; the probability is that of this outcome or a more severe one.
        outcomes: of the simulator, the least severe first.
        title: of the question or the hazard.
        mean, sd: of the probability over the sampled variables; without an interval. NaN without a sample.
        indices: Sobol' indices, by decreasing total index; empty if nothing is to be explained.
        confidence: of their intervals.
        samples: points of the sample; 0 if all variables have values, or nothing is to be explained.
        evaluations: of the classifier.
        units: of the variables, by name; empty for a number.
        outside: share of the sampled designs outside the campaign's space, where the classifier extrapolates.
        notes: what the numbers mean and assume, as sentences.
        pulses: that integrate the probability of each design; 0 without a hazard.
        probability: with all variables at their base values, without an interval; NaN without a hazard.
        moves: one variable at a time, by decreasing effect; empty without a hazard.
        length_scales: of the classifier's features by name, in standard deviations of the feature.
        p_values: of the campaign's variables in a logistic regression of its initial design; empty without a fit.
    """

    outcome: str
    outcomes: tuple[str, ...]
    title: str
    mean: float
    sd: float
    indices: tuple[Index, ...]
    confidence: float
    samples: int
    evaluations: int
    units: Mapping[str, str]
    outside: float
    notes: tuple[str, ...]
    pulses: int = 0
    probability: float = float("nan")
    moves: tuple[Move, ...] = ()
    length_scales: Mapping[str, float] = field(default_factory=dict)
    p_values: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_given_designs(self) -> bool:
        """Whether the probability is one of designs, with the pulses of a hazard integrated out."""
        return self.pulses > 0

    exit_code = 0

    def write_table(self, target: Target) -> None:
        """Write a row for each variable; what a variable does not have is an empty cell.

        Raises:
            InputError: if the file cannot be written.
        """
        rows: dict[str, dict[str, object]] = {}

        def set_cells(name: str, cells: Iterable[tuple[str, object]]) -> None:
            rows.setdefault(name, {"variable": name, "unit": self.units[name]}).update(cells)

        for name, first, total in self.indices:
            set_cells(name, zip(_OF_INDEX, (*first, *total), strict=True))
        for name, *numbers in self.moves:
            set_cells(name, zip(_OF_MOVE, numbers, strict=True))
        for name in self.units:
            beside = {"length_scale": self.length_scales, "p_value": self.p_values}
            set_cells(name, ((column, values[name]) for column, values in beside.items() if name in values))
        with writing(target, _COLUMNS) as write:
            write([[row.get(column, "") for column in _COLUMNS] for row in rows.values()])

    @property
    def heading(self) -> str:
        """What the numbers are about."""
        name = or_worse(self.outcome, self.outcomes)
        return f"sensitivity of the probability of {name} under {self.title}, by the classifier"

    @property
    def index_rows(self) -> list[list[str]]:
        """The table of indices, with its header; empty without indices."""
        if not self.indices:
            return []
        interval = f"({100 * self.confidence:g} % interval)"
        rows = [["variable", f"first index {interval}", f"total index {interval}", "length scale", "p-value"]]
        for name, first, total in self.indices:
            scale = f"{self.length_scales[name]:.3g}" if name in self.length_scales else _NONE
            p_value = _p_value(self.p_values[name]) if name in self.p_values else _NONE
            rows.append([self._label(name), _in_words(first), _in_words(total), scale, p_value])
        return rows

    @property
    def move_rows(self) -> list[list[str]]:
        """The table of one variable at a time, with its header; empty without a hazard."""
        if not self.moves:
            return []
        low, high = f"{100 * LOW:g} %", f"{100 * HIGH:g} %"
        rows = [["variable", "base value", f"at its {low} quantile", f"at its {high} quantile"]]
        for move in self.moves:
            at_low = f"{percent(move.at_low)} at {significant(move.low)}"
            at_high = f"{percent(move.at_high)} at {significant(move.high)}"
            rows.append([self._label(move.name), significant(move.value), at_low, at_high])
        return rows

    def _label(self, name: str) -> str:
        unit = self.units[name]
        return f"{name} [{unit}]" if unit else name

    @property
    def about(self) -> list[tuple[str, str]]:
        """Titles and sentences beside the tables."""
        rows = []
        if self.samples:
            over = "designs" if self.is_given_designs else "the distribution"
            spread = f"standard deviation {percent(self.sd)}; no interval"
            rows.append(("mean", f"{percent(self.mean)} over {over}; {spread}"))
        if others := {name: x for name, x in self.length_scales.items() if name not in self.units}:
            scales = ", ".join(f"{name} {scale:.3g}" for name, scale in others.items())
            rows.append(("features", f"length scales of other features: {scales}"))
        sampled = f"{self.samples} samples, " if self.samples else ""
        rows.append(("from", f"{sampled}{self.evaluations} evaluations of the classifier, no simulation"))
        lie = "of the sampled designs lie outside the campaign's space, where the classifier extrapolates"
        rows.append(("outside", f"{percent(self.outside)} {lie}"))
        return rows

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        text = [self.heading]
        if self.moves:
            at_base = f"probability {percent(self.probability)} with all variables at their base values"
            text += ["", f"{at_base}, without an interval", *aligned(self.move_rows)]
        if self.indices:
            text += ["", "Sobol' indices", *aligned(self.index_rows)]
        return [*text, "", *titled(self.about), *titled(("note", note) for note in self.notes)]

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        return json_values(
            {
                "outcome": self.outcome,
                "question": self.title,
                "output": f"probability given {'the design' if self.is_given_designs else 'all variables'}",
                "mean": self.mean,
                "standard_deviation": self.sd,
                "confidence": self.confidence,
                "samples": self.samples,
                "evaluations": self.evaluations,
                "pulses": self.pulses,
                "outside_design_space": self.outside,
                "indices": [
                    {"variable": name, "unit": self.units[name], "first": first, "total": total}
                    for name, first, total in self.indices
                ],
                "probability": self.probability,
                "one_at_a_time": [
                    {"variable": name, "unit": self.units[name], **dict(zip(_OF_MOVE, numbers, strict=True))}
                    for name, *numbers in self.moves
                ],
                "length_scales": self.length_scales,
                "p_values": self.p_values,
                "interval": None,
                "interval_reason": "the classifier's values, without simulation; the intervals of indices cover their "
                "sampling",
                "notes": self.notes,
            }
        )


def _in_words(estimate: Estimate) -> str:
    return f"{estimate.value:.3f} ({estimate.low:.3f} to {estimate.high:.3f})"


def _p_value(p: float) -> str:
    return "< 0.001" if p < 1e-3 else f"{p:.3f}"


_OF_INDEX = ("first", "first_low", "first_high", "total", "total_low", "total_high")
_OF_MOVE = ("value", "low", "high", "probability_at_low", "probability_at_high")
_COLUMNS = ("variable", "unit", *_OF_INDEX, "length_scale", "p_value", *_OF_MOVE)
