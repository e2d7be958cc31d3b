"""Untrusted files, read within limits; folders written whole or not at all.

Nothing here trusts what a file says about itself: sizes are checked before memory is taken, no pickle is ever run, and
names found in files are used as paths only once they are known to stay inside their folder.

Locks on files and folders. The kernel drops a lock with the process that holds it, however that ends.

Folders in which something is written before it takes its place, and what remains of them when a writer is killed.

A writer holds a lock on its folder as long as it lives, so a folder whose lock can be had is nobody's. Where there are
no locks, nothing is swept; where a file system has none, a folder looks alive to nobody.

SQLite files of ours, opened only once it is known that they are ours: folders of strangers may hold other files.
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
"""True if this system has locks."""


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Hold the lock of a file or folder, after waiting for it; go on without where it cannot be locked."""
    lock = acquire_lock(path, wait=True)
    try:
        yield
    finally:
        release_lock(lock)


def acquire_lock(path: Path, wait: bool) -> int | None:
    """Lock a file or folder until the descriptor is closed; None where it cannot be locked.

    Raises ``OSError`` where it is not there, and where it is locked already and we do not ``wait``.
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
    """Give back what ``acquire_lock`` has returned."""
    if lock is not None:
        os.close(lock)


TEMPORARY_FOLDER_PREFIX = ".getagrip.new."
"""Prefix of the folders' names."""


@contextmanager
def temporary_folder(parent: Path) -> Iterator[Path]:
    """Make an empty hidden folder, which is removed in the end."""
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
    """Put what stands in ``old/`` of a workplace back where it was, unless something newer has taken its place."""
    if (folder / "old").is_symlink():  # a stranger's: what it leads to stays where it is
        return
    for old in (folder / "old").glob("*"):
        target = folder.parent / old.name
        if not os.path.lexists(target):
            os.rename(old, target)


def remove_stale_folders(parent: Path) -> list[Path]:
    """Remove this user's workplaces whose writers are dead, and return them; restore folders being replaced."""
    swept = []
    for folder in parent.glob(f"{TEMPORARY_FOLDER_PREFIX}*") if HAS_FILE_LOCKS else ():
        if folder.is_symlink() or not folder.is_dir():
            continue
        try:
            if folder.stat().st_uid != os.geteuid():
                continue
            lock = acquire_lock(folder, wait=False)
        except OSError:  # it lives, or is another user's, or gone
            continue
        try:
            restore(folder)
            shutil.rmtree(folder, ignore_errors=True)
            swept.append(folder)
        finally:
            release_lock(lock)
    return swept


Json = dict[str, Any]
"""A JSON object: whoever reads one checks its values."""
MAX_JSON_BYTES = 64 * 2**20
MAX_FILE_BYTES = 2**30
"""Limits in bytes."""
BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"), (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
"""How texts begin that say how they are encoded."""
FORBIDDEN_NAME_CHARS = {*"/\\"} | ({*'<>:"|?*'} if os.name == "nt" else set())
"""Letters of no name here."""
WINDOWS_DEVICE_NAME = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?$", re.IGNORECASE)
"""Names that Windows opens as devices, in every folder and with any suffix."""
UNNAMED_WRITE_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors of writing that come without a file's name."""


