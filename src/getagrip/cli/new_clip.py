"""``getagrip clip new``: a clip from the user's own video, masks, hands and mesh.

A clip can be made in steps: without hands or masks it is written with its images, for an estimator or a segmentation.
Missing inputs are listed with instructions. The mesh comes from a file, or is a built-in shape; its size may be stated.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from getagrip.cli.command import WARNING_EXIT_STATUS, Command, FirstNumber, Labels, OptionalSide, refuse_existing
from getagrip.cli.view_options import NewView, ViewOptions
from getagrip.errors import InputError, UsageError
from getagrip.geometry.lens import Distortion, Lens
from getagrip.io import files
from getagrip.io.options import Flag, Folder, OptionalFile, one_of
from getagrip.io.terminal import format_count, warn

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8
    from numpy import ndarray

    from getagrip.clip import Clip, HandTrack
    from getagrip.clip.read import SegmentList
    from getagrip.geometry.mesh import Mesh
    from getagrip.provenance import Provenance, Source
    from getagrip.readers.masks.mask_request import MaskReader
    from getagrip.readers.trackers import TrackedHands

Unit = Literal["mm", "cm", "m", "in"]
METRES_PER_UNIT: dict[Unit, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
MIN_PART_SIZE_FRACTION = 0.05
"""Size, as a fraction of the mesh's, below which a separate part is debris."""
FREE_SCALE_SIZE_M = 0.1
"""Largest side of a mesh of free scale whose own size in metres is implausible for a hand-held object [m]."""
CAMERA_TOLERANCE = 0.02
"""Relative difference of intrinsics up to which two cameras are the same."""
MAX_CLIP_FRAMES = 20_000
"""Maximum number of frames of a clip: minutes."""
MISSING_OPTION_HINTS = {
    "interval": "--interval START END: the frames between which the grasp is stable, counted from 1; "
    "getagrip annotate {video} --out DIR finds them; or all frames, for reconstruct --find-grasps",
    "side": "--side left|right: the hand that holds the object",
    "mesh": "--mesh FILE: the object's shape (.obj, .ply, .stl, .glb), a CAD, a scan, or what an image-to-3D tool "
    "makes of a frame; or --mesh KIND, as plate, for a shape of this package's own; with --size-mm or --diameter-mm if "
    "its size is known",
    "camera": "--K FX FY CX CY from a calibration, or --focal PX; --guess-focal if there is none: depth and size are "
    "then guesses, too",
}
"""Instructions for required inputs."""
NEXT_STEP_HINTS = {
    "masks": "masks of the object and the hand: SAM 2 or any segmentation of {out}/frames, as PNG labels, COCO "
    "or .npz; then getagrip import masks PATH --object LABEL --hand LABEL --clip {out}. Without a segmentation: "
    "getagrip annotate {video} --out DIR (docs/annotate.md)",
    "hands": "run an estimator on {out}/frames (docs/estimators.md); then getagrip import hands FILE... --from ... "
    "--clip {out}. Without an estimator: click joints in getagrip annotate {video} --out DIR (docs/annotate.md)",
    "view": "masks of view {view}: any segmentation of {out}/views/{view}/frames; then getagrip import masks PATH "
    "--object LABEL --hand LABEL --clip {out} --view {view}",
}
"""Instructions for inputs that can be added later; the page of ``annotate`` makes both at once."""


