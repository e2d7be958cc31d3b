"""``getagrip refine``: a joint fit with all evidence that starts from another system's poses of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.batch.scheduling import BatchOptions
from getagrip.cli.command import Command, FirstNumber
from getagrip.errors import UsageError
from getagrip.fitting.options import Options, PriorsFile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxtyping import Float
    from numpy import ndarray

    from getagrip.clip import Clip
    from getagrip.result import Reconstruction
    from getagrip.result.findings import Probability

REFINED_POSES_FOLDER = "in-given-format"
"""Subfolder of the results for the refined poses in the other system's format."""
CHANGES_FILE = "changes.csv"
"""Table of the changes, in the folder of the results."""
CHANGES_COLUMNS = (
    "clip", "iou_before", "iou_after", "moved_mm", "turned_deg", "right_in_hand_before", "right_in_hand_before_at_most",
    "right_in_hand_after", "right_in_camera_before", "right_in_camera_before_at_most", "right_in_camera_after",
)  # fmt: skip
MAX_EQUAL_POSES_DIAMETERS, MIN_EXCLUSIVE_POSES_DIAMETERS = 0.03, 0.2
"""Distances up to which poses are one solution, and from which they cannot both be right [diameters]."""


@dataclass(frozen=True, kw_only=True)
class Refine(Command):
    """Refine another system's poses of the object in each frame, by a joint fit that starts from them."""

    poses: Annotated[Positional[Path], arg(metavar="PATH", help_behavior_hint="")]
    """The poses, as for evaluate --poses: a file or folder of one clip, or a folder with PATH/<clip> for many."""
    clips: Annotated[tuple[Path, ...], arg(metavar="CLIP...", help_behavior_hint="(required)")] = ()
    """The clips: folders, folders of clips, or patterns in quotes."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder of the results: a folder for each clip, DIR/in-given-format/<clip> with the refined poses in the
    format of PATH, and changes.csv."""
    first: FirstNumber = None
    """The number that PATH gives to the clip's first frame, if it counts from another start."""
    options: Annotated[Options, arg(name="")] = field(default_factory=Options)
    batch: Annotated[BatchOptions, arg(name="")] = field(default_factory=BatchOptions)

    def run(self) -> int:
        """Reconstruct the clips, write their poses in the format of PATH, and print the changes."""
        from getagrip.batch.clips import clips_by_name, reconstruct_clips
        from getagrip.io import files

        if self.options.init != "uniform":
            raise UsageError(f"--init {self.options.init} cannot be used with refine, which starts from PATH")
        self.batch.keep.check(self.options)
        options = replace(self.options, init="poses", priors=PriorsFile(self.poses, first=self.first))
        status = reconstruct_clips(self.clips, self.out, options, self.batch, self.debug)
        refined = files.folder_inside(self.out, REFINED_POSES_FOLDER)
        shard = self.batch.share.shard
        clips = [(name, folder) for name, folder in clips_by_name(self.clips)[0].items() if name in shard]
        if changes := [made for name, folder in clips if (made := self._written(name, folder, refined)) is not None]:
            _print_changes(changes)
            files.write_csv(self.out / CHANGES_FILE, [CHANGES_COLUMNS, *(one.cells for one in changes)])
            print(self.out / CHANGES_FILE)
        return status

    def _written(self, name: str, folder: Path, refined: Path) -> Change | None:
        """Write the refined poses of a clip; return the change, None without a result."""
        from getagrip.clip import find_masks, read_clip
        from getagrip.clip.object_poses import (
            ExternalTrack,
            find_pose_table,
            find_poses_path,
            read_poses,
            write_poses_like,
        )
        from getagrip.geometry import se3
        from getagrip.io import files
        from getagrip.metrics.evaluate.external import read_external_poses
        from getagrip.result import is_result, read_result

        if not is_result(self.out / name):
            return None
        after, _ = read_result(self.out / name)
        whole = read_clip(folder)
        index = whole.index_of(after.frames)
        clip, place = whole.take(index), find_poses_path(self.poses, whole.name)
        before = read_external_poses(place, place.stem, whole, find_masks(whole), self.first).take(index)
        if is_result(place):
            own, _ = read_result(place)
            in_hand, in_camera = own.probability_right, own.probability_right_in_camera
            before = replace(before, probability_right=in_hand, probability_right_in_camera=in_camera)
        else:
            names = read_poses(place, whole, self.first).names
            names = tuple(names[n] for n in index)
            T_cam_obj = _hand_poses(clip, after) @ after.T_hand_obj
            T_hand_obj = se3.inverse(clip.hand.T_cam_hand) @ T_cam_obj  # in the clip's hand, as in the file
            track = ExternalTrack(names, T_cam_obj, T_hand_obj, after.scale, after.iou)
            write_poses_like(find_pose_table(place), track, files.folder_inside(refined, clip.name))
        return Change.of(name, clip, before, after)


