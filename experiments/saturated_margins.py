"""Margins that saturate away from failure: does the stop rule end a campaign that has missed a region of failure?

    python experiments/saturated_margins.py --seeds 20

Two standard normal variables. Failure is a half-plane, and a disc of radius 0.1 to 0.4 on the other side that has 20 to
90 % of the failure probability. Each seed draws both. The margin is the distance to the nearer of the two regions; the
simulator reports

    distance   this distance
    clipped    the distance, at most 0.4
    smooth     0.4 tanh(distance/0.4)
    outcomes   no margin

Within 0.4 of the disc nothing distinguishes a clipped margin from one without a disc. Each campaign has the defaults of
`stop = { probability = "failure" }` and a budget of 100 simulations. The table gives, for each kind of margin,

    ended      campaigns that the rule ended
    wrong      of these, those whose probability is more than 20 % off
    wrong all  campaigns whose probability is more than 20 % off, ended by the rule or not
    calls      simulations: median and range
    coverage   share of 90 % intervals from 50 fresh simulations that contain the true probability
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from scipy.stats import ncx2, norm

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings
from activefail.execution.local import ThreadExecutor
from activefail.loop.asynchronous import learned_so_far
from activefail.loop.batches import run
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.record.memory import MemoryStore
from activefail.reliability.estimate import baseline, deviation_of_margins, plan_estimate
from activefail.reliability.integral import boundary_of
from activefail.simulators.interface import Results
from activefail.surrogate.margin import MarginLatent
from activefail.surrogate.threads import one_thread

KINDS = ("distance", "clipped", "smooth", "outcomes")
LEVEL = 0.4
FRESH, REPEATS = 50, 10


@dataclass(frozen=True)
class HalfPlaneAndDisc:
    """The limit state as a simulator: a half-plane at a distance from the origin, and a disc on the other side."""

    kind: str
    direction: tuple[float, float]
    offset: float
    centre: tuple[float, float]
    radius: float

    outcomes = ("safe", "failure")
    causes = ("",)
    releases_gil = True

    @classmethod
    def drawn(cls, kind, seed):
        rng = np.random.default_rng([seed, 3])
        while True:
            angle, away = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5 * np.pi, 1.5 * np.pi)
            offset, far, radius = rng.uniform(2.6, 3.2), rng.uniform(1.2, 2.2), rng.uniform(0.1, 0.4)
            direction = float(np.cos(angle)), float(np.sin(angle))
            centre = float(far * np.cos(angle + away)), float(far * np.sin(angle + away))
            problem = cls(kind, direction, float(offset), centre, float(radius))
            if 0.2 <= problem.disc / problem.probability <= 0.9:
                return problem

    @property
    def disc(self):
        """The failure probability of the disc."""
        return float(ncx2.cdf(self.radius**2, 2, np.square(self.centre).sum()))

    @property
    def probability(self):
        """The failure probability; the regions do not overlap."""
        return float(norm.sf(self.offset)) + self.disc

    @property
    def margins(self):
        return () if self.kind == "outcomes" else ("g",)

    def distance(self, X):
        plane = self.offset - X @ np.array(self.direction)
        disc = np.linalg.norm(X - np.array(self.centre), axis=1) - self.radius
        return np.minimum(plane, disc)

    def run(self, X):
        g = self.distance(X)
        shown = {
            "distance": g,
            "clipped": np.minimum(g, LEVEL),
            "smooth": LEVEL * np.tanh(g / LEVEL),
            "outcomes": g,
        }[self.kind]
        nothing = np.zeros(len(X))
        margins = shown[:, None] if self.margins else np.empty((len(X), 0))
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), margins, nothing)


def score(kind, seed, terms):
    problem = HalfPlaneAndDisc.drawn(kind, seed)
    space = {name: {"distribution": "normal", "mean": 0.0, "sd": 1.0} for name in ("x", "y")}
    settings = CampaignSettings().changed(
        {
            "seed": seed,
            "space": space,
            "sampling.initial": 12,
            "sampling.batch": terms["batch"],
            "sampling.budget": terms["budget"],
            "sampling.asynchronous": terms["asynchronous"],
            "classifier.features": "design",
            "acquisition.criterion": "eavc",
            "stop": {"probability": "failure"},
        }
    )
    campaign = Campaign.of(settings, simulator=problem)
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, terms["budget"])
    known = learned_so_far if terms["asynchronous"] else current
    learned, history = known(campaign, store, write=False), History.of(store.batches)
    latent = learned.classifier.latent("failure")
    standardised = boundary_of(learned.classifier, campaign.features, "failure")
    rng = np.random.default_rng([seed, 1])
    with one_thread():
        integral = baseline(standardised, campaign.space)
        covered = 0
        for _ in range(REPEATS):
            plan = plan_estimate(standardised, campaign.space, integral, FRESH, rng)
            results = problem.run(plan.designs)
            if isinstance(latent, MarginLatent):
                margin = results.margins[:, 0]
                plan = plan.deviating(deviation_of_margins(latent, campaign.features, plan.designs, margin))
            estimate = plan.estimate(results.outcome == 1, np.ones(FRESH, dtype=bool), 0.9)
            covered += estimate.low <= problem.probability <= estimate.high
    return {
        "kind": kind,
        "calls": len(history),
        "ended": bool(len(learned.looks.table)) and learned.looks.is_known,
        "ratio": integral.probability / problem.probability,
        "covered": covered / REPEATS,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--asynchronous", action="store_true")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    terms = {key: getattr(options, key) for key in ("batch", "budget", "asynchronous")}
    kinds = options.kinds.split(",")
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        tasks = [pool.submit(score, kind, seed, terms) for kind in kinds for seed in range(options.seeds)]
        rows = [task.result() for task in tasks]
    print(f"{'margin':10} {'ended':>7} {'wrong':>7} {'wrong all':>9} {'calls':>14} {'coverage':>8}")
    for kind in kinds:
        own = [row for row in rows if row["kind"] == kind]
        ended = [row for row in own if row["ended"]]
        wrong = [abs(row["ratio"] - 1.0) > 0.2 for row in own]
        ended = [row["ended"] for row in own]
        calls = np.array([row["calls"] for row in own])
        print(
            f"{kind:10} {f'{sum(ended)}/{len(own)}':>7} {f'{np.sum(np.logical_and(wrong, ended))}/{sum(ended)}':>7} "
            f"{f'{sum(wrong)}/{len(own)}':>9} {f'{np.median(calls):.0f} ({calls.min()}-{calls.max()})':>14} "
            f"{np.mean([row['covered'] for row in own]):8.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
