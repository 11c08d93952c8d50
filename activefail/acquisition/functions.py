"""The array functions that the criteria are written with."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

Numbers: TypeAlias = Any
"""A NumPy array or a torch tensor; a criterion of arrays is an array, one of tensors a tensor."""


class Functions(NamedTuple):
    """The functions that the criteria take from an array library.

    Attributes:
        x_log_x: x log x, 0 at 0.
        label_covariance: as in `bivariate`.
    """

    sqrt: Callable[[Numbers], Numbers]
    exp: Callable[[Numbers], Numbers]
    minimum: Callable[[Numbers, Numbers], Numbers]
    concatenate: Callable[[list[Numbers]], Numbers]
    ndtr: Callable[[Numbers], Numbers]
    x_log_x: Callable[[Numbers], Numbers]
    label_covariance: Callable[[Numbers, Numbers, Numbers], Numbers]