@dataclass(frozen=True)
class MeshOptions:
    """The mesh of a user's own clip, and its size."""

    mesh: Annotated[Path | None, arg(metavar="FILE|KIND", help_behavior_hint="")] = None
    """The object's shape: a file (.obj, .ply, .stl or .glb) or, if there is no such file, the kind of a built-in shape:
    bottle, bowl, can, cup, glass, mug, pan, plate, saucepan, box, ..."""
    size_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest side of its bounding box."""
    diameter_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest distance between two of its points."""
    unit: Annotated[Unit | None, one_of("mm", "cm", "m", "in"), arg(help_behavior_hint="(default: m)")] = None
    """The unit of the mesh file."""
    part: Annotated[str | None, arg(metavar="N|all", help_behavior_hint="")] = None
    """The part of the mesh that is the object, if it has separate ones, as a scan has with its table: 1 is the largest.
    all: all of them are."""
    known_scale: Flag = False
    """The mesh, in its unit, has the object's true size. Without this and without rescaling, the size is estimated."""
    handle: Annotated[
        tuple[str, ...], arg(metavar="X,Y,Z...|none", help_behavior_hint="(default: as it is found)")
    ] = ()
    """The handle: points along its middle line, in order, in the coordinates of the mesh file. none: there is none."""

    @property
    def handle_line(self) -> Float[ndarray, "P 3"] | None:
        """Points of the handle's middle line, in the mesh file's coordinates; None if unstated.

        Raises ``UsageError``.
        """
        import numpy as np

        if not self.handle:
            return None
        try:
            points = [] if self.handle == ("none",) else [[float(x) for x in point.split(",")] for point in self.handle]
            line = np.array(points, dtype=float).reshape(len(points), 3)
        except ValueError:
            line = np.full((1, 3), np.nan)
        if not np.isfinite(line).all():
            got = " ".join(self.handle)
            raise UsageError(f"--handle must be points X,Y,Z in the coordinates of the mesh, or none (got {got})")
        return line

    @property
    def path(self) -> Path:
        """The mesh file or built-in shape. Raises ``UsageError`` if none is named."""
        if self.mesh is None:
            raise UsageError("missing --mesh: the object's shape")
        return self.mesh

    @property
    def kind(self) -> str | None:
        """The name of a built-in shape; None for a file."""
        from getagrip.synthetic.categories import SHAPE_MAKERS

        name = str(self.mesh)
        return name if name in SHAPE_MAKERS and not Path(name).is_file() else None


@dataclass(frozen=True)
class OwnMesh:
    """A mesh in metres."""

    mesh: Mesh
    sized: bool
    """True if the mesh has the object's size; False: the size is estimated with the pose."""
    provenance: dict[str, Source]
    """Sources of the mesh and its size."""
    handle: Float[ndarray, "P 3"] | None = None
    """Points of the handle's middle line, as stated; None if unstated."""


def read_own_mesh(request: MeshOptions) -> OwnMesh:
    """Read the mesh at the stated size.

    Raises ``InputError`` for a missing file or one without a mesh, ``UsageError`` for options that do not fit.
    """
    from getagrip.clip.read_arrays import check_handle
    from getagrip.geometry.mesh_files import checked_mesh, drop_degenerate_faces
    from getagrip.provenance import assumed

    if request.kind is not None and request.known_scale:
        own = f"this package's own {request.kind}, whose size is not that of the one in your video"
        raise UsageError(f"--known-scale cannot be used with {own}: --size-mm or --diameter-mm")
    if request.kind is not None and request.unit is not None:
        raise UsageError(f"--unit cannot be used with this package's own {request.kind}, which is in metres")
    vertices, faces, shape = _read_mesh_arrays(request)
    words = shape.text
    kept = drop_degenerate_faces(vertices, faces)  # generated meshes are full of slivers
    if len(kept) < len(faces):
        words += f", {format_count(len(faces) - len(kept), 'face')} without area left out"
    kept, words_of_part, guess = _select_mesh_part(vertices, kept, request)
    words += words_of_part
    vertices, kept, colours, without = _paint_mesh(request, vertices, kept)
    words += without
    factor, scale = _scale_of_mesh(vertices, kept, request)
    vertices = factor * vertices
    if request.unit is not None:
        words += f", in {request.unit}"
    shape = assumed(words) if guess else replace(shape, text=words)
    provenance = {"mesh": shape} | ({} if scale is None else {"scale": scale})
    sized = request.known_scale or request.size_mm is not None or request.diameter_mm is not None
    mesh, handle = checked_mesh(request.path, vertices, kept), request.handle_line
    if handle is not None:
        handle = factor * handle
        check_handle(request.path, handle, mesh)
    return OwnMesh(mesh if colours is None else mesh.coloured_like(vertices, colours), sized, provenance, handle)


def _paint_mesh(
    request: MeshOptions, vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."]
) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."], UInt8[ndarray, "V 3"] | None, str]:
    """Read the colours of a mesh's vertices, subdivided where a texture needs it; without any, describe why."""
    from scipy.spatial import cKDTree

    from getagrip.geometry.mesh import subdivide_surface
    from getagrip.geometry.mesh_files.colours import (
        ColouredPoints,
        names_texture,
        painted_edge,
        parse_colours,
        texture_colours,
    )

    if request.kind is not None or not _is_usable(vertices, faces):
        return vertices, faces, None, ""
    try:
        if names_texture(request.path):
            longest = painted_edge(vertices, faces)
            painted: ColouredPoints | None = texture_colours(request.path, longest)
            vertices, faces = subdivide_surface(vertices, faces, longest)
        else:
            painted = parse_colours(request.path)
    except InputError as error:  # a pose needs no colours
        return vertices, faces, None, f", without its texture ({error.key}: {error.got})"
    if painted is None or painted.points.shape[1:] != vertices.shape[1:]:
        return vertices, faces, None, ""
    return vertices, faces, painted.colours[cKDTree(painted.points).query(vertices)[1]], ""


