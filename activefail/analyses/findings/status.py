"""What `activefail status` shows: the summary of a run folder and the command that continues it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from numbers import Real
from pathlib import Path
from typing import Any

from activefail.analyses.findings.learned_from import LearnedFrom, candidate_of, saved_choices, source_in_words
from activefail.analyses.findings.summary import Summary, features_in_words, where_lost
from activefail.campaign.known_code import known_code
from activefail.campaign.sections import margins_in
from activefail.campaign.settings import read_settings
from activefail.estimates.confidence_bounds import unseen_outcomes
from activefail.estimates.scores import CurvePoint, fits, last_error, learning_curve, verified_in_words
from activefail.loop.history import History
from activefail.loop.stop_rule import noted
from activefail.record.journal import is_being_written
from activefail.record.layout import SETTINGS, check_run_folder
from activefail.record.run_folder import FolderStore
from activefail.space.shares import alike, lognormal_interval, percent
from activefail.space.space import REACH
from activefail.visible import or_worse, quoted, visible

NUMERICAL = "numerical_failure"
"""Name of a simulation without an outcome, in counts."""


@dataclass(frozen=True)
class Status:
    """The state of a run folder.

    Attributes:
        folder: the run folder.
        summary: of its campaign.
        learnable: names of the simulator's margins, or the text of their system.
        lost: where runs gave no result; empty if all gave one.
        warnings: of its record; empty if it is intact.
        saved: state after the last iteration; empty if none was.
        estimates: of probabilities by outcome, from fresh simulations of this record.
        stop_rule: how its stop rule is met; empty if it is not.
        error: of the classifier of this record, from fresh simulations; None if it was not verified.
        curve: what the campaign knew after its iterations.
        is_running: whether a process has the folder open for writing.
    """

    folder: Path
    summary: Summary
    learnable: tuple[str, ...]
    lost: str
    warnings: tuple[str, ...]
    saved: Mapping[str, Any]
    estimates: Mapping[str, Mapping[str, Any]]
    stop_rule: str
    error: Mapping[str, Any] | None
    curve: Sequence[CurvePoint]
    is_running: bool

    @property
    def state(self) -> str:
        """`running`, `finished`, `elsewhere` or `stopped`."""
        summary, settings = self.summary, self.summary.settings
        if self.is_running:
            return "running"
        if self.stop_rule or summary.done >= settings.sampling.budget:
            return "finished"
        return "elsewhere" if settings.is_elsewhere else "stopped"

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Titles and texts: the campaign, its state, what is known of an error or a probability, and all else."""
        campaign = visible(self.summary.settings.description or self.folder.name)
        lines = [(title, self._learner if title == "learner" else text) for title, text in self.summary.lines]
        state = self.state + ": a process has the folder open for writing" * self.is_running
        return [("campaign", campaign), ("state", state), *self.estimate, *lines, *self.learned]

    def _repr_html_(self) -> str:
        """The state as a table, for a notebook."""
        lines = [*self.lines, ("warning", self.summary.unseen_warning), *self.continuation]
        rows = "".join(
            f"<tr><th>{escape(title)}</th><td>{escape(visible(text))}</td></tr>" for title, text in lines if text
        )
        return f"<table><caption>{escape(visible(str(self.folder)))}</caption>{rows}</table>"

    def as_json(self) -> dict[str, Any]:
        """The state as JSON values; `docs/reference/json.md` describes the keys."""
        summary = self.summary
        names = (*summary.outcomes, NUMERICAL)
        origins = {"all": summary.counts} | summary.origins
        counts = {title: dict(zip(names, of.tolist(), strict=True)) for title, of in origins.items()}
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
            "state": self.state,
            "stop_rule_met": bool(self.stop_rule),
            "error": self.error,
            "estimates": {
                outcome: {
                    name: one
                    for name, one in numbers.items()
                    if name == "modes" or isinstance(one, str | int | float | None)
                }
                for outcome, numbers in self.estimates.items()
            },
            "warnings": list(self.warnings),
            "lost": self.lost,
            "continue": [text for _, text in self.continuation],
        }

    @cached_property
    def _choices(self) -> list[LearnedFrom]:
        summary = self.summary
        return saved_choices(self.saved, summary.outcomes, self.learnable, summary.settings.classifier.learns)

    @property
    def _learner(self) -> str:
        """What is learned and where, in words."""
        line, features = self.summary.learner, f"on {features_in_words(self.summary.settings)} features"
        margins = [one.margin for one in self._choices]
        if not margins and (name := candidate_of(self.learnable, self.summary.settings.classifier.learns)):
            return f"regression of {source_in_words(name)} {features}, or {line}"
        names = " and ".join(dict.fromkeys(source_in_words(margin) for margin in margins if margin))
        if not names:
            return line
        return f"regression of {names} {features}" if all(margins) else f"regression of {names}, and {line}"

    @property
    def learned(self) -> list[tuple[str, str]]:
        """Titles and texts of where runs are lost, of what each boundary is learned from, and of its stop rule."""
        lines = [("lost", self.lost)]
        lines += [("learned", one.sentence(self.summary.settings)) for one in self._choices]
        lines += [("stop rule", "met" if self.stop_rule else "")]
        return [(title, text) for title, text in lines if text]

    @property
    def estimate(self) -> list[tuple[str, str]]:
        """Titles and texts of the verified error and of the probability, from fresh simulations or the classifier."""
        lines = []
        if self.error is not None:
            lines = [("error", verified_in_words(self.error))]
        if self.estimates:
            return [*lines, *(("estimate", self._estimated(outcome, of)) for outcome, of in self.estimates.items())]
        if not len(looks := self.saved.get("stop/looks", ())):
            return lines
        _, probability, sd, error = looks[-1].tolist()
        probability, low, high = alike(probability, *lognormal_interval(probability, math.hypot(sd, error), REACH))
        seen = all(self.summary.counts[:-1])
        interval = f"95 % interval {low} to {high}" if seen else "without an interval"
        text = f"probability {probability} under the classifier, {interval}"
        if "probability" not in self.summary.settings.refused:
            text += "; `activefail probability` estimates it from fresh simulations"
        return [*lines, ("estimate", text)]

    def _estimated(self, outcome: str, of: Mapping[str, Any]) -> str:
        """An estimate of an outcome's probability in words, from its numbers in JSON."""
        name = visible(or_worse(outcome, self.summary.outcomes))
        probability, low, high = alike(of["probability"], of["low"], of["high"])
        interval = f"{100.0 * of['confidence']:g} % interval {low} to {high}"
        if of["extrapolated"]:
            interval = f"at most {of['high']:.2g} without a model, because no simulation ended in {name}"
        under = f" under {visible(of['question'])}" if of["question"] else ""
        text = (
            f"probability of {name}{under} {probability}, {interval}, from {of['simulations']} fresh "
            f"simulations; recall at least {percent(of['recall_low'])}"
        )
        if modes := of.get("modes"):
            shares = ", ".join(f"{visible(mode)} {percent(one['failed'])}" for mode, one in modes.items())
            text += f"; share of the failures in which a mode has failed: {shares}"
        if of["contradictions_where_sure"]:
            text += "; fresh simulations contradict the classifier where it was sure: continue the campaign"
        if of["check"] and of["check"]["contradictions"]:
            text += "; its mode check contradicts the classifier: begin a campaign under the question"
        return text

    @property
    def _asking(self) -> list[tuple[str, str]]:
        """How to continue a campaign whose simulations are made elsewhere."""
        settings, folder, summary = self.summary.settings, quoted(self.folder), self.summary
        lines = self._telling
        if summary.done + len(summary.in_flight) < settings.sampling.budget:
            ignoring = " --ignore-stop" if self.stop_rule else ""
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
        known, ignoring = known_code(self.folder) if settings.needs_code else None, " --ignore-stop"
        if settings.needs_code and known is None:
            # Not a command that could be pasted: nobody has named the folder yet.
            command = "with `activefail resume`; name the folder of the custom code with --code"
            ignoring = ", and add --ignore-stop"
        else:
            command = f"activefail resume {quoted(self.folder)}"
        lines = []
        if known is not None and known.is_changed:
            command += f" --code {quoted(known.folder)}"
            lines.append(("", "the code in that folder has changed since the campaign last ran with it"))
        first = ("continue", command + (ignoring if self.stop_rule else ""))
        return [first, *lines, *(("", text) for text in self._telling)]

    @property
    def _telling(self) -> list[str]:
        """The command for designs that are simulated elsewhere; empty without any."""
        command = f"activefail tell {quoted(self.folder)} --csv answers.csv"
        return [command] if self.summary.elsewhere else []


