"""The frame on which a person should draw next: where the object is lost, the ends, then where it helps most."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from getagrip.studio.masks.propagate_clip import keyframe_spans

MAX_SUGGESTED_FRAMES = 4
"""Frames that are asked for."""
MASK_CONFIDENCE_THRESHOLD = 0.95
"""Masks as sure as this need no more."""
MIN_MASK_IOU = 1e-3
"""A mask counts as met by at least this IOU."""


def discount_confidence(
    confidence: Mapping[int, float], iou: Mapping[int, float], drawn: Collection[int]
) -> Mapping[int, float]:
    """Return the confidence of frames' masks, less where a result meets them less than those that a person drew.

    ``iou`` is the result's with the masks; between the drawn frames it would be between theirs, if all were right.
    """
    known = sorted(n for n in drawn if n in iou)
    if not known:
        return confidence
    usual = np.maximum(np.interp([*confidence], known, [iou[n] for n in known]), MIN_MASK_IOU)
    return {
        n: min(sure, max(iou.get(n, at), MIN_MASK_IOU) / at)
        for (n, sure), at in zip(confidence.items(), usual.tolist(), strict=True)
    }


def lost_frames(confidence: Mapping[int, float]) -> list[int]:
    """Return the frames in which the object is lost (``propagated_masks``)."""
    return sorted(n for n, sure in confidence.items() if sure == 0.0)


def suggest_frame(confidence: Mapping[int, float], drawn: Collection[int], first: int, last: int) -> int | None:
    """Return the frame from ``first`` to ``last`` on which it helps most to draw; None where nothing is asked for.

    ``confidence`` is that of the frames' masks; frames without one are about to be filled in. Of what a frame is unsure
    of, a drawn one at a distance d resolves the share 1 - d / D, D being its distance from the frames drawn before.
    """
    if not drawn:
        return first
    if lost := [n for n in lost_frames(confidence) if first <= n <= last]:
        return min(lost, key=lambda n: min(abs(n - key) for key in drawn))
    if len(drawn) == 1:
        (only,) = drawn
        return last if 2 * only < first + last else first
    unsure = np.array([1.0 - confidence.get(n, np.nan) for n in range(first, last + 1)])
    if len(drawn) >= MAX_SUGGESTED_FRAMES or np.isnan(unsure).any() or unsure.max() <= 1.0 - MASK_CONFIDENCE_THRESHOLD:
        return None
    best, most = None, 0.0
    for stretch in keyframe_spans(drawn, first, last):
        frames = np.arange(stretch.first, stretch.last + 1)
        for n in frames[~np.isin(frames, stretch.keys)]:
            sides = [np.abs(key - (n if len(stretch.keys) == 2 else frames)) for key in stretch.keys]
            beyond = sides[0] if len(sides) == 1 else np.where(frames < n, *sides)
            resolved = float(
                (unsure[frames - first] * np.clip(1.0 - np.abs(frames - n) / np.maximum(beyond, 1), 0, 1)).sum()
            )
            if resolved > most:
                best, most = int(n), resolved
    return best
