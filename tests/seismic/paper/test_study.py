import contextlib
import io
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import some
from commandline import activefail
from scipy.special import expit

from activefail.analyses.sensitivity.logistic import logistic_regression
from activefail.cli import main
from activefail.seismic.bearing import TABLE_1, Model, simulate
from activefail.seismic.features import paper_features
from activefail.seismic.figures.paper_planes import FIGURES
from activefail.seismic.ida.sample_mean import Estimate
from activefail.seismic.paper import published
from activefail.seismic.paper import study as paper
from activefail.seismic.paper.claims import BY_CHANCE, CONCLUSIONS, NOT_REPRODUCED, REPRODUCED, claims, medians_outside
from activefail.seismic.paper.reproduction import render, table_2, write_reproduction
from activefail.seismic.paper.study import METHODS, SPLITS, TILTED, VARIANTS, Draw, Logistic, Process, run_study

DOCS = Path(__file__).parents[3] / "docs"
STUDY = {"draws": 2, "fresh": 60, "seed": 3}
SIZE, SPLITS_OF_STUDY = 100, 2


@pytest.fixture(scope="module")
def study():
    """A study of smaller draws and fewer splits than the paper's, in one process: loading a second takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper, "SIZE", SIZE)
        patch.setattr(paper, "SPLITS", SPLITS_OF_STUDY)
        patch.setattr("os.cpu_count", lambda: 1)
        return run_study(**STUDY)


def test_the_draws_are_latin_hypercubes_of_their_own_and_the_fresh_designs_are_of_neither():
    X, fresh = paper.designs(3, 500, 1)
    assert X.shape == (3, 250, 9)
    for draw in X:
        strata = np.floor(250 * TABLE_1.to_unit(draw)).astype(int)
        assert all(sorted(column) == list(range(250)) for column in strata.T)
    assert not np.array_equal(X[0], X[1])
    assert not (fresh[:, None] == X.reshape(-1, 9)[None]).all(axis=2).any()


def test_more_draws_do_not_change_the_first_ones():
    assert np.array_equal(paper.designs(2, 10, 5)[0], paper.designs(4, 10, 5)[0][:2])


def test_the_outcomes_are_the_simulators(study):
    answers = simulate(study.data.X[1][:20])
    assert np.array_equal(study.data.outcome[1][:20], answers.outcome)
    assert np.array_equal(study.data.outcome_fresh[:10], simulate(study.data.X_fresh[:10]).outcome)


def test_a_draw_studied_alone_is_the_draw_of_the_study(study):
    alone = paper.study_draw(
        study.data.X[1], study.data.outcome[1], study.data.X_fresh, study.data.outcome_fresh, 3, 1, ("laplace",), 2
    )
    there = study.draws[1].processes["laplace"]
    # Accuracies of few designs can agree by chance.
    assert np.array_equal(alone.processes["laplace"].probability, there.probability)
    assert alone.processes["laplace"].fresh == there.fresh
    assert np.array_equal(alone.logistic["failure"].p_values, study.draws[1].logistic["failure"].p_values)
    assert np.array_equal(alone.held_out, study.draws[1].held_out[:2])


def test_the_splits_of_a_draw_are_others_each_time(study):
    for draw in study.draws:
        assert len(draw.held_out) == SPLITS_OF_STUDY
    splits = [paper.split(np.random.default_rng([3, 2, 0, number]), 250) for number in range(2)]
    for train, held_out in splits:
        assert len(held_out) == 62
        assert sorted([*train, *held_out]) == list(range(250))
    assert not np.array_equal(splits[0][1], splits[1][1])


def test_the_regression_compared_on_fresh_designs_saw_the_points_that_the_processes_saw(study):
    X, failed = study.data.X[0], study.data.outcome[0] == 2
    train, _ = paper.split(np.random.default_rng([3, 2, 0, 0]), SIZE)
    fitted = logistic_regression(paper_features(X[train]), failed[train])
    expected = fitted.accuracy(paper_features(study.data.X_fresh), study.data.outcome_fresh == 2)
    assert study.draws[0].three_quarters == pytest.approx(expected)


def test_table_2_in_the_papers_units_is_the_features_with_the_amplitude_in_g_and_the_displacement_in_millimetres():
    X, _ = paper.designs(2, 1, 1)
    flat = X.reshape(-1, 9)
    T_p, A_p, D_tot, p, k = flat[:, 7], flat[:, 8], flat[:, 2], flat[:, 5] * 1e6, flat[:, 6]
    displacement = A_p * (T_p / (2 * np.pi)) ** 2
    rows = published.table_2(X)
    assert rows[0].median[1] == pytest.approx(np.median((displacement / D_tot)[250:]), rel=1e-12)
    k_norm = k / (p * np.sqrt(1000 * displacement))
    assert rows[5].median[0] == pytest.approx(np.median(k_norm[:250]), rel=1e-12)
    assert rows[5].low[1] == pytest.approx(k_norm[250:].min(), rel=1e-12)
    assert rows[2].high[0] == pytest.approx(paper_features(flat[:250])[:, 2].max())


def test_no_design_leaves_what_table_1_attains_and_some_come_near():
    X = np.random.default_rng(0).random((200_000, 9))
    F = paper_features(TABLE_1.from_unit(X))
    for row, column in zip(published.table_2(np.zeros((2, 1, 9)) + TABLE_1.low), F.T, strict=True):
        low, high = row.attainable
        values = row.factor * column
        assert low <= values.min() < low + 0.05 * (high - low)
        assert 0.5 * high < values.max() <= high


def test_tilted_designs_have_the_papers_two_medians_and_leave_the_other_variables_alone():
    X = TABLE_1.sobol(2**14, np.random.default_rng(4))
    moved = published.tilted(X)
    medians = np.median(paper_features(moved), axis=0)
    assert medians[2] == pytest.approx(published.TABLE_2[2][1], abs=0.002)
    assert medians[3] == pytest.approx(published.TABLE_2[3][1], abs=0.002)
    assert TABLE_1.contains(moved).all()
    others = [i for i in range(9) if i not in (published.AMPLITUDE, published.SLIDER_HEIGHT)]
    assert moved[:, others] == pytest.approx(X[:, others], rel=1e-12)
    assert (moved[:, published.AMPLITUDE] >= X[:, published.AMPLITUDE] * (1 - 1e-12)).all()
    assert (moved[:, published.SLIDER_HEIGHT] <= X[:, published.SLIDER_HEIGHT] * (1 + 1e-12)).all()


def test_the_calibration_error_is_zero_for_shares_that_come_and_the_gap_otherwise():
    p = np.repeat([0.25, 0.75], 40)
    y = np.concatenate([np.arange(40) < 10, np.arange(40) < 30])
    assert paper.expected_calibration_error(p, y) == pytest.approx(0.0)
    assert paper.expected_calibration_error(np.repeat([0.05, 0.95], 40), y) == pytest.approx(0.2)


def test_calibration_of_probabilities_that_mean_what_they_say_and_of_ones_that_exaggerate():
    rng = np.random.default_rng(5)
    log_odds = rng.normal(0.0, 2.0, 40_000)
    y = rng.random(len(log_odds)) < expit(log_odds)
    assert paper.expected_calibration_error(expit(log_odds), y) < 0.01
    assert paper.calibration_slope(expit(log_odds), y) == pytest.approx(1.0, abs=0.05)
    assert paper.expected_calibration_error(expit(2.0 * log_odds), y) > 0.05
    assert paper.calibration_slope(expit(2.0 * log_odds), y) == pytest.approx(0.5, abs=0.03)


def test_intervals_cover_the_mean_and_the_next_sample_as_often_as_they_say():
    rng = np.random.default_rng(6)
    means = rng.normal(0.0, 1.0, (4000, 9))
    values = means[..., None] + rng.normal(0.0, 2.0, (4000, 9, 4))
    estimates = [Estimate.over(sample[:-1]) for sample in values]
    covers_mean = np.mean([e.of_mean[0] <= 0.0 <= e.of_mean[1] for e in estimates])
    covers_one = np.mean([e.of_one[0] <= v[-1, 0] <= e.of_one[1] for e, v in zip(estimates, values, strict=True)])
    assert covers_mean == pytest.approx(0.95, abs=0.015)
    # Student's t with the degrees of freedom of the samples alone is cautious for repetitions.
    assert 0.94 < covers_one < 0.985


def test_a_variant_that_is_the_default_moves_no_outcome(study):
    assert study.variants[0].name == next(iter(VARIANTS))
    assert study.variants[0].draws is study.draws
    assert study.variants[0].data is study.data
    assert all(variant.moved > 0.0 for variant in study.variants[1:-1])


def test_the_tilted_variant_is_of_other_designs(study):
    variant = study.variants[-1]
    assert (variant.name, variant.moved) == (TILTED, None)
    assert np.array_equal(variant.data.X, published.tilted(study.data.X))
    assert np.array_equal(variant.data.outcome[0][:10], simulate(variant.data.X[0][:10]).outcome)


def test_a_variant_counts_the_outcomes_that_its_model_moves(study):
    assembly = simulate(study.data.X.reshape(-1, 9), Model(restitution="assembly")).outcome
    moved = np.mean(assembly != study.data.outcome.ravel())
    variant = next(v for v in study.variants if "assembly" in v.name)
    assert variant.moved == pytest.approx(moved)


def made(p_values=published.P_VALUES, held_out=0.97, fresh=0.95):
    """A draw with these statistics, by default the paper's."""
    logistic = {name: Logistic(published.LOGISTIC[name], 0.9, np.array(p), False) for name, p in p_values.items()}
    lengths = np.array([1.0, 1.0, 1.0, 20.0, 20.0, 20.0])
    process = Process(held_out, fresh, -0.1, 0.02, 1.0, lengths, np.zeros(6, dtype=bool), True, np.full(4, 0.5))
    return Draw(logistic, 0.9, dict.fromkeys(METHODS, process), np.full(SPLITS, held_out))


