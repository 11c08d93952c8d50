"""The p-values of a campaign's variables, by the paper's logistic regression."""

import numpy as np

from activefail.errors import InputError
from activefail.loop.history import History
from activefail.paper.methods import logistic_regression
from activefail.space import DesignSpace


def variable_p_values(space: DesignSpace, history: History, severity: int) -> dict[str, float]:
    """The p-values of the variables, by name, in a logistic regression of the initial design.

    Only the initial design is a sample of the design space. The variables are standardised as for the classifier.

    Args:
        space: of the campaign.
        history: its simulations.
        severity: number of the outcome whose boundary it is.

    Returns:
        Empty if the regression has no maximum: one side has no simulation, or a plane separates the sides.
    """
    known = history[history.initial & history.answered]
    beyond = known.outcome >= severity
    if not beyond.any() or beyond.all():
        return {}
    try:
        fit = logistic_regression(space.standardised(known.designs), beyond)
    except InputError:
        # Fewer simulations than variables.
        return {}
    if not (fit.converged and np.isfinite(fit.p_values).all()):
        return {}
    return dict(zip(space.names, fit.p_values.tolist(), strict=True))
