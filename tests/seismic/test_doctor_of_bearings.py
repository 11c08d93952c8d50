"""What `activefail doctor` says of the simulator of bearings."""

import importlib.metadata
import json

import numpy as np
import pytest
from commandline import activefail
from test_doctor import lines

from activefail.seismic import bearing


def test_the_kernels_and_every_extra_for_users_are_named_and_the_simulator_passes_its_test() -> None:
    result = activefail("doctor")
    assert result.code == 0, result.out
    found = lines(result.out)
    assert "kernels" in found
    extras = {*importlib.metadata.metadata("activefail").get_all("Provides-Extra")} - {"dev", "docs"}
    assert extras <= found.keys()
    assert "the right outcomes" in found["simulator"]


def test_a_simulator_that_computes_something_else_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    simulate = bearing.simulate
    monkeypatch.setattr(bearing, "simulate", lambda X: simulate(np.flip(X, axis=0)))
    result = activefail("doctor")
    assert result.code == 1
    found = lines(result.out)
    assert found["simulator"] == "fails: SelfTestError: the outcomes of two bearings are [0, 2], not [2, 0]"
    # What comes after it is tested too.
    assert "learned" in found["campaign"]
    as_json = activefail("doctor", "--json")
    assert as_json.code == 1
    shown = json.loads(as_json.out)
    assert shown["works"] is False
    assert [one["title"] for one in shown["findings"] if one["is_fault"]] == ["simulator"]
    assert [one["title"] for one in shown["findings"]] == list(found)
