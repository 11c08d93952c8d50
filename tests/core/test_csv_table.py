"""Tables: every bad cell is named before anything is done, and a table appears whole or not at all."""

import csv
import io
import os
import stat
from collections.abc import Callable, Sequence
from pathlib import Path

import hypothesis
import pytest
from hypothesis import given
from hypothesis import strategies as st

from activefail.errors import InputError
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace
from activefail.text.csv_table import ROWS_AT_ONCE, DesignTable, Kept, Table, harmless, rereadable, writing

SPACE = DesignSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))


def ordered(design: Array) -> str | None:
    return None if design[0] <= design[1] else f"column b: `a <= b` must hold, got {design[1]:g}"


@pytest.fixture
def table(tmp_path: Path) -> Callable[[str | bytes], DesignTable]:
    """Writes a file and checks it as a table of a and b to which `answer` will be added."""

    def checked(content: str | bytes) -> DesignTable:
        path = tmp_path / "in.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return DesignTable.checked(Kept(path, str(path)), SPACE, ("answer",), ordered)

    return checked


def rows(of: DesignTable) -> tuple[list[list[str]], list[list[float]]]:
    chunks = list(of.chunks())
    return [text for texts, _ in chunks for text in texts], [row for _, X in chunks for row in X.tolist()]


# What is wrong, and what the message says of it after the file's name.
BAD = {
    "text": ("a,b\n1,2\n1,two\n", "row 2 (line 3), column b: must be a number, got 'two'"),
    "a range": ("a,b\n1,0.5-100\n", "row 1 (line 2), column b: must be a number, got '0.5-100'"),
    "empty cell": ("a,b\n,2\n", "row 1 (line 2), column a: must be a finite number, got an empty cell"),
    "nan": ("a,b\n1,2\nNaN,2\n", "row 2 (line 3), column a: must be a finite number, got 'NaN'"),
    "nul": ("a,b\n1,\x00\n", "row 1 (line 2), column b: must be a number, got '\\x00'"),
    "broken rule": ("a,b\n1,2\n3,2\n", "row 2 (line 3), column b: `a <= b` must hold, got 2"),
    "title above": (
        "Results\na,b,note\n1,2,x\n",
        "row 1 (line 2): must have 1 cells, like the header, has 3. The header must be the first line",
    ),
    "cell too few": ("a,b,note\n1,2,x\n1,2\n", "row 2 (line 3): must have 3 cells, like the header, has 2"),
    "line breaks in a cell": (
        'note,a,b\n"over\nthree\nlines",1,2\nx,1,?\n',
        "row 2 (line 5), column b: must be a number, got '?'",
    ),
    "missing column": ("a,c\n1,2\n", "column 'b': required, but missing; the required columns are a,b"),
    "thousands": ("a;b\n1;2.000,5\n", "row 1 (line 2), column b: must be a number, got '2.000,5'"),
    "points and commas": (
        "a;b\n1,5;2\n1.5;2\n",
        "row 2 (line 3), column a: must be a number with the decimal mark of the others, got '1.5'",
    ),
    "column twice": ("a,b,a\n1,2,3\n", "column 'a': must occur only once, occurs 2 times"),
    "column that will be written": (
        "a,answer,b\n1,2,3\n",
        "column 'answer': would be overwritten by the output; rename or remove it",
    ),
    "empty file": ("", "is empty; a header is required"),
    "Excel": (b"PK\x03\x04\x14\0", "is a workbook or an archive; save the table as CSV"),
    "misspelt": ("aa,B [m]\n1,2\n", "column 'a': required, but missing; the required columns are a,b."),
    "a unit": ("a,B [m]\n1,2\n", "column 'b': required, but missing; the required columns are a,b. It may be 'B [m]'"),
    "latin-1": (b"a,b\n1,2\n1,\xfc\n", "must be UTF-8 text (of a spreadsheet: CSV UTF-8)"),
    "open quote": ('a,b\n1,"2\n', "not valid CSV"),
}


@pytest.mark.parametrize(("content", "says"), BAD.values(), ids=BAD.keys())
def test_a_bad_table_is_refused_with_its_name_and_the_place_rule_and_value_of_the_first_mistake(
    table: Callable[[str | bytes], DesignTable], content: str | bytes, says: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as refused:
        table(content)
    assert str(refused.value).startswith(f"{tmp_path / 'in.csv'}: {says}")
    assert str(refused.value).endswith(".")


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "none.csv", "No such file or directory"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError) as refused:
            DesignTable.checked(Kept(path, str(path)), SPACE, (), ordered)
        assert str(refused.value) == f"{path}: cannot be read: {reason}."


