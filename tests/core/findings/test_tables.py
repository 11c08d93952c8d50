"""Tables in and out: numbers are exact to the last bit, and a bad table leaves nothing behind."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from ran import Run

from activefail.analyses.findings.tables import export_table, predict_table
from activefail.errors import InputError
from activefail.learning.model.threads import one_thread
from activefail.space.space import Array


def written(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file, strict=True)
    return header, rows


def numbers(rows: list[list[str]], columns: slice) -> Array:
    """Cells as numbers, where an empty one is a NaN."""
    return np.array([[float(cell) if cell else np.nan for cell in row[columns]] for row in rows])


def save(path: Path, X: Array, names: tuple[str, ...]) -> Path:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([names, *(list(map(repr, row)) for row in X.tolist())])
    return path


# --- predict -----------------------------------------------------------------------------------------------------


def test_probabilities_of_a_prediction_sum_to_one_and_are_the_classifiers(ran: Run, tmp_path: Path) -> None:
    X = ran.campaign.space.sobol(64, np.random.default_rng(3))
    source = save(tmp_path / "in.csv", X, ("x", "y"))
    progress: list[int] = []
    with one_thread():
        outside = predict_table(ran.campaign, ran.classifier, source, tmp_path / "out.csv", lambda _: progress.append)
        probabilities = ran.classifier.probabilities(X)
        latent = ran.classifier.latents[0].moments(ran.campaign.features(X))
    header, rows = written(tmp_path / "out.csv")
    assert header == ["x", "y", "likeliest_outcome", "p_safe", "p_broken", "latent_mean", "latent_sd"]
    assert {row[2] for row in rows} == {"safe", "broken", "unknown"}
    known = np.array([row[2] != "unknown" for row in rows])
    assert [row[2] == "broken" for row in np.array(rows)[known]] == (probabilities[known, 1] > 0.5).tolist()
    assert (np.abs(probabilities[~known, 1] - 0.5) < 0.3).all()
    answers = numbers(rows, slice(3, None))
    np.testing.assert_allclose(answers[:, :2].sum(axis=1), 1.0, rtol=0.0, atol=1e-12)
    assert answers[:, :2].min() >= 0.0
    assert answers.tobytes() == np.column_stack([probabilities, latent.mean, latent.sd]).tobytes()
    assert (answers[:, 3] > 0.0).all()
    assert (outside, progress) == (0, [64])


def test_a_prediction_does_not_depend_on_the_rows_beside_it(ran: Run, tmp_path: Path) -> None:
    X = ran.campaign.space.sobol(16, np.random.default_rng(3))
    answers = []
    for order in (np.arange(16), np.arange(16)[::-1]):
        with one_thread():
            predict_table(
                ran.campaign, ran.classifier, save(tmp_path / "in.csv", X[order], ("x", "y")), tmp_path / "out.csv"
            )
        answers.append(numbers(written(tmp_path / "out.csv")[1], slice(3, None))[np.argsort(order)])
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-9, atol=1e-12)


def test_designs_outside_the_space_are_predicted_and_counted(ran: Run, tmp_path: Path) -> None:
    X = np.vstack([ran.campaign.space.low, ran.campaign.space.high, [[-2.1, 20.0], [0.0, 51.0], [1e308, -1e308]]])
    source = save(tmp_path / "in.csv", X, ("x", "y"))
    with one_thread(), pytest.warns(UserWarning, match=r"3 designs .* \(the first by x: `-2 <= x"):
        assert predict_table(ran.campaign, ran.classifier, source, tmp_path / "out.csv") == 3
    answers = numbers(written(tmp_path / "out.csv")[1], slice(3, None))
    assert np.isfinite(answers).all()
    np.testing.assert_allclose(answers[:, :2].sum(axis=1), 1.0)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("x,y\n0,20\n0,nan\n", "row 2 (line 3), column y: must be a finite number, got 'nan'"),
        ("x,y\n0,20\nright,20\n", "row 2 (line 3), column x: must be a number, got 'right'"),
        ("x\n0\n", "column 'y': required, but missing; the required columns are x,y"),
        ("x,y,p_broken\n0,20,1\n", "column 'p_broken': would be overwritten by the output; rename or remove it"),
        ("x,y,latent_sd\n0,20,1\n", "column 'latent_sd': would be overwritten by the output; rename or remove it"),
    ],
)
def test_a_table_that_cannot_be_predicted_is_refused_and_nothing_is_written(
    ran: Run, tmp_path: Path, content: str, says: str
) -> None:
    (tmp_path / "in.csv").write_text(content)
    with pytest.raises(InputError) as refused:
        predict_table(ran.campaign, ran.classifier, tmp_path / "in.csv", tmp_path / "out.csv")
    assert str(refused.value).startswith(f"{tmp_path / 'in.csv'}: {says}")
    assert os.listdir(tmp_path) == ["in.csv"]


# --- export ------------------------------------------------------------------------------------------------------


def test_an_exported_table_is_the_record_to_the_last_bit(ran: Run, tmp_path: Path) -> None:
    assert export_table(ran.campaign, ran.store, tmp_path / "out.csv") == 40
    header, rows = written(tmp_path / "out.csv")
    assert header == ["id", "iteration", "origin", "x", "y", "outcome", "cause", "distance", "seconds"]
    batches = ran.store.batches
    assert numbers(rows, slice(3, 5)).tobytes() == np.concatenate([b.designs for b in batches]).tobytes()
    assert [row[0] for row in rows] == [str(i) for i in range(40)]
    assert [row[1] for row in rows] == ["0"] * 20 + ["1"] * 10 + ["2"] * 10
    assert [row[2] for row in rows] == ["seed"] * 20 + ["active"] * 20
    outcome = np.concatenate([b.results.outcome for b in batches])
    assert [row[5] for row in rows] == [("safe", "broken", "numerical_failure")[i] for i in outcome]
    assert [row[6] for row in rows] == [("", "crack", "fog")[i] for i in outcome]
    margins = np.concatenate([b.results.margins for b in batches])
    assert np.array_equal(numbers(rows, slice(7, 8)), margins, equal_nan=True)
    assert np.isnan(margins).any()
    assert all(row[7] != "nan" for row in rows)
    seconds = np.concatenate([b.results.seconds for b in batches])
    assert numbers(rows, slice(8, 9)).ravel().tobytes() == seconds.tobytes()


def test_an_exported_table_can_be_read_as_designs_again(ran: Run, tmp_path: Path) -> None:
    export_table(ran.campaign, ran.store, tmp_path / "out.csv")
    with one_thread():
        assert predict_table(ran.campaign, ran.classifier, tmp_path / "out.csv", tmp_path / "again.csv") == 0
    header, rows = written(tmp_path / "again.csv")
    assert header[-4:] == ["p_safe", "p_broken", "latent_mean", "latent_sd"]
    right = [(float(row[-4]) > 0.5) == (row[5] == "safe") for row in rows if row[5] != "numerical_failure"]
    assert np.mean(right) > 0.9


def test_where_nothing_can_be_written_the_name_and_the_reason_are_told(ran: Run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none/out\.csv: cannot be written: No such file or directory"):
        export_table(ran.campaign, ran.store, tmp_path / "none" / "out.csv")
