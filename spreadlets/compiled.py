"""How kernels are compiled, and where they are kept for later processes.

Kernels are compiled when they are first called. They are kept beside the package where that can be written to, else in
the user's folder for caches, else in a temporary folder; ``NUMBA_CACHE_DIR`` overrides all of it. Kernels that came
with the package, made once where it was installed, are used from wherever they lie. All are made anew as soon as a file
with kernels changes: one kernel holds the code of others.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import importlib
import logging
import os
import pickle
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, overload

import numba
import numba.core.event
import platformdirs
from llvmlite.binding import parse_assembly, parse_bitcode
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.runtime.nrt import rtsys

Kernel = Callable[..., Any]

TAKEN_APART = (0, 68)
"""The version of Numba whose parts `spreadlets.kernel_compiler` uses. Any other compiles as it always does."""
_is_taken_apart = numba.version_info.short == TAKEN_APART
if _is_taken_apart:
    from spreadlets.kernel_compiler import HelperCompiler, KernelCompiler

PACKAGE = Path(__file__).resolve().parent
USUAL: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
"""What Numba is told of every kernel and helper; nothing calls them from C."""
TEMPORARY = "spreadlets-"
"""What the name of a folder that ends with the process begins with."""
logger = logging.getLogger("spreadlets")
_of_kernels: dict[str, Any] = {"pipeline_class": KernelCompiler} if _is_taken_apart else {}
_of_helpers: dict[str, Any] = {"pipeline_class": HelperCompiler} if _is_taken_apart else {}
_kernels: set[Kernel] = set()
_first_calls: list[tuple[str, str, Any]] = []


@overload
def kernel(function: Kernel) -> Kernel: ...
@overload
def kernel(*, fastmath: bool | set[str] = ...) -> Callable[[Kernel], Kernel]: ...
def kernel(function: Kernel | None = None, **options: Any) -> Kernel | Callable[[Kernel], Kernel]:
    """Compile a function when it is first called, keep it for later processes, and run it without the global lock.

    Parameters
    ----------
    function : callable
        Written in what Numba compiles.
    **options
        Numba's: ``fastmath``, liberties with floating-point numbers, by default none, so that results are exact.

    Notes
    -----
    Dividing by zero gives infinity, as in NumPy: the checks that Python makes take time in each loop.
    """
    if function is None:
        return lambda given: kernel(given, **options)
    kept = "NUMBA_CACHE_DIR" in os.environ
    compiled = numba.njit(**USUAL, **_of_kernels, nogil=True, cache=kept, **options)(function)
    if not numba.config.DISABLE_JIT and "NUMBA_CACHE_DIR" not in os.environ:  # type: ignore[attr-defined]
        compiled._cache = _KernelCache(function)  # type: ignore[no-untyped-call]
    _kernels.add(compiled)
    return compiled  # type: ignore[no-any-return]


@overload
def helper(function: Kernel) -> Kernel: ...
@overload
def helper(*, fastmath: bool | set[str] = ...) -> Callable[[Kernel], Kernel]: ...
def helper(function: Kernel | None = None, **options: Any) -> Kernel | Callable[[Kernel], Kernel]:
    """Compile a function that only kernels call: it is kept within them, and has no entrance from Python.

    Parameters
    ----------
    function : callable
    **options
        As for `kernel`.
    """
    compile_it: Callable[[Kernel], Kernel] = numba.njit(  # type: ignore[call-overload]
        **USUAL, **_of_helpers, no_cpython_wrapper=True, **options
    )
    return compile_it if function is None else compile_it(function)


@cache
def kernel_folder() -> Path:
    """Return the folder that compiled kernels are kept in, made if need be.

    Where kernels came with the package and its folder cannot be written to, they are copied to where new ones can be
    kept. Without any such place, a temporary folder is used, with a warning.
    """
    # The user's choice comes first, then the package's own folder.
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    shipped, own = PACKAGE / "__pycache__" / "kernels", platformdirs.user_cache_path("spreadlets") / "kernels"
    if _can_be_written(shipped):
        return shipped
    # Else the user's cache, or in the worst case a temporary folder.
    if _can_be_written(own):
        folder = own
    else:
        folder = Path(tempfile.mkdtemp(prefix=TEMPORARY))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        warnings.warn(
            f"kernels are compiled again in each run: neither {str(shipped)!r} nor {str(own)!r} can be written to; "
            "set NUMBA_CACHE_DIR to a folder that can",
            stacklevel=2,
        )
    # Take over the kernels that came with the package.
    if shipped.is_dir() and not any(folder.iterdir()):
        shutil.copytree(shipped, folder, dirs_exist_ok=True)
    return folder


def _can_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@cache
def _state_of_kernels() -> str:
    """Return a digest of all files with kernels, and of how they are compiled: what is kept is valid for this."""
    digest = hashlib.sha256(Path(__file__).read_bytes() + Path(__file__).with_name("kernel_compiler.py").read_bytes())
    for folder, _, names in sorted(os.walk(PACKAGE, followlinks=True)):
        for name in sorted(names):
            if name.endswith("_kernels.py"):
                digest.update(Path(folder, name).read_bytes())
    return digest.hexdigest()


@cache
def _import_functions() -> None:
    """Import Numba's functions on arrays, to compile, without SciPy's linear algebra, which takes as long again.

    All that they would take from it is the inner product of `numpy.convolve`, which kernels do not use; Numba has its
    own.
    """
    unknown = "scipy.linalg" not in sys.modules
    if unknown:
        sys.modules["scipy.linalg"] = None  # type: ignore[assignment]
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        if unknown:
            del sys.modules["scipy.linalg"]


class _Place(_CacheLocator):
    """Where Numba keeps a kernel: in one folder, whatever folder its source is in."""

    def __init__(self, function: Kernel, source: str) -> None:
        self._function, self._source = function, source

    def get_cache_path(self) -> str:
        return str(kernel_folder())

    def ensure_cache_path(self) -> None:
        kernel_folder()

    def get_source_stamp(self) -> str:
        if Path(self._source).resolve().is_relative_to(PACKAGE.parent):
            return _state_of_kernels()
        return hashlib.sha256(Path(self._source).read_bytes()).hexdigest()

    def get_disambiguator(self) -> str:
        return f"{self._function.__module__}-{self._function.__code__.co_firstlineno}"

    @classmethod
    def from_function(cls, function: Kernel, source: str) -> _Place:
        return cls(function, source)


class _KernelCacheImpl(CompileResultCacheImpl):
    """What is kept of a kernel is machine code, and LLVM's, read only if another kernel is compiled with it."""

    _locator_classes = [_Place]

    def reduce(self, compiled: Any) -> Any:
        *described, environments = super().reduce(compiled)  # type: ignore[no-untyped-call]
        # What has no constants is never looked into, and would import the module of Numba's that it comes from.
        return (*described, tuple(each for each in environments if each.consts))

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        if not _is_taken_apart:
            return super().rebuild(target_context, payload)  # type: ignore[no-untyped-call]
        (library, kind, (machine_code, code)), described, *rest = payload
        # Numba asks LLVM's code for nothing but the name of the entrance from Python.
        entrance = f'define void @"{described.llvm_cpython_wrapper_name}"() {{ ret void }}'
        named = library, kind, (machine_code, parse_assembly(entrance).as_bitcode())
        kernel = super().rebuild(target_context, (named, described, *rest))  # type: ignore[no-untyped-call]
        kernel.library._get_module_for_linking = cache(partial(parse_bitcode, code))
        return kernel


