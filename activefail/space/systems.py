"""Systems of limit states: what their margins, and probabilities of failure, say of the system."""

import ast
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from activefail.space.space import Array

CERTAIN = 38.0
"""Probit of what is certain: a probability of 10⁻³¹⁶, the least that a float holds."""

_LONGEST, MOST = 1000, 20
"""Most characters in an expression, and most modes: the cost of their shares grows with the square."""


@dataclass(frozen=True)
class Node:
    """Parts of a system that fail as `any` of them does (in series), or when all have failed (in parallel).

    Attributes:
        is_series: whether one failed part is enough.
        parts: positions of modes, or nodes; at least two.
    """

    is_series: bool
    parts: tuple["Node | int", ...]

    @property
    def modes(self) -> list[int]:
        """Positions of the modes in it, repeated ones repeatedly."""
        return [mode for part in self.parts for mode in ([part] if isinstance(part, int) else part.modes)]


@dataclass(frozen=True)
class System:
    """Limit states that make a system: nested `min(...)` (in series) and `max(...)` (in parallel) of margins.

    Attributes:
        text: as it is written.
        names: of the k modes, each a margin.
        root: of the expression.
    """

    text: str
    names: tuple[str, ...]
    root: Node

    def __call__(self, margins: Array) -> Array:
        """The system's margin, (...,), of its modes' margins, (..., k); at most 0 where it fails.

        An undefined margin (NaN) may have any value: the system's is NaN unless its side is the same for all of them.
        """
        undefined = np.isnan(margins)
        low, high = (_folded(self.root, np.where(undefined, end, margins)) for end in (-np.inf, np.inf))
        return np.where(high <= 0.0, high, np.where(low > 0.0, low, np.nan))

    def deciding(self, z: Array) -> NDArray[np.intp]:
        """Position of the mode that most probably decides, (n,), of the probits that each mode has failed, (n, k)."""
        return np.asarray((-z == _folded(self.root, -z)[:, None]).argmax(axis=1))

    def probit(self, z: Array) -> Array:
        """The probit that the system has failed, (n,), of the probits that each mode has, (n, k), independently."""
        return np.clip(self._probit(np.asarray(z)), -CERTAIN, CERTAIN)

    def _probit(self, z: Array) -> Array:
        from scipy.special import log_ndtr

        for mode in self._repeated:
            if np.isfinite(z[:, mode]).all():  # either it has failed, or not
                log_p, log_q = log_ndtr(z[:, mode]), log_ndtr(-z[:, mode])
                failed, safe = (self._probit(_with(z, mode, end)) for end in (np.inf, -np.inf))
                beyond, short = (
                    np.logaddexp(log_p + log_ndtr(s * failed), log_q + log_ndtr(s * safe)) for s in (1, -1)
                )
                return _probit_of(beyond, short)
        return _probit_at(self.root, z)

    @cached_property
    def _repeated(self) -> list[int]:
        return [mode for mode, count in Counter(self.root.modes).items() if count > 1]


def _with(values: Array, mode: int, value: float) -> Array:
    return np.where(np.arange(values.shape[-1]) == mode, value, values)


def _folded(node: Node | int, margins: Array) -> Array:
    if isinstance(node, int):
        return margins[..., node]
    fold = np.minimum if node.is_series else np.maximum
    return np.asarray(fold.reduce([_folded(part, margins) for part in node.parts]))


def _probit_at(node: Node | int, z: Array) -> Array:
    from scipy.special import log_ndtr, ndtri_exp  # settings, which `status` reads, import this module

    if isinstance(node, int):
        return z[..., node]
    sign = -1.0 if node.is_series else 1.0
    log_all = np.sum([log_ndtr(sign * _probit_at(part, z)) for part in node.parts], axis=0)
    return np.asarray(sign * ndtri_exp(log_all))


def _probit_of(log_p: Array, log_q: Array) -> Array:
    """The probit of a probability p, of log p and log (1 - p), whichever is smaller."""
    from scipy.special import ndtri_exp

    return np.asarray(np.where(log_p < log_q, ndtri_exp(np.minimum(log_p, 0.0)), -ndtri_exp(np.minimum(log_q, 0.0))))


def parse_system(text: str, margins: Sequence[str]) -> System:
    """The system of an expression.

    Args:
        text: nested `min(...)` and `max(...)` of margins.
        margins: their names; each must be in the expression.

    Raises:
        ValueError: naming the part that breaks a rule.
    """
    rule = "must be min(...) or max(...) of two margins or more, which may be nested"
    if len(text) > _LONGEST:
        raise ValueError(f"must have at most {_LONGEST} characters, got {len(text)}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise ValueError(f"{rule}, got {text!r}") from None

    def parsed(node: ast.expr) -> Node | int:
        match node:
            case ast.Name(id=name):
                if name not in margins:
                    raise ValueError(
                        f"must name margins among {', '.join(margins) or 'none'}, got {name!r} in {text!r}"
                    )
                return margins.index(name)
            case ast.Call(func=ast.Name(id="min" | "max" as kind), args=[_, _, *_] as parts, keywords=[]):
                return Node(kind == "min", tuple(parsed(part) for part in parts))
        raise ValueError(f"{rule}, got {ast.get_source_segment(text.strip(), node)!r} in {text!r}")

    root = parsed(tree)
    if isinstance(root, int):
        raise ValueError(f"{rule}, got {text!r}")
    if len(margins) > MOST:
        raise ValueError(f"must have at most {MOST} margins, got {len(margins)}")
    if missing := [name for position, name in enumerate(margins) if position not in root.modes]:
        raise ValueError(f"must contain every margin, but {missing[0]!r} is not in {text!r}")
    return System(text, tuple(margins), root)
