"""`activefail doctor`: what it says of a sound installation, and of one that is not."""

import importlib.metadata
import json
import platform

import numpy as np
import pytest
from commandline import activefail

from activefail.__main__ import program
from activefail.cli import diagnosis


def lines(text: str) -> dict[str, str]:
    return {line.split()[0]: line.split(maxsplit=1)[1] for line in text.splitlines()}


def test_a_sound_installation_passes_and_extras_are_named() -> None:
    result = activefail("doctor")
    assert result.code == 0, result.out
    found = lines(result.out)
    assert {"cluster", "parquet", "sensitivity", "opensees"} <= found.keys()
    assert {"activefail", "libraries", "cores"} <= found.keys()
    assert "learned" in found["campaign"]
    assert "missing" not in found["libraries"]


def test_the_versions_are_printed_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "diagnosis", lambda: iter([diagnosis.Finding("campaign", "learned")]))
    result = activefail("doctor", "--json")
    assert (result.code, result.err) == (0, "")
    shown = json.loads(result.out)
    assert shown["works"] is True
    assert shown["versions"]["numpy"] == np.__version__
    assert shown["versions"]["python"] == platform.python_version()
    assert shown["findings"] == [{"title": "campaign", "text": "learned", "is_fault": False}]
    installed = importlib.metadata.version
    gone = importlib.metadata.PackageNotFoundError

    def without_torch(name: str) -> str:
        if name == "torch":
            raise gone(name)
        return installed(name)

    monkeypatch.setattr(importlib.metadata, "version", without_torch)
    assert json.loads(activefail("doctor", "--json").out)["versions"]["torch"] is None


def test_windows_is_sent_to_wsl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "win32")
    with pytest.raises(SystemExit, match="runs on Linux and macOS; on Windows, run it in WSL"):
        program()


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    version = importlib.metadata.version

    def without_arrow(name: str) -> str:
        if name == "pyarrow":
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(importlib.metadata, "version", without_arrow)
    parquet = diagnosis._extra("parquet", diagnosis._EXTRAS["parquet"])
    assert parquet.text == "missing (`activefail export --parquet`): pip install 'activefail[parquet]'"
    assert not parquet.is_fault
