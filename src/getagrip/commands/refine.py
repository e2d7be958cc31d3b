"""``getagrip refine``: another system's poses of the object become the start of a joint fit with all evidence."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.batch.share import Batch
from getagrip.commands.command import Command
from getagrip.errors import UsageError
from getagrip.fitting.options import Options, PriorsFile

if TYPE_CHECKING:
    from getagrip.result import Reconstruction

REFINED = "refined"
"""Folder, in that of the results, of the poses in the other system's format."""


@dataclass(frozen=True, kw_only=True)
class Refine(Command):
    """Refine another system's poses of the object in each frame, by a joint fit that starts from them."""

    poses: Annotated[Positional[Path], arg(metavar="PATH", help_behavior_hint="")]
    """The poses, as for evaluate --poses: a file or folder of one clip, or a folder with PATH/<clip> for many."""
    clips: Annotated[tuple[Path, ...], arg(metavar="CLIP...", help_behavior_hint="(required)")] = ()
    """The clips: folders, folders of clips, or patterns in quotes."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder of the results: a folder for each clip, and DIR/refined/<clip> with the refined poses in the format of
    PATH."""
    first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")] = None
    """The number that PATH gives to the clip's first frame, if it counts from another start."""
    options: Annotated[Options, arg(name="")] = field(default_factory=Options)
    batch: Annotated[Batch, arg(name="")] = field(default_factory=Batch)

    def run(self) -> int:
        """Reconstruct the clips, write their poses in the format of PATH, and print what changed."""
        from getagrip.batch.clips import reconstruct_clips
        from getagrip.batch.plan import by_name
        from getagrip.io import files

        if self.options.init != "uniform":
            raise UsageError(f"--init {self.options.init} cannot be used with refine, which starts from PATH")
        options = replace(self.options, init="poses", priors=PriorsFile(self.poses, first=self.first))
        status = reconstruct_clips(self.clips, self.out, options, self.batch, self.debug)
        refined = files.folder_inside(self.out, REFINED)
        shard = self.batch.share.shard
        named = [(name, folder) for name, folder in by_name(self.clips)[0].items() if name in shard]
        changes = [made for name, folder in named if (made := self._written(name, folder, refined)) is not None]
        if changes:
            _print(changes)
        return status

    def _written(self, name: str, folder: Path, refined: Path) -> Change | None:
        """Write the refined poses of a clip; return what changed, None where there is no result."""
        from getagrip.clip import find_masks, read_clip
        from getagrip.evaluation.other_poses import poses_of
        from getagrip.io import files
        from getagrip.object_poses.at_frames import only_file, place_in, read_poses
        from getagrip.object_poses.writing import Track, write_like
        from getagrip.result import is_result, read_result

        if not is_result(self.out / name):
            return None
        after, _ = read_result(self.out / name)
        whole = read_clip(folder)
        clip = whole.take(whole.index_of(after.frames))
        place = place_in(self.poses, clip.name)
        before = poses_of(place, place.stem, whole, find_masks(whole), self.first).take(whole.index_of(after.frames))
        if not is_result(place):
            names = read_poses(place, whole, self.first).names
            T_cam_hand = clip.hand.T_cam_hand if after.T_cam_hand is None else after.T_cam_hand
            names = tuple(names[n] for n in whole.index_of(after.frames))
            track = Track(names, T_cam_hand @ after.T_hand_obj, after.T_hand_obj, after.scale, after.iou)
            write_like(only_file(place), track, files.folder_inside(refined, clip.name))
        return Change.of(name, before, after)


@dataclass(frozen=True)
class Change:
    """The change of a clip's poses.

    Attributes:
        iou: mean overlap with the masks, before and after.
        moved: median shift of the object's origin in the hand [m].
        turned: median rotation of the object in the hand [rad].
    """

    clip: str
    iou: tuple[float, float]
    moved: float
    turned: float
    after: Reconstruction

    @staticmethod
    def of(name: str, before: Reconstruction, after: Reconstruction) -> Change:
        """Compare two results in the same frames."""
        import numpy as np

        from getagrip.geometry import se3

        T, S = before.T_hand_obj, after.T_hand_obj
        moved = np.median(np.linalg.norm(T[:, :3, 3] - S[:, :3, 3], axis=1))
        turned = np.median(se3.angle_between(T[:, :3, :3], S[:, :3, :3]))
        iou = float(np.nanmean(before.iou)), float(np.nanmean(after.iou))
        return Change(name, iou, float(moved), float(turned), after)


def _print(changes: list[Change]) -> None:
    """Print a line for each clip."""
    import numpy as np
    from rich.text import Text

    from getagrip.errors import cleaned
    from getagrip.io.terminal import console, plain_table
    from getagrip.probability import percent

    table = plain_table()
    for heading in ("clip", "IOU before", "after", "moved", "turned", "right in the hand", "in the camera"):
        table.add_column(heading, justify="left" if heading == "clip" else "right")
    for one in changes:
        right = (one.after.probability_right, one.after.probability_right_in_camera)
        table.add_row(
            Text(cleaned(one.clip)), f"{one.iou[0]:.2f}", f"{one.iou[1]:.2f}", f"{1e3 * one.moved:.0f} mm",
            f"{np.degrees(one.turned):.0f} deg", *("-" if each is None else percent(each.value) for each in right),
        )  # fmt: skip
    console().print(table)
