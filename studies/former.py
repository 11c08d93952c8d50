"""Processor time of learning and proposing, over that of a former version in the same process.

    python studies/former.py --former PATH_OF_A_CHECKOUT --sizes 250 500 1000 4000 --repeats 5

The former version must have the matrices of its own (version 0.2). Its package is copied under another name. The
problem is the failure boundary of Table 1, Matérn-5/2, with the features "paper" and "collision". For each number of
designs

    cold     learning from scratch;
    warm     learning with ten designs more, to a model that can predict;
    again    the same with a twentieth more, so that hyperparameters are learned again;
    pool     moments at 4,096 designs;
    entropy, eavc    a batch of ten.

Each cell is the ratio of medians, present over former. "alike" is the number of equal designs in the last batches by
each criterion; then the accuracies of both on 4,096 fresh designs, and the largest difference of a probit there.
"""

import importlib
import re
import shutil
import statistics
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import torch
from study import asked, head, line, timed

from activefail.learning.criteria.batch_proposal import propose
from activefail.learning.criteria.criteria import criterion
from activefail.learning.features import feature_map
from activefail.learning.model.fitting import fit, outcome_prior
from activefail.learning.model.latent import Latent
from activefail.learning.model.threads import one_thread
from activefail.seismic.bearing import TABLE_1, simulate
from activefail.seismic.bearing.outcome import FAILURE

CELLS = ("cold", "warm", "again", "pool", "entropy", "eavc")


def former_package(checkout: Path, folder: Path) -> None:
    """Copy a package as `formerfail`, which then can be imported."""
    shutil.copytree(checkout / "activefail", folder / "formerfail")
    for file in (folder / "formerfail").rglob("*.py"):
        file.write_text(re.sub(r"\bactivefail\b", "formerfail", file.read_text()))
    sys.path.insert(0, str(folder))


class Version:
    """One version's functions, on NumPy arrays."""

    def __init__(self, is_former):
        if not is_former:
            self.learn = partial(self._present, partial(outcome_prior, "matern52"))
            self.latent, self.features, self.space = Latent, feature_map, TABLE_1
            self.propose, self.criterion = propose, criterion
            return
        module = lambda name: importlib.import_module(f"formerfail.{name}")  # noqa: E731
        self.learn = partial(self._former, module("surrogate.fitting").fit)
        self.latent, self.features = module("surrogate.classifier").Latent, module("features").feature_map
        self.space = module("bearing").TABLE_1
        self.propose = module("acquisition.batch_proposal").propose
        self.criterion = module("acquisition.criteria").criterion

    @staticmethod
    def _present(prior, F, failed, warm=None):
        return fit(torch.from_numpy(F), torch.from_numpy(failed.astype(float)), prior, warm)

    @staticmethod
    def _former(fit, F, failed, warm=None):
        return fit(torch.from_numpy(F), torch.from_numpy(np.where(failed, 1.0, -1.0)), "matern52", warm)

    def measured(self, names, F, failed, n, fresh, seed):
        """Seconds by cell, and what was computed."""
        features = self.features(names, self.space)
        trained, cold = timed(self.learn, F[:n], failed[:n])
        ready = lambda size: self.latent(self.learn(F[:size], failed[:size], trained)).moments(F[:1])  # noqa: E731
        _, warm = timed(ready, n + 10)
        _, again = timed(ready, n + n // 20 + 5)
        latent = self.latent(trained)
        latent.moments(F[:1])
        moments, pool = timed(latent.moments, fresh)
        seconds, batches = [cold, warm, again, pool], []
        for name in ("entropy", "eavc"):
            arguments = latent, features, self.space, self.criterion(name), 10, np.random.default_rng(seed)
            batch, taken = timed(self.propose, *arguments)
            seconds.append(taken)
            batches.append({row.tobytes() for row in batch})
        return seconds, batches, moments.standardised


def main():
    arguments = asked(__doc__, former=Path, sizes=[250, 500, 1000, 4000], repeats=5)
    with tempfile.TemporaryDirectory() as folder, one_thread():
        former_package(arguments.former, Path(folder))
        versions = Version(True), Version(False)
        head("features, designs", *CELLS, "alike", "accuracy", "probit")
        for names in ("paper", "collision"):
            for n in arguments.sizes:
                rng = np.random.default_rng(3)
                X, fresh = TABLE_1.latin_hypercube(n + n // 20 + 10, rng), TABLE_1.sobol(4096, rng)
                failed, truth = (simulate(designs).outcome >= FAILURE for designs in (X, fresh))
                features = feature_map(names, TABLE_1)
                F, G = features(X), features(fresh)
                seconds = [[], []]
                for repeat in range(arguments.repeats):
                    found = [None, None]
                    for which in (0, 1) if repeat % 2 else (1, 0):
                        found[which] = versions[which].measured(names, F, failed, n, G, repeat)
                        seconds[which].append(found[which][0])
                before, now = ([statistics.median(cell) for cell in zip(*rows, strict=True)] for rows in seconds)
                ratios = [f"{b / a:.2f}" for a, b in zip(before, now, strict=True)]
                alike = ", ".join(str(len(a & b)) for a, b in zip(found[0][1], found[1][1], strict=True))
                accuracy = " ".join(f"{100.0 * np.mean((one[2] > 0.0) == truth):.2f}" for one in found)
                line(f"{names} {n}", *ratios, alike, accuracy, f"{np.abs(found[0][2] - found[1][2]).max():.1g}")


if __name__ == "__main__":
    main()
