"""Changes of the inputs of HO-3D's evaluation: estimated masks instead of the clip's, and no depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.bench.inputs.perturbations import UNCHANGED, Change, Several
from getagrip.bench.sources.ho3d_sequences import sequence_of
from getagrip.clip import Clip, FrameMasks, Masks
from getagrip.clip.depth import DEPTH_KEY
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks

HAND_MASKS_SUFFIX = "_hand"
"""Suffix of a folder of hand masks."""


@dataclass(frozen=True)
class WithMasks(Change):
    """Replaces the masks by those of ``folder/<sequence>``, and the hand masks by ``folder/<sequence>_hand`` if any.

    Without hand masks, the clip's rendered hand is the occluder.
    """

    folder: Path

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        request, place = MaskRequest(clip.frames, clip.size), self.folder / sequence_of(clip.name)
        objects, hand = open_masks(place, request), place.with_name(place.name + HAND_MASKS_SUFFIX)
        hands = open_masks(hand, request) if hand.is_dir() else None

        def of_frame(n: int) -> FrameMasks:
            seen = objects(n)
            if seen is None:
                return FrameMasks.unknown(clip.size)
            hidden = None if hands is None else hands(n)
            return seen if hidden is None else FrameMasks(seen.object, hidden.object & ~seen.object)

        return clip, Masks.packed(map(of_frame, range(len(clip))), clip.size)

    def inputs(self, clip: str) -> Mapping[str, Path]:
        place = self.folder / sequence_of(clip)
        folders = (place, place.with_name(place.name + HAND_MASKS_SUFFIX))
        return {f"{one.name}/{file.name}": file for one in folders if one.is_dir() for file in sorted(one.iterdir())}


@dataclass(frozen=True)
class WithoutDepth(Change):
    """Removes the depth."""

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        return replace(clip, evidence={**clip.evidence, DEPTH_KEY: None}), masks


def without_depth(change: Change | None, depth: bool) -> Change:
    """Return a change (None: none), followed by ``WithoutDepth`` unless ``depth``."""
    change = UNCHANGED if change is None else change
    if depth:
        return change
    return WithoutDepth() if change == UNCHANGED else Several((change, WithoutDepth()))