@pytest.mark.parametrize(
    "content",
    [
        "a,b\n1,2\n3,4\n",
        "a,b\n1,2\n3,4",
        "a,b\r\n1,2\r\n3,4\r\n",
        "\ufeffa,b\n1,2\n3,4\n",
        " a , b\n 1,2 \n3.0,4e0\n",
        '"a","b"\n"1","2"\n+3,0.4E+1\n',
        "a,b,,\n1,2,,\n,,,\n3,4,,\n,,,\n",
        "a;b\n1,0; 20,0e-1\n+3;4,\n",
        "a\tb\n1\t2\n3\t4\n",
    ],
    ids=[
        "plain",
        "no end of line",
        "Windows",
        "byte order mark",
        "blanks",
        "quoted",
        "empty",
        "decimal commas",
        "tabs",
    ],
)
def test_a_table_is_read_however_a_spreadsheet_writes_it(
    table: Callable[[str | bytes], DesignTable], content: str
) -> None:
    for good in (table(content), table(content.removeprefix("\ufeff").encode("utf-16"))):
        assert (good.header, good.rows) == (("a", "b"), 2)
        assert rows(good)[1] == [[1.0, 2.0], [3.0, 4.0]]


def test_between_semicolons_only_numbers_are_changed(table: Callable[[str | bytes], DesignTable]) -> None:
    good = table("a;b;part, kind\n1,5;2,5;steel, welded\n-,5e1;3;,\n3;4;12.03.2026\n3;4; 1,5 \n3;4;26.11\n")
    assert good.header == ("a", "b", "part, kind")
    assert rows(good)[1] == [[1.5, 2.5], [-5.0, 3.0], [3.0, 4.0], [3.0, 4.0], [3.0, 4.0]]
    assert rows(good)[0][0] == ["1.5", "2.5", "steel, welded"]
    assert [row[2] for row in rows(good)[0][1:]] == [",", "12.03.2026", " 1,5 ", "26.11"]


