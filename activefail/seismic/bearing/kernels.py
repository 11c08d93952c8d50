"""The compiled kernels: their compiler options, and the folder that keeps them."""

import hashlib
import logging
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from activefail.errors import InputError
from activefail.text.syntax import dumped, syntax_of

KERNEL: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
"""Options of every kernel: division by zero gives infinity; a product and a sum may be fused, with one rounding.

Results then depend on the processor type, as they already do through the exponential. Kernels write squares as
products, because numba compiles a power with a whole exponent as a separate function, once per process, with the
options of the first kernel that uses it.
"""

INLINE: dict[str, Any] = {"forceinline": True, **KERNEL}
"""Options of kernels that become part of their callers."""

_PACKAGE = Path(__file__).parent

_DEFAULTS = {
    "OPT": 3,
    "LOOP_VECTORIZE": 1,
    "SLP_VECTORIZE": 0,
    "BOUNDSCHECK": None,
    "DEBUGINFO_DEFAULT": 0,
    "EXTEND_VARIABLE_LIFETIMES": 0,
    "ENABLE_AVX": True,
    "DISABLE_INTEL_SVML": False,
    "LLVM_REFPRUNE_PASS": 1,
    "LLVM_REFPRUNE_FLAGS": "all",
    "CPU_NAME": None,
    "CPU_FEATURES": None,
}


def compiler_options() -> str:
    """Numba's options that change compiled code and differ from the defaults."""
    from numba.core import config

    values = {name: getattr(config, name, default) for name, default in _DEFAULTS.items()}
    # The level "max" is an integer 3 with a mark.
    values["OPT"] = "max" if getattr(config.OPT, "is_opt_max", False) else int(config.OPT)
    return " ".join(f"NUMBA_{name}={value}" for name, value in values.items() if value != _DEFAULTS[name]) or "defaults"


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a kernel: numba compiles it with these options at its first call and keeps it (`kept_kernels`)."""
    from numba import njit

    def decorate(function: Callable[..., Any]) -> Any:
        with kept_kernels(_folder()):
            return njit(cache=True, **options)(function)

    return decorate


@cache
def _folder() -> Path:
    return folder_of_kernels()


def folder_of_kernels(package: Path = _PACKAGE) -> Path:
    """The folder for the kernels of these sources and compiler options; it cannot be created if none is private.

    Kernels of earlier sources next to the package are deleted; their folders stay, because a process that began before
    the change may still save there.
    """
    from numba.misc.appdirs import AppDirs

    pycache, named = package / "__pycache__", Path(os.environ.get("NUMBA_CACHE_DIR", ""))
    user = Path(AppDirs("numba", False).user_cache_dir)
    bases = [named] if named.is_absolute() else [*([pycache] if os.access(package, os.W_OK) else []), user]
    # A relative path would begin at the current folder, which may come from someone else.
    base = next((base for base in bases if base.is_absolute() and _is_private(base)), Path(os.devnull))
    digest = hashlib.sha256()
    for source in sorted(package.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    sources = f"kernels-{digest.hexdigest()[:16]}"
    with suppress(OSError):
        for kept in pycache.glob("kernels-*/**/*.nb[ic]"):
            if sources not in kept.parts:
                kept.unlink(missing_ok=True)
    return base / sources / hashlib.sha256(compiler_options().encode()).hexdigest()[:8]


@contextmanager
def kept_kernels(folder: Path) -> Iterator[None]:
    """Keep kernels that are defined meanwhile in this folder, and nowhere else.

    By itself, numba checks only a kernel's own file: it would continue to use a kernel after a change in a function
    that the kernel calls, or after a change of the compiler options. Numba would also turn to its other folders, which
    have the same fault, if it cannot use this one, or if `NUMBA_CACHE_LOCATOR_CLASSES` names them. Therefore numba gets
    this folder alone. If it cannot be written, or another user may write there, kernels are compiled for this process
    and not kept: numba unpickles what it keeps.
    """
    from numba.core import config, dispatcher
    from numba.core.caching import UserProvidedCacheLocator

    kernel_type: Any = dispatcher.Dispatcher
    before = config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES, kernel_type.enable_caching
    config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = str(folder), UserProvidedCacheLocator.__name__
    place = folder / UserProvidedCacheLocator.get_suitable_cache_subpath(__file__)
    kernel_type.enable_caching = (
        _keep if _is_private(folder) and _is_writable(place) and _is_private(place) else _do_not_keep
    )
    try:
        yield
    finally:
        config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES, kernel_type.enable_caching = before


def _is_private(folder: Path) -> bool:
    """Whether only this user and root may change what a folder contains, or will contain once it is created.

    In a parent with the sticky bit, such as /tmp, nobody may replace another's folder. A group is this user's own if it
    has the user's number.
    """
    owners = (0, os.geteuid())
    try:
        folder = folder.resolve()
        for place in (one for one in (folder, *folder.parents) if one.exists()):
            status = place.stat()
            writers = stat.S_IWOTH if status.st_gid in owners else stat.S_IWOTH | stat.S_IWGRP
            is_guarded = place != folder and status.st_mode & stat.S_ISVTX
            if status.st_uid not in owners or (status.st_mode & writers and not is_guarded):
                return False
    except (OSError, ValueError):  # ValueError: the name contains a NUL
        return False
    return True


def _is_writable(folder: Path) -> bool:
    """Whether files can be created in a folder, which is created too, for this user alone."""
    try:
        for missing in [one for one in (*reversed(folder.parents), folder) if not one.exists()]:
            missing.mkdir(mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, ValueError):  # ValueError: the name contains a NUL
        return False
    return True


def _keep(kernel: Any) -> None:
    """Let numba keep a kernel; if the folder fails, as on a full disk, it is compiled but not kept."""
    from numba.core.caching import FunctionCache

    class Cache(FunctionCache):
        def load_overload(self, sig: Any, target_context: Any) -> Any:
            loaded = None
            with suppress(OSError):
                loaded = super().load_overload(sig, target_context)
            if loaded is None:
                _announce(kernel)
            return loaded

        def save_overload(self, sig: Any, data: Any) -> None:
            with suppress(OSError):
                super().save_overload(sig, data)

    kernel._cache = Cache(kernel.py_func)


def _announce(kernel: Any) -> None:
    """Log that a kernel is compiled now, if it is the one that takes long."""
    if kernel.py_func.__name__ == "integrate":
        logging.getLogger(__name__).info("compiling the simulator, once; this takes some 20 s")


def _do_not_keep(kernel: Any) -> None:
    """Let numba compile a kernel for this process only.

    A temporary folder would gain nothing: the process has the kernel in memory. Worker processes end without clean-up
    and would leave their folders behind.
    """


def check_compiled() -> None:
    """Check that numba compiles.

    Raises:
        InputError: if `NUMBA_DISABLE_JIT` is set.
    """
    from numba.core import config

    if config.DISABLE_JIT:
        raise InputError("NUMBA_DISABLE_JIT is set, but the bearing's kernels run only when compiled. Unset it.")


@cache
def physics_digest(package: Path = _PACKAGE) -> str:
    """SHA-256 of the package's syntax, without docstrings, which identifies the version of the physics."""
    digest = hashlib.sha256()
    for source in sorted(package.glob("*.py")):
        tree = syntax_of(source.read_bytes())
        assert tree is not None
        digest.update(f"{source.name}\0{dumped(tree)}".encode())
    return digest.hexdigest()