def _is_usable(vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."]) -> bool:
    """Return whether arrays are a mesh; ``checked_mesh`` reports the error of others."""
    import numpy as np

    shaped = vertices.ndim == 2 and vertices.shape[1:] == (3,) and faces.shape[1:] == (3,) and faces.size > 0
    return bool(shaped and 0 <= faces.min() <= faces.max() < len(vertices) and np.isfinite(vertices).all())


def _read_mesh_arrays(request: MeshOptions) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."], Source]:
    from getagrip.geometry.mesh_files import MESH_SUFFIXES, parse_mesh
    from getagrip.provenance import Source, assumed
    from getagrip.synthetic.categories import SHAPE_MAKERS

    if request.kind is not None:
        made = SHAPE_MAKERS[request.kind]()
        return made.vertices, made.faces, assumed(f"this package's own {request.kind}: a guess of the object's shape")
    if not request.path.is_file():
        kinds = ", ".join(sorted(SHAPE_MAKERS))
        expected = f"a triangle mesh ({', '.join(MESH_SUFFIXES)}), or the name of one of this package's shapes: {kinds}"
        raise InputError(request.path, "mesh", "no such file", expected)
    return *parse_mesh(request.path), Source(request.path.name)


def _select_mesh_part(
    vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."], request: MeshOptions
) -> tuple[Int[ndarray, "..."], str, bool]:
    """Return the faces of the object's part, a description for the provenance, and whether the choice is a guess.

    Raises ``UsageError`` for a stated size and several parts larger than debris without ``--part``.
    """
    import numpy as np

    from getagrip.geometry.mesh import separate_parts

    if request.part is not None and not (request.part == "all" or (request.part.isdecimal() and int(request.part))):
        raise UsageError(f"--part must be the number of a part, from 1, or all (got {request.part!r})")
    if not _is_usable(vertices, faces):
        return faces, "", False
    parts = separate_parts(vertices, faces)
    sides = [np.ptp(vertices[faces[part].ravel()], axis=0) for part in parts]
    whole = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    count = sum(side.max() >= MIN_PART_SIZE_FRACTION * whole for side in sides)
    metres = METRES_PER_UNIT[request.unit or "m"]
    listed = ", ".join(" x ".join(f"{metres * length:.3g}" for length in side) for side in sides[:count])
    if request.part is not None and request.part != "all":
        number = int(request.part)
        if number > len(parts):
            raise UsageError(f"--part must be 1 to {len(parts)}, the parts of {request.path} (got {number})")
        return faces[np.sort(parts[number - 1])], f", part {number} of {len(parts)}", False
    if request.part == "all" or count < 2:
        return faces, "", False
    found = f"{count} separate parts, {listed} (sides [{'m' if request.unit else 'units of the file'}])"
    if request.size_mm is not None or request.diameter_mm is not None:
        option = "--size-mm" if request.size_mm is not None else "--diameter-mm"
        way = f"{option} is of that; or take the others out of the file"
        raise UsageError(f"{request.path}: {found}: missing --part N, the one that is held, or --part all; {way}")
    return faces, f", {found}, all taken as the object: a guess; --part takes one", True


def _scale_of_mesh(
    vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."], request: MeshOptions
) -> tuple[float, Source | None]:
    """Return the factor that gives a mesh its stated size [m], with the source of the size; None: the file's.

    Points that no face uses do not count for the size.
    """
    import numpy as np

    from getagrip.geometry.mesh import diameter
    from getagrip.geometry.mesh_files import MAX_MESH_EXTENT_M, MIN_MESH_EXTENT_M
    from getagrip.provenance import Source, assumed

    sizes = {"--size-mm": request.size_mm, "--diameter-mm": request.diameter_mm}
    stated = [(option, value) for option, value in sizes.items() if value is not None]
    if len(stated) > 1:
        raise UsageError("--size-mm cannot be used with --diameter-mm")
    known_unit = METRES_PER_UNIT[request.unit or "m"]
    used = vertices
    if faces.size and vertices.size and 0 <= faces.min() <= faces.max() < len(vertices):
        used = vertices[np.unique(faces)]
    extent = float(np.ptp(used, axis=0).max()) if used.ndim == 2 and used.size and np.isfinite(used).all() else 0.0
    plausible = MIN_MESH_EXTENT_M <= known_unit * extent <= MAX_MESH_EXTENT_M or extent == 0
    if not stated and plausible:
        return known_unit, None
    if not stated and request.known_scale:
        got = f"the object {known_unit * extent:.4g} m large"
        otherwise = "if the file is in another unit than the metre, --unit mm, cm or in, or --size-mm or --diameter-mm"
        expected = f"{MIN_MESH_EXTENT_M:g} to {MAX_MESH_EXTENT_M:g} m; {otherwise}"
        raise InputError(request.path, "vertices", got, expected)
    if not stated:
        factor = FREE_SCALE_SIZE_M / extent
        text = f"the mesh, {extent:.4g} units large, rescaled by {factor:.6g}: its size is a guess"
        return factor, assumed(text)
    option, value = stated[0]
    if not 1e3 * MIN_MESH_EXTENT_M <= value <= 1e3 * MAX_MESH_EXTENT_M:
        allowed = f"{1e3 * MIN_MESH_EXTENT_M:g} to {1e3 * MAX_MESH_EXTENT_M:g} millimetres"
        raise UsageError(f"{option} must be {allowed} (got {value:g})")
    now = (diameter(used) if option == "--diameter-mm" else extent) if extent else 0.0
    factor = value / 1e3 / now if now > 0 else 1.0  # checked_mesh reports the error of the others
    return factor, Source(f"the mesh rescaled by {factor:.6g}, to {option} {value:g}")


@dataclass(frozen=True, kw_only=True)
class NewClip(Command):
    """Make a clip of your own video, at once or in steps. What is still missing is listed, with how to get it."""

    video: Annotated[Positional[Path], arg(metavar="VIDEO|FOLDER")]
    """The video, undistorted or with --distortion; or a folder of its images, in the order of their numbers."""
    out: Folder
    """The clip's folder; its name is the clip's."""
    interval: Annotated[tuple[int, int] | None, arg(metavar="START END", help_behavior_hint="")] = None
    """First and last frame of the stable grasp or of the timeline, counted from 1."""
    side: OptionalSide = None
    """Side of the hand."""
    shape: Annotated[MeshOptions, arg(name="")] = field(default_factory=MeshOptions)
    category: Annotated[str | None, arg(metavar="WORD", help_behavior_hint="(default: KIND, or object)")] = None
    """Category of the object, in a word."""
    masks: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """Masks, as for import masks, which can add them later."""
    mask_first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: START)")] = None
    """The number that the masks give to frame START."""
    mask_images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Folder, or pattern of names, of the mask images to use, if there are several for a frame."""
    object: Labels = ()
    """Labels of the object in the masks."""
    ignore: Labels = ()
    """Labels of whatever hides the object, in the masks."""
    hand: Labels = ()
    """Labels of the hand that holds the object, in the masks. Its pixels are ignored as well, and --hands are refined
    against them."""
    hands: OptionalFile = None
    """A hand.npz, as import hands --out writes it; import hands can also add hands later."""
    hand_first: FirstNumber = None
    """The number that --hands gives to the first frame, if it counts from another start."""
    segments: OptionalFile = None
    """Segments of the clip, as annotate writes them; import segments can add them later."""
    still_camera: Flag = False
    """State that the camera did not move: the camera frame is then the world."""
    lens: Annotated[Lens, arg(name="")] = field(default_factory=Lens)
    """The camera. Not needed if the hand file has it."""
    distorted: Annotated[Distortion, arg(name="")] = field(default_factory=Distortion)
    views: Annotated[ViewOptions, arg(name="")] = field(default_factory=ViewOptions)
    images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Pattern of names of the images to use (rgb_*), if a folder has several sets of them."""
    fps: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="(default: 30)")] = None
    """Frames per second of a folder of images; a video has its frames' own times."""
    overwrite: Flag = False
    """Replace a clip that is there already."""

    def run(self) -> int:
        """Write a clip.

        Returns 0 for a complete clip, 2 without required options, 3 if masks are missing, if the hands of most frames
        are, or with a warning about the camera. Raises ``InputError`` for files that do not fit, ``UsageError`` for an
        existing folder without ``--overwrite``.
        """
        import numpy as np

        from getagrip.cli.import_files import report_masks
        from getagrip.cli.import_hands import HandFile, camera_of
        from getagrip.clip import Clip
        from getagrip.clip.read import add_segments
        from getagrip.clip.read_arrays import check_in_view
        from getagrip.clip.write import missing_hand_provenance
        from getagrip.readers.video import footage_interval, size_and_rate

        refuse_existing(self.out, self.overwrite)
        if not files.is_portable_name(self.out.name):
            raise UsageError(f"--out must be a folder whose name can be the clip's (got {self.out})")
        if self.views.view and (self.lens.is_set or self.distorted.distortion):
            used = "distortion" if self.distorted.distortion else "K, --focal or --guess-focal"
            raise UsageError(f"--{used} cannot be used with --cameras, which has the camera of the clip")
        rig = self.views.rig
        size, fps = size_and_rate(self.video, self.fps, self.images)
        print(f"video: {size[0]} x {size[1]}, {fps:.6g} frames per second")
        hands = None if self.hands is None else HandFile.of(self.hands)
        camera_known = self.lens.is_set or rig is not None or (hands is not None and hands.K is not None)
        required = {
            "interval": self.interval,
            "side": self.side,
            "mesh": self.shape.mesh,
            "camera": camera_known or None,
        }
        missing = [key for key, value in required.items() if value is None]
        for key in missing:
            print(f"missing: {key}: {MISSING_OPTION_HINTS[key].format(video=self.video)}", file=sys.stderr)
        if missing or self.interval is None or self.side is None:
            return 2
        numbers = _interval_frame_numbers(self.interval)
        footage = footage_interval(self.video, numbers, size, fps, self.fps is not None, self.images)
        names = footage.names
        if rig is None:
            K, camera = camera_of(self.lens, hands, size)
            undistort = self.distorted.removal(K, size) if self.distorted.words else None
            words = self.distorted.words
        else:
            camera = rig.source(rig.own)
            K, undistort, words = rig.undistortion(rig.own, size)
            if hands is not None and hands.K is not None and not np.allclose(hands.K, K, rtol=CAMERA_TOLERANCE):
                warn(f"{hands.path}: hands of another camera than {rig.own.name}: focal length {hands.K[0, 0]:.5g} px")
        views = NewView.all_of(self.views, footage)
        images, camera = footage.images(), replace(camera, text=camera.text + words)
        images = images if undistort is None else map(undistort, images)
        found = read_own_mesh(self.shape)
        found_hands = None if hands is None else hands.at(names, self.side, self.hand_first)
        of_hands: Provenance = {"hands": "none yet"}
        if hands is not None and found_hands is not None:
            check_in_view(hands.path, found_hands.track, np.tile(K, (len(found_hands.found), 1, 1)), size)
            of_hands = found_hands.provenance | missing_hand_provenance(names, found_hands.found)
        clip = Clip(
            folder=self.out,
            name=self.out.name,
            category=self.category or self.shape.kind or "object",
            side=self.side,
            fps=footage.fps,
            frames=names,
            times=footage.times,
            size=size,
            K=np.tile(K, (len(numbers), 1, 1)),
            mesh=found.mesh,
            handle=found.handle,
            scale="known" if found.sized else "free",
            hand=_empty_hand_track(len(numbers)),
            provenance={
                "source": f"{self.video.name}, frames {numbers[0]} to {numbers[-1]}",
                "camera": camera,
                **({"times": footage.rate} if footage.rate else {}),
                **found.provenance,
                "masks": _masks_source(self),
                **of_hands,
            },
        )
        clip = add_segments(clip, _read_new_segments(self, self.out))
        reader = None if self.masks is None else _open_clip_masks(self, names, size)
        visible = _write_new_clip(clip, found_hands, images, reader, views, self.out, self.overwrite)
        unsure = report_masks(reader, clip.frames, visible) if reader else 0
        return _print_new_clip(clip, self, found_hands, self.out) or unsure


