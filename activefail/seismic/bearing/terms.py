"""A bearing in the designer's terms: effective radius, period, and where and at which force the rims touch."""

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple, Self

from activefail.seismic.bearing.design import GRAVITY, Model

NEEDED = ("T_b", "mu", "D_tot", "h_sl_ratio", "p", "k")
"""Variables of Table 1 on which the terms depend."""


class Terms(NamedTuple):
    """What the nominal values T_b, D_tot and μ + D_tot/2R stand for in the model.

    R_eff = 2√(R² − D_sl²/4) − h_sl is 2R less the slider's height along its axis. At rest each vertex sinks into its
    dish by δ, so the circles on which the vertices of a tilted slider move have the radius r = √(A² + D_sl²/4) with
    A = √(R² − D_sl²/4) + δ, and centres L = R_eff + 2δ apart. At a tilt α the plate is displaced by L sin α and pushed
    by W tan(α + ψ), where ψ has the friction of both dishes: sin ψ = 2r² sin(atan μ)/(L A). A vertex is at a rim at
    α = asin(D_out/2r) − asin(D_sl/2r). Slow pushes agree within 1 % (tests/seismic/bearing/test_terms.py), and within
    4 % for the highest slider of Table 1 in its smallest dishes with the softest contacts, where friction tilts the
    slider too.
    """

    effective_radius: float  # R_eff [m]
    period: float  # of small swings, 2π√(L/g) [s]
    rim_displacement: float  # of the top plate, at which the slider is at both rims [m]
    rim_force: float  # lateral force there over the weight [-]
    nominal_period: float  # T_b = 2π√(2R/g) [s]
    capacity: float  # D_tot [m]
    nominal_force: float  # μ + D_tot/2R [-]
    has_rims: bool  # without, the slider is at the edges of its dishes

    @classmethod
    def of(cls, values: Mapping[str, float], model: Model) -> Self | None:
        """The terms of a bearing; None if one of NEEDED has no value, or the slider does not fit its dishes.

        Args:
            values: of the variables of Table 1, by name.
            model: its slider diameter D_sl and rims.
        """
        if not values.keys() >= set(NEEDED):
            return None
        T_b, mu, D_tot, height, p, k = (values[name] for name in NEEDED)
        radius, half = GRAVITY * (T_b / (2.0 * math.pi)) ** 2 / 2.0, model.slider_diameter / 2.0
        if not half + D_tot / 2.0 < radius:
            return None
        level = math.sqrt(radius * radius - half * half)
        sunk = (0.5e6 * p * math.pi * half * half * radius / (level * k)) ** (2.0 / 3.0)
        effective, reach = 2.0 * level - height * model.slider_diameter, level + sunk
        circle, length = math.hypot(reach, half), effective + 2.0 * sunk
        friction = 2.0 * circle * circle * math.sin(math.atan(mu)) / (length * reach)
        if not (effective > 0.0 and friction < 1.0):
            return None
        tilt = math.asin((D_tot / 2.0 + half) / circle) - math.asin(half / circle)
        return cls(
            effective,
            2.0 * math.pi * math.sqrt(length / GRAVITY),
            length * math.sin(tilt),
            math.tan(tilt + math.asin(friction)),
            T_b,
            D_tot,
            mu + D_tot / (2.0 * radius),
            model.rim != "none",
        )

    def lines(self, upper: Collection[str] | None = None) -> list[tuple[str, str]]:
        """Titles and texts.

        Args:
            upper: the variables that are at their upper bounds, to say so of the friction behind the forces.
        """
        friction = "" if upper is None else f", {_of_friction(upper)}"
        reached = "touched by the slider" if self.has_rims else "none; the slider is at the edges of its dishes"
        return [
            (
                "swings",
                f"R_eff = {self.effective_radius:.3g} m: small swings take {self.period:.3g} s "
                f"(T_b, with 2R: {self.nominal_period:.3g} s)",
            ),
            (
                "rims",
                f"{reached} at {self.rim_displacement:.3g} m (D_tot: {self.capacity:.3g} m), at a "
                f"lateral force of {self.rim_force:.3g} of the weight{friction} "
                f"(μ + D_tot/2R: {self.nominal_force:.3g})",
            ),
        ]

    @property
    def text(self) -> str:
        """Both lines in one."""
        (_, swings), (_, rims) = self.lines()
        return f"{swings}; rims: {rims}"

    def as_json(self) -> dict[str, float]:
        """The terms as JSON values."""
        return {
            "effective_radius": self.effective_radius,
            "period_of_small_swings": self.period,
            "rim_displacement": self.rim_displacement,
            "rim_force_over_weight": self.rim_force,
            "nominal_force_over_weight": self.nominal_force,
        }


def _of_friction(upper: Collection[str]) -> str:
    if "mu" in upper:
        return "at the upper bound of friction"
    return "at the given friction (the hazard has no upper bound)"


def lateral_force(known: Mapping[str, float], upper: Collection[str]) -> tuple[float, str, str] | None:
    """Lateral force at the displacement capacity over the weight: μ + D_tot (2π/T_b)²/g.

    It is the force of two equal dishes before a rim is touched. It also has a title and a text.

    Args:
        known: quantities of a design; None follows if one is missing.
        upper: those that are at their upper bounds.
    """
    if not {"T_b", "mu", "D_tot"} <= known.keys():
        return None
    force = known["mu"] + known["D_tot"] * (2.0 * math.pi / known["T_b"]) ** 2 / GRAVITY
    text = f"lateral force at D_tot over weight: {force:.3g}, {_of_friction(upper)} (formula, no interval)"
    return force, "force", text
