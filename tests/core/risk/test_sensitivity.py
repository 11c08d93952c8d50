"""The sensitivity of a probability: indices against closed forms, one variable at a time, and what is refused."""

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, refused, table
from scipy.special import ndtri

from activefail import open_run
from activefail.analyses.sensitivity import calculation as module
from activefail.analyses.sensitivity.calculation import default_samples, sensitivity
from activefail.analyses.sensitivity.logistic import variable_p_values
from activefail.analyses.sensitivity.sobol import Estimate, decomposed
from activefail.campaign.assembly import Campaign
from activefail.campaign.inquiry import Inquiry
from activefail.loop.history import History
from activefail.run.run import Run
from activefail.simulators.interface import Results
from activefail.space.space import Array

CAMPAIGN = """
simulator = { python = "blocks:reserve", margins = ["reserve"] }
sampling = { initial = 16, budget = 16 }
[classifier]
features = "design"
[space]
mu = { low = 0.02, high = 0.12 }
D_tot = { low = 0.4, high = 0.9, unit = "m" }
T_p = { low = 1.0, high = 6.0, unit = "s" }
A_p = { low = 0.1, high = 1.0, unit = "g" }
"""

BLOCKS = """
def reserve(design):
    return design["D_tot"] + 3.0 * design["mu"] - 0.2 * design["A_p"] * design["T_p"]
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sensitivity")
    (folder / "blocks.py").write_text(BLOCKS)
    (folder / "made.toml").write_text(CAMPAIGN)
    (folder / "fixed.toml").write_text("D_tot = 0.6\n")
    result = activefail("run", folder / "made.toml", "--out", folder / "run")
    assert result.code == 0, result.err
    return folder


@pytest.fixture(scope="module")
def run(home: Path) -> Iterator[Run]:
    with open_run(home / "run", code=home) as opened:
        yield opened


@pytest.fixture(scope="module")
def campaign(run: Run) -> Campaign:
    return run.campaign


def alone(boundary: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """One boundary as all boundaries of a classifier."""
    return lambda X: boundary(X)[:, None]


def contains(estimate: Estimate, true: float) -> bool:
    return estimate.low <= true <= estimate.high


# --- closed forms ------------------------------------------------------------------------------------------------


def ishigami(U: Array) -> Array:
    x, y, z = (np.pi * (2.0 * U - 1.0)).T
    return np.asarray(np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x))


def test_the_indices_of_ishigamis_function_are_the_known_ones() -> None:
    found = decomposed(ishigami, "xyz", 2048, 0.99)
    known = {"x": (0.3139, 0.5576), "y": (0.4424, 0.4424), "z": (0.0, 0.2437)}
    assert [index.name for index in found.indices] == list(known)
    for name, first, total in found.indices:
        assert contains(first, known[name][0]), name
        assert contains(total, known[name][1]), name
        assert first.high - first.low < 0.25
    assert found.mean == pytest.approx(3.5, abs=0.02)
    assert found.sd == pytest.approx(13.8446**0.5, rel=0.02)


def test_the_intervals_cover_the_known_indices_of_most_samples() -> None:
    known = np.array([[0.3139, 0.5576], [0.4424, 0.4424], [0.0, 0.2437]])
    covered = [
        [
            [contains(index.first, first), contains(index.total, total)]
            for index, (first, total) in zip(found, known, strict=True)
        ]
        for found in (decomposed(ishigami, "xyz", 256, 0.95, seed).indices for seed in range(1, 41))
    ]
    shares = np.mean(covered, axis=0)
    assert shares.mean() >= 0.95
    # Of 40 samples with 95 % coverage, fewer than 32 cover with a probability of 10⁻⁴.
    assert shares.min() >= 0.8


def test_a_constant_function_has_no_indices() -> None:
    assert decomposed(lambda U: np.full(len(U), 0.3), "ab", 16, 0.95).indices == ()


def test_ripples_of_a_constant_have_no_indices() -> None:
    assert decomposed(lambda U: 4e-5 + 3e-7 * U[:, 0], "ab", 16, 0.95).indices == ()
    assert decomposed(lambda U: 1.0 - 4e-5 - 3e-7 * U[:, 0], "ab", 16, 0.95).indices == ()
    assert len(decomposed(lambda U: 4e-5 * U[:, 0], "ab", 16, 0.95).indices) == 2


@pytest.mark.parametrize(("level", "ended"), [(0.35, "No"), (-0.35, "Every")])
def test_a_campaign_whose_simulations_all_end_alike_has_nothing_to_explain(
    tmp_path: Path, level: float, ended: str
) -> None:
    (tmp_path / "tank.py").write_text(f"def tank(d):\n    return {level}\n")
    (tmp_path / "tank.toml").write_text(
        'simulator = { python = "tank:tank", margins = ["freeboard"] }\nsampling = { initial = 8, budget = 8 }\n'
        "[space]\nlevel = { low = 1, high = 2 }\nPGA = { low = 0.05, high = 0.3 }\n"
    )
    assert activefail("run", tmp_path / "tank.toml", "--out", tmp_path / "run").code == 0
    result = activefail("sensitivity", tmp_path / "run", "--code", tmp_path, "--samples", "64")
    assert result.code == 0, result.err
    assert f"{ended} simulation of the campaign ended in failure, so there is nothing to explain" in result.out
    assert "first index" not in result.out
    assert "length scales" not in result.out


def test_the_indices_of_a_question_are_those_of_its_distributions(campaign: Campaign, tmp_path: Path) -> None:
    file = tmp_path / "asked.toml"
    file.write_text(
        "[space]\nmu = { value = 0.05 }\n"
        'A_p = { distribution = "truncated_normal", mean = 0.5, sd = 0.05, low = 0.1, high = 0.9, unit = "g" }\n'
    )
    asked = Inquiry.of(campaign, None, file, None)

    def additive(X: Array) -> Array:
        assert (X[:, 0] == 0.05).all()
        return np.asarray(ndtri(0.1 + 0.4 * X[:, 1] + 0.5 * X[:, 3]))

    counted: list[int] = []
    found = sensitivity(
        asked,
        alone(additive),
        "failure",
        1024,
        0.99,
        lambda total: [counted.append(-total), counted.append][1],
    )
    parts = {"D_tot": 0.4**2 * 0.5**2 / 12.0, "A_p": 0.5**2 * 0.05**2, "T_p": 0.0}
    assert [index.name for index in found.indices] == ["D_tot", "A_p", "T_p"]
    for name, first, total in found.indices:
        true = parts[name] / sum(parts.values())
        assert contains(first, true)
        assert contains(total, true)
        assert total.value == pytest.approx(true, abs=0.02)
    assert found.mean == pytest.approx(0.1 + 0.4 * 0.65 + 0.25, abs=1e-3)
    assert found.outside == 0.0
    assert sum(counted) == 0
    assert not found.is_given_designs


# --- what is said ------------------------------------------------------------------------------------------------


def test_notes_warn_of_wide_intervals_impossible_estimates_and_rare_outcomes(campaign: Campaign) -> None:
    def corner(X: Array) -> Array:
        return np.where((X[:, 0] > 0.08) & (X[:, 1] < 0.5) & (X[:, 2] > 4.0), 9.0, -9.0)

    few = sensitivity(Inquiry(campaign, campaign.question), alone(corner), "failure", 16)
    told = " ".join(few.notes)
    assert "16 samples are too few" in told
    assert "`--samples 64`" in told
    assert any(index.first.value < 0.0 for index in few.indices)
    assert "Estimates below 0 or above 1 are sampling errors" in told
    assert "of 32 sampled designs lie on the rarer side" in told
    many = sensitivity(Inquiry(campaign, campaign.question), alone(lambda X: ndtri(X[:, 0])), "failure", 4096)
    assert not any("too few" in note or "rarer" in note for note in many.notes)


def test_the_default_number_of_samples_is_an_affordable_power_of_two() -> None:
    for variables, points in ((9, 1), (7, 128), (3, 128), (1, 1), (30, 4096)):
        samples = default_samples(variables, points)
        assert samples & (samples - 1) == 0
        assert samples * (variables + 2) * points <= 600_000 or samples == 64
    assert default_samples(7, 128) == 512


def test_p_values_are_those_of_the_initial_design_and_need_both_sides(campaign: Campaign) -> None:
    rng = np.random.default_rng(1)
    X = campaign.space.latin_hypercube(200, rng)
    # A_p decides, not always.
    beyond = X[:, 3] + 0.2 * rng.standard_normal(200) > 0.5
    nothing = np.full(200, np.nan)
    results = Results(beyond.astype(np.int8), np.zeros(200, dtype=np.int8), nothing[:, None], nothing)
    history = History.of_sample(X, results)
    found = variable_p_values(campaign.space, history, 1)
    assert list(found) == list(campaign.space.names)
    assert found["A_p"] < 1e-6
    assert min(found["mu"], found["D_tot"], found["T_p"]) > 1e-3
    assert variable_p_values(campaign.space, history[~beyond], 1) == {}
    assert variable_p_values(campaign.space, history[:3], 1) == {}


# --- the command -------------------------------------------------------------------------------------------------


def test_the_command_prints_the_indices_and_writes_table_and_page(home: Path, tmp_path: Path) -> None:
    options = ("--code", home, "--samples", "64")
    done = activefail("sensitivity", home / "run", *options, "--csv", tmp_path / "all.csv", "--out", tmp_path / "page")
    assert done.code == 0, done.err
    assert "sensitivity of the probability of failure under the design measure" in done.out
    assert "first index (95 % interval)" in done.out
    assert "no simulation" in done.out
    rows = table(tmp_path / "all.csv")
    assert {row["variable"] for row in rows} == {"mu", "D_tot", "T_p", "A_p"}
    assert all(float(row["first_low"]) <= float(row["first"]) <= float(row["first_high"]) for row in rows)
    assert all(float(row["length_scale"]) > 0.0 and row["probability_at_low"] == "" for row in rows)
    numbers = json.loads(activefail("sensitivity", home / "run", *options, "--json").out)
    assert [index["variable"] for index in numbers["indices"]] == [row["variable"] for row in rows]
    assert numbers["indices"][0]["total"]["value"] == float(rows[0]["total"])
    assert numbers["probability"] is None
    page = tmp_path / "page"
    assert {file.name for file in page.iterdir()} == {
        *("sensitivity.md", "sensitivity.csv", "indices.svg", "indices.png"),
    }
    assert "## Sobol' indices" in (page / "sensitivity.md").read_text()
    assert (page / "sensitivity.csv").read_text() == (tmp_path / "all.csv").read_text()


def test_the_method_takes_a_question_as_an_object(run: Run) -> None:
    question = run.sensitivity(question=run.asked(fixed={"mu": 0.05}), samples=16)
    assert {index.name for index in question.indices} == {"D_tot", "T_p", "A_p"}
    assert set(question.length_scales) == {"mu", "D_tot", "T_p", "A_p"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--samples", "100"], "samples: must be a power of two of at least 16, got 100"),
        (["--fixed", "unknown.toml"], "unknown.toml: q: is not a variable of the campaign"),
        (["--question", "correlated.toml"], "T_p and A_p have the correlation 0.5"),
    ],
)
def test_what_cannot_be_answered_is_refused(
    home: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], message: str
) -> None:
    monkeypatch.chdir(home)
    files = {
        "unknown.toml": "q = 1.0\n",
        "correlated.toml": 'correlation = [["T_p", "A_p", 0.5]]\n[space]\nmu = { value = 0.05 }\n',
    }
    for name, text in files.items():
        (home / name).write_text(text)
    monkeypatch.setattr(module, "decomposed", lambda *_: pytest.fail("evaluated first"))
    refused(activefail("sensitivity", "run", "--code", home, *options), message)


def test_without_salib_the_message_says_how_to_install_it(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "SALib.sample.sobol", None)
    result = activefail("sensitivity", home / "run", "--code", home, "--samples", "16")
    refused(result, "requires the package SALib; install it with `pip install 'activefail[sensitivity]'`")
