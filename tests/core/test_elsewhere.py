"""Simulations done elsewhere, through the Python interface and the commands, wrong inputs included."""

import csv
import errno
import io
import os
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from commandline import CommandResult, activefail, record, refused, table
from explorer.conftest import site_of
from pounding import write_campaign

import activefail as af
from activefail.errors import InputError, StoreError

LAB = """
seed = 3
sampling = { initial = 8, budget = 16, batch = 4 }
simulator = { elsewhere = true, outcomes = ["safe", "failure"], margins = ["g"] }
[space]
load = { low = 1.0, high = 5.0, unit = "kN" }
strength = { low = 2.0, high = 12.0 }
span = { value = 3.0, unit = "m" }
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    (tmp_path / "lab.toml").write_text(LAB)
    return tmp_path / "lab.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with eight results and two designs in flight, not to be changed."""
    file = tmp_path_factory.mktemp("lab") / "lab.toml"
    file.write_text(LAB)
    folder = file.with_name("run")
    with af.create_run(folder, file) as run:
        run.tell(answered(run.ask(8)))
        run.ask(2)
    return folder


@pytest.fixture
def folder(made: Path, lab: Path) -> Path:
    """A copy of it beside its campaign file."""
    return Path(shutil.copytree(made, lab.with_name("run")))


def answered(designs: pd.DataFrame) -> pd.DataFrame:
    return designs.assign(g=designs["strength"] - 2.0 * designs["load"])


