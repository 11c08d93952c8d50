"""`make` installs with the CPU build of torch where the index has one, and with the default build elsewhere."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[1]

# A build backend inside the project, so that nothing is fetched but what the index of the test has.
BACKEND = """
from zipfile import ZipFile

def build_editable(folder, config_settings=None, metadata_directory=None):
    name, info = "activefail-0-py3-none-any.whl", "activefail-0.dist-info"
    with ZipFile(f"{folder}/{name}", "w") as wheel:
        metadata = "Metadata-Version: 2.1\\nName: activefail\\nVersion: 0\\nRequires-Dist: torch\\nProvides-Extra: dev\\n"
        wheel.writestr(f"{info}/METADATA", metadata)
        wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\\nGenerator: test\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n")
        wheel.writestr(f"{info}/RECORD", "")
    return name
"""
PROJECT = """
[build-system]
requires = []
build-backend = "backend"
backend-path = ["."]
"""


def stub(folder: Path, version: str) -> str:
    """An empty wheel of torch; its file name."""
    name, info = f"torch-{version}-py3-none-any.whl", f"torch-{version}.dist-info"
    with ZipFile(folder / name, "w") as wheel:
        wheel.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: torch\nVersion: {version}\n")
        wheel.writestr(
            f"{info}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        wheel.writestr(f"{info}/RECORD", "")
    return name


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a CPU build of its own")
@pytest.mark.parametrize(
    ("offered", "taken", "large"),
    [(["2.13.0", "2.14.0"], "2.13.0", True), (["2.13.0", "2.13.0+cpu", "2.14.0"], "2.13.0+cpu", False)],
    ids=["default index", "index with a CPU build"],
)
def test_make_installs_from_any_index_and_announces_the_large_build(
    offered: list[str], taken: str, large: bool, tmp_path: Path
) -> None:
    for name in ("Makefile", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "pyproject.toml").write_text(PROJECT)
    (tmp_path / "backend.py").write_text(BACKEND)
    index = tmp_path / "simple" / "torch"
    index.mkdir(parents=True)
    wheels = [stub(index, version) for version in offered]
    (index / "index.html").write_text("".join(f'<a href="{name.replace("+", "%2B")}">{name}</a>\n' for name in wheels))
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "MAKE"))}
    environment |= {"PIP_CONFIG_FILE": os.devnull, "PIP_INDEX_URL": index.parent.as_uri(), "PIP_NO_CACHE_DIR": "1"}
    command = ["make", f"PYTHON={sys.executable}", ".venv/.installed"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [path.name for path in (tmp_path / ".venv").rglob("torch-*")] == [f"torch-{taken}.dist-info"]
    said = [line for line in done.stdout.splitlines() if "the default build is coming, several GB" in line]
    assert len(said) == large
