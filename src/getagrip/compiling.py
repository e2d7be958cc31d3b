"""Kernels: compiled on all cores before the first reconstruction, and kept in the user's cache.

The cache folder is named after the kernels' sources, numba and Python: compiled kernels outlast upgrades and new
environments, and a kernel with changed source is compiled again.
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
"""Numba's options for all kernels; NaN and infinity keep their meaning.

``forceinline``: called kernels become parts of their callers. Else each caller would have a copy, optimised separately,
and a process would use the first copy loaded, which depends on the cache: the last bits would vary.
"""
KERNEL_GROUPS = (
    ("geometry.kernels.silhouette", "fitting.energy.mask"),
    (
        "geometry.kernels.closest", "geometry.kernels.rotations", "fitting.energy.contact",
        "fitting.energy.contact_consistency", "fitting.motion.soft_hinge", "fitting.solver.damped_step",
        "geometry.rasterize", "hands.bending",
    ),
)  # fmt: skip
"""Modules by compiling process: modules that share parts together, and processes of equal duration."""
RARELY_USED_KERNEL_MODULES = (
    "fitting.energy.mesh_mask", "fitting.energy.paper_contact", "fitting.energy.depth_term", "geometry.kernels.depth",
    "fitting.energy.occlusion_order", "fitting.energy.handle_grip", "studio.masks.graph_cut",
)  # fmt: skip
"""Modules that few reconstructions need; each is compiled on first use."""
TYPE_BY_LETTER = {
    "f": types.float64, "s": types.float32, "i": types.int64, "n": types.int32, "t": types.int8, "u": types.uint64,
    "b": types.boolean,
}  # fmt: skip
ALLOCATING_CALLS = {"copy", "empty", "zeros", "zeros_like"}
"""Calls that need reference counting. Numba refuses to compile a kernel without them that allocates by other means,
such as the difference of two arrays."""
COMPILATION_MESSAGE = "kernels are compiled, once for this version: about 15 seconds of one core"

_declared_kernels: list[tuple[Dispatcher, str]] = []

if not processes.imports_from_cwd():  # numba would read options, such as its cache folder, from the current folder
    config._config_fname = ""
    config.reload_config()


def kernel(arguments: str = "", fastmath: bool = True) -> Callable[[Callable], Dispatcher]:
    """Make a decorator that compiles a function.

    ``arguments`` are the types for which a kernel called from Python is compiled in advance: a letter of
    ``TYPE_BY_LETTER`` each, then an array's number of axes, as in "f3 i". A kernel without them is called by kernels
    only. Without ``fastmath``, sums keep their order.
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
    """Compile the kernels of a reconstruction unless done, calling ``tell`` first. Raises nothing.

    One of several processes does it, with a child per core, while the others wait. A mark file states completion.
    Kernels that could not be kept are compiled on use.
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
    except Exception:  # a full disk, another user's folder, no memory: the clips will report it
        return


def compile_modules(names: Iterable[str]) -> None:
    """Compile the kernels of the package's modules for their declared types."""
    modules = {f"getagrip.{name}" for name in names}
    for module in modules:
        importlib.import_module(module)
    with _garbage_collection_paused():
        for compiled, arguments in _declared_kernels:
            if compiled.py_func.__module__ in modules:
                compiled.compile(numba_signature(arguments))


@contextmanager
def _garbage_collection_paused() -> Iterator[None]:
    """Pause garbage collection: checking numba's many lasting objects takes a tenth of its time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def numba_signature(arguments: str) -> tuple[types.Type, ...]:
    """Return numba's types for the ``arguments`` of ``kernel``."""
    return tuple(
        types.Array(TYPE_BY_LETTER[word[0]], int(word[1:]), "C") if word[1:] else TYPE_BY_LETTER[word]
        for word in arguments.split()
    )


@cache
def folder() -> Path:
    """Return the folder of the compiled kernels: in ``NUMBA_CACHE_DIR``, else in the user's cache.

    Its files are executed. If other users can write there, this process and its children use a temporary folder.
    """
    total = hashlib.sha256(repr((numba.__version__, sys.version_info[:2], sys.platform)).encode())
    for name in ("compiling", *(name for group in (*KERNEL_GROUPS, RARELY_USED_KERNEL_MODULES) for name in group)):
        total.update(Path(__file__).parent.joinpath(*name.split(".")).with_suffix(".py").read_bytes())
    named = os.environ.get("NUMBA_CACHE_DIR")
    kept = (Path(named) if named else cache_folder() / "kernels") / total.hexdigest()[:16]
    with suppress(OSError):
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
    """Return the mark file for this processor, once all kernels are compiled: machines may share the folder."""
    from numba.core.registry import cpu_target

    processor = cpu_target.target_context.codegen().magic_tuple()  # numba's own key of cached code
    return folder() / f"compiled.{hashlib.sha256(repr(processor).encode()).hexdigest()[:16]}"


def _is_mark_set(mark: Path) -> bool:
    return mark.is_file() and mark.stat().st_size > 0


def _compile_in_parallel() -> None:
    """Compile all groups, each in its own process if cores are free and Python can be started."""
    n = min(config.NUMBA_DEFAULT_NUM_THREADS, len(KERNEL_GROUPS))  # cores of this process
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
    """The place of a kernel in the cache, by numba's interface."""

    def __init__(self, py_func: Callable, py_file: str) -> None:
        self._py_file, self._module = py_file, py_func.__module__

    def get_cache_path(self) -> str:
        return str(folder())

    def get_source_stamp(self) -> str:
        return folder().name

    def get_disambiguator(self) -> str:
        return str(self._module)

    @classmethod
    def from_function(cls, py_func: Callable, py_file: str) -> _KernelCacheLocator:
        return cls(py_func, py_file)


class _KernelCacheFiles(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes: ClassVar = [_KernelCacheLocator]


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """The compiled versions of a kernel. Unreadable ones are compiled again."""

    _impl_class = _KernelCacheFiles

    def load_overload(self, sig: object, target_context: object) -> object:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged file may raise anything
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: object, data: object) -> None:
        with suppress(Exception):  # a full disk, or any error of numba
            super().save_overload(sig, data)