def _read_new_segments(new: NewClip, out: Path) -> SegmentList:
    """Read the segments and the statement about the camera; no segments for a single stable grasp."""
    from getagrip.cli.import_files import add_camera_statement
    from getagrip.clip.read import SegmentList, read_segment_list

    listed = SegmentList(out, "segments", [], None)
    if new.segments is not None:
        listed = read_segment_list(new.segments, [out.name, new.video.stem])
    return add_camera_statement(listed, new.still_camera)


def _interval_frame_numbers(interval: tuple[int, int]) -> Int[ndarray, "T"]:
    import numpy as np

    first, last = interval
    if not 1 <= first < last or last - first >= MAX_CLIP_FRAMES:
        expected = f"two frames' numbers from 1, the later one last, at most {MAX_CLIP_FRAMES} apart"
        raise UsageError(f"--interval must be {expected} (got {first} {last})")
    return np.arange(first, last + 1)


def _empty_hand_track(frames: int) -> HandTrack:
    """Make a hand without vertices, for a clip without hands."""
    import numpy as np

    from getagrip.clip import HandTrack

    none = np.zeros((frames, 0, 3))
    return HandTrack(none, np.zeros((0, 3), dtype=int), np.tile(np.eye(4), (frames, 1, 1)), {})


def _masks_source(new: NewClip) -> str:
    from getagrip.cli.import_files import masks_provenance

    if new.masks is None:
        return "none yet"
    return masks_provenance(new.masks, new.object, new.ignore, new.hand, new.mask_images)


