"""Masks of the hand that holds the object: ``masks/hand``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.clip import Clip, Modality, masks_in
from getagrip.clip.masks import HAND, VisibleHand, mask_files, read_hand_masks, write_masks
from getagrip.fitting.energy import Terms

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.problem import Problem


class HandMasks(Modality[VisibleHand]):
    """The hand's silhouette. Its check is ``hand-off-pixels`` (``checks.table``)."""

    name = HAND

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return mask_files(folder, "hand", frames)

    def read(self, clip: Clip) -> VisibleHand | None:
        return read_hand_masks(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        masks = masks_in(clip)
        if masks is not None and masks.hand is not None:
            write_masks(masks.hand, masks.known, clip.frames, folder / "masks" / "hand")

    def terms(self, problem: Problem) -> Terms | None:
        from getagrip.fitting.objective import hand_mask_of

        known = self.of(problem.clip) is not None or problem.refinement is not None
        return Terms(hand=hand_mask_of(problem)) if known else None
