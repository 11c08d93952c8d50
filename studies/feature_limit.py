"""The highest accuracy of any classifier that uses only the paper's six features.

    python studies/feature_limit.py --n 10000 --copies 32

Six features leave three of Table 1's nine variables free, so bearings with the same six features may have different
outcomes. Each of n designs, uniform over Table 1, gets copies with the same features, drawn from the uniform measure
given these, and all are simulated. In logarithms the features are linear and the density is exponential, so steps of
hit-and-run are drawn exactly. A design is a draw given its own features, so walks from it are in equilibrium from the
start. The remaining correlation with the start makes both figures too high rather than too low; more --steps show by
how much.

    vote     accuracy of predicting a design by the majority of its copies: a classifier on the six features, so the
             limit is not below it;
    share    mean share of the most frequent outcome among copies and design: the limit is not above it, apart from
             chance.

Per cent with standard errors over designs, for the failure and the impact boundary.
"""

import numpy as np
from scipy.linalg import null_space
from study import asked, head, line, percent

from activefail.seismic.bearing import TABLE_1, simulate
from activefail.seismic.bearing.outcome import FAILURE, NO_IMPACT
from activefail.seismic.features import paper_features
from activefail.seismic.figures.feature_planes import EXPONENTS, LOGARITHMIC

COLUMNS = list(LOGARITHMIC)


def copies_of(X, steps, rng):
    """Each design's walk to another with the same features, (n, 9) -> (n, 9)."""
    low, high = np.log(TABLE_1.low[COLUMNS]), np.log(TABLE_1.high[COLUMNS])
    free = null_space(EXPONENTS)
    x = np.log(X[:, COLUMNS])
    for _ in range(steps):
        direction = rng.standard_normal((len(x), free.shape[1])) @ free.T
        with np.errstate(divide="ignore"):
            ends = np.stack([(low - x) / direction, (high - x) / direction])
        begin, end = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        # Uniform variables have the density exp(sum of their logarithms): along a line an exponential, cut at the box.
        slope, length = direction.sum(axis=1), np.maximum(end - begin, 0.0)
        u, rise = rng.random(len(x)), slope * length
        steep = np.abs(rise) > 1e-9
        along = np.where(steep, np.log1p(u * np.expm1(rise)) / np.where(steep, slope, 1.0), u * length)
        x = np.clip(x + (begin + along)[:, None] * direction, low, high)
    moved = X.copy()
    moved[:, COLUMNS] = np.clip(np.exp(x), TABLE_1.low[COLUMNS], TABLE_1.high[COLUMNS])
    return moved


def main() -> None:
    options = asked(__doc__, n=10_000, copies=32, steps=40, seed=41)
    rng = np.random.default_rng(options.seed)
    X = TABLE_1.from_unit(rng.random((options.n, TABLE_1.dimension)))
    F, outcome = paper_features(X), simulate(X).outcome
    copied = []
    for _ in range(options.copies):
        moved = copies_of(X, options.steps, rng)
        assert np.allclose(paper_features(moved), F, rtol=1e-9)
        copied.append(simulate(moved).outcome)
    outcomes = np.stack(copied)
    print(f"{options.n} designs, {options.copies} copies of each with the same features, which moved by")
    print(f"{np.abs(moved - X)[:, COLUMNS].mean(axis=0) / (TABLE_1.high - TABLE_1.low)[COLUMNS]} of the ranges")
    head("boundary", "vote", "share")
    for name, beyond in (("failure", lambda of: of == FAILURE), ("impact", lambda of: of != NO_IMPACT)):
        is_beyond, others = beyond(outcome), beyond(outcomes)
        p = others.mean(axis=0)
        # Where the copies are divided, half of such votes are right.
        right = np.where(p == 0.5, 0.5, (p > 0.5) == is_beyond)
        share = (others.sum(axis=0) + is_beyond) / (options.copies + 1)
        line(name, percent(right), percent(np.maximum(share, 1.0 - share)))


if __name__ == "__main__":
    main()
