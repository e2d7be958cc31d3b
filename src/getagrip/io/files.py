"""Untrusted files, read within limits; files and folders written whole or not at all; locks; SQLite files.

- Reading: no file is trusted. Sizes are checked before memory is taken, no pickle is ever run, and a name found in a
  file is used as a path only after a check that it stays inside its folder.
- Writing: a folder is written in a hidden workplace beside its target, then renamed. The writer locks the workplace,
  and the kernel drops the lock however the process ends: a workplace that can be locked is abandoned, and is swept.
  Without ``fcntl`` nothing is swept; on a file system without locks, every workplace counts as abandoned.
- SQLite: a database is opened only if its header names our application.
"""

from __future__ import annotations

import codecs
import csv
import errno
import hashlib
import io
import json
import math
import os
import re
import secrets
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, is_dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TextIO
from urllib.parse import quote

from getagrip.errors import InputError, UsageError, replace_surrogates
from getagrip.io.terminal import CsvTable, unescape_cell

try:
    import fcntl
except ImportError:  # no POSIX: nothing is locked
    fcntl = None  # type: ignore[assignment]

HAS_FILE_LOCKS = fcntl is not None
"""True if this system supports file locks."""


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Wait for and hold the lock of a file or folder; continue without it if locks are unsupported."""
    lock = acquire_lock(path, wait=True)
    try:
        yield
    finally:
        release_lock(lock)


def acquire_lock(path: Path, wait: bool) -> int | None:
    """Lock a file or folder and return a descriptor that holds the lock; None if locks are unsupported.

    Raises ``OSError`` if the path is missing, or if it is locked already and ``wait`` is False.
    """
    if fcntl is None:
        return None
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        if wait:  # a file system without locks
            return None
        raise
    return descriptor


def release_lock(lock: int | None) -> None:
    """Close the descriptor returned by ``acquire_lock``."""
    if lock is not None:
        os.close(lock)


TEMPORARY_FOLDER_PREFIX = ".getagrip.new."
"""Prefix of the workplaces' names."""


@contextmanager
def temporary_folder(parent: Path) -> Iterator[Path]:
    """Make an empty hidden folder, locked, and remove it when the block ends."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=TEMPORARY_FOLDER_PREFIX, dir=parent))
        with suppress(FileNotFoundError):  # swept before it was locked
            lock = acquire_lock(folder, wait=True)
            if folder.exists():
                break
            release_lock(lock)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        release_lock(lock)


def restore(folder: Path) -> None:
    """Move the folder in ``old/`` of a workplace back beside the workplace, unless a newer one has its name."""
    if (folder / "old").is_symlink():  # not ours: its target is left alone
        return
    for old in (folder / "old").glob("*"):
        target = folder.parent / old.name
        if not os.path.lexists(target):
            os.rename(old, target)


def remove_stale_folders(parent: Path) -> list[Path]:
    """Remove this user's abandoned workplaces, and return them; restore the folders that were being replaced."""
    swept = []
    for folder in parent.glob(f"{TEMPORARY_FOLDER_PREFIX}*") if HAS_FILE_LOCKS else ():
        if folder.is_symlink() or not folder.is_dir():
            continue
        try:
            if folder.stat().st_uid != os.geteuid():
                continue
            lock = acquire_lock(folder, wait=False)
        except OSError:  # locked by a live writer, another user's, or gone
            continue
        try:
            restore(folder)
            shutil.rmtree(folder, ignore_errors=True)
            swept.append(folder)
        finally:
            release_lock(lock)
    return swept


Json = dict[str, Any]
"""A JSON object; its reader checks the values."""
MAX_JSON_BYTES = 64 * 2**20
MAX_YAML_BYTES = 2**18
"""Maximum size of a YAML file: calibrations have a few kilobytes, and parsing is slow."""
OPENCV_YAML_MARK = b"%YAML"
"""Start of OpenCV's first line, ``%YAML:1.0``, which is no YAML."""
MAX_FILE_BYTES = 2**30
BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"), (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
"""Byte order marks of texts, and the encodings that they state."""
FORBIDDEN_NAME_CHARS = {*"/\\"} | ({*'<>:"|?*'} if os.name == "nt" else set())
WINDOWS_DEVICE_NAME = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?$", re.IGNORECASE)
"""Names that Windows opens as devices, in every folder and with any suffix."""
UNNAMED_WRITE_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Write errors that Python raises without the file's name."""


