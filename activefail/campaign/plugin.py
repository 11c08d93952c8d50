"""A function that a campaign's file names: found, loaded, and its source told apart from others."""

import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from activefail.errors import InputError


def load_function(reference: str, folders: Iterable[Path], key: str) -> tuple[Callable[..., Any], str]:
    """The function "module:function" and the SHA-256 of its module's source, "" when that is no file.

    The module is looked for in the folders, in their order, then where Python looks for modules.

    Args:
        reference: of the function.
        folders: that are looked in first.
        key: of the settings that names it, for messages.

    Raises:
        InputError: if there is no such module or function in it, or the module cannot be imported.
    """
    module_name, _, name = reference.partition(":")
    relative = Path(*module_name.split("."))
    candidates = [folder / relative.with_suffix(".py") for folder in folders]
    path = next((candidate for candidate in candidates if candidate.is_file()), None)
    try:
        module = _module_of(path, module_name) if path else importlib.import_module(module_name)
    except ModuleNotFoundError as missing:
        if path is None and missing.name and f"{module_name}.".startswith(f"{missing.name}."):
            looked = ", ".join(str(candidate) for candidate in candidates)
            raise InputError(f"{key}: there is no module {module_name!r}; looked for {looked}.") from None
        raise InputError(f"{key}: {module_name} cannot be imported: {missing}.") from missing
    except Exception as error:
        raise InputError(f"{key}: {module_name} cannot be imported: {type(error).__name__}: {error}.") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise InputError(f"{key}: {module.__file__ or module_name} has no function {name!r}.")
    source = Path(module.__file__) if module.__file__ else None
    return function, hashlib.sha256(source.read_bytes()).hexdigest() if source and source.is_file() else ""


def _module_of(path: Path, name: str) -> ModuleType:
    """The module of a file, under a name of its own: two campaigns may each have a module of one name."""
    unique = f"activefail_own_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}_{name.replace('.', '_')}"
    spec = importlib.util.spec_from_file_location(unique, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # As an import does: what looks itself up there (dataclasses, numba) must find it.
    sys.modules[unique] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[unique]
        raise
    return module
