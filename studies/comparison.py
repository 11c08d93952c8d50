"""Active against static sampling over seeds: campaigns and Latin hypercubes, scored on the same fresh designs.

    python studies/comparison.py campaigns/quick.toml --seeds 2 --static 20,40 --test 500       a quick look
    python studies/comparison.py campaigns/paper.toml --seeds 5 --criteria entropy,eavc --features paper,design \
        --static 250,500,1000,2000 --out runs/comparison

Printed are tables in Markdown: medians over seeds with lowest and highest values. With --out the folder gets learning
curves, and a repeated command continues with the cases that its scores.jsonl lacks. Each fresh design has copies,
displaced at random, that show whether it is near a boundary.
"""

import os
from itertools import product
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from study import Rows, asked, in_memory, markdown, parallel

from activefail.analyses.comparison.equivalent import simulations_to_reach
from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.campaign.settings import read_settings
from activefail.estimates.scores import log_score, probability_of_truth
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import learn_from
from activefail.seismic.paper.study import expected_calibration_error
from activefail.simulators.interface import NUMERICAL_FAILURE

STATIC, CUSTOM = "static", "custom"
"""Names in the tables of a Latin hypercube, and of the campaign file's own features."""

NEIGHBOURS, DISPLACEMENT = 4, 0.02
"""Displaced copies of each fresh design; the standard deviation of their displacement, in units of the ranges."""


class FreshSet(NamedTuple):
    """Designs, (n, d), their outcomes, (n,), and those of their displaced copies, (n, NEIGHBOURS)."""

    X: np.ndarray
    outcome: np.ndarray
    around: np.ndarray


def simulated(campaign, X):
    """The results of designs; those of a simulation that raises are a numerical failure."""
    with ThreadExecutor(1) as executor:
        return executor.run(campaign.simulator, X)


def fresh_set(campaign, n):
    """Fresh designs of a campaign that have an outcome."""
    space, seed = campaign.space, campaign.settings.seed
    X = space.random(n, stream(seed, "test"))
    unit = np.repeat(space.to_unit(X), NEIGHBOURS, axis=0)
    unit = np.abs(unit + DISPLACEMENT * stream(seed, "test", 1).standard_normal(unit.shape))
    copies = space.from_unit(1.0 - np.abs(1.0 - unit))  # reflected at the bounds
    outcome, around = (simulated(campaign, designs).outcome for designs in (X, copies))
    answered = outcome != NUMERICAL_FAILURE
    return FreshSet(X[answered], outcome[answered], around.reshape(n, -1)[answered])


def measures(classifier, severity, test):
    """The measures of a classifier by name; accuracy is that of the boundary below the outcome `severity`."""
    latent = classifier.latents[severity - 1].moments(classifier.features(test.X))
    beyond, predicted = test.outcome >= severity, latent.mean > 0.0
    right = predicted == beyond
    answered = test.around != NUMERICAL_FAILURE
    opposite = answered & ((test.around >= severity) != beyond[:, None])
    near = opposite.any(axis=1)
    small = beyond & (2 * opposite.sum(axis=1) >= np.maximum(answered.sum(axis=1), 1))
    probabilities = classifier.probabilities(test.X)
    of_truth = probabilities[np.arange(len(test.X)), test.outcome]
    likeliest = np.argmax(probabilities, axis=1)
    boundaries = enumerate(zip(classifier.outcomes[1:], classifier.latents, strict=True), 1)
    accuracies = {
        f"accuracy, {name} boundary": np.mean(
            (one.moments(classifier.features(test.X)).mean > 0.0) == (test.outcome >= k)
        )
        for k, (name, one) in boundaries
        if k != severity
    }
    recalls = {f"recall of {name}": (likeliest == k)[test.outcome == k] for k, name in enumerate(classifier.outcomes)}
    return {
        "accuracy": right.mean(),
        "near the boundary": _share(right[near]),
        "recall of small regions": _share(predicted[small]),
        "log score": log_score(probability_of_truth(latent.probability, beyond)),
        "calibration error": expected_calibration_error(latent.probability, beyond),
        "accuracy of outcomes": np.mean(likeliest == test.outcome),
        "log score of outcomes": log_score(of_truth),
        **accuracies,
        **{name: _share(hits) for name, hits in recalls.items()},
    }


def _share(hits):
    """NaN if there is none of a kind."""
    return np.mean(hits) if len(hits) else np.nan


class Case(NamedTuple):
    """A campaign, or a Latin hypercube of some size, with one seed."""

    features: str
    sampling: str
    size: int
    seed: int


def campaign_of(file, case=None):
    """The campaign of a file, with the features, the criterion and the seed of a case."""
    settings, changes = read_settings(file), {"validation.size": 0}
    if case is not None:
        changes |= {"seed": case.seed}
        changes |= {} if case.features == CUSTOM else {"classifier.features": case.features}
        changes |= {} if case.sampling == STATIC else {"acquisition.criterion": case.sampling}
    return Campaign.of(settings.changed(changes), file.absolute().parent)


def checkpoints(sampling):
    """Numbers of simulations at which a campaign is scored: initial, a fifth of a step, and five steps."""
    step = (sampling.budget - sampling.initial) / 5
    return sorted({sampling.initial, *(round(sampling.initial + step * part) for part in (0.2, 1, 2, 3, 4, 5))})


