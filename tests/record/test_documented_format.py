"""docs/reference/run-folder.md describes the files exactly: its own reader, which knows only the page, reads them."""

import ast
import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from activefail.record.hdf5 import encode
from activefail.record.segment import Segment, decode_segment, encode_segment
from commandline import activefail

from activefail.record import segment as segment_module
from activefail.record.batch import ACTIVE, COLUMNS, INITIAL, Batch, Schema, answers_of
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import EXECUTION_CAUSES, Results

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "run-folder.md").read_text(encoding="utf-8")
OLD = ROOT / "tests" / "old_runs"
SCHEMA = Schema(("radius", "μ"), ("none", "failure"), ("", "uplift"), ("drift",))
SETTINGS = 'seed = 1\r\nname = "Lager Süd"\n'

CAMPAIGN = """
seed = 5
[sampling]
initial = 62
budget = 65
batch = 1
asynchronous = true
[validation]
size = 20
"""


@pytest.fixture(scope="module")
def reader():
    """The reader on the page."""
    (source,) = re.findall(r"^```python\n(import hashlib.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    imported = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names])
    }
    assert imported == {"hashlib", "io", "json", "re", "pathlib", "urllib", "h5py", "numpy"}
    names: dict[str, object] = {}
    exec(compile(source, "run-folder.md", "exec"), names)
    return SimpleNamespace(**names)


@pytest.fixture(scope="module")
def new_run(tmp_path_factory):
    """A run folder of the present program, with merged segments, states, designs in flight and sets."""
    place = tmp_path_factory.mktemp("new")
    (place / "campaign.toml").write_text(CAMPAIGN)
    result = activefail("run", place / "campaign.toml", "--out", place / "run", "--workers", "1")
    assert result.code == 0, result.err
    return place / "run"


@pytest.fixture(
    params=[
        "new",
        *(f"{state}/{name}" for state in ("finished", "interrupted") for name in ("paper", "bearing", "custom")),
    ]
)
def run(request, tmp_path):
    """A run folder, of the present version and of older ones."""
    old = request.getfixturevalue("new_run") if request.param == "new" else OLD / request.param
    return Path(shutil.copytree(old, tmp_path / "run"))


def batch(n, seed):
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 2, (2, n)).astype(np.int8)
    margins = np.where(rng.random((n, 1)) < 0.5, np.nan, rng.random((n, 1)))
    origin = np.full(n, INITIAL if seed == 0 else ACTIVE, dtype=np.int8)
    return Batch(seed, rng.normal(size=(n, 2)), origin, Results(codes[0], codes[1], margins, rng.random(n)))


def same(batches, store):
    """Whether the page's reader and the program see the same batches, bit for bit."""
    expected = [
        {"iteration": one.iteration, "designs": one.designs, "origin": one.origin, **answers_of(one.results)}
        for one in store.batches
    ]
    assert len(batches) == len(expected)
    for one, other in zip(batches, expected, strict=True):
        assert one.keys() == other.keys()
        for name in COLUMNS:
            assert (one[name].dtype, one[name].tobytes()) == (other[name].dtype, other[name].tobytes()), name
    return True


def test_the_page_names_the_columns_and_causes_of_the_program(reader):
    assert reader.COLUMNS == COLUMNS
    assert reader.EXECUTION_CAUSES == EXECUTION_CAUSES
    for code, name in EXECUTION_CAUSES.items():
        assert f"| −{-code} | `{name}` |" in PAGE


