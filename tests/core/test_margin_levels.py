"""One margin for several boundaries, and margins that the campaign file says to end at failure."""

import json
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, record
from scipy.special import ndtr

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.run.opening import open_run

SPACE = """
[space]
x = { distribution = "normal", mean = 0, sd = 1 }
y = { distribution = "normal", mean = 0, sd = 1 }
"""

LIMITS = """
def drift(design):
    return 4.0 - design["x"] + 0.1 * design["y"]

def scattered(design):
    g = 2.5 - design["x"] + 0.1 * design["y"]
    # What is left where the simulation ends depends on chance.
    return g if g > 0 else -2.0 * (1000.0 * design["y"] % 1.0)
"""

LEVELS = (2.0, 1.0)


@pytest.fixture(scope="module")
def levelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("levels")
    (folder / "limit.py").write_text(LIMITS)
    (folder / "made.toml").write_text(
        'simulator = { python = "limit:drift", outcomes = ["safe", "damage", "collapse"], margins = ["g"], '
        f"levels = {{ g = {list(LEVELS)} }} }}\n"
        'stop = { probability = "collapse" }\nsampling = { budget = 60 }\n'
        "acquisition = { boundary = { damage = 1, collapse = 1 } }\n" + SPACE
    )
    result = activefail("run", folder / "made.toml", "--out", folder / "run")
    assert result.code == 0, result.err
    assert "damage from the margin g" in result.out
    assert "collapse from the margin g" in result.out
    return folder


def test_each_outcome_is_that_of_its_level(levelled: Path) -> None:
    for row in record(levelled / "run"):
        expected = ["safe", "damage", "collapse"][sum(float(row["g"]) <= level for level in LEVELS)]
        assert row["outcome"] == expected


@pytest.mark.parametrize(("outcome", "level"), list(zip(("damage", "collapse"), LEVELS, strict=True)))
def test_each_boundary_is_learned_from_the_one_margin(levelled: Path, outcome: str, level: float) -> None:
    true = float(ndtr(-(4.0 - level) / 1.01**0.5))
    result = activefail(
        "probability", levelled / "run", "--code", levelled, "--outcome", outcome, "--simulations", "20", "--json"
    )
    assert result.code == 0, result.err
    estimate = json.loads(result.out)["outcomes"][outcome]
    assert estimate["learned_from"] == "g"
    assert estimate["low"] <= true <= estimate["high"]
    assert estimate["probability"] == pytest.approx(true, rel=0.1)


def test_a_saved_classifier_of_levels_is_restored(levelled: Path) -> None:
    with open_run(levelled / "run", code=levelled) as run:
        damage, collapse = run.classifier.latents
        margin = run.history.training.margins[:, 0]
    # One regression, of which each boundary is a level.
    assert damage.trained is collapse.trained
    assert np.array_equal(collapse.trained.data.margin, margin - LEVELS[1])
    assert (damage.level, collapse.level) == (LEVELS[0] - LEVELS[1], 0.0)


def test_one_margin_has_one_latent_so_that_an_outcome_is_as_probable_as_its_levels_say(levelled: Path) -> None:
    with open_run(levelled / "run", code=levelled) as run:
        latent = run.classifier.latents[1]
        designs = run.space.sobol(512, np.random.default_rng(0))
        moments = latent.moments(run.features(designs))
        predicted = run.predict(designs)
    for outcome, level in zip(("p_damage", "p_collapse"), LEVELS, strict=True):
        below = ndtr((latent.trained.data.warped(np.array(level - LEVELS[1])) + moments.mean) / moments.sd)
        beyond = predicted["p_collapse"] + (predicted["p_damage"] if outcome == "p_damage" else 0.0)
        # A regression without noise amplifies rounding, which differs between the two readers.
        assert beyond.to_numpy() == pytest.approx(below, abs=1e-4)


@pytest.mark.parametrize("declared", [False, True])
def test_margins_that_end_at_failure_are_censored_if_the_campaign_says_so(tmp_path: Path, declared: bool) -> None:
    (tmp_path / "limit.py").write_text(LIMITS)
    (tmp_path / "made.toml").write_text(
        'simulator = { python = "limit:scattered", margins = ["g"]'
        + (', truncated = ["g"] }\n' if declared else " }\n")
        + 'classifier = { learns = "g" }\nsampling = { initial = 40, budget = 40 }\n'
        + SPACE.replace("mean = 0", "mean = 1", 1)
    )
    assert activefail("run", tmp_path / "made.toml", "--out", tmp_path / "run").code == 0
    with open_run(tmp_path / "run", code=tmp_path) as run:
        (latent,) = run.classifier.latents
        failed = run.history.training.outcome == 1
        assert np.ptp(run.history.training.margins[failed, 0]) > 0.1
        assert latent.trained.data.truncated == declared
        assert (np.ptp(latent.trained.data.margin[failed]) == 0.0) == declared


def test_margins_that_end_at_the_last_outcome_say_nothing_exact_of_an_earlier_one() -> None:
    settings = parse_settings(
        'simulator = { python = "limit:run", outcomes = ["safe", "damage", "collapse"], margins = ["g", "h"], '
        'levels = { g = [1.0, 0.0] }, truncated = ["g"] }\n' + SPACE,
        "made.toml",
    )
    campaign = Campaign.of(settings)
    outcome = np.array([0, 1, 2, -1], dtype=np.int8)
    margins = np.array([[2.5, 1.0], [0.5, 2.0], [-3.0, 3.0], [np.nan, np.nan]])
    for severity, level in ((1, 1.0), (2, 0.0)):
        related = campaign.margins_at(severity, outcome, margins)
        assert np.array_equal(related[:, 0], [2.5 - level, 0.5 - level, np.nan, np.nan], equal_nan=True)
        assert np.array_equal(related[:, 1], margins[:, 1], equal_nan=True)
    assert margins[2, 0] == -3.0
