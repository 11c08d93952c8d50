"""A reliability problem whose failure is rare."""

import numpy as np


def four_branch(X):
    """The limit state of a series system with k = 7 (Waarts 2000) at designs, (n, 2); below zero at failure.

    About 2.2 in a thousand designs of two standard normal variables fail.
    """
    x, y = X.T
    bent = 3.0 + 0.1 * (x - y) ** 2
    return np.min([bent - (x + y) / 2**0.5, bent + (x + y) / 2**0.5, x - y + 7 / 2**0.5, y - x + 7 / 2**0.5], axis=0)
