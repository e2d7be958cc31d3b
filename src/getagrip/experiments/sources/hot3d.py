"""HOT3D: interactions as timelines; of every three people the first is for training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from getagrip.experiments.sources.timelines import Timelines

if TYPE_CHECKING:
    from getagrip.datasets.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class Hot3dTimelines(Timelines):
    """HOT3D's timelines by the true poses; the head moves."""

    dataset: ClassVar[str] = "hot3d-timelines"

    def reader(self, root: Path) -> Dataset:
        from getagrip.datasets.hot3d import reader

        return reader.Hot3d(root=root, timelines=True)
