"""Designs beyond the simulations: how often a campaign's classifier calls them wrongly, or "unknown".

    python studies/beyond.py                               five limit states, ten seeds
    python studies/beyond.py --problems beam --seeds 2     a quick look
    python studies/beyond.py --quantile 1e-5               nearer to the simulations

Each campaign has 20 designs of a Latin hypercube and 40 that the default criterion chooses. Asked are designs that are
uniform between the quantiles --quantile and 1 - --quantile of every variable, those outside the convex hull of the
simulated ones. Problems:

    portal     a portal frame: five variables and a grade; utilisation by bending and axial force
    beam       a beam's deflection under a load: three variables
    slope      an infinite slope with a water table: five variables; safety factor less 1
    column     a steel column by Perry and Robertson: four variables and a profile
    roof       a roof under snow and wind: four variables; the larger of two utilisations

The table gives the share of these designs that fail; that are called wrongly, and of the failing ones those called
safe; that are called unknown; and that are called wrongly with a probability of more than 0.95: means over the seeds.
"""

from pathlib import Path

import numpy as np
from problems import Problem
from scipy.spatial import Delaunay
from study import Rows, asked, head, in_memory, line, parallel

from activefail.learning.model.moments import undecided
from activefail.learning.model.threads import one_thread

GRADES = np.array([235.0, 275.0, 355.0])
PROFILES = np.array([(25.3, 3.02), (38.8, 3.98), (53.8, 4.98), (76.8, 6.00)])


def _portal(X):
    wind, snow, height, span, imperfection, grade = X.T
    bending = 0.25 * wind * height**2 + 0.06 * snow * span**2 + 0.5 * snow * span * imperfection * height
    strength = GRADES[grade.astype(int)]
    return 1.0 - bending / (0.9 * strength) - (0.5 * snow * span + 0.3 * wind * height) / (8.0 * strength)


def _beam(X):
    load, length, stiffness = X.T
    return 0.03 - load * length**3 / (48.0 * stiffness)


def _slope(X):
    cohesion, friction, weight, depth, water = X.T
    angle = np.radians(28.0)
    normal = (weight - 9.81 * np.clip(water, 0.0, 1.0)) * depth * np.cos(angle) ** 2
    driving = weight * depth * np.sin(angle) * np.cos(angle)
    return (cohesion + normal * np.tan(np.radians(friction))) / driving - 1.0


def _column(X):
    length, load, strength, bow, profile = X.T
    area, gyration = PROFILES[profile.astype(int)].T
    slender = length * 100.0 / gyration / (np.pi * np.sqrt(210e3 / strength))
    phi = 0.5 * (1.0 + bow * np.maximum(slender - 0.2, 0.0) + slender**2)
    reduction = np.minimum(1.0, 1.0 / (phi + np.sqrt(np.maximum(phi**2 - slender**2, 0.0))))
    return reduction * area * strength * 0.1 / load - 1.0


def _roof(X):
    snow, wind, span, resistance = X.T
    down, up = 1.35 * 0.6 + snow, wind * 0.9 - 0.6
    return 1.0 - np.maximum(down, up) * span**2 / 8.0 / resistance


def _of(name, **values):
    return {"distribution": name, **values}


