"""A function that a campaign's file names: found, loaded, and its source told apart from others."""

import ast
import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from activefail.errors import InputError
from activefail.visible import visible

SIMULATOR_KEY = "simulator.python"
FEATURES_KEY = "classifier.features.python"
"""The keys of the settings that name functions of a user's own, and of their sources' digests in a record."""

_OWN = "activefail_own_"
"""What the names of a user's own modules begin with."""


def load_function(
    reference: str, code: Path | None, key: str, run: Path | None = None
) -> tuple[Callable[..., Any], str]:
    """The function "module:function" and the SHA-256 of its module's source, "" when that is no file.

    The module is looked for in the folder of the user's own code, then where Python looks for modules, and so is what
    it imports, in the other order: nothing of the user's hides a library. The digest is also over the modules of the
    folder that it imports.

    Args:
        reference: of the function.
        code: folder of the user's own code; None if none may be run.
        key: of the settings that names it, for messages.
        run: run folder, in which no code is looked for, as it may come from someone else; unless `code` lies in it.

    Raises:
        InputError: if there is no such module or function in it, the module cannot be imported, or it may not be run.
    """
    if code is None:
        raise InputError(
            f"{key}: {reference} is code of the campaign's own. A run folder may come from someone else, so that such "
            f"code is run only where its folder is named: --code FOLDER."
        )
    module_name, _, name = reference.partition(":")
    path = code / Path(*module_name.split(".")).with_suffix(".py")
    # Who names the run folder, or one in it, wants its code.
    never = None if run is None or _lies_in(code, run) else run
    try:
        if path.is_file():
            if never and _lies_in(path, never):
                raise _NeverRunError(path)
            sources = _sources(path, code)
            look_beside(code, sources)
            with _in_this_folder():
                module = _module_of(path, module_name)
            digest = _digest(sources, code)
        else:
            package = path.with_suffix("") / "__init__.py"
            sources = _sources(package, code)
            look_beside(code, sources)  # no more in the folder of another campaign
            with _in_this_folder():
                module = _module_elsewhere(module_name, never)
            source = Path(module.__file__) if module.__file__ else None
            if source == package:
                digest = _digest(sources, code)
            else:
                digest = _sha256(source.read_bytes()) if source and source.is_file() else ""
    except ModuleNotFoundError as missing:
        if not path.is_file() and missing.name and f"{module_name}.".startswith(f"{missing.name}."):
            raise InputError(f"{key}: there is no module {module_name!r}; looked for {path}.") from None
        raise InputError(f"{key}: {module_name} cannot be imported: {visible(str(missing))}.") from missing
    except _NeverRunError as refused:
        raise InputError(
            f"{key}: {module_name} is {refused}, in the run folder, which may come from someone else and is not looked "
            f"in for code; name another folder, or that one itself where you trust it: --code FOLDER."
        ) from None
    except (Exception, SystemExit) as error:  # a script that ends itself must not end us, and in silence
        said = visible(f"{type(error).__name__}: {error}")
        raise InputError(f"{key}: {module_name} cannot be imported: {said}.") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise InputError(f"{key}: {module.__file__ or module_name} has no function {name!r}.")
    return function, digest


@contextmanager
def _in_this_folder() -> Iterator[None]:
    """Code that is run within leaves the current folder as it was: relative paths of the user's start from there."""
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


# --- where a module is found -------------------------------------------------------------------------------------


class _NeverRunError(Exception):
    """A module lies where no code is run from."""


def _lies_in(path: Path, folder: Path) -> bool:
    return path.absolute().is_relative_to(folder.absolute()) or path.resolve().is_relative_to(folder.resolve())


