"""Names of the measures of a record's intensity, so that the command line loads no engine."""

from typing import Literal, NamedTuple

IntensityKind = Literal["factor", "pga", "pgv", "sa", "p695"]
"""Measures of a record's intensity (`activefail.seismic.motions.intensity`)."""


class Measure(NamedTuple):
    """How a measure of intensity is shown, and how far `ida` goes by default."""

    name: str  # with the period {T} in s, if it has one
    unit: str
    highest: float  # level at which most far-field records fail a bearing of Table 1; for "p695" over S_NRT


INTENSITIES: dict[IntensityKind, Measure] = {
    "factor": Measure("scale factor", "", 8.0),
    "pga": Measure("PGA", "g", 3.0),
    "pgv": Measure("PGV", "m/s", 4.0),
    "sa": Measure("Sa({T:g} s)", "g", 2.0),
    "p695": Measure("S_T({T:g} s)", "g", 12.0),
}
