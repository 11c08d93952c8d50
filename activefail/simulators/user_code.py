"""Loads a function of the user's that a campaign file names, and the digest of its source."""

import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from activefail.errors import InputError, description_of
from activefail.simulators.code_folder import digest_of, import_from, sha256, sources_of
from activefail.visible import visible

SIMULATOR_KEY = "simulator.python"
FEATURES_KEY = "classifier.features.python"
"""The settings that name a user's functions; the record keeps the digests of their sources under the same keys."""


def load_function(
    reference: str, code: Path | None, key: str, run: Path | None = None
) -> tuple[Callable[..., Any], str]:
    """The function "module:function" and the SHA-256 of its module's source, "" if the module has no file.

    The module is searched in the folder of the user's code first, then where Python searches. What it imports is
    searched in the other order, so that no module of the user's hides a library. The digest covers the modules of the
    folder that it imports, too.

    Args:
        reference: of the function.
        code: folder of the user's code; None if none may be run.
        key: setting that names the function, for messages.
        run: run folder, which may come from someone else: no code in it is run, unless `code` lies in it.

    Raises:
        InputError: if there is no such module or function, the module cannot be imported, or it may not be run.
    """
    if code is None:
        raise InputError(
            f"{key}: {reference} is code of the campaign's own. A run folder may come from someone else, so that such "
            f"code is run only where its folder is named: --code FOLDER."
        )
    module_name, _, name = reference.partition(":")
    file = code / Path(*module_name.split(".")).with_suffix(".py")
    try:
        # Whoever names the run folder, or one in it, wants its code.
        module, digest = _load_module(module_name, file, code, None if run is None or _lies_in(code, run) else run)
    except ModuleNotFoundError as missing:
        if not file.is_file() and missing.name and f"{module_name}.".startswith(f"{missing.name}."):
            raise InputError(f"{key}: there is no module {module_name!r}; looked for {file}.") from None
        raise InputError(f"{key}: {module_name} cannot be imported: {visible(str(missing))}.") from missing
    except _NeverRunError as refused:
        raise InputError(
            f"{key}: {module_name} is {refused}, in the run folder, which may come from someone else. Code in run "
            f"folders is not run. Name another folder, or that one itself if you trust it: --code FOLDER."
        ) from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a script that ends itself must not end us, and in silence
        reason = visible(description_of(error))
        raise InputError(f"{key}: {module_name} cannot be imported: {reason}.") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise InputError(f"{key}: {module.__file__ or module_name} has no function {name!r}.")
    return function, digest


class _NeverRunError(Exception):
    """A module lies where no code is run from."""


def _load_module(name: str, file: Path, code: Path, never: Path | None) -> tuple[ModuleType, str]:
    """A module and the digest of its source: the file's if there is one, or else the one that Python finds.

    Raises:
        _NeverRunError: if it lies in the folder `never`.
    """
    package = file.with_suffix("") / "__init__.py"
    source = file if file.is_file() else package
    if source == file and never and _lies_in(file, never):
        raise _NeverRunError(file)
    sources = sources_of(source, code)
    import_from(code, sources)
    with _current_folder_kept():
        module = _module_of(file, name) if source == file else _module_that_python_finds(name, never)
    found = Path(module.__file__) if module.__file__ else None
    if source in (file, found):
        return module, digest_of(sources, code)
    return module, sha256(found.read_bytes()) if found and found.is_file() else ""


def _module_of(file: Path, name: str) -> ModuleType:
    """The module of a file, under a name that the file alone has: two campaigns may each have a module of one name."""
    unique = f"activefail_own_{sha256(str(file.resolve()).encode())[:12]}_{name.replace('.', '_')}"
    spec = importlib.util.spec_from_file_location(unique, file)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    # As an import does: what looks itself up there (dataclasses, numba) must find it.
    sys.modules[unique] = module
    try:
        # Not by its loader, which may use compiled code of a source that has changed in the same second.
        exec(compile(file.read_bytes(), file, "exec", dont_inherit=True), module.__dict__)
    except BaseException:
        del sys.modules[unique]
        raise
    return module


def _module_that_python_finds(name: str, never: Path | None) -> ModuleType:
    """The module that Python itself finds under a name.

    Raises:
        _NeverRunError: if it, or a package around it, lies in the folder `never`: Python may search the current folder.
    """
    parts = name.split(".")
    for depth in range(1, len(parts) + 1):
        # Imports the packages around it, which were checked before.
        spec = importlib.util.find_spec(".".join(parts[:depth]))
        places = [] if spec is None else [spec.origin or "", *(spec.submodule_search_locations or [])]
        for place in map(Path, filter(None, places)):
            if never and _lies_in(place, never):
                raise _NeverRunError(place)
    return importlib.import_module(name)


def _lies_in(path: Path, folder: Path) -> bool:
    return path.absolute().is_relative_to(folder.absolute()) or path.resolve().is_relative_to(folder.resolve())


@contextmanager
def _current_folder_kept() -> Iterator[None]:
    """Code that runs within leaves the current folder as it was: relative paths of the user's start from there."""
    try:
        here = os.getcwd()
    except OSError:  # it was removed
        here = None
    try:
        yield
    finally:
        if here is not None:
            with suppress(OSError):
                os.chdir(here)
