"""The variables of a pulse, and the peak ground velocity that may take the place of its amplitude."""

from collections.abc import Mapping

from activefail.campaign.derived import Derived
from activefail.seismic.hazard.sections import LARGEST_MEDIAN, LARGEST_VELOCITY
from activefail.space.parameter import Parameter
from activefail.space.space import Array

PERIOD, AMPLITUDE = "T_p", "A_p"
"""The variables of a pulse: period [s] and amplitude [g]."""

PGV = "PGV"
"""Peak ground velocity of the pulse [m/s], which may take the place of its amplitude."""


def _amplitude(known: Mapping[str, Array]) -> Array:
    from activefail.seismic.bearing.pulse import amplitude_of  # it loads numba

    return amplitude_of(known[PGV], known[PERIOD])


VELOCITY = Derived(
    Parameter(PGV, 0.001, LARGEST_VELOCITY, "m/s"),
    AMPLITUDE,
    {PERIOD: "s", AMPLITUDE: "g"},
    "pulse",
    _amplitude,
    LARGEST_MEDIAN,
    "cm/s",
)
