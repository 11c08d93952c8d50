"""Tables of simulated bearings: answers are the simulator's to the last bit, and a bad table leaves nothing behind."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from findings.test_tables import numbers, save, written

from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Model, Tolerance, simulate
from activefail.seismic.bearing.outcome import CAUSES, COLUMNS, OUTCOME_NAMES
from activefail.seismic.tables import check_bearing, simulate_table

HEADER = ",".join(TABLE_1.names)

GOOD = "4.0,0.06,0.6,0.8,0.1,50,2e9,2.0,0.4"


def test_a_simulated_table_holds_what_simulate_answers_to_the_last_bit(tmp_path: Path) -> None:
    X = TABLE_1.latin_hypercube(40, np.random.default_rng(1))
    model, tolerance = Model(slider_diameter=0.32), Tolerance(relative=1e-3)
    progress: list[int] = []

    def begin(total: int) -> object:
        assert total == 40
        return progress.append

    counts = simulate_table(save(tmp_path / "in.csv", X, TABLE_1.names), tmp_path / "out.csv", model, tolerance, begin)  # type: ignore[arg-type]
    answers = simulate(X, model, tolerance)
    header, rows = written(tmp_path / "out.csv")
    assert header == [*TABLE_1.names, "outcome", "cause", *COLUMNS]
    assert numbers(rows, slice(0, 9)).tobytes() == X.tobytes()
    assert [row[9] for row in rows] == answers.outcome_name.tolist()
    assert [row[10] for row in rows] == [CAUSES[cause] for cause in answers.cause]
    assert np.array_equal(numbers(rows, slice(11, None)), answers.columns, equal_nan=True)
    assert counts == {name: int((answers.outcome_name == name).sum()) for name in OUTCOME_NAMES}
    assert len(set(answers.outcome_name.tolist())) == 3
    assert sum(progress) == 40


def test_a_numerical_failure_is_written_and_counted_as_one(tmp_path: Path) -> None:
    X = TABLE_1.latin_hypercube(4, np.random.default_rng(1))
    counts = simulate_table(
        save(tmp_path / "in.csv", X, TABLE_1.names), tmp_path / "out.csv", Model(), Tolerance(most_steps=5)
    )
    _, rows = written(tmp_path / "out.csv")
    assert {(row[9], row[10]) for row in rows} == {("numerical_failure", "too_many_steps")}
    assert counts == {"no_impact": 0, "impact": 0, "failure": 0, "numerical_failure": 4}


def test_other_columns_and_the_text_of_numbers_are_carried_along_in_any_order(tmp_path: Path) -> None:
    X = TABLE_1.latin_hypercube(2, np.random.default_rng(1))
    header = ["site", *TABLE_1.names[::-1], "remark"]
    lines = [["Bridge, north", *[f"{x:.20e}" for x in row[::-1]], 'the "old" one\n2nd line'] for row in X.tolist()]
    with (tmp_path / "in.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *lines])
    simulate_table(tmp_path / "in.csv", tmp_path / "out.csv", Model(), Tolerance())
    header_written, rows = written(tmp_path / "out.csv")
    assert header_written == [*header, "outcome", "cause", *COLUMNS]
    assert [row[:11] for row in rows] == lines
    assert [row[11] for row in rows] == simulate(X).outcome_name.tolist()


def test_a_table_may_be_written_over_itself(tmp_path: Path) -> None:
    X = TABLE_1.latin_hypercube(3, np.random.default_rng(1))
    path = save(tmp_path / "designs.csv", X, TABLE_1.names)
    simulate_table(path, path, Model(), Tolerance())
    header, rows = written(path)
    assert header[9:11] == ["outcome", "cause"]
    assert len(rows) == 3


def test_a_table_without_designs_becomes_a_header(tmp_path: Path) -> None:
    counts = simulate_table(
        save(tmp_path / "in.csv", np.empty((0, 9)), TABLE_1.names), tmp_path / "out.csv", Model(), Tolerance()
    )
    assert written(tmp_path / "out.csv") == ([*TABLE_1.names, "outcome", "cause", *COLUMNS], [])
    assert sum(counts.values()) == 0


def _with(column: str, cell: str) -> str:
    cells = GOOD.split(",")
    cells[TABLE_1.names.index(column)] = cell
    return ",".join(cells)


BAD = {
    **{
        f"{name} of {cell}": (_with(name, cell), f"column {name}: `0 < {name} <= 1e+75` must hold, got {cell}")
        for name in TABLE_1.names
        for cell in ("0", "-0.1", "1e+308")
    },
    "text": (_with("mu", "rough"), "column mu: must be a number, got 'rough'"),
    "nan": (_with("A_p", "nan"), "column A_p: must be a finite number, got 'nan'"),
    "dish more than a hemisphere": (_with("D_tot", "20"), "D_tot, h_sl_ratio, h_rim_ratio: A dish must be less"),
    "slider higher than the sphere": (
        _with("h_sl_ratio", "90"),
        "h_sl_ratio, h_rim_ratio: The slider's height must",
    ),
    "cell too few": (GOOD.rpartition(",")[0], "must have 9 cells, like the header, has 8"),
}


@pytest.mark.parametrize(("line", "says"), BAD.values(), ids=BAD.keys())
def test_a_design_that_is_no_bearing_is_refused_by_row_line_rule_and_value_and_nothing_is_written(
    tmp_path: Path, line: str, says: str
) -> None:
    source = tmp_path / "in.csv"
    source.write_text(f"{HEADER}\n{GOOD}\n{GOOD}\n{line}\n{GOOD}\n")
    (tmp_path / "out.csv").write_text("the old one")
    began: list[int] = []
    with pytest.raises(InputError) as refused:
        simulate_table(source, tmp_path / "out.csv", Model(), Tolerance(), lambda n: began.append)  # type: ignore[arg-type,return-value]
    message = str(refused.value)
    assert message.startswith(f"{source}: row 3 (line 4)")
    assert says in message
    assert message.endswith(".")
    assert not message.endswith("..")
    assert began == []
    assert sorted(os.listdir(tmp_path)) == ["in.csv", "out.csv"]
    assert (tmp_path / "out.csv").read_text() == "the old one"


@pytest.mark.parametrize("column", ["outcome", "cause", COLUMNS[0], COLUMNS[-1]])
def test_a_table_that_has_an_answer_already_is_refused(tmp_path: Path, column: str) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER},{column}\n{GOOD},x\n")
    with pytest.raises(InputError, match=f"column '{column}': would be overwritten by the output"):
        simulate_table(tmp_path / "in.csv", tmp_path / "out.csv", Model(), Tolerance())


def test_what_passes_the_check_of_a_bearing_can_be_simulated() -> None:
    check = check_bearing(Model())
    rng = np.random.default_rng(0)
    # Five times wider than Table 1, on both sides.
    X = np.exp(rng.uniform(np.log(TABLE_1.low / 5.0), np.log(TABLE_1.high * 5.0), (60, 9)))
    passed = X[[check(row) is None for row in X]]
    assert 10 < len(passed) < 60
    assert len(simulate(passed).outcome) == len(passed)
