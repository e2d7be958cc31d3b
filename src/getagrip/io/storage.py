"""Folders in object stores, by fsspec: ``s3://bucket/folder``, ``gs://...``, ``https://...`` and its other protocols.

Their content is untrusted, as files are: sizes are bounded before memory is taken, and names stay inside the folder. An
HTTP response is no longer than requested, and comes from the requested server.
"""

from __future__ import annotations

import functools
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit
from zipfile import ZipFile, ZipInfo

from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.io import files, plugins

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

HTTP_PROTOCOLS = ("http", "https")
MAX_LISTING_BYTES = 64 * 2**20
"""Limit of a response to a request without a range, such as a folder's page."""


def fsspec_options(url: str) -> dict[str, object]:
    """Return fsspec's options for the protocols in an address; empty if all defaults are right."""
    kinds = [kind for kind in HTTP_PROTOCOLS if re.search(rf"(^|::){kind}://", url)]
    return {kind: {"client_kwargs": _client_arguments()} for kind in kinds}


def asked_bytes(headers: Mapping[str, str]) -> int | None:
    """Return the number of bytes that a request asks for; None without a range."""
    asked = re.fullmatch(r"bytes=(\d+)-(\d+)", headers.get("Range", ""))
    return None if asked is None else int(asked[2]) - int(asked[1]) + 1


@functools.cache
def _client_arguments() -> dict[str, object]:
    """Arguments of aiohttp's ``ClientSession``."""
    import aiohttp

    class Bounded(aiohttp.ClientResponse):  # type: ignore[misc]
        """A response, read up to the requested length: servers may ignore ranges, and bodies may be endless."""

        _body: bytes | None = None

        async def read(self) -> bytes:
            body = self._body
            if body is None:
                asked = asked_bytes(self.request_info.headers)
                left = MAX_LISTING_BYTES + 1 if asked is None else asked
                parts: list[bytes] = []
                while left and (part := await self.content.read(left)):
                    parts.append(part)
                    left -= len(part)
                if not left:
                    self.close()
                    if asked is None:
                        got = f"more than {MAX_LISTING_BYTES} bytes"
                        raise InputError(str(self.url), "", got, "at most that in a listing")
                self._body = body = b"".join(parts)
            return body

    async def same_server(session: object, context: object, redirect: aiohttp.TraceRequestRedirectParams) -> None:
        target = redirect.response.headers.get("Location") or redirect.response.headers.get("URI") or ""
        if redirect.url.join(type(redirect.url)(target)).origin() != redirect.url.origin():
            raise InputError(str(redirect.url), "", f"a redirect to {target[:200]!r}", "files of the same server")

    trace = aiohttp.TraceConfig()
    trace.on_request_redirect.append(same_server)
    return {"response_class": Bounded, "trace_configs": [trace]}


STORE_EXTRAS = {"s3": "s3", "s3a": "s3", "gs": "gs", "gcs": "gs"}
"""This package's extra for each protocol."""
MAX_REMOTE_FILES, MAX_REMOTE_BYTES, MAX_REMOTE_DEPTH = 20_000, files.MAX_FILE_BYTES, 8
"""Limits of a copied folder: files, bytes in all, and levels."""
ARCHIVE_SUFFIX = ".zip"
"""Suffix of a clip stored as a single object."""
WRITE_TEST_NAME = ".getagrip.trial"
"""Name of an object that is written and removed to test for permission."""