def test_choices_have_decimal_commas_if_they_are_numbers_and_keep_them_if_they_are_texts(tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text("b;a;load [u,v,w,x]\n0,5;1,5;x\n0,05;2,5;y\n")
    space = DesignSpace((Parameter.of_choices("a", ("1,5", "2,5")), Parameter.of_choices("b", (0.05, 0.5))))
    good = DesignTable.checked(Kept(tmp_path / "in.csv", "in.csv"), space, (), lambda _: None)
    ((texts, X),) = good.chunks()
    assert X.tolist() == [[0.0, 1.0], [1.0, 0.0]]
    assert texts == [["0.5", "1,5", "x"], ["0.05", "2,5", "y"]]


def test_designs_are_in_the_order_asked_for_and_other_columns_are_kept_as_they_are(
    table: Callable[[str | bytes], DesignTable],
) -> None:
    good = table('note,b,id,a\n"x, ""y""",2,007,1\n , 4,,3 \n')
    assert good.header == ("note", "b", "id", "a")
    assert rows(good) == ([['x, "y"', "2", "007", "1"], [" ", " 4", "", "3 "]], [[1.0, 2.0], [3.0, 4.0]])


def test_a_table_with_a_header_alone_has_no_designs(table: Callable[[str | bytes], DesignTable]) -> None:
    assert table("a,b\n").rows == 0
    assert rows(table("a,b\n")) == ([], [])


def test_a_long_table_comes_in_chunks_and_loses_no_row(table: Callable[[str | bytes], DesignTable]) -> None:
    n = 2 * ROWS_AT_ONCE + 3
    long = table("a,b\n" + "".join(f"{i},{n}\n" for i in range(n)))
    chunks = [len(X) for _, X in long.chunks()]
    assert chunks == [ROWS_AT_ONCE, ROWS_AT_ONCE, 3]
    assert [row[0] for row in rows(long)[1]] == list(range(n))
    # A whole number of chunks leaves no empty one behind.
    even = table("a,b\n" + "1,2\n" * ROWS_AT_ONCE)
    assert [len(X) for _, X in even.chunks()] == [ROWS_AT_ONCE]


def test_a_carriage_return_in_a_cell_stays_in_its_cell(tmp_path: Path) -> None:
    with writing(tmp_path / "out.csv", ["note", "a", "b"]) as write:
        write([["over\rtwo lines", "1", "2"]])
    assert rows(DesignTable.checked(Kept(tmp_path / "out.csv", ""), SPACE, (), ordered))[0] == [
        ["over\rtwo lines", "1", "2"]
    ]


cells = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\r"), max_size=8)


@hypothesis.settings(deadline=None)
@given(
    texts=st.lists(st.tuples(cells, st.floats(-1e3, 0.0), cells, st.floats(0.0, allow_infinity=False)), max_size=6),
)
def test_what_is_written_is_read_again_to_the_last_bit(
    texts: list[tuple[str, float, str, float]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "again.csv"
    given = [[note, repr(a), other, repr(b)] for note, a, other, b in texts]
    with writing(path, ["note", "a", "other", "b"]) as write:
        write(given)
    repeated = DesignTable.checked(Kept(path, str(path)), SPACE, (), ordered)
    kept = [[harmless(note), a, harmless(other), b] for note, a, other, b in given]
    assert rows(repeated) == (kept, [[a, b] for _, a, _, b in texts])


def test_no_cell_or_name_of_a_column_is_written_as_a_formula(tmp_path: Path) -> None:
    formulas = ["=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\t=1", " =1", "\n=1", "＝1", "-x", "\r=1"]
    numbers = ["-0.5", "+1e-3", "-inf", "nan", " -7 ", "a=b", "2-1", ""]
    with writing(tmp_path / "out.csv", ["=name"]) as write:
        write([[cell] for cell in (*formulas, *numbers)])
    with (tmp_path / "out.csv").open(newline="", encoding="utf-8") as file:
        written = [cells[0] if cells else "" for cells in csv.reader(file)]
    assert written == ["'=name", *("'" + cell for cell in formulas), *numbers]


# --- writing -----------------------------------------------------------------------------------------------------


def test_a_table_appears_only_once_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("the old one\n")
    with writing(path, ["a", "b"]) as write:
        write([[1, 2]])
        assert path.read_text() == "the old one\n"
        write([[3, "x, y"]])
        assert path.read_text() == "the old one\n"
    assert path.read_text() == 'a,b\n1,2\n3,"x, y"\n'
    assert os.listdir(tmp_path) == ["out.csv"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError, InputError])
def test_a_table_that_is_not_finished_leaves_the_old_one_and_nothing_else(
    tmp_path: Path, error: type[BaseException]
) -> None:
    (tmp_path / "out.csv").write_text("the old one\n")

    def fail(write: Callable[[Sequence[Sequence[int]]], None]) -> None:
        write([[1, 2]] * 10_000)
        raise error

    with pytest.raises(error), writing(tmp_path / "out.csv", ["a", "b"]) as write:
        fail(write)
    assert os.listdir(tmp_path) == ["out.csv"]
    assert (tmp_path / "out.csv").read_text() == "the old one\n"


def test_a_written_table_has_the_rights_that_any_new_file_gets(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with writing(tmp_path / "out.csv", ["a"]) as write:
            write([[1]])
        (tmp_path / "plain").touch()
    finally:
        os.umask(before)
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("out.csv", "plain")]
    assert modes == [0o640, 0o640]


def test_a_link_is_followed_and_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link.csv").symlink_to(tmp_path / "real.csv")
    with writing(tmp_path / "link.csv", ["a"]) as write:
        write([["1"]])
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text() == "a\n1\n"


def test_what_is_no_regular_file_is_neither_read_nor_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="must be a regular file"):
        Table.of_csv(tmp_path / "pipe")
    with pytest.raises(InputError, match="must be a file"), writing(tmp_path / "pipe", ["a"]):
        pass
    assert (tmp_path / "pipe").is_fifo()


# --- streams -----------------------------------------------------------------------------------------------------


class Pipe(io.BytesIO):
    """A stream that can be read only once."""

    name: str | int = 0

    def seek(self, offset: int, whence: int = 0, /) -> int:
        raise io.UnsupportedOperation("seek")


def test_a_stream_is_read_once_and_gives_the_table_of_the_file(table: Callable[[str | bytes], DesignTable]) -> None:
    content = "a,note,b\n" + "".join(f"{i},x{i},{i + 1}\n" for i in range(ROWS_AT_ONCE + 1))
    with rereadable(Pipe(content.encode())) as kept:
        of_stream = DesignTable.checked(kept, SPACE, ("answer",), ordered)
        of_file = table(content)
        assert (of_stream.header, of_stream.rows) == (of_file.header, of_file.rows)
        assert rows(of_stream) == rows(of_stream) == rows(of_file)


@pytest.mark.parametrize("name", ["standard input", "b.csv", "the table"])
def test_a_bad_stream_is_refused_by_its_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Pipe(b"a,b\n1,2\n3,2\n")
    if name == "standard input":
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(stream))
    elif name == "b.csv":
        name = stream.name = str(tmp_path / name)
    with rereadable(stream) as kept, pytest.raises(InputError) as refused:
        DesignTable.checked(kept, SPACE, (), ordered)
    assert str(refused.value) == f"{name}: row 2 (line 3), column b: `a <= b` must hold, got 2."


def test_a_stream_gets_rows_as_they_are_computed() -> None:
    passed_on: list[str] = []

    class Output(io.StringIO):
        def flush(self) -> None:
            passed_on.append(self.getvalue())

    with writing(Output(), ["a"]) as write:
        assert passed_on == ["a\n"]
        write([["1"], ["2"]])
        assert passed_on == ["a\n", "a\n1\n2\n"]


def test_a_stream_that_is_closed_on_the_other_side_raises_its_own_error() -> None:
    class Closed(io.StringIO):
        def flush(self) -> None:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError), writing(Closed(), ["a"]):
        pass
