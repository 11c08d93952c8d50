"""Plug-ins: packages that bring commands, analyses, simulators, features and kinds of questions.

A plug-in is a module whose attributes in capitals are dictionaries of what it brings, by name. Dictionaries and their
values may be references, "module:name", which are imported when they are used.
"""

import re
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
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
    named = dict.fromkeys([_SHIPPED, *(one.value for one in entry_points(group=GROUP))])
    return tuple(import_module(name) for name in named if name != _SHIPPED or find_spec(name) is not None)


def brought(what: str) -> dict[Any, Any]:
    """What all plug-ins bring of a kind, such as "features", or "commands" with the words of an example each."""
    found = [_loaded(getattr(one, what.upper(), {})) for one in plugins()]
    return {name: _loaded(value) for one in found for name, value in one.items()}


def _loaded(value: Any) -> Any:
    """What a reference names; anything else as it is."""
    if not (isinstance(value, str) and _REFERENCE.fullmatch(value)):
        return value
    module, _, name = value.partition(":")
    return getattr(import_module(module), name)
