"""Masks of the hand that holds the object: ``masks/hand``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from getagrip.clip import Clip, Modality, masks_in
from getagrip.clip.masks import HAND, VisibleHand, mask_files, read_hand_masks, write_masks


class HandMasks(Modality[VisibleHand]):
    """The hand's silhouette."""

    name = HAND

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return mask_files(folder, "hand", frames)

    def read(self, clip: Clip) -> VisibleHand | None:
        return read_hand_masks(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        masks = masks_in(clip)
        if masks is not None and masks.hand is not None:
            write_masks(masks.hand, masks.known, clip.frames, folder / "masks" / "hand")
