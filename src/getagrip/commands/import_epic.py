"""``getagrip import epic``: EPIC-Grasps, and a look at the poses that a search may start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from getagrip.datasets.dataset import Note, Part
from getagrip.datasets.epic.reader import EpicGrasps
from getagrip.fitting import pose_priors
from getagrip.io.arguments import OptionalFolder
from getagrip.io.terminal import report


@dataclass(frozen=True, kw_only=True)
class ImportEpic(EpicGrasps):
    """EPIC-Grasps: its stable grasps in EPIC-KITCHENS, with VISOR's masks; hands come from an estimator's files."""

    priors: OptionalFolder = None
    """Initial poses of reconstruct --init priors, by category and hand: they are only checked."""

    def parts(self, note: Note) -> Sequence[Part]:
        """List the videos, and report how the poses will be used, and whether they can be. Raises ``InputError``."""
        parts = super().parts(note)
        if self.priors is not None:
            self._report(self.priors)
        return parts

    def _report(self, folder: Path) -> None:
        learnt = pose_priors.read_folder(folder)
        kinds = sorted({(grasp.category, grasp.side) for grasp in self.grasps()})
        without = [f"{category} in a {side} hand" for category, side in kinds if not len(learnt.of(category, side))]
        print(f"to start from the poses of {folder}: getagrip reconstruct ... --init priors --priors {folder}")
        if without:
            report(f"{folder} has no poses of {', '.join(without)}")
        if self.cad is None:
            report("poses belong to the meshes they were made with: bring these with --cad")
