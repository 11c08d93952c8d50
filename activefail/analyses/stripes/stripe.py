"""A probability over finitely many values: the classifier predicts each, and the doubtful ones are simulated.

A *stripe* is such a question at given values of all other variables, such as one design under all records at one
intensity. Its simulations join the record as if they were added: the classifier learns from them, and they are not part
of the budget. The predictions that they check are kept before, so that an interrupted question continues.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.analyses.stripes.intervals import (
    Checked,
    Interval,
    SureWrong,
    deviations,
    expected_wrong,
    most_wrong,
    of_others,
    of_these,
)
from activefail.campaign.assembly import Campaign
from activefail.campaign.finite import FiniteValues
from activefail.campaign.question import Question
from activefail.campaign.random_streams import stream
from activefail.errors import InputError, SimulationError
from activefail.estimates.error import probability_wrong
from activefail.estimates.stored_sets import first_fault_text
from activefail.execution.executor import Executor, run_keeping
from activefail.learning.criteria.population import finite
from activefail.learning.model.classifier import Classifier
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.telling import add
from activefail.record.asked import are_among, bits_of
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, is_impossible
from activefail.space.shares import percent
from activefail.space.space import Array
from activefail.text.progress import Stage, silent

_CHECKED, _LEAST_CHECKED = 0.1, 3
"""Share of the predictions that a check simulates too, and their least number."""

OF_BOUND = 0.9
"""One-sided confidence of the bound on wrong predictions without a model."""


class Round(NamedTuple):
    """Values that were chosen together, and what the classifier said of them before they were simulated.

    Attributes:
        rows: of the question's values; of a check all predictions, in random order, those of large weight sooner.
        beyond: whether each was predicted to be beyond the boundary.
        drawn: of a check how many of the rows, the first ones, are simulated; 0 if all are, the most doubtful ones.
    """

    rows: list[int]
    beyond: list[bool]
    drawn: int

    @property
    def chosen(self) -> list[int]:
        """The rows that are simulated."""
        return self.rows[: self.drawn or None]


@dataclass(frozen=True, eq=False)
class Stripe:
    """What is known of a question's values.

    Attributes:
        campaign: whose record and classifier speak.
        question: whose values they are.
        outcome: of the boundary.
        values: the n values.
        known: (n,) whether each was simulated with an outcome.
        lost: (n,) whether its simulation gave none; values that do not exist have no weight.
        beyond: (n,) on which side of the boundary it is, or is predicted to be if it is not known.
        doubt: (n,) the classifier's probability that this is wrong; 0 where it was simulated.
        wrong: accepted expected probability of the values that are predicted wrongly.
        rounds: of simulations that this question asked for, now and before.
        earlier: what the checks of other questions of the campaign found, for the same outcome.
        new: simulations of this call.
        learned: simulations with an outcome that the classifier learned from.
    """

    campaign: Campaign
    question: Question
    outcome: str
    values: FiniteValues
    known: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    beyond: NDArray[np.bool_]
    doubt: Array
    wrong: float
    rounds: tuple[Round, ...]
    earlier: Checked
    new: int
    learned: int

    @property
    def probability(self) -> float:
        """The probability of the values that are beyond the boundary."""
        return min(1.0, float(self.values.weight @ self.beyond))

    @property
    def doubted(self) -> float:
        """Expected probability of the values that are predicted wrongly, by the classifier's own doubt."""
        return float(self.values.weight @ self.doubt)

    @property
    def expected_wrong(self) -> float:
        """The same, with mistakes of which the classifier is sure, if the check found any."""
        return expected_wrong(self.predicted, self.doubt, self.values.weight, self.checked)

    @property
    def sure_wrong(self) -> SureWrong:
        """What all checks of the campaign say of mistakes of which the classifier is sure."""
        return SureWrong.of(self.checked, self.earlier)

    @cached_property
    def predicted(self) -> NDArray[np.bool_]:
        """Which values are predicted, (n,)."""
        return np.asarray(~self.known & ~self.lost & (self.values.weight > 0.0))

    @property
    def check(self) -> Round | None:
        """The round that checks predictions; None before it."""
        return next((one for one in self.rounds if one.drawn), None)

    @property
    def checked(self) -> Checked:
        """What the check found."""
        if self.check is None:
            return Checked(0, 0)
        rows, beyond = np.array(self.check.chosen), np.array(self.check.beyond[: self.check.drawn])
        known = self.known[rows]
        return Checked(int(known.sum()), int((known & (self.beyond[rows] != beyond)).sum()))

    @property
    def most_wrong(self) -> float:
        """A bound on the probability of wrong predictions without the classifier's word, from the check alone.

        The check speaks of the predictions from which it was drawn. One that has changed since may be wrong; those that
        were found wrong later count.
        """
        weight, of_predicted = self.values.weight, float(self.values.weight @ self.predicted)
        if self.check is None:
            return of_predicted
        rows, beyond = np.array(self.check.rows[self.check.drawn :], int), self.check.beyond[self.check.drawn :]
        differs = self.beyond[rows] != np.array(beyond, bool)
        found = float(weight[rows] @ (self.known[rows] & differs))
        unchanged = float(weight[rows] @ (self.predicted[rows] & ~differs))
        left = max(0.0, most_wrong(self.checked, OF_BOUND) * float(weight[rows].sum()) - found)
        return of_predicted - unchanged + min(unchanged, left)

    @cached_property
    def _drawn(self) -> Array:
        return deviations(self.beyond, self.predicted, self.doubt, self.values.weight, self.sure_wrong)

    def of_these(self, confidence: float) -> Interval:
        """The interval of these values."""
        lost = [float(self.values.weight @ (self.lost & side)) for side in (self.beyond, ~self.beyond)]
        return of_these(self.probability, self._drawn, (lost[0], lost[1]), confidence)

    def of_others(self, confidence: float) -> Interval | None:
        """The interval of other values of their kind; None where these are no sample, or of fewer than three groups."""
        if self.values.group is None:
            return None
        found = of_others(self.beyond, self.values.weight, self.values.group, self._drawn, confidence)
        these = self.of_these(confidence)
        return found and Interval(min(found.low, these.low), max(found.high, these.high))