def shorten_value(value: object) -> str:
    """Shorten a value for an error message, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."


def printable(text: str) -> str:
    """Shorten a name from a file for an error message, on one line and without quotes."""
    return shorten_value(text)[1:-1]


def is_portable_name(name: str) -> bool:
    """Return whether a text can name a file or folder.

    It must be printable, of 1 to 200 bytes, without separators, not hidden and not ``..``. So that a folder can be
    moved to Windows, it is none of the names of devices there and ends in no dot.
    """
    plain = (
        name.isprintable()
        and name == name.strip()
        and not name.startswith((".", "~"))
        and not FORBIDDEN_NAME_CHARS & {*name}
    )
    return plain and not name.endswith(".") and not WINDOWS_DEVICE_NAME.match(name) and 0 < len(name.encode()) <= 200


def list_files(folder: Path, suffixes: Collection[str] = (), pattern: str = "*") -> list[Path]:
    """List the files in a folder that end in one of some ``suffixes``, in any case, by name.

    Files that begin with a dot are no content: other systems leave them beside each file, as ``._000001.jpg``.
    """
    found = (path for path in folder.glob(pattern) if not path.name.startswith("."))
    return sorted(path for path in found if path.is_file() and (not suffixes or path.suffix.lower() in suffixes))


def folders_in(folder: Path) -> list[Path]:
    """List the folders in a folder, by name; but those that begin with a dot."""
    inside = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in inside if path.is_dir() and not path.name.startswith("."))


def inside(folder: Path, relative: str, key: str, what: str, source: Path | None = None) -> Path:
    """Return the file ``folder/relative``, which must exist and lie in the folder, links followed.

    Raises ``InputError``, in the name of the file ``source`` where the path was read from one.
    """
    named = source or folder / relative
    parts = PurePosixPath(relative)
    if not relative or "\0" in relative or "\\" in relative or parts.is_absolute() or ".." in parts.parts:
        raise InputError(named, key, f"the path {shorten_value(relative)}", f"{what} inside the folder")
    path = folder / relative
    try:
        leaves = not os.path.realpath(path).startswith(os.path.join(os.path.realpath(folder), ""))
        there = path.is_file()
    except OSError as error:  # names that are too long, no permission
        raise InputError(named, key, f"the path {shorten_value(relative)} ({error.strerror})", what) from error
    if leaves:
        raise InputError(
            named, key, f"the path {shorten_value(relative)}, which leads out", f"{what} inside the folder"
        )
    if not there:
        raise InputError(path, "" if source is None else key, "no such file", what)
    return path


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
    """Return a text in UTF-8 without the mark that says how it is encoded, as Windows writes it: also from UTF-16."""
    for mark, encoding in BYTE_ORDER_MARKS:
        if content.startswith(mark):
            return content[len(mark) :] if encoding == "utf-8" else content.decode(encoding, "replace").encode()
    return content


def read_text(path: Path, limit: int = MAX_FILE_BYTES) -> str:
    """Read a text of at most ``limit`` bytes, encoded as its mark says, else in UTF-8. Raises ``InputError``."""
    return strip_byte_order_mark(read_bytes(path, limit)).decode(errors="replace")


def read_json(path: Path) -> Json:
    """Read a JSON object. Raises ``InputError`` for anything else, and as ``read_any_json`` does."""
    content = read_any_json(path)
    if not isinstance(content, dict):
        raise InputError(path, "", f"a JSON {type(content).__name__}", "a JSON object")
    return content


def read_any_json(path: Path, *, nan: bool = False) -> object:
    """Read a JSON file. Raises ``InputError``, also for duplicate keys and for infinite numbers and, but ``nan``, NaN.

    Python writes NaN for numbers that are missing.
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
        raise InputError(path, "", f"text that is no JSON ({error})", "JSON") from error


def write_csv(path: Path, rows: Iterable[Iterable[object]]) -> None:
    """Write a table, its headings first. Whoever reads the file meanwhile sees the old one or the new one."""
    with new_text(path) as stream:
        CsvTable(stream).write_rows(rows)


def csv_rows(path: Path, content: bytes, what: str) -> tuple[list[str], list[tuple[str, dict[str, str]]]]:
    """Read a CSV table: its heads, and its rows by head, each with the words that begin its key: "line 7, ".

    ``what`` the file should be, in words. Raises ``InputError`` for what is no CSV in UTF-8, and for ragged rows.
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
        raise InputError(path, "", f"text that is no CSV ({error})", what) from error
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
    """Write a text as it is, in UTF-8, likewise."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: Mapping[str, object] | Sequence[object]) -> None:
    """Write a JSON object or list, its folder made where there is none.

    Arrays become lists, numbers that are not finite become null.
    """
    write_bytes(path, (to_json(content) + "\n").encode())


def to_json(content: Mapping[str, object] | Sequence[object]) -> str:
    """Write a JSON object or list as a text, as ``write_json`` does into a file."""
    return replace_surrogates(json.dumps(_to_json_types(content), indent=2, ensure_ascii=False, allow_nan=False))


