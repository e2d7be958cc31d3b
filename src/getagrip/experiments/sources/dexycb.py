"""DexYCB: its visible stable grasps; of every three subjects the first is for training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.errors import UsageError
from getagrip.experiments.sources.source import ClipSource, Sample

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome


@dataclass(frozen=True)
class DexYcb(ClipSource):
    """DexYCB's grasps, imported where that is not done yet."""

    root: Path | None = None
    """Where the dataset is."""
    meshes: Path | None = None
    """Where the YCB models are; None: in ``root``."""

    def samples(self, clips: Path, debug: bool) -> tuple[list[Sample], list[Outcome]]:
        from getagrip.batch.imports import import_clips
        from getagrip.batch.job import by_name
        from getagrip.datasets.dexycb import reader

        if self.root is None:
            raise UsageError("--root: got nothing, expected the folder of DexYCB")
        self.claim(clips)
        done = clips / "imported"
        if not done.exists() and import_clips(reader.DexYcb(root=self.root, meshes=self.meshes), clips, debug) == 0:
            done.touch()  # else what failed is tried again next time
        found, failed = by_name([clips])
        subjects = sorted({reader.subject_of(name) for name in found})
        train = subjects[::3]
        split = {"train": train, "test": [s for s in subjects if s not in train], "all": subjects}[self.split]
        return [Sample(name, path) for name, path in sorted(found.items()) if reader.subject_of(name) in split], failed
