"""What `activefail status` shows: the summary of a run folder and the command that continues it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from activefail.campaign.known_code import known_code
from activefail.campaign.settings import read_settings
from activefail.findings.learned_from import candidate_of, of_rule, sentence, sentence_without
from activefail.findings.summary import Summary, features_in_words
from activefail.loop.history import History
from activefail.record.layout import SETTINGS, check_run_folder
from activefail.record.run_folder import FolderStore
from activefail.shares import lognormal_interval, percent
from activefail.space import REACH
from activefail.verification.stored_sets import first_part, name_of_look
from activefail.verification.unseen import unseen_outcomes
from activefail.visible import or_worse, quoted, visible

NUMERICAL = "numerical_failure"
"""Name of a simulation without an outcome, in counts."""


@dataclass(frozen=True)
class Status:
    """The state of a run folder.

    Attributes:
        folder: the run folder.
        summary: of its campaign.
        warnings: of its record; empty if it is intact.
        state: saved after the last iteration; empty if none was.
        estimates: of probabilities by outcome, from fresh simulations of this record.
        has_looked: whether the stop rule looked after the last batch, so that it may have ended the campaign.
    """

    folder: Path
    summary: Summary
    warnings: tuple[str, ...]
    state: Mapping[str, Any]
    estimates: Mapping[str, Mapping[str, Any]]
    has_looked: bool

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Titles and texts, the campaign's description first, then what is known of a probability."""
        title, learned = visible(self.summary.settings.description or self.folder.name), self.learned
        lines = [line for line in self.summary.lines if line[0] != "learner"]
        return [("campaign", title), *self.estimate, lines[0], ("learner", self._learner), *lines[1:], *learned]

    def as_json(self) -> dict[str, Any]:
        """The state as JSON values; `docs/reference/json.md` describes the keys."""
        summary = self.summary
        names = (*summary.outcomes, NUMERICAL)
        counts = {
            title: dict(zip(names, numbers.tolist(), strict=True))
            for title, numbers in (
                ("all", summary.counts),
                ("initial", summary.initial),
                ("chosen", summary.chosen),
                ("given", summary.given),
            )
        }
        return {
            "description": visible(summary.settings.description),
            "seed": summary.settings.seed,
            "budget": summary.settings.sampling.budget,
            "simulations": summary.done,
            "iteration": summary.iteration,
            "counts": counts,
            "never_seen": list(unseen_outcomes(summary.outcomes, summary.counts)),
            "in_flight": list(summary.in_flight),
            "corrected": summary.corrected,
            "stop_rule_met": self._rule_is_met,
            "estimates": {
                outcome: {name: one for name, one in numbers.items() if isinstance(one, str | int | float | None)}
                for outcome, numbers in self.estimates.items()
            },
            "warnings": list(self.warnings),
            "lost": self.summary.lost,
            "continue": [text for _, text in self.continuation],
        }

    @cached_property
    def _choices(self) -> list[tuple[str, str, float, float, bool, int]]:
        """For each boundary the arguments of `sentence`."""
        rows = []
        for outcome in self.summary.outcomes[1:]:
            try:
                margin, _, from_margin, from_outcomes, _ = self.state[f"{outcome}/choice"].tolist()
                name = "" if margin < 0 else self.summary.margins[int(margin)]
                is_clipped = f"{outcome}/clipped" in self.state
                support = int(self.state.get(f"{outcome}/support", 0))
                rows.append((outcome, name, float(from_margin), float(from_outcomes), is_clipped, support))
            except (LookupError, ValueError, TypeError, OverflowError):
                return []
        return rows

    @property
    def _learner(self) -> str:
        """What is learned and where, in words."""
        line = dict(self.summary.lines)["learner"]
        margins = [margin for _, margin, *_ in self._choices]
        if not any(margins):
            return line
        settings = self.summary.settings
        names = " and ".join(dict.fromkeys(f"the margin {visible(margin)}" for margin in margins if margin))
        if all(margins):
            return f"regression of {names} on {features_in_words(settings)} features"
        return f"regression of {names}, and {line}"

    @property
    def learned(self) -> list[tuple[str, str]]:
        """Titles and texts of where runs are lost, of what each boundary is learned from, and of its stop rule."""
        settings, lines = self.summary.settings, [("lost", self.summary.lost)] if self.summary.lost else []
        rule = settings.probability_rule
        candidate = candidate_of(self.summary.margins, settings.classifier.learns)
        for choice in self._choices:
            outcome, margin, *_ = choice
            text = sentence(*choice)
            if not text and candidate:
                text = sentence_without(
                    outcome, candidate, "it does not show on which side of the boundary a design lies"
                )
            if text:
                lines.append(("learned", text + of_rule(outcome, margin, visible(rule.probability) if rule else "")))
        if self._rule_is_met:
            lines.append(("stop rule", "met"))
        return lines

    @property
    def _rule_is_met(self) -> bool:
        try:
            return bool(int(self.state["stop/known"]))
        except (LookupError, ValueError, TypeError, OverflowError):
            return False

    @property
    def estimate(self) -> list[tuple[str, str]]:
        """Titles and texts of the probability: from fresh simulations if there are any, else by the classifier."""
        return self._from_fresh_simulations or self._by_classifier

    @property
    def _from_fresh_simulations(self) -> list[tuple[str, str]]:
        try:
            lines = []
            for outcome, numbers in self.estimates.items():
                probability, low, high, confidence, recall_low = (
                    float(numbers[key]) for key in ("probability", "low", "high", "confidence", "recall_low")
                )
                name, simulations = visible(or_worse(outcome, self.summary.outcomes)), int(numbers["simulations"])
                interval = f"{100.0 * confidence:g} % interval {low:.3g} to {high:.3g}"
                if numbers["extrapolated"]:
                    interval = f"at most {high:.2g} without a model, because no simulation ended in {name}"
                under = f" under {visible(question)}" if (question := numbers.get("question")) else ""
                text = (
                    f"probability of {name}{under} {probability:.3g}, {interval}, from {simulations} fresh "
                    f"simulations; recall at least {percent(recall_low)}"
                )
                if int(numbers["contradictions_where_sure"]):
                    text += "; fresh simulations contradict the classifier where it was sure: continue the campaign"
                if int((numbers.get("check") or {}).get("contradictions", 0)):
                    text += "; its mode check contradicts the classifier: begin a campaign under the question"
                lines.append(("estimate", text))
            return lines
        except (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError):
            # None yet, or not written by `activefail probability`.
            return []

    @property
    def _by_classifier(self) -> list[tuple[str, str]]:
        try:
            _, probability, sd, error = self.state["stop/looks"][-1].tolist()
            low, high = lognormal_interval(probability, math.hypot(sd, error), REACH)
        except (LookupError, ValueError, TypeError, ArithmeticError):
            return []
        seen = all(self.summary.counts[:-1])
        interval = f"95 % interval {low:.2g} to {high:.2g}" if seen else "without an interval"
        text = f"probability {probability:.3g} under the classifier, {interval}; "
        return [("estimate", text + "`activefail probability` estimates it from fresh simulations")]

    @property
    def _asking(self) -> list[tuple[str, str]]:
        """How to continue a campaign whose simulations are made elsewhere."""
        settings, folder, summary = self.summary.settings, quoted(self.folder), self.summary
        lines = self._telling
        if summary.done + len(summary.in_flight) < settings.sampling.budget:
            ignoring = " --ignore-stop" if self._rule_is_met else ""
            lines.append(f"activefail ask {folder} --n {settings.sampling.batch} --csv todo.csv{ignoring}")
        return [("continue" if number == 0 else "", line) for number, line in enumerate(lines)]

    @property
    def continuation(self) -> list[tuple[str, str]]:
        """Titles and texts of how to continue; empty once the budget is spent."""
        settings = self.summary.settings
        if settings.is_elsewhere:
            return self._asking
        if self.summary.done + self.summary.elsewhere >= settings.sampling.budget:
            return [("continue", text) for text in self._telling]
        known = known_code(self.folder) if settings.needs_code else None
        if settings.needs_code and known is None:
            # Not a command that could be pasted: nobody has named the folder yet.
            command = "with `activefail resume`; name the folder of the custom code with --code"
            ignoring = f"{command}, and add --ignore-stop"
        else:
            command = f"activefail resume {quoted(self.folder)}"
            if known is not None and known.is_changed:
                command += f" --code {quoted(known.folder)}"
            ignoring = f"{command} --ignore-stop"
        lines = [("continue", ignoring if self._rule_is_met else command)]
        if known is not None and known.is_changed:
            lines.append(("", "the code in that folder has changed since the campaign last ran with it"))
        if self.has_looked:
            lines.append(("", f"{ignoring}, if the stop rule ended the campaign"))
        return [*lines, *(("", text) for text in self._telling)]

    @property
    def _telling(self) -> list[str]:
        """The command for designs that are simulated elsewhere; empty without any."""
        command = f"activefail tell {quoted(self.folder)} --csv answers.csv"
        return [command] if self.summary.elsewhere else []


def estimate_of(outcome: str, digest: str) -> tuple[str, ...]:
    """What the last estimate of an outcome's probability is of, in a record with this digest."""
    return "probability", outcome, digest


def read_status(folder: Path) -> Status:
    """The status of a run folder; safe while the campaign runs.

    Raises:
        InputError: if the folder holds no campaign or its settings are invalid.
        StoreError: if the record cannot be read.
    """
    check_run_folder(folder)
    settings = read_settings(folder / SETTINGS)
    with FolderStore.open(folder, write=False) as store:
        history = History.of(store.batches)
        summary = Summary.of(settings, store.schema, history, store.asked, len(store.corrections.place))
        saved, iteration = store.latest_state(), summary.iteration
        state = saved[1] if saved is not None and saved[0] == iteration else {}
        recalled = {one: store.recall(estimate_of(one, store.digest)) for one in store.schema.outcomes[1:]}
        estimates = {visible(one): numbers for one, numbers in recalled.items() if isinstance(numbers, dict)}
        rule = settings.error_rule
        looked = rule is not None and first_part(name_of_look(iteration, rule.simulations)) in store.set_names()
        return Status(folder, summary, store.new_warnings(), state, estimates, looked)
