"""The command line: what each command takes. What it does stands elsewhere, and is imported when it runs."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, Suppress, arg, subcommand

from getagrip.errors import GetagripError, UsageError
from getagrip.options import Init, Method, Options, PriorsFile

Clips = Annotated[Positional[tuple[Path, ...]], arg(metavar="CLIP...", help_behavior_hint="")]
Results = Annotated[Positional[tuple[Path, ...]], arg(metavar="RESULT...", help_behavior_hint="")]
Folder = Annotated[Path, arg(metavar="DIR")]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
Category = Literal["bottle", "bowl", "can", "cup", "glass", "mug", "pan", "plate", "saucepan"]
Workers = Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core for more than 3 clips)")]
Inits = Annotated[int, arg(metavar="N")]
PriorsPath = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Intrinsics = Annotated[
    tuple[float, float, float, float] | None, arg(name="K", metavar="FX FY CX CY", help_behavior_hint="")
]
Focal = Annotated[float | None, arg(metavar="PX", help_behavior_hint="")]
Labels = Annotated[tuple[str, ...], arg(metavar="LABEL...", help_behavior_hint="")]
Flag = Annotated[bool, FlagCreatePairsOff, arg(help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class Command:
    """What every command takes."""

    debug: Flag = False
    """Show where an error arose."""

    def run(self) -> int:
        """Do it, and return the exit status."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise ``UsageError`` where what it writes has no place, before any work is done."""
        from getagrip import files

        if (out := getattr(self, "out", None)) is not None:
            files.check_folder("--out", out)
        if (json := getattr(self, "json", None)) is not None:
            files.check_file("--json", json)


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Make a clip, reconstruct it, evaluate it, and draw a report."""

    out: Folder = Path("out/demo")
    """Where the clip, the result and report.png go."""

    def run(self) -> int:
        from getagrip import demo

        demo.run(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class Reconstruct(Command):
    """Find the pose of the object in the hand, in the frames of each clip."""

    clips: Clips = ()
    """Clip folders, or folders of clips."""
    out: Folder
    """Where the results go: a folder for each clip, of the clip's name. Those that are there already are kept."""
    method: Method = "soft-hinge"
    """How the object may move in the hand: about one axis (the paper's), a little off it too, not at all, freely. The
    last three are other people's methods, to compare with."""
    inits: Inits = 50
    """Poses to start from."""
    init: Init = "uniform"
    """Rotations spread evenly (uniform); or first those that init learn has found (clusters) or that a folder holds by
    category and side, as the authors of the paper keep theirs (priors), and even ones for the rest."""
    priors: PriorsPath = None
    """For clusters, the file that init learn has written; for priors, the folder."""
    thorough: Flag = False
    """Search longer, about three times."""
    seed: Annotated[int, arg(metavar="S")] = 0
    """Seed of all that is random."""
    frames: Annotated[int, arg(metavar="N")] = 30
    """Frames to use, spread evenly over the clip."""
    workers: Workers = None
    """Processes to share the clips between."""
    overwrite: Flag = False
    """Make results again that are there already."""

    def run(self) -> int:
        from getagrip.run.batch import reconstruct_clips

        options = Options(
            method=self.method, inits=self.inits, seed=self.seed, frames=self.frames, thorough=self.thorough,
            init=self.init, priors=_priors(self.priors, self.init),
        )  # fmt: skip
        return reconstruct_clips(self.clips, self.out, options, self.workers, self.overwrite, self.debug)


