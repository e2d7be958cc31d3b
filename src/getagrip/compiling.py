"""How kernels are compiled, on all cores before the first reconstruction, and where they are kept.

They are kept in the user's cache, in a folder that is named after all that they depend on: their sources, numba and
Python. There they outlast upgrades and new environments, and a kernel whose source has changed is compiled anew.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import importlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numba
from numba import config, njit, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from getagrip.io import files, plugins, processes
from getagrip.io.terminal import cache_folder, is_private_folder

if TYPE_CHECKING:
    from numba.core.dispatcher import Dispatcher

NUMBA_OPTIONS: dict[str, object] = {
    "cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    "forceinline": True, "no_cfunc_wrapper": True,
}  # fmt: skip
"""How all kernels are compiled; NaN and infinity keep their meaning.

Kernels that others call become parts of these. Else each caller has a copy, optimised in its own way; of several copies
in a process the first to be loaded counts, and that is another one where kernels come from the cache: other last bits.
"""
KERNEL_GROUPS = (
    ("geometry.kernels.silhouette", "fitting.energy.mask"),
    ("geometry.kernels.closest", "fitting.energy.contact", "geometry.rasterize", "hands.generic"),
)
"""Modules whose kernels are compiled by one process: those that share parts, and as many as take equally long."""
RARELY_USED_KERNEL_MODULES = (
    "fitting.energy.mesh_mask", "fitting.energy.paper_contact", "fitting.energy.depth_term", "geometry.kernels.depth",
    "fitting.energy.occlusion_order", "fitting.energy.contact_consistency", "studio.masks.graph_cut",
)  # fmt: skip
"""Modules of kernels that few reconstructions need; each is compiled when it is."""
TYPE_BY_LETTER = {
    "f": types.float64, "s": types.float32, "i": types.int64, "n": types.int32, "t": types.int8, "u": types.uint64,
    "b": types.boolean,
}  # fmt: skip
ALLOCATING_CALLS = {"copy", "empty", "zeros", "zeros_like"}
"""Calls for which a kernel must count references. Without them it need not; numba refuses to compile one that allocates
by other means, such as the difference of two arrays."""
COMPILATION_MESSAGE = "kernels are compiled, once for this version: about 15 seconds of one core"

_declared_kernels: list[tuple[Dispatcher, str]] = []

if not processes.imports_from_cwd():  # numba takes options, as where it reads compiled code, from the current folder
    config._config_fname = ""
    config.reload_config()


def kernel(arguments: str = "", fastmath: bool = True) -> Callable[[Callable], Dispatcher]:
    """Make a decorator that compiles a function.

    ``arguments`` are the types that a kernel called from Python is compiled for ahead: a letter of ``TYPE_BY_LETTER`` each,
    then the number of axes of an array, as in "f3 i". One without them is a part of others, called by kernels only.
    Without ``fastmath``, sums keep their order.
    """

    def decorate(function: Callable) -> Dispatcher:
        allocates = not ALLOCATING_CALLS.isdisjoint(function.__code__.co_names)
        options = NUMBA_OPTIONS | {"no_cpython_wrapper": not arguments, "_nrt": allocates}
        compiled = njit(**options if fastmath else options | {"fastmath": False})(function)
        compiled._cache = _KernelCache(function)
        if arguments:
            _declared_kernels.append((compiled, arguments))
        return compiled

    return decorate


def compile_once(tell: Callable[[], object] = lambda: None) -> None:
    """Have the kernels of a reconstruction compiled, unless they are, and call ``tell`` before. Raises nothing.

    Of several processes one does it, by one process per core; the others wait. A mark says that it is done. Kernels
    that could not be kept are compiled when they are used.
    """
    mark = mark_file()
    try:
        if _is_mark_set(mark):
            return
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
        with files.hold_lock(mark):
            if not _is_mark_set(mark):
                tell()
                _compile_in_parallel()
                files.write_text(mark, "compiled")
    except Exception:  # a full disk, a folder of others, no room in memory: the clips will say what is wrong
        return


def compile_modules(names: Iterable[str]) -> None:
    """Compile the kernels of modules of the package for the types that they declare."""
    modules = {f"getagrip.{name}" for name in names}
    for module in modules:
        importlib.import_module(module)
    with _garbage_collection_paused():
        for compiled, arguments in _declared_kernels:
            if compiled.py_func.__module__ in modules:
                compiled.compile(numba_signature(arguments))


@contextmanager
def _garbage_collection_paused() -> Iterator[None]:
    """Leave garbage for later: numba makes many objects that stay; looking through them takes a tenth of its time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def numba_signature(arguments: str) -> tuple[types.Type, ...]:
    """Return numba's types of arguments as ``kernel`` takes them."""
    return tuple(
        types.Array(TYPE_BY_LETTER[word[0]], int(word[1:]), "C") if word[1:] else TYPE_BY_LETTER[word]
        for word in arguments.split()
    )


