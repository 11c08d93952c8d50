"""A table of bearings through pipes."""

import io
import os
import sys
from pathlib import Path

import pytest
from commandline import CommandResult, activefail


@pytest.fixture
def piped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Runs a command in an empty folder with a text as standard input."""
    monkeypatch.chdir(tmp_path)

    def run(text: str | bytes, *words: str | Path) -> CommandResult:
        data = text.encode() if isinstance(text, str) else text
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
        result = activefail(*words)
        assert not os.path.lexists("-")
        return result

    return run


def test_a_table_is_simulated_through_pipes(tmp_path: Path, piped) -> None:
    designs = "T_b,mu,D_tot,h_sl_ratio,h_rim_ratio,p,k,T_p,A_p\n4.0,0.06,0.6,0.8,0.1,50,2e9,2.0,0.4\n"
    (tmp_path / "in.csv").write_text(designs)
    assert activefail("simulate", "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv").code == 0
    result = piped(designs, "simulate", "--csv", "-", "--out", "-")
    assert (result.code, result.out) == (0, (tmp_path / "out.csv").read_text())
    assert "1 designs in " in result.err
