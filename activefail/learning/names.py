"""Names that settings share with the packages that give them a meaning, so that reading settings loads no engine."""

from typing import Literal

Criterion = Literal["joint_entropy", "entropy", "u", "straddle", "bald", "eavc", "globalmi", "sur"]
"""What ranks the candidates (`activefail.learning.criteria.criteria`)."""

FEATURE_SETS = ("design", "decorrelated")
"""Features that need no plug-in: what the classifier sees of a design (`activefail.learning.features`)."""

Kernel = Literal["rbf", "matern52"]
"""Covariance of a latent (`activefail.learning.model.covariance`): squared exponential (the paper's) or Matérn-5/2."""
