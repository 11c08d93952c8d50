"""docs/reference/run-folder.md describes the files exactly: run_folder.py, which knows only the page, reads them."""

import ast
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from faults.victim import elsewhere, opened
from record.test_run_folder import STORED, WRITES, written

from activefail.estimates import stored_sets
from activefail.record.batch import COLUMNS, columns_of
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import EXECUTION_CAUSES

FOLDER = Path(__file__).parents[3] / "docs" / "reference"
PAGE = (FOLDER / "run-folder.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def reader() -> SimpleNamespace:
    """The reader beside the page."""
    source = (FOLDER / "run_folder.py").read_text(encoding="utf-8")
    imported = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else [one.name for one in node.names])
    }
    assert imported == {"hashlib", "json", "re", "pathlib", "numpy"}
    names: dict[str, object] = {}
    exec(compile(source, "run_folder.py", "exec"), names)
    return SimpleNamespace(**names)


@pytest.fixture(params=["stored", "elsewhere"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A stored run folder, and that of a campaign with every kind of event."""
    if request.param == "stored":
        return STORED
    with opened(tmp_path / "run") as store:
        elsewhere(store)
        WRITES["remember"](store)
        store.write_set("test", *(lambda one: (one.designs, one.results))(store.batches[0]))
        store.write_state(store.batches[-1].iteration, {"a/b": np.arange(6.0).reshape(2, 3), "n": np.array(3)})
    return tmp_path / "run"


def test_the_page_s_reader_reads_all_that_the_program_reads(reader: SimpleNamespace, folder: Path) -> None:
    schema, batches, asked, sets, results = reader.read_record(folder)
    with FolderStore.open(folder, write=False) as store:
        assert schema == {name: list(names) for name, names in vars(store.schema).items()}
        assert len(batches) == len(store.batches)
        for one, other in zip(batches, store.batches, strict=True):
            assert one["iteration"] == other.iteration
            for name, column in columns_of(other).items():
                assert (one[name].dtype, one[name].tobytes()) == (column.dtype, column.tobytes())
        assert [one["id"] for one in asked] == store.asked.id.tolist()
        assert [one["dropped"] for one in asked] == store.asked.dropped.tolist()
        assert list(sets) == store.set_names() == ["test"]
        assert ("a", "b") in results
        assert results == {of: store.recall(of) for of in results}
        assert reader.digest(folder) == store.digest
        states, saved = reader.read_states(folder), store.latest_state()
        assert saved is not None
        assert max(states) == saved[0]
        record, arrays = states[saved[0]]
        assert record == reader.digest(folder, saved[0])
        assert {name: array.tobytes() for name, array in arrays.items()} == {
            name: array.tobytes() for name, array in saved[1].items()
        }


def test_the_page_s_reader_refuses_what_the_program_refuses(reader: SimpleNamespace, tmp_path: Path) -> None:
    written(tmp_path / "run", 2, 3)
    path = tmp_path / "run" / "journal"
    data = path.read_bytes()
    for changed in (data.replace(b"format 2", b"format 1"), data[:200] + b"x" + data[201:]):
        path.write_bytes(changed)
        with pytest.raises(ValueError, match=r"format|damaged"):
            reader.read_record(tmp_path / "run")
    path.write_bytes(data[:-1])
    assert len(reader.read_record(tmp_path / "run")[1]) == 1
    (tmp_path / "run" / "campaign.toml").write_text("seed = 2\n")
    with pytest.raises(ValueError, match="other settings"):
        reader.read_record(tmp_path / "run")


def test_the_page_names_every_kind_of_set() -> None:
    listed = re.findall(r"^    ([a-z]+)(?:-<.*?)?  ", stored_sets.__doc__ or "", re.MULTILINE)
    sets = PAGE[PAGE.index("The names of sets") : PAGE.index("Results:")]
    assert {"begun", "validation", "check", *listed} <= {*re.findall(r"`([a-z]+)", sets)}


def test_the_page_names_the_columns_causes_and_events_of_the_program() -> None:
    assert re.findall(r"^- `(\w+)`, \w+ \(n", PAGE, re.MULTILINE) == list(COLUMNS)
    causes = re.findall(r"−(\d)\s+`(\w+)`", PAGE)
    assert {-int(code): name for code, name in causes} == EXECUTION_CAUSES
    events = PAGE[PAGE.index("## Events") : PAGE.index("### Columns")]
    source = Path(FolderStore.__mro__[1].__module__.replace(".", "/")).with_suffix(".py")
    kinds = re.findall(r'case "(\w+)":', (Path(__file__).parents[3] / source).read_text())
    assert re.findall(r"^- `(\w+)`, with", events, re.MULTILINE) == kinds