def verdicts(study, draws):
    return {line.item: line.verdict for line in claims(replace(study, draws=draws))}


@pytest.mark.parametrize(
    ("change", "item"),
    [
        ({"failure": (0.2, 0.004, 7e-7, 0.20, 0.52, 0.24)}, "features significant for failure"),
        ({"impact": (0.012, 0.01, 0.028, 0.689, 0.204, 0.755)}, "features significant for impact"),
    ],
)
def test_a_claim_that_does_not_hold_is_called_not_reproduced(study, change, item):
    as_paper = verdicts(study, [made()] * 4)
    assert as_paper[item] == REPRODUCED
    otherwise = verdicts(study, [made(published.P_VALUES | change)] * 4)
    assert otherwise == as_paper | {item: NOT_REPRODUCED}


def with_process(draw, method, **changes):
    return replace(draw, processes=draw.processes | {method: replace(draw.processes[method], **changes)})


ALIKE = np.array([1.0, 1.0, 1.0, 9.0, 9.0, 9.0])


@pytest.mark.parametrize(
    ("item", "otherwise"),
    [
        ("expectation propagation against Laplace, fresh accuracy", ("ep", {"fresh": 0.956})),
        ("length scales, insignificant over significant features", ("laplace", {"length_scales": ALIKE})),
    ],
)
def test_processes_that_differ_from_the_papers_are_not_called_reproduced(study, item, otherwise):
    method, changes = otherwise
    assert verdicts(study, [made()] * 4)[item] == REPRODUCED
    assert verdicts(study, [with_process(made(), method, **changes)] * 4)[item] == NOT_REPRODUCED


