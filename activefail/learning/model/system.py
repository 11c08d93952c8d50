"""The latent of a boundary that a system of limit states makes: a regression of each mode's margin.

Each mode is smooth where the system's margin has kinks, so it takes fewer simulations. A simulation teaches all modes.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activefail.learning.model.boundary_gp import SystemModel
from activefail.learning.model.latent import CustomLatent, Latent
from activefail.learning.model.margin import MarginLatent
from activefail.learning.model.moments import Moments, system_moments
from activefail.space.space import Array
from activefail.space.systems import System


@dataclass(frozen=True)
class SystemLatent:
    """The latent of a system's boundary: the probit of the probability that the system fails, with a deviation of 1.

    It has the methods of `margin.MarginLatent`.

    Attributes:
        modes: the latents of the k modes, each learned from the simulations that have its margin.
        known: (n, k) which simulations these are.
        features: (n, m) scaled features of all simulations.
        system: of the modes.
    """

    modes: tuple[MarginLatent, ...]
    known: Array
    features: Array
    system: System

    margin_data = None
    is_one_sided = False
    normality = math.nan

    @property
    def length_scales(self) -> Array:
        """The shortest of the modes' length scales, (m,)."""
        scales = [mode.length_scales for mode in self.modes if mode.length_scales is not None]
        return np.asarray(np.min(scales, axis=0))

    @property
    def is_clipped(self) -> bool:
        """Whether the margin of any mode is clipped."""
        return any(mode.is_clipped for mode in self.modes)

    @property
    def size_of_support(self) -> int:
        """Largest number of support points of a mode; 0 if all points are."""
        return max(mode.size_of_support for mode in self.modes)

    @cached_property
    def model(self) -> SystemModel:
        """The posterior as a BoTorch model over the scaled features."""
        return SystemModel([mode.model for mode in self.modes], self.system)

    def sides(self, F: Array) -> Array:
        """The probits that each mode has failed at scaled features, (n, m) -> (n, k)."""
        return np.column_stack([mode.moments(F).side for mode in self.modes])

    def moments(self, F: Array) -> Moments:
        """Of the probit at scaled features, (n, m)."""
        return system_moments(self.system, self.sides(F))

    def deviations(self, F: Array, margins: Array) -> Array:
        """How far the margin of the mode that decides lies beyond its mean, in standard deviations, (n,).

        Args:
            F: (n, m) scaled features.
            margins: (n, k) of the modes.
        """
        each = np.column_stack([mode.deviations(F, of) for mode, of in zip(self.modes, margins.T, strict=True)])
        return np.asarray(each[np.arange(len(F)), self.system.deciding(self.sides(F))])

    def left_out(self) -> Moments:
        """Moments at each training point without its own margins, with hyperparameters unchanged, (n,)."""
        z = self.sides(self.features)
        for mode, known, column in zip(self.modes, self.known.T, z.T, strict=True):
            column[known] = mode.left_out().side
        return system_moments(self.system, z)


ByMargins = MarginLatent | SystemLatent
"""Latents that are learned from margins."""

AnyLatent = Latent | CustomLatent | ByMargins
