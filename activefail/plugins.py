"""Plug-ins: packages that bring commands, analyses, simulators, features and kinds of questions.

A plug-in is a module whose attributes in capitals are dictionaries of what it brings, by name. Dictionaries and their
values may be references, "module:name", which are imported when they are used.
"""

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

GROUP = "activefail.plugins"
"""The group of entry points under which packages name their plug-ins."""

_SHIPPED = "activefail.seismic"


_REFERENCE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


@cache
def plugins() -> tuple[ModuleType, ...]:
    """The plug-ins that are there: first the shipped one, also if the package was not installed."""
    # Imported here: a script that only imports activefail needs no plug-in.
    from importlib.metadata import entry_points

    named = dict.fromkeys([_SHIPPED, *(one.value for one in entry_points(group=GROUP))])
    return tuple(import_module(name) for name in named if name != _SHIPPED or find_spec(name) is not None)


class Brought(Mapping[Any, Any]):
    """What plug-ins bring of a kind, by name. A value that is a reference is imported when it is taken."""

    def __init__(self, values: Mapping[Any, Any]) -> None:
        self._values = values

    def __getitem__(self, name: Any) -> Any:
        return _loaded(self._values[name])

    def __iter__(self) -> Iterator[Any]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)


def brought(what: str) -> Brought:
    """What all plug-ins bring of a kind, such as "features", or "commands" with the words of an example each."""
    found = [_loaded(getattr(one, what.upper(), {})) for one in plugins()]
    return Brought({name: value for one in found for name, value in one.items()})


def _loaded(value: Any) -> Any:
    """What a reference names; anything else as it is."""
    if not (isinstance(value, str) and _REFERENCE.fullmatch(value)):
        return value
    module, _, name = value.partition(":")
    return getattr(import_module(module), name)


class _Alias:
    """Finds a package, or a plug-in's under another name, with its modules: the same objects under both names.

    Without a name it finds `activefail.NAME` for each name in the plug-ins' `PACKAGES`, once nothing else has.
    """

    def __init__(self, alias: str = "", package: str = "") -> None:
        self._alias, self._package = alias, package

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module of this name, if the package or a plug-in has it."""
        if self._alias:
            is_inside = name == self._alias or name.startswith(f"{self._alias}.")
            module = self._package + name.removeprefix(self._alias)
            return ModuleSpec(name, _Loader(module)) if is_inside and find_spec(module) is not None else None
        root, _, rest = name.partition(".")
        # To look for plug-ins is to look for this one.
        if root != __package__ or name == _SHIPPED or rest not in (packages := brought("packages")):
            return None
        # Before the finder of folders, which would load the package's modules again.
        sys.meta_path.insert(0, alias := _Alias(name, packages[rest]))
        return alias.find_spec(name)


class _Loader(Loader):
    """Loads a module that is, or will be, there under its own name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(self._name)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # The import system has replaced it by that of the alias.
        module.__spec__ = self._spec


def find_packages_of_plugins() -> None:
    """Have `import activefail.NAME` find the packages that plug-ins bring."""
    sys.meta_path.append(_Alias())
