"""A frame whose ground motion is drawn for each simulation, or is a variable: calls, and intervals that hold the truth.

    python studies/random_record.py --seeds 40
    python studies/random_record.py --seeds 2 --way variable       a quick look

An elastic frame with uncertain period and capacity stands under the far-field records of FEMA P695, scaled to an
uncertain peak ground velocity; the margin is the logarithm of its capacity over its largest displacement. "drawn": the
simulator draws the record, so that it does not repeat. "variable": the record is one of the variables, by
`record = { set = "farfield" }`. Campaigns have `stop = { probability = "failure" }`, 20 simulations in a batch, and
at most 120. The table gives the simulations, how many campaigns the rule ended, the probability by the classifier over
the true one (of 65,536 designs under each record), the root mean square of its relative error, how often the 90 %
interval from 200 fresh simulations holds the true one and the classifier's, and the interval's width over the true one.
"""

from functools import cache
from pathlib import Path

import numpy as np
from noise import FRESH
from study import Rows, asked, head, in_memory, line, parallel, spread, timed

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings, checked
from activefail.estimates.probability_estimator import Estimator
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.seismic.motions.accelerogram_sets import read_record_set
from activefail.seismic.motions.intensity import spectral_acceleration
from activefail.simulators.interface import Results

PERIODS = np.geomspace(0.4, 2.5, 24)
VARIABLES = {
    "period": {"distribution": "lognormal", "median": 1.0, "dispersion": 0.15, "low": 0.4, "high": 2.5},
    "capacity": {"distribution": "lognormal", "median": 0.5, "dispersion": 0.3},
    "PGV": {"distribution": "lognormal", "median": 0.25, "dispersion": 0.6},
}
RECORD = {"record": {"set": "farfield", "scaled_to": {"PGV": "pgv"}}}


@cache
def spectra():
    """Logarithms of the spectral displacement [m] of each record at a peak velocity of 1 m/s, (records, periods)."""
    motions = [record.motion for record in read_record_set("farfield", None, None).records]
    displacement = [[spectral_acceleration(one, T) * (T / (2.0 * np.pi)) ** 2 for T in PERIODS] for one in motions]
    return np.log(displacement) - np.log([[one.peak_velocity] for one in motions])


def margin(X, which):
    """The margin of designs, (n, 3), under the records with these numbers, (n,)."""
    period, capacity, PGV = X.T
    place = np.interp(np.log(period), np.log(PERIODS), np.arange(len(PERIODS)))
    left = np.minimum(place.astype(int), len(PERIODS) - 2)
    part, of = place - left, spectra()
    return np.log(capacity / PGV) - (1.0 - part) * of[which, left] - part * of[which, left + 1]


class Frame:
    """The simulator; its records are drawn by a generator, or are the last variable without one."""

    outcomes, margins, causes, releases_gil = ("safe", "failure"), ("g",), ("",), True

    def __init__(self, rng=None):
        self.rng = rng

    def run(self, X):
        which = X[:, 3].astype(int) if self.rng is None else self.rng.integers(len(spectra()), size=len(X))
        g, nothing = margin(X[:, :3], which), np.zeros(len(X))
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), g[:, None], nothing)


def campaign_of(way, seed):
    drawn = way == "drawn"
    settings = {
        "seed": seed,
        "simulator": {"python": "frame:g", "margins": ["g"], "repeatable": not drawn},
        "space": VARIABLES if drawn else VARIABLES | RECORD,
        "sampling": {"initial": 20, "batch": 20, "budget": 120},
        "stop": {"probability": "failure"},
    }
    simulator = Frame(np.random.default_rng([seed, 1]) if drawn else None)
    return Campaign.of(checked(CampaignSettings, settings, "study"), simulator=simulator)


@cache
def truth():
    """The probability of failure."""
    X = campaign_of("drawn", 0).space.sobol(1 << 16, np.random.default_rng(0))
    return float(np.mean([(margin(X, np.full(len(X), which)) <= 0.0).mean() for which in range(len(spectra()))]))


def measured(way, seed):
    with one_thread(), ThreadExecutor(1) as executor:
        campaign = campaign_of(way, seed)
        learned, seconds = timed(in_memory, campaign)
        estimator = Estimator(campaign, learned.store, executor, learned.classifier, learned.history.last_iteration)
        estimate = estimator.sample("failure", FRESH, campaign.question).estimate(0.9)
        mean = estimator.probability("failure", campaign.question)
    return {
        "way": way,
        "seed": seed,
        "simulations": len(learned.history),
        "ended": learned.looks.is_known,
        "mean": mean,
        "estimate": [estimate.low, estimate.probability, estimate.high],
        "truth": truth(),
        "seconds": seconds,
    }


def main():
    options = asked(__doc__, way=["drawn", "variable"], seeds=40, file=Path, processes=1)
    rows = Rows(options.file)
    cases = [(way, seed) for seed in range(options.seeds) for way in options.way if rows.lack(way=way, seed=seed)]
    for row in parallel(measured, cases, options.processes):
        rows.add(**row)
    titles = "record", "P", "simulations", "ended by the rule", "classifier / P", "its error"
    head(*titles, "interval holds P", "holds the classifier's", "width / P")
    for way in options.way:
        of = [row for row in rows.of(way=way) if row["seed"] < options.seeds]
        true, means = of[0]["truth"], np.array([row["mean"] for row in of])
        low, _, high = np.array([row["estimate"] for row in of]).T
        line(
            way,
            f"{true:.3g}",
            spread([row["simulations"] for row in of], 0),
            f"{sum(row['ended'] for row in of)}/{len(of)}",
            spread(means / true),
            f"{100.0 * np.sqrt(np.mean((means / true - 1.0) ** 2)):.0f} %",
            f"{np.mean((low <= true) & (true <= high)):.3f}",
            f"{np.mean((low <= means) & (means <= high)):.3f}",
            f"{np.median(high - low) / true:.2f}",
        )


if __name__ == "__main__":
    main()
