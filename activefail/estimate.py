"""A statistic over independent samples: its mean, and what one sample more may show."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from activefail.space import Array

Interval = tuple[float, float]


@dataclass(frozen=True)
class Estimate:
    """Of a statistic over independent samples, both intervals at 95 % by Student's t.

    Attributes:
        mean: over the samples.
        of_mean: confidence interval of the mean.
        of_one: prediction interval for the statistic of one more sample, as a published figure is.
    """

    mean: float
    of_mean: Interval
    of_one: Interval

    @classmethod
    def over(cls, values: Array) -> "Estimate":
        """From one value a sample, (samples,), or several repetitions in each, (samples, repetitions).

        Repetitions within a sample sharpen its mean; one of them alone varies as much within as between samples.
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
