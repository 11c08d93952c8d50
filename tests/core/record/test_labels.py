"""Labels of simulations: whatever is acknowledged can be read, with any text and any number of columns."""

import json
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from record.test_run_folder import SCHEMA, appended, batch, entries, written

import activefail as af
from activefail.campaign.results_table import Reading, ResultTable
from activefail.errors import StoreError
from activefail.record.events import Event
from activefail.record.labels import labels_of, new_labels
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.text.csv_table import Table

LAB = """
seed = 3
sampling = { initial = 8, budget = 16, batch = 4 }
simulator = { elsewhere = true, outcomes = ["safe", "failure"], margins = ["g"] }
[space]
load = { low = 1.0, high = 5.0, unit = "kN" }
strength = { low = 2.0, high = 12.0 }
"""
FORGED = "activefail " + "0" * 64 + ' 8 ["batch"'
"""A text that looks like an entry of a journal."""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    (tmp_path / "lab.toml").write_text(LAB)
    return tmp_path / "lab.toml"


def table(rows: int, **labels: Any) -> pd.DataFrame:
    """Simulations with these columns of the user's own."""
    rng = np.random.default_rng(rows)
    load, strength = rng.uniform(1.0, 5.0, rows), rng.uniform(2.0, 12.0, rows)
    return pd.DataFrame({"load": load, "strength": strength, "g": strength - 2.0 * load, **labels})


def shown(folder: Path, name: str) -> list[Any]:
    with af.open_run(folder) as run:
        return run.simulations[name].tolist()


def test_labels_of_many_bytes_can_be_read_again(lab: Path) -> None:
    texts = {f"注釈 {k}": [f"{row} " + "試" * 990 for row in range(100)] for k in range(18)}
    with af.create_run(lab.with_name("run"), lab) as run:
        assert run.add(table(100, **texts)) == 100
    for name in ("注釈 0", "注釈 17"):
        assert shown(lab.with_name("run"), name) == texts[name]


class Counted(str):
    """A name that counts how often it is compared with another one."""

    __slots__ = ()
    __hash__ = str.__hash__
    times = 0

    def __eq__(self, other: object) -> bool:
        Counted.times += 1
        return str(self) == other


def test_the_work_on_a_table_grows_with_its_columns_and_not_with_their_square(lab: Path) -> None:
    frame = table(3)
    names = [*frame.columns, *(f"u_{k:04d}" for k in range(2000))]
    rows = [[*row, *map(str, range(2000))] for row in frame.itertuples(index=False)]
    with af.create_run(lab.with_name("run"), lab) as run:
        read = Table("", tuple(map(Counted, names)), rows, ["row 0", "row 1", "row 2"])
        added = ResultTable.added(run.campaign, read, Reading())
        assert added.warnings(run.campaign) == []
        labels = added.labels(run.campaign)
    assert [len(one) for one in labels] == [2000] * 3
    assert labels[2]["u_1999"] == "1999"
    assert Counted.times < 40 * len(names)


def test_a_run_folder_with_a_line_of_more_than_ten_megabytes_can_be_read(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    large = {str(number): {"note": "x" * 6_000_000} for number in (0, 1)}
    appended(tmp_path / "run", Event("result", {"of": ["labels", "0"], "value": large}, {}))
    for _ in range(2):
        with FolderStore.open(tmp_path / "run", write=True) as store:
            assert store.warnings == ()
            assert labels_of(store, np.arange(2)) == {"note": ["x" * 6_000_000] * 2}
            store.commit(batch(2, 1))


def test_later_labels_add_to_earlier_ones_and_only_what_is_new_is_written() -> None:
    store = MemoryStore(SCHEMA)
    rows = [{"a": str(k), "b": "x" * 1000} for k in range(300)]
    for of, value in new_labels(store, range(300), rows).items():
        assert len(json.dumps(value)) < 1_000_000
        store.remember(of, value)
    assert labels_of(store, np.arange(300)) == {name: [row[name] for row in rows] for name in "ab"}
    assert new_labels(store, range(300), rows) == {}
    new = new_labels(store, [7, 299], [{"a": "seven", "b": "x" * 1000}, {"c": "new"}])
    assert [*new.values()] == [{"7": {"a": "seven"}}, {"299": {"c": "new"}}]
    for of, value in new.items():
        store.remember(of, value)
    assert labels_of(store, np.array([7, 299])) == {"a": ["seven", "299"], "b": ["x" * 1000] * 2, "c": ["", "new"]}


@pytest.mark.parametrize("text", [FORGED, f"{FORGED},{{}},[]]\n{FORGED}", ("activefail " * 80).strip()])
@pytest.mark.parametrize("place", ["label", "name"])
def test_a_cut_entry_whose_labels_look_like_entries_is_set_aside(lab: Path, text: str, place: str) -> None:
    folder = lab.with_name("run")
    with af.create_run(folder, lab) as run:
        run.add(table(3))
        more = table(5, **({text: "x"} if place == "name" else {"note": text}))
        run.add(more)
    assert shown(folder, text if place == "name" else "note")[-1] == ("x" if place == "name" else text)
    *_, at, end = entries(folder)
    (folder / "checkpoint.h5").unlink()
    data = (folder / "journal").read_bytes()
    for cut in (end - 1, end - 9, (at + end) // 2, at + 100):
        (folder / "journal").write_bytes(data[:cut])
        with af.open_run(folder) as reader:
            assert len(reader.simulations) == 8
        with af.open_run(folder, write=True) as run:
            assert "moved to journal.quarantine" in run.store.warnings[0]
            assert run.add(more) == 0
        assert (folder / "journal").read_bytes()[:at] == data[:at]


@pytest.mark.parametrize("way", ["add", "tell", "correct"])
def test_a_full_disk_leaves_no_row_without_its_labels(lab: Path, way: str) -> None:
    folder, notes = lab.with_name("run"), list("abcde")
    with af.create_run(folder, lab) as run:
        frame = table(5, note=notes) if way == "add" else run.ask(5).assign(g=-1.0, note=notes)
        if way == "correct":
            run.tell(frame.drop(columns="note"))
            frame["g"] = -2.0
        before, errors = run.simulations, []
        for room in range(100, 10_000, 200):
            limits = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, ((folder / "journal").stat().st_size + room, limits[1]))
            try:
                assert (run.add(frame) if way == "add" else run.tell(frame, correct=way == "correct")) == 5
                break
            except StoreError as error:
                errors.append(str(error))
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            assert run.simulations.equals(before)
        assert len(errors) > 1
        assert all("File too large" in error for error in errors)
        assert run.simulations["note"].tolist() == notes
    assert shown(folder, "note") == notes
