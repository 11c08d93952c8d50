"""Keeps libraries from reading their settings in the current folder, which may come from someone else."""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any

NUMBA, MATPLOTLIB = "numba.core.config", "matplotlib"
"""The modules that read such settings when they are imported.

Numba's `.numba_config.yaml` names compiler options and a folder of kernels, which numba unpickles; `matplotlibrc` may
start LaTeX.
"""


def keep_out(name: str) -> None:
    """Have a module ignore the current folder; numba's also if it is already imported."""
    if name in sys.modules:
        _settle(sys.modules[name])
    else:
        sys.meta_path.insert(0, _Finder(name))


class _Finder:
    """Finds one module and has it executed in the root folder."""

    def __init__(self, name: str) -> None:
        self.name = name

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module, if it is this one."""
        spec = PathFinder.find_spec(name, path) if name == self.name else None
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(name, spec.origin)
        return spec


class _Loader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        with _root_folder():
            super().exec_module(module)
        _settle(module)


@contextmanager
def _root_folder() -> Iterator[None]:
    """A context whose current folder, which all threads share, is the root."""
    here = os.open(".", getattr(os, "O_PATH", os.O_RDONLY))
    try:
        os.chdir("/")
        yield
    finally:
        os.fchdir(here)
        os.close(here)


def _settle(module: Any) -> None:
    """Numba looks for its file again before each compilation."""
    if module.__name__ == NUMBA:
        module._config_fname = os.devnull
        module.reload_config()
