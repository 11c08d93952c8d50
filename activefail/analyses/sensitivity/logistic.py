"""Logistic regression (the paper, section 3.1), and which variables matter by that of an initial design."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.special import expit
from statsmodels.discrete.discrete_model import Logit

from activefail.errors import InputError
from activefail.loop.history import History
from activefail.space.space import Array, DesignSpace

Labels = NDArray[np.bool_]


def check_labelled(F: Array, y: Labels) -> None:
    """Check features and labels.

    Raises:
        InputError: if shapes differ or a value is not finite.
    """
    if F.ndim != 2 or y.shape != (len(F),):
        raise InputError(f"Features (n, m) and labels (n,) must have matching shapes, got {F.shape} and {y.shape}.")
    if not np.isfinite(F).all():
        raise InputError(f"Features must be finite, got {np.count_nonzero(~np.isfinite(F))} non-finite values.")


@dataclass(frozen=True)
class LogisticFit:
    """A logistic regression with an intercept, by maximum likelihood.

    Attributes:
        intercept: of the log odds.
        coefficients: (m,) of the log odds, per unit of each feature.
        standard_errors: (m,) of the coefficients, from the observed information; NaN without a maximum.
        p_values: (m,) of Wald's two-sided test that a coefficient is zero; NaN without a maximum.
        converged: whether Newton's method found the maximum.
        separation: whether a plane separates the classes, except for points on it (complete or quasi-complete
            separation). The likelihood then has no maximum, and only the direction of the coefficients is meaningful.
    """

    intercept: float
    coefficients: Array
    standard_errors: Array
    p_values: Array
    converged: bool
    separation: bool

    def probability(self, F: Array) -> Array:
        """P(label) at features, (n, m) -> (n,)."""
        return np.asarray(expit(self.intercept + F @ self.coefficients))

    def accuracy(self, F: Array, y: Labels) -> float:
        """Share of labels, (n,), on the right side of probability ½ at features, (n, m)."""
        return float(np.mean((self.probability(F) > 0.5) == y))


def separable(Z: Array, y: Labels) -> bool:
    """Whether some β ≠ 0 has ±Zβ ≥ 0 for all points, with the label's sign: complete or quasi-complete separation.

    This is equivalent to logistic regression having no maximum [AlbertAnderson1984]. Uses the linear program of
    [Konis2007]: without separation, the largest sum of ±Zβ for β in a unit box is zero.

    Args:
        Z: (n, k) of full column rank, with entries of order 1, including a column of ones for an intercept.
        y: (n,) labels.
    """
    signed = np.where(y, 1.0, -1.0)[:, None] * Z
    solution = linprog(-signed.sum(0), A_ub=-signed, b_ub=np.zeros(len(Z)), bounds=(-1.0, 1.0))
    # The solver satisfies each constraint to 1e-7.
    return bool(-solution.fun > 1e-6 * len(Z))


def logistic_regression(F: Array, y: Labels) -> LogisticFit:
    """Regress labels, (n,), on features, (n, m), in any units, with statsmodels' `Logit`.

    Standardises the features internally, which changes neither the fit nor the p-values.

    Raises:
        InputError: if shapes differ, a value is not finite, or features and intercept are linearly dependent.
    """
    check_labelled(F, y)
    center, spread = F.mean(axis=0), F.std(axis=0)
    # A constant feature has a spread of rounding error; setting its column to zero lowers the rank.
    Z = np.column_stack([np.ones(len(F)), (F - center) / np.where(spread > 1e-12 * np.abs(center), spread, np.inf)])
    if (rank := np.linalg.matrix_rank(Z)) < Z.shape[1]:
        raise InputError(f"Features and intercept must be linearly independent, got rank {rank} of {Z.shape[1]}.")
    separation = separable(Z, y)
    result, converged = _maximum(Logit(y.astype(float), Z), separation)
    nan = np.full(F.shape[1], np.nan)
    errors, p_values = (result.bse[1:] / spread, result.pvalues[1:]) if converged else (nan, nan)
    slopes = result.params[1:] / spread
    return LogisticFit(float(result.params[0] - slopes @ center), slopes, errors, p_values, converged, separation)


def _maximum(model: Logit, separation: bool) -> tuple[Any, bool]:
    """statsmodels' results at the maximum likelihood or where the search ended, and whether it converged."""
    # This callback replaces the one that warns of separation.
    quiet = {"disp": False, "callback": lambda _: None, "warn_convergence": False}
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # odds of infinity are a probability of 0 or 1
        # statsmodels' Newton method takes full steps, which can diverge from a poor start: BFGS finds a good one.
        start = model.fit(method="bfgs", maxiter=500, skip_hessian=True, **quiet)
        if separation:
            return start, False
        try:
            tolerance = 1e-8 * max(1.0, float(np.abs(start.params).max()))
            result = model.fit(method="newton", start_params=start.params, tol=tolerance, **quiet)
        except np.linalg.LinAlgError:  # near separation the information matrix is singular
            return start, False
    return (result, True) if result.mle_retvals["converged"] else (start, False)


def variable_p_values(space: DesignSpace, history: History, severity: int) -> dict[str, float]:
    """The p-values of the variables, by name, in a logistic regression of the initial design.

    Only the initial design is a sample of the design space. The variables are standardised as for the classifier.
    Those with choices are left out.

    Args:
        space: of the campaign.
        history: its simulations.
        severity: number of the outcome whose boundary it is.

    Returns:
        Empty if the regression has no maximum: one side has no simulation, or a plane separates the sides.
    """
    known = history[history.initial & history.answered]
    beyond = known.outcome >= severity
    columns = [column for column, one in enumerate(space.parameters) if not one.choices]
    if not beyond.any() or beyond.all() or not columns:
        return {}
    try:
        fit = logistic_regression(space.standardised(known.designs)[:, columns], beyond)
    except InputError:
        # Fewer simulations than variables.
        return {}
    if not (fit.converged and np.isfinite(fit.p_values).all()):
        return {}
    return dict(zip((space.names[column] for column in columns), fit.p_values.tolist(), strict=True))