def _module_of(path: Path, name: str) -> ModuleType:
    """The module of a file, under a name of its own: two campaigns may each have a module of one name."""
    unique = f"{_OWN}{_sha256(str(path.resolve()).encode())[:12]}_{name.replace('.', '_')}"
    spec = importlib.util.spec_from_file_location(unique, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    # As an import does: what looks itself up there (dataclasses, numba) must find it.
    sys.modules[unique] = module
    try:
        # Not by its loader, which takes compiled code for that of a source that was changed in the same second.
        exec(compile(path.read_bytes(), path, "exec", dont_inherit=True), module.__dict__)
    except BaseException:
        del sys.modules[unique]
        raise
    return module


def _module_elsewhere(name: str, never: Path | None) -> ModuleType:
    """The module that Python itself finds under a name.

    Raises:
        _NeverRunError: if it, or a package that it is in, lies in a folder that no code is run from: Python may look
            in the current folder, too.
    """
    parts = name.split(".")
    for depth in range(1, len(parts) + 1):
        # Imports the packages around it, which were looked at before.
        spec = importlib.util.find_spec(".".join(parts[:depth]))
        places = [] if spec is None else [spec.origin or "", *(spec.submodule_search_locations or [])]
        for place in map(Path, filter(None, places)):
            if never and _lies_in(place, never):
                raise _NeverRunError(place)
    return importlib.import_module(name)


# --- modules beside it -------------------------------------------------------------------------------------------

_there_before: frozenset[str] = frozenset()
"""Modules that were imported before any of a user's own, activefail's among them: never forgotten."""

_looked_in: Path | None = None
"""The folder whose modules can be imported."""

_added = ""
"""That folder as it was added to Python's path; empty where Python looks there anyway."""

_imported: dict[Path, str] = {}
"""Digests of the sources of that folder when they were imported."""


def look_beside(code: Path, sources: dict[Path, str] | None = None) -> None:
    """Have the modules of a folder found by imports, after all others; those of the folder before it no more.

    One folder at a time, as Python knows modules by name alone: two campaigns may each have a helper of one name.

    Args:
        code: the folder.
        sources: that are about to be imported; where one was another when it was, all are imported anew.
    """
    global _looked_in, _added, _there_before
    changed = any(_imported.get(path, digest) != digest for path, digest in (sources or {}).items())
    if _looked_in != code or changed:
        _there_before = _there_before or frozenset(sys.modules)
        if _looked_in is not None:
            for name in list(_modules_in(_looked_in)):
                del sys.modules[name]
        if _added and _added in sys.path:
            sys.path.remove(_added)
        _imported.clear()
        # One that Python looks in anyway stays where it is, now and when another is looked in.
        _added = "" if str(code) in sys.path else str(code)
        if _added:
            # Last: a file of the user's that is called as a library is must not hide it from anyone else.
            sys.path.append(_added)
        _looked_in = code
    for path in (sources or {}).keys() - _imported.keys():
        # Python takes it for that of a source which was changed in the same second to one of the same length.
        with suppress(OSError):
            Path(importlib.util.cache_from_source(path)).unlink()
    _imported.update(sources or {})
    importlib.invalidate_caches()


def _modules_in(folder: Path) -> Iterator[str]:
    """Names of the modules that were imported from a folder, and of those within them."""
    for name in list(sys.modules):
        top = sys.modules.get(name.partition(".")[0])
        spec = getattr(top, "__spec__", None)
        if spec is None or spec.name in _there_before or spec.name.startswith(_OWN):
            continue
        place = next(iter(spec.submodule_search_locations or []), spec.origin)
        if place and Path(place).parent == folder:
            yield name


def _sources(path: Path, code: Path) -> dict[Path, str]:
    """Digests of a module's source and of those in the folder of the user's code that it imports, or these do."""
    found: dict[Path, str] = {}
    left = [path]
    while left:
        path = left.pop()
        if path not in found and path.is_file():
            text = path.read_bytes()
            found[path] = _sha256(text)
            for name in _names_imported(text, path.parent.relative_to(code).parts):
                place = code.joinpath(*name.split("."))
                left += [place.with_suffix(".py"), place / "__init__.py"]
    return found


def _names_imported(text: bytes, package: tuple[str, ...]) -> set[str]:
    """Full names of what a source in a package imports: modules, the packages around them, and what may be either."""
    names: set[str] = set()
    # Its import says what is wrong with it.
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        for node in ast.walk(ast.parse(text)):
            match node:
                case ast.Import(names=aliases):
                    names.update(alias.name for alias in aliases)
                case ast.ImportFrom(module=module, names=aliases, level=level):
                    around = package[: len(package) + 1 - level] if level else ()
                    names.update(".".join(filter(None, (*around, module, alias.name))) for alias in aliases)
    return {".".join(name.split(".")[:depth]) for name in names for depth in range(1, name.count(".") + 2)}


def _digest(sources: dict[Path, str], code: Path) -> str:
    """One digest of sources: that of a single one, so that a module without others has its own."""
    if len(sources) == 1:
        return next(iter(sources.values()))
    return _sha256("".join(sorted(f"{path.relative_to(code)} {digest}\n" for path, digest in sources.items())).encode())


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
