"""Zip archives from strangers: neither listing their members nor unpacking these takes more memory than it should."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import IO

from getagrip.errors import InputError

MOST_MEMBERS = 100_000
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Ways of packing whose decompressors can be told how much to give: 1 kB of the others is gigabytes at once."""
ENTRY = b"PK\x01\x02"
"""Begins each entry of an archive's list."""


def archive(path: Path | str, content: bytes) -> zipfile.ZipFile:
    """An archive in memory. Raises ``InputError`` for too many members, and what ``zipfile`` raises."""
    if content.count(ENTRY) > MOST_MEMBERS:  # zipfile keeps all of them
        raise InputError(path, "", f"an archive of more than {MOST_MEMBERS} members", "at most so many")
    return zipfile.ZipFile(io.BytesIO(content))


def opened(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> IO[bytes]:
    """A member to be read piece by piece. Raises what ``zipfile`` raises."""
    if member.compress_type not in METHODS:
        raise NotImplementedError(f"{member.filename!r} is packed in another way than by deflate")
    return of.open(member)


def content_of(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """The bytes of a member, as many as the archive says, their checksum verified. Raises what ``zipfile`` raises.

    ``ZipFile.read`` unpacks up to 1 GB before it looks at how many there should be.
    """
    with opened(of, member) as stream:
        return stream.read(member.file_size)
