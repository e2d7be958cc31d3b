"""`getagrip import`: clips from datasets, and hands and masks from other people's files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional, Suppress, arg, subcommand

from getagrip.cli.command import (
    Command,
    Flag,
    Folder,
    OptionalFile,
    OptionalFolder,
)

Intrinsics = Annotated[
    tuple[float, float, float, float] | None, arg(name="K", metavar="FX FY CX CY", help_behavior_hint="")
]
Focal = Annotated[float | None, arg(metavar="PX", help_behavior_hint="")]
Labels = Annotated[tuple[str, ...], arg(metavar="LABEL...", help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class Import(Command):
    """Make clips from a dataset with true poses."""

    source: Annotated[str, Suppress]
    """Which one: the subcommand's name."""
    root: Annotated[Positional[Path], arg(metavar="ROOT")]
    """The folder that holds them, as it came."""
    out: Folder
    """Where the clips go, a folder each. Those that are there already are kept."""
    meshes: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: ROOT/models)")] = None
    """dexycb, ho3d: folder of the YCB models."""
    mano: OptionalFolder = None
    """arctic, hoi4d: folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl. ho3d too: without, the generic hand is fitted."""
    view: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 0)")] = None
    """arctic: the camera, 0 on the head, 1 to 8 fixed."""
    whole: Flag = False
    """Not the grasps but all frames, without masks: for segment and study."""
    timelines: OptionalFile = None
    """hot3d: a list of grasps (hot3d_hit.json), instead of the holds found here."""
    first_frame: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 0)")] = None
    """hot3d: the list's number of a recording's first frame; else the recording must be as long as the list has it."""

    def run(self) -> int:
        from getagrip.batch.imports import Given, import_clips

        given = Given(self.meshes, self.mano, self.view, self.whole, self.timelines, self.first_frame)
        return import_clips(self.source, self.root, self.out, given, self.debug)


@dataclass(frozen=True, kw_only=True)
class ImportEpic(Command):
    """EPIC-Grasps: its stable grasps in EPIC-KITCHENS, with VISOR's masks; hands come from an estimator's files."""

    csv: Annotated[Positional[Path], arg(metavar="CSV")]
    """EPIC-Grasps' table, as published. Its errata are applied where they lie beside it (<CSV>_errata.csv)."""
    visor: Folder
    """VISOR's annotations, sparse, dense or both, and its frame_mapping.json, anywhere below."""
    frames: OptionalFolder = None
    """EPIC-KITCHENS' images: P01/rgb_frames/P01_01/frame_0000000001.jpg or P01_01.tar, or P01_01/..."""
    videos: OptionalFolder = None
    """Instead of images, EPIC-KITCHENS' videos: P01/videos/P01_01.MP4, or P01_01.MP4."""
    hands: OptionalFolder = None
    """Hand files, <clip name>.npz each: as a clip's hand.npz, if need be with frames and K."""
    cad: OptionalFolder = None
    """Meshes of the categories, <category>.obj each, in metres, z up; without, this package's own."""
    priors: OptionalFolder = None
    """Poses to start from, by category and hand, for reconstruct --init priors: only looked at."""
    cameras: OptionalFolder = None
    """EPIC-Fields' cameras, <video>.json each."""
    focal: Annotated[float | None, arg(metavar="PX", help_behavior_hint="(default: a guess)")] = None
    """Instead of cameras, the focal length in pixels of images 854 wide."""
    errata: Annotated[Path | None, arg(metavar="CSV", help_behavior_hint="(default: beside the table)")] = None
    """EPIC-Grasps' errata."""
    out: Folder
    """Where the clips go, a folder each. Those that are there already are kept, unless they lack hands found now."""

    def run(self) -> int:
        from getagrip.commands.import_epic import Sources, import_epic

        sources = Sources(
            self.visor, self.frames, self.videos, self.hands, self.cad, self.cameras, self.focal
        )  # fmt: skip
        return import_epic(self.csv, self.errata, sources, self.priors, self.out, self.debug)


