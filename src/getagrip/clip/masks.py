"""Masks of a clip: read from its folder one frame at a time, checked, written, and completed by rendered hands."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip.clip import Clip, Masks, frame_indices
from getagrip.errors import InputError, UsageError, check_arguments
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.io.array_data import ArrayData
from getagrip.io.images import PackedMask, PackedMasks, pack_masks, read_mask, write_mask

OBJECT_MASKS_KEY, HAND_MASKS_KEY = "object-masks", "hand-masks"
"""Keys of ``Clip.evidence``: the names of the two modalities of masks."""


@dataclass(frozen=True, eq=False)
class VisibleHand(ArrayData):
    """Masks of the hand in every frame.

    Attributes:
        pixels: (T, H, W) visible pixels of the grasping hand, and of no other. A frame without any has no information
            on the hand.
    """

    pixels: Bool[ndarray, "T H W"]

    def __len__(self) -> int:
        return len(self.pixels)

    def take(self, index: Int[ndarray, "n"]) -> VisibleHand:
        """Return the masks of some frames, in the given order."""
        return VisibleHand(self.pixels[index])


def with_masks(clip: Clip, masks: Masks | None) -> Clip:
    """Return the clip with masks in memory; None: without masks, even if its folder has some."""
    hand = None if masks is None or masks.hand is None else VisibleHand(masks.hand)
    alone = None if masks is None else replace(masks, hand=None)
    return replace(clip, evidence={**clip.evidence, OBJECT_MASKS_KEY: alone, HAND_MASKS_KEY: hand})


def masks_in_memory(clip: Clip) -> Masks | None:
    """Return the masks of a clip in memory; None without any."""
    masks, hand = clip.evidence.get(OBJECT_MASKS_KEY), clip.evidence.get(HAND_MASKS_KEY)
    assert masks is None or isinstance(masks, Masks)
    assert hand is None or isinstance(hand, VisibleHand)
    return masks if masks is None or hand is None else replace(masks, hand=hand.pixels)


@check_arguments
def read_masks(clip: Clip) -> Masks:
    """Read and check the masks of a clip, from its folder.

    The mask of a frame without a file in ``masks/object`` is unknown (``Masks.known``). The folders ``masks/ignore``
    and ``masks/hand`` may be absent; if present, they have an image for each frame that ``masks/object`` has.

    Args:
        clip: the clip, as ``read_clip`` returns it.

    Returns:
        The masks of the clip's frames, in their order.

    Raises:
        InputError: an image is missing, damaged or of another size, no mask shows the object, or the clip has no
            folder.
    """
    masks = masks_in_memory(clip)
    return add_hand_masks(read_object_masks(clip), clip) if masks is None else masks


def find_masks(clip: Clip) -> Masks | None:
    """Read the masks of a clip with ``read_masks``; None without a folder of masks."""
    return read_masks(clip) if masks_in_memory(clip) is not None or _has_masks(clip) else None


def read_available_masks(clip: Clip, with_hand: bool = False) -> Masks | None:
    """Read the masks of a clip's frames, which may all be empty, optionally with hand masks; None without a folder."""
    if not _has_masks(clip):
        return None
    masks = _stack_masks(clip)
    return add_hand_masks(masks, clip) if with_hand else masks


def read_object_masks(clip: Clip) -> Masks:
    """Read the masks of a clip's frames without hand masks. Raises as ``read_masks`` does."""
    _clip_folder(clip)
    masks = _stack_masks(clip)
    _check_nonempty_masks(clip, bool(masks.object.any()))
    return masks


def read_hand_masks(clip: Clip) -> VisibleHand | None:
    """Read the hand masks of a clip's frames; None if its folder has none."""
    folder = _clip_folder(clip)
    if not (folder / "masks" / "hand").exists():
        return None
    nothing, size = PackedMask.empty(clip.size[::-1]), clip.size
    each = [_read_mask_file(folder, "hand", name, size) if has_mask(folder, name) else nothing for name in clip.frames]
    return VisibleHand(PackedMasks(each, size[::-1]).as_array())


def add_hand_masks(masks: Masks, clip: Clip) -> Masks:
    """Add the hand masks of a clip's folder, if any, to its masks."""
    hand = read_hand_masks(clip)
    return masks if hand is None else replace(masks, hand=hand.pixels)


def read_observed(clip: Clip) -> Bool[ndarray, "T"]:
    """Compute ``read_masks(clip).observed``, with one frame in memory at a time."""
    any_object, observed = False, np.zeros(len(clip), dtype=bool)
    for n, (mask, ignore) in enumerate(_iterate_masks(clip)):
        any_object |= mask.area > 0
        observed[n] = mask.exceeds(ignore)
    _check_nonempty_masks(clip, any_object)
    return observed


def _stack_masks(clip: Clip) -> Masks:
    return Masks(*(PackedMasks(each, clip.size[::-1]).as_array() for each in zip(*_iterate_masks(clip), strict=True)))


