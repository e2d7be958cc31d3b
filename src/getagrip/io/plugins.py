"""Plug-ins of other packages, this package's optional extras, and the fingerprint of the code that made a result.

An installed package that declares ``[project.entry-points."getagrip.methods"] mine = "package.module:MINE"`` adds a
method ``mine`` (docs/extending.md); its object is loaded on first use.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import re
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import date
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar
from urllib.parse import urlsplit

from getagrip.errors import UsageError
from getagrip.io import processes, terminal

PACKAGE = Path(__file__).resolve().parents[1]
UNFINGERPRINTED_PARTS = (
    "cli", "bench", "studio", "batch", "report", "export", "readers", "timelines/detect", "metrics/evaluate",
)  # fmt: skip
"""Folders that a reconstruction never imports: the wings (docs/architecture.md), and two parts of the core."""
T = TypeVar("T")
ENTRY_POINT_PREFIX = "getagrip."
"""Prefix of the groups of entry points."""


@cache
def fingerprint(*also: str) -> str:
    """Compute the checksum of all sources and tables that a reconstruction may depend on, 16 hexadecimal digits.

    ``also`` are files and folders of ``UNFINGERPRINTED_PARTS`` to include, relative to the package. Comments count:
    from the bytes of a file alone, an irrelevant change looks like any other.
    """
    total = hashlib.sha256()
    for path in sorted((*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.json"))):
        name = path.relative_to(PACKAGE).as_posix()
        if not _is_within(name, UNFINGERPRINTED_PARTS) or _is_within(name, also):
            content = path.read_bytes()
            total.update(f"{name}\0{len(content)}\0".encode())
            total.update(content)
    return total.hexdigest()[:16]


def _is_within(name: str, parts: Iterable[str]) -> bool:
    """Return whether a file is one of ``parts``, or lies in one."""
    return f"{name}/".startswith(tuple(f"{part}/" for part in parts))


def date_and_commit() -> str:
    """Return the date and, in a git checkout, the package's commit: "2025-03-01, commit a1b2c3d"; see ``commit``."""
    today = date.today().isoformat()
    found = commit(PACKAGE)
    return f"{today}, commit {found}" if found else today


def commit(folder: Path) -> str | None:
    """Return a folder's git commit, marked if its files differ from it; None outside git."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()

    try:
        if not git("ls-files", "."):  # ignored: an environment inside another checkout
            return None
        changed = git("status", "--porcelain", "--", ".")
        return git("rev-parse", "--short", "HEAD") + (" with uncommitted changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):  # no git, or no checkout
        return None


@cache
def _find_entry_points() -> tuple[metadata.EntryPoint, ...]:
    """Find all entry points for this package, sorted by group and name."""
    try:
        every = metadata.entry_points()
        found = [e for group in every.groups if group.startswith(ENTRY_POINT_PREFIX) for e in every.select(group=group)]
    except Exception as error:  # caused by any installed package
        warn_once(f"plug-ins cannot be listed: an entry_points.txt among the installed packages is malformed ({error})")
        return ()
    return tuple(sorted(found, key=lambda entry: (entry.group, entry.name, _package_version(entry))))


def _package_version(entry: metadata.EntryPoint) -> str:
    """Return name and version of an entry point's package."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "a package without a name"


def plugin_names(kind: str) -> list[str]:
    """List the names of plug-ins of a kind, such as ``exports``."""
    return list(dict.fromkeys(entry.name for entry in _find_entry_points() if entry.group == ENTRY_POINT_PREFIX + kind))


def plugin_packages() -> list[str]:
    """List names and versions of the packages with plug-ins."""
    return sorted({_package_version(entry) for entry in _find_entry_points()})


def fingerprint_with_plugins() -> str:
    """Return ``fingerprint`` and ``plugin_packages``, as a text."""
    return " with ".join(filter(None, [fingerprint(), ", ".join(plugin_packages())]))


