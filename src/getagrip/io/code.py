"""Which code made something: a fingerprint of files, since they change within a version."""

from __future__ import annotations

import hashlib
import inspect
import sys
import sysconfig
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from types import FunctionType, MethodType, ModuleType

PACKAGE = Path(__file__).resolve().parents[1]
ABOVE = (
    "cli", "commands", "annotate", "experiments", "batch", "pages", "view", "export", "segmentation", "evaluation",
)  # fmt: skip
"""Parts that a reconstruction does not import: those above ``fitting`` (docs/architecture.md), but for ``timelines``,
where ``reconstruct`` is; and ``evaluation``."""

INSTALLED = tuple(Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib", "purelib", "platlib"))
"""Where the standard library and packages are."""


@cache
def fingerprint(*also: str) -> str:
    """Checksum of all files of the package that a reconstruction may depend on, 16 hexadecimal digits.

    What is made otherwise depends on more: ``also`` are the folders and files ``ABOVE`` that it depends on, relative to
    the package. It changes with a comment, too: that a change does not matter cannot be seen from outside.
    """
    total = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if name.split("/")[0] not in ABOVE or f"{name}/".startswith(tuple(f"{part}/" for part in also)):
            content = path.read_bytes()
            total.update(f"{name}\0{len(content)}\0".encode())
            total.update(content)
    return total.hexdigest()[:16]


def outside(function: Callable[..., object]) -> str | None:
    """Checksum of the files outside the package that a function depends on, 16 hexadecimal digits.

    They are those that it is from, and those that these import, but for the standard library and installed packages.
    Empty for a function of the package; None where some of its code is in no file, as at a prompt.
    """
    contents = dict[str, bytes]()
    waiting = [module for module in _modules(function) if not _in(module, PACKAGE)]
    while waiting:
        module = waiting.pop()
        if module.__name__ in contents:
            continue
        if getattr(module, "__file__", None) is None:
            return None
        contents[module.__name__] = Path(str(module.__file__)).read_bytes()
        used = [other for value in vars(module).values() for other in _modules(value)]
        waiting += [other for other in used if getattr(other, "__file__", None) and not _in(other, PACKAGE, *INSTALLED)]
    total = hashlib.sha256(b"\0".join(sorted(contents.values())))
    return total.hexdigest()[:16] if contents else ""


def _modules(thing: object) -> Iterator[ModuleType]:
    """The modules that a value is, is defined in, or holds functions of."""
    if isinstance(thing, ModuleType):
        yield thing
    elif isinstance(thing, partial):
        for part in (thing.func, *thing.args, *thing.keywords.values()):
            yield from _modules(part)
    elif isinstance(thing, MethodType):
        yield from _modules(thing.__func__)
    elif isinstance(thing, FunctionType | type):
        if (module := sys.modules.get(thing.__module__)) is not None:
            yield module
        if isinstance(thing, FunctionType):
            for closed_over in inspect.getclosurevars(thing).nonlocals.values():
                if closed_over is not thing:
                    yield from _modules(closed_over)
    elif callable(thing):
        yield from _modules(type(thing))


def _in(module: ModuleType, *folders: Path) -> bool:
    """Whether a module's file is in one of some folders."""
    file = getattr(module, "__file__", None)
    return file is not None and any(Path(file).resolve().is_relative_to(folder) for folder in folders)