def _iterate_masks(clip: Clip) -> Iterator[tuple[PackedMask, PackedMask]]:
    """Read the masks of the object and of ignored pixels, frame by frame."""
    folder, size = _clip_folder(clip), clip.size[::-1]
    nothing, everything = PackedMask.empty(size), PackedMask.full(size)
    hidden = (folder / "masks" / "ignore").exists()
    for frame in clip.frames:
        if not has_mask(folder, frame):
            yield nothing, everything
            continue
        mask = _read_mask_file(folder, "object", frame, clip.size)
        yield mask, _read_mask_file(folder, "ignore", frame, clip.size) if hidden else nothing


def has_mask(folder: Path, frame: str) -> bool:
    """Return whether a clip's folder has a file or link of the object's mask in a frame."""
    return os.path.lexists(folder / "masks" / "object" / f"{frame}.png")


def mask_files(folder: Path, kind: str, frames: Iterable[str]) -> list[str]:
    """Name the mask files of a kind (``object``, ``ignore``, ``hand``) in a clip's folder, for frames with masks."""
    if not (folder / "masks" / kind).exists():
        return []
    return [f"masks/{kind}/{frame}.png" for frame in frames if has_mask(folder, frame)]


def write_masks(masks: Bool[ndarray, "T H W"], known: Bool[ndarray, "T"], frames: Sequence[str], folder: Path) -> None:
    """Write the known masks as PNGs of 0 and 255 into a new folder."""
    folder.mkdir(parents=True)
    for name, mask, is_known in zip(frames, masks, known, strict=True):
        if is_known:
            write_mask(folder / f"{name}.png", mask)


def _has_masks(clip: Clip) -> bool:
    return clip.folder is not None and (clip.folder / "masks" / "object").exists()


def _clip_folder(clip: Clip) -> Path:
    if clip.folder is None:
        raise InputError(clip.origin, "masks", "none, for a clip that is in no folder", "the masks beside the clip")
    return clip.folder


def _read_mask_file(folder: Path, kind: str, frame: str, size: tuple[int, int]) -> PackedMask:
    path = files.inside(folder, f"masks/{kind}/{frame}.png", "", "a mask for each frame of clip.json")
    return read_mask(path, size)


def _check_nonempty_masks(clip: Clip, any_object: bool) -> None:
    if not any_object:
        folder = clip.origin / "masks" / "object"
        count = sum(has_mask(clip.origin, frame) for frame in clip.frames)
        got = f"{count} masks without a pixel" if count else "no mask of any frame"
        raise InputError(folder, "", got, "masks that show the object")


def check_masks(clip: Clip, masks: Masks) -> None:
    """Raise ``UsageError`` for masks of another clip: another number of frames, or another size."""
    expected = (len(clip), clip.size[1], clip.size[0])
    if masks.object.shape != expected:
        raise UsageError(f"masks must be of the shape {expected}, as the clip {clip.name} (got {masks.object.shape})")


def observed_frames(clip: Clip, observed: Bool[ndarray, "T"], most: int | None = None) -> Clip:
    """Return the clip at its ``observed`` frames (``Masks.observed``), at most ``most`` of them.

    Raises ``InputError`` for fewer than two: one silhouette does not determine a motion.
    """
    if observed.sum() < 2:
        got = f"{observed.sum()} of {len(clip)} frames whose mask has a pixel that is not ignored"
        raise InputError(clip.origin / "masks" / "object", "", got, "at least 2")
    unobserved = tuple(name for name, is_observed in zip(clip.frames, observed, strict=True) if not is_observed)
    index = np.flatnonzero(observed)
    if most is not None:
        index = index[frame_indices(len(index), most)]
    return replace(clip.take(index), left_out=(*clip.left_out, *unobserved))


def occluded_by_hand(clip: Clip, masks: Masks) -> Masks:
    """Ignore the pixels of the clip's rendered hands outside the object's mask; all pixels of unknown masks."""
    from getagrip.geometry.rasterize import render_packed

    hands = [(clip.hand, np.ones(len(clip), dtype=bool))]
    if clip.other_hand is not None:
        hands.append((clip.other_hand.track, clip.other_hand.known))
    posed = [(se3.transform(hand.T_cam_hand, hand.vertices), hand.faces, known) for hand, known in hands]
    size = clip.size[::-1]

    def hidden(n: int, visible: PackedMask) -> PackedMask:
        drawn = [render_packed(v[n], faces, clip.K[n], clip.size) for v, faces, known in posed if known[n]]
        box = drawn[0].box_with(drawn[-1])  # one hand or two
        covered = np.any([hand.part(box) for hand in drawn], axis=0)
        return PackedMask.of(covered & ~visible.part(box), box[1], box[0], size)

    frames = enumerate(zip(pack_masks(masks.object).frames, masks.known, strict=True))
    ignored = [hidden(n, visible) if known else PackedMask.full(size) for n, (visible, known) in frames]
    return Masks(masks.object, PackedMasks(ignored, size).as_array())
