"""One thread decides all numbers, whatever the caller's threads are: the tests' own processes have one anyway."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

import activefail as af
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.boundary_gp import SiteStrategy
from activefail.learning.model.saved import SavedLatent

CAMPAIGN = """
simulator = {{ python = "ring:run"{margins} }}
sampling = {{ initial = 16, budget = 24, batch = 4 }}
classifier.features = "design"
[space]
x = {{ low = -2, high = 2 }}
y = {{ low = -2, high = 2 }}
"""


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    with threadpool_limits(2):
        yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("margins", ["", ', margins = ["g"]'])
def test_each_method_of_a_run_learns_and_predicts_with_one_thread(
    margins: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tell = "return d['x'] ** 2 + d['y'] ** 2 - 1" if margins else "return 'ab'[d['x'] ** 2 + d['y'] ** 2 < 1]"
    (tmp_path / "ring.py").write_text(f"def run(d):\n    {tell}\n")
    text = CAMPAIGN.format(margins=margins if margins else ', outcomes = ["a", "b"]')
    (tmp_path / "ring.toml").write_text(text)
    seen: list[int] = []

    def counted(predict: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object) -> object:
            blas = [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]
            seen.append(max([torch.get_num_threads(), *blas]))
            return predict(*arguments)

        return call

    # What simulates is not what learns: a thread of this process does as well as another process.
    monkeypatch.setattr("activefail.execution.local.ProcessExecutor", lambda *_: ThreadExecutor(1))
    monkeypatch.setattr(SiteStrategy, "seen", counted(SiteStrategy.seen))
    monkeypatch.setattr(SavedLatent, "moments", counted(SavedLatent.moments))
    with af.create_run(tmp_path / "run", tmp_path / "ring.toml", code=tmp_path) as run:
        methods = [
            lambda: run.take(progress=False, workers=1),
            lambda: run.predict({"x": np.zeros(3), "y": np.linspace(0.0, 2.0, 3)}),
            lambda: run.verify(10),
            lambda: run.probability(10),
            lambda: run.fragility(against="x"),
        ]
        for method in methods:
            seen.clear()
            method()
            assert set(seen) == {1}, method
        assert torch.get_num_threads() == 2