@dataclass(frozen=True, kw_only=True)
class Evaluate(Command):
    """Print the metrics of results against their clips."""

    results: Results = ()
    """Result folders, or folders of results."""
    clips: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: where they were made from)")] = None
    """A clip, or the folder that holds the clips by name."""
    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Write every number here, unrounded."""

    def run(self) -> int:
        from getagrip.run.scores import evaluate_results

        return evaluate_results(self.results, self.clips, self.json, self.debug)


@dataclass(frozen=True, kw_only=True)
class Segment(Command):
    """Find the stable grasps in clips with true poses; no masks are needed."""

    clips: Clips = ()
    """Clip folders, or folders of clips."""
    tau: float = 0.5
    """In a stable grasp, the contacts of every two frames have an intersection over union above this."""
    contact_mm: Annotated[float, arg(metavar="MM")] = 0.0
    """Points of the object so near to the hand's surface, or inside it, are in contact."""
    points: Literal["vertices", "area", "fragments"] = "vertices"
    """Contact is a set of vertices, of points spread evenly over the object's area, or of patches."""
    rule: Literal["all-pairs", "first", "consecutive"] = "all-pairs"
    """Frames that are compared: all (the paper's definition), all with the first, or neighbours (two weaker tests)."""
    shortest: Annotated[int, arg(metavar="N")] = 20
    """Frames of the shortest grasp."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Write segments.csv and a picture of each clip here."""
    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Write every number here, unrounded."""
    workers: Workers = None
    """Processes to share the clips between."""

    def run(self) -> int:
        from getagrip.grasps import Definition
        from getagrip.run.segments import segment_clips

        definition = Definition(self.tau, self.contact_mm / 1e3, self.points, self.rule, self.shortest)
        return segment_clips(self.clips, definition, self.out, self.json, self.workers, self.debug)


@dataclass(frozen=True, kw_only=True)
class Study(Command):
    """Measure what changes within the stable grasps of clips with true poses, and outside them: the paper's study."""

    clips: Clips = ()
    """Clip folders, or folders of clips: whole sequences, not cut to grasps, show what is outside. No masks needed."""
    out: Folder
    """Where study.png, grasps.csv, curves.csv and summary.csv go."""
    tau: float = 0.5
    """In a stable grasp, the contacts of every two frames have an intersection over union above this."""
    contact_mm: Annotated[float, arg(metavar="MM")] = 0.0
    """Points of the object so near to the hand's surface, or inside it, are in contact."""
    points: Literal["vertices", "area", "fragments"] = "vertices"
    """Contact is a set of vertices, of points spread evenly over the object's area, or of patches."""
    rule: Literal["all-pairs", "first", "consecutive"] = "all-pairs"
    """Frames that are compared, as for the command segment."""
    shortest: Annotated[int, arg(metavar="N")] = 20
    """Frames of the shortest grasp."""
    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Write every number here, unrounded."""
    workers: Workers = None
    """Processes to share the clips between."""

    def run(self) -> int:
        from getagrip.grasps import Definition
        from getagrip.run.study import study_clips

        definition = Definition(self.tau, self.contact_mm / 1e3, self.points, self.rule, self.shortest)
        return study_clips(self.clips, definition, self.out, self.json, self.workers, self.debug)


@dataclass(frozen=True, kw_only=True)
class Stats(Command):
    """Print how long stable grasps last, category by category: the paper's dataset tables."""

    source: Annotated[Positional[str], arg(metavar="epic-grasps|LIST")]
    """epic-grasps, followed by its CSV; or a list that segment wrote: its segments.csv or JSON."""
    csv: Annotated[Positional[Path | None], arg(metavar="CSV", help_behavior_hint="")] = None
    """EPIC-Grasps' table, as published."""
    fps: Annotated[Literal["paper", "true"] | None, arg(help_behavior_hint="(default: paper)")] = None
    """epic-grasps: 50 frames per second in every video, as the paper has it, or as its frames are really numbered."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Write stats.md and stats.csv here."""
    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Write every number here, unrounded."""

    def run(self) -> int:
        from getagrip.run.stats import print_stats

        return print_stats(self.source, self.csv, self.fps, self.out, self.json)


@dataclass(frozen=True, kw_only=True)
class Bench(Command):
    """Compare methods on a dataset: the paper's tables, with intervals. What is done already is kept."""

    dataset: Annotated[Positional[str], arg(metavar="DATASET")]
    """synthetic, dexycb, or a folder of clips with their truth."""
    out: Folder
    """Where clips, results, tables and plots go. Called again with the same folder, it goes on where it stopped."""
    methods: Annotated[tuple[Method, ...], arg(help_behavior_hint="(default: all)")] = ()
    """What to compare. An ablation compares one-dof and soft-hinge, unless others are named."""
    ablation: Annotated[
        Literal["physical", "occlusion", "axis", "inits", "hand-noise", "mask-noise", "scale", "sca"] | None,
        arg(help_behavior_hint="(default: none)"),
    ] = None
    """Instead of methods as they are, compare each in several settings."""
    split: Annotated[
        Literal["train", "test", "all"] | None, arg(help_behavior_hint="(default: test; all of a folder)")
    ] = None
    """Which part of a dataset: train is for tuning."""
    clips: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """So many clips of it, spread evenly."""
    preset: Literal["clean", "hamer", "frankmocap", "wild"] = "clean"
    """synthetic: everything as it is, with the errors of a hand tracker, or with little known, as in the wild."""
    root: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """dexycb: where it is, as for the command import."""
    meshes: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """dexycb: where the YCB meshes are."""
    init: Init = "uniform"
    """Where the search starts: as for reconstruct."""
    priors: PriorsPath = None
    """For clusters and priors: the file or folder, as for reconstruct."""
    inits: Inits = 50
    """Poses to start from."""
    thorough: Flag = False
    """Search longer, about three times."""
    seed: Annotated[int, arg(metavar="S")] = 0
    """Seed of all that is random."""
    workers: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Processes to share the clips between."""
    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Write every number here, unrounded."""
    overwrite: Flag = False
    """Make results again that are there already."""

    def run(self) -> int:
        from getagrip.bench.command import Plan, bench
        from getagrip.bench.sources import Source

        source = Source(self.dataset, self.out / "clips", self.split, self.clips, self.preset, self.root, self.meshes)
        options = Options(
            inits=self.inits, seed=self.seed, thorough=self.thorough, init=self.init,
            priors=_priors(self.priors, self.init),
        )  # fmt: skip
        choice = (self.methods, self.ablation, options)
        return bench(Plan(source, self.out, *choice, self.workers, self.overwrite, self.json), self.debug)