def scored(file, case, test):
    """A case with its scores: a number of simulations and the measures of the classifier that learns from them."""
    campaign = campaign_of(file, case)
    if case.sampling == STATIC:
        X = campaign.space.latin_hypercube(case.size, stream(case.seed, "static", case.size))
        history, sizes = History.of_sample(X, simulated(campaign, X)), [case.size]
    else:
        history, sizes = in_memory(campaign).history, checkpoints(campaign.settings.sampling)
    with one_thread():
        scores = [(n, measures(learn_from(campaign, history[:n]), campaign.severity, test)) for n in sizes]
    return case, scores


def curves_of(rows):
    """For each pair of features and sampling: sizes in order, (n,), and by measure the values of each seed, (n, s)."""
    values = {}
    for case, (n, found) in ((row, score) for row in rows for score in row["scores"]):
        of_size = values.setdefault((case["features"], case["sampling"]), {}).setdefault(n, {})
        for name, value in found.items():
            of_size.setdefault(name, []).append(np.nan if value is None else value)
    return {
        key: (np.array(sorted(sizes)), {name: np.array([sizes[n][name] for n in sorted(sizes)]) for name in measured})
        for key, sizes in values.items()
        for measured in [next(iter(sizes.values()))]
    }


def _range(values):
    """Median, with minimum and maximum over several seeds."""
    values = values[~np.isnan(values)]
    if not len(values):
        return "–"
    text = f"{np.median(values):.4f}"
    return text if len(values) == 1 else f"{text} ({values.min():.4f} to {values.max():.4f})"


def medians_of(curve):
    """Sizes and median accuracies of a curve."""
    sizes, values = curve
    return sizes, np.median(values["accuracy"], axis=1)


def to_reach(levels, others):
    """A row for each point of some curves: the simulations with which each other curve reaches its accuracy."""
    rows = []
    for (features, sampling), curve in levels.items():
        for n, level in zip(*medians_of(curve), strict=True):
            needed = [simulations_to_reach(*medians_of(other), level) for other in others.values()]
            cells = [
                f"> {other[0][-1]}" if one is None else f"{one:.0f}"
                for one, other in zip(needed, others.values(), strict=True)
            ]
            rows.append([f"{sampling}, {features}", str(n), f"{level:.4f}", *cells])
    titles = [f"{sampling}, {features}" for features, sampling in others]
    return markdown(["sampling, features", "simulations", "accuracy", *titles], rows)


def draw(curves, measure, path):
    """A measure against simulations, with a band from minimum to maximum; hypercubes are dashed."""
    figure, axes = plt.subplots(figsize=(7.6, 5.0), layout="constrained")
    for (features, sampling), (sizes, values) in curves.items():
        style = "--" if sampling == STATIC else "-"
        (drawn,) = axes.plot(
            sizes, np.median(values[measure], axis=1), style, marker="o", label=f"{sampling}, {features} features"
        )
        axes.fill_between(
            sizes, values[measure].min(axis=1), values[measure].max(axis=1), color=drawn.get_color(), alpha=0.12
        )
    axes.set(xscale="log", xlabel="simulations trained on", ylabel=measure)
    axes.legend()
    figure.savefig(path)


def main():
    options = asked(
        __doc__,
        words="file",
        seeds=5,
        criteria=[str],
        features=[str],
        static=[int],
        test=5000,
        processes=os.cpu_count(),
        out=Path,
    )
    file = Path(options.file[0])
    settings = read_settings(file)
    if reason := settings.refused.get("compare"):
        raise SystemExit(f"{file} cannot be compared: {reason}.")
    sampling, own = settings.sampling, settings.classifier.features
    criteria = options.criteria or [str(settings.acquisition.criterion)]
    features = options.features or [own if isinstance(own, str) else CUSTOM]
    static = options.static or sorted({sampling.initial, sampling.budget})
    arms = [*((criterion, sampling.budget) for criterion in criteria), *((STATIC, size) for size in static)]
    seeds = range(settings.seed, settings.seed + options.seeds)
    cases = [Case(of, *arm, seed) for seed, of, arm in product(seeds, features, arms)]

    rows = Rows(options.out and options.out / "scores.jsonl", campaign=settings.text(), test=options.test)
    lacking = [case for case in cases if rows.lack(**case._asdict())]
    if lacking:
        test = fresh_set(campaign_of(file), options.test)
        for case, scores in parallel(scored, [(file, case, test) for case in lacking], options.processes):
            # One row, so that an interrupted study has all of a case or none.
            rows.add(**case._asdict(), scores=scores)

    curves = curves_of([row for case in cases for row in rows.of(**case._asdict())])
    names = list(next(iter(curves.values()))[1])
    print(
        markdown(
            ["features", "sampling", "simulations", *names],
            [
                [*key, str(n), *(_range(values[name][k]) for name in names)]
                for key, (sizes, values) in curves.items()
                for k, n in enumerate(sizes)
            ],
        )
    )
    hypercubes, campaigns = (
        {key: curve for key, curve in curves.items() if (key[1] == STATIC) == fixed} for fixed in (True, False)
    )
    print(f"\nSimulations with which campaigns are as accurate as hypercubes:\n\n{to_reach(hypercubes, campaigns)}")
    print(f"\nSimulations with which hypercubes are as accurate as campaigns:\n\n{to_reach(campaigns, hypercubes)}")
    if options.out:
        for name in ("accuracy", "log score"):
            draw(curves, name, options.out / f"{name.replace(' ', '_')}.svg")


if __name__ == "__main__":
    main()
