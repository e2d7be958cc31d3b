"""Clips: what they hold, and their folders (docs/formats.md)."""

from getagrip.clip.clip import FINGERS, Clip, FrameMasks, HandTrack, Joint, Masks, OtherHand, PerFrame, Truth, World
from getagrip.clip.masks import (
    check_masks,
    find_masks,
    masks_in_memory,
    observed_frames,
    read_available_masks,
    read_masks,
    read_observed,
    with_masks,
)
from getagrip.clip.modality import MODALITIES, Modality, modalities, other_evidence, with_evidence
from getagrip.clip.read import input_sha256, read_clip, read_name
from getagrip.clip.read_arrays import check_clip
from getagrip.clip.timeline import Segment, State
from getagrip.clip.write import write_clip

__all__ = [
    "FINGERS",
    "MODALITIES",
    "Clip",
    "FrameMasks",
    "HandTrack",
    "Joint",
    "Masks",
    "Modality",
    "OtherHand",
    "PerFrame",
    "Segment",
    "State",
    "Truth",
    "World",
    "check_clip",
    "check_masks",
    "find_masks",
    "input_sha256",
    "masks_in_memory",
    "modalities",
    "observed_frames",
    "other_evidence",
    "read_available_masks",
    "read_clip",
    "read_masks",
    "read_name",
    "read_observed",
    "with_evidence",
    "with_masks",
    "write_clip",
]