@dataclass(frozen=True)
class RemotePath:
    """A folder or an object in an object store. Every method raises ``GetagripError`` if the store fails."""

    url: str
    """Without a slash at its end."""

    def __truediv__(self, name: str) -> RemotePath:
        return RemotePath(f"{self.url}/{name}")

    def __str__(self) -> str:
        return self.url

    @property
    def name(self) -> str:
        """The last part of the address."""
        return self.url.rpartition("/")[2]

    @property
    def parent(self) -> RemotePath:
        """The containing folder."""
        return RemotePath(self.url.rpartition("/")[0])

    def children(self) -> list[tuple[str, bool]]:
        """List the names in the folder, sorted, and whether each is a folder. Raises ``UsageError`` if missing."""
        with self._named():
            fs, path = self._opened()
            try:
                entries = fs.ls(path, detail=True)
            except FileNotFoundError as error:
                raise UsageError(f"{self}: no such folder or bucket") from error
            found = ((str(entry["name"]).rstrip("/").rpartition("/")[2], entry["type"]) for entry in entries)
            return sorted((name, kind == "directory") for name, kind in found if name and name != self.name)

    def matches(self) -> list[RemotePath]:
        """List the addresses that match this one as a pattern, sorted."""
        with self._named():
            fs, path = self._opened()
            return sorted((RemotePath(fs.unstrip_protocol(found)) for found in fs.glob(path)), key=str)

    def read(self, limit: int) -> bytes | None:
        """Read an object of at most ``limit`` bytes; None if it is missing."""
        with self._named():
            fs, path = self._opened()
            try:
                content = fs.cat_file(path, start=0, end=limit + 1)
            except FileNotFoundError:
                return None
        if len(content) > limit:
            raise InputError(self.url, "", f"more than {limit} bytes", f"at most {limit} bytes")
        return bytes(content)

    def write(self, content: bytes) -> None:
        """Make or replace an object, whole."""
        with self._named():
            fs, path = self._opened()
            fs.pipe_file(path, content)

    def remove(self) -> None:
        """Remove an object."""
        with self._named():
            fs, path = self._opened()
            fs.rm_file(path)

    def copy_to(self, folder: Path, leave_out: Sequence[str] = ()) -> None:
        """Copy the folder into a new local one, except for files and folders named in ``leave_out``.

        Raises ``InputError`` for names that lead out, too large folders, and changes during the copy.
        """
        with self._named():
            fs, root = self._opened()
            before = self._listed(fs, root, leave_out)
            contents = self._contents(fs, {name: (entry["name"], entry["size"]) for name, entry in before.items()})
            if self._listed(fs, root, leave_out) != before:
                raise self._changed_error()
        _write_folder_files(folder, contents)

    def unpack_to(self, folder: Path, leave_out: Sequence[str] = ()) -> None:
        """Copy a zip archive's files into a new folder, as ``copy_to`` does; a folder around all of them is dropped.

        Also raises ``InputError`` for damaged archives, links in them, and duplicate names.
        """
        from getagrip.io import arrays

        content = self.read(MAX_REMOTE_BYTES)
        if content is None:
            raise InputError(self.url, "", "no such archive", "a zip archive")
        try:
            with arrays.open_archive_bytes(self.url, content) as archive:
                members = self._members(archive, leave_out)
                contents = {name: arrays.read_archive_member(archive, member) for name, member in members.items()}
        except InputError:
            raise
        except Exception as error:  # zipfile and its decompressors raise many types
            raise InputError(self.url, "", f"a file that does not unpack ({error})", "a zip archive") from error
        _write_folder_files(folder, contents)

    def fetch(self, names: Sequence[str], limit: int, folder: Path) -> None:
        """Copy objects of the folder by name, in parallel; objects missing or above ``limit`` bytes are skipped."""
        with self._named():
            fs, root = self._opened()
            paths = [f"{root}/{name}" for name in names]
            contents = fs.cat_ranges(paths, [0] * len(paths), [limit + 1] * len(paths), on_error="return")
        found = {name: c for name, c in zip(names, contents, strict=True) if not isinstance(c, Exception)}
        _write_folder_files(folder, {name: bytes(c) for name, c in found.items() if len(c) <= limit})

    def check_writable(self, option: str) -> None:
        """Raise ``UsageError``, in the name of an option, if the folder is not writable."""
        trial = self / WRITE_TEST_NAME
        try:
            trial.write(b"")
            trial.remove()
        except UsageError:
            raise
        except GetagripError as error:
            raise UsageError(f"{option} must be a folder that can be written (got {self}: {error})") from error

    def _listed(self, fs: AbstractFileSystem, root: str, leave_out: Sequence[str]) -> dict[str, files.Json]:
        """Return the store's checked record of each file in the folder, by name."""
        found = fs.find(root, detail=True).items()
        there = {name.removeprefix(f"{root}/"): entry for name, entry in found if name.startswith(f"{root}/")}
        is_file = {name: entry["type"] == "file" and not name.endswith("/") for name, entry in there.items()}
        wanted = {name: there[name] for name in select_names(self.url, filter(is_file.get, there), leave_out)}
        check_size(self.url, [entry["size"] for entry in wanted.values()])
        return wanted

    def _members(self, archive: ZipFile, leave_out: Sequence[str]) -> dict[str, ZipInfo]:
        """List an archive's files by name, checked, without a folder around all of them."""
        members = [member for member in archive.infolist() if not member.is_dir()]
        if any(stat.S_ISLNK(member.external_attr >> 16) for member in members):
            raise InputError(self.url, "", "a link in it", "files only")
        tops = {member.filename.partition("/")[0] + "/" for member in members}
        shared = tops.pop() if len(tops) == 1 else ""
        by_name = {member.filename.removeprefix(shared): member for member in members}
        if len(by_name) < len(members):
            raise InputError(self.url, "", "a name twice", "each file once")
        wanted = {name: by_name[name] for name in select_names(self.url, by_name, leave_out)}
        check_size(self.url, [member.file_size for member in wanted.values()])
        return wanted

    def _contents(self, fs: AbstractFileSystem, wanted: Mapping[str, tuple[str, int]]) -> dict[str, bytes]:
        """Read files by name, given the path and size of each, in parallel."""
        full = {name: place for name, place in wanted.items() if place[1]}  # an empty file has no range
        paths, sizes = [path for path, _ in full.values()], [size for _, size in full.values()]
        contents = fs.cat_ranges(paths, [0] * len(paths), [size + 1 for size in sizes], on_error="raise")
        if [len(content) for content in contents] != sizes:
            raise self._changed_error()
        return dict.fromkeys(wanted, b"") | dict(zip(full, map(bytes, contents), strict=True))

    def _changed_error(self) -> InputError:
        return InputError(self.url, "", "files that changed while they were read", "a folder that stays as it is")

    def _opened(self) -> tuple[AbstractFileSystem, str]:
        """Open the file system; also return the path in it. Raises ``UsageError`` if its library is missing."""
        kind = self.url.split(":", 1)[0]
        extra = STORE_EXTRAS.get(kind, "s3")  # every extra includes fsspec
        core = plugins.import_extra("fsspec.core", extra, self.url)
        try:
            fs, path = core.url_to_fs(self.url, use_listings_cache=False, **fsspec_options(self.url))
        except ImportError as error:
            advice = plugins.install_command(extra) if kind in STORE_EXTRAS else "install fsspec's library for it"
            raise UsageError(f"missing library for {kind}:// ({error}), which {self} needs: {advice}") from error
        except ValueError as error:
            known = "those that fsspec knows, such as s3:// and gs://"
            raise UsageError(f"unknown kind of address {kind!r} of {self}; choose from {known}") from error
        return fs, str(path).rstrip("/")

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Convert the libraries' errors to ``GetagripError`` with the address."""
        try:
            yield
        except GetagripError:
            raise
        except Exception as error:
            words = " ".join(str(error).split())[:300]
            if isinstance(error, FileNotFoundError):
                raise GetagripError(f"{self}: no such file, folder or bucket ({words})") from error
            raise GetagripError(f"{self}: it cannot be reached ({type(error).__name__}: {words})") from error


