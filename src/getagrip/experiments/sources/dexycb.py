"""DexYCB: its visible stable grasps, or whole sequences; of every three subjects the first is for training."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from getagrip.experiments.sources.recorded import Recorded
from getagrip.experiments.sources.timelines import Preset, Timelines
from getagrip.io.arguments import OptionalFolder

if TYPE_CHECKING:
    from getagrip.datasets.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class DexYcb(Recorded):
    """DexYCB's visible stable grasps."""

    dataset: ClassVar[str] = "dexycb"

    meshes: OptionalFolder = None
    """The folder of the YCB models, where they are not in --root."""

    def reader(self, root: Path) -> Dataset:
        from getagrip.datasets.dexycb import reader

        return reader.DexYcb(root=root, meshes=self.meshes)


@dataclass(frozen=True, kw_only=True)
class DexYcbTimelines(Timelines, DexYcb):
    """DexYCB's uncut sequences, with their true segments."""

    dataset: ClassVar[str] = "dexycb-timelines"

    def reader(self, root: Path) -> Dataset:
        from getagrip.datasets.dexycb import reader

        return reader.DexYcb(root=root, meshes=self.meshes, timelines=True)


@dataclass(frozen=True, kw_only=True)
class DexYcbSequences(DexYcbTimelines):
    """DexYCB's uncut sequences; grasps are found without 3D labels."""

    dataset: ClassVar[str] = "dexycb-segments"
    preset: Preset = "none"
    """Noise of hands and masks: none, moderate, strong or estimated."""

    def presets(self) -> Collection[str]:
        from getagrip.datasets.synthetic.noise import NOISE

        return NOISE
