"""What `activefail doctor` says of an installation: versions, cores, compiled kernels, a short self-test, extras."""

import importlib.metadata
import os
import platform
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail.errors import SelfTestError
from activefail.plugins import brought
from activefail.visible import visible

_LIBRARIES = ("numpy", "scipy", "torch", "gpytorch", "botorch", *brought("libraries"), "h5py")

_EXTRAS = {
    "cluster": "simulations on a Dask cluster",
    "parquet": "`activefail export --parquet`",
    "sensitivity": "`activefail sensitivity`",
    "opensees": "the campaigns frame and opensees",
}
"""Extras for users, and what each is for, beside those of plug-ins."""


@dataclass(frozen=True)
class Finding:
    """One line of the diagnosis.

    Attributes:
        title: what it is about.
        text: what was found.
        is_fault: whether activefail does not work because of it.
    """

    title: str
    text: str
    is_fault: bool = False


def diagnosis() -> Iterator[Finding]:
    """The findings, one by one; the self-tests come last and take about a second once the simulator is compiled."""
    yield Finding("activefail", f"{_version('activefail')}, Python {platform.python_version()}, {platform.platform()}")
    yield Finding("libraries", ", ".join(f"{name} {_version(name)}" for name in _LIBRARIES))
    yield _cores()
    for extra, purpose in {**_EXTRAS, **brought("extras")}.items():
        yield _extra(extra, purpose)
    for title, fact in brought("facts").items():
        yield Finding(title, fact())
    for title, test in {**brought("self_tests"), "campaign": _campaign}.items():
        yield _tested(title, test)


def versions() -> dict[str, str | None]:
    """Versions of activefail, Python and the libraries, by name; None for a missing one."""
    found = {name: _version(name) for name in ("activefail", *_LIBRARIES)}
    installed = {name: None if version == "missing" else version for name, version in found.items()}
    return {"python": platform.python_version(), **installed}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name) or "unknown"
    except importlib.metadata.PackageNotFoundError:
        return "missing"


def _cores() -> Finding:
    from threadpoolctl import threadpool_info

    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    threads = sorted({f"{pool['internal_api']} uses {pool['num_threads']}" for pool in threadpool_info()})
    return Finding("cores", f"{usable} usable of {os.cpu_count()}; threads: {', '.join(threads) or 'unknown'}")


def _extra(extra: str, purpose: str) -> Finding:
    """Whether the packages of an extra are installed."""
    requirements = (line for line in importlib.metadata.requires("activefail") or () if f"extra == '{extra}'" in line)
    names = [re.split(r"[^\w.-]", line.replace('"', "'"))[0] for line in requirements]
    missing = [name for name in names if _version(name) == "missing"]
    if missing:
        return Finding(extra, f"missing ({purpose}): pip install 'activefail[{extra}]'")
    return Finding(extra, f"installed ({purpose})")


def _tested(title: str, test: Callable[[], str]) -> Finding:
    began = time.perf_counter()
    try:
        text = test()
    except Exception as error:
        return Finding(title, f"fails: {type(error).__name__}: {visible(str(error))}", is_fault=True)
    return Finding(title, f"{text} ({time.perf_counter() - began:.1f} s)")


def _campaign() -> str:
    """Learn the unit circle from thirty points, in a run folder."""
    from activefail.run.opening import create_run

    side = {"low": -2.0, "high": 2.0}
    settings = {
        "simulator": {"elsewhere": True, "outcomes": ["inside", "outside"]},
        "space": {"x": side, "y": side},
        "sampling": {"initial": 20, "budget": 30, "batch": 10},
    }
    with (
        tempfile.TemporaryDirectory(prefix="activefail-") as folder,
        create_run(Path(folder) / "run", settings, remember=False) as run,
    ):
        while len(designs := run.ask(10)):
            outside = np.hypot(designs["x"], designs["y"]) > 1.0
            run.tell(designs.assign(outcome=np.where(outside, "outside", "inside")))
        predicted = run.predict({"x": [0.0, 1.9], "y": [0.0, 1.9]})["p_outside"].to_numpy()
    if not predicted[0] < 0.5 < predicted[1]:
        at_centre, far_away = predicted.tolist()
        raise SelfTestError(
            f"P(outside a circle) is {at_centre:.3g} at its centre and {far_away:.3g} far outside; the first must be "
            "below 0.5, the second above"
        )
    return "a circle is learned from thirty simulations in a run folder"
