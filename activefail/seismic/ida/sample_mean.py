"""A statistic over independent samples: its mean, and a prediction for one more sample."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from activefail.space.space import Array

Interval = tuple[float, float]


@dataclass(frozen=True)
class Estimate:
    """A statistic over independent samples, with 95 % intervals from Student's t.

    Attributes:
        mean: mean over the samples.
        of_mean: confidence interval of the mean.
        of_one: prediction interval for one more sample, such as a published figure.
    """

    mean: float
    of_mean: Interval
    of_one: Interval

    @classmethod
    def over(cls, values: Array) -> "Estimate":
        """From one value per sample, (samples,), or several repetitions of each, (samples, repetitions).

        Repetitions reduce the variance of a sample's mean; a single one also has the variance within samples.
        """
        values = values.reshape(len(values), -1)
        n, repetitions = values.shape
        means = values.mean(axis=1)
        between = float(np.var(means, ddof=1))
        within = float(np.mean(np.var(values, axis=1, ddof=1))) * (1.0 - 1.0 / repetitions) if repetitions > 1 else 0.0
        mean, quantile = float(means.mean()), float(t.ppf(0.975, n - 1))

        def around(variance: float) -> Interval:
            half = quantile * float(np.sqrt(variance))
            return mean - half, mean + half

        return cls(mean, around(between / n), around(between + within + between / n))


def contains(interval: Interval, value: float, rounding: float = 0.0) -> bool:
    """Whether an interval contains a value that was rounded to ± `rounding`."""
    return interval[0] - rounding <= value <= interval[1] + rounding
