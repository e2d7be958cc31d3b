"""Masks of the object and of its occluders (``masks/object``, ``masks/ignore``), and of the hand (``masks/hand``)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.clip import Clip, Masks, Modality, masks_in_memory
from getagrip.clip.masks import (
    HAND_MASKS_KEY,
    OBJECT_MASKS_KEY,
    VisibleHand,
    mask_files,
    read_hand_masks,
    read_object_masks,
    write_masks,
)
from getagrip.fitting.energy import Terms

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.problem import Problem


class ObjectMasks(Modality[Masks]):
    """The object's silhouette; every clip that is fitted has it.

    Its checks are those of ``checks.table``, which compare it with the mesh, the camera and the hand of any clip.
    """

    name = OBJECT_MASKS_KEY

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return [name for kind in ("object", "ignore") for name in mask_files(folder, kind, frames)]

    def read(self, clip: Clip) -> Masks:
        return read_object_masks(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        masks = self.of(clip)
        if masks is None:
            return
        write_masks(masks.object, masks.known, clip.frames, folder / "masks" / "object")
        if masks.say_what_hides:
            write_masks(masks.ignore, masks.known, clip.frames, folder / "masks" / "ignore")

    def terms(self, problem: Problem) -> Terms:
        from getagrip.fitting.objective import mask_energy

        return Terms(object=mask_energy(problem))


class HandMasks(Modality[VisibleHand]):
    """The hand's silhouette. Its check is ``hand-off-pixels`` (``checks.table``)."""

    name = HAND_MASKS_KEY

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return mask_files(folder, "hand", frames)

    def read(self, clip: Clip) -> VisibleHand | None:
        return read_hand_masks(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        masks = masks_in_memory(clip)
        if masks is not None and masks.hand is not None:
            write_masks(masks.hand, masks.known, clip.frames, folder / "masks" / "hand")

    def terms(self, problem: Problem) -> Terms | None:
        from getagrip.fitting.objective import hand_mask_energy

        known = self.of(problem.clip) is not None or problem.refinement is not None
        return Terms(hand=hand_mask_energy(problem)) if known else None