@dataclass(frozen=True, kw_only=True)
class InitCommand(Command):
    """Learn where a search may start, from clips with true poses: rotations of each kind of object in each hand."""

    action: Positional[Literal["learn"]]
    """learn: cluster the true rotations, and take the mean of the true translations."""
    clips: Clips = ()
    """Clip folders, or folders of clips."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Where the poses go. The file says whose hands it was learnt from, and is not used for those."""
    k: int = 50
    """Rotations of each kind of object in each hand."""
    leave_out: Annotated[tuple[str, ...], arg(metavar="SUBJECT...", help_behavior_hint="")] = ()
    """Whose hands not to learn from: those on whose clips the poses will be tried."""
    way: Annotated[Literal["geodesic", "axis-angle"], arg(name="clusters")] = "geodesic"
    """k-means by the angles between rotations; or, as in the paper, of rotation vectors."""
    seed: Annotated[int, arg(metavar="S")] = 0
    """Seed of all that is random."""

    def check(self) -> None:
        from getagrip import files

        files.check_file("--out", self.out)

    def run(self) -> int:
        from getagrip.run.init import learn

        return learn(self.clips, self.out, self.k, self.way, self.leave_out, self.seed, self.debug)


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
    mano: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """arctic, hoi4d: folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl. ho3d too: without, the generic hand is fitted."""
    view: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 0)")] = None
    """arctic: the camera, 0 on the head, 1 to 8 fixed."""
    whole: Flag = False
    """dexycb, arctic, hoi4d, ho3d: not the grasps but all frames, without masks: for segment and study."""

    def run(self) -> int:
        from getagrip.run.imports import Given, import_clips

        given = Given(self.meshes, self.mano, self.view, self.whole)
        return import_clips(self.source, self.root, self.out, given, self.debug)