def _open_clip_masks(new: NewClip, names: tuple[str, ...], size: tuple[int, int]) -> MaskReader:
    from getagrip.cli.import_files import NumberedFrames
    from getagrip.readers.masks.mask_request import MaskRequest
    from getagrip.readers.masks.mask_sources import open_masks

    assert new.masks is not None
    names, ask_first, counted = NumberedFrames.of(names, new.mask_first, "--mask-first")
    labels = new.object, new.ignore, new.hand
    request = MaskRequest(names, size, *labels, ask_first, counted, new.mask_images, "--mask-images")
    return open_masks(new.masks, request)


def _write_new_clip(
    clip: Clip,
    hands: TrackedHands | None,
    images: Iterator[UInt8[ndarray, "H W 3"]],
    masks: MaskReader | None,
    views: Sequence[NewView],
    out: Path,
    overwrite: bool,
) -> int:
    """Write the clip with its images, masks and views, one at a time, and read it again: a written clip is valid.

    Returns the number of frames whose masks show the object.
    """
    from getagrip.cli.import_files import write_reader_masks
    from getagrip.clip.write import write_clip_contents, write_hand_at

    visible = 0
    with files.new_folder(out, ("clip.json",) if overwrite else ()) as new:
        write_clip_contents(new, replace(clip, folder=None), None, images)  # an older clip may be in its folder
        if masks:
            visible = write_reader_masks(masks, clip.frames, new / "masks")
        for view in views:
            view.write(new, clip.frames)
        if hands:
            write_hand_at(hands.track, clip.frames, hands.found, new / "hand.npz")
            _check_written_clip(new, masks is not None, out)
    return visible


