"""The folder of the user's code: imports from it, and a digest of what they load."""

import ast
import hashlib
import importlib
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from activefail.text.syntax import dumped, syntax_of


class SourceLoader(SourceFileLoader):
    """Compiles a module from its source; bytecode may be older than the source by less than a second, or a forgery."""

    def get_code(self, fullname: str) -> CodeType:
        """The code of the module."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


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
        self._loaded: dict[str, ModuleType] = {}
        self._added = False

    def enter(self) -> None:
        """Put the finder and the folder into Python's search, with the modules that it found before."""
        # A folder that is already on the path keeps its place.
        self._added = str(self.folder) not in sys.path
        if self._added:
            sys.path.append(str(self.folder))
        sys.meta_path.insert(sys.meta_path.index(PathFinder), self)
        sys.modules.update(self._loaded)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module or package, if its top-level package is in the folder."""
        if (spec := PathFinder.find_spec(name, path)) is None:
            return None
        location = next(iter(spec.submodule_search_locations or []), spec.origin)
        if path is None and location and Path(location).parent == self.folder:
            self._modules.add(name)
        if name.partition(".")[0] not in self._modules:
            return None
        if isinstance(spec.loader, SourceFileLoader):
            spec.loader = SourceLoader(spec.loader.name, spec.loader.path)
        return spec

    def leave(self) -> None:
        """Take the finder and the folder out of Python's search, with the modules that it found."""
        found = [name for name in sys.modules if name.partition(".")[0] in self._modules]
        self._loaded = {name: sys.modules.pop(name) for name in found}
        if self._added and str(self.folder) in sys.path:
            sys.path.remove(str(self.folder))
        sys.meta_path.remove(self)


_MODULE = re.compile(r"[^\W\d]\w*(?:\.[^\W\d]\w*)*")
"""The name of a module."""

_TEXT = re.compile(r"[./]*([^\W\d]\w*(?:[./][^\W\d]\w*)*)([./]?)")
"""A text that may name a module or its file, or begin such a name."""

_LOADERS = {"import_module", "__import__", "run_module", "run_path", "spec_from_file_location", "exec"}
"""Functions that may load a module whose name is computed."""

_compiled: dict[Path, str] = {}
"""Digests of the compiled modules that this process has loaded."""

_finders: dict[Path, _FolderFinder] = {}
"""By their folders."""


def import_from(folder: Path, sources: Mapping[Path, str]) -> None:
    """Make the modules of a folder importable, in place of those of the previous folder.

    Python identifies modules by name only, and two campaigns may have helper modules of the same name.

    Args:
        folder: the folder of the user's code.
        sources: digests of the files to import; if one has changed since its import, all are imported again.

    Raises:
        ImportError: if one that has changed is compiled, which a process can load only once.
    """
    for path, digest in sources.items():
        if path.suffix != ".py" and _compiled.setdefault(path, digest) != digest:
            raise ImportError(f"{path} has changed since this process loaded it; start Python again")
    finder = _finders.setdefault(folder, _FolderFinder(folder))
    if any(finder.sources.get(path, digest) != digest for path, digest in sources.items()):
        finder = _finders[folder] = _FolderFinder(folder)
    finder.sources.update(sources)
    use(folder)
    importlib.invalidate_caches()


def use(folder: Path) -> None:
    """Make the modules of a folder importable again, those that were loaded as they are."""
    finder = _finders[folder]
    if finder in sys.meta_path:
        return
    for other in [other for other in sys.meta_path if isinstance(other, _FolderFinder)]:
        other.leave()
    finder.enter()


# --- sources ------------------------------------------------------------------------------------------------------


def file_of(module: str, folder: Path) -> Path | None:
    """The file that an import of a module from the folder loads: a package, a compiled module, or a source."""
    *parents, name = module.split(".")
    spec = PathFinder.find_spec(name, [str(folder.joinpath(*parents))])
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


def files_of(names: Iterable[str], folder: Path) -> list[Path]:
    """The files of modules in the folder, of the packages around them, and of all modules in `package.*`.

    Args:
        names: full names; others name nothing.
        folder: of the code.
    """
    every = {".".join(name.split(".")[:depth]) for name in names for depth in range(1, name.count(".") + 2)}
    for name in [name for name in every if name.endswith("*")]:
        package = folder.joinpath(*name.split(".")[:-1])
        modules = {beside.name.partition(".")[0] for beside in package.iterdir()} if package.is_dir() else ()
        every |= {f"{name[:-1]}{module}" for module in modules}
    return [file for name in sorted(every) if _MODULE.fullmatch(name) and (file := file_of(name, folder))]


def sources_of(path: Path, folder: Path) -> dict[Path, str]:
    """Digests of a module's file and of all files in the folder that it imports, directly or not; empty without a file.

    A text that could be the name of a module counts as an import, also as the beginning of a name that is computed.
    Where imports cannot be read, in a compiled module or one that computes names, all modules beside it count.
    """
    importlib.invalidate_caches()
    digests: dict[Path, str] = {}
    pending = [path]
    while pending:
        path = pending.pop()
        if path not in digests and path.is_file():
            content = path.read_bytes()
            package = path.parent.relative_to(folder).parts
            tree = syntax_of(content) if path.suffix == ".py" else None
            digests[path] = sha256(content if tree is None else dumped(tree).encode())
            beside = {".".join((*package, "*"))} if path.suffix != ".py" else set()
            pending += files_of(beside if tree is None else _names_imported(tree, package), folder)
    return digests


def digest_of(sources: Mapping[Path, str], folder: Path) -> str:
    """One digest for all files of modules in a folder; for a single file, its own."""
    if len(sources) == 1:
        return next(iter(sources.values()))
    lines = sorted(f"{path.relative_to(folder)} {digest}\n" for path, digest in sources.items())
    return sha256("".join(lines).encode())


def sha256(content: bytes) -> str:
    """The SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def _names_imported(tree: ast.Module, package: tuple[str, ...]) -> set[str]:
    """Full names that a source in a package imports, or may import: modules, and names or texts that may be modules."""
    names: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=aliases):
                names.update(alias.name for alias in aliases)
            case ast.ImportFrom(module=module, names=aliases, level=level):
                around = package[: len(package) + 1 - level] if level else ()
                names.update(".".join(filter(None, (*around, module, alias.name))) for alias in aliases)
            case ast.Constant(value=str(text)) if match := _TEXT.fullmatch(text):
                name = match[1].replace("/", ".") + (".*" if match[2] else "")
                names |= {name, ".".join((*package, name))}
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.alias(name=name) if name in _LOADERS:
                names |= {"*", ".".join((*package, "*"))}
    return names