def test_a_figure_that_single_samples_reach_but_their_mean_does_not_is_called_that(study):
    item = "Gaussian process (Laplace), failure, held-out quarter"
    assert verdicts(study, [made(held_out=0.97)] * 4)[item] == REPRODUCED
    spread = [made(held_out=value) for value in (0.91, 0.93, 0.92, 0.94, 0.96, 0.92, 0.93, 0.91)]
    assert verdicts(study, spread)[item] == BY_CHANCE
    assert verdicts(study, [made(held_out=0.90)] * 4)[item] == NOT_REPRODUCED


def test_each_conclusion_holds_of_the_papers_own_figures_and_can_be_overturned():
    as_paper = [made(), made(held_out=0.969)]
    assert all(holds(as_paper) for holds in CONCLUSIONS.values())
    weak = [made(dict.fromkeys(published.P_VALUES, (0.5,) * 6), held_out=0.8, fresh=0.85)] * 2
    weak = [replace(d, logistic={k: replace(v, in_sample=0.7) for k, v in d.logistic.items()}) for d in weak]
    assert not any(holds(weak) for holds in CONCLUSIONS.values())


def test_medians_are_judged_in_the_papers_units(study):
    X, _ = paper.designs(20, 1, 1)

    def outside(X):
        return set(medians_outside(replace(study, data=replace(study.data, X=X))))

    # Those of D_ratio and k_norm would be outside of any interval in SI units.
    assert outside(X) == {0, 2, 3, 5}
    assert outside(published.tilted(X)) == set()


def test_the_process_that_is_drawn_is_the_median_one_of_those_that_order_the_features_as_the_paper(study):
    def draws(fresh, lengths):
        return [
            with_process(made(), "laplace", fresh=value, length_scales=np.array(scales))
            for value, scales in zip(fresh, lengths, strict=True)
        ]

    ordered, other = [1.0, 2.0, 3.0, 4.0, 9.0, 9.0], [1.0, 5.0, 3.0, 4.0, 9.0, 9.0]
    assert paper.orders_as_the_paper(draws([0.9], [ordered])[0].processes["laplace"])
    assert not paper.orders_as_the_paper(draws([0.9], [other])[0].processes["laplace"])
    for lengths, expected in (([ordered, other], 0), ([other, ordered], 1), ([other, other], 0)):
        assert paper.typical_draw(replace(study, draws=draws([0.95, 0.94], lengths), seed=3)) == expected


