"""Every reader of the package: how a valid input is written, and how it is read."""

from __future__ import annotations

from fuzz import clip_readers, dataset_readers, estimate_readers
from fuzz.reader import Reader

READERS: dict[str, Reader] = {**clip_readers.READERS, **estimate_readers.READERS, **dataset_readers.READERS}
"""By name."""