@dataclass(frozen=True)
class PoseProbabilities:
    """Probabilities that poses are right, before and after the refinement; None where unknown.

    Attributes:
        before: probability of the poses in PATH.
        at_most: upper bound of ``before`` where that is unknown.
        after: probability of the refined poses.
    """

    before: float | None = None
    at_most: float | None = None
    after: float | None = None

    @staticmethod
    def of(before: Probability | None, after: Probability | None, apart: float) -> PoseProbabilities:
        """Compute the probabilities; ``apart`` is the distance of the poses before and after [diameters].

        Only this package's results have a calibrated probability. Another system's poses have the same probability if
        they are the same solution, and at most the complement if both cannot be right.
        """
        if before is not None or after is None:
            known = (None if one is None else one.value for one in (before, after))
            return PoseProbabilities(next(known), None, next(known))
        same = after.value if apart <= MAX_EQUAL_POSES_DIAMETERS else None
        most = 1.0 - after.value if apart >= MIN_EXCLUSIVE_POSES_DIAMETERS else None
        return PoseProbabilities(same, most, after.value)

    @property
    def said(self) -> tuple[str, str]:
        """Both probabilities in words, before and after."""
        from getagrip.result.findings import format_probability

        known = (self.before, self.at_most, self.after)
        before, most, after = ("-" if one is None else format_probability(one) for one in known)
        if self.at_most is not None:
            before = most if most.startswith("<") else f"at most {most}"
        return before, after


@dataclass(frozen=True)
class Change:
    """The change of a clip's poses.

    Attributes:
        iou: mean overlap with the masks, before and after.
        moved: median shift of the object's origin in the hand [m].
        turned: median rotation of the object in the hand [rad].
        right: probabilities that the poses are right in the hand, and in the camera.
        notes: remarks on the poses before.
    """

    clip: str
    iou: tuple[float, float]
    moved: float
    turned: float
    right: tuple[PoseProbabilities, PoseProbabilities] = (PoseProbabilities(), PoseProbabilities())
    notes: tuple[str, ...] = ()

    @property
    def cells(self) -> list[object]:
        """Cells of the row of ``CHANGES_FILE``."""
        right = [value for one in self.right for value in (one.before, one.at_most, one.after)]
        return [self.clip, *self.iou, 1e3 * self.moved, math.degrees(self.turned), *right]

    @staticmethod
    def of(name: str, clip: Clip, before: Reconstruction, after: Reconstruction) -> Change:
        """Compare two results in the same frames."""
        import numpy as np

        from getagrip.geometry import se3

        T, S = before.T_hand_obj, after.T_hand_obj
        moved = np.median(np.linalg.norm(T[:, :3, 3] - S[:, :3, 3], axis=1))
        turned = np.median(se3.angle_between(T[:, :3, :3], S[:, :3, :3]))
        iou = float(np.nanmean(before.iou)), float(np.nanmean(after.iou))
        both, in_camera = (before, after), (_hand_poses(clip, before) @ T, _hand_poses(clip, after) @ S)
        apart = [_pose_distance_diameters(clip, both, poses) for poses in ((T, S), in_camera)]
        right = (
            PoseProbabilities.of(before.probability_right, after.probability_right, apart[0]),
            PoseProbabilities.of(before.probability_right_in_camera, after.probability_right_in_camera, apart[1]),
        )
        return Change(name, iou, float(moved), float(turned), right, before.notes[1:])


def _hand_poses(clip: Clip, result: Reconstruction) -> Float[ndarray, "T 4 4"]:
    return clip.hand.T_cam_hand if result.T_cam_hand is None else result.T_cam_hand


def _pose_distance_diameters(
    clip: Clip, results: Sequence[Reconstruction], poses: Sequence[Float[ndarray, "T 4 4"]]
) -> float:
    """Compute the mean vertex distance of two results, up to symmetries [diameters]."""
    from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
    from getagrip.metrics.symmetry import find_symmetries

    first, second = (ObjectTrack(T, result.scale) for T, result in zip(poses, results, strict=True))
    symmetry = best_symmetry(clip.mesh, first, second, find_symmetries(clip.mesh))
    errors = pose_errors(clip.mesh, first, second, symmetry)
    return float(errors.add.mean()) / errors.diameter


def _print_changes(changes: list[Change]) -> None:
    import numpy as np
    from rich.text import Text

    from getagrip.errors import escape_unprintable
    from getagrip.io.terminal import console, make_table, print_note
    from getagrip.metrics.evaluate.external import MISALIGNED_POSES_MESSAGE

    table, heads = make_table(), ("right in the hand before", "after", "in the camera before", "after")
    for heading in ("clip", "IOU before", "after", "moved", "turned", *heads):
        table.add_column(heading, justify="left" if heading == "clip" else "right")
    for one in changes:
        change = f"{1e3 * one.moved:.0f} mm", f"{np.degrees(one.turned):.0f} deg"
        right = *one.right[0].said, *one.right[1].said
        table.add_row(Text(escape_unprintable(one.clip)), *(f"{iou:.2f}" for iou in one.iou), *change, *right)
    console().print(table)
    for one in changes:
        for note in one.notes or ([MISALIGNED_POSES_MESSAGE] if one.iou[0] == 0.0 else []):
            print_note(f"{escape_unprintable(one.clip)}: {note}")