def test_the_process_that_is_drawn_learned_from_the_first_split_of_its_draw(study, monkeypatch):
    monkeypatch.setattr(paper, "train", lambda F, failed, method: None)  # its training has tests of its own
    draw = paper.typical_draw(study)
    drawn = paper.typical_process(study)
    train, _ = paper.split(np.random.default_rng([study.seed, 2, draw, 0]), SIZE)
    assert np.array_equal(drawn.F, paper_features(study.data.X[draw][train]))
    assert np.array_equal(drawn.failed, study.data.outcome[draw][train] == 2)


@pytest.fixture(scope="module")
def by_command(study, tmp_path_factory):
    """The folder that the command writes, with one of three planes, and what it prints."""
    folder = tmp_path_factory.mktemp("paper") / "new"
    shown = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(shown):
        patch.setattr(paper, "run_study", lambda *_: study)
        patch.setattr("activefail.seismic.paper.reproduction.FIGURES", FIGURES[:1])
        patch.setattr(sys, "argv", ["activefail", "paper", "--draws", "4", "--out", str(folder)])
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 0
    return folder, shown.getvalue()


def test_the_command_writes_the_page_and_says_every_verdict(study, by_command):
    folder, shown = by_command
    assert all(line.item in shown for line in claims(study))
    assert (folder / "reproduction.md").exists()


def test_the_command_prints_the_numbers_of_every_claim_as_json(study, tmp_path, monkeypatch):
    monkeypatch.setattr(paper, "run_study", lambda *_: study)
    monkeypatch.setattr(
        "activefail.seismic.paper.reproduction.write_reproduction", lambda *_: tmp_path / "reproduction.md"
    )
    done = activefail("paper", "--out", tmp_path, "--json")
    assert done.code == 0, done.err
    shown = json.loads(done.out)
    assert (shown["draws"], shown["fresh"], shown["seed"]) == (2, 60, 3)
    assert shown["simulations"] == 2 * SIZE + 60
    assert shown["page"] == str(tmp_path / "reproduction.md")
    assert [claim["item"] for claim in shown["claims"]] == [line.item for line in claims(study)]
    decimals = {"share": 3, "points": 1}
    for claim in shown["claims"]:
        numbers = claim["estimate"]
        if numbers is None:
            continue
        assert numbers["one_sample_low"] <= numbers["low"] <= numbers["mean"] <= numbers["high"]
        digits = 2 if claim["item"].startswith("expectation") else decimals[numbers["unit"]]
        mean, low, high = (f"{numbers[name]:.{digits}f}" for name in ("mean", "low", "high"))
        # The page's text states the same numbers.
        assert claim["ours"].startswith(f"{mean} ({low} to {high})")
        lowest, highest = (f"{numbers[name]:.{digits}f}" for name in ("one_sample_low", "one_sample_high"))
        assert claim["one_sample"] == f"{lowest} to {highest}"
    assert sum(claim["estimate"] is not None for claim in shown["claims"]) == 7


@pytest.mark.exhaustive
def test_the_page_is_whole_and_the_same_each_time(study, tmp_path):
    first, repeated = (write_reproduction(study, tmp_path / name) for name in "ab")
    text = first.read_text()
    assert text == repeated.read_text()
    assert not re.search(r"\bnan\b", text)
    for picture in re.findall(r"\]\(([^)]+\.svg)\)", text):
        assert (first.parent / picture).read_bytes() == (repeated.parent / picture).read_bytes()
        assert (first.parent / picture).with_suffix(".png").stat().st_size > 10_000


def test_the_documented_page_holds_the_numbers_of_its_run_and_no_others():
    numbers = json.loads((DOCS / "reproduction" / "numbers.json").read_text(encoding="utf-8"))
    assert (DOCS / "reproduction.md").read_text(encoding="utf-8") == render(numbers)
    assert numbers["draws"] >= 20
    assert numbers["answered_fresh"] >= 2000


@pytest.mark.parametrize("splits", some([2, SPLITS], 2))
def test_the_documented_numbers_are_those_of_this_simulator_and_these_methods(splits):
    numbers = json.loads((DOCS / "reproduction" / "numbers.json").read_text(encoding="utf-8"))
    X, X_fresh = paper.designs(numbers["draws"], 10, numbers["seed"])
    assert numbers["table2"] == table_2(X)
    data = paper.simulated(X[:1], X_fresh, Model())
    alone = paper.study_draw(
        X[0], data.outcome[0], X_fresh, data.outcome_fresh, numbers["seed"], 0, ("laplace",), splits
    )
    first = numbers["first_sample"]
    assert first["logistic"] == {name: fitted.in_sample for name, fitted in alone.logistic.items()}
    for name, p_values in first["p_values"].items():
        assert alone.logistic[name].p_values == pytest.approx(p_values, rel=1e-4)
    # The libraries' rounding may move a point that lies on the boundary.
    assert alone.held_out == pytest.approx(first["held_out"][:splits], abs=1.5 / 62)