def test_the_pages_reader_gets_the_designs_and_outcomes_that_export_writes(reader, run, tmp_path):
    schema, batches, chain = reader.read_record(run)
    result = activefail("export", run, "--csv", tmp_path / "simulations.csv")
    assert (result.code, result.err) == (0, "")
    with (tmp_path / "simulations.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    column = {name: np.concatenate([one[name] for one in batches]) for name in COLUMNS}
    assert len(column["designs"]) == len(table) == max(chain)
    for place, name in enumerate(schema["variables"]):
        assert column["designs"][:, place].tolist() == [float(row[name]) for row in table]
    for place, name in enumerate(schema["margins"]):
        written = [float(row[name] or "nan") for row in table]
        assert np.array_equal(column["margins"][:, place], written, equal_nan=True)
    names = [*schema["outcomes"], "numerical_failure"]  # −1 is the last one
    assert [names[code] for code in column["outcome"].tolist()] == [row["outcome"] for row in table]
    causes = dict(enumerate(schema["causes"])) | reader.EXECUTION_CAUSES
    assert [causes[code] for code in column["cause"].tolist()] == [row["cause"] for row in table]
    assert [one["iteration"] for one in batches for _ in one["origin"]] == [int(row["iteration"]) for row in table]


def test_the_pages_reader_reads_every_state_and_set(reader, run):
    schema, batches, chain = reader.read_record(run)
    states = sorted((run / "state").iterdir())
    assert 1 <= len(states) <= 3
    for path in states:
        state = reader.read_state(path, chain)
        through = int(path.stem)
        answered = sum(int((one["outcome"] >= 0).sum()) for one in batches if one["iteration"] <= through)
        for outcome in schema["outcomes"][1:]:
            assert state[f"{outcome}/site_linear"].shape == state[f"{outcome}/site_precision"].shape == (answered,)
        assert all(
            f"`{name.replace(name.split('/')[0], '<outcome>')}`" in PAGE or f"`{name}`" in PAGE for name in state
        )
    for path in sorted((run / "sets").iterdir()) if (run / "sets").exists() else []:
        columns = reader.read_set(path, (run / "campaign.toml").read_bytes())
        assert columns["designs"].shape == (20, len(schema["variables"]))


def test_the_new_run_folder_has_all_that_the_page_describes(reader, new_run):
    assert {path.name for path in new_run.iterdir()} >= {"campaign.toml", "segments", "state", "sets", ".lock"}
    assert (new_run / ".lock").read_bytes() == b""
    assert [path.name for path in (new_run / "sets").iterdir()] == ["validation-0.h5"]
    sizes = [len(reader.read_segment(path)["batches"]) for path in (new_run / "segments").iterdir()]
    assert max(sizes) >= 64, "nothing was merged"
    _, _, chain = reader.read_record(new_run)
    assert "flight/designs" in reader.read_state(max((new_run / "state").iterdir()), chain)


ELSEWHERE = """
seed = 5
sampling = { initial = 6, budget = 20, batch = 2 }
simulator = { elsewhere = true, margins = ["g"] }
[space]
load = { low = 1.0, high = 5.0 }
strength = { low = 2.0, high = 12.0 }
"""


@pytest.fixture(scope="module")
def asked_once(tmp_path_factory):
    """A run folder with designs in flight, results told in another order than asked for, dropped and given designs."""
    import activefail

    place = tmp_path_factory.mktemp("asked")

    def answered(designs):
        return designs.assign(g=designs["strength"] - 2.0 * designs["load"])

    (place / "lab.toml").write_text(ELSEWHERE)
    with activefail.create_run(place / "run", place / "lab.toml") as run:
        first = answered(run.ask(6))
        run.tell(first[3:])
        run.add({"load": 2.0, "strength": 3.0, "g": -1.0})
        run.drop(1)
        run.tell(first[:1])
        run.add(first[1:2])  # what was dropped was simulated after all
        run.tell(answered(run.ask(3))[1:2])
        run.drop(10)
    return place / "run"


@pytest.fixture
def asked_run(asked_once, tmp_path):
    """A copy of it."""
    return Path(shutil.copytree(asked_once, tmp_path / "run"))


def test_the_pages_reader_knows_ids_and_what_is_in_flight_from_asked_h5(reader, asked_run, tmp_path):
    schema, batches, chain = reader.read_record(asked_run)
    asked = reader.read_asked(asked_run / "asked.h5", batches, chain)
    assert activefail("export", asked_run, "--csv", tmp_path / "all.csv").code == 0
    assert activefail("ask", asked_run, "--in-flight", "--csv", tmp_path / "todo.csv").code == 0
    with (tmp_path / "all.csv").open(newline="") as file:
        exported = list(csv.DictReader(file))
    with (tmp_path / "todo.csv").open(newline="") as file:
        todo = list(csv.DictReader(file))
    assert reader.record_ids(asked, max(chain)) == [int(row["id"]) for row in exported] == [3, 4, 5, 6, 0, 7, 9]
    assert [row["origin"] for row in exported].count("given") == 2
    assert sum(int((batch["origin"] == 3).sum()) for batch in batches) == 2
    flight = (asked["row"] < 0) & (asked["dropped"] == 0)
    assert asked["id"][flight].tolist() == [int(row["id"]) for row in todo] == [2, 8]
    assert asked["designs"][flight].tolist() == [[float(row[name]) for name in schema["variables"]] for row in todo]
    assert asked["id"][asked["dropped"] == 1].tolist() == [1, 10]
    assert asked["learned"].tolist() == [-1] * 6 + [0] * 3
    assert asked["origin"].tolist() == [0] * 6 + [1] * 3


@pytest.fixture(scope="module")
def corrected_once(asked_once, tmp_path_factory):
    """A run folder in which a result was corrected twice, and a given one once."""
    import activefail

    corrected = Path(shutil.copytree(asked_once, tmp_path_factory.mktemp("corrected") / "run"))
    with activefail.open_run(corrected, write=True) as run:
        rows = run.simulations[["id", "g"]]
        run.learn()
        run.tell(rows[:1].assign(g=rows["g"] + 1.0), correct=True)
        run.tell(rows[:1].assign(g=-0.5), correct=True)
        run.tell(rows[rows["id"] == 6].assign(g=rows["g"] + 2.0), correct=True)
        run.learn()
    return corrected


@pytest.fixture
def corrected_run(corrected_once, tmp_path):
    """A copy of it."""
    return Path(shutil.copytree(corrected_once, tmp_path / "run"))


def test_the_pages_reader_applies_corrections(reader, corrected_run, tmp_path):
    schema, batches, chain = reader.read_record(corrected_run)
    corrections = reader.read_corrections(corrected_run / "corrections.h5", schema, chain)
    now, applied = reader.apply_corrections(batches, corrections)
    assert applied == [0, 0, 3]
    assert activefail("export", corrected_run, "--csv", tmp_path / "all.csv").code == 0
    with (tmp_path / "all.csv").open(newline="") as file:
        exported = [float(row["g"]) for row in csv.DictReader(file)]
    assert np.concatenate([batch["margins"] for batch in now])[:, 0].tolist() == exported
    assert exported[0] == -0.5
    assert np.concatenate([batch["margins"] for batch in batches])[0, 0] == corrections["former_margins"][0, 0]
    elsewhere, _ = reader.apply_corrections(batches[1:], corrections)
    assert [batch["margins"].tolist() for batch in elsewhere] == [batch["margins"].tolist() for batch in batches[1:]]
    with pytest.raises(reader.Damaged):
        reader.read_corrections(corrected_run / "corrections.h5", schema, chain | {0: "0" * 64})


def test_the_digest_of_corrections_in_a_state_is_that_of_the_page(reader, corrected_run):
    schema, _, chain = reader.read_record(corrected_run)
    corrections = reader.read_corrections(corrected_run / "corrections.h5", schema, chain)
    digest = reader.sha256(*(column.tobytes() for column in corrections.values()))
    path = max((corrected_run / "state").iterdir())
    with reader.body(path.read_bytes()) as file:
        assert reader.text(file.attrs["corrected"]) == digest
    with FolderStore.open(corrected_run, write=False) as store:
        assert store.corrections.entry(3) == f"3 {digest[:16]}"


def test_the_page_lists_every_dataset_of_corrections_h5_with_its_type(reader, corrected_run):
    part = PAGE[PAGE.index("## Corrections") : PAGE.index("## How the schema grows")]
    listed = {
        name: kind
        for names, kind in re.findall(r"^\| (`[\w`, ]+`) \| (\w+) \| \(", part, re.MULTILINE)
        for name in re.findall(r"\w+", names)
    }
    with reader.body((corrected_run / "corrections.h5").read_bytes()) as file:
        assert set(file.attrs) == {"schema_version", "campaign"}
        assert set(listed) == set(file)
        for name, dataset in file.items():
            assert listed[name] == "text" or np.dtype(listed[name]) == dataset.dtype, name


def test_the_page_lists_every_dataset_of_asked_h5_with_its_type(reader, asked_run):
    listed = dict(re.findall(r"^\| `(\w+)` \| (\w+) \| \(k", PAGE, re.MULTILINE))
    with reader.body((asked_run / "asked.h5").read_bytes()) as file:
        assert set(file.attrs) == {"schema_version", "campaign"}
        for name, dataset in file.items():
            assert np.dtype(listed[name]) == dataset.dtype, name


def test_the_pages_reader_refuses_asked_h5_of_another_campaign(reader, asked_run):
    _, batches, chain = reader.read_record(asked_run)
    with pytest.raises(reader.Damaged):
        reader.read_asked(asked_run / "asked.h5", batches, chain | {0: "0" * 64})


def test_the_page_lists_all_datasets_and_attributes_of_each_kind_of_file(reader, run):
    listed = set(re.findall(r"`([\w.<>]+)`", PAGE))
    for path in sorted(run.rglob("*.h5")):
        with reader.body(path.read_bytes()) as file:
            named = set(file.attrs) if path.parent.name == "state" else {*file, *file.attrs}
            assert {name for name in named if not name.startswith("provenance.")} <= listed


def test_where_a_merge_was_interrupted_the_overlap_is_read_once(reader, tmp_path):
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA, provenance={"numpy": "1"}) as store:
        for seed in range(63):
            store.commit(batch(1 + seed % 3, seed))
        before = {path.name: path.read_bytes() for path in (tmp_path / "run" / "segments").iterdir()}
        store.commit(batch(2, 63))
        for name, data in before.items():
            (tmp_path / "run" / "segments" / name).write_bytes(data)
        _, batches, chain = reader.read_record(tmp_path / "run")
        assert same(batches, store)
        assert chain == store.segments[0].chain
    assert len(list((tmp_path / "run" / "segments").iterdir())) == 64