@dataclass(frozen=True, eq=False)
class Stripes:
    """Asks for probabilities over finitely many values, one after another; each teaches the next.

    Attributes:
        campaign: the campaign.
        store: its record, open for writing.
        executor: runs the simulations.
        learn: the classifier of all recorded simulations.
        at_once: values that are simulated before the classifier learns again.
        stage: called with each stage of the work.
    """

    campaign: Campaign
    store: Store
    executor: Executor
    learn: Callable[[], Classifier]
    at_once: int = 3
    stage: Stage = silent

    def ask(self, question: Question, outcome: str, wrong: float) -> Stripe:
        """Simulate values until the expected probability of wrongly predicted ones is small, and a check agrees.

        The most doubtful values come first. Once the classifier's own doubt is small, some of the remaining
        predictions, drawn by weight, are simulated as a check. The more of them are wrong, the more values are
        simulated.

        Args:
            question: with finitely many values.
            outcome: of the boundary.
            wrong: accepted expected probability of the values that are predicted wrongly.

        Raises:
            InputError: if the question has not finitely many values, or the simulator does not repeat.
            SimulationError: if no simulation of the first two rounds gives an outcome.
        """
        if not self.campaign.settings.is_repeatable:
            raise InputError("wrong: requires a simulator that repeats; leave --wrong out where results have noise.")
        values, began = FiniteValues.of(question), len(History.of(self.store.batches))
        seed = int(question.digest[:12] or "0", 16)
        # The order in which draws by weight, without replacement, would take the values.
        waiting = stream(self.campaign.settings.seed, "stripe", seed).exponential(size=len(values))
        order = np.argsort(waiting / np.maximum(values.weight, np.finfo(float).tiny))
        F = finite(self.campaign.features, values.X)
        kept = _Kept(self.store, outcome, question.digest, f"{wrong:g}")
        while True:
            stripe = self._stripe(question, outcome, values, F, wrong, began, kept)
            handed_out = are_among(values.X, HandedOut.of(self.store).in_flight.designs)
            is_open = stripe.predicted & ~handed_out
            rows = [row for one in stripe.rounds[-1:] for row in one.chosen if is_open[row]]
            if not rows:
                if not (one := self._chosen(stripe, is_open, order)).rows:
                    kept.found(stripe.checked)
                    return stripe
                kept.add(one)
                rows = one.chosen
            self._simulate(stripe, np.array(rows))

    def predicted(self, question: Question, outcome: str) -> Stripe:
        """What the record and the classifier say; nothing is simulated."""
        values = FiniteValues.of(question)
        F, began = finite(self.campaign.features, values.X), len(History.of(self.store.batches))
        return self._stripe(question, outcome, values, F, 1.0, began)

    def _stripe(
        self,
        question: Question,
        outcome: str,
        values: FiniteValues,
        F: Array,
        wrong: float,
        began: int,
        kept: "_Kept | None" = None,
    ) -> Stripe:
        """What the record and the classifier say now."""
        classifier, history = self.learn(), History.of(self.store.batches)
        severity, simulator = self.campaign.simulator.outcomes.index(outcome), self.campaign.simulator
        places = {design: place for place, design in enumerate(bits_of(history.designs))}
        place = np.array([places.get(design, -1) for design in bits_of(values.X)])
        is_recorded = place >= 0
        known = is_recorded & (history.outcome[place] != NUMERICAL_FAILURE)
        moments = classifier.latents[severity - 1].moments(F)
        impossible = is_recorded & is_impossible(simulator, history.outcome, history.cause)[place]
        if impossible.any():
            values = values.without(impossible)
        return Stripe(
            campaign=self.campaign,
            question=question,
            outcome=outcome,
            values=values,
            known=known,
            lost=is_recorded & ~known & ~impossible,
            beyond=np.where(known, history.outcome[place] >= severity, moments.mean > 0.0),
            doubt=np.where(is_recorded, 0.0, probability_wrong(moments)),
            wrong=wrong,
            rounds=kept.rounds() if kept else (),
            earlier=kept.earlier() if kept else Checked(0, 0),
            new=len(history) - began,
            learned=len(history.training),
        )

    def _chosen(self, stripe: Stripe, is_open: NDArray[np.bool_], order: NDArray[np.intp]) -> Round:
        """The next values to simulate; none if the question is answered."""
        rows: list[int] = []
        drawn = 0
        if stripe.check is None and stripe.doubted <= stripe.wrong:
            rows = order[is_open[order]].tolist()
            drawn = max(_LEAST_CHECKED, math.ceil(_CHECKED * len(rows)))
        elif stripe.expected_wrong > stripe.wrong:
            doubtful = np.argsort(-np.where(is_open, stripe.values.weight * stripe.doubt, -1.0), kind="stable")
            rows = doubtful[is_open[doubtful]][: self.at_once].tolist()
        return Round(rows, stripe.beyond[rows].tolist(), drawn)

    def _simulate(self, stripe: Stripe, rows: NDArray[np.intp]) -> None:
        """Simulate values and record the results."""
        X = stripe.values.X[rows]
        self.stage(
            f"simulating {len(X)} of {len(stripe.values)} values of {', '.join(stripe.values.names)}; "
            f"{percent(stripe.expected_wrong)} expected to be predicted wrongly"
        )
        keep = partial(add, self.campaign, self.store)
        results = run_keeping(self.executor, self.campaign.simulator, X, keep)
        # One such round is recorded: these values may be the ones that never converge.
        none_before = stripe.lost.any() and not stripe.known.any()
        if none_before and (results.outcome == NUMERICAL_FAILURE).all():
            raise SimulationError(
                f"None of the {len(X)} simulations gave an outcome. Their results were discarded."
                + first_fault_text(results.faults.values())
            )
        keep(X, results)


