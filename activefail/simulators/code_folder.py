"""The folder of the user's code: imports from it, and a digest of its sources."""

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
    """Finds the modules of one folder and remembers which modules it found.

    It precedes Python's path finder on `sys.meta_path`. The folder is last on `sys.path`, so that none of its modules
    shadows a library. Processes started by the user's code inherit `sys.path` and find the modules too.

    Attributes:
        folder: the folder of the user's code.
        sources: digests of the sources that were, or are about to be, imported.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sources: dict[Path, str] = {}
        self._modules: set[str] = set()
        # A folder that is already on the path keeps its place.
        self._added = str(folder) not in sys.path
        if self._added:
            sys.path.append(str(folder))
        sys.meta_path.insert(sys.meta_path.index(PathFinder), self)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The top-level module or package, if it is in the folder; Python finds the modules inside a package."""
        if path is None and (spec := PathFinder.find_spec(name)) is not None:
            location = next(iter(spec.submodule_search_locations or []), spec.origin)
            if location and Path(location).parent == self.folder:
                self._modules.add(name)
                return spec
        return None

    def remove(self) -> None:
        """Remove the finder and the folder from Python's search, and unload the modules that it found."""
        for name in list(sys.modules):
            if name.partition(".")[0] in self._modules:
                del sys.modules[name]
        if self._added and str(self.folder) in sys.path:
            sys.path.remove(str(self.folder))
        sys.meta_path.remove(self)


def import_from(folder: Path, sources: Mapping[Path, str]) -> None:
    """Make the modules of a folder importable, in place of those of the previous folder.

    Python identifies modules by name only, and two campaigns may have helper modules of the same name.

    Args:
        folder: the folder of the user's code.
        sources: digests of the sources to import; if one has changed since its import, all are imported again.
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
        # Python would reuse the bytecode of a source that changed within the same second at the same length.
        with suppress(OSError):
            Path(importlib.util.cache_from_source(path)).unlink()
    finder.sources.update(sources)
    importlib.invalidate_caches()


# --- sources ------------------------------------------------------------------------------------------------------


def sources_of(path: Path, folder: Path) -> dict[Path, str]:
    """Digests of a source and of all sources in the folder that it imports, directly or not; empty without a file."""
    digests: dict[Path, str] = {}
    pending = [path]
    while pending:
        path = pending.pop()
        if path not in digests and path.is_file():
            text = path.read_bytes()
            digests[path] = sha256(text)
            for name in _names_imported(text, path.parent.relative_to(folder).parts):
                stem = folder.joinpath(*name.split("."))
                pending += [stem.with_suffix(".py"), stem / "__init__.py"]
    return digests


def digest_of(sources: Mapping[Path, str], folder: Path) -> str:
    """One digest for all sources in a folder; for a single source, the digest of its bytes."""
    if len(sources) == 1:
        return next(iter(sources.values()))
    lines = sorted(f"{path.relative_to(folder)} {digest}\n" for path, digest in sources.items())
    return sha256("".join(lines).encode())


def sha256(content: bytes) -> str:
    """The SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def _names_imported(text: bytes, package: tuple[str, ...]) -> set[str]:
    """Full names that a source in a package imports: modules, their parent packages, and names that may be modules."""
    names: set[str] = set()
    # The import reports a source that cannot be parsed.
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        for node in ast.walk(ast.parse(text)):
            match node:
                case ast.Import(names=aliases):
                    names.update(alias.name for alias in aliases)
                case ast.ImportFrom(module=module, names=aliases, level=level):
                    around = package[: len(package) + 1 - level] if level else ()
                    names.update(".".join(filter(None, (*around, module, alias.name))) for alias in aliases)
    return {".".join(name.split(".")[:depth]) for name in names for depth in range(1, name.count(".") + 2)}
