"""Names that settings share with the packages that give them a meaning, so that reading settings loads no engine."""

from typing import Literal, NamedTuple

Criterion = Literal["joint_entropy", "entropy", "u", "straddle", "bald", "eavc", "globalmi", "sur"]
"""What ranks the candidates (`activefail.learning.criteria.criteria`)."""

FEATURE_SETS = ("design", "decorrelated")
"""Features that need no plug-in: what the classifier sees of a design (`activefail.learning.features`)."""

Kernel = Literal["rbf", "matern52"]
"""Covariance of a latent (`activefail.learning.model.covariance`): squared exponential (the paper's) or Matérn-5/2."""

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
