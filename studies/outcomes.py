"""What a classifier of the bearing learns from static and from active designs, by feature sets, criteria and couplings.

    python studies/outcomes.py collision --static 500 --seeds 1000 1001 --fresh 778 8
    python studies/outcomes.py collision --active 500 --criterion eavc --impact 0.3 --couplings consistent
    python studies/outcomes.py sliding collision      the cost of the features alone, beside that of the bearing model

Static designs are a Latin hypercube. Active ones extend one of 250 in batches, of which a share (--impact) is for the
impact boundary and a share (--exploration) is a hypercube. No impact < impact < failure. Latent 1 gives P1 = P(impact
or worse), latent 2 P2 = P(failure), each learned from all designs. Pc is the probability of failure given an impact,
learned from the designs with one. Pb is that of an impact given no failure, learned from the designs without failure.
The couplings are ways to compute the probabilities of three outcomes. Scores on 8,000 fresh designs: mean log
probability of the true outcome [nat, times 100], and the shares [%] of right outcomes and of right sides of the failure
and impact boundaries.
"""

from typing import NamedTuple

import numpy as np
import torch
from study import asked, timed, uniform

from activefail.learning.criteria.batch_proposal import propose_shared
from activefail.learning.criteria.criteria import criterion
from activefail.learning.features import feature_map
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.training import train
from activefail.seismic.bearing import TABLE_1, simulate

INITIAL, FRESH = 250, 8000


class Sampling(NamedTuple):
    """How active designs are chosen; the share `impact` of those without exploration targets the impact boundary."""

    criterion: str = "entropy"
    impact: float = 0.0
    exploration: float = 0.0
    batch: int = 10
    kernel: str = "matern52"


def outcome_of(X):
    """0 no impact, 1 impact, 2 failure, (n,)."""
    return simulate(X, threads=1).outcome


def designs(features, n, active, seed, sampling):
    """A Latin hypercube of n designs, or one of 250 that active sampling extends to n; and their outcomes."""
    start = INITIAL if active else n
    X = TABLE_1.latin_hypercube(start, np.random.default_rng([seed, start]))
    outcome, classifier = outcome_of(X), None
    while len(X) < n:
        classifier = train(
            X, outcome, ("no impact", "impact", "failure"), features, VariationalGP(sampling.kernel), classifier
        )
        batch = propose_shared(
            classifier,
            TABLE_1,
            criterion(sampling.criterion),
            boundaries={"failure": 1.0 - sampling.impact, "impact": sampling.impact},
            exploration=sampling.exploration,
            first=len(X) - INITIAL,
            q=min(sampling.batch, n - len(X)),
            rng=np.random.default_rng([seed, len(X)]),
        )
        X, outcome = np.concatenate([X, batch]), np.concatenate([outcome, outcome_of(batch)])
    return X, outcome


def samples(features, options):
    """(how, X, outcomes) of all static and active samples; a larger active sample continues the smaller ones."""
    sampling = Sampling(*(getattr(options, name, default) for name, default in Sampling._field_defaults.items()))
    for seed in options.seeds:
        for n in options.static:
            yield f"static {n} seed {seed}", *designs(features, n, False, seed, sampling)
        X, outcome = designs(features, max(options.active), True, seed, sampling) if options.active else (None, None)
        for n in options.active:
            yield f"active {n} seed {seed}", X[:n], outcome[:n]


def couplings(P1, P2, Pc, Pb):
    """Probabilities of the three outcomes, (n, 3), by the name of the coupling."""

    def nested(first, second):
        return np.column_stack([1.0 - first, first - second, second])

    joint = np.column_stack([(1.0 - P1) * (1.0 - P2), P1 * (1.0 - P2), P1 * P2])
    return {
        "maximum": nested(np.maximum(P1, P2), P2),
        "consistent": joint / joint.sum(axis=1, keepdims=True),
        "product": nested(P1, P1 * P2),
        "continued forward": nested(P1, P1 * Pc),
        "continued backward": nested(1.0 - (1.0 - P2) * (1.0 - Pb), P2),
    }


def judged(p, outcome):
    """The scores of probabilities of the outcomes, (n, 3)."""
    return (
        np.log(np.clip(p[np.arange(len(p)), outcome], 1e-12, None)).mean(),
        np.mean(p.argmax(axis=1) == outcome),
        np.mean((p[:, 2] > 0.5) == (outcome == 2)),
        np.mean((p[:, 0] < 0.5) == (outcome >= 1)),
    )


def main():
    options = asked(
        __doc__,
        words="sets",
        static=[int],
        active=[int],
        seeds=[1000],
        fresh=[777, 8],
        couplings=[str],
        criterion="entropy",
        impact=0.0,
        exploration=0.0,
        batch=10,
        kernel="matern52",
    )
    torch.set_num_threads(1)
    X_fresh = uniform(FRESH, options.fresh)
    happened = outcome_of(X_fresh)
    maps = {name: feature_map(name, TABLE_1) for name in options.sets}
    for name, function in {"the bearing": outcome_of, **maps}.items():
        function(X_fresh[:2])  # compiled before the clock runs
        print(f"{name:12} {2.0 * timed(function, X_fresh[:500])[1]:.3f} ms of the processor for a design")
    for name, features in maps.items():
        F = features(X_fresh)
        for how, X, outcome in samples(features, options):
            p = []
            for rows, least in ((outcome >= 0, 1), (outcome >= 0, 2), (outcome >= 1, 2), (outcome <= 1, 1)):
                p.append(
                    VariationalGP(options.kernel)
                    .learned(features(X[rows]), outcome[rows] >= least)
                    .moments(F)
                    .probability
                )
            for coupling, probabilities in couplings(*p).items():
                if not options.couplings or coupling in options.couplings:
                    figures = "  ".join(f"{100.0 * figure:8.3f}" for figure in judged(probabilities, happened))
                    print(f"{name:10} {how}  {coupling:18}  {figures}", flush=True)


if __name__ == "__main__":
    main()
