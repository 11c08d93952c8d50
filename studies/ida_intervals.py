"""Which interval of a collapse fragility covers: a jackknife over events with Student's t, or a bootstrap over events.

    python studies/ida_intervals.py --repetitions 200 [--bootstraps 100]

Capacities are lognormal, with a part of the variance that the two components of an event share. They are observed as by
`activefail ida`: between two levels, or above the highest. The last columns are the shares of 95 % intervals with the
true median and dispersion, and the number of intervals.
"""

import numpy as np
from study import asked, head, line

from activefail.analyses.fragility.capacities import fit_lognormal, fitted
from activefail.seismic.ida.capacity import BISECTIONS, ladder
from activefail.seismic.motions.intensity import Intensity

MEDIAN, DISPERSION = 1.5, 0.4


def observed(capacity):
    """The levels between which capacities lie, (n,) each."""
    levels = ladder(Intensity("pgv"))
    place = np.searchsorted(levels, capacity)
    low = np.where(place > 0, levels[np.maximum(place - 1, 0)], 0.0)
    high = np.where(place < len(levels), levels[np.minimum(place, len(levels) - 1)], np.inf)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        fails = capacity <= middle
        inside = np.isfinite(high)
        low, high = np.where(inside & ~fails, middle, low), np.where(inside & fails, middle, high)
    return low, high


def bootstrap(low, high, events, rng, draws):
    """Percentile intervals of the median and the dispersion."""
    rows = [np.flatnonzero(events == event) for event in np.unique(events)]
    found = []
    for _ in range(draws):
        drawn = np.concatenate([rows[k] for k in rng.integers(len(rows), size=len(rows))])
        if (fit := fit_lognormal(low[drawn], high[drawn])) is not None:
            found.append((fit.median, fit.dispersion))
    return np.quantile(np.array(found), [0.025, 0.975], axis=0).T


def main():
    options = asked(__doc__, repetitions=200, bootstraps=0, seed=1)
    head("events", "shared", "method", "median", "dispersion", "intervals")
    for count in (5, 8, 14, 22):
        for shared in (0.0, 0.7):
            rng = np.random.default_rng([options.seed, count, int(10 * shared)])
            hits = {"jackknife": [], "bootstrap": []}
            for _ in range(options.repetitions):
                of_event, own = rng.normal(size=(count, 1)), rng.normal(size=(count, 2))
                z = np.sqrt(shared) * of_event + np.sqrt(1.0 - shared) * own
                low, high = observed(MEDIAN * np.exp(DISPERSION * z.ravel()))
                events = np.repeat(np.arange(count), 2)
                intervals = {}
                found = fitted(low, high, events.tolist())
                if found is not None and found.median:
                    intervals["jackknife"] = (found.median, found.dispersion)
                if options.bootstraps:
                    intervals["bootstrap"] = bootstrap(low, high, events, rng, options.bootstraps)
                for name, (median, dispersion) in intervals.items():
                    hits[name].append((median[0] <= MEDIAN <= median[1], dispersion[0] <= DISPERSION <= dispersion[1]))
            for name, rows in hits.items():
                if rows:
                    median, dispersion = np.mean(rows, axis=0)
                    line(count, shared, name, f"{median:.3f}", f"{dispersion:.3f}", len(rows))


if __name__ == "__main__":
    main()
