"""ARCTIC's motion as ArtiGrasp's repository holds it, hands as recorded or as estimated from images."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import arg

from getagrip.experiments.sources.recorded import Recorded

if TYPE_CHECKING:
    from getagrip.datasets.cutting import TrackedDataset

TRAINING = ("s1", "s4", "s7")
"""Of every three subjects the first, by name."""


@dataclass(frozen=True, kw_only=True)
class ArtiGrasp(Recorded):
    """ARCTIC's grasps, from ArtiGrasp's repository, by true hands."""

    dataset: ClassVar[str] = "artigrasp"

    shortest: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 2)")] = None
    """Frames of the shortest grasp, as for import."""

    def training(self, subjects: Collection[str]) -> Collection[str]:
        """The same whichever subjects are there: folders hold some of them only."""
        return TRAINING

    def reader(self, root: Path) -> TrackedDataset:
        from getagrip.datasets import artigrasp

        return self._cut(artigrasp.ArtiGrasp(root=root))

    def _cut(self, dataset: TrackedDataset) -> TrackedDataset:
        if self.shortest is None:
            return dataset
        return replace(dataset, grasps=replace(dataset.grasps, shortest=self.shortest))


@dataclass(frozen=True, kw_only=True)
class EstimatedArtiGrasp(ArtiGrasp):
    """Grasps of ARCTIC's s05, hands as estimated from images. The subject is for testing."""

    dataset: ClassVar[str] = "artigrasp-estimated"

    def reader(self, root: Path) -> TrackedDataset:
        from getagrip.datasets import artigrasp_estimated

        return self._cut(artigrasp_estimated.EstimatedArtiGrasp(root=root))
