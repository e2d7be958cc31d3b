"""Commands that begin with a video: a clip of one's own, candidates in EPIC-KITCHENS, annotation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.cli.command import Command, Focal, Intrinsics, Labels, OptionalSide
from getagrip.io.arguments import File, Flag, Folder, OptionalFile

Category = Literal["bottle", "bowl", "can", "cup", "glass", "mug", "pan", "plate", "saucepan"]


@dataclass(frozen=True, kw_only=True)
class ClipCommand(Command):
    """Make a clip of your own video, in one go or in steps. What is missing is listed, with how to get it."""

    video: Annotated[Positional[Path], arg(metavar="VIDEO|FOLDER")]
    """The video, undistorted; or a folder of its images, in the order of the numbers in their names."""
    out: Folder
    """The clip's folder; its name is the clip's."""
    interval: Annotated[tuple[int, int] | None, arg(metavar="START END", help_behavior_hint="")] = None
    """The stable grasp, or all that is to be a timeline: first and last frame, counted from 1."""
    side: OptionalSide = None
    """Which hand."""
    mesh: Annotated[Path | None, arg(metavar="FILE|KIND", help_behavior_hint="")] = None
    """The object's shape: .obj, .ply, .stl or .glb. Or, where there is no such file, the kind of a shape that this
    package has: bottle, bowl, can, cup, glass, mug, pan, plate, saucepan, box, ..."""
    size_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest side of its bounding box."""
    diameter_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest distance between two of its points."""
    unit: Annotated[Literal["mm", "cm", "m", "in"] | None, arg(help_behavior_hint="(default: m)")] = None
    """The unit of the mesh file."""
    known_scale: Flag = False
    """The mesh, in its unit, has the object's size. Else, unless it is rescaled, its size is found with its pose."""
    category: Annotated[str | None, arg(metavar="WORD", help_behavior_hint="(default: KIND, or object)")] = None
    """What it is, in a word."""
    masks: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """As for import masks, which can add them later."""
    mask_first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: START)")] = None
    """The number of the mask of frame START."""
    mask_images: str = ""
    """Which images of the masks are meant where there are several of a frame: a folder, or a pattern of names."""
    object: Labels = ()
    """Of the masks: the object's labels."""
    ignore: Labels = ()
    """Of the masks: labels of what hides it."""
    hand: Labels = ()
    """Of the masks: labels of the hand that holds it. It is ignored as well, and --hands are corrected by it."""
    hands: OptionalFile = None
    """A hand.npz; import hands makes one, and can add it later."""
    hand_first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")] = None
    """The number of the first frame's hand. Needed where hands are counted from another start."""
    segments: OptionalFile = None
    """What the object does from frame to frame, as annotate writes it; import segments can add it later."""
    still_camera: Flag = False
    """The camera did not move: its frame is the world."""
    K: Intrinsics = None
    """The camera. Not needed where the hand file has it."""
    focal: Focal = None
    """Instead of K, the focal length; the principal point is in the middle."""
    fps: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="(default: 30)")] = None
    """Frames per second of a folder of images; a video has its frames' own times."""
    guess_focal: Flag = False
    """Guess it. Depths and sizes are guesses then, too."""
    overwrite: Flag = False
    """Replace a clip that is there already."""

    def run(self) -> int:
        from getagrip.clip.intrinsics import Lens
        from getagrip.commands.new_clip import Ingredients, new_clip
        from getagrip.commands.own_mesh import MeshRequest

        sizes = (self.size_mm, self.diameter_mm, self.known_scale, self.unit)
        given = Ingredients(
            video=self.video, interval=self.interval, side=self.side, category=self.category,
            mesh=None if self.mesh is None else MeshRequest(self.mesh, *sizes), masks=self.masks,
            mask_of_first=self.mask_first, mask_images=self.mask_images,
            object=self.object, ignore=self.ignore, hand=self.hand, hands=self.hands,
            lens=Lens(self.K, self.focal, self.guess_focal), segments=self.segments,
            still_camera=self.still_camera, fps=self.fps, hand_of_first=self.hand_first,
        )  # fmt: skip
        return new_clip(given, self.out, self.overwrite)


@dataclass(frozen=True, kw_only=True)
class Epic(Command):
    """Find where stable grasps may be in EPIC-KITCHENS: where VISOR says that a hand touches an object."""

    visor: Folder
    """VISOR's sparse annotations, and its frame_mapping.json, anywhere below."""
    actions: Annotated[tuple[Path, ...], arg(metavar="CSV...")]
    """EPIC-100's action labels: EPIC_100_train.csv, EPIC_100_validation.csv."""
    categories: Annotated[tuple[Category, ...], arg(help_behavior_hint="(default: all)")] = ()
    """Kinds of objects."""
    out: File
    """Where the table goes (CSV)."""
    json: OptionalFile = None
    """Write all that is known of the candidates here."""

    def check(self) -> None:
        from getagrip.io import files

        files.check_file("--out", self.out)
        if self.json is not None:
            files.check_file("--json", self.json)

    def run(self) -> int:
        from getagrip.commands.epic_candidates import find_candidates

        return find_candidates(self.visor, self.actions, self.categories, self.out, self.json, self.debug)


@dataclass(frozen=True, kw_only=True)
class Annotate(Command):
    """Mark stable grasps, or all that an object does, and label frames, on a page that only this machine can open."""

    source: Annotated[Positional[Path], arg(metavar="VIDEO|CANDIDATES")]
    """A video, a folder of images, or a list (.csv, .json) of videos with rough start and end, hand and category, as
    epic candidates writes it."""
    out: Folder
    """Where marks are kept as they are made. Called again with the same folder, it goes on where it stopped."""
    videos: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: where the list is)")] = None
    """For a list: where its videos are, or folders of their images."""
    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 8765, or the next free one)")] = None
    """Where the page is served, on 127.0.0.1."""
    K: Intrinsics = None
    """The camera, for the hands that are fitted to clicked joints. Without it their depth and size are guesses."""
    focal: Focal = None
    """Instead of K, the focal length; the principal point is in the middle."""
    export: Flag = False
    """Serve nothing: write the grasps marked so far, each person's as a table and as JSON, and how far people agree;
    the segments of whole interactions; of what is labelled the labels, hand.npz and masks, too."""
    import_labels: OptionalFile = None
    """Import a labels file in the place of the labels of its frames, and exit."""
    import_segments: OptionalFile = None
    """Import segments that segment --from-masks has found, or anybody has marked, as a first draft, and exit."""
    annotator: Annotated[str, arg(metavar="NAME")] = "imported"
    """import-labels, import-segments: whose they are from now on."""

    def run(self) -> int:
        from getagrip.clip.intrinsics import Lens
        from getagrip.commands.annotate import AnnotateRequest, annotate

        request = AnnotateRequest(self.import_labels, self.import_segments, self.annotator, self.export)
        return annotate(self.source, self.videos, self.out, self.port, Lens(self.K, self.focal), request)