def _check_written_clip(made: Path, masks: bool, out: Path) -> None:
    """Read the clip in a temporary folder. Raises ``InputError``, with paths in its final folder ``out``."""
    from getagrip.clip import read_clip, read_observed

    try:
        clip = read_clip(made)
        if masks:
            read_observed(clip)
    except InputError as error:
        inside = error.path.relative_to(made) if error.path.is_relative_to(made) else error.path
        raise InputError(out / inside, error.key, error.got, error.expected) from error


def _print_new_clip(clip: Clip, new: NewClip, hands: TrackedHands | None, out: Path) -> int:
    """Print the clip, its assumptions and missing inputs; return 3 with missing inputs or warnings, else 0."""
    from getagrip.checks.intrinsics import camera_warning
    from getagrip.provenance import is_assumed

    print(f"{out}: {len(clip)} frames")
    if hands and len(hands.found) < len(clip):
        bare = f"no hand in {len(clip) - len(hands.found)} of {len(clip)} frames"
        command = f"getagrip import hands ... --clip {out} --overwrite"
        warn(f"{bare}, which are left out until they have one; {command}")
    for key, text in clip.provenance.items():
        if is_assumed(text):
            warn(f"{key}: {text}")
    if warning := camera_warning(clip.K, clip.size):
        warn(f"camera: {warning}")
    missing = [key for key, path in (("masks", new.masks), ("hands", new.hands)) if path is None]
    for key in missing:
        print(f"missing: {key}: {NEXT_STEP_HINTS[key].format(out=out, video=new.video)}", file=sys.stderr)
    for view in new.views.names:
        print(f"missing: {NEXT_STEP_HINTS['view'].format(out=out, view=view)}", file=sys.stderr)
    missing += new.views.names
    few_hands = hands is not None and 2 * len(hands.found) < len(clip)
    return WARNING_EXIT_STATUS if missing or warning or few_hands else 0
