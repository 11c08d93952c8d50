"""The example notebook runs as it is in the documentation."""

from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from patience import PATIENCE

PAGE = Path(__file__).parents[2] / "docs" / "elsewhere.ipynb"


def run_notebook(notebook: Any, place: Path) -> list[Any]:
    """The cells of code with their outputs, after a kernel has executed all cells in order in a folder."""
    client = NotebookClient(notebook, timeout=PATIENCE, resources={"metadata": {"path": str(place)}})
    with pytest.MonkeyPatch.context() as patch:
        # Kernels write a history and sockets, by default into the home.
        for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR"):
            patch.setenv(name, str(place / name))
        client.execute()
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


TAKE = """
import activefail
from pathlib import Path
Path("plate.py").write_text("def run(d):\\n    return 'failure' if d['x'] + d['y'] > 1.3 else 'safe'\\n")
settings = {"simulator": {"python": "plate:run"}, "sampling": {"initial": 8, "budget": 12, "batch": 4}}
space = {"x": {"low": 0, "high": 1}, "y": {"low": 0, "high": 1}}
with activefail.create_run("run", settings | {"space": space}, code=".", remember=False) as run:
    taken = run.take(workers=1)
"""


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """The cells of the page after an execution, and after them one more in the same kernel: a kernel starts slowly."""
    notebook = nbformat.read(PAGE, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(TAKE))
    return run_notebook(notebook, tmp_path_factory.mktemp("notebook"))


def output(cell: Any, kind: str) -> str:
    """What a cell shows, in one format."""
    (shown,) = [data[kind] for one in cell.outputs if kind in (data := one.get("data", {}))]
    return str(shown)


def cell_with(cells: list[Any], text: str) -> Any:
    (cell,) = [cell for cell in cells if text in cell.source]
    return cell


def test_the_notebook_runs_and_shows_what_its_text_says(executed: list[Any]) -> None:
    assert output(cell_with(executed, "run.in_flight"), "text/html").count("<tr") == 3
    counts = output(cell_with(executed, "run.drop"), "text/plain")
    assert "'in_flight': 0" in counts
    assert output(cell_with(executed, "run.add"), "text/plain") == "2"
    state = output(cell_with(executed, "while"), "text/html")
    assert "30 of 30 simulations" in state
    assert "in flight" not in state
    assert output(cell_with(executed, "contourf"), "image/png")
    assert "'load'" in output(cell_with(executed, "PosteriorStandardDeviation"), "text/plain")


def test_the_notebook_is_stored_without_outputs() -> None:
    stored = nbformat.read(PAGE, as_version=4)
    nbformat.validate(stored)
    for cell in stored.cells:
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None)


def test_a_notebook_shows_the_progress_of_a_campaign_as_a_bar(executed: list[Any]) -> None:
    (shown,) = cell_with(executed, "run.take").outputs
    assert '<progress value="12" max="12"></progress> 12/12' in shown["data"]["text/html"]
    assert "seeking    the boundary of failure" in shown["data"]["text/html"]
    assert "iteration 1 | " in shown["data"]["text/html"]