def written(path: Path, rows: list[dict[str, Any]]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


# --- what the tables hold ----------------------------------------------------------------------------------------


def test_designs_are_handed_out_with_ids_variables_and_fixed_quantities(lab: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        designs = run.ask(3)
        assert list(designs.columns) == ["id", "load", "strength", "span"]
        assert designs["id"].tolist() == [0, 1, 2]
        assert designs["span"].tolist() == [3.0] * 3
        pd.testing.assert_frame_equal(run.in_flight, designs)
        assert run.counts == {"safe": 0, "failure": 0, "numerical_failure": 0, "in_flight": 3}


def test_simulations_have_the_columns_of_export_and_the_ids_of_ask(folder: Path, tmp_path: Path) -> None:
    with af.open_run(folder) as run:
        simulations = run.simulations
        assert activefail("export", folder, "--csv", tmp_path / "all.csv").code == 0
        exported = pd.read_csv(tmp_path / "all.csv", keep_default_na=False)
        pd.testing.assert_frame_equal(simulations, exported)
        assert simulations["id"].tolist() == list(range(8))
        assert (simulations["outcome"] == np.where(simulations["g"] <= 0.0, "failure", "safe")).all()


def test_predictions_have_a_row_for_each_design_in_the_given_order(folder: Path) -> None:
    with af.open_run(folder) as run:
        X = np.array([[1.0, 12.0], [5.0, 2.0], [2.0, 4.5]])
        predicted = run.predict(X)
        added = ["likeliest_outcome", "p_safe", "p_failure", "latent_mean", "latent_sd"]
        assert list(predicted.columns) == ["load", "strength", *added]
        assert predicted["likeliest_outcome"].tolist()[:2] == ["safe", "failure"]
        assert predicted["p_failure"].iloc[0] < 0.1 < 0.9 < predicted["p_failure"].iloc[1]
        named = [{"strength": strength, "load": load} for load, strength in X.tolist()]
        pd.testing.assert_frame_equal(run.predict(named), predicted)
        pd.testing.assert_frame_equal(run.predict(pd.DataFrame(named)), predicted)
        assert len(run.predict(np.empty((0, 2)))) == 0
        swapped = pd.DataFrame(named)[["strength", "load"]]
        predicted_by_name = [
            list(swapped.itertuples(index=False)),
            [row for _, row in swapped.iterrows()],
            swapped.to_dict("list"),
        ]
        for table in predicted_by_name:
            np.testing.assert_array_equal(run.predict(table), predicted)
        for rows in (X.tolist(), list(map(tuple, X)), list(X)):
            pd.testing.assert_frame_equal(run.predict(rows), predicted)


@pytest.mark.parametrize(
    ("X", "message"),
    [
        (
            np.zeros(2),
            r"an \(n, 2\) array of numbers with the columns load, strength, got shape \(2,\)",
        ),
        (np.array([["a", "b"]]), r"X: must be a table or an \(n, 2\) array of numbers"),
        (np.array([[1.0, np.nan]]), "X: row 0, column strength: must be finite, got nan"),
        ([{"load": 1.0}], "column 'strength': required, but missing"),
        ([{"load": 1.0, "strength": "much"}], "row 0, column strength: must be a number, got 'much'"),
        (3.0, "table: must be a DataFrame, a dictionary of columns, or a list of dictionaries"),
        ([pd.Series({"load": 1.0, "strength": 2.0}), [1.0, 2.0]], "table: must be a DataFrame"),
        ([[1.0, 2.0], pd.Series({"load": 1.0, "strength": 2.0})], "column 'load': required, but missing"),
    ],
)
def test_wrong_designs_to_predict_are_refused(folder: Path, X: Any, message: str) -> None:
    with af.open_run(folder) as run, pytest.raises(InputError, match=message):
        run.predict(X)


@pytest.mark.parametrize("learns", ["outcomes", "g"])
def test_a_boundary_is_a_botorch_model_over_the_features(lab: Path, learns: str) -> None:
    import torch
    from botorch.acquisition import PosteriorStandardDeviation

    lab.write_text(LAB + f'[classifier]\nlearns = "{learns}"\n')
    with af.create_run(lab.with_name("run"), lab) as run:
        run.tell(answered(run.ask(8)))
        X, model = np.array([[1.0, 12.0], [5.0, 2.0]]), run.model("failure")
        F, predicted = torch.from_numpy(run.features(X)).unsqueeze(1).requires_grad_(), run.predict(X)
        posterior = model.posterior(F)
        np.testing.assert_allclose(posterior.mean.detach().numpy().ravel(), predicted["latent_mean"], atol=1e-6)
        sd = posterior.variance.detach().sqrt().numpy().ravel()
        np.testing.assert_allclose(sd, predicted["latent_sd"], atol=1e-6)
        # BoTorch's criteria and their gradients work on it.
        PosteriorStandardDeviation(model)(F).sum().backward()
        assert F.grad is not None
        assert bool(torch.isfinite(F.grad).all())
        assert float(F.grad.abs().max()) > 0.0
        with pytest.raises(InputError, match="outcome: must be one of failure, got 'safe'"):
            run.model("safe")


@pytest.mark.parametrize(
    "given",
    [
        lambda designs: answered(designs),
        lambda designs: answered(designs).to_dict("records"),
        lambda designs: answered(designs).to_dict("list"),
        lambda designs: answered(designs)[["g", "id"]].assign(note="by hand", g=lambda t: t["g"].map(str)),
    ],
)
def test_results_may_come_as_any_kind_of_table(lab: Path, given: Callable[[pd.DataFrame], Any]) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        designs = run.ask(3)
        assert run.tell(given(designs)) == 3
        assert run.simulations["g"].tolist() == answered(designs)["g"].tolist()


def test_one_row_of_a_table_is_a_table(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        design = run.in_flight.iloc[0]
        assert run.predict(design).equals(run.predict(run.in_flight[:1]))
        assert run.tell(answered(run.in_flight).iloc[0]) == 1
        assert run.in_flight["id"].tolist() == [9]
        with pytest.raises(InputError, match="column 'id': required"):
            run.tell(pd.Series([9, 0.5]))


def test_one_result_may_be_a_dictionary(lab: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        run.ask(2)
        assert run.tell({"id": 1, "outcome": "Numerical_Failure", "cause": "time_limit"}) == 1
        row = run.simulations.iloc[0]
        assert (row["id"], row["outcome"], row["cause"], np.isnan(row["g"])) == (
            1,
            "numerical_failure",
            "time_limit",
            True,
        )


def test_rows_without_a_result_are_not_told_yet(lab: Path, tmp_path: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        designs = run.ask(3)
        rows = answered(designs).astype(object).to_dict("records")
        rows[1]["g"] = ""
        assert run.tell(written(tmp_path / "part.csv", rows)) == 2
        assert run.in_flight["id"].tolist() == [1]


NOTHING: dict[str, Callable[[pd.DataFrame], Any]] = {
    "NaN": lambda designs: designs.assign(g=[np.nan, 1.0, np.nan]),
    "None": lambda designs: designs.assign(g=[None, 1.0, None]).to_dict("records"),
    "NA": lambda designs: designs.assign(g=pd.array([None, 1.0, None], dtype="Float64")),
    "empty text": lambda designs: designs.assign(g=["", "1.0", " "]),
    "an outcome that is none": lambda designs: designs.assign(outcome=[None, "failure", np.nan]),
    "both": lambda designs: designs.assign(g=[np.nan, 1.0, np.nan], outcome=[None, "safe", pd.NA]),
}


@pytest.mark.parametrize("given", NOTHING)
def test_a_row_of_python_without_a_result_is_refused_with_both_ways_to_mean_it(lab: Path, given: str) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        rows = NOTHING[given](run.ask(3))
        with pytest.raises(InputError) as caught:
            run.tell(rows)
        lines = str(caught.value).splitlines()
        assert [line.split(":")[0] for line in lines[1:]] == ["  row 0", "  row 2"]
        assert "Drop the row if there is no result yet" in lines[1]
        assert 'if there will be none, its outcome is "numerical_failure".' in lines[1]
        assert len(run.history) == 0
        with pytest.warns(UserWarning, match="2 rows are skipped: row 0: must have a result, but has NaN or None as"):
            assert run.tell(rows, skip_invalid=True) == 1
        assert run.tell(run.in_flight.assign(outcome="numerical_failure")) == 2


@pytest.mark.parametrize("given", ["DataFrame", "dictionary", "added"])
def test_a_margin_that_is_nan_beside_an_outcome_in_a_table_of_python_is_refused(lab: Path, given: str) -> None:
    def outcome(g: float) -> str:
        return "failure" if g <= 0 else "safe"  # of NaN it says "safe"

    with af.create_run(lab.with_name("run"), lab) as run:
        designs = run.ask(3).assign(g=[np.nan, 1.0, -1.0])
        rows = designs.assign(outcome=designs["g"].map(outcome))
        record = {"DataFrame": run.tell, "dictionary": lambda table: run.tell(table.to_dict("list")), "added": run.add}
        rows = rows.drop(columns="id").assign(load=[1.5, 2.5, 3.5]) if given == "added" else rows
        with pytest.raises(InputError) as caught:
            record[given](rows)
        assert str(caught.value).startswith("row 0: margins.g: must be a number beside the outcome safe, got nan")
        assert str(caught.value).endswith('if there is no result, its outcome is "numerical_failure".')
        assert len(run.history) == 0
        rows.loc[0, "outcome"] = "numerical_failure"
        assert record[given](rows) == 3


def test_a_failure_may_leave_a_margin_undefined_in_a_table_of_python_if_the_campaign_says_so(lab: Path) -> None:
    lab.write_text(LAB.replace('margins = ["g"]', 'margins = ["g"], truncated = ["g"], lost = "failure"'))
    with af.create_run(lab.with_name("run"), lab) as run:
        rows = run.ask(4).assign(g=[np.nan, 1.0, np.nan, -1.0], outcome=["failure", "safe", "failure", "failure"])
        assert run.tell(rows.assign(cause=["", "", "time_limit", ""])) == 4
        with af.create_run(lab.with_name("other"), lab) as other:
            assert other.add(run.simulations) == 4
            assert other.simulations["g"].equals(run.simulations["g"])


@pytest.mark.parametrize("outcome", ["", "safe"])
def test_the_text_nan_in_a_file_is_no_margin(lab: Path, tmp_path: Path, outcome: str) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        run.ask(1)
        told = written(tmp_path / "told.csv", [{"id": 0, "outcome": outcome, "g": "nan"}])
        with pytest.raises(InputError, match=r"row 1 \(line 2\): .*nan"):
            run.tell(told)
        assert run.in_flight["id"].tolist() == [0]


# --- wrong inputs ------------------------------------------------------------------------------------------------

WRONG = [
    ({"id": 99, "g": 1.0}, "id 99 is unknown: no design was handed out with this id"),
    ({"id": 0, "g": 1.0}, "id 0 already has the result"),
    ({"id": "eight", "g": 1.0}, "column id: must be a whole number, got 'eight'"),
    ({"id": 8.5, "g": 1.0}, "column id: must be a whole number, got"),
    ({"id": "", "g": 1.0}, "column id: must be a whole number, got an empty cell."),
    ({"id": 8, "g": "1_0"}, "column g: must be a number, got '1_0'"),
    ({"id": 8, "g": "wide"}, "column g: must be a number, got 'wide'"),
    ({"id": 8, "g": "1e400"}, "column g: must fit a float64, at most 1.8e308 in size, got '1e400'"),
    ({"id": "9" * 30, "g": 1.0}, "column id: must be a whole number below 2**53, got '9999"),
    ({"id": 8, "g": "", "outcome": "collapse"}, "column outcome: must be one of safe, failure, numerical_failure (or"),
    ({"id": 8, "g": 1.0, "cause": "fog"}, "column cause: must be empty or one of"),
    ({"id": 8, "g": 1.0, "seconds": -1}, "column seconds: `0 <= seconds < inf` must hold, got -1.0"),
    ({"id": 8, "g": 1.0, "load": 1.0}, "column load: must be "),
    ({"id": 8, "g": 1.0, "span": 4.0}, "column span: must be 3.0, its fixed value, got"),
    ({"id": 8, "g": 1.0, "load": ""}, "column load: must be a finite number, got an empty cell."),
    ({"id": 8, "g": 1.0, "load": "nan"}, "column load: must be a finite number, got"),
    ({"id": 8, "force": 2.0}, "column 'outcome' or 'g': required, but missing; the columns are id,force"),
    ({"g": 1.0}, "column 'id': required, but missing"),
    ({"id": 8, "cause": "time_limit", "g": ""}, "the margin g is nan; without an outcome it must be a finite number"),
    ({"id": 8, "cause": "time_limit", "g": 1.0}, "column cause: must be empty beside the outcome safe, which it contr"),
]


@pytest.mark.parametrize(("row", "message"), WRONG)
def test_a_wrong_row_is_refused_with_its_place_and_nothing_of_the_table_is_recorded(
    folder: Path, tmp_path: Path, row: dict[str, Any], message: str
) -> None:
    with af.open_run(folder, write=True) as run:
        good = {name: {"id": 9, "g": 0.5}.get(name, "") for name in row}
        rows = [good, row] if {"id", "g"} <= row.keys() else [row]
        if "load" in row or "span" in row:
            designs = run.in_flight.set_index("id")
            rows = [good | {name: designs.loc[9, name] for name in row.keys() & {"load", "span"}}, row]
        before = len(run.history)
        with pytest.raises(InputError) as caught:
            run.tell(rows)
        assert message in str(caught.value)
        assert "required" in message or str(caught.value).startswith("row 1")
        assert (len(run.history), run.in_flight["id"].tolist()) == (before, [8, 9])
    path = written(tmp_path / "wrong.csv", rows)
    said = activefail("tell", folder, "--csv", path)
    refused(said, message, str(path))
    assert "required" in message or f"{path}: row 2 (line 3)" in said.err


def test_all_rows_that_break_a_rule_are_named_at_once_and_the_others_can_be_kept(lab: Path, tmp_path: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        run.ask(3)
        rows = [{"load": 2.0 + k / 100, "strength": 8.0, "g": "" if k % 2 else 1.0, "note": f"{k}"} for k in range(30)]
        path = written(tmp_path / "old.csv", [*rows, {"load": 9.0, "strength": 8.0, "g": -1.0, "note": "outside"}])
        with pytest.raises(InputError) as caught:
            run.add(path)
        text = str(caught.value).splitlines()
        assert text[0].startswith("16 rows break rules; nothing is recorded (keep the others: `--skip-invalid`")
        assert len(text) == 12
        assert text[1].strip().startswith(f"{path}: row 2 (line 3)")
        assert text[-1] == "  and 6 more"
        with pytest.warns(UserWarning, match=r"16 rows are skipped: .*row 2 \(line 3\)"):
            assert run.add(path, skip_invalid=True) == 15
        told = [
            {"id": 0, "g": 1.0},
            {"id": 0, "g": 2.0},
            {"id": 1, "g": 0.5, "load": 3},
            {"id": 77, "g": 1.0},
            {"id": 2, "g": 1},
        ]
        with pytest.raises(InputError, match=r"column load: must be "):
            run.tell(told)
        del told[2]
        with pytest.raises(
            InputError, match=r"(?s)2 rows .*row 1: id 0 has the result .*row 3|2 rows .*id 77 is unknown"
        ):
            run.tell(told)
        with pytest.warns(UserWarning, match="2 rows are skipped") as caught:
            assert run.tell(told, skip_invalid=True) == 2
        assert {one.filename for one in caught} == {__file__}  # the line that told them
        # The rows of `old.csv` have labels.
        assert run.simulations["note"].tolist()[:3] == ["0", "2", "4"]


def test_columns_with_other_names_and_units_and_words_are_named_and_can_be_mapped(lab: Path, tmp_path: Path) -> None:
    lab.write_text(LAB.replace('"safe", "failure"', '"safe", "damage", "failure"').replace(', margins = ["g"]', ""))
    row = {"Load [N]": 2500.0, "strength_MPa": "8", "Result": "collapsed", "tested by": "=Ben"}
    path = written(tmp_path / "old.csv", [row, row | {"Load [N]": 3000.0, "Result": "safe"}])
    folder = lab.with_name("run")
    with af.create_run(folder, lab) as run:
        for name in ("load [kN]", "Load", "load_kN", "load (kN)", "LOAD, kN"):
            with pytest.raises(InputError) as caught:
                run.add([{name: 2.5, "strength": 8.0, "outcome": "safe"}])
            assert f'It may be {name!r} (--map "load={name}", with a factor if the unit differs)' in str(caught.value)
        names = {"load": "Load [N]/1000", "strength": "strength_MPa", "outcome": "Result", "failure": "collapsed"}
        for wrong, message in (
            ({"loat": "x"}, "map: must name one of id, outcome, "),
            ({"load": "Loda"}, "column 'Loda': missing; the columns are Load [N],"),
        ):
            with pytest.raises(InputError, match=re.escape(message)):
                run.add(path, names=names | wrong)
        for name, column in (("load", "Kraft [N]"), ("load", "load_N"), ("strength", "strength (%)")):
            with pytest.raises(InputError, match=re.escape(f"map: {column!r} may have another unit than {name}")):
                run.add([{"load": 2.5, "strength": 8.0, "outcome": "safe", column: 1.0}], names={name: column})
    (tmp_path / "map.toml").write_text('outcome = "Result"\nfailure = "collapsed"\n')
    options = ("--map", "load=Load [N]/1000", "--map", "strength=strength_MPa", "--map", tmp_path / "map.toml")
    assert activefail("add", folder, "--csv", path, *options).out == "2 simulations added\n"
    assert activefail("export", folder, "--csv", tmp_path / "all.csv").code == 0
    rows = table(tmp_path / "all.csv")
    assert [(float(row["load"]), row["outcome"]) for row in rows] == [(2.5, "failure"), (3.0, "safe")]
    # Their labels come back, and no spreadsheet runs them.
    assert [row["tested by"] for row in rows] == ["'=Ben"] * 2


def test_a_name_is_mapped_once(lab: Path, tmp_path: Path) -> None:
    with af.create_run(lab.with_name("run"), lab):
        pass
    path = written(tmp_path / "old.csv", [{"load": 2.5, "strength": 8.0, "g": 1.0}])
    answer = activefail("add", lab.with_name("run"), "--csv", path, "--map", "safe=Safe", "--map", "safe=held")
    assert "--map: safe must be given once, got 'Safe' and 'held'." in answer.err


def test_replicates_keep_their_own_labels(lab: Path) -> None:
    lab.write_text(LAB.replace("margins", "repeatable = false, margins"))
    with af.create_run(lab.with_name("run"), lab) as run:
        rows = [{"load": 2.5, "strength": 8.0, "g": g, "batch": batch} for g, batch in ((0.3, "a"), (-0.2, "b"))]
        assert run.add(rows) == run.add(rows[:1]) + 1
        assert run.simulations["batch"].tolist() == ["a", "b", "a"]
        with pytest.raises(InputError, match="fixes every variable, so only the noise is uncertain"):
            run.design(target="10%", free=["load"], fixed={"strength": 8.0})


@pytest.mark.parametrize(("margins", "is_flag"), [((0, 1, 1), True), ((0, 1, 0.5), False), ((1, 1, 1), False)])
def test_a_margin_that_may_be_a_flag_is_warned_of(lab: Path, margins: tuple[float, ...], is_flag: bool) -> None:
    folder = lab.with_name("run")
    with af.create_run(folder, lab) as run:
        run.add([{"load": 2.0 + k, "strength": 8.0, "g": margin} for k, margin in enumerate(margins)])
    assert ("warning: All margins g are 0 or 1, like a flag." in activefail("status", folder).err) is is_flag


def test_columns_are_scaled_and_shifted_and_those_that_export_has_are_named(lab: Path) -> None:
    rows = {"Load cell 1 [C]": [-271.15, -270.15], "strength": 8.0, "depth": [-100.0, 200.0], "origin": "Lyon", "id": 7}
    names = {"load": "Load cell 1 [C]+273.15", "g": "depth*-0.01-0.5"}
    with af.create_run(lab.with_name("run"), lab) as run:
        for name in ("origin", "id"):
            frame = pd.DataFrame(rows).drop(columns={"origin", "id"} - {name})
            with pytest.warns(UserWarning, match=f"column '{name}' is not kept, for `export` has one; rename it"):
                run.add(frame, names=names)
        assert run.simulations["load"].tolist() == pytest.approx([2.0, 3.0])
        assert run.simulations["g"].tolist() == [0.5, -2.5]
        # A sign right after a name may belong to it.
        plain = pd.DataFrame({"T": [0.5, 1.5], "T_1": 2.5, "strength": 8.0, "g": 1.0})
        for wrong in ("T-1", "T -1", "T+1"):
            with pytest.raises(InputError, match=re.escape(f"column {wrong!r}: missing; the columns are T,T_1,")):
                run.add(plain, names={"load": wrong})
        assert run.add(plain, names={"load": "T + 1"}) == 2
        assert run.simulations["load"].tolist()[-2:] == [1.5, 2.5]
        for wrong in ("strength*0", "strength/0", "strength*1e999"):
            with pytest.raises(InputError, match="the factor must not be 0"):
                run.add(pd.DataFrame(rows), names={"load": wrong, "g": "depth"})


def test_simulations_outside_the_space_are_learned_from_if_they_are_to_be_kept(lab: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        run.tell(answered(run.ask(8)))
        outside = [{"load": 6.0, "strength": 1.0, "g": -11.0}]
        with pytest.raises(InputError, match="`1 <= load <= 5` must hold"):
            run.add(outside)
        before, bound = run.predict([[5.0, 2.0]])["latent_mean"][0], run.summary.initial.tolist()
        assert run.add(outside, outside="keep") == 1
        assert run.predict([[5.0, 2.0]])["latent_mean"][0] != before
        assert run.summary.initial.tolist() == bound
        assert len(run.ask(4)) == 4


@pytest.mark.parametrize("load", [1e300, -1e300])
def test_a_simulation_too_far_outside_the_space_is_neither_recorded_nor_read(folder: Path, load: float) -> None:
    with af.open_run(folder, write=True) as run:
        with pytest.raises(InputError, match="too far outside the design space"):
            run.add([{"load": load, "strength": 1.0, "g": -11.0}], outside="keep")
        (last,) = run.store.batches
        ids = np.arange(20, 20 + len(last))
        run.store.commit(replace(last, id=ids, designs=np.full_like(last.designs, load)))
    for words in (["export", folder, "--csv", folder.with_name("all.csv")], ["report", folder]):
        result = activefail(*words)
        assert (result.code, "journal lists designs outside the design space" in result.err) == (1, True), result.err


def test_added_simulations_take_the_place_of_initial_designs_but_for_two(lab: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        whole = run.space.latin_hypercube(4, np.random.default_rng(1))
        given = pd.DataFrame(whole, columns=["load", "strength"])
        run.add(answered(given))
        run.add([{"load": 2.0, "strength": 7.0, "outcome": "numerical_failure"}])
        run.add([{"load": 9.0, "strength": 7.0, "g": -11.0}], outside="keep")
        assert len(run.ask(3)) == 3
        assert len(run.ask(8)) == 1  # 4 of 8 are covered
    with af.create_run(lab.with_name("other"), lab) as run:
        run.add(
            answered(
                pd.DataFrame(run.space.latin_hypercube(30, np.random.default_rng(1)), columns=["load", "strength"])
            )
        )
        assert len(run.ask(8)) == 2
        run.tell(answered(run.in_flight))
        assert len(run.ask(4)) == 4


def test_a_laboratory_that_rounds_tells_what_it_tested_and_reaches_its_budget(lab: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        while len(designs := run.ask(4)):
            tested = answered(designs.assign(load=designs["load"].round(1), strength=designs["strength"].round(1)))
            assert run.tell(tested, changed=True) == len(designs)
            assert run.tell(tested) == 0
        assert run.counts["in_flight"] == 0
        assert len(run.simulations) == 16
        assert (run.simulations["load"] == run.simulations["load"].round(1)).all()
        with pytest.raises(InputError, match=r"row 0, column load: .* must hold, got 7\.0"):
            run.tell([{"id": 0, "load": 7.0, "g": 1.0}], changed=True)


def test_without_any_outcome_no_number_of_simulations_can_be_learned_from(lab: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        run.tell(run.ask(2)[["id"]].assign(outcome="numerical_failure"))
        for number in (1, 2, 5):
            with pytest.raises(InputError, match=f"after: none of the 2 recorded simulations has an .*; got {number}"):
                run.classifier_after(number)


def test_a_result_that_was_told_before_is_nothing(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        again = run.simulations[["id", "outcome", "g"]]
        assert run.tell(again) == 0
        assert len(run.history) == 8


def test_a_wrong_result_is_corrected_and_the_former_one_stays_in_the_history(folder: Path, tmp_path: Path) -> None:
    with af.open_run(folder, write=True) as run:
        before, p = run.simulations, run.predict(run.simulations)["p_failure"]
        row = before.iloc[2]
        wrong = {"id": int(row["id"]), "g": -row["g"]}
        assert len(run.corrections) == 0
        assert run.tell(wrong, correct=True) == 1
        assert run.tell(wrong, correct=True) == run.tell(wrong) == 0
        with pytest.raises(
            InputError, match=f"row 0: id {wrong['id']} already has the result .*to replace it: `tell --correct`"
        ):
            run.tell({"id": wrong["id"], "g": row["g"]})
        now = run.simulations
        assert now["g"].tolist() == [*before["g"][:2], -row["g"], *before["g"][3:]]
        assert now["outcome"][2] != row["outcome"]
        # It learns from the corrected results, in this process and in the next.
        assert not np.array_equal(run.predict(before)["p_failure"], p)
        again = run.predict(before)["p_failure"].tolist()
    with af.open_run(folder) as run:
        assert run.predict(before)["p_failure"].tolist() == again
        (kept,) = run.corrections.to_dict("records")
        assert (kept["id"], kept["former_g"], kept["g"]) == (wrong["id"], row["g"], -row["g"])
        assert {kept["former_outcome"], kept["outcome"]} == {"safe", "failure"}
        counts = run.counts
    status = activefail("status", folder).out
    assert "corrected  1 correction\n" in status
    assert f"all        {counts['safe']} safe, {counts['failure']} failure, 0 numerical failures" in status
    table = written(tmp_path / "fixes.csv", [{"id": wrong["id"], "g": float(row["g"])}])
    said = activefail("tell", folder, "--csv", table, "--correct").out
    assert said.startswith(f"id {wrong['id']}: {now['outcome'][2]}, g {-row['g']} -> {row['outcome']}, g {row['g']}\n")
    assert "1 result corrected\n" in said
    with af.open_run(folder) as run:
        assert run.simulations.equals(before)
        np.testing.assert_array_equal(run.predict(before)["p_failure"], p)
        assert len(run.corrections) == 2


def test_a_correction_that_would_lose_a_margin_is_warned_of(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        row = run.simulations.iloc[2]
        number, g = int(row["id"]), float(row["g"])
        with pytest.warns(UserWarning, match=f"id {number}: the correction has no value for g, which was {g!r}"):
            assert run.tell({"id": number, "outcome": "failure"}, correct=True) == 1
        # A numerical failure has no margins to lose, and a margin that comes back is none that is lost.
        assert run.tell({"id": number, "outcome": "numerical_failure"}, correct=True) == 1
        assert run.tell({"id": number, "g": g}, correct=True) == 1


def test_an_infinite_margin_is_warned_of(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        number = int(run.ask(1, beyond=True)["id"].iloc[0])
        with pytest.warns(UserWarning, match="row 0: g is inf; no boundary can be learned from it"):
            run.tell({"id": number, "g": np.inf, "outcome": "safe"})


def test_an_infinite_margin_alone_is_refused(folder: Path) -> None:
    with (
        af.open_run(folder, write=True) as run,
        pytest.raises(InputError, match="the margin g is inf; without an outcome it must be a finite number"),
    ):
        run.tell({"id": int(run.in_flight["id"].iloc[0]), "g": np.inf})


def test_an_asynchronous_campaign_goes_on_by_hand(tmp_path: Path) -> None:
    text = "seed = 5\nsampling = { initial = 8, budget = 8, batch = 4, asynchronous = true }\n"
    write_campaign(tmp_path / "made.toml", text)
    assert activefail("run", tmp_path / "made.toml", "--out", tmp_path / "run").code == 0
    assert activefail("ask", tmp_path / "run", "--beyond", "--n", "2", "--csv", tmp_path / "todo.csv").code == 0
    assert "in flight  2 designs, ids 8, 9" in activefail("status", tmp_path / "run").out
    assert activefail("export", tmp_path / "run", "--csv", tmp_path / "old.csv").code == 0
    assert "0 simulations added" in activefail("add", tmp_path / "run", "--csv", tmp_path / "old.csv").out


SCALES = {
    "uniform": "low = 1.0, high = 5.0",
    "offset": "low = 100.0, high = 110.0",
    "decades": 'low = 1e-12, high = 1e3, distribution = "log_uniform"',
    "about_zero": 'mean = 0.0, sd = 1.0, distribution = "normal"',
    "lognormal": 'median = 1.0, dispersion = 3.0, distribution = "lognormal"',
    "weibull": 'shape = 0.2, scale = 1.0, distribution = "weibull"',
    "gamma": 'shape = 0.2, scale = 1.0, distribution = "gamma"',
    "beta": 'low = 0.0, high = 1.0, alpha = 0.5, beta = 3.0, distribution = "beta"',
    "gumbel": 'location = 10.0, scale = 1.0, distribution = "gumbel_max"',
    "exponential": 'rate = 1e-3, distribution = "exponential"',
}


@pytest.fixture(scope="module")
def on_scales(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with eight designs in flight, whose variables have all kinds of scales."""
    file = tmp_path_factory.mktemp("scales") / "lab.toml"
    space = "".join(f"{name} = {{ {text} }}\n" for name, text in SCALES.items())
    file.write_text(f"{LAB.partition('[space]')[0]}[space]\n{space}")
    with af.create_run(file.with_name("run"), file) as run:
        run.ask(8)
    return file.with_name("run")


@pytest.mark.parametrize(
    "write",
    [repr, np.float32, "{:.6g}".format, "{:.4e}".format, lambda x: f"{x:.5e}"[:6] + f"{x:.5e}"[-4:]],
    ids=["repr", "float32", "6g", "4e", "cut off"],
)
def test_a_design_that_was_rounded_honestly_is_the_same(on_scales: Path, write: Callable[[float], Any]) -> None:
    with af.open_run(on_scales) as run:
        table = run.in_flight.assign(g=1.0)
        for name in SCALES:
            table[name] = [float(write(value)) for value in table[name]]
        assert not run.is_told(table)
        run.is_told(table[["id", "g", "uniform", "decades"]])
        assert not run.is_told(run.in_flight.round({"uniform": 2, "offset": 2, "exponential": 0}).assign(g=1.0))
        with pytest.raises(InputError, match=r"column offset: must be .*, as handed out with id \d"):
            run.is_told(run.in_flight.round({"offset": 0}).assign(g=1.0))


@pytest.mark.parametrize("name", SCALES)
def test_a_design_that_was_changed_or_exchanged_is_refused(on_scales: Path, name: str) -> None:
    with af.open_run(on_scales) as run:
        table = run.in_flight.assign(g=1.0)
        others = table.copy()
        others[name] = np.roll(table[name], 1)
        changed = table.copy()
        changed.loc[3, name] *= 1.001 if name != "decades" else 1.5
        smallest = table.copy()
        smallest.loc[0, name], smallest.loc[1, name] = sorted(table[name])[:2][::-1]
        for wrong in (others, changed, smallest):
            for columns in (wrong, wrong[["id", "g", name]]):
                with pytest.raises(InputError, match=rf"column {name}: must be .*, as handed out with id \d"):
                    run.is_told(columns)


def test_exchanged_designs_that_differ_by_less_than_their_rounding_are_refused(lab: Path) -> None:
    lab.write_text(LAB.replace("low = 1.0, high = 5.0", "low = 1.0, high = 1.0001"))
    with af.create_run(lab.with_name("run"), lab) as run:
        asked = run.ask(8).assign(g=1.0)
        order = np.argsort(asked["load"])
        exchanged = asked.copy()
        exchanged.loc[order[:2], "load"] = asked.loc[order[:2][::-1], "load"].to_numpy()
        with pytest.raises(InputError, match="as handed out with id"):
            run.is_told(exchanged[["id", "g", "load"]])


def test_designs_whose_table_cannot_be_written_are_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def full(path: Path) -> Iterator[io.StringIO]:
        yield io.StringIO()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("activefail.text.csv_table.replacing", full)
    said = activefail("ask", folder, "--n", "2", "--csv", tmp_path / "todo.csv")
    assert said.code == 2
    assert "2 designs, ids 10 to 11, are in flight; `activefail ask" in said.err
    assert "--in-flight --csv FILE` writes them again" in said.err
    assert "No space left on device" in said.err


def test_added_simulations_are_given_and_must_lie_in_the_design_space(folder: Path, tmp_path: Path) -> None:
    rows = [{"load": 2.0, "strength": 3.0, "g": -1.0}, {"load": 2.0, "strength": 8.0, "g": 4.0}]
    path = written(tmp_path / "old.csv", rows)
    said = activefail("add", folder, "--csv", path)
    assert (said.code, said.out) == (0, "2 simulations added\n")
    assert activefail("add", folder, "--csv", path).out == "0 simulations added\n"
    assert "given      1 safe, 1 failure" in activefail("status", folder).out
    written(path, [*rows, {"load": 6.0, "strength": 3.0, "g": -1.0}])
    refused(
        activefail("add", folder, "--csv", path), f"{path}: row 3 (line 4), column load: `1 <= load <= 5` must hold"
    )
    with af.open_run(folder) as run:
        assert (run.simulations["origin"] == "given").sum() == 2
        assert run.summary.done == 8


def test_dropping_names_what_is_wrong(folder: Path) -> None:
    refused(activefail("drop", folder, "--ids", "8,x"), "--ids: must be whole numbers separated by commas, got 'x'")
    refused(activefail("drop", folder, "--ids", "8,77"), "ids: must be of designs in flight; id 77 is unknown")
    refused(activefail("drop", folder, "--ids", "8,3"), "ids: must be of designs in flight; id 3 has a result")
    assert activefail("drop", folder, "--ids", "8").out == "1 design dropped; 1 design in flight\n"
    with af.open_run(folder, write=True) as run:
        assert run.drop(8) == 0
        with pytest.raises(InputError, match=r"ids: must be a whole number, got 8\.5"):
            run.drop([8.5])
        with pytest.raises(
            InputError, match=r"row 0: id 8 was dropped \(use `add` to record its result\); this row has"
        ):
            run.tell({"id": 8, "g": 1.0})


@pytest.mark.parametrize("n", [0, -1, 2.5, "3", True])
def test_a_number_of_designs_is_a_whole_number_of_at_least_one(folder: Path, n: Any) -> None:
    with af.open_run(folder, write=True) as run, pytest.raises(InputError, match="n: must be"):
        run.ask(n)


def test_a_run_that_is_open_for_reading_hands_nothing_out(folder: Path) -> None:
    with af.open_run(folder) as run:
        for change in (lambda: run.ask(1), lambda: run.tell({"id": 8, "g": 1.0}), lambda: run.drop([8])):
            with pytest.raises(StoreError, match="was opened for reading only"):
                change()
        assert run.in_flight["id"].tolist() == [8, 9]


# --- commands ----------------------------------------------------------------------------------------------------


def test_designs_in_flight_are_written_again_without_handing_out_others(folder: Path, tmp_path: Path) -> None:
    first, again = tmp_path / "first.csv", tmp_path / "again.csv"
    assert activefail("ask", folder, "--n", "1", "--csv", first).code == 0
    said = activefail("ask", folder, "--in-flight", "--csv", again)
    assert (said.code, said.out) == (0, f"3 designs, ids 8 to 10, written to {again}\n")
    assert table(again)[-1:] == table(first)


def test_a_table_that_cannot_be_written_hands_nothing_out(folder: Path, tmp_path: Path) -> None:
    refused(activefail("ask", folder, "--n", "1", "--csv", tmp_path / "none" / "todo.csv"), "cannot be written")
    with af.open_run(folder) as run:
        assert run.in_flight["id"].tolist() == [8, 9]


def test_status_lists_the_designs_in_flight_and_the_command_that_continues(folder: Path) -> None:
    said = activefail("status", folder)
    assert "in flight  2 designs, ids 8, 9\n" in said.out
    assert f"continue   activefail tell {folder} --csv answers.csv\n" in said.out
    assert f"           activefail ask {folder} --n 4 --csv todo.csv\n" in said.out
    assert "elsewhere, 2 variables" in said.out


def test_fewer_designs_than_asked_for_come_with_the_reason(folder: Path, tmp_path: Path) -> None:
    said = activefail("ask", folder, "--n", "10", "--csv", tmp_path / "todo.csv")
    assert said.code == 0
    assert (
        said.err == "6 designs instead of 10: the campaign's budget of 16 simulations allows no more (in flight: 2)\n"
    )
    beyond = activefail("ask", folder, "--n", "3", "--beyond", "--csv", tmp_path / "todo.csv")
    assert (beyond.err, len(table(tmp_path / "todo.csv"))) == ("", 3)


@pytest.mark.parametrize("command", ["run", "resume", "verify", "probability", "compare"])
def test_commands_that_simulate_refuse_a_campaign_elsewhere(folder: Path, lab: Path, command: str) -> None:
    words = ["run", lab, "--out", lab.with_name("other")] if command == "run" else [command, folder]
    refused(activefail(*words), "simulator.elsewhere: activefail cannot run these simulations", "activefail ask")
    assert not lab.with_name("other").exists()


def test_pages_advise_no_command_that_the_campaign_refuses(folder: Path) -> None:
    reported = activefail("report", folder)
    assert "missing" not in reported.out, reported.err
    page = (folder / "report.html").read_text()
    with af.open_run(folder) as run:
        refused = {*run.campaign.settings.refused}
        page += site_of(run.findings).one.failure({})
    assert refused == {"verify", "probability", "design", "compare"}
    assert [command for command in refused if f"activefail {command}" in page] == []


def test_status_and_report_say_the_same_of_simulations_batches_and_learner(lab: Path) -> None:
    folder = lab.with_name("run")
    with af.create_run(folder, lab) as run:
        first = answered(run.ask(8))
        outcome = np.where(first["g"] > 0.0, "safe", "failure").astype(object)
        outcome[0], first.loc[0, "g"] = "numerical_failure", np.nan
        run.tell(first.assign(outcome=outcome))
        assert "learner    regression of the margin g on design features, or rbf" in activefail("status", folder).out
        run.tell(answered(run.ask(5)))
        run.ask(1)
        safe, failing = (int((run.simulations["outcome"] == name).sum()) for name in ("safe", "failure"))
        run.report()
    counts = f"{safe} safe, {failing} failure, 1 numerical failure"
    told, page = activefail("status", folder).out, (folder / "report.html").read_text()
    assert f"all        {counts}\n" in told
    assert "learner    regression of the margin g on design features\n" in told
    assert f"13: {counts}<" in page
    assert "<dd>5 in 1 batch<" in page
    assert "Gaussian process regression of the margin g" in page


def test_settings_that_need_a_simulator_are_refused_elsewhere(lab: Path) -> None:
    for line, key in (
        ("stop = { error = 0.1 }", "stop.error"),
        ("validation = { size = 10 }", "validation.size"),
        ("simulator = { elsewhere = true, time_limit = 3.0 }", "simulator.time_limit"),
        ("simulator = { elsewhere = false }", "simulator.elsewhere"),
    ):
        text = "\n".join(
            part for part in LAB.splitlines() if not line.startswith("simulator") or part[:9] != "simulator"
        )
        lab.write_text(f"{line}\n{text}")
        refused(activefail("create", lab, "--out", lab.with_name("run")), key)


def test_a_run_is_created_from_a_dictionary(tmp_path: Path) -> None:
    settings = {
        "simulator": {"elsewhere": True, "outcomes": ["safe", "failure"]},
        "space": {"x": {"low": 0.0, "high": 1.0}, "y": {"low": 0.0, "high": 1.0}},
        "sampling": {"initial": 10, "budget": 20, "batch": 5},
    }
    with af.create_run(tmp_path / "run", settings) as run:
        while len(designs := run.ask(5)):
            run.tell(designs.assign(outcome=np.where(designs["x"] + designs["y"] > 1.3, "failure", "safe")))
        assert run.predict([{"x": 0.9, "y": 0.9}])["p_failure"].iloc[0] > 0.8
        assert "20 of 20 simulations" in run._repr_html_()
        assert "has the folder open" not in run._repr_html_()
        with af.open_run(tmp_path / "run") as reader:
            assert "has the folder open" in reader._repr_html_()
    with pytest.raises(InputError, match=r"settings:\n  space\.x"):
        af.create_run(tmp_path / "other", settings | {"space": {"x": {"low": 1.0, "high": 0.0}}})


def plate(folder: Path) -> Path:
    """The file of a small campaign on a Python function."""
    (folder / "plate.py").write_text("def run(d):\n    return 'failure' if d['x'] + d['y'] > 1.3 else 'safe'\n")
    (folder / "plate.toml").write_text(
        'simulator = { python = "plate:run" }\nsampling = { initial = 10, budget = 20, batch = 5 }\n'
        "[space]\nx = { low = 0, high = 1 }\ny = { low = 0, high = 1 }\n"
    )
    return folder / "plate.toml"


def test_a_campaign_asked_for_by_hand_is_resumed_by_a_function(tmp_path: Path) -> None:
    assert activefail("run", plate(tmp_path), "--out", tmp_path / "whole").code == 0
    with af.create_run(tmp_path / "run", tmp_path / "plate.toml") as run:
        for _ in range(3):
            designs = run.ask(5)
            run.tell(designs.assign(outcome=np.where(designs["x"] + designs["y"] > 1.3, "failure", "safe")))
        run.take(progress=False, workers=1)
    assert record(tmp_path / "run") == record(tmp_path / "whole")


def test_every_public_name_can_be_imported_and_is_documented() -> None:
    for name in af.__all__:
        public = getattr(af, name)
        assert name == "TABLE_1" or (public.__doc__ or "").strip(), name
    for name in dir(af.Run):
        if not name.startswith("_"):
            assert (getattr(af.Run, name).__doc__ or "").strip(), name
    assert issubclass(af.InputError, af.ActivefailError)


# --- found under attack ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "row",
    [
        *({"id": number, "g": 1.0} for number in (10**400, 1e300, 2**53, 2.5, "8.5", np.float64("inf"), True)),
        {"id": 8, "g": 1.0, "cause": ["fog"]},
        {"id": 8, "g": 1.0, "outcome": ("safe",)},
        *({"id": 8, "g": value} for value in (1j, True)),
    ],
)
def test_odd_cells_get_a_message(folder: Path, row: dict[str, Any]) -> None:
    with af.open_run(folder, write=True) as run:
        with pytest.raises(InputError, match="row 0, column"):
            run.tell([row])
        assert len(run.history) == 8


@pytest.mark.parametrize("number", [8, 8.0, "8", "8.0", "8.", np.int8(8), np.float32(8.0)])
def test_an_id_may_come_as_any_kind_of_whole_number(folder: Path, number: Any) -> None:
    with af.open_run(folder, write=True) as run:
        assert run.tell({"id": number, "g": 1.0}) == 1


def test_nothing_to_tell_or_add_is_nothing(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        assert (run.tell([]), run.tell(pd.DataFrame()), run.add([])) == (0, 0, 0)


def test_ids_to_drop_may_be_an_array_and_nothing_else_odd(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        for ids in (2**63, None, 1.0, [8.5], True, b"12", "8"):
            with pytest.raises(InputError, match="ids: must be"):
                run.drop(ids)
        assert run.drop({8}) == 1
        assert run.drop(run.in_flight["id"].to_numpy()) == 1


@pytest.mark.parametrize("table", [None, 3.0, {8, 1.0}, iter([]), b"id,g"])
def test_what_is_no_table_is_refused_by_its_type(folder: Path, table: Any) -> None:
    message = f"table: must be a DataFrame, .*, got {type(table).__name__}"
    with af.open_run(folder, write=True) as run:
        for record in (run.tell, run.add):
            with pytest.raises(InputError, match=message):
                record(table)


@pytest.mark.parametrize("command", ["tell", "add"])
def test_results_come_through_a_pipe(folder: Path, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def piped(text: str) -> CommandResult:
        reader, writer = os.pipe()
        with open(writer, "w") as pipe:
            pipe.write(text)
        with open(reader) as pipe, monkeypatch.context() as patch:
            patch.setattr(sys, "stdin", pipe)
            return activefail(command, folder, "--csv", "-")

    refused(
        piped("id,load,strength,g\n8,2.0,3.0,wide\n"),
        "standard input: row 1 (line 2), column g: must be a number, got 'wide'",
    )
    said = piped("id,g\n8,1.5\n" if command == "tell" else "load,strength,g\n2.0,3.0,-1.0\n")
    assert said.code == 0, said.err
    assert said.out.startswith("1 new result" if command == "tell" else "1 simulation added")


def test_results_come_through_a_pipe_from_another_process(folder: Path) -> None:
    words = [sys.executable, "-m", "activefail.cli", "tell", str(folder), "--csv", "-"]
    said = subprocess.run(words, input="id,g\n8,1.5\n", capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert said.stdout.startswith("1 new result")


def test_given_simulations_can_be_learned_from_and_asked_but_are_no_sample(tmp_path: Path) -> None:
    settings = {
        "simulator": {"python": "plate:run"},
        "space": {"x": {"low": 0.0, "high": 1.0}, "y": {"low": 0.0, "high": 1.0}},
        "sampling": {"initial": 10, "budget": 20, "batch": 5},
    }
    (tmp_path / "plate.py").write_text("def run(d):\n    return 'failure' if d['x'] + d['y'] > 1.3 else 'safe'\n")
    with af.create_run(tmp_path / "earlier", settings, code=tmp_path) as earlier:
        earlier.take(10, progress=False, workers=1)
        export = earlier.simulations
    with af.create_run(tmp_path / "run", settings, code=tmp_path) as run:
        assert run.add(export.iloc[:9]) == 9
        with pytest.raises(InputError, match="has not finished its initial design"):
            run.verify(10)
        assert run.add(export.iloc[9:]) == 1
        assert run.verify(10).estimate.simulations == 10
        lines = run.probability(simulations=10).lines
        assert any(line.split(maxsplit=1)[:2][0] == "bound" and "none without a model" in line for line in lines)
        assert run.take(progress=False, workers=1).progress.done == 20


def test_faults_are_quoted_and_can_be_fixed_although_a_design_is_in_flight(tmp_path: Path) -> None:
    (tmp_path / "plate.py").write_text(
        "from pathlib import Path\ndef run(d):\n    if Path(__file__).with_name('bad').exists():\n"
        "        raise ValueError('no licence')\n    return 'failure' if d['x'] > 0.5 else 'safe'\n"
    )
    (tmp_path / "plate.toml").write_text(
        'simulator = { python = "plate:run" }\nsampling = { initial = 6, budget = 12, batch = 2 }\n'
        "[space]\nx = { low = 0, high = 1 }\ny = { low = 0, high = 1 }\n"
    )
    (bad := tmp_path / "bad").touch()
    with af.create_run(tmp_path / "run", tmp_path / "plate.toml") as run:
        run.ask(1)
        with pytest.raises(
            af.SimulationError, match=r"no simulation has given an outcome.*Why the first .*failed: .*no licence"
        ):
            run.take(progress=False, workers=1)
        bad.unlink()
        run.tell([{"id": 0, "outcome": "safe"}])
        assert len(run.ask(1)) == 1
        assert run.take(progress=False, workers=1).progress.done == 11
        assert run.classifier.outcomes == ("safe", "failure")


def test_a_table_is_read_from_a_path_or_a_binary_file(folder: Path, tmp_path: Path) -> None:
    with af.open_run(folder, write=True) as run:
        path = written(tmp_path / "answers.csv", [{"id": 8, "g": 1.0}])
        with path.open() as text, pytest.raises(InputError, match="table: must be a file that was opened in binary"):
            run.tell(text)
        assert run.tell(str(path)) == 1
        with path.open("rb") as binary:
            assert run.tell(binary) == 0
        written(path, [{"id": 8, "g": "wide"}])
        with path.open("rb") as binary, pytest.raises(InputError, match=f"^{path}: row 1 .line 2., column g"):
            run.tell(binary)


def test_threads_that_ask_at_once_get_different_designs(folder: Path) -> None:
    with af.open_run(folder, write=True) as run, ThreadPoolExecutor(4) as pool:
        tables = list(pool.map(lambda _: run.ask(1, beyond=True), range(4)))
    assert sorted(int(table["id"].iloc[0]) for table in tables) == [10, 11, 12, 13]
    assert len({table["load"].iloc[0] for table in tables}) == 4


def test_a_fork_of_a_writer_hands_nothing_out(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        child = os.fork()
        if child == 0:
            code = 1
            try:
                run.ask(1)
            except StoreError as error:
                code = 0 if "was opened before a fork" in str(error) else 2
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert run.ask(1)["id"].tolist() == [10]


def test_a_list_with_designs_outside_the_space_is_refused(folder: Path, lab: Path) -> None:
    from activefail.record.run_folder import FolderStore

    with FolderStore.open(folder, write=True) as store:
        new = replace(store.asked[-1:], id=store.asked.id[-1:] + 1, designs=np.full((1, 2), 1e300))
        store.hand_out(new)
    refused(activefail("ask", folder, "--csv", lab.with_name("todo.csv")), "outside the design space", code=1)


def test_an_initial_design_that_was_given_up_is_followed_by_another(lab: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        first = run.ask(8)
        assert run.drop(first["id"]) == 8
        second = run.ask(8)
        assert (len(second), second.attrs["reason"]) == (8, "")
        assert not set(first["load"]) & set(second["load"])


def test_asking_for_nothing_keeps_the_table_that_is_there(folder: Path, tmp_path: Path) -> None:
    todo = tmp_path / "todo.csv"
    assert activefail("ask", folder, "--n", "6", "--csv", todo).code == 0
    before = todo.read_bytes()
    said = activefail("ask", folder, "--n", "6", "--csv", todo)
    assert (said.code, said.out) == (
        0,
        "no designs, so no table was written; --in-flight writes the designs in flight again\n",
    )
    assert todo.read_bytes() == before


@pytest.mark.usefixtures("without_pictures")
def test_a_report_of_given_simulations_alone_is_written(lab: Path, tmp_path: Path) -> None:
    with af.create_run(lab.with_name("run"), lab) as run:
        load, strength = np.random.default_rng(3).uniform([1.0, 2.0], [5.0, 12.0], (20, 2)).T
        assert run.add(pd.DataFrame({"load": load, "strength": strength, "g": strength - 2.0 * load})) == 20
        run.report(tmp_path / "report.html")
        with pytest.raises(InputError, match=r"Commands with fresh simulations \(verify"):
            run.verify(10)
    assert "no bound: no simulation is one of an initial design" in (tmp_path / "report.html").read_text()
    assert "given" in (tmp_path / "report.html").read_text()


# --- messages and warnings ---------------------------------------------------------------------------------------


def test_predictions_keep_the_index_so_that_they_join_their_designs(folder: Path) -> None:
    with af.open_run(folder) as run:
        some = run.simulations.iloc[[5, 2, 7]]
        predicted = run.predict(some)
        assert predicted.index.tolist() == [5, 2, 7]
        assert predicted["load"].tolist() == some["load"].tolist()
        assert run.predict([[2.0, 4.5]])["load"].tolist() == [2.0]
        with pytest.raises(InputError, match="X: must be a table or an"):
            run.predict(["load"])


def test_a_misspelt_column_a_missing_margin_and_a_contradiction_are_warned_of(folder: Path, tmp_path: Path) -> None:
    with af.open_run(folder, write=True) as run:
        with pytest.warns(UserWarning, match="column 'outcom' is ignored; 'outcome' is missing"):
            run.tell([{"id": 8, "g": 1.0, "outcom": "safe"}])
        with pytest.warns(UserWarning, match=r"row 0: g -0\.5 contradicts the outcome safe"):
            run.tell([{"id": 9, "g": -0.5, "outcome": "safe"}])
    path = written(tmp_path / "old.csv", [{"ids": 1, "load": 2.0, "strength": 8.0, "outcome": "safe", "caus": ""}])
    said = activefail("add", folder, "--csv", path)
    assert (said.code, said.out) == (0, "1 simulation added\n")
    # `add` ignores the id, so it does not miss it.
    first, second = said.err.splitlines()
    way = ' (--map "cause=caus", with a factor if the unit differs)'
    assert first == f"warning: {path}: column 'caus' is ignored; 'cause' is missing{way}."
    assert second.startswith(f"warning: {path}: row 1 (line 2): g is missing. A boundary is learned from a margin only")


def test_warnings_that_are_errors_come_before_anything_is_recorded(folder: Path) -> None:
    with af.open_run(folder, write=True) as run, warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning, match="contradicts the outcome"):
            run.tell([{"id": 9, "g": -0.5, "outcome": "safe"}])
        with pytest.raises(UserWarning, match="contradicts the outcome"):
            run.add([{"load": 2.0, "strength": 8.0, "g": -0.5, "outcome": "safe"}])
        assert (len(run.history), run.in_flight["id"].tolist()) == (8, [8, 9])


def test_warnings_are_attributed_to_the_line_that_tells(folder: Path) -> None:
    with af.open_run(folder, write=True) as run:
        with pytest.warns(UserWarning, match="contradicts") as told:
            run.tell([{"id": 9, "g": -0.5, "outcome": "safe"}])
        with pytest.warns(UserWarning, match="contradicts") as added:
            run.add([{"load": 2.0, "strength": 8.0, "g": -0.5, "outcome": "safe"}])
    assert [told[0].filename, added[0].filename] == [__file__] * 2


FILLED_IN = {
    "a table": "id,load,strength,span,outcome\n8,,,,\n9,{9},3.0,safe\n",
    "semicolons": "id;load;strength;span;g\n8;1,0;2,0;3,0;1,5\n",
    "Latin-1": "id,note,g\n8,Brücke,1.5\n",
    "an unknown id": "id,g\n77,1.5\n",
    "another result": "id,g\n0,-77.0\n",
    "simulations to add": "load,strength,g\n2.0,3.0,-1.0\n",
    "a line before": "sep=,\nid,g\n8,1.5\n",
    "other letters": "ID,Load,Outcome\n8,1.0,safe\n",
}


@pytest.mark.parametrize("kind", FILLED_IN)
@pytest.mark.parametrize("option", ["--n=1", "--in-flight"])
def test_a_table_with_results_that_are_not_recorded_is_not_replaced(
    folder: Path, tmp_path: Path, kind: str, option: str
) -> None:
    with af.open_run(folder) as run:
        design = run.in_flight.set_index("id").loc[9]
    text = FILLED_IN[kind].replace("{9}", f"{design['load']!r},{design['strength']!r}")
    (todo := tmp_path / "todo.csv").write_bytes(before := text.encode({"Latin-1": "latin-1"}.get(kind, "utf-8")))
    first = text.splitlines()[0]
    of_others = {"sep=,": "sep=", "ID,Load,Outcome": "ID, Load, Outcome"}
    column = of_others.get(first, "outcome" if "outcome" in first else "g")
    said = activefail("ask", folder, option, "--csv", todo)
    refused(said, f"--csv: {todo} holds results that are not recorded ({column}): `tell` them first")
    assert todo.read_bytes() == before
    with af.open_run(folder) as run:
        assert run.in_flight["id"].tolist() == [8, 9]


def test_a_table_of_one_line_is_told_nothing_without_a_word_no_more(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "told.csv").write_text("8,safe,0.5\n")
    for command in ("tell", "add"):
        refused(activefail(command, folder, "--csv", tmp_path / "told.csv"), "required, but missing")


def test_ask_fill_in_and_tell_go_on_in_one_table(folder: Path, tmp_path: Path) -> None:
    todo = tmp_path / "todo.csv"
    assert activefail("ask", folder, "--in-flight", "--csv", todo).code == 0
    for ids in ([10], [11]):
        rows = table(todo)
        written(todo, [row | {"g": "", "outcome": ""} for row in rows])
        # A template that nobody has filled in yet.
        assert activefail("ask", folder, "--in-flight", "--csv", todo).code == 0
        rows = table(todo)
        written(todo, [row | {"g": 0.5} for row in rows])
        assert activefail("tell", folder, "--csv", todo).code == 0
        assert activefail("ask", folder, "--csv", todo).code == 0
        assert [int(row["id"]) for row in table(todo)] == ids


def test_paths_may_be_strings_or_those_of_another_library(folder: Path, tmp_path: Path) -> None:
    class Other:
        def __init__(self, path: Path) -> None:
            self.path = path

        def __fspath__(self) -> str:
            return str(self.path)

    with af.open_run(folder, write=True) as run:
        for kind in (str, Other):
            assert run.export_table(kind(tmp_path / "all.csv")) == 8
            assert len(table(tmp_path / "all.csv")) == 8
            assert run.predict_table(kind(tmp_path / "all.csv"), kind(tmp_path / "predicted.csv")) == 0
            assert "p_failure" in table(tmp_path / "predicted.csv")[7]
            assert run.export_parquet(kind(tmp_path / "all.parquet")) == 8
            assert len(pd.read_parquet(tmp_path / "all.parquet")) == 8
            (tmp_path / "all.csv").unlink()
        assert run.tell(Other(written(tmp_path / "answers.csv", [{"id": 8, "g": 1.0}]))) == 1
        assert repr(run) == f"Run({str(folder)!r}: 9 of 16 simulations)"


def test_what_is_neither_a_path_nor_a_stream_is_refused_by_its_type(folder: Path, tmp_path: Path) -> None:
    with af.open_run(folder) as run:
        for target in (5, io.BytesIO()):
            with pytest.raises(InputError, match="target: must be a path or a text stream, got "):
                run.export_table(target)
        with pytest.raises(InputError, match="source: must be a file that was opened in binary mode, or its path"):
            run.predict_table(io.StringIO("load,strength\n"), tmp_path / "out.csv")
    with pytest.raises(InputError, match="folder: must be a path, got"):
        af.open_run(None)


def test_status_names_tell_wherever_designs_are_in_flight(tmp_path: Path) -> None:
    (tmp_path / "plate.py").write_text("def run(d):\n    return 'failure' if d['x'] + d['y'] > 1.3 else 'safe'\n")
    (tmp_path / "plate.toml").write_text(
        'simulator = { python = "plate:run" }\nsampling = { initial = 6, budget = 8, batch = 2 }\n'
        "[space]\nx = { low = 0, high = 1 }\ny = { low = 0, high = 1 }\n"
    )
    folder = tmp_path / "run"
    assert activefail("create", tmp_path / "plate.toml", "--out", folder).code == 0
    assert activefail("ask", folder, "--n", "2", "--csv", tmp_path / "todo.csv").code == 0
    said = activefail("status", folder).out
    assert f"continue   activefail resume {folder}\n           activefail tell {folder} --csv answers.csv\n" in said
    said = activefail("resume", folder, "--workers", "1").out
    assert "in flight  2 designs, ids 0, 1; they count towards the budget. Record their results with `" in said
    assert f"continue   activefail tell {folder} --csv answers.csv\n" in activefail("status", folder).out


def test_a_design_on_a_computed_bound_is_accepted_although_its_last_digits_differ(folder: Path) -> None:
    from activefail.record.run_folder import FolderStore

    with FolderStore.open(folder, write=True) as store:
        edge = np.array([[np.nextafter(5.0, 6.0), 12.0]])
        new = replace(store.asked[-1:], id=store.asked.id[-1:] + 1, designs=edge)
        store.hand_out(new)
    assert activefail("status", folder).code == 0
    with af.open_run(folder) as run:
        assert len(run.in_flight) == 3


def test_after_a_failed_campaign_the_classifier_is_that_of_the_record(tmp_path: Path) -> None:
    (tmp_path / "plate.py").write_text(
        "def run(d):\n    if d['x'] > 0.3:\n        raise ValueError('no')\n"
        "    return 'failure' if d['y'] > 0.5 else 'safe'\n"
    )
    (tmp_path / "plate.toml").write_text(
        'simulator = { python = "plate:run" }\nsampling = { initial = 24, budget = 26, batch = 4 }\n'
        "[space]\nx = { low = 0, high = 1 }\ny = { low = 0, high = 1 }\n"
    )
    with af.create_run(tmp_path / "run", tmp_path / "plate.toml") as run:
        run.add([{"x": 0.1, "y": 0.9, "outcome": "failure"}, {"x": 0.1, "y": 0.1, "outcome": "safe"}])
        before = len(run.classifier.latents[0].features)
        with pytest.raises(af.SimulationError, match="failed numerically"):
            run.take(progress=False, workers=1)
        assert len(run.classifier.latents[0].features) == int(run.history.answered.sum()) > before


@pytest.mark.usefixtures("without_pictures")
def test_a_run_keeps_its_folder_when_the_working_directory_changes(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with af.open_run("run", write=True) as run:
        assert run.resume_command() == "activefail resume run"
        named = run._repr_html_()
        (tmp_path / "other").mkdir()
        monkeypatch.chdir(tmp_path / "other")
        assert run.folder == folder
        assert f"activefail tell {folder} --csv" in run._repr_html_()
        assert run._repr_html_().replace(str(folder), "run") == named
        run.report()
    assert (folder / "report.html").exists()
    assert list((tmp_path / "other").iterdir()) == []