@cache
def kernel_cache_folder() -> Path:
    """Return the folder of the compiled kernels: in ``NUMBA_CACHE_DIR``, else in the user's cache.

    What lies there is run. Where others can write, a folder of this process and of those that it starts is taken.
    """
    total = hashlib.sha256(repr((numba.__version__, sys.version_info[:2], sys.platform)).encode())
    for name in ("compiling", *(name for group in (*KERNEL_GROUPS, RARELY_USED_KERNEL_MODULES) for name in group)):
        total.update(Path(__file__).parent.joinpath(*name.split(".")).with_suffix(".py").read_bytes())
    named = os.environ.get("NUMBA_CACHE_DIR")
    kept = (Path(named) if named else cache_folder() / "kernels") / total.hexdigest()[:16]
    with suppress(OSError):  # before others make it
        kept.mkdir(mode=0o700, parents=True, exist_ok=True)
    if is_private_folder(kept):
        return kept
    plugins.warn_once(
        f"{kept}: other users can write there, so compiled kernels are neither read nor kept, and compiled in each "
        "call; NUMBA_CACHE_DIR names another folder"
    )
    os.environ["NUMBA_CACHE_DIR"] = own = tempfile.mkdtemp(prefix="getagrip-kernels-")
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    return Path(own) / kept.name


def mark_file() -> Path:
    """Return the mark that all kernels are compiled for this processor: several machines may see one folder."""
    from numba.core.registry import cpu_target

    processor = cpu_target.target_context.codegen().magic_tuple()  # by which numba tells apart what it keeps
    return kernel_cache_folder() / f"compiled.{hashlib.sha256(repr(processor).encode()).hexdigest()[:16]}"


def _is_mark_set(mark: Path) -> bool:
    return mark.is_file() and mark.stat().st_size > 0


def _compile_in_parallel() -> None:
    """Compile all groups, in processes of their own where there are cores for several and Python can be started."""
    n = min(config.NUMBA_DEFAULT_NUM_THREADS, len(KERNEL_GROUPS))  # cores that this process may use
    if n == 1 or getattr(sys, "frozen", False) or not Path(sys.executable or "").name.lower().startswith("py"):
        return compile_modules(name for group in KERNEL_GROUPS for name in group)
    shares, own = KERNEL_GROUPS[: n - 1], [name for group in KERNEL_GROUPS[n - 1 :] for name in group]
    command = "import sys; from getagrip.compiling import compile_modules; compile_modules(sys.argv[1:])"
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path if path)
    with ThreadPoolExecutor(n - 1) as threads:
        ends = [
            threads.submit(
                subprocess.run, processes.python_command("-c", command, *names), env=os.environ | {"PYTHONPATH": paths},
                stdin=subprocess.DEVNULL, capture_output=True, check=True,
            )
            for names in shares
        ]  # fmt: skip
        compile_modules(own)
        for end in ends:
            end.result()
    return None


class _KernelCacheLocator(_CacheLocator):  # type: ignore[misc]
    """The place of a kernel in the cache, as numba asks for it."""

    def __init__(self, py_func: Callable, py_file: str) -> None:
        self._py_file, self._module = py_file, py_func.__module__

    def get_cache_path(self) -> str:
        return str(kernel_cache_folder())

    def get_source_stamp(self) -> str:
        return kernel_cache_folder().name

    def get_disambiguator(self) -> str:
        return str(self._module)

    @classmethod
    def from_function(cls, py_func: Callable, py_file: str) -> _KernelCacheLocator:
        return cls(py_func, py_file)


class _KernelCacheFiles(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes: ClassVar = [_KernelCacheLocator]


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """The compiled versions of a kernel. What cannot be read or kept is compiled anew."""

    _impl_class = _KernelCacheFiles

    def load_overload(self, sig: object, target_context: object) -> object:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged file may raise anything
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: object, data: object) -> None:
        with suppress(Exception):  # likewise, or a full disk
            super().save_overload(sig, data)
