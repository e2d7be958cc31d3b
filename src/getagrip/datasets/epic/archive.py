"""EPIC-KITCHENS' images in the archives that it ships (``P01/rgb_frames/P01_01.tar``), read where they lie in them.

Nothing is unpacked: headers are skipped through once, names only looked at for the number in ``frame_0000000001.jpg``.
"""

from __future__ import annotations

import re
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from getagrip.errors import InputError

BLOCK = tarfile.BLOCKSIZE
FRAME = re.compile(r"(?:.*/)?frame_(\d{10})\.jpg")
NO_TAR = "an archive of frames (.tar), not compressed"


@dataclass(frozen=True)
class Archive:
    """An uncompressed ``.tar`` of frames."""

    path: Path

    @cached_property
    def places(self) -> dict[int, tuple[int, int]]:
        """Where the image of each frame begins, and its size in bytes. Raises ``InputError``."""
        try:
            return dict(self._members())
        except (OSError, tarfile.TarError) as error:
            raise InputError(self.path, "", f"a file that is damaged or no archive ({error})", NO_TAR) from error

    def _members(self) -> Iterator[tuple[int, tuple[int, int]]]:
        length = self.path.stat().st_size
        with self.path.open("rb") as file:
            at = 0
            while at + BLOCK <= length:
                file.seek(at)
                header = file.read(BLOCK)
                if not header.strip(b"\0"):  # the end is marked by empty blocks
                    return
                member = tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
                if not 0 <= member.size <= length:
                    raise InputError(self.path, "", f"a member of {member.size} bytes", f"{length} at most")
                named = FRAME.fullmatch(member.name)
                if named and member.isreg():
                    yield int(named[1]), (at + BLOCK, member.size)
                at += BLOCK + -(-member.size // BLOCK) * BLOCK

    def read(self, number: int, limit: int) -> bytes:
        """The file of a frame, of at most ``limit`` bytes. Raises ``InputError``."""
        key = f"frame_{number:010d}.jpg"
        if number not in self.places:
            raise InputError(self.path, key, "no such file in it", "the frame")
        begin, size = self.places[number]
        if size > limit:
            raise InputError(self.path, key, f"{size} bytes", f"at most {limit}")
        with self.path.open("rb") as file:
            file.seek(begin)
            content = file.read(size)
        if len(content) < size:
            raise InputError(self.path, key, "an archive that is cut short", "the whole archive")
        return content