@dataclass(frozen=True, kw_only=True)
class ImportHands(Command):
    """Hands from an estimator's files: into a clip that lacks them, or into a file for a clip to come."""

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE...", help_behavior_hint="")]
    """.npz, .json, .pkl, .pt, .npy: a file for each image, named like it, or one for all (docs/estimators.md)."""
    source: Annotated[Literal["hamer", "wilor", "hawor", "frankmocap", "mano", "joints"], arg(name="from")]
    """Whose they are; mano: plain parameters; joints: 21 of them in metres, before the camera."""
    clip: Annotated[Path | None, arg(metavar="CLIP", help_behavior_hint="")] = None
    """The clip's folder. Its side, its frames and its camera are taken from it."""
    out: OptionalFile = None
    """Instead of a clip, a file for clip new --hands. It needs --side, --frames, --size and a camera."""
    mano: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: the generic hand)")] = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl."""
    pose: Literal["axis-angle", "pca", "matrix"] | None = None
    """mano: what hand_pose holds."""
    mean: Literal["flat", "mean"] | None = None
    """mano: whether poses are relative to the flat hand or to MANO's mean pose."""
    order: Literal["openpose", "ho3d"] | None = None
    """joints: their order (docs/hands.md)."""
    estimator_focal: Annotated[float | None, arg(metavar="PX", help_behavior_hint="")] = None
    """hawor: the focal length that it was run with."""
    first: Annotated[int, arg(metavar="N", help_behavior_hint="(default: 1, the video's first)")] = 1
    """hawor: the number of the first frame that it was run on, which it calls 0."""
    side: Literal["left", "right"] | None = None
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
    overwrite: Flag = False
    """Replace hands that are there already."""

    def check(self) -> None:
        from getagrip.io import files

        if self.out is not None:
            files.check_file("--out", self.out)

    def run(self) -> int:
        from getagrip.clip.intrinsics import Lens
        from getagrip.commands.import_hands import Told, import_hands

        told = Told(self.mano, self.pose, self.mean, self.order, self.estimator_focal, self.first)
        lens = Lens(self.K, self.focal, self.guess_focal)
        new = (self.side, self.frames, self.size, lens)
        return import_hands(self.files, self.source, told, self.clip, self.out, new, self.overwrite)


@dataclass(frozen=True, kw_only=True)
class ImportMasks(Command):
    """Masks from files: a folder of PNG (labels, palettes as of SAM 2, colours), COCO's .json, or .npz, into a clip."""

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The folder or file; images are named like the clip's frames, or by the same numbers."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder."""
    object: Labels = ()
    """The object: values of its labels, #rrggbb, or names of COCO's categories. Not needed where there is one only."""
    ignore: Labels = ()
    """What hides it, likewise: hands, other things in front."""
    first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")] = None
    """The number of the first frame's mask, where masks are counted differently from frames."""
    overwrite: Flag = False
    """Replace masks that are there already."""

    def run(self) -> int:
        from getagrip.commands.import_masks import into_clip

        return into_clip(self.path, self.object, self.ignore, self.first, self.clip, self.overwrite)


def _dataset(name: str, what: str) -> Any:
    """The subcommand of ``import`` for a dataset with true poses."""
    return subcommand(name, description=what, default=Import(source=name, root=tyro.MISSING, out=tyro.MISSING))


Imports = (
    Annotated[Import, _dataset("hot3d", "Raw HOT3D recordings: every hold of an object by a hand.")]
    | Annotated[Import, _dataset("dexycb", "DexYCB, or a packed file of its sequences: every stable grasp seen.")]
    | Annotated[Import, _dataset("arctic", "ARCTIC's raw sequences: every stable grasp seen.")]
    | Annotated[Import, _dataset("hoi4d", "HOI4D's rigid objects: every stable grasp seen.")]
    | Annotated[Import, _dataset("ho3d", "HO-3D: every stable grasp seen.")]
    | Annotated[ImportEpic, subcommand("epic")]
    | Annotated[ImportHands, subcommand("hands")]
    | Annotated[ImportMasks, subcommand("masks")]
)