PROBLEMS = {
    "portal": Problem(
        _portal,
        {
            "wind": _of("gumbel_max", mean=6.0, sd=1.5),
            "snow": _of("gumbel_max", mean=8.0, sd=2.5),
            "height": _of("normal", mean=6.0, sd=0.3),
            "span": _of("normal", mean=14.0, sd=0.5),
            "imperfection": _of("lognormal", mean=0.05, cov=0.5),
            "grade": {"choices": ["S235", "S275", "S355"]},
        },
    ),
    "beam": Problem(
        _beam,
        {
            "load": _of("gumbel_max", mean=20.0, sd=3.0),
            "length": _of("normal", mean=6.0, sd=0.05),
            "stiffness": _of("lognormal", mean=6500.0, cov=0.1),
        },
    ),
    "slope": Problem(
        _slope,
        {
            "cohesion": _of("lognormal", mean=10.0, cov=0.3),
            "friction": _of("normal", mean=32.0, sd=3.0),
            "weight": _of("normal", mean=19.0, sd=0.8),
            "depth": _of("lognormal", mean=2.5, cov=0.25),
            "water": _of("normal", mean=0.4, sd=0.15),
        },
    ),
    "column": Problem(
        _column,
        {
            "length": _of("normal", mean=4.0, sd=0.2),
            "load": _of("gumbel_max", mean=350.0, sd=80.0),
            "strength": _of("lognormal", mean=280.0, cov=0.08),
            "bow": _of("lognormal", mean=0.34, cov=0.3),
            "profile": {"choices": ["HEA120", "HEA160", "HEA200", "HEA240"]},
        },
    ),
    "roof": Problem(
        _roof,
        {
            "snow": _of("gumbel_max", mean=1.0, sd=0.35),
            "wind": _of("gumbel_max", mean=0.8, sd=0.25),
            "span": _of("normal", mean=8.0, sd=0.1),
            "resistance": _of("lognormal", mean=35.0, cov=0.12),
        },
    ),
}


def beyond(campaign, simulated, quantile, rng):
    """Designs, (n, d), outside the hull of the simulated ones."""
    space = campaign.space
    unit = quantile + (1.0 - 2.0 * quantile) * rng.random((4_000, space.dimension))
    is_number = np.array([not one.choices for one in space.parameters])
    low, high = (space.from_unit(np.full((1, space.dimension), q))[0] for q in (quantile, 1.0 - quantile))
    X = np.where(is_number, low + (high - low) * unit, space.from_unit(unit))
    hull = Delaunay(space.to_unit(simulated)[:, is_number])
    return X[hull.find_simplex(space.to_unit(X)[:, is_number]) < 0]


def score(name, seed, quantile, labels):
    """How the designs beyond the simulations of a campaign are called."""
    problem = PROBLEMS[name]
    campaign = problem.campaign(
        seed=seed, sampling__initial=20, sampling__budget=60, sampling__batch=1, classifier__learns=labels
    )
    learned = in_memory(campaign)
    X = beyond(campaign, learned.history.designs, quantile, np.random.default_rng([seed, 1]))
    fails = problem.limit(X) <= 0.0
    with one_thread():
        P, unknown = learned.classifier.probabilities(X)[:, 1], undecided(learned.classifier, X)
    wrong = ~unknown & ((P > 0.5) != fails)
    return {
        "problem": name,
        "seed": seed,
        "designs": len(X),
        "fail": float(fails.mean()),
        "wrong": float(wrong.mean()),
        "called safe": float((wrong & fails).sum() / max(1, fails.sum())),
        "unknown": float(unknown.mean()),
        "sure and wrong": float((np.abs(P - fails) > 0.95).mean()),
    }


def main():
    options = asked(__doc__, problems=[str], seeds=10, quantile=1e-8, learns="auto", processes=1, out=Path)
    names = options.problems or [*PROBLEMS]
    rows = Rows(options.out, quantile=options.quantile, learns=options.learns)
    cases = [(name, seed) for name in names for seed in range(options.seeds) if rows.lack(problem=name, seed=seed)]
    for row in parallel(score, [(*case, options.quantile, options.learns) for case in cases], options.processes):
        rows.add(**row)
    head("problem", "designs", "fail", "wrong", "failures called safe", "unknown", "sure and wrong")
    for name in names:
        own = rows.of(problem=name)
        mean = {key: np.mean([row[key] for row in own]) for key in own[0] if key not in ("problem", *rows.terms)}
        shares = [f"{100.0 * mean[key]:.1f} %" for key in ("fail", "wrong", "called safe", "unknown", "sure and wrong")]
        line(name, f"{mean['designs']:.0f}", *shares)


if __name__ == "__main__":
    main()
