"""Foreign code: a checksum of a function and all that it uses, and the line of an error in it."""

from __future__ import annotations

import ast
import hashlib
import linecache
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
from numpy import ndarray

from getagrip.io.plugins import PACKAGE

REPR_TYPES = (type(None), bool, int, float, complex, str, bytes, np.generic, Path)
"""Types whose ``repr`` determines a value."""
CONTAINER_PARTS: Mapping[type, Callable[[Any], Iterable[object]]] = {
    partial: lambda of: (of.func, of.args, of.keywords),
    MethodType: lambda of: (of.__func__, of.__self__),
    dict: lambda of: of.items(),
    tuple: lambda of: of,
    list: lambda of: of,
    set: lambda of: sorted(of, key=repr),
    frozenset: lambda of: sorted(of, key=repr),
    ndarray: lambda of: (str(of.dtype), of.shape, of.tolist() if of.dtype.hasobject else of.tobytes()),
}
"""Functions that list the objects inside objects of some types."""
SITE_PACKAGES_FOLDERS = ("site-packages", "dist-packages")
STDLIB_FOLDER = Path(sysconfig.get_path("stdlib")).resolve()


class UnknownSourceError(Exception):
    """An object whose source code cannot be determined."""


def source_checksum(value: object) -> str:
    """Compute the checksum of a function or another value, and all its parts outside this package.

    Parts are the source files of functions and classes, the files that these import except for installed libraries, and
    the values in partials, closures, defaults and objects. Raises ``UnknownSourceError`` for a source without a file,
    as typed at a prompt, and for a value with parts that only its own code knows.
    """
    made_of = _CodeParts()
    try:
        made_of.add(value)
        sources = sorted(made_of.digests())
    except (OSError, RecursionError, SyntaxError, ValueError) as error:
        raise UnknownSourceError(str(error)) from error
    return hashlib.sha256("\0".join([*made_of.values, *sources]).encode()).hexdigest()[:16]


def locate_error(error: BaseException) -> str:
    """Return the place of an error in foreign code, "mine.py:14": the last line outside installed libraries.

    Empty if all of its code belongs to this package, Python or libraries.
    """
    lines = [(line.filename, line.lineno) for line in traceback.extract_tb(error.__traceback__)]
    own = [f"{Path(name).name}:{number}" for name, number in lines if _is_user_code(Path(name))]
    return own[-1] if own else ""


def _is_user_code(file: Path) -> bool:
    """Return whether a file, or the prompt named by an error's line, is the user's own."""
    if not file.is_file():
        return file.name == "<stdin>" or (not file.name.startswith("<") and bool(linecache.getlines(str(file))))
    return not _is_package_or_stdlib(file.resolve()) and not _is_in_site_packages(file.resolve())


@dataclass
class _CodeParts:
    """The parts of a value, found recursively."""

    files: set[Path] = field(default_factory=set)
    values: list[str] = field(default_factory=list)
    seen: dict[int, object] = field(default_factory=dict)
    """Objects by ``id``, kept alive so that no id is reused."""

    def add(self, value: object) -> None:
        """Add a value and its parts."""
        if isinstance(value, REPR_TYPES):
            self.values.append(f"{type(value).__name__} {value!r}")
        elif id(value) not in self.seen:
            self.seen[id(value)] = value
            self.values.append(type(value).__name__)
            for part in self._within(value):
                self.add(part)

    def digests(self) -> list[str]:
        """Return the checksums of the files and their imports."""
        found, left = dict[Path, str](), list(self.files)
        while left:
            file = left.pop()
            if file not in found:
                source = _read_source_file(file)
                found[file] = source.digest
                left += source.imports
        return list(found.values())

    def _within(self, value: object) -> Iterator[object]:
        """Yield an object's parts."""
        if isinstance(value, FunctionType):
            self._note(value.__code__.co_filename)
            yield from (value.__qualname__, value.__defaults__, value.__kwdefaults__)
            yield from (cell.cell_contents for cell in value.__closure__ or ())
        elif isinstance(value, type):
            yield from (value.__module__, value.__qualname__)
            if value.__module__ not in sys.builtin_module_names:  # built-in modules have no file
                yield sys.modules.get(value.__module__)
        elif isinstance(value, ModuleType):
            self._note(getattr(value, "__file__", None) or "")
        elif isinstance(value, BuiltinFunctionType | np.ufunc):
            yield value.__name__
        else:
            yield from _parts_of_object(value)

    def _note(self, name: str) -> None:
        """Note a source file outside this package and Python."""
        file = Path(name)
        if not file.is_file():
            raise UnknownSourceError(name)
        if not _is_package_or_stdlib(file.resolve()):
            self.files.add(file.resolve())


def _parts_of_object(value: object) -> Iterable[object]:
    """Return the parts of a container or of another object without code of its own."""
    for kind, parts in CONTAINER_PARTS.items():
        if isinstance(value, kind):
            return parts(value)
    if hasattr(value, "__wrapped__"):  # a decorated function
        return (value.__wrapped__,)
    if not hasattr(value, "__dict__"):
        raise UnknownSourceError(f"a {type(value).__name__}")
    return type(value), vars(value)


def _is_package_or_stdlib(file: Path) -> bool:
    """Return whether a file belongs to this package or to Python's library."""
    return file.is_relative_to(PACKAGE) or (file.is_relative_to(STDLIB_FOLDER) and not _is_in_site_packages(file))


def _is_in_site_packages(file: Path) -> bool:
    return any(name in file.parts for name in SITE_PACKAGES_FOLDERS)


@dataclass(frozen=True)
class _SourceFile:
    digest: str
    imports: frozenset[Path]
    """Foreign files imported anywhere in it."""


def _read_source_file(file: Path) -> _SourceFile:
    content = file.read_bytes()
    found = set[Path]()
    if file.suffix == ".py":
        for node in ast.walk(ast.parse(content)):
            if isinstance(node, ast.Import):
                found.update(*(_imported_files(file, 0, one.name, ()) for one in node.names))
            elif isinstance(node, ast.ImportFrom):
                names = tuple(one.name for one in node.names)
                found.update(_imported_files(file, node.level, node.module or "", names))
    return _SourceFile(hashlib.sha256(content).hexdigest(), frozenset(found))


def _imported_files(importer: Path, level: int, module: str, names: tuple[str, ...]) -> Iterator[Path]:
    """Yield the files that an import loads: the module, its packages, and the modules among ``names``.

    Files of an installed library only if the importing file belongs to it.
    """
    first, *rest = module.split(".") if module else [""]
    if level:
        folders: list[str] = [str(importer.parents[level - 1])]
        rest = [first, *rest] if first else []
    else:
        try:
            spec = find_spec(first)
        except (ImportError, ValueError):  # the running script has no spec
            spec = None
        if spec is None or (_is_in_site_packages(Path(spec.origin or "")) and first not in importer.parts):
            return
        yield from _foreign_file(spec.origin)
        folders = [*(spec.submodule_search_locations or ())]
    for name in rest:
        inner = PathFinder.find_spec(name, folders)
        if inner is None:
            return
        yield from _foreign_file(inner.origin)
        folders = [*(inner.submodule_search_locations or ())]
    for name in names if folders else ():
        inner = PathFinder.find_spec(name, folders)
        yield from _foreign_file(None if inner is None else inner.origin)


def _foreign_file(origin: str | None) -> Iterator[Path]:
    """Yield the file of a foreign module."""
    if origin is not None and (file := Path(origin)).is_file() and not _is_package_or_stdlib(file.resolve()):
        yield file.resolve()
