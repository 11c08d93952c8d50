"""A folder of the user's code: how its modules are imported, and one digest of their sources."""

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType


class _FolderFinder:
    """Finds the modules of one folder, after all others, and knows which of them it has found.

    It stands on `sys.meta_path` before Python's own finder. The folder is the last on `sys.path`, so that none of its
    modules hides a library. Processes that the user's code starts take `sys.path` over and find the modules, too.

    Attributes:
        folder: where it looks.
        sources: digests of the sources that were imported, or are about to be.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sources: dict[Path, str] = {}
        self._found: set[str] = set()
        # A folder that Python searches anyway keeps its place.
        self._added = str(folder) not in sys.path
        if self._added:
            sys.path.append(str(folder))
        sys.meta_path.insert(sys.meta_path.index(PathFinder), self)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module or package of that name, if it lies in the folder; Python itself finds what a package holds."""
        if path is None and (spec := PathFinder.find_spec(name)) is not None:
            place = next(iter(spec.submodule_search_locations or []), spec.origin)
            if place and Path(place).parent == self.folder:
                self._found.add(name)
                return spec
        return None

    def remove(self) -> None:
        """Take it from where Python looks, and forget the modules that it has found."""
        for name in list(sys.modules):
            if name.partition(".")[0] in self._found:
                del sys.modules[name]
        if self._added and str(self.folder) in sys.path:
            sys.path.remove(str(self.folder))
        sys.meta_path.remove(self)


def import_from(folder: Path, sources: Mapping[Path, str]) -> None:
    """Let imports find the modules of a folder, and no longer those of the folder before it.

    Python knows modules by name alone, and two campaigns may each have a helper of one name.

    Args:
        folder: of the user's code.
        sources: that are about to be imported; if one has changed since it was imported, all are imported again.
    """
    finder = next((finder for finder in sys.meta_path if isinstance(finder, _FolderFinder)), None)
    if finder is not None:
        changed = any(finder.sources.get(path, digest) != digest for path, digest in sources.items())
        if changed or finder.folder != folder:
            finder.remove()
            finder = None
    if finder is None:
        finder = _FolderFinder(folder)
    for path in sources.keys() - finder.sources.keys():
        # Python would use compiled code of a source that has changed in the same second and kept its length.
        with suppress(OSError):
            Path(importlib.util.cache_from_source(path)).unlink()
    finder.sources.update(sources)
    importlib.invalidate_caches()


# --- sources ------------------------------------------------------------------------------------------------------


def sources_of(path: Path, folder: Path) -> dict[Path, str]:
    """Digests of a source and of those in the folder that it imports, or these do; empty if there is no such file."""
    found: dict[Path, str] = {}
    left = [path]
    while left:
        path = left.pop()
        if path not in found and path.is_file():
            text = path.read_bytes()
            found[path] = sha256(text)
            for name in _names_imported(text, path.parent.relative_to(folder).parts):
                place = folder.joinpath(*name.split("."))
                left += [place.with_suffix(".py"), place / "__init__.py"]
    return found


def digest_of(sources: Mapping[Path, str], folder: Path) -> str:
    """One digest of sources in a folder; that of a single source is its own."""
    if len(sources) == 1:
        return next(iter(sources.values()))
    lines = sorted(f"{path.relative_to(folder)} {digest}\n" for path, digest in sources.items())
    return sha256("".join(lines).encode())


def sha256(content: bytes) -> str:
    """The SHA-256 of some bytes, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def _names_imported(text: bytes, package: tuple[str, ...]) -> set[str]:
    """Full names that a source in a package imports: modules, the packages around them, and what may be either."""
    names: set[str] = set()
    # A source that cannot be parsed is reported when it is imported.
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        for node in ast.walk(ast.parse(text)):
            match node:
                case ast.Import(names=aliases):
                    names.update(alias.name for alias in aliases)
                case ast.ImportFrom(module=module, names=aliases, level=level):
                    around = package[: len(package) + 1 - level] if level else ()
                    names.update(".".join(filter(None, (*around, module, alias.name))) for alias in aliases)
    return {".".join(name.split(".")[:depth]) for name in names for depth in range(1, name.count(".") + 2)}