@dataclass(frozen=True, kw_only=True)
class ImportEpic(Command):
    """EPIC-Grasps: its stable grasps in EPIC-KITCHENS, with VISOR's masks; hands come from an estimator's files."""

    csv: Annotated[Positional[Path], arg(metavar="CSV")]
    """EPIC-Grasps' table, as published. Its errata are applied where they lie beside it (<CSV>_errata.csv)."""
    visor: Folder
    """VISOR's annotations, sparse, dense or both, and its frame_mapping.json, anywhere below."""
    frames: OptionalFolder = None
    """EPIC-KITCHENS' images: P01/rgb_frames/P01_01/frame_0000000001.jpg, or P01_01/..."""
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
        from getagrip.run.epic import Sources, import_epic

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
    out: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
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
        from getagrip import files

        if self.out is not None:
            files.check_file("--out", self.out)

    def run(self) -> int:
        from getagrip.run.hands import Told, import_hands
        from getagrip.run.intrinsics import Lens

        told = Told(self.mano, self.pose, self.mean, self.order, self.estimator_focal)
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
        from getagrip.run.masks import into_clip

        return into_clip(self.path, self.object, self.ignore, self.first, self.clip, self.overwrite)


@dataclass(frozen=True, kw_only=True)
class ClipCommand(Command):
    """Make a clip of your own video, in one go or in steps: what is missing is told, and how to get it."""

    action: Positional[Literal["new"]]
    """new: make one."""
    video: Annotated[Positional[Path], arg(metavar="VIDEO")]
    """The video, undistorted."""
    out: Folder
    """The clip's folder; its name is the clip's."""
    interval: Annotated[tuple[int, int] | None, arg(metavar="START END", help_behavior_hint="")] = None
    """The stable grasp: its first and last frame, counted from 1."""
    side: Literal["left", "right"] | None = None
    """Which hand."""
    mesh: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """The object's shape: .obj, .ply, .stl or .glb."""
    size_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest side of its bounding box."""
    diameter_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest distance between two of its points."""
    known_scale: Flag = False
    """The mesh, in metres, has the object's size. Else, unless it is rescaled, its size is found with its pose."""
    category: str = "object"
    """What it is, in a word."""
    masks: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """As for import masks, which can add them later."""
    mask_first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: START)")] = None
    """The number of the mask of frame START."""
    object: Labels = ()
    """Of the masks: the object's labels."""
    ignore: Labels = ()
    """Of the masks: labels of what hides it."""
    hands: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """A hand.npz; import hands makes one, and can add it later."""
    K: Intrinsics = None
    """The camera. Not needed where the hand file has it."""
    focal: Focal = None
    """Instead of K, the focal length; the principal point is in the middle."""
    guess_focal: Flag = False
    """Guess it. Depths and sizes are guesses then, too."""
    overwrite: Flag = False
    """Replace a clip that is there already."""

    def run(self) -> int:
        from getagrip.run.intrinsics import Lens
        from getagrip.run.own_video import Ingredients, new_clip

        given = Ingredients(
            video=self.video, interval=self.interval, side=self.side, category=self.category, mesh=self.mesh,
            side_mm=self.size_mm, diameter_mm=self.diameter_mm, known_scale=self.known_scale, masks=self.masks,
            mask_of_first=self.mask_first, object=self.object, ignore=self.ignore, hands=self.hands,
            lens=Lens(self.K, self.focal, self.guess_focal),
        )  # fmt: skip
        return new_clip(given, self.out, self.overwrite)


