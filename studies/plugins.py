"""Campaigns with code of a researcher's own, beside the default: the examples of docs/classifier.md on the bearing.

    python studies/plugins.py                 every variant, three seeds
    python studies/plugins.py --table         the table of the finished campaigns

A campaign has 250 designs of a Latin hypercube of Table 1 and 250 chosen ones in batches of 10, with the paper's
features. The code is that of the page's examples. The same 5,000 fresh designs score all, as criteria.py does: a cell
has the mean over the seeds (least to greatest). Lines of --out are not run again.
"""

import re
import tempfile
from pathlib import Path

import numpy as np
from criteria import fresh
from study import Rows, asked, campaign_of, head, in_memory, line, timed

from activefail.campaign.assembly import Campaign
from activefail.estimates.scores import log_score, probability_of_truth
from activefail.learning.model.threads import one_thread

PAGE = Path(__file__).resolve().parent.parent / "docs" / "classifier.md"
BOTORCH = "botorch.acquisition.analytic:PosteriorStandardDeviation"
VARIANTS = {
    "probit likelihood, entropy": {},
    "the kernel of the page": {"classifier.kernel": {"python": "mine:kernel"}},
    "the likelihood of the page": {"classifier.likelihood": {"python": "mine:Robust"}},
    "BoTorch's `SingleTaskGP` as the model": {"classifier.model": {"python": "mine:model"}},
    "the criterion of the page": {"acquisition.criterion": {"python": "mine:Near"}},
    "BoTorch's `PosteriorStandardDeviation`": {"acquisition.criterion": {"python": BOTORCH}},
}


def scored(variant, seed, code):
    """One campaign: its scores, and its processor seconds."""
    settings = campaign_of(seed=seed, classifier__features="paper", classifier__kernel="matern52").settings.changed(
        {"acquisition.criterion": "entropy"}
    )
    sizes = {"sampling.initial": 250, "sampling.budget": 500, "sampling.batch": 10}
    campaign = Campaign.of(settings.changed(sizes | VARIANTS[variant]), code)
    with one_thread():
        learned, seconds = timed(in_memory, campaign)
    test = fresh("bearing-paper-500")
    p = learned.classifier.predicted(test.X).beyond(campaign.severity)
    right, score = np.mean((p > 0.5) == test.failed), log_score(probability_of_truth(p, test.failed))
    return {"variant": variant, "seed": seed, "accuracy": right, "log_score": score, "seconds": round(seconds, 1)}


def main():
    arguments = asked(__doc__, seeds=3, first_seed=2000, table=False, out=Path)
    rows = Rows(arguments.out)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    with tempfile.TemporaryDirectory() as folder:
        code = "\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))
        (Path(folder) / "mine.py").write_text(code)
        for seed in seeds:
            for variant in [] if arguments.table else VARIANTS:
                if rows.lack(variant=variant, seed=seed):
                    rows.add(**scored(variant, seed, Path(folder)))
    head("campaign", "seeds", "failure accuracy [%]", "log score [nat]", "own time [s]")
    for variant in VARIANTS:
        found = rows.of(variant=variant)
        accuracy, score, seconds = (
            np.array([row[key] for row in found]) for key in ("accuracy", "log_score", "seconds")
        )
        a = 100.0 * accuracy
        of_seeds = f"{a.mean():.2f} ({a.min():.2f} to {a.max():.2f})"
        line(variant, len(found), of_seeds, f"{score.mean():.3f}".replace("-", "−"), f"{np.median(seconds):.0f}")


if __name__ == "__main__":
    main()