class _KernelCache(FunctionCache):
    """What cannot be read is compiled anew; what cannot be kept, on a full disk, is used all the same."""

    _impl_class = _KernelCacheImpl

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        # What is compiled also looks for the kernels that it calls; later it holds them.
        if not _announcement.depth:
            _first_calls.append((self._py_func.__module__, self._py_func.__name__, signature))
        try:
            if not _is_taken_apart:
                _import_functions()
                return super().load_overload(signature, target_context)  # type: ignore[no-untyped-call]
            # Numba would take in all that it can compile, which takes as long as loading all kernels of a run; what has
            # been compiled only needs what manages memory.
            rtsys.initialize(target_context)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(signature, target_context)  # type: ignore[no-untyped-call]
        except OSError:
            return None
        except (EOFError, pickle.UnpicklingError, AttributeError, ImportError):
            # It is damaged, or tells of types that this version does not have: what is kept from now on is listed anew.
            with suppress(OSError):
                self._cache_file.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        with suppress(OSError):
            super().save_overload(signature, compiled)  # type: ignore[no-untyped-call]


class _Announcement(numba.core.event.Listener):
    """Counts the kernels that are compiled, says so of the first, and knows how deep one is compiled for another.

    What a compilation makes is hardly ever garbage before its end, and looking for garbage within takes a fifth of its
    time: so collection waits.
    """

    count = depth = 0
    collects = False

    def on_start(self, event: numba.core.event.Event) -> None:
        if not self.depth:
            _import_functions()
            self.collects = gc.isenabled()
            gc.disable()
        self.depth += 1
        if is_kernel(event.data["dispatcher"]):
            if not self.count:
                runs = "later runs" if are_kept() else "this run"
                logger.info("compiling once: kernels are kept for %s in %s", runs, kernel_folder())
            self.count += 1

    def on_end(self, event: numba.core.event.Event) -> None:
        self.depth -= 1
        if not self.depth and self.collects:
            gc.enable()


_announcement = _Announcement()
numba.core.event.register("numba:compile", _announcement)  # type: ignore[no-untyped-call]


def count_compiled() -> int:
    """Return how many kernels this process has compiled, instead of loading them."""
    return _announcement.count


def is_kernel(dispatcher: Any) -> bool:
    """Return whether Numba's function is one of our kernels, not a helper within one."""
    return dispatcher in _kernels


def first_calls() -> Sequence[tuple[str, str, Any]]:
    """Return module, name and types of arguments of the kernels that were called, in the order of their first calls."""
    return _first_calls


def are_kept() -> bool:
    """Return whether other processes find what this one compiles."""
    return not kernel_folder().name.startswith(TEMPORARY)
