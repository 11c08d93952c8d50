"""Names that settings share with the packages that give them a meaning, so that reading settings loads no engine."""

from typing import Literal

Criterion = Literal["entropy", "u", "straddle", "bald", "eavc", "globalmi", "sur"]
"""What ranks the candidates (`activefail.acquisition.criteria`)."""

FeatureSet = Literal["paper", "design", "decorrelated", "sliding", "collision"]
"""What the classifier sees of a design (`activefail.features`)."""

Kernel = Literal["rbf", "matern52"]
"""Covariance of a latent (`activefail.surrogate.covariance`): squared exponential (the paper's) or Matérn-5/2."""
