"""Compare samplings over seeds: campaigns by criterion and features, and static designs, on one test set.

A comparison has a folder. Each arm, a campaign or a static design, is scored once and its scores are saved there, so
that an interrupted comparison continues where it stopped.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from activefail.analyses.comparison.measures import NEIGHBOURS, FreshSet, displaced, measures
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import create_folder, open_campaign
from activefail.campaign.random_streams import stream
from activefail.campaign.settings import CampaignSettings, parse_settings, read_settings
from activefail.errors import InputError
from activefail.estimates.stored_sets import (
    set_name,
    simulated_results,
)
from activefail.execution.local import local_executor
from activefail.execution.pool import ProcessPool
from activefail.execution.worker import stopping
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.progress import Observer
from activefail.record.layout import SETTINGS
from activefail.record.run_folder import check_empty
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.space.space import Array
from activefail.text.files import replacing
from activefail.text.trust import refuse_links

STATIC = "static"
"""The sampling of an arm that is a Latin hypercube."""

CUSTOM = "custom"
"""Name of the campaign file's custom features in arms and tables."""


_DEFINITION, _SCORES, _RUNS, _DESIGNS = "comparison.toml", "scores", "runs", "designs"
"""Files and folders of a comparison: its settings, the scores of the arms, their campaigns, and all other designs."""


@dataclass(frozen=True)
class Arm:
    """A campaign or a static design, with one seed.

    Attributes:
        features: name of the classifier's features.
        sampling: name of a criterion, or "static".
        size: number of simulations.
        seed: of the campaign or the Latin hypercube.
    """

    features: str
    sampling: str
    size: int
    seed: int

    @property
    def name(self) -> str:
        """Unique name in a comparison, usable as a file name."""
        return f"{self.features}-{self.sampling}-{self.size}-seed{self.seed}"


@dataclass(frozen=True)
class ComparisonPlan:
    """The definition of a comparison.

    Attributes:
        settings: of the campaign; its seed is the first seed, its budget that of every campaign.
        seeds: number of seeds.
        criteria, features: each combination is a campaign.
        static: sizes of the static designs.
        test: number of test designs.
        code: folder of the user's code, which is executed (see `Campaign.of`).
    """

    settings: CampaignSettings
    seeds: int
    criteria: tuple[str, ...]
    features: tuple[str, ...]
    static: tuple[int, ...]
    test: int
    code: Path | None = None

    @classmethod
    def of(
        cls,
        file: Path,
        seeds: int | None = None,
        criteria: Sequence[str] = (),
        features: Sequence[str] = (),
        static: Sequence[int] = (),
        test: int | None = None,
    ) -> Self:
        """The comparison of a campaign file: by default 5 seeds and 5000 test designs.

        Args:
            file: the campaign file; its folder holds the user's code.
            seeds, test: as for the class.
            criteria, features: by default the file's.
            static: by default the file's initial and its budget.

        Raises:
            InputError: if the file is unreadable or invalid.
        """
        settings = read_settings(file)
        if reason := settings.refused.get("compare"):
            raise InputError(f"compare: {reason}.")
        sampling, file_features = settings.sampling, settings.classifier.features
        return cls(
            settings,
            seeds or 5,
            tuple(criteria) or (str(settings.acquisition.criterion),),
            tuple(features) or (file_features if isinstance(file_features, str) else CUSTOM,),
            tuple(static) or tuple(sorted({sampling.initial, sampling.budget})),
            test or 5000,
            file.absolute().parent,
        )

    def arms(self) -> list[Arm]:
        """All arms, ordered by seed."""
        first, budget = self.settings.seed, self.settings.sampling.budget
        return [
            Arm(features, sampling, size, seed)
            for seed in range(first, first + self.seeds)
            for features in self.features
            for sampling, size in (
                *((criterion, budget) for criterion in self.criteria),
                *((STATIC, size) for size in self.static),
            )
        ]

    def settings_of(self, arm: Arm) -> CampaignSettings:
        """The settings of an arm.

        Raises:
            InputError: if one breaks a rule.
        """
        changes: dict[str, Any] = {"seed": arm.seed, "validation.size": 0}
        if arm.features != CUSTOM:
            changes["classifier.features"] = arm.features
        if arm.sampling not in (STATIC, str(self.settings.acquisition.criterion)):
            changes["acquisition.criterion"] = arm.sampling
        return self.settings.changed(changes)

    def checkpoints(self) -> list[int]:
        """Numbers of simulations at which a campaign is scored: initial, a fifth of a step, and five steps."""
        initial, budget = self.settings.sampling.initial, self.settings.sampling.budget
        step = (budget - initial) / 5
        return sorted({initial, *(round(initial + step * part) for part in (0.2, 1, 2, 3, 4, 5))})


