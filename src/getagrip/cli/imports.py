"""`getagrip import`: clips from datasets; hands, masks and segments from files into clips.

What it takes is declared with the readers, whose modules load numpy and more. So this module is loaded when the command
is called, not for `getagrip --help`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, Literal, TypeAlias, TypeVar, Union

from tyro.conf import Positional, arg, subcommand

from getagrip.batch.imports import import_clips
from getagrip.cli.command import Command, Focal, Intrinsics, Labels, OptionalSide
from getagrip.cli.sharing import Sharing
from getagrip.clip.intrinsics import Lens
from getagrip.commands.datasets import DATASETS
from getagrip.commands.import_hands import NewFrames, import_hands
from getagrip.commands.import_masks import into_clip
from getagrip.commands.import_segments import into_clip as segments_into_clip
from getagrip.datasets.dataset import Dataset
from getagrip.hands.trackers import TRACKERS, choose
from getagrip.io import files
from getagrip.io.arguments import Flag, Folder, OptionalFile

if TYPE_CHECKING:
    Source: TypeAlias = str
    Trackers: TypeAlias = object
else:  # the choices of --from, and the options of each tracker, as the table has them
    TAKES = "; ".join(f"{name}: {tracker.takes}" for name, tracker in TRACKERS.items())
    Source = Annotated[Literal[tuple(TRACKERS)], arg(name="from", help=f"Whose they are. {TAKES}.")]
    OPTIONS = [(name, type(tracker), field(default=tracker)) for name, tracker in TRACKERS.items()]
    Trackers = Annotated[make_dataclass("Trackers", OPTIONS, frozen=True), arg(name="")]
D = TypeVar("D", bound=Dataset)


@dataclass(frozen=True, kw_only=True)
class Import(Command, Generic[D]):
    """Make clips of a dataset."""

    dataset: Annotated[D, arg(name="")]
    out: Folder
    """Where the clips go, a folder each. Those that are there already are kept, unless they lack hands found now."""

    sharing: Annotated[Sharing, arg(name="")] = field(default_factory=Sharing)

    def run(self) -> int:
        return import_clips(self.dataset, self.out, self.debug, self.sharing.share())


@dataclass(frozen=True, kw_only=True)
class ImportHands(Command):
    """Hands from an estimator's files: into a clip that lacks them, or into a file for a clip to come."""

    paths: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE...", help_behavior_hint="")]
    """.npz, .json, .pkl, .pt, .npy, .obj, or folders of them: a file for each image, named like it, or one for all
    (docs/estimators.md)."""
    source: Source
    trackers: Trackers
    clip: Annotated[Path | None, arg(metavar="CLIP", help_behavior_hint="")] = None
    """The clip's folder. Its side, its frames and its camera are taken from it."""
    out: OptionalFile = None
    """Instead of a clip, a file for clip new --hands. It needs --side, --frames, --size and a camera."""
    mano: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: the generic hand)")] = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl."""
    side: OptionalSide = None
    """With --out: which hand."""
    frames: Annotated[tuple[int, int] | None, arg(metavar="FIRST LAST", help_behavior_hint="")] = None
    """With --out: numbers of the frames, the last included."""
    size: Annotated[tuple[int, int] | None, arg(metavar="WIDTH HEIGHT", help_behavior_hint="")] = None
    """With --out: of the images."""
    K: Intrinsics = None
    """With --out: the camera."""
    focal: Focal = None
    """With --out: instead of K, the focal length; the principal point is in the middle."""
    guess_focal: Flag = False
    """With --out: guess it. Depths and sizes are guesses then, too."""
    first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")] = None
    """The number of the first frame's hand in the files. Needed where these are counted from another start."""
    hold_ends: Flag = False
    """For a whole interaction: before the first and after the last frame in which it was found, the hand stands still
    where it was then, marked as a guess. Else these frames are left out."""
    other_hand: Flag = False
    """With --clip: the hand of the other side, which holds the object in some of a timeline's grasps. Frames may lack
    it."""
    overwrite: Flag = False
    """Replace hands that are there already."""

    def check(self) -> None:
        if self.out is not None:
            files.check_file("--out", self.out)

    def run(self) -> int:
        new = NewFrames(self.side, self.frames, self.size, Lens(self.K, self.focal, self.guess_focal))
        tracker = choose(self.source, vars(self.trackers))
        how = self.hold_ends, self.other_hand, self.first, self.overwrite
        return import_hands(self.paths, tracker, self.mano, self.clip, self.out, new, *how)


@dataclass(frozen=True, kw_only=True)
class ImportMasks(Command):
    """Masks from files into a clip: a folder of PNG (labels, palettes as of SAM 2, colours), of .npy or of LabelMe's
    .json; .json of COCO, YouTube-VIS or SA-V; .npz and .npy; or SAM 2's video_segments (.pkl, .npy)."""

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The folder or file; images are named like the clip's frames, or by the same numbers."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder."""
    object: Labels = ()
    """The object: values of its labels, #rrggbb, or names of COCO's categories; of several cups, cup:7 by its track_id,
    or cup:all. Not needed where there is one only."""
    ignore: Labels = ()
    """What hides it, likewise: other hands, other things in front."""
    hand: Labels = ()
    """The hand that holds it, likewise. It is ignored as well, and the clip's hands are corrected by its pixels."""
    first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")] = None
    """The number of the first frame's mask. Needed where masks are counted from 0 and frames are not."""
    images: str = ""
    """Which images are meant where there are several of a frame: a folder as take1, or a pattern as cam1_*."""
    overwrite: Flag = False
    """Replace masks that are there already."""

    def run(self) -> int:
        labels = self.object, self.ignore, self.hand
        return into_clip(self.path, *labels, self.first, self.images, self.clip, self.overwrite)


@dataclass(frozen=True, kw_only=True)
class ImportSegments(Command):
    """Segments into a clip, which becomes a timeline: what annotate or segment --from-masks has written, corrected or
    not."""

    path: Annotated[Positional[Path], arg(metavar="FILE")]
    """segments.json, or segments-NAME.json (docs/formats.md). The clip's own entry is taken, or the only one."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder. Segments are cut at its ends."""
    still_camera: Flag = False
    """The camera did not move: its frame is the world."""
    overwrite: Flag = False
    """Replace segments that are there already."""

    def run(self) -> int:
        return segments_into_clip(self.path, self.clip, self.still_camera, self.overwrite)


def _subcommands() -> Any:
    """The subcommands of ``import``: a dataset each, then hands, masks and segments."""
    datasets = [
        Annotated[Import[dataset], subcommand(name, description=dataset.__doc__)]  # type: ignore[valid-type]
        for name, dataset in DATASETS.items()
    ]
    own = [("hands", ImportHands), ("masks", ImportMasks), ("segments", ImportSegments)]
    return Union[*datasets, *(Annotated[command, subcommand(name)] for name, command in own)]


Imports = _subcommands()