@cache
def warn_once(words: str) -> None:
    """Print a warning once, from the main process only."""
    from multiprocessing import parent_process

    if parent_process() is None:
        terminal.warn(words)


@contextmanager
def convert_base_exceptions() -> Iterator[None]:
    """Turn a ``BaseException`` raised by foreign code into a ``RuntimeError``; the user's Ctrl-C passes."""
    before = processes.interrupt_count()
    try:
        yield
    except (Exception, GeneratorExit):
        raise
    except BaseException as error:
        if processes.is_user_interrupt(error, before):
            raise
        raise RuntimeError(f"{type(error).__name__}: {error}") from error


@dataclass(frozen=True)
class Plugin:
    """A plug-in of another package."""

    entries: tuple[metadata.EntryPoint, ...]
    """Its entry points: one, unless several packages use one name."""

    @property
    def packages(self) -> str:
        """Names and versions."""
        return ", ".join(map(_package_version, self.entries))

    def __str__(self) -> str:
        return " and ".join(
            f"{entry.group} {entry.name!r} of {_package_version(entry)} ({entry.value})" for entry in self.entries
        )

    def load(self) -> Any:
        """Load the object. Raises ``UsageError`` for any failure."""
        if len(self.entries) > 1:
            raise UsageError(f"{self} have the same name: rename one, or uninstall its package")
        try:
            with convert_base_exceptions():
                return self.entries[0].load()
        except Exception as error:
            raise UsageError(f"{self} cannot be loaded: {type(error).__name__}: {error}") from error


@dataclass(eq=False)
class PluginTable(MutableMapping[str, T], Generic[T]):
    """Entries of one kind by name: this package's, those set by scripts, and plug-ins.

    All names are known without loading anything. A plug-in that fails to load raises ``UsageError`` on access by its
    name; ``working`` leaves it out.
    """

    kind: str
    """Group of the entry points, without ``ENTRY_POINT_PREFIX``."""
    own: dict[str, T]
    """Entries of this package and of scripts."""
    expected: str
    """Description of a valid object, for errors."""
    fits: Callable[[str, object], bool]
    """Test of an entry point's name and object."""
    taken: tuple[str, ...] = ()
    """Other reserved names."""
    _loaded: dict[str, T] = field(default_factory=dict, init=False)
    _made_of: dict[str, str] = field(default_factory=dict, init=False)
    """Checksums of loaded plug-ins, each computed once: later changes of their files do not run here."""

    def __post_init__(self) -> None:
        self._reserved = frozenset((*self.own, *self.taken))
        PLUGIN_TABLES[self.kind] = self

    @cached_property
    def plugins(self) -> Mapping[str, Plugin]:
        """Plug-ins by name, except for names that are reserved or cannot be a folder's."""
        from getagrip.io.files import is_portable_name

        found: dict[str, Plugin] = {}
        for name in plugin_names(self.kind):
            key = (ENTRY_POINT_PREFIX + self.kind, name)
            plugin = Plugin(tuple(e for e in _find_entry_points() if (e.group, e.name) == key))
            if name in self._reserved:
                warn_once(f"{plugin} is left out: getagrip has {name!r} itself; rename the entry point")
            elif not is_portable_name(name):
                warn_once(f"{plugin} is left out: its name must be one that a folder can have")
            else:
                found[name] = plugin
        return found

    def __getitem__(self, name: str) -> T:
        if name in self.own:
            return self.own[name]
        if name not in self._loaded:
            plugin = self.plugins[name]
            value = plugin.load()
            if not self.fits(name, value):
                raise UsageError(f"{plugin} must be {self.expected} (got {value!r})")
            self._loaded[name] = value
        return self._loaded[name]

    def __setitem__(self, name: str, value: T) -> None:
        self.own[name] = value

    def __delitem__(self, name: str) -> None:
        del self.own[name]

    def __contains__(self, name: object) -> bool:
        return name in self.own or name in self.plugins

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self.own, *self.plugins]))

    def __len__(self) -> int:
        return len({*self.own, *self.plugins})

    def working(self) -> dict[str, T]:
        """Return all entries that load, with a warning about each of the others."""
        out: dict[str, T] = {}
        for name in self:
            try:
                out[name] = self[name]
            except UsageError as error:
                warn_once(f"left out: {error}")
        return out

    def made_of(self, *only: str) -> Iterator[str]:
        """Yield package, version and checksum of each working plug-in; with names, of these plug-ins only."""
        for name, value in self.working().items():
            if name not in self.own and (not only or name in only):
                if name not in self._made_of:
                    part = f"{self.kind} {name} {_plugin_checksum(value)}"
                    self._made_of[name] = f"{self.plugins[name].packages} ({part})"
                yield self._made_of[name]


