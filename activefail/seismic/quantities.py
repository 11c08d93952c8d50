"""Symbols, units and meanings of the quantities of a bearing: its variables and its features."""

from activefail.text.quantities import Quantity

_VARIABLES = (
    Quantity("T_b", "$T_b$", "T_b", "s", "period of the bearing"),
    Quantity("mu", r"$\mu$", "μ", "", "friction coefficient"),
    Quantity("D_tot", "$D_{tot}$", "D_tot", "m", "displacement capacity"),
    Quantity("h_sl_ratio", "$h_{sl}/D_{sl}$", "h_sl/D_sl", "", "slider height over slider diameter"),
    Quantity("h_rim_ratio", "$h_{rim}/D_{sl}$", "h_rim/D_sl", "", "rim height over slider diameter"),
    Quantity("p", "$p$", "p", "MPa", "pressure on the slider"),
    Quantity("k", "$k$", "k", "N/m¹·⁵", "stiffness of the contacts"),
    Quantity("T_p", "$T_p$", "T_p", "s", "period of the pulse"),
    Quantity("A_p", "$A_p$", "A_p", "g", "amplitude of the pulse"),
)

_FEATURES = (
    Quantity("D_ratio", "$D_{ratio}$", "D_ratio", "", "displacement of the pulse over the capacity"),
    Quantity("T_b/T_p", "$T_b/T_p$", "T_b/T_p", "", "period of the bearing over that of the pulse"),
    Quantity("mu/A_p", r"$\mu/A_p$", "μ/A_p", "", "friction over the amplitude of the pulse"),
    Quantity("h_sl/D_sl", "$h_{sl}/D_{sl}$", "h_sl/D_sl", "", "slider height over slider diameter"),
    Quantity("h_rim/D_sl", "$h_{rim}/D_{sl}$", "h_rim/D_sl", "", "rim height over slider diameter"),
    Quantity("k_norm", "$k_{norm}$", "k_norm", "", "contact stiffness over pressure and pulse displacement"),
    Quantity("v*", "$v*$", "v*", "", "sliding block: speed at the rim over the speed needed to cross it"),
    Quantity("a*", "$a*$", "a*", "", "sliding block: outward ground acceleration at the stop, over g"),
    Quantity("m*", "$m*$", "m*", "", "reduced collision: severity, 0 at failure"),
)

VARIABLES = {one.name: one for one in _VARIABLES}
"""Of Table 1, by name."""

QUANTITIES = {one.name: one for one in (*_VARIABLES, *_FEATURES)}
"""Variables and features, by name."""
