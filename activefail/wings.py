"""The wings: packages for one field, without which the core works.

A wing is a package with a module `commands`, whose `COMMANDS` are added to those of the core: functions, with the words
of an example each. Installed packages name theirs in the entry-point group `activefail.plugins`.
"""

from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec

_SHIPPED = ("activefail.seismic",)
"""Also found in a source tree, which has no metadata or old one."""


def commands() -> dict[Callable[..., None], str]:
    """The commands of the wings that are there, with the words of an example each."""
    found: dict[Callable[..., None], str] = {}
    for name in dict.fromkeys((*_SHIPPED, *(one.value for one in entry_points(group="activefail.plugins")))):
        if find_spec(name) is not None:
            found |= import_module(f"{name}.commands").COMMANDS
    return found
