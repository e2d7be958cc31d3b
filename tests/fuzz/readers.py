"""Every reader of the package: how a valid input is written, and how it is read."""

from __future__ import annotations

from fuzz import clip_readers, dataset_readers, estimate_readers, service_readers, uncut_readers
from fuzz.reader import Reader

READERS: dict[str, Reader] = {
    name: reader
    for kind in (clip_readers, uncut_readers, estimate_readers, dataset_readers, service_readers)
    for name, reader in kind.READERS.items()
}
"""By name."""
