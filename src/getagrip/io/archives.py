"""Untrusted zip archives: neither listing their members nor unpacking these takes more memory than it should."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO

from getagrip.errors import InputError

MOST_MEMBERS = 100_000
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compressions whose decompressors can be limited: 1 kB of the others may be gigabytes at once."""
ENTRY = b"PK\x01\x02"
"""Begins each entry of an archive's list."""
PIECE = 2**20
"""Bytes of an archive that are searched at once."""


def archive(path: Path | str, content: bytes) -> zipfile.ZipFile:
    """Open an archive in memory. Raises ``InputError`` for too many members, and what ``zipfile`` raises."""
    return _of_few(path, io.BytesIO(content))


@contextmanager
def archive_at(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive in a file. Raises as ``archive`` does, and ``OSError``."""
    with path.open("rb") as stream, _of_few(path, stream) as found:
        yield found


def _of_few(path: Path | str, stream: BinaryIO) -> zipfile.ZipFile:
    """Open the archive unless it has too many members: ``zipfile`` keeps all of them in memory."""
    entries, end = 0, b""
    while piece := stream.read(PIECE):
        entries += (end + piece).count(ENTRY)
        end = piece[1 - len(ENTRY) :]
        if entries > MOST_MEMBERS:
            raise InputError(path, "", f"an archive of more than {MOST_MEMBERS} members", f"at most {MOST_MEMBERS}")
    return zipfile.ZipFile(stream)


def opened(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> IO[bytes]:
    """Open a member, to be read piece by piece. Raises what ``zipfile`` raises."""
    if member.compress_type not in METHODS:
        raise NotImplementedError(f"{member.filename!r} is packed in another way than by deflate")
    return of.open(member)


def content_of(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Read a member: as many bytes as the archive says, their checksum verified.

    Raises what ``zipfile`` raises.

    ``ZipFile.read`` unpacks up to 1 GB before it looks at how many there should be.
    """
    with opened(of, member) as stream:
        return stream.read(member.file_size)
