"""DexYCB: its visible stable grasps; of every three subjects the first is for training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.experiments.sources.recorded import Recorded

if TYPE_CHECKING:
    from getagrip.datasets.dataset import Dataset


@dataclass(frozen=True)
class DexYcb(Recorded):
    """DexYCB's grasps."""

    meshes: Path | None = None
    """Where the YCB models are; None: in ``root``."""

    def reader(self, root: Path) -> Dataset:
        from getagrip.datasets.dexycb import reader

        return reader.DexYcb(root=root, meshes=self.meshes)