def _plugin_checksum(value: object) -> str:
    from getagrip.io.source_checksum import UnknownSourceError, source_checksum

    try:
        return source_checksum(value)
    except UnknownSourceError:
        return "of unknown source"


PLUGIN_TABLES: dict[str, PluginTable[Any]] = {}
"""All tables whose modules are imported, by kind."""


def plugin_dependencies(method: str) -> dict[str, str]:
    """Return the plug-ins on which a method's result depends, as an entry of its record; empty without any."""
    methods = PLUGIN_TABLES["methods"].made_of(method) if "methods" in PLUGIN_TABLES else ()
    kinds = ("modalities", "input_checks", "result_checks")
    parts = [*methods, *(part for kind in kinds if kind in PLUGIN_TABLES for part in PLUGIN_TABLES[kind].made_of())]
    return {"plugins": "; ".join(parts)} if parts else {}


def plugin_of(value: object) -> Plugin | None:
    """Return the plug-in of a table's entry; None for an entry of this package or of a script."""
    for table in PLUGIN_TABLES.values():
        for name, loaded in table._loaded.items():
            if loaded is value:
                return table.plugins[name]
    return None


def import_extra(module: str, extra: str, option: str = "") -> ModuleType:
    """Import a module of an extra of this package.

    ``option`` is the option that needs it; empty: ``--to`` and the extra's name. Raises ``UsageError`` with the command
    that installs the extra.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        needed = f"{option or f'--to {extra}'} needs it; {install_command(extra)}"
        raise UsageError(f"missing module {module!r} ({error}): {needed}") from error


def install_command(extra: str) -> str:
    """Write the command that installs an extra, from the clone or wheel of this package.

    If these are unknown or gone, it names the libraries instead, never this package: an index may not have it, or have
    another one of its name.
    """
    if source := _install_source():
        return 'pip install {}"{}[{}]"'.format(*source, extra)
    libraries = " ".join(f'"{each}"' for each in libraries_of(extra))
    return f"pip install {libraries}" if libraries else f"install the libraries of the extra {extra!r}"


def libraries_of(extra: str) -> list[str]:
    """List the requirements of an extra, as pip takes them; for ``all``, those of the extras that it includes."""
    mark = re.compile(rf"""extra == ['"]{re.escape(extra)}['"]""")
    found: list[str] = []
    for requirement in metadata.requires("getagrip") or ():
        library, _, condition = requirement.partition(";")
        if not mark.search(condition):
            continue
        others = re.match(r"getagrip\[(.*)\]", library)
        found += [each for name in others[1].split(",") for each in libraries_of(name)] if others else [library.strip()]
    return found


def _install_source() -> tuple[str, str] | None:
    """Return pip's option and the folder or wheel from which this package was installed (PEP 610), if it exists."""
    try:
        record = json.loads(metadata.distribution("getagrip").read_text("direct_url.json") or "null")
    except (metadata.PackageNotFoundError, ValueError):
        return None
    if not isinstance(record, dict) or not str(record.get("url", "")).startswith("file:"):
        return None
    from urllib.request import url2pathname  # loads ssl

    path = Path(url2pathname(urlsplit(record["url"]).path))
    if not path.exists():
        return None
    editable = bool(record.get("dir_info", {}).get("editable"))
    return ("-e " if editable else ""), str(path)