@dataclass(frozen=True)
class _Kept:
    """What a record keeps of a question: its rounds, and what the checks of all questions of this outcome found."""

    store: Store
    outcome: str
    digest: str
    wrong: str

    @property
    def _identity(self) -> tuple[str, ...]:
        return "stripe", self.digest, self.outcome, self.wrong

    @property
    def _own(self) -> str:
        return f"{self.digest} {self.wrong}"

    @property
    def _checks(self) -> dict[str, Checked]:
        """By the digest of the question and what was accepted to be wrong: asked for less, it is checked again."""
        found: Any = self.store.recall(("checks", self.outcome))
        return {asked: Checked(*of) for asked, of in (found or {}).items()}

    def rounds(self) -> tuple[Round, ...]:
        found: Any = self.store.recall(self._identity)
        return tuple(Round(*one) for one in found or ())

    def add(self, one: Round) -> None:
        self.store.remember(self._identity, [*self.rounds(), one])

    def earlier(self) -> Checked:
        """What the checks of other questions found."""
        others = [of for asked, of in self._checks.items() if asked != self._own]
        return Checked(sum(one.simulated for one in others), sum(one.contradicted for one in others))

    def found(self, checked: Checked) -> None:
        """Keep what the question's own check found."""
        if checked.simulated and self._checks.get(self._own) != checked:
            self.store.remember(("checks", self.outcome), self._checks | {self._own: checked})