def test_provenance_that_changed_is_json_by_design_in_a_merged_file(reader, tmp_path):
    folder = tmp_path / "run"
    for number, name in enumerate(("create", "open")):
        extra = {"settings": SETTINGS} if name == "create" else {"write": True}
        kept = {"numpy": str(number)}
        with getattr(FolderStore, name)(folder, schema=SCHEMA, provenance=kept, **extra) as store:
            for seed in range(32):
                store.commit(batch(1, seed))
    (path,) = (folder / "segments").iterdir()
    with reader.body(path.read_bytes()) as file:
        assert json.loads(reader.text(file.attrs["provenance.numpy"])) == {"0": "0", "32": "1"}


def test_the_pages_reader_refuses_what_the_program_refuses(reader, tmp_path):
    folder = tmp_path / "run"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        for seed in range(4):
            store.commit(batch(2, seed))
        first, second, third, last = sorted((folder / "segments").iterdir())
        kept = {path: path.read_bytes() for path in (first, second, third, last)}
        for change in (
            lambda: last.write_bytes(kept[last][:-1]),
            lambda: last.write_bytes(kept[last][:700] + bytes([kept[last][700] ^ 1]) + kept[last][701:]),
            lambda: last.write_bytes(kept[first]),  # under a wrong name
            last.unlink,
        ):
            change()
            _, batches, chain = reader.read_record(folder)
            assert (len(batches), max(chain)) == (3, 6)
            last.write_bytes(kept[last])
        other = Segment(SETTINGS, SCHEMA, 2, store.segments[1].before, (batch(2, 77),), {})
        for change, restored in (
            (second.unlink, second),
            (lambda: (folder / "campaign.toml").write_text("seed = 2\n"), folder / "campaign.toml"),
            (lambda: second.write_bytes(encode_segment(other)), second),
        ):
            whole = restored.read_bytes()
            change()
            with pytest.raises(reader.Refused):
                reader.read_record(folder)
            restored.write_bytes(whole)
        assert same(reader.read_record(folder)[1], store)


