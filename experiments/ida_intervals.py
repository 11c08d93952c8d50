"""Which interval of a collapse fragility covers: a jackknife over events with Student's t, or a bootstrap over events.

    python experiments/ida_intervals.py --repetitions 200 [--bootstraps 100]

Capacities are lognormal, with a part of the variance that the two components of an event share. They are observed as by
`activefail ida`: between two levels, or above the highest. The last columns are the shares of 95 % intervals with the
true median and dispersion, and the number of intervals.
"""

import argparse

import numpy as np

from activefail.risk.ida.capacity import BISECTIONS, ladder
from activefail.risk.ida.collapse import fit_lognormal, fitted
from activefail.risk.ida.intensity import Intensity

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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--bootstraps", type=int, default=0, help="draws of the bootstrap; 0 leaves it out")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(f"{'events':>6} {'shared':>6} {'method':<10} {'median':>8} {'dispersion':>10}   cover of 95 % intervals")
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
                    print(
                        f"{count:>6} {shared:>6.1f} {name:<10} {median:>8.3f} {dispersion:>10.3f}   {len(rows)}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
