"""One probability, and runs that say nothing: what the classifier says against direct simulation.

    python benchmarks/answers.py --part fragility --campaign runs/bearing     8 bearings x 6 hazards (half an hour)
    python benchmarks/answers.py --part lost                                  10 campaigns x 20 estimates

The parts are

    fragility  the curves of failure and of impact or worse of each bearing for M 6 to 8: the largest excess of
               failure over impact or worse, and the risk in 50 years over that of simulations of the same pulses, where
               it is above 0.05 %. The campaign is one of campaigns/bearing.toml, run first if the folder does not exist
    lost       a solver that gives up where x2 < -2.5: 3 - x1 - 0.1 x2 <= 0 for normal variables. The share of nominal
               90 % intervals, each of 50 fresh simulations, that contain the probability if no lost run is a failure,
               and if all are. And, from outcomes, a mesh that dies where x2 < 0, with failure where 0.5 - x1 - 0.1 x2
               <= 0: how many runs are lost among the first 20 and the last 40

Each line of --out is one bearing or campaign; a repeated command continues where it stopped.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail import create_run, open_run, simulate
from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import hazard_of
from activefail.campaign.question import Question
from activefail.campaign.settings import CampaignSettings
from activefail.execution.local import ThreadExecutor
from activefail.loop.batches import run
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.record.memory import MemoryStore
from activefail.reliability.integral import BoundariesOf
from activefail.risk.fragility.curve import Curve
from activefail.risk.fragility.levels import curves_on, intensity_ladder, question_at
from activefail.risk.fragility.rates import risk_of
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.surrogate.threads import one_thread
from activefail.verification.probability_estimator import Estimator

MAGNITUDES = (6.0, 6.4, 6.8, 7.0, 7.4, 8.0)
RATES = {"pgv_m_s": [0.2, 0.5, 1.0, 2.0], "annual_rate": [1e-2, 2e-3, 4e-4, 5e-5]}
PULSES = 256
IF_NONE, IF_ALL = 1.4174e-3, 7.6e-3


def fragility(folder, number):
    """The ratios of one bearing under all hazards."""
    opened = open_run(folder) if folder.exists() else create_run(folder, "campaigns/bearing.toml")
    with opened as opened:
        if opened.history.asked_for < opened.settings.sampling.budget:
            opened.take()
        space, rng, rows = opened.space, np.random.default_rng([number, 3]), []
        bearing = {p.name: float(p.low + (p.high - p.low) * rng.random()) for p in space.parameters[:7]}
        boundaries = BoundariesOf(opened.classifier, opened.campaign.features)
        for M in MAGNITUDES:
            pgv = {"median_m_s": 1.0, "dispersion": 0.25}
            hazard = hazard_of({"magnitude": {"M": M}, "pgv": pgv, "curve": RATES}, Path("hazard.toml"))

            def at(level, hazard=hazard):
                return question_at(hazard, opened.settings, space, bearing, "pgv", level)

            with one_thread():
                curves = curves_on(boundaries, at, intensity_ladder("pgv", hazard), space).curves
            ladder = curves[0].ladder
            designs = [at(v).designs(at(v).space.sobol(PULSES, np.random.default_rng(1))) for v in ladder.levels]
            outcome = simulate(np.concatenate(designs)).outcome.reshape(len(designs), PULSES)
            excess = float(np.max(curves[1].probability - curves[0].probability))
            outside = at(1.0).share_outside(space)
            row = {"bearing": number, "M": M, "outside": outside, "excess": excess, "risk": [], "true": []}
            for severity, curve in enumerate(curves, start=1):
                true = Curve(ladder, (outcome >= severity).mean(axis=1), 0.0)
                for key, one in (("risk", curve), ("true", true)):
                    risk = risk_of(one, np.array(RATES["pgv_m_s"]), np.array(RATES["annual_rate"]))
                    row[key].append(risk.in_50_years)
            rows.append(row)
    return rows


@dataclass(frozen=True)
class GivesUp:
    """A limit state whose solver gives up far out."""

    margins: tuple[str, ...] = ("g",)

    outcomes = ("safe", "failure")
    causes = ("",)
    releases_gil = True

    def run(self, X):
        at, below = (3.0, -2.5) if self.margins else (0.5, 0.0)
        g, lost = at - X[:, 0] - 0.1 * X[:, 1], X[:, 1] < below
        outcome = np.where(lost, NUMERICAL_FAILURE, g <= 0.0).astype(np.int8)
        margins = np.where(lost, np.nan, g)[:, None] if self.margins else np.empty((len(X), 0))
        return Results(outcome, np.zeros(len(X), dtype=np.int8), margins, np.zeros(len(X)))


def lost(margins, seed, estimates=20):
    """One campaign and its estimates."""
    normal = {"distribution": "normal", "mean": 0.0, "sd": 1.0}
    keys = {
        "seed": seed,
        "space": {"x1": normal, "x2": normal},
        "sampling.initial": 12 if margins else 24,
        "sampling.batch": 4,
        "sampling.budget": 60 if margins else 100,
        "classifier.features": "design",
        "limits.numerical_failures": 1.0,
    }
    if margins:
        keys["stop"] = {"probability": "failure", "cov": 0.1}
    campaign = Campaign.of(CampaignSettings().changed(keys), simulator=GivesUp(("g",) if margins else ()))
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, campaign.settings.sampling.budget)
        learned, history = current(campaign, store, write=False), History.of(store.batches)
        gone = ~history.answered
        row = {"margins": margins, "seed": seed, "simulations": len(history), "met": learned.looks.is_known}
        row |= {
            "first": int(gone[:20].sum()),
            "last": int(gone[-40:].sum()),
            "none": 0,
            "all": 0,
            "estimates": estimates,
        }
        estimator = Estimator(campaign, store, executor, learned.classifier, history.last_iteration)
        with one_thread():
            for draw in range(1, estimates + 1 if margins else 1):
                question = Question.of_space(campaign.space).drawn(draw)
                estimate = estimator.sample("failure", 50, question).estimate(0.9)
                row["none"] += estimate.low <= IF_NONE <= estimate.high
                row["all"] += estimate.low <= IF_ALL <= estimate.high
    return [{key: int(value) if isinstance(value, np.integer | bool) else value for key, value in row.items()}]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=("fragility", "lost"), required=True)
    parser.add_argument("--campaign", type=Path, default=Path("runs/bearing"))
    parser.add_argument("--bearings", type=int, default=8)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    out = arguments.out or Path(f"answers-{arguments.part}.jsonl")
    rows = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    if arguments.part == "fragility":
        cases = [
            ("bearing", number, lambda n: fragility(arguments.campaign, n)) for number in range(arguments.bearings)
        ]
    else:
        cases = [("seed", seed, lambda s: [*lost(True, s), *lost(False, s)]) for seed in range(arguments.seeds)]
    for key, number, case in cases:
        if not any(row[key] == number for row in rows):
            rows += (new := case(number))
            with out.open("a") as file:
                file.writelines(json.dumps(row) + "\n" for row in new)
    if arguments.part == "fragility":
        print(f"{len(rows)} hazards; largest excess of failure {max(row['excess'] for row in rows):.2g}")
        for title, some in (
            ("at most 10 % of the pulses outside", [row for row in rows if row["outside"] <= 0.1]),
            ("more of them", [row for row in rows if row["outside"] > 0.1]),
        ):
            pairs = [(r, t) for row in some for r, t in zip(row["risk"], row["true"], strict=True) if t > 5e-4]
            if not pairs:
                continue
            ratios = np.array([r / t for r, t in pairs])
            within = int((np.abs(np.log(ratios)) <= np.log(1.15)).sum())
            low, middle, high = np.quantile(ratios, (0.0, 0.5, 1.0))
            print(f"{title}: {within} of {len(ratios)} risks within 1.15; {middle:.2f} ({low:.2f} to {high:.2f})")
        return
    for margins in (1, 0):
        some = [row for row in rows if row["margins"] == margins]
        first, last = (sum(row[key] for row in some) for key in ("first", "last"))
        met = sum(row["met"] for row in some)
        print(f"{'margins' if margins else 'outcomes'}: {len(some)} campaigns, {met} rules met")
        print(f"  lost: {first} of the first 20 of each, {last} of the last 40")
        if margins:
            none, everything, count = (sum(row[key] for row in some) for key in ("none", "all", "estimates"))
            print(f"  of {count} intervals {none} contain P if no lost run fails, {everything} if all do")


if __name__ == "__main__":
    main()