def shorten_value(value: object) -> str:
    """Shorten a value for an error message, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."


def printable(text: str) -> str:
    """Shorten a name from a file for an error message, on one line and without quotes."""
    return shorten_value(text)[1:-1]


def is_portable_name(name: str) -> bool:
    """Return whether a text can name a file or folder.

    It must be printable, of 1 to 200 bytes, without separators, not hidden and not ``..``. Windows' device names and a
    dot at the end are refused everywhere, so that folders can be moved to Windows.
    """
    plain = name.isprintable() and name == name.strip() and not FORBIDDEN_NAME_CHARS & {*name}
    return (
        plain
        and not name.startswith((".", "~"))
        and not name.endswith(".")
        and not WINDOWS_DEVICE_NAME.match(name)
        and 0 < len(name.encode()) <= 200
    )


def list_files(folder: Path, suffixes: Collection[str] = (), pattern: str = "*") -> list[Path]:
    """List the files in a folder with one of some lower-case ``suffixes``, in either case; all files without any.

    Files that begin with a dot are left out: macOS adds one beside each file, such as ``._000001.jpg``.
    """
    found = (path for path in folder.glob(pattern) if not path.name.startswith("."))
    return sorted(path for path in found if path.is_file() and (not suffixes or path.suffix.lower() in suffixes))


def folders_in(folder: Path) -> list[Path]:
    """List the folders in a folder, by name, except for hidden ones."""
    inside = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in inside if path.is_dir() and not path.name.startswith("."))


def inside(folder: Path, relative: str, key: str, what: str, source: Path | None = None) -> Path:
    """Return the file ``folder/relative``, which must exist and lie in the folder, links followed.

    Raises ``InputError`` about ``key`` of the file ``source`` from which the path was read, if any.
    """
    named = source or folder / relative
    parts = PurePosixPath(relative)
    if not relative or "\0" in relative or "\\" in relative or parts.is_absolute() or ".." in parts.parts:
        raise InputError(named, key, f"the path {shorten_value(relative)}", f"{what} inside the folder")
    path = folder / relative
    try:
        leaves = _may_leave(folder, parts) and not os.path.realpath(path).startswith(
            os.path.join(os.path.realpath(folder), "")
        )
        there = path.is_file()
    except OSError as error:  # names that are too long, no permission
        raise InputError(named, key, f"the path {shorten_value(relative)} ({error.strerror})", what) from error
    if leaves:
        got = f"the path {shorten_value(relative)}, which leads out"
        raise InputError(named, key, got, f"{what} inside the folder")
    if not there:
        raise InputError(path, "" if source is None else key, "no such file", what)
    return path


def _may_leave(folder: Path, parts: PurePosixPath) -> bool:
    """Return whether a part of a path is a link, or might be one on Windows: only then are its links followed."""
    return os.name == "nt" or any(os.path.islink(f"{folder}/{part}") for part in (parts, *parts.parents[:-1]))


def read_bytes(path: Path, limit: int = MAX_FILE_BYTES) -> bytes:
    """Read a file of at most ``limit`` bytes. Raises ``InputError``."""
    try:
        if not path.is_file():
            raise InputError(path, "", "no such file", "a file")
        size = path.stat().st_size
        if size > limit:
            raise InputError(path, "", f"{size} bytes", f"at most {limit}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(path, "", f"a file that cannot be read ({error.strerror})", "a readable file") from error


def strip_byte_order_mark(content: bytes) -> bytes:
    """Return a text in UTF-8 without its byte order mark, which may state UTF-16 or UTF-32, as on Windows."""
    for mark, encoding in BYTE_ORDER_MARKS:
        if content.startswith(mark):
            return content[len(mark) :] if encoding == "utf-8" else content.decode(encoding, "replace").encode()
    return content


def read_text(path: Path, limit: int = MAX_FILE_BYTES) -> str:
    """Read a text of at most ``limit`` bytes, in UTF-8 unless a byte order mark differs. Raises ``InputError``."""
    return strip_byte_order_mark(read_bytes(path, limit)).decode(errors="replace")


def read_json(path: Path) -> Json:
    """Read a JSON object. Raises ``InputError`` for anything else, and as ``read_any_json`` does."""
    content = read_any_json(path)
    if not isinstance(content, dict):
        raise InputError(path, "", f"a JSON {type(content).__name__}", "a JSON object")
    return content


def read_any_json(path: Path, *, nan: bool = False) -> object:
    """Read a JSON file. Raises ``InputError``, also for duplicate keys, infinity and, unless ``nan``, NaN.

    Python writes NaN for missing numbers.
    """

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        out = dict(pairs)
        if len(out) < len(pairs):
            twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
            raise InputError(path, printable(twice), "the key twice", "each key once")
        return out

    def number(text: str) -> float:
        value = float(text)
        if not (math.isfinite(value) or (nan and text == "NaN")):
            raise InputError(path, "", f"the number {shorten_value(text)}", "finite numbers")
        return value

    content = read_bytes(path, MAX_JSON_BYTES)
    try:
        text = content.decode(json.detect_encoding(content))
        value = json.loads(text, object_pairs_hook=unique, parse_float=number, parse_constant=number)
        if "\\ud" in text.lower():  # half a character, which no file can be written with
            json.dumps(value, ensure_ascii=False).encode()
        return value
    except (ValueError, RecursionError) as error:  # RecursionError: nested thousands deep
        raise InputError(path, "", f"invalid JSON ({error})", "JSON") from error


def read_yaml(path: Path) -> dict[str, object]:
    """Read a YAML mapping, such as OpenCV's. Raises ``InputError``.

    Beside YAML's own types, only tuples of Python are allowed, for DexYCB, and OpenCV's matrices, as mappings. Aliases
    are refused: by them a small file can unfold to a huge one.
    """
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """YAML's own types, without aliases."""

        def compose_node(self, parent: object, index: object) -> object:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("an alias")
            return super().compose_node(parent, index)

    Loader.add_constructor("tag:yaml.org,2002:python/tuple", Loader.construct_sequence)
    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", lambda it, node: it.construct_mapping(node, deep=True))
    content = strip_byte_order_mark(read_bytes(path, MAX_YAML_BYTES))
    content = content.partition(b"\n")[2] if content.startswith(OPENCV_YAML_MARK) else content
    try:
        value = yaml.load(content, Loader)
    except Exception as error:  # parsers of dates, numbers and truth values raise many kinds of errors
        raise InputError(path, "", f"invalid plain YAML ({error})", "a YAML mapping") from error
    if not isinstance(value, dict):
        raise InputError(path, "", f"a YAML {type(value).__name__}", "a YAML mapping")
    return value


