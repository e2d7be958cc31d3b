"""Untrusted zip archives: neither listing their members nor unpacking these takes more memory than it should."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO

from getagrip.errors import InputError

MAX_ARCHIVE_MEMBERS = 100_000
ZIP_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compressions whose decompressors can be limited: 1 kB of the others may be gigabytes at once."""
ZIP_ENTRY_MAGIC = b"PK\x01\x02"
"""Begins each entry of an archive's list."""
ZIP_SEARCH_BYTES = 2**20
"""Bytes of an archive that are searched at once."""


def open_archive_bytes(path: Path | str, content: bytes) -> zipfile.ZipFile:
    """Open an archive in memory. Raises ``InputError`` for too many members, and what ``zipfile`` raises."""
    return _open_checked_archive(path, io.BytesIO(content))


@contextmanager
def open_archive_file(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive in a file. Raises as ``open_archive_bytes`` does, and ``OSError``."""
    with path.open("rb") as stream, _open_checked_archive(path, stream) as found:
        yield found


def _open_checked_archive(path: Path | str, stream: BinaryIO) -> zipfile.ZipFile:
    """Open the archive unless it has too many members: ``zipfile`` keeps all of them in memory."""
    entries, end = 0, b""
    while piece := stream.read(ZIP_SEARCH_BYTES):
        entries += (end + piece).count(ZIP_ENTRY_MAGIC)
        end = piece[1 - len(ZIP_ENTRY_MAGIC) :]
        if entries > MAX_ARCHIVE_MEMBERS:
            raise InputError(
                path, "", f"an archive of more than {MAX_ARCHIVE_MEMBERS} members", f"at most {MAX_ARCHIVE_MEMBERS}"
            )
    return zipfile.ZipFile(stream)


def open_archive_member(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> IO[bytes]:
    """Open a member, to be read piece by piece. Raises what ``zipfile`` raises."""
    if member.compress_type not in ZIP_COMPRESSIONS:
        raise NotImplementedError(f"{member.filename!r} is packed in another way than by deflate")
    return of.open(member)


def read_archive_member(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Read a member: as many bytes as the archive says, their checksum verified.

    Raises what ``zipfile`` raises.

    ``ZipFile.read`` unpacks up to 1 GB before it looks at how many there should be.
    """
    with open_archive_member(of, member) as stream:
        return stream.read(member.file_size)
