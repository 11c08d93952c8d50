import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from activefail.bearing import TABLE_1, Model, simulate
from activefail.features import paper_features
from activefail.report.reproduction import PAPER_P_VALUES, render, summary, write_reproduction
from activefail.study import paper
from activefail.study.paper import METHODS, VARIANTS, Draw, Logistic, Process, run_study

DOCS = Path(__file__).parents[2] / "docs"
COMMAND = {"draws": 2, "fresh": 150, "seed": 3}


@pytest.fixture(scope="module")
def study():
    return run_study(**COMMAND)


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


def test_the_labels_are_the_simulators(study):
    answers = simulate(study.data.X[1][:20])
    assert np.array_equal(study.data.label[1][:20], answers.label)
    assert np.array_equal(study.data.label_fresh[:10], simulate(study.data.X_fresh[:10]).label)


def test_a_draw_studied_alone_is_the_draw_of_the_study(study):
    alone = paper.study_draw(
        study.data.X[1], study.data.label[1], study.data.X_fresh, study.data.label_fresh, 3, 1, ("laplace",)
    )
    assert alone.processes["laplace"].fresh == study.draws[1].processes["laplace"].fresh
    assert np.array_equal(alone.logistic["failure"].p_values, study.draws[1].logistic["failure"].p_values)


def test_table_2_in_the_papers_units_is_the_features_with_the_amplitude_in_g_and_the_displacement_in_millimetres():
    X, _ = paper.designs(2, 1, 1)
    flat = X.reshape(-1, 9)
    T_p, A_p, D_tot, p, k = flat[:, 7], flat[:, 8], flat[:, 2], flat[:, 5] * 1e6, flat[:, 6]
    displacement = A_p * (T_p / (2 * np.pi)) ** 2
    rows = paper.table_2(X)
    assert rows[0].medians_in_papers_units[1] == pytest.approx(np.median((displacement / D_tot)[250:]), rel=1e-12)
    assert rows[5].medians_in_papers_units[0] == pytest.approx(
        np.median((k / (p * np.sqrt(1000 * displacement)))[:250]), rel=1e-12
    )
    assert rows[2].median == pytest.approx(np.median(paper_features(flat)[:, 2]))


def test_a_variant_that_is_the_default_moves_no_label(study):
    assert study.variants[0].name == next(iter(VARIANTS))
    assert study.variants[0].moved == 0.0
    assert all(variant.moved > 0.0 for variant in study.variants[1:])


def test_a_variant_counts_the_labels_that_its_model_moves(study):
    assembly = simulate(study.data.X.reshape(-1, 9), Model(restitution="assembly")).label
    moved = np.mean(assembly != study.data.label.ravel())
    variant = next(v for v in study.variants if "assembly" in v.name)
    assert variant.moved == pytest.approx(moved)


def made(p_values, accuracy=0.95):
    """A study whose draws all have these statistics."""
    logistic = {
        name: Logistic(0.98 if name == "impact" else 0.92, accuracy - 0.05, np.array(p), False)
        for name, p in p_values.items()
    }
    process = Process(0.97, accuracy, -0.1, np.array([1.0, 1.0, 1.0, 20.0, 20.0, 20.0]), np.full(4, 0.5))
    return Draw(logistic, dict.fromkeys(METHODS, process))


@pytest.mark.parametrize(
    ("change", "item"),
    [
        ({"failure": (0.2, 0.004, 7e-7, 0.20, 0.52, 0.24)}, "significant features, failure"),
        ({"impact": (0.012, 0.01, 0.028, 0.689, 0.204, 0.755)}, "significant features, impact"),
    ],
)
def test_a_claim_that_does_not_hold_is_called_not_reproduced(study, change, item):
    as_paper = replace(study, draws=[made(PAPER_P_VALUES)] * 4)
    not_reproduced = [line.item for line in summary(as_paper) if line.verdict == "**not reproduced**"]
    assert item not in not_reproduced
    otherwise = replace(study, draws=[made(PAPER_P_VALUES | change)] * 4)
    assert [line.item for line in summary(otherwise) if line.verdict == "**not reproduced**"] in (
        [item, *not_reproduced],
        [*not_reproduced, item],
    )


def test_the_page_is_whole_and_the_same_each_time(study, tmp_path):
    first = write_reproduction(study, tmp_path / "a", COMMAND, lambda _: None)
    again = write_reproduction(study, tmp_path / "b", COMMAND, lambda _: None)
    text = first.read_text()
    assert text == again.read_text()
    assert not re.search(r"\bnan\b", text)
    for picture in re.findall(r"\]\(([^)]+\.svg)\)", text):
        assert (first.parent / picture).read_bytes() == (again.parent / picture).read_bytes()
        assert (first.parent / picture).with_suffix(".png").stat().st_size > 10_000


def test_the_documented_page_holds_the_numbers_of_its_run_and_no_others():
    numbers = json.loads((DOCS / "reproduction" / "numbers.json").read_text(encoding="utf-8"))
    assert (DOCS / "reproduction.md").read_text(encoding="utf-8") == render(numbers)
    assert numbers["draws"] >= 20
    assert numbers["answered_fresh"] >= 2000
