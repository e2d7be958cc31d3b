"""Views of results and clips in folders, also of several results of one clip at their common frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

import numpy as np

from getagrip.clip import Clip, read_clip
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.metrics.evaluate import read_result_clip_masks
from getagrip.report.pictures.result_view import View
from getagrip.result import Axis, Reconstruction
from getagrip.stable_grasps.axis import pose_hinge
from getagrip.stable_grasps.study import object_in_hand


@dataclass(frozen=True)
class StoredResult:
    """The folder of a result or a clip; ``clips`` holds the result's clip (None: the clip that the result names)."""

    folder: Path
    clips: Path | None = None

    def read(self) -> View:
        """Read the result with its clip and masks, or the ground truth of a clip. Raises ``InputError``."""
        if is_clip(self.folder):
            return ground_truth_view(self.folder)
        result, clip, masks = read_result_clip_masks(self.folder, self.clips)
        return View.of(result, clip, masks)


def is_clip(folder: Path) -> bool:
    """Return whether a folder is a clip's."""
    return (folder / "clip.json").exists()


def ground_truth_view(folder: Path) -> View:
    """Return all frames of a clip with the true poses of hand and object, as in the paper's Figs. 2 and 3.

    The axis is the hinge of least error (``pose_hinge``), as in the study. Raises ``InputError`` without ground truth.
    """
    clip = read_clip(folder).light()
    truth = clip.truth
    if truth is None:
        raise InputError(folder / "truth.npz", "", "no such file", "the true poses, or a result instead of a clip")
    R, centre, size = object_in_hand(clip)
    hinge = pose_hinge(R, centre, size)
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    axis = Axis(hinge.point, hinge.direction, np.unwrap(hinge.angles(R, centre)))
    motion = replace(Reconstruction.external(clip.name, "one-dof", clip.frames, T_hand_obj, truth.scale), axis=axis)
    hand = replace(clip.hand, vertices=truth.hand_vertices, T_cam_hand=truth.T_cam_hand)
    return View(replace(clip, hand=hand, scale="known"), None, motion, of_truth=True)


def hand_only_view(clip: Clip) -> View:
    """Return the view of a clip without poses of the object."""
    still = np.tile(np.eye(4), (len(clip), 1, 1))
    nothing = Reconstruction.external(clip.name, "", clip.frames, still)
    return View(clip.light(), None, nothing, posed=False)


def at_common_frames(results: Sequence[tuple[StoredResult, View]]) -> list[View]:
    """Return the views at their common frames. Raises ``InputError`` for results of several clips or without any."""
    first, one = results[0]
    for value, view in results[1:]:
        if view.clip.name != one.clip.name:
            expected = f"{one.clip.name!r}, as of {first.folder}: results of one clip"
            raise InputError(value.folder / "result.json", "clip", repr(view.clip.name), expected)
        if view.clip.size != one.clip.size:
            width, height = one.clip.size
            raise InputError(view.clip.origin / "clip.json", "size", f"{view.clip.size}", f"{width} x {height}")
    common = reduce(set.intersection, (set(view.result.frames) for _, view in results))
    if not common:
        of = " and ".join(str(value.folder) for value, _ in results[1:])
        raise InputError(of, "frames", f"none of those of {first.folder}", "results that share frames")
    names = [name for name in one.result.frames if name in common]
    return [view.at(names) for _, view in results]


def distinct_path_parts(results: Sequence[StoredResult]) -> list[str]:
    """Return the parts in which the results' paths differ, without the common beginning and end."""
    paths = [value.folder.resolve().parts for value in results]
    if len(paths) == 1:
        return [paths[0][-1]]
    begin = _common_prefix_length(paths)
    end = min(_common_prefix_length([path[::-1] for path in paths]), *(len(path) - begin - 1 for path in paths))
    return ["/".join(path[begin : len(path) - end]) for path in paths]


def _common_prefix_length(paths: Sequence[Sequence[str]]) -> int:
    alike = (len(set(parts)) == 1 for parts in zip(*paths, strict=False))
    return next((n for n, same in enumerate(alike) if not same), min(map(len, paths)))
