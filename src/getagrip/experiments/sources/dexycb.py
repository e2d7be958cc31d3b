"""DexYCB: its visible stable grasps, or whole sequences; of every three subjects the first is for training."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.errors import UsageError
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


@dataclass(frozen=True)
class DexYcbTimelines(DexYcb):
    """DexYCB's sequences, not cut, with their true segments."""

    preset: str = "all"
    """Level of noise, of ``timeline_trials.LEVELS``: it is added when a sequence is read, the clips are without."""

    def __post_init__(self) -> None:
        from getagrip.experiments.timeline_trials import ALL, LEVELS

        self.check((ALL, *LEVELS))

    def check(self, presets: Collection[str]) -> None:
        """Raise ``UsageError`` for a preset that is none of these."""
        if self.preset not in presets:
            raise UsageError(f"--preset: got {self.preset!r}, expected one of {', '.join(presets)}")

    def claim(self, clips: Path) -> None:
        super(DexYcbTimelines, replace(self, preset=type(self).preset)).claim(clips)

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
