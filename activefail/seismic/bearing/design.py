"""A bearing, a pulse and the settings of the model, checked at construction."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from activefail.errors import InputError
from activefail.space.parameter import LARGEST, Parameter
from activefail.space.space import Array, DesignSpace

GRAVITY = 9.81
"""g [m/s²]."""

TABLE_1 = DesignSpace(
    (
        Parameter("T_b", 2.5, 5.5, "s"),
        Parameter("mu", 0.02, 0.12),
        Parameter("D_tot", 0.450, 0.850, "m"),
        Parameter("h_sl_ratio", 0.33, 1.3),
        Parameter("h_rim_ratio", 0.05, 0.2),
        Parameter("p", 30.0, 60.0, "MPa"),
        Parameter("k", 2.5e8, 50e8, "N/m^1.5"),
        Parameter("T_p", 0.25, 5.0, "s"),
        Parameter("A_p", 0.1, 0.8, "g"),
    )
)
"""The nine sampled variables and their ranges (paper, Table 1)."""


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"`{name} > 0` must hold, got {value}.")


def _require_in_bounds(**values: float) -> None:
    for name, value in values.items():
        if abs(value) > LARGEST:
            raise InputError(f"`{-LARGEST:g} <= {name} <= {LARGEST:g}` must hold, got {value}.")


@dataclass(frozen=True)
class Bearing:
    """A double friction pendulum bearing with two equal dishes.

    Attributes:
        radius: R of both dishes [m].
        mu: friction coefficient [-].
        dish_diameter: D_out, between the rims of a dish [m].
        slider_diameter: D_sl [m].
        slider_height: h_sl at the edge, vertex to vertex [m].
        rim_height: h_rim [m].
        pressure: p on the slider's area [Pa].
        stiffness: k of the Hertz contacts [N/m^1.5].

    Raises:
        InputError: if a value is not positive and finite, or the dish or the slider does not fit its sphere.
    """

    radius: float
    mu: float
    dish_diameter: float
    slider_diameter: float
    slider_height: float
    rim_height: float
    pressure: float
    stiffness: float

    def __post_init__(self) -> None:
        _require_positive(**vars(self))
        if not self.slider_diameter < self.dish_diameter:
            raise InputError(
                f"`slider_diameter < dish_diameter` must hold, got {self.slider_diameter} and {self.dish_diameter} m."
            )
        if not self.dish_diameter < 2.0 * self.radius:
            raise InputError(
                f"A dish must be less than a hemisphere, `dish_diameter < 2 radius`; "
                f"got {self.dish_diameter} and {2.0 * self.radius:.4g} m."
            )
        # A product may overflow to infinity, where `**` would raise.
        half = self.slider_diameter / 2.0
        if not self.slider_height < 2.0 * math.sqrt(self.radius * self.radius - half * half):
            raise InputError(
                f"The slider's height must be less than the distance between the dishes' centres, "
                f"got a height of {self.slider_height} m for a radius of {self.radius:.4g} m."
            )

    @classmethod
    def from_table(
        cls,
        T_b: float,
        mu: float,
        D_tot: float,
        h_sl_ratio: float,
        h_rim_ratio: float,
        p: float,
        k: float,
        slider_diameter: float = 0.30,
    ) -> Self:
        """The bearing of a row of Table 1: s, -, m, -, -, MPa, N/m^1.5; slider diameter in m (paper, eq. 2).

        Raises:
            InputError: as the class does.
        """
        values = {"T_b": T_b, "mu": mu, "D_tot": D_tot, "h_sl_ratio": h_sl_ratio, "h_rim_ratio": h_rim_ratio}
        _require_positive(**values, p=p, k=k)
        _require_in_bounds(**values, p=p, k=k)
        return cls(
            radius=GRAVITY * (T_b / (2.0 * math.pi)) ** 2 / 2.0,
            mu=mu,
            dish_diameter=D_tot + slider_diameter,
            slider_diameter=slider_diameter,
            slider_height=h_sl_ratio * slider_diameter,
            rim_height=h_rim_ratio * slider_diameter,
            pressure=p * 1e6,
            stiffness=k,
        )

    @classmethod
    def from_row(cls, row: Sequence[float], slider_diameter: float) -> Self:
        """As `from_table`, from the first seven numbers of a row of Table 1."""
        T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k = row[:7]
        return cls.from_table(T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k, slider_diameter)

    @property
    def displacement_capacity(self) -> float:
        """D_tot = D_out − D_sl, nominally the displacement at which the slider touches both rims [m]; see `terms`."""
        return self.dish_diameter - self.slider_diameter

    @property
    def plate_mass(self) -> float:
        """M of the top plate, including the whole load [kg]."""
        return self.pressure * math.pi * self.slider_diameter**2 / (4.0 * GRAVITY)


@dataclass(frozen=True)
class Pulse:
    """An antisymmetric Ricker pulse: period T_p [s] and amplitude A_p [m/s²], which may be negative (mirrored).

    Raises:
        InputError: if the period is not positive and finite or the amplitude is not finite.
    """

    period: float
    amplitude: float

    def __post_init__(self) -> None:
        _require_positive(period=self.period)
        if not math.isfinite(self.amplitude):
            raise InputError(f"The amplitude of a pulse must be finite, got {self.amplitude}.")

    @property
    def peak(self) -> float:
        """Peak ground acceleration [m/s2]."""
        return abs(self.amplitude)

    @classmethod
    def from_table(cls, T_p: float, A_p: float) -> Self:
        """The pulse of a row of Table 1: s, g.

        Raises:
            InputError: as the class does, with the table's names.
        """
        _require_positive(T_p=T_p)
        if not math.isfinite(A_p):
            raise InputError(f"`A_p` must be finite, got {A_p}.")
        _require_in_bounds(T_p=T_p, A_p=A_p)
        return cls(T_p, A_p * GRAVITY)


WIDEST_SLIDER = 5.0
"""Diameter that a slider must stay below [m]."""

WIDEST_REGULARISATION = 0.1
"""Largest velocity over which friction is regularised [m/s]."""

RELATIVE_TOLERANCES = (1e-12, 1e-2)
"""Range of the relative error per step."""

RESTITUTIONS = ("pairwise", "assembly")

RIMS: dict[str, tuple[str, ...]] = {
    "rigid": (),
    "breaking": ("rim_strength",),
    "yielding": ("rim_strength", "rim_deformation"),
    "none": (),
}
"""Types of rim, with the settings that each requires; no other type takes them."""


@dataclass(frozen=True)
class Model:
    """Choices that the paper leaves open or fixes for all bearings.

    Attributes:
        slider_diameter: D_sl [m], which Table 1 does not contain.
        restitution_coefficient: e of a rim impact (paper, section 2.1).
        restitution: mass in the damper: "pairwise" (the law as published, with the two bodies in contact) or
            "assembly" (the plate's mass, so that a plate that hits a rim through the slider rebounds with e).
        slider_density: ρ [kg/m³]; steel.
        friction_velocity: v_r over which Coulomb friction is regularised [m/s].
        loss_of_confinement: whether a slider that a plate's rim no longer holds counts as failure.
        rim: type of the rims: "rigid" (the paper), "breaking" at `rim_strength`, "yielding" there until it breaks at
            `rim_deformation`, or "none", a flat plate. A slider beyond the edge of a dish where no rim is left fails.
        rim_strength: largest normal force on a rim over the weight M g [-].
        rim_deformation: plastic deformation at which a yielding rim breaks [m].

    Raises:
        InputError: if a value is outside its range, or the type of rim requires or excludes it.
    """

    slider_diameter: float = 0.30
    restitution_coefficient: float = 0.65
    restitution: str = "pairwise"
    slider_density: float = 7850.0
    friction_velocity: float = 1e-3
    loss_of_confinement: bool = True
    rim: str = "rigid"
    rim_strength: float | None = None
    rim_deformation: float | None = None

    def __post_init__(self) -> None:
        _require_positive(
            slider_diameter=self.slider_diameter,
            slider_density=self.slider_density,
            friction_velocity=self.friction_velocity,
        )
        if not self.slider_diameter < WIDEST_SLIDER:
            raise InputError(f"`slider_diameter < {WIDEST_SLIDER:g}` must hold, in m, got {self.slider_diameter}.")
        if not self.friction_velocity <= WIDEST_REGULARISATION:
            rule = f"`friction_velocity <= {WIDEST_REGULARISATION:g}` must hold, in m/s"
            raise InputError(f"{rule}, got {self.friction_velocity}.")
        if not 0.0 < self.restitution_coefficient <= 1.0:
            raise InputError(f"`0 < restitution_coefficient <= 1` must hold, got {self.restitution_coefficient}.")
        if self.restitution not in RESTITUTIONS:
            raise InputError(f"`restitution` must be one of {', '.join(RESTITUTIONS)}, got {self.restitution!r}.")
        if self.rim not in RIMS:
            raise InputError(f"`rim` must be one of {', '.join(RIMS)}, got {self.rim!r}.")
        for name in RIMS["yielding"]:
            value, is_needed = getattr(self, name), name in RIMS[self.rim]
            if (value is not None) != is_needed:
                words = "requires" if is_needed else "cannot be combined with"
                raise InputError(f'rim = "{self.rim}" {words} `{name}`{"" if is_needed else f", got {value}"}.')
        if self.rim_strength is not None and not 0.0 <= self.rim_strength < math.inf:
            raise InputError(f"`0 <= rim_strength < inf` must hold, got {self.rim_strength}.")
        if self.rim_deformation is not None and not 0.0 < self.rim_deformation <= self.slider_diameter / 2.0:
            raise InputError(
                f"`0 < rim_deformation <= slider_diameter / 2` must hold, got {self.rim_deformation} and "
                f"{self.slider_diameter} m."
            )

    @property
    def rim_limits(self) -> tuple[float, float]:
        """Strength over M g [-] and plastic deformation [m] that break a rim: infinite if rigid, 0 without one."""
        if self.rim == "rigid":
            return math.inf, math.inf
        return self.rim_strength or 0.0, self.rim_deformation or 0.0

    @property
    def damping_ratio(self) -> float:
        """ξ of the approach-phase damper for the restitution coefficient e [Jankowski2006, eq. 18]."""
        e = self.restitution_coefficient
        return 4.5 * math.sqrt(5.0) * (1.0 - e * e) / (e * (e * (9.0 * math.pi - 16.0) + 16.0))


@dataclass(frozen=True)
class Tolerance:
    """Accuracy of the integration.

    Attributes:
        relative: relative error per step.
        longest_step: upper bound of a step [s].
        most_steps: attempted steps after which a simulation is abandoned as a numerical failure.

    Raises:
        InputError: if a value is outside its range.
    """

    relative: float = 1e-4
    longest_step: float = 0.1
    most_steps: int = 400_000

    def __post_init__(self) -> None:
        least, largest = RELATIVE_TOLERANCES
        if not least <= self.relative <= largest:
            raise InputError(
                f"`{least:g} <= relative <= {largest:g}` must hold for the tolerance, got {self.relative}."
            )
        _require_positive(longest_step=self.longest_step)
        if not (isinstance(self.most_steps, int) and self.most_steps >= 1):
            raise InputError(f"`most_steps` must be a whole number of at least 1, got {self.most_steps!r}.")


def table_1_rows(X: Array) -> Array:
    """X as a contiguous (n, 9) array of any numbers.

    Raises:
        InputError: if X has another shape or does not contain numbers.
    """
    try:
        X = np.ascontiguousarray(X, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"designs: must be numbers: {error}.") from None
    if X.ndim != 2 or X.shape[1] != TABLE_1.dimension:
        raise InputError(
            f"designs: must be an array of shape (n, {TABLE_1.dimension}) with the columns {', '.join(TABLE_1.names)}, "
            f"got shape {X.shape}."
        )
    return X


def check_designs(X: Array) -> Array:
    """X as a contiguous (n, 9) array of finite positive designs in Table 1's order and units."""
    X = table_1_rows(X)
    bad = np.argwhere(~(np.isfinite(X) & (X > 0.0)))
    if len(bad):
        row, column = bad[0]
        name = TABLE_1.names[column]
        raise InputError(f"Row {row}, column {name}: `{name}` must be positive and finite, got {X[row, column]}.")
    return X


def outside_table_1(row: Sequence[float]) -> list[str]:
    """Messages for the variables of a design, a row of TABLE_1 or its bearing, that are outside the paper's ranges."""
    return [
        f"{parameter.name} = {value:g} lies outside the paper's range {parameter.low:g} to {parameter.high:g}"
        for parameter, value in zip(TABLE_1.parameters, row, strict=False)
        if not parameter.low <= value <= parameter.high
    ]