@dataclass(frozen=True)
class ArmScore:
    """The measures of an arm after a number of simulations."""

    arm: Arm
    simulations: int
    measures: dict[str, float]


def _campaign_rows(
    folder: Path, campaign: Campaign, checkpoints: Sequence[int], code: Path | None
) -> Iterator[tuple[int, History]]:
    """Run a campaign to its last checkpoint; yields size and simulations at each. Nothing if stopped."""
    # Loads torch, which what draws learning curves does without.
    from activefail.loop.running import run

    if not (folder / SETTINGS).exists():
        create_folder(folder, campaign).close()
    with (
        open_campaign(folder, write=True, code=code) as (recorded, store),
        local_executor(recorded.simulator, 1, recorded.time_limit) as executor,
    ):
        if not run(recorded, store, executor, checkpoints[-1], Observer(stop=stopping)):
            return
        history = History.of(store.batches)
        for n in checkpoints:
            yield n, history[:n]


def score_arm(
    arm: Arm,
    settings: str,
    checkpoints: Sequence[int],
    folder: Path,
    test: FreshSet,
    static: History | None,
    code: Path | None,
) -> list[ArmScore] | None:
    """Score an arm in a worker process; None if stopped.

    Args:
        arm, settings: the arm, and the settings of its campaign as text.
        checkpoints: numbers of simulations at which a campaign is scored.
        folder: of the comparison.
        test: what scores.
        static: the simulations of a static design.
        code: folder of the user's code.
    """
    from activefail.loop.learning import learn_from

    campaign = Campaign.of(parse_settings(settings, arm.name), code)
    with one_thread():
        if static is None:
            rows = _campaign_rows(folder / _RUNS / arm.name, campaign, checkpoints, code)
        else:
            rows = iter([(arm.size, static)])
        scores = []
        for n, known in rows:
            if stopping():
                return None
            scores.append(ArmScore(arm, n, measures(learn_from(campaign, known), campaign.severity, test)))
    return scores or None


def _saved(path: Path) -> list[ArmScore] | None:
    if not path.exists():
        return None
    rows = json.loads(path.read_text(encoding="utf-8"))
    return [ArmScore(Arm(**row["arm"]), row["simulations"], row["measures"]) for row in rows]


def _save(path: Path, scores: list[ArmScore]) -> None:
    with replacing(path) as file:
        json.dump([asdict(score) for score in scores], file, indent=1)


def prepare(folder: Path, plan: ComparisonPlan) -> None:
    """Create the folder of a comparison, or check that it holds the same comparison.

    Raises:
        InputError: if it holds another comparison or other files.
        StoreError: if a file or folder of it is a symbolic link.
    """
    text, judged_by = plan.settings.text(), f"\n# fresh designs to judge by: {plan.test}\n"
    path = folder / _DEFINITION
    refuse_links(folder, (_DEFINITION, _SCORES, _RUNS, _DESIGNS))
    if path.exists():
        held = path.read_text(encoding="utf-8")
        if not held.endswith(judged_by) or parse_settings(held, str(path)).text() != text:
            raise InputError(f"{folder}: holds a comparison of another campaign or test set; choose another folder.")
    else:
        check_empty(folder, "comparison", "Choose another one.")
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            file.write(text + judged_by)
    for part in (_SCORES, _RUNS):
        (folder / part).mkdir(exist_ok=True)