def grown(data, tmp_path):
    """A segment's file with a dataset and attributes that version 1 does not know."""
    import h5py

    (tmp_path / "plain.h5").write_bytes(data)
    with h5py.File(tmp_path / "plain.h5") as file:
        content = {name: file[name][()] for name in file if file[name].dtype.kind != "S"}
        texts = {name: bytes(file[name][0]).decode() for name in file if file[name].dtype.kind == "S"}
        attributes = {name: bytes(value).decode() for name, value in file.attrs.items()}
    n = len(content["outcome"])
    return encode(content | texts | {"rotations": np.zeros((n, 3))}, attributes | {"comment": "by a later version"})


def test_unknown_datasets_and_attributes_of_a_segment_are_ignored(reader, tmp_path):
    folder = tmp_path / "run"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        store.commit(batch(3, 0))
        store.commit(batch(2, 1))
    for path in (folder / "segments").iterdir():
        path.write_bytes(grown(path.read_bytes(), tmp_path))
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        assert store.warnings == ()
        assert len(store.batches) == 2
        assert same(reader.read_record(folder)[1], store)


def test_a_schema_with_another_key_needs_another_schema_version(reader, tmp_path, monkeypatch):
    segment = Segment(SETTINGS, SCHEMA, 0, segment_module.chain_start(SETTINGS, SCHEMA), (batch(2, 0),), {})

    class Wider(Schema):
        @property
        def text(self):
            return json.dumps(json.loads(super().text) | {"units": []}, separators=(",", ":"))

    wider = replace(segment, schema=Wider(**vars(SCHEMA)))
    with pytest.raises(segment_module.DamagedError):
        decode_segment(wider.name, encode_segment(wider))
    with monkeypatch.context() as patch:
        patch.setattr(segment_module, "SCHEMA_VERSION", 2)
        data = encode_segment(wider)
    with pytest.raises(segment_module.StoreError, match="schema version 2") as refused:
        decode_segment(wider.name, data)
    assert not isinstance(refused.value, segment_module.DamagedError)
    (tmp_path / wider.name).write_bytes(data)
    with pytest.raises(reader.Refused):
        reader.read_segment(tmp_path / wider.name)
