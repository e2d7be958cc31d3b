"""DexYCB: its visible stable grasps, or whole sequences; of every three subjects the first is for training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.experiments.sources.recorded import Recorded
from getagrip.experiments.sources.timelines import Timelines

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


@dataclass(frozen=True)
class DexYcbTimelines(Timelines, DexYcb):
    """DexYCB's sequences, not cut, with their true segments."""

    def reader(self, root: Path) -> Dataset:
        from getagrip.datasets.dexycb import reader

        return reader.DexYcb(root=root, meshes=self.meshes, timelines=True)


@dataclass(frozen=True)
class DexYcbSequences(DexYcbTimelines):
    """The same, for grasps that are to be found."""

    preset: str = "none"
    """Noise of hands and masks, of ``NOISE``."""

    def __post_init__(self) -> None:
        from getagrip.datasets.synthetic.noise import NOISE

        self.check(NOISE)
