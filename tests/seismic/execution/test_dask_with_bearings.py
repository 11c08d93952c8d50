"""Bearings and records on a Dask cluster."""

from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, record
from execution.test_dask import Cluster

from activefail.seismic.ida import simulations as ida_simulations
from activefail.seismic.ida.capacity import Answers
from activefail.seismic.ida.simulations import CampaignSubject


def test_a_stopped_analysis_under_records_continues_on_a_cluster_to_the_bytes_of_this_machine(
    shared: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "set").mkdir()
    for name in "abc":
        np.savetxt(tmp_path / "set" / f"{name}.txt", np.random.default_rng(ord(name)).normal(size=50))
    (tmp_path / "plate.py").write_text(
        "import os, pathlib\n\n"
        "def run(design):\n"
        "    with open(pathlib.Path(__file__).with_name(f'simulated-{os.getpid()}'), 'a') as file:\n"
        "        file.write('x')\n"
        "    return 'failure' if design['PGV'] > 1.0 + 0.1 * int(design['record']) else 'safe'\n"
    )
    (tmp_path / "plate.toml").write_text(
        'simulator = { python = "plate:run" }\n'
        "space = { record = { low = 0, high = 3 }, PGV = { low = 0.1, high = 3 }, mass = { low = 1, high = 2 } }\n"
    )
    (tmp_path / "mass.toml").write_text("mass = 1.5\n")
    monkeypatch.chdir(tmp_path)
    words = ("ida", "--records", "set", "--unit", "m/s2", "--dt", "0.01", "--bearing", "mass.toml")
    words = (*words, "--simulator", "plate.toml", "--out")
    assert activefail(*words, "whole", "--workers", "1").code == 0
    monkeypatch.setattr(ida_simulations, "_PART", 10)
    here, parts = CampaignSubject.simulate, iter(range(2))

    def stopping(self: CampaignSubject, *about) -> Answers:
        if len(about[-1]) == 10 and next(parts, None) is None:
            raise KeyboardInterrupt
        return here(self, *about)

    with monkeypatch.context() as patched:
        patched.setattr(CampaignSubject, "simulate", stopping)
        assert activefail(*words, "stopped", "--workers", "1").code == 130
    for path in tmp_path.glob("simulated-*"):
        path.unlink()
    continued = activefail(*words, "stopped", "--executor", "dask", "--scheduler", shared.address)
    assert continued.code == 0, continued.err
    for name in ("ida.json", "ida.csv", next((tmp_path / "whole").glob("simulations-*.json")).name):
        assert (tmp_path / "stopped" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    # Ten levels and five bisections for each record, without the two parts that were kept.
    assert sum(len(path.read_text()) for path in tmp_path.glob("simulated-*")) == 3 * 15 - 20


def test_workers_as_dask_starts_them_simulate_bearings(alone: Cluster, tmp_path: Path) -> None:
    # Beside a nanny a worker is a daemon, which Python refuses to have children.
    alone.add("one", "--nanny")
    (tmp_path / "bearing.toml").write_text("seed = 2\nsampling = { initial = 20, budget = 24, batch = 4 }")
    dask = ("--executor", "dask", "--scheduler", alone.address)
    result = activefail("run", tmp_path / "bearing.toml", "--out", tmp_path / "run", *dask)
    assert result.code == 0, result.err
    assert activefail("run", tmp_path / "bearing.toml", "--out", tmp_path / "here").code == 0
    assert record(tmp_path / "run") == record(tmp_path / "here")
