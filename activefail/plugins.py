"""Plug-ins: packages that bring commands, analyses, simulators, features and kinds of questions.

A plug-in is a module whose attributes in capitals are dictionaries of what it brings. Values of the form
"module:name" are imported when they are used, so that a plug-in costs nothing before.
"""

from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from types import ModuleType
from typing import Any

GROUP = "activefail.plugins"
"""The group of entry points under which packages name their plug-ins."""

_SHIPPED = "activefail.seismic"


@cache
def plugins() -> tuple[ModuleType, ...]:
    """The plug-ins that are there: first the shipped one, also if the package was not installed."""
    named = dict.fromkeys([_SHIPPED, *(one.value for one in entry_points(group=GROUP))])
    return tuple(import_module(name) for name in named if name != _SHIPPED or find_spec(name) is not None)


def brought(what: str) -> dict[str, Any]:
    """What all plug-ins bring of a kind, by name: `brought("features")`."""
    found = {name: value for one in plugins() for name, value in getattr(one, what.upper(), {}).items()}
    return {name: _loaded(value) if isinstance(value, str) else value for name, value in found.items()}


@cache
def _loaded(reference: str) -> Any:
    module, _, name = reference.partition(":")
    return getattr(import_module(module), name)
