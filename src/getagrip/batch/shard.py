"""A part of the work, for one of several machines."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

from getagrip.errors import UsageError


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of all clips, by their names: which one a clip is in depends on nothing else."""

    index: int = 1
    """1 to ``count``."""
    count: int = 1

    @classmethod
    def of(cls, text: str) -> Shard:
        """Parse "i/N". Raises ``UsageError``."""
        index, slash, count = text.partition("/")
        if not (slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
            raise UsageError(f"--shard must be i/N with i from 1 to N, such as 2/4 (got {text})")
        return cls(int(index), int(count))

    def __contains__(self, name: str) -> bool:
        return crc32(name.encode()) % self.count == self.index - 1


ALL = Shard()
"""Every clip."""