def _simulated(plan: ComparisonPlan, folder: Path, stage: Callable[[str], None]) -> tuple[FreshSet, dict[Arm, History]]:
    """The test set and the static designs with their outcomes, stored in the folder `designs`."""
    campaign = Campaign.of(plan.settings.changed({"validation.size": 0}), plan.code, folder)
    space, first = campaign.space, plan.settings.seed
    designs = folder / _DESIGNS
    if not (designs / SETTINGS).exists():
        create_folder(designs, campaign).close()
    with (
        open_campaign(designs, write=True, code=plan.code) as (_, store),
        local_executor(campaign.simulator, time_limit=campaign.time_limit) as executor,
    ):

        def simulated(name: str, X: Array) -> Results:
            results = simulated_results(campaign, store, executor, name, X)
            assert results is not None  # no stop was requested
            return results

        stage(f"simulating {plan.test} test designs and {NEIGHBOURS} designs around each")
        X = space.random(plan.test, stream(first, "test"))
        outcome = simulated(set_name("test", plan.test), X).outcome
        neighbours = displaced(X, space, stream(first, "test", 1))
        around = simulated(set_name("around", plan.test), neighbours).outcome.reshape(len(X), -1)
        answered = outcome != NUMERICAL_FAILURE
        test = FreshSet(X[answered], outcome[answered], around[answered])
        static = {}
        for arm in (arm for arm in plan.arms() if arm.sampling == STATIC):
            stage(f"simulating a static design of {arm.size}, seed {arm.seed}")
            hypercube = space.latin_hypercube(arm.size, stream(arm.seed, "static", arm.size))
            results = simulated(set_name("static", arm.size, f"seed{arm.seed}"), hypercube)
            static[arm] = History.of_sample(hypercube, results)
    return test, static


def compare_seeds(
    plan: ComparisonPlan,
    folder: Path,
    jobs: int,
    stage: Callable[[str], None] = lambda _: None,
    done: Callable[[int, int], None] = lambda _done, _total: None,
    stop: Callable[[], bool] = lambda: False,
) -> list[ArmScore] | None:
    """Score all arms, `jobs` in parallel; None if stopped, with the scores so far saved.

    Raises:
        InputError: if the folder holds another comparison, or settings and features are inconsistent.
        SimulationError: if a worker process dies.
    """
    arms = plan.arms()
    settings = {arm: plan.settings_of(arm) for arm in arms}
    for arm in {(arm.features, arm.sampling): arm for arm in arms}.values():
        Campaign.of(settings[arm], plan.code)  # reject inconsistent settings before writing anything
    prepare(folder, plan)
    files = {arm: folder / _SCORES / f"{arm.name}.json" for arm in arms}
    scores = {arm: saved for arm, path in files.items() if (saved := _saved(path)) is not None}
    if len(scores) < len(arms):
        test, static = _simulated(plan, folder, stage)
        stage("campaigns and classifiers")
        with ProcessPool(jobs, "scores are kept") as pool:
            futures = {
                pool.submit(
                    score_arm, arm, settings[arm].text(), plan.checkpoints(), folder, test, static.get(arm), plan.code
                ): arm
                for arm in arms
                if arm not in scores
            }
            pending, stop_requested = set(futures), False
            while pending and not stop_requested:
                finished, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in finished:
                    if (found := future.result()) is not None:
                        arm = futures[future]
                        _save(files[arm], found)
                        scores[arm] = found
                        done(len(scores), len(arms))
                stop_requested = stop()
            pool.ask_to_stop()
    if len(scores) < len(arms):
        return None
    return [score for arm in arms for score in scores[arm]]


@dataclass(frozen=True)
class Point:
    """A measure of one sampling after a number of simulations, over the seeds."""

    simulations: int
    values: Array  # (seeds,)


def curves(scores: list[ArmScore], measure: str) -> dict[tuple[str, str], list[Point]]:
    """Points by features and sampling, ordered by simulations."""
    values: dict[tuple[str, str], dict[int, list[float]]] = {}
    for score in scores:
        by_size = values.setdefault((score.arm.features, score.arm.sampling), {})
        by_size.setdefault(score.simulations, []).append(score.measures[measure])
    return {key: [Point(n, np.array(one)) for n, one in sorted(by_size.items())] for key, by_size in values.items()}


def simulations_to_reach(points: list[Point], level: float) -> float | None:
    """Simulations at which a curve of medians first reaches a level, interpolated in log n; None if never."""
    n = np.array([point.simulations for point in points], dtype=float)
    medians = np.array([np.median(point.values) for point in points])
    reached = np.nonzero(medians >= level)[0]
    if not len(reached):
        return None
    after = int(reached[0])
    if after == 0:
        return float(n[0])
    share = (level - medians[after - 1]) / (medians[after] - medians[after - 1])
    return float(np.exp(np.log(n[after - 1]) + share * np.log(n[after] / n[after - 1])))
