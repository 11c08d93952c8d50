"""Loads a user's function that a campaign file names, with the digest of its source."""

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
KERNEL_KEY, LIKELIHOOD_KEY = "classifier.kernel.python", "classifier.likelihood.python"
MODEL_KEY, CRITERION_KEY = "classifier.model.python", "acquisition.criterion.python"
"""The settings that name a user's functions; the record stores the digests of their sources under these keys."""


def load_function(
    reference: str, code: Path | None, key: str, run: Path | None = None
) -> tuple[Callable[..., Any], str]:
    """The function and the SHA-256 of its module's source, "" if the module has no file.

    The module is searched in the folder of the user's code first, then on Python's path. Its imports are searched in
    the opposite order, so that no user module shadows a library. The digest also covers the modules that it imports
    from the folder.

    Args:
        reference: the function, as "module:function".
        code: folder of the user's code; None if no code may be run.
        key: setting that names the function, for messages.
        run: run folder, which may come from someone else: its code is run only if `code` lies in it.

    Raises:
        InputError: if the module or function does not exist, cannot be imported, or may not be run.
    """
    if code is None:
        raise InputError(
            f"{key}: {reference} is custom code. A run folder may come from someone else, so custom code runs only if "
            "you name its folder with --code."
        )
    module_name, _, name = reference.partition(":")
    file = _file_of(module_name, code)
    try:
        # Naming the run folder as --code, or a folder inside it, permits its code.
        module, digest = _load_module(module_name, file, code, None if run is None or lies_in(code, run) else run)
    except ModuleNotFoundError as error:
        if not file.is_file() and error.name and f"{module_name}.".startswith(f"{error.name}."):
            raise InputError(f"{key}: there is no module {module_name!r}; looked for {file}.") from None
        raise InputError(f"{key}: {module_name} cannot be imported: {visible(str(error))}.") from error
    except _NeverRunError as error:
        raise InputError(
            f"{key}: {module_name} is {error}. It lies in the run folder, which may come from someone else. Code in a "
            "run folder runs only if you name that folder with --code. Do this only if you trust the folder."
        ) from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a script that calls sys.exit must not end the program silently
        reason = visible(description_of(error))
        raise InputError(f"{key}: {module_name} cannot be imported: {reason}.") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise InputError(f"{key}: {module.__file__ or module_name} has no function {name!r}.")
    return function, digest


class _NeverRunError(Exception):
    """A module lies in a folder from which no code is run."""


def _load_module(name: str, file: Path, code: Path, forbidden: Path | None) -> tuple[ModuleType, str]:
    """A module and the digest of its source: from the file if it exists, otherwise from Python's path.

    Raises:
        _NeverRunError: if it lies in the folder `forbidden`.
    """
    source = _source_at(file)
    if source == file and forbidden and lies_in(file, forbidden):
        raise _NeverRunError(file)
    sources = sources_of(source, code)
    import_from(code, sources)
    with _current_folder_kept():
        module = _module_from_file(file, name) if source == file else _module_from_path(name, forbidden)
    origin = Path(module.__file__) if module.__file__ else None
    if source in (file, origin):
        return module, digest_of(sources, code)
    return module, sha256(origin.read_bytes()) if origin and origin.is_file() else ""


def digest_without_running(reference: str, code: Path) -> str:
    """The digest that `load_function` returns if it finds the module in the folder of the user's code.

    Returns:
        "" if the folder has no such module.
    """
    module_name = reference.partition(":")[0]
    sources = sources_of(_source_at(_file_of(module_name, code)), code)
    return digest_of(sources, code) if sources else ""


def _file_of(module_name: str, code: Path) -> Path:
    return code / Path(*module_name.split(".")).with_suffix(".py")


def _source_at(file: Path) -> Path:
    """The source of a module in the folder of the user's code: its file, or that of the package of its name."""
    return file if file.is_file() else file.with_suffix("") / "__init__.py"


def _module_from_file(file: Path, name: str) -> ModuleType:
    """The module of a file, under a name unique to the file: two campaigns may have modules of the same name."""
    unique = f"activefail_custom_{sha256(str(file.resolve()).encode())[:12]}_{name.replace('.', '_')}"
    spec = importlib.util.spec_from_file_location(unique, file)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    # As an import does: dataclasses and numba look their module up there.
    sys.modules[unique] = module
    try:
        # Its loader might reuse the bytecode of a source that changed within the same second.
        exec(compile(file.read_bytes(), file, "exec", dont_inherit=True), module.__dict__)
    except BaseException:
        del sys.modules[unique]
        raise
    return module


def _module_from_path(name: str, forbidden: Path | None) -> ModuleType:
    """The module that Python finds on its path.

    Raises:
        _NeverRunError: if it or a parent package lies in `forbidden`: Python may search the current folder.
    """
    parts = name.split(".")
    for depth in range(1, len(parts) + 1):
        # This imports the parent packages, which are already checked.
        spec = importlib.util.find_spec(".".join(parts[:depth]))
        locations = [] if spec is None else [spec.origin or "", *(spec.submodule_search_locations or [])]
        for location in map(Path, filter(None, locations)):
            if forbidden and lies_in(location, forbidden):
                raise _NeverRunError(location)
    return importlib.import_module(name)


def lies_in(path: Path, folder: Path) -> bool:
    """Whether a path is a folder or lies in it, by its name or with links followed."""
    return path.absolute().is_relative_to(folder.absolute()) or path.resolve().is_relative_to(folder.resolve())


@contextmanager
def _current_folder_kept() -> Iterator[None]:
    """Restore the current folder at the end of the context: the user's relative paths start from it."""
    try:
        current = os.getcwd()
    except OSError:  # the folder was removed
        current = None
    try:
        yield
    finally:
        if current is not None:
            with suppress(OSError):
                os.chdir(current)
