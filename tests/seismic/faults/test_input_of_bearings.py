"""What people write of bearings in files and on the command line is taken or refused in words."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from commandline import activefail, refused
from faults.test_input import (
    NO_NAMES,
    Survived,
    bring_no_traceback,
    full,
    is_taken_or_refused,
    is_unknown,
    keys,
    often,
    scalars,
    texts,
    values,
)
from hypothesis import given
from hypothesis import strategies as st

from activefail.seismic.bearing import TABLE_1
from activefail.space.parameter import LARGEST

pytestmark = pytest.mark.faults

HEADER = ",".join(TABLE_1.names)

ROW = ("4.0", "0.06", "0.6", "0.8", "0.1", "50", "2e9", "2.0", "0.4")

no_numbers = st.one_of(
    st.text(st.characters(codec="utf-8", exclude_categories=["Cs"], exclude_characters='\r\n"\0'), max_size=8),
    st.sampled_from(
        ["", " ", "nan", "-NaN", "inf", "-Infinity", "1e999", "1_000", "0x10", "1,5", "4 m", "½", "--1", "1e"]
    ),
    st.floats(max_value=0.0).map(repr),
    st.floats(min_value=1.01 * LARGEST).map(repr),
).filter(lambda text: not _is_good(text))


def _is_good(text: str) -> bool:
    try:
        value = float(text.replace("_", "?"))
    except ValueError:
        return False
    return 0.0 < value <= LARGEST


def _number(text: str) -> str | None:
    """A number as messages write it; None if the text is none."""
    try:
        return f"{float(text):g}"
    except ValueError:
        return None


@often
@given(
    before=st.integers(0, 4),
    after=st.integers(0, 3),
    column=st.integers(0, 8),
    bad=no_numbers,
    blank=st.booleans(),
    order=st.permutations(range(9)),
    end=st.sampled_from(["\n", "\r\n"]),
    mark=st.booleans(),
)
def test_a_bad_cell_is_refused_by_file_row_line_column_rule_and_value_and_nothing_is_written(
    before: int,
    after: int,
    column: int,
    bad: str,
    blank: bool,
    order: list[int],
    end: str,
    mark: bool,
    tmp_path_factory: pytest.TempPathFactory,
    survived: Survived,
) -> None:
    place = tmp_path_factory.getbasetemp() / "tables"
    place.mkdir(exist_ok=True)
    row = [f'"{text}"' if "," in text else text for text in (bad if i == column else ROW[i] for i in order)]
    good = ",".join(ROW[i] for i in order)
    lines = [",".join(TABLE_1.names[i] for i in order), *[""] * blank, *[good] * before, ",".join(row), *[good] * after]
    (place / "in.csv").write_bytes((end.join(lines) + end).encode("utf-8-sig" if mark else "utf-8"))
    result = activefail("simulate", "--csv", place / "in.csv", "--out", place / "out.csv")
    name, line = TABLE_1.names[column], before + 2 + blank
    refused(result, f"{place / 'in.csv'}: row {before + 1} (line {line}), column {name}: ", "must ", "got ")
    value = result.err.rpartition("got ")[2].rstrip(".\n")
    assert value in (repr(bad.strip()) if bad.strip() else "an empty cell", _number(bad)), result.err
    assert os.listdir(place) == ["in.csv"]
    survived()


@often
@given(content=st.one_of(st.binary(max_size=80), st.text('"a,\r\n;\t1.T_b\0é', max_size=80).map(str.encode)))
def test_a_file_of_any_bytes_is_no_table_and_is_refused_by_its_name(
    content: bytes, tmp_path_factory: pytest.TempPathFactory, survived: Survived
) -> None:
    place = tmp_path_factory.getbasetemp() / "tables"
    place.mkdir(exist_ok=True)
    (place / "in.csv").write_bytes(content)
    refused(activefail("simulate", "--csv", place / "in.csv", "--out", place / "out.csv"), f"{place / 'in.csv'}")
    assert os.listdir(place) == ["in.csv"]
    survived()


def test_a_bad_cell_at_the_end_of_a_million_rows_is_refused_in_little_memory(tmp_path: Path, every_fault: bool) -> None:
    rows = 10**6 if every_fault else 10**4
    with (tmp_path / "in.csv").open("w") as file:
        file.write(f"{HEADER}\n" + f"{','.join(ROW)}\n" * (rows - 1) + f"{','.join(ROW).replace('0.06', 'rough')}\n")
    words = [sys.executable, "-m", "activefail.cli", "simulate", "--csv", "in.csv", "--out", "out.csv"]

    def limited() -> None:
        # The libraries alone take some 0.6 GB of addresses; a million rows as Python objects would take 1 GB more.
        resource.setrlimit(resource.RLIMIT_DATA, (500 * 2**20, 500 * 2**20))

    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, preexec_fn=limited)
    assert done.returncode == 2, done.stderr
    assert f"in.csv: row {rows} (line {rows + 1}), column mu: must be a number, got 'rough'." in done.stderr
    assert os.listdir(tmp_path) == ["in.csv"]


BEARING = full({"stop": {"error": 0.05}, "classifier": {"features": {"python": "own_features:own"}}})


@often
@given(path=st.sampled_from(keys(BEARING)), value=values)
def test_a_value_that_a_key_of_a_bearing_cannot_have_is_refused_by_file_key_rule_and_value(
    path: tuple[str, ...], value: object, taken: Path, survived: Survived
) -> None:
    is_taken_or_refused(BEARING, path, value, taken)
    survived()


@often
@given(path=st.sampled_from([(), *keys(BEARING)]), name=texts.filter(lambda text: text not in NO_NAMES), value=scalars)
def test_a_key_of_a_bearing_that_there_is_not_is_refused_by_file_and_key(
    path: tuple[str, ...], name: str, value: object, taken: Path, survived: Survived
) -> None:
    is_unknown(BEARING, path, name, value, taken)
    survived()


@often
@given(data=st.data())
def test_no_options_of_the_paper_bring_a_traceback(
    data: st.DataObject, taken: Path, monkeypatch: pytest.MonkeyPatch, survived: Survived
) -> None:
    monkeypatch.chdir(taken)
    bring_no_traceback(["paper"], ["--draws", "--fresh", "--seed"], data, taken, last=("--draws", "0"))
    survived()