def _to_json_types(value: object) -> object:
    """Convert content to JSON's own types."""
    if hasattr(value, "tolist"):  # numpy's, which need not be loaded here
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
    """Raise ``UsageError``, in the name of an option, where a folder cannot be made or written; leaves no trace."""
    try:
        there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        os.rmdir(
            tempfile.mkdtemp(prefix=".getagrip.", dir=there)
        )  # permissions alone are not enough: /proc, full disks
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"{option} must be a folder that can be written (got {folder}: {reason})") from error


def check_file(option: str, file: Path) -> None:
    """Raise ``UsageError``, in the name of an option, where a file cannot be written; leaves no trace.

    Its folder need not be there yet: whoever writes the file makes it.
    """
    check_folder(option, file.parent)
    try:
        if file.exists() and not file.is_symlink():  # a link is replaced
            file.open("ab").close()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"{option} must be a file that can be written (got {file}: {reason})") from error


def refuse_link(path: Path) -> None:
    """Raise ``UsageError`` where a folder in which something is to be written is a link."""
    if path.is_symlink():
        raise UsageError(f"{path} must be a folder or a free name (got a link, and nothing is written through one)")


def folder_inside(folder: Path, *names: str) -> Path:
    """Return a folder in another, each of ``names`` in the one before, made where there is none.

    ``folder`` itself may be a link: the user names it. Raises ``UsageError`` where a name is that of a link.
    """
    for name in names:
        folder /= name
        refuse_link(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def new_folder(target: Path, replace: tuple[str, ...] = ()) -> Iterator[Path]:
    """Make a folder beside ``target`` that takes its name when the block ends well, and is removed if not.

    An older folder is replaced only where it holds all that ``replace`` names: files that every such folder holds, and
    none that was named by mistake. Raises ``UsageError`` for another. An ``OSError`` of the block about a file in the
    folder names it by the path that it was to have. What a killed process leaves, ``leftovers.sweep`` removes.
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
    """Give a path beside ``target`` whose file takes its place when the block ends well, and is removed if not.

    The folder is made where there is none. An ``OSError`` of the block about the file names it ``target``. A link of
    that name is replaced, not followed; the new file has a random name, where nobody can have put a link.
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
    """Open a UTF-8 text stream that becomes a file as ``new_file`` does; line ends stay as written."""
    with new_file(target) as part, part.open("w", encoding="utf-8", newline="") as stream:
        yield stream


@contextmanager
def _rename_in_errors(part: Path, target: Path) -> Iterator[None]:
    """Give the files that an ``OSError`` is about the names that they were to have."""
    try:
        yield
    except OSError as error:
        if (
            error.filename is None and error.errno in UNNAMED_WRITE_ERRORS
        ):  # Python and libraries do not say which file they wrote
            raise OSError(error.errno, error.strerror, str(target)) from error
        if isinstance(error.filename, str) and (file := Path(error.filename)).is_relative_to(part):
            error.filename = str(target / file.relative_to(part))
        raise


SQLITE_MAGIC = b"SQLite format 3\0"
APPLICATION_ID = slice(68, 72)
"""Bytes at a file's start that say which application made it, as a big-endian number (SQLite's file format, 1.3)."""
SQLITE_LOG_SUFFIXES = ("-journal", "-wal", "-shm")
"""Suffixes of the files that SQLite writes beside a database."""


def connect(
    path: Path, application: int, what: str, *, timeout: float, shared: bool = False, read_only: bool = False
) -> sqlite3.Connection:
    """Open a database of an application, or a new file; nothing of another's is changed.

    ``shared``: threads may share the connection. ``read_only``: nothing is changed or made. Raises ``InputError`` for
    links and for files of something else, and ``sqlite3.Error``.
    """
    for file in (path, *(path.with_name(path.name + end) for end in SQLITE_LOG_SUFFIXES)):
        if file.is_symlink() or (file.exists() and not file.is_file()):
            raise InputError(file, "", "a link or a folder", f"{what}; move it away")
    if path.exists() and path.stat().st_size:
        with path.open("rb") as stream:
            head = stream.read(100)
        # 0 is that of a file of ours whose first transaction is still beside it.
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
    """Return an address that opens a file for reading only: SQLite would leave new files beside one without a log."""
    log = path.with_name(f"{path.name}-wal")
    mode = "mode=ro" if log.exists() and log.stat().st_size else "immutable=1"
    return f"file:{quote(os.fsencode(path.absolute()))}?{mode}"