@dataclass(frozen=True, kw_only=True)
class Epic(Command):
    """Find where stable grasps may be in EPIC-KITCHENS: where VISOR says that a hand touches an object."""

    action: Positional[Literal["candidates"]]
    """candidates: a table of hands, objects and rough extents, to be annotated."""
    visor: Folder
    """VISOR's sparse annotations, and its frame_mapping.json, anywhere below."""
    actions: Annotated[tuple[Path, ...], arg(metavar="CSV...")]
    """EPIC-100's action labels: EPIC_100_train.csv, EPIC_100_validation.csv."""
    categories: Annotated[tuple[Category, ...], arg(help_behavior_hint="(default: all)")] = ()
    """Kinds of objects."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Where the table goes (CSV)."""
    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Write all that is known of the candidates here."""

    def check(self) -> None:
        from getagrip import files

        files.check_file("--out", self.out)
        if self.json is not None:
            files.check_file("--json", self.json)

    def run(self) -> int:
        from getagrip.run.epic import find_candidates

        return find_candidates(self.visor, self.actions, self.categories, self.out, self.json, self.debug)


@dataclass(frozen=True, kw_only=True)
class Annotate(Command):
    """Mark where stable grasps start and end, on a page in your browser that only this machine can open."""

    source: Annotated[Positional[Path], arg(metavar="VIDEO|CANDIDATES")]
    """A video, a folder of images, or a list (.csv, .json) of videos with rough start and end, hand and category, as
    epic candidates writes it."""
    out: Folder
    """Where marks are kept as they are made. Called again with the same folder, it goes on where it stopped."""
    videos: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: where the list is)")] = None
    """For a list: where its videos are, or folders of their images."""
    port: int = 8765
    """Where the page is served, on 127.0.0.1."""
    export: Flag = False
    """Serve nothing: write the grasps marked so far, each person's as a table and as JSON, and how far people agree."""

    def run(self) -> int:
        from getagrip.annotate.command import annotate

        return annotate(self.source, self.videos, self.out, self.port, self.export)


@dataclass(frozen=True, kw_only=True)
class Report(Command):
    """Draw a picture of a result into its folder: report.png."""

    result: Annotated[Positional[Path], arg(metavar="RESULT")]
    """A result folder."""

    def run(self) -> int:
        from getagrip.run.scores import report_result

        return report_result(self.result)


@dataclass(frozen=True, kw_only=True)
class Doctor(Command):
    """Check the installation, and compile what the first run would have to."""

    def run(self) -> int:
        from getagrip import doctor

        return doctor.run()


def _priors(path: Path | None, init: Init) -> PriorsFile | None:
    """The starting poses that the user names, identified."""
    if init == "uniform" and path is not None:
        raise UsageError(f"--priors: got {path}, expected none without --init clusters or priors")
    if path is None:
        if init != "uniform":
            raise UsageError(f"--priors: got nothing, expected a file or folder for --init {init}")
        return None
    from getagrip import priors

    return priors.given(path, init)


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
Commands = (
    Annotated[Demo, subcommand("demo")]
    | Annotated[Reconstruct, subcommand("reconstruct")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[Segment, subcommand("segment")]
    | Annotated[Study, subcommand("study")]
    | Annotated[Stats, subcommand("stats")]
    | Annotated[Bench, subcommand("bench")]
    | Annotated[InitCommand, subcommand("init")]
    | Annotated[Imports, subcommand("import", description="Make clips from other people's layouts.")]
    | Annotated[ClipCommand, subcommand("clip")]
    | Annotated[Epic, subcommand("epic")]
    | Annotated[Annotate, subcommand("annotate")]
    | Annotated[Report, subcommand("report")]
    | Annotated[Doctor, subcommand("doctor")]
)
DESCRIPTION = "Where an object is in the hand that holds it: from hands, masks and the object's mesh, for every frame."


def main(args: Sequence[str] | None = None) -> int:
    """Run a command. Returns 0 when all is done, 1 when some of it failed, 2 when the call is wrong."""
    command: Command = tyro.cli(
        Commands, prog="getagrip", description=DESCRIPTION, args=args, config=(OmitArgPrefixes,)
    )
    try:
        command.check()
        return command.run()
    except KeyboardInterrupt:
        print("interrupted; what was finished is kept", file=sys.stderr)
        return 130
    except (GetagripError, OSError) as error:
        if command.debug:
            traceback.print_exc()
        print(f"getagrip: {error}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
