"""What a boundary is learned from: evidence chooses between margins and outcomes."""

import numpy as np
import pytest
from rare import four_branch
from surrogate.labelled import RBF

from activefail.learning.model.margin_choice import OUTCOMES, Choice, is_due, usable
from activefail.learning.model.training import choose, fit_defined

RNG = np.random.default_rng(0)
X = 2.0 * RNG.standard_normal((60, 2))
G = four_branch(X)
BEYOND = G <= 0.0


def test_a_margin_that_tells_how_far_the_boundary_is_wins() -> None:
    margins = np.column_stack([np.sin(50.0 * X[:, 0]), G])
    choice = choose(X, BEYOND, margins, (0, 1), RBF)
    assert choice.margin == 1
    assert choice.margin_score > choice.outcome_score
    assert (choice.simulations, choice.one_sided) == (60, False)


def test_a_margin_that_tells_nothing_but_its_sign_loses() -> None:
    # The sign is right and the size is random. A regression expects a trend that is not there.
    noise = np.exp(3.0 * RNG.standard_normal(60))
    choice = choose(X, BEYOND, (np.where(BEYOND, -1.0, 1.0) * noise)[:, None], (0,), RBF)
    assert choice.margin == OUTCOMES
    assert choice.outcome_score > choice.margin_score


def test_before_any_failure_a_usable_margin_is_chosen_without_a_comparison() -> None:
    safe = ~BEYOND
    choice = choose(X[safe], BEYOND[safe], G[safe][:, None], (0,), RBF)
    assert (choice.margin, choice.one_sided) == (0, True)
    assert np.isnan(choice.outcome_score)


@pytest.mark.parametrize(
    ("margin", "reason"),
    [
        (np.where(BEYOND, G, -G), "its sign contradicts the outcome of"),
        (-G, "its sign contradicts the outcome of 60 simulations; a margin must be at most its level"),
        (
            np.where(BEYOND, -1.0, np.nan),
            f"it is undefined in {(~BEYOND).sum()} simulations on the safe side of the boundary",
        ),
        (np.where(G > 2.0, np.inf, G), "it is infinite in"),
        (np.where(BEYOND, -1.0, 1.0), "fewer than two different positive values"),
    ],
)
def test_a_margin_that_cannot_tell_the_side_is_not_used_and_the_reason_is_given(margin, reason) -> None:
    assert usable(margin, BEYOND).startswith(reason)
    assert choose(X, BEYOND, margin[:, None], (0,), RBF).margin == OUTCOMES


def test_a_margin_may_be_undefined_at_failure_and_is_then_taken_as_truncated() -> None:
    margin = np.where(BEYOND, np.nan, G)
    assert usable(margin, BEYOND) == ""
    assert choose(X, BEYOND, margin[:, None], (0,), RBF).margin == 0
    assert fit_defined(X, margin).data.truncated


def test_the_models_are_compared_again_when_much_is_new_or_a_side_is_first_seen() -> None:
    assert is_due(None, 12, BEYOND[:12])
    previous = Choice(0, 20, -0.1, -0.2)
    assert not is_due(previous, 29, BEYOND[:29])
    assert is_due(previous, 30, BEYOND[:30])
    one_sided = Choice(0, 20, -0.1, one_sided=True)
    assert not is_due(one_sided, 21, np.zeros(21, dtype=bool))
    assert is_due(one_sided, 21, np.arange(21) == 20)