def write_csv(path: Path, rows: Iterable[Iterable[object]]) -> None:
    """Write a table, headings first, whole or not at all."""
    with new_text(path) as stream:
        CsvTable(stream).write_rows(rows)


def csv_rows(path: Path, content: bytes, what: str) -> tuple[list[str], list[tuple[str, dict[str, str]]]]:
    """Read a CSV table: its headings, and its cells by heading for each row, with its place for errors, "line 7, ".

    ``what`` names the expected file. Raises ``InputError`` for invalid CSV or UTF-8, and for ragged rows.
    """
    try:
        lines = csv.reader(io.StringIO(strip_byte_order_mark(content).decode(), newline=""), strict=True)
        heads = next(lines, [])
        rows = []
        for cells in filter(None, lines):
            if len(cells) != len(heads):
                raise InputError(path, f"line {lines.line_num}", f"{len(cells)} cells", f"{len(heads)}, as in line 1")
            rows.append((f"line {lines.line_num}, ", dict(zip(heads, map(unescape_cell, cells), strict=True))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "", f"invalid CSV ({error})", what) from error
    return heads, rows


def sha256(paths: Mapping[str, Path]) -> str:
    """Compute the checksum of some files by name, their names and lengths included."""
    total = hashlib.sha256()
    for name, path in paths.items():
        content = read_bytes(path)
        total.update(f"{name}\0{len(content)}\0".encode())
        total.update(content)
    return total.hexdigest()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, as ``new_file`` does. Raises ``OSError`` that names it."""
    with new_file(path) as part:
        part.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, its line ends unchanged, as ``write_bytes`` does."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: Mapping[str, object] | Sequence[object]) -> None:
    """Write a JSON object or list as ``to_json`` does; its folder is made if missing."""
    write_bytes(path, (to_json(content) + "\n").encode())


def to_json(content: Mapping[str, object] | Sequence[object]) -> str:
    """Convert a JSON object or list to text: arrays become lists, NaN and infinity null."""
    return replace_surrogates(json.dumps(_to_json_types(content), indent=2, ensure_ascii=False, allow_nan=False))


def _to_json_types(value: object) -> object:
    if hasattr(value, "tolist"):  # numpy's types, without importing numpy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _to_json_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json_types(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if is_dataclass(value) and not isinstance(value, type):
        return _to_json_types(asdict(value))
    return str(value) if isinstance(value, Path) else value


def check_folder(option: str, folder: Path) -> None:
    """Raise ``UsageError``, in the name of an option, if a folder cannot be made or written; leave no trace."""
    try:
        parent = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        os.rmdir(tempfile.mkdtemp(prefix=".getagrip.", dir=parent))  # permissions do not show /proc and full disks
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"{option} must be a folder that can be written (got {folder}: {reason})") from error


def check_file(option: str, file: Path) -> None:
    """Raise ``UsageError``, in the name of an option, if a file or its folder cannot be written; leave no trace."""
    check_folder(option, file.parent)
    try:
        if file.exists() and not file.is_symlink():  # a link is replaced
            file.open("ab").close()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"{option} must be a file that can be written (got {file}: {reason})") from error


def refuse_link(path: Path) -> None:
    """Raise ``UsageError`` if a folder to write into is a link."""
    if path.is_symlink():
        raise UsageError(f"{path} must be a folder or a free name (got a link, and nothing is written through one)")


def folder_inside(folder: Path, *names: str) -> Path:
    """Return a folder nested in another, ``folder/name/name/...``, made if missing.

    ``folder`` itself may be a link, since the user names it. Raises ``UsageError`` if a folder below it is a link.
    """
    for name in names:
        folder /= name
        refuse_link(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def new_folder(target: Path, replace: tuple[str, ...] = ()) -> Iterator[Path]:
    """Make a folder beside ``target`` that takes its name when the block succeeds, and is removed if it fails.

    An older folder is replaced only if it contains all files in ``replace``, which identify its kind; else raises
    ``UsageError``. An ``OSError`` of the block about a file in the new folder names the file by its final path.
    ``remove_stale_folders`` removes the remains of a killed process.
    """
    refuse_link(target)
    missing = [f" without {name!r} in it" for name in replace if not (target / name).exists()]
    if target.exists() and (missing or not replace):
        raise UsageError(f"{target}: exists already{''.join(missing[:1])}; it is not overwritten")
    target.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(target.parent) as beside:
        work, old = beside / "new" / target.name, beside / "old" / target.name
        work.mkdir(parents=True)
        old.parent.mkdir()
        try:
            with _rename_in_errors(work, target):
                yield work
            if target.exists():
                os.rename(target, old)
            os.rename(work, target)
        finally:
            restore(beside)  # interrupted between the two


@contextmanager
def new_file(target: Path) -> Iterator[Path]:
    """Give a path beside ``target`` whose file takes its name when the block succeeds, and is removed if it fails.

    The folder is made if missing. An ``OSError`` of the block about the file names it ``target``. A link named
    ``target`` is replaced, not followed; the new file has a random name, which nobody can have made a link.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
    try:
        with _rename_in_errors(part, target):
            os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            yield part
            part.replace(target)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def new_text(target: Path) -> Iterator[TextIO]:
    """Open a UTF-8 text stream that becomes a file as in ``new_file``, its line ends unchanged."""
    with new_file(target) as part, part.open("w", encoding="utf-8", newline="") as stream:
        yield stream


@contextmanager
def _rename_in_errors(part: Path, target: Path) -> Iterator[None]:
    """Name files by their final paths in an ``OSError``."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno in UNNAMED_WRITE_ERRORS:
            raise OSError(error.errno, error.strerror, str(target)) from error
        if isinstance(error.filename, str) and (file := Path(error.filename)).is_relative_to(part):
            error.filename = str(target / file.relative_to(part))
        raise


SQLITE_MAGIC = b"SQLite format 3\0"
APPLICATION_ID = slice(68, 72)
"""Place of the application id in the header, a big-endian number (SQLite's file format, 1.3)."""
SQLITE_LOG_SUFFIXES = ("-journal", "-wal", "-shm")
"""Suffixes of SQLite's files beside a database."""


def connect(
    path: Path, application: int, what: str, *, timeout: float, shared: bool = False, read_only: bool = False
) -> sqlite3.Connection:
    """Open a database of an application id, or a new file; another program's file stays unchanged.

    ``shared``: threads may share the connection. ``read_only``: nothing is changed or made. Raises ``InputError`` for
    links and for other programs' files, and ``sqlite3.Error``.
    """
    for file in (path, *(path.with_name(path.name + end) for end in SQLITE_LOG_SUFFIXES)):
        if file.is_symlink() or (file.exists() and not file.is_file()):
            raise InputError(file, "", "a link or a folder", f"{what}; move it away")
    if path.exists() and path.stat().st_size:
        with path.open("rb") as stream:
            head = stream.read(100)
        # 0: a file of ours whose first transaction is still in its log.
        if not head.startswith(SQLITE_MAGIC) or int.from_bytes(head[APPLICATION_ID], "big") not in (application, 0):
            raise InputError(path, "", "a file of another program", what)
    name = _read_only_uri(path) if read_only else path
    connection = sqlite3.connect(
        name, timeout=timeout, isolation_level=None, check_same_thread=not shared, uri=read_only
    )
    try:
        connection.execute("PRAGMA trusted_schema = OFF")
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        (found,) = connection.execute("PRAGMA application_id").fetchone()
        if tables and found != application:
            raise InputError(path, "", f"a database of another program ({found})", what)
    except BaseException:
        connection.close()
        raise
    return connection


def _read_only_uri(path: Path) -> str:
    """Return a URI for reading only; ``immutable`` keeps SQLite from adding files beside a database without a log."""
    log = path.with_name(f"{path.name}-wal")
    mode = "mode=ro" if log.exists() and log.stat().st_size else "immutable=1"
    return f"file:{quote(os.fsencode(path.absolute()))}?{mode}"
