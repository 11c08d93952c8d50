"""Loads a user's function that a campaign file names, or refuses to: code in a run folder never runs."""

import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

from activefail.errors import InputError, description_of
from activefail.simulators.code_folder import SourceLoader, digest_of, file_of, import_from, sha256, sources_of, use
from activefail.visible import visible

SIMULATOR_KEY, COMMAND_KEY = "simulator.python", "simulator.command"
FEATURES_KEY = "classifier.features.python"
KERNEL_KEY, LIKELIHOOD_KEY = "classifier.kernel.python", "classifier.likelihood.python"
MODEL_KEY, CRITERION_KEY = "classifier.model.python", "acquisition.criterion.python"
"""The settings that name a user's functions; the record stores the digests of their sources under these keys."""

LEARNER_KEYS = KERNEL_KEY, LIKELIHOOD_KEY, MODEL_KEY
"""Those of them that train the classifier; what it learns also depends on custom features."""

_importing: set[str] = set()
"""The user's modules that are being imported; `_loading` guards it."""

_called: list[Path] = []
"""The folders of the functions that are being called, each by the one before it; `_loading` guards them."""

_loading = threading.RLock()
"""One module at a time: imports share the path, the current folder and the output of the process."""


def load_function(
    reference: str, code: Path | None, key: str, run: Path | None = None
) -> tuple[Callable[..., Any], str]:
    """The function and a digest of its module's code, "" if the module has no file.

    The module is searched in the folder of the user's code first, then on Python's path. Its imports are searched in
    the opposite order, so that no user module shadows a library. The digest also covers the modules that it imports
    from the folder, compiled ones too. Of a source it covers the syntax, without comments and docstrings.

    Args:
        reference: the function, as "module:function".
        code: folder of the user's code; None if no code may be run.
        key: setting that names the function, for messages.
        run: run folder, which may come from someone else: its code is run only if `code` lies in it.

    Raises:
        InputError: if the module or function does not exist, cannot be imported, or may not be run.
    """
    if code is None:
        raise not_permitted(key, reference)
    module_name, _, name = reference.partition(":")
    try:
        # Naming the run folder as --code, or a folder inside it, permits its code.
        module, digest = _load_module(module_name, code, None if run is None or lies_in(code, run) else run)
    except ModuleNotFoundError as error:
        file = code / Path(*module_name.split(".")).with_suffix(".py")
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
    except _ImportsItselfError:
        if _importing:
            raise
        raise InputError(
            f"{key}: {module_name} creates a run while it is imported. Put the function into a file of its own, or "
            'what creates the run under `if __name__ == "__main__":`.'
        ) from None
    except BaseException as error:  # a script that calls sys.exit must not end the program silently
        reason = visible(description_of(error))
        raise InputError(f"{key}: {module_name} cannot be imported: {reason}.") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise InputError(f"{key}: {module.__file__ or module_name} has no function {name!r}.")
    return _importing_from(code, function), digest


def _importing_from(code: Path, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose imports at run time are of its own folder, whatever was loaded since."""

    @wraps(function, updated=())
    def call(*args: Any, **kwargs: Any) -> Any:
        with _loading, _calling(code):
            use(code)
            return function(*args, **kwargs)

    return call


@contextmanager
def _calling(code: Path | None = None) -> Iterator[None]:
    """The context of a call of the user's, or of an import; a call around it has its own folder again afterwards."""
    _called.extend([code] if code else [])
    try:
        yield
    finally:
        if code:
            _called.pop()
        if _called:
            use(_called[-1])


def not_permitted(key: str, code: str) -> InputError:
    """The error where custom code, a function or a program, would run although its user has not named its folder."""
    return InputError(
        f"{key}: {code} is custom code. A run folder may come from someone else, so custom code runs only if you name "
        "its folder with --code, or code=FOLDER in Python."
    )


class _ImportsItselfError(Exception):
    """A module asks for a function of its own while it is imported."""


class _NeverRunError(Exception):
    """A module lies in a folder from which no code is run."""


def _load_module(name: str, code: Path, forbidden: Path | None) -> tuple[ModuleType, str]:
    """A module and the digest of its code: from the folder of the code if it is there, otherwise from Python's path.

    Raises:
        _NeverRunError: if it lies in the folder `forbidden`.
    """
    found = file_of(name, code)
    # A package is imported by its name, for the modules in it.
    file = found if found is not None and found.name.partition(".")[0] != "__init__" else None
    if file is not None and forbidden and lies_in(file, forbidden):
        raise _NeverRunError(file)
    sources = {} if found is None else sources_of(found, code)
    with _loading, _calling(), _not_twice(name), _current_folder_kept(), redirect_stdout(sys.stderr):
        import_from(code, sources)
        module = _module_from_path(name, forbidden) if file is None else _module_from_file(file, name)
    origin = Path(module.__file__) if module.__file__ else None
    if sources and found in (file, origin):
        return module, digest_of(sources, code)
    return module, sha256(origin.read_bytes()) if origin and origin.is_file() else ""


def digest_without_running(reference: str, code: Path) -> str:
    """The digest that `load_function` returns if it finds the module in the folder of the user's code.

    Returns:
        "" if the folder has no such module.
    """
    file = file_of(reference.partition(":")[0], code)
    return "" if file is None else digest_of(sources_of(file, code), code)


def _module_from_file(file: Path, name: str) -> ModuleType:
    """The module of a file; a source's under a name unique to the file: two campaigns may have modules of one name."""
    package, _, last = name.rpartition(".")
    # A compiled module knows its name.
    loader = None
    if file.suffix == ".py":
        last = f"activefail_custom_{sha256(str(file.resolve()).encode())[:12]}_{last}"
        loader = SourceLoader(".".join(filter(None, (package, last))), str(file))
    unique = ".".join(filter(None, (package, last)))
    spec = importlib.util.spec_from_file_location(unique, file, loader=loader)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # As an import does: dataclasses and numba look their module up there.
    sys.modules[unique] = module
    try:
        spec.loader.exec_module(module)
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
def _not_twice(name: str) -> Iterator[None]:
    """The context in which a module is imported.

    Raises:
        _ImportsItselfError: if it is being imported already.
    """
    if name in _importing:
        raise _ImportsItselfError
    _importing.add(name)
    try:
        yield
    finally:
        _importing.discard(name)


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