def learnable_of(simulator: Any, margins: tuple[str, ...]) -> tuple[str, ...]:
    """What a boundary of a campaign can be learned from, as `Campaign.learnable`, by its settings."""
    system = getattr(simulator, "system", None)
    return margins_in(simulator, margins) if system is None else (system,)


def estimate_of(outcome: str, digest: str) -> tuple[str, ...]:
    """What the last estimate of an outcome's probability is of, in a record with this digest."""
    return "probability", outcome, digest


def _is_estimate(value: Any) -> bool:
    """Whether a kept value is an estimate that this version can show."""
    numbers = ("probability", "low", "high", "confidence", "simulations", "recall_low", "contradictions_where_sure")
    shape = dict.fromkeys(numbers, Real) | {"extrapolated": bool, "question": str | None, "check": dict | None}
    return (
        fits(value, shape)
        and fits(value["check"] or {"contradictions": 0}, {"contradictions": int})
        # Estimates of earlier versions have no modes.
        and fits(modes := value.get("modes", {}), dict)
        and all(fits(one, {"failed": Real}) for one in modes.values())
    )


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
        schema, corrected = store.schema, len(store.corrections.place)
        summary = Summary.of(settings, schema, history, store.asked, corrected)
        saved, iteration = store.latest_state(), summary.iteration
        latest = saved[1] if saved is not None and saved[0] == iteration else {}
        recalled = {one: store.recall(estimate_of(one, store.digest)) for one in schema.outcomes[1:]}
        estimates = {visible(one): numbers for one, numbers in recalled.items() if _is_estimate(numbers)}
        return Status(
            folder,
            summary,
            learnable_of(settings.simulator, schema.margins),
            where_lost(schema.variables, history.designs, ~history.answered, settings.without_order),
            store.new_warnings(),
            latest,
            estimates,
            noted(store),
            last_error(store),
            learning_curve(store),
            is_being_written(folder),
        )