Place = Path | RemotePath
"""A folder, local or in an object store."""


def parse_place(text: str) -> Place:
    """Parse a path or an address; ``file://`` addresses are local paths."""
    kind, mark, rest = text.partition("://")
    if not mark:
        return Path(text)
    if kind == "file":
        return Path(unquote(urlsplit(text).path))
    return RemotePath(f"{kind}://{rest.rstrip('/')}")


def select_names(source: str, names: Iterable[str], leave_out: Sequence[str]) -> list[str]:
    """List the names of an untrusted folder, except for hidden ones and ``leave_out``. Raises ``InputError``."""
    wanted = []
    for name in names:
        parts = name.split("/")
        if parts[0] in leave_out or any(part.startswith(".") and part not in (".", "..") for part in parts):
            continue
        if len(parts) > MAX_REMOTE_DEPTH or not all(map(files.is_portable_name, parts)):
            raise InputError(source, "", f"the name {files.shorten_value(name)}", "names of files inside the folder")
        wanted.append(name)
    return wanted


def check_size(source: str, sizes: Sequence[int]) -> None:
    """Raise ``InputError`` for a folder of too many files, or too many bytes in all."""
    if len(sizes) > MAX_REMOTE_FILES or sum(sizes) > MAX_REMOTE_BYTES:
        got = f"{len(sizes)} files of {sum(sizes)} bytes"
        raise InputError(source, "", got, f"at most {MAX_REMOTE_FILES} files of {MAX_REMOTE_BYTES} bytes")


def require_local_path(option: str, value: Place) -> Path:
    """Return the local path of an option that takes no address. Raises ``UsageError``."""
    if isinstance(value, RemotePath):
        raise UsageError(f"{option} cannot be used with {value}, only with folders on a disk")
    return value


def _write_folder_files(folder: Path, contents: Mapping[str, bytes]) -> None:
    for name, content in contents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_bytes(path, content)
