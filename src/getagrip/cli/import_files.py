"""``getagrip import masks``, ``depth``, ``cameras`` and ``segments``: other programs' files into existing clips.

``import_many`` imports into all clips of a folder, for masks and hands, from files named like the clips.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.checks.intrinsics import camera_warning
from getagrip.cli.command import WARNING_EXIT_STATUS, Command, FirstNumber, Labels, for_each_clip, refuse_existing
from getagrip.clip import Segment, read
from getagrip.clip.depth import DEPTH_KEY, check_depth_shape
from getagrip.clip.match_frames import check_frame_numbers, matching_names, renumber_frames, stem_of
from getagrip.clip.read import STATED_BY_USER, ClipHeader, SegmentList, parse_world, read_header
from getagrip.clip.read_arrays import check_intrinsics
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays, files
from getagrip.io.images import read_mask, write_mask
from getagrip.io.options import Flag, one_of
from getagrip.io.terminal import NullOutput, collect_warnings, format_count, print_note, print_result, warn
from getagrip.provenance import Source, assumed, estimated, measured, report_source
from getagrip.readers.cameras import CameraPath, read_camera_path
from getagrip.readers.depth_files import (
    DEPTH_FORMATS,
    DepthReader,
    add_depth,
    check_depth_direction,
    check_focal_length,
    open_depth,
    select_depth_source,
)
from getagrip.readers.masks.mask_arrays import sample_frames
from getagrip.readers.masks.mask_request import MaskReader, MaskRequest
from getagrip.readers.masks.mask_sources import open_masks

FOCAL_WARNING_FRACTION = 0.02
"""Relative difference of focal lengths above which a warning is printed."""
PRINCIPAL_POINT_WARNING_FRACTION = 0.1
"""Distance of principal points, as a fraction of the images' sides, above which a warning is printed."""
STATIC_POSE_TOLERANCE = 1e-9
"""Change up to which a pose counts as static [m, or entries of a rotation]."""
MIN_VISIBLE_FRAMES = 2
"""Minimum number of frames whose masks show the object."""
Quaternion = Literal["xyzw", "wxyz"]
Scale = Literal["metric", "clip", "frame"]
if TYPE_CHECKING:
    Format: TypeAlias = str
else:  # the table of formats states the choices of --from
    TAKES = "; ".join(f"{name}: {form.takes}" for name, form in DEPTH_FORMATS.items())
    Format = Annotated[
        Literal[tuple(DEPTH_FORMATS)], arg(name="from", help=f"Program or format of the files. {TAKES}.")
    ]


class NumberedFrames(NamedTuple):
    """The clip's frames with the numbers that files give to them."""

    names: tuple[str, ...]
    ask_first: str
    """The option to suggest for files with other numbers; empty if it is used."""
    counted: bool
    """True if the option is used."""

    @staticmethod
    def of(frames: tuple[str, ...], first: int | None, option: str = "--first") -> NumberedFrames:
        """Name a clip's frames by numbers from ``first``; None keeps their names."""
        if first is None:
            return NumberedFrames(frames, option, False)
        return NumberedFrames(renumber_frames(frames, first, option), "", True)


@dataclass(frozen=True, kw_only=True)
class ImportMasks(Command):
    """Add masks from files to a clip.

    Formats: a folder of PNG (labels, palettes as of SAM 2, colours), of .npy or of LabelMe's .json; .json of COCO,
    YouTube-VIS or SA-V; .npz and .npy; and SAM 2's video_segments (.pkl, .npy).
    """

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The folder or file; images are named like the clip's frames, or by the same numbers."""
    clip: Annotated[Path | None, arg(metavar="CLIP", help_behavior_hint="")] = None
    """The clip's folder."""
    clips: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """A folder of clips: into each what PATH, a folder, has under the clip's name. Clips with masks are done."""
    object: Labels = ()
    """Labels of the object: values, #rrggbb, or names of COCO's categories. If there are several cups, cup:7 selects
    one by its track_id and cup:all takes all. Not needed if there is only one label."""
    ignore: Labels = ()
    """Labels of whatever hides the object: other hands, other things in front."""
    hand: Labels = ()
    """Labels of the hand that holds the object. Its pixels are ignored as well, and the clip's hands are refined
    against them."""
    first: FirstNumber = None
    """The number that the masks give to the first frame, if they count from another start."""
    images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Folder (take1) or pattern of names (cam1_*) of the images to use, if there are several for a frame."""
    stretched: Flag = False
    """The masks are of images that were stretched to another shape, as Roboflow's resize does."""
    overwrite: Flag = False
    """Replace masks that are there already."""

    def run(self) -> int:
        """Add ``masks/`` to a clip's folder; return 0, or 3 with warnings.

        Raises ``InputError``, and ``UsageError`` for a clip that has masks already.
        """
        if self.clip is None and self.clips is None:
            raise UsageError("missing --clip or --clips")
        if self.clips is not None:
            if self.clip is not None:
                raise UsageError("--clip cannot be used with --clips")

            def of_clip(source: Path, clip: Path) -> ImportMasks:
                return replace(self, path=source, clip=clip, clips=None)

            return import_many(self.path, self.clips, "masks", self.overwrite, of_clip, self.debug)
        assert self.clip is not None
        header = read_header(self.clip)
        target = header.folder / "masks"
        refuse_existing(target, self.overwrite)
        names, ask_first, counted = NumberedFrames.of(header.frames, self.first)
        labels = self.object, self.ignore, self.hand
        request = MaskRequest(names, header.size, *labels, ask_first, counted, self.images, stretched=self.stretched)
        reader = open_masks(self.path, request)
        whence = header.fields["provenance"] | {"masks": masks_provenance(self.path, *labels, self.images)}
        with files.new_folder(target, ("object",) if self.overwrite else ()) as new:
            visible = write_reader_masks(reader, header.frames, new)
            with files.new_file(header.folder / "clip.json") as part:
                files.write_json(part, header.changed({"provenance": whence}))
        print_result(f"{target}: the object is visible in {visible} of {len(names)} frames")
        return report_masks(reader, header.frames, visible)


def report_masks(reader: MaskReader, frames: tuple[str, ...], visible: int) -> int:
    """Print warnings about masks and frames without masks; return 3 if masks are probably wrong, else 0."""
    for note, count in reader.notes.items():
        warn(f"{reader.source}: {note}: {count}")
    if missing := [name for n, name in enumerate(frames) if n not in reader.known]:
        some = f"no mask of {len(missing)} of {len(frames)} frames (first: {missing[0]})"
        warn(f"{reader.source}: {some}; reconstruct interpolates their poses")
    if visible < MIN_VISIBLE_FRAMES:
        seen = f"the object is visible in {format_count(visible, 'frame')}; reconstruct needs {MIN_VISIBLE_FRAMES}"
        warn(f"{reader.source}: {seen}")
    for warning in (*reader.warnings, *(f"no frame has a pixel of {named}" for named in sorted(reader.unmet))):
        warn(f"{reader.source}: {warning}")
    amiss = [named for named in reader.unmet if not named.startswith("--hand")]  # a hand may be hidden throughout
    return WARNING_EXIT_STATUS if reader.warnings or amiss or visible < MIN_VISIBLE_FRAMES else 0


def write_reader_masks(reader: MaskReader, frames: tuple[str, ...], folder: Path) -> int:
    """Write the masks frame by frame; return the number of frames in which the object is visible.

    Raises ``InputError`` for masks that show the object in no frame.
    """
    visible = 0
    for n, name in enumerate(frames):
        masks = reader(n)
        if masks is None:
            continue
        for kind, mask in masks._asdict().items():
            if mask is not None:
                write_mask(files.folder_inside(folder, kind) / f"{name}.png", mask)
        visible += int(masks.object.any())
    if not visible:
        others = f"; there are {', '.join(sorted(reader.others))}" if reader.others else ""
        raise InputError(reader.source, "", f"masks without a pixel of the object{others}", "masks that show it")
    return visible


def masks_provenance(
    source: Path, objects: tuple[str, ...], ignore: tuple[str, ...], hand: tuple[str, ...], images: str = ""
) -> str:
    """Return the source of masks, for a clip's provenance."""
    named = (("images", (images,) * bool(images)), ("object", objects), ("ignored", ignore), ("hand", hand))
    labels = "".join(f", {what} {', '.join(names)}" for what, names in named if names)
    return f"from {source.name}{labels}" + ("" if ignore or hand else ", nothing ignored")


@dataclass(frozen=True, kw_only=True)
class ImportDepth(Command):
    """Add depth images to a clip: distances of what each pixel shows, which reconstruct uses beside the masks.

    Files are named like the clip's frames, or by the same numbers; they may be smaller than its images, but neither
    cropped nor turned.
    """

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The folder or file: 16-bit PNG, .npy, .npz or .exr."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder."""
    source: Format
    scale: Annotated[Scale | None, one_of(*get_args(Scale)), arg(help_behavior_hint="(default: as its program)")] = None
    """Measure of the numbers: metres; metres times a factor of the clip, or of each frame."""
    unit: Annotated[float | None, arg(metavar="M", help_behavior_hint="(default: as its program)")] = None
    """Metres that 1 in the files stands for."""
    error: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="(default: by its kind)")] = None
    """Error of distances, the factor apart, as a share of the distance."""
    first: FirstNumber = None
    """The number that the files give to the first frame, if they count from another start."""
    images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Folder or pattern of names (cam1_*) of the files to use, if there are several for a frame."""
    overwrite: Flag = False
    """Replace depth that is there already."""

    def run(self) -> int:
        """Add ``depth/`` to a clip's folder; return 0, or 3 with warnings.

        Raises ``InputError``, and ``UsageError`` for a clip that has depth already.
        """
        header = read_header(self.clip)
        target = header.folder / DEPTH_KEY
        refuse_existing(target, self.overwrite)
        frames, ask_first, counted = NumberedFrames.of(header.frames, self.first)
        reader = open_depth(self.path, self.source, frames, ask_first, self.images, counted)
        source = select_depth_source(self.source, self.scale, self.unit, self.error)
        check_depth_shape(*reader.read(reader.known[0])[:2], header.size)
        order = check_depth_direction(reader, _read_depth_masks(header, reader), source)
        said = f"from {self.path.name}, {self.source}"
        add_depth(header, reader, source, said, unit=self.unit, overwrite=self.overwrite)
        print_result(f"{target}: depth of {len(reader.known)} of {len(frames)} frames")
        warnings = [*filter(None, [check_focal_length(reader, source, header.K, header.size[0]), order])]
        if len(reader.known) < len(frames):
            missing = [name for n, name in enumerate(header.frames) if n not in reader.known]
            warn(f"no depth in {len(missing)} of {len(frames)} frames (first: {missing[0]})")
        for warning in warnings:
            warn(f"{self.path}: {warning}")
        return WARNING_EXIT_STATUS if warnings else 0


def _read_depth_masks(header: ClipHeader, reader: DepthReader) -> dict[int, tuple[ndarray, ndarray]]:
    """Read the object's mask and the ignore mask in some frames that have a mask and depth."""
    found = dict[int, tuple[ndarray, ndarray]]()
    masks = header.folder / "masks"
    masked = [n for n in reader.known if (masks / f"object/{header.frames[n]}.png").is_file()]
    for n in sample_frames(masked):
        seen = read_mask(masks / f"object/{header.frames[n]}.png", header.size).unpacked
        ignore = masks / f"ignore/{header.frames[n]}.png"
        found[n] = seen, read_mask(ignore, header.size).unpacked if ignore.is_file() else np.zeros_like(seen)
    return found


@dataclass(frozen=True, kw_only=True)
class ImportCameras(Command):
    """Add the camera's path to a clip.

    Recognised by their files: COLMAP, EPIC-Fields, nerfstudio, ViPE, MegaSaM, DROID-SLAM, HaWoR, ARKit (3D Scanner
    App), Record3D, Aria MPS, TUM, EuRoC and KITTI lines.
    """

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The file or folder."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder."""
    first: FirstNumber = None
    """The number that the files give to the first frame, if they count from another start."""
    start: Annotated[float | None, arg(metavar="S", help_behavior_hint="")] = None
    """The time that the file gives to time 0 of the clip, for files with times."""
    images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Folder (cam1) or pattern of names (cam1_*) of the images to use, if there are several for a frame."""
    quaternion: Annotated[Quaternion | None, one_of("xyzw", "wxyz"), arg(help_behavior_hint="")] = None
    """Order of the quaternions in lines of numbers, where the files do not tell it."""
    metres: Annotated[float | None, arg(metavar="M", help_behavior_hint="")] = None
    """Metres of a unit of length, for files whose scale is arbitrary."""
    intrinsics: Flag = False
    """Take the intrinsics, too. Hands that are there already were placed with the old ones: import them again."""
    overwrite: Flag = False
    """Replace the path that is there already."""

    def run(self) -> int:
        """Write the camera's path into ``clip.json``; return 0, or 3 with assumptions or warnings.

        Raises ``InputError``, and ``UsageError`` for a clip that has a path already.
        """
        header = read_header(self.clip)
        if "T_world_cam" in header.fields["camera"] and not self.overwrite:
            raise UsageError(f"{header.folder}: has camera.T_world_cam already; --overwrite replaces it")
        if self.metres is not None and not 0.0 < self.metres < 1e6:
            raise UsageError(f"--metres must be above 0 (got {self.metres:g})")
        if self.start is not None and not np.isfinite(self.start):
            raise UsageError(f"--start must be a time in seconds (got {self.start:g})")
        found = self._found(header)
        names, ask_first, counted = NumberedFrames.of(header.frames, self.first)
        stems = [stem_of(found.names[row]) for row in matching_names(found.names, self.images)]
        check_frame_numbers(header.frames, stems, self.path, "pose", ask_first)
        how = names, header.times, self.start, counted, self.images
        with arrays.convert_to_input_errors(self.path):
            poses, filled = found.scaled(self.metres or 1.0).at(*how)
            theirs = found.K_at(header.size, *how) if found.pinholes else None
        camera: dict[str, object] = {**header.fields["camera"], "T_world_cam": poses.tolist()}
        camera.pop("world_up", None), camera.pop("world_support", None)
        if found.up is not None:
            camera["world_up"] = found.up.tolist()
        parse_world(header.folder / "clip.json", camera, header.frames)
        sources = {"world": _camera_path_source(found, self.path.name, self.metres, int(filled.sum()), len(names))}
        K = header.K
        if theirs is not None and self.intrinsics:
            K = theirs
            check_intrinsics(self.path, K, header.size)
            camera["K"] = K[0].tolist() if np.allclose(K, K[0], rtol=1e-9) else K.tolist()
            sources["camera"] = measured(f"{found.source}, {self.path.name}")
        provenance = header.fields["provenance"] | sources
        with files.new_file(header.folder / "clip.json") as part:
            files.write_json(part, header.changed({"camera": camera, "provenance": provenance}))
        for topic, source in sources.items():
            report_source(topic, source)
        warnings = [*self._warnings(found, poses, theirs, header), *filter(None, [camera_warning(K, header.size)])]
        for text in warnings:
            warn(f"camera: {text}")
        extent = float(np.ptp(poses[:, :3, 3], axis=0).max())
        print_result(
            f"{header.folder / 'clip.json'}: the camera in {len(names)} frames, {extent:.2f} m from end to end"
        )
        return WARNING_EXIT_STATUS if warnings or any(source.basis == "assumed" for source in sources.values()) else 0

    def _found(self, header: ClipHeader) -> CameraPath:
        """Read the path, by the model with the most of the clip's frames. Raises ``UsageError`` without intrinsics."""
        found = read_camera_path(self.path, self.quaternion or "")
        print_note(f"{self.path}: taken for {found.source}")
        if found.others:
            models = (found, *found.others)
            counts = ", ".join(f"{one.path.parent} ({len(one.names)} images)" for one in models)
            found = found.best(header.frames)
            used = f"{found.path.parent} is used, which has most frames"
            print_note(f"{self.path}: {len(models)} models, {counts}; {used}")
        if self.intrinsics and not found.pinholes:
            raise UsageError(f"--intrinsics cannot be used with {self.path}: {found.source} have no intrinsics")
        return found

    def _warnings(
        self, found: CameraPath, poses: Float[ndarray, "T 4 4"], theirs: Float[ndarray, "T 3 3"] | None,
        header: ClipHeader,
    ) -> list[str]:  # fmt: skip
        """Return warnings about intrinsics that differ from the clip's, distortion, and a camera static by mistake."""
        texts = []
        if np.ptp(poses, axis=0).max() < STATIC_POSE_TOLERANCE < np.ptp(found.T_world_cam, axis=0).max():
            texts.append("it stands still in all frames, although the files' camera moves: are these its times?")
        if any(one.distorted for one in found.pinholes):
            texts.append("the files' model has lens distortion: a clip is a pinhole (clip new --distortion)")
        if theirs is None or self.intrinsics:
            return texts
        f, ours = theirs[:, 0, 0], header.K[:, 0, 0]
        if (apart := abs(f / ours - 1.0)).max() > FOCAL_WARNING_FRACTION:
            some = f"{f[0]:.5g} px" if np.ptp(f) < 1e-6 * f[0] else f"{f.min():.5g} to {f.max():.5g} px"
            own = f"{ours[apart.argmax()]:.5g} px in the clip"
            texts.append(f"focal length {some} in the files, {own}; --intrinsics takes it")
        off = abs(theirs[:, :2, 2] - header.K[:, :2, 2]) / header.size
        if off.max() > PRINCIPAL_POINT_WARNING_FRACTION:
            x, y = theirs[off.max(axis=1).argmax(), :2, 2]
            texts.append(f"principal point ({x:.4g}, {y:.4g}) px in the files, another in the clip: cropped images?")
        return texts


def _camera_path_source(found: CameraPath, name: str, metres: float | None, filled: int, frames: int) -> Source:
    """Return the source of a camera's path, assumed for an unknown scale."""
    known = found.metric or metres is not None
    scale = "" if known else "; its scale is not known, a guess: metres"
    scale = f", {metres:g} m for a unit" if metres is not None else scale
    between = f"; {filled} of {frames} frames between others" if filled else ""
    text = f"{found.source}, {name}{scale}{between}" + ("" if found.up is not None else "; up is not known")
    return estimated(text) if known else assumed(text)


@dataclass(frozen=True, kw_only=True)
class ImportSegments(Command):
    """Add segments to a clip, which becomes a timeline: a file of annotate or of segment --from-masks."""

    path: Annotated[Positional[Path], arg(metavar="FILE")]
    """segments.json, or segments-NAME.json (docs/formats.md). The clip's own entry is taken, or the only one."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder. Segments are cut at the clip's ends."""
    still_camera: Flag = False
    """The camera did not move: its frame is the world."""
    overwrite: Flag = False
    """Replace segments that are there already."""

    def run(self) -> int:
        """Write the segments of a file into a clip's ``clip.json``.

        Raises ``InputError``, and ``UsageError`` for a clip with segments, or with ``--still-camera`` camera poses.
        """
        header = read_header(self.clip)
        read.check_segments_replaceable(header, self.overwrite)
        listed = add_camera_statement(read.read_segment_list(self.path, [header.fields["name"]]), self.still_camera)
        if self.still_camera and "T_world_cam" in header.fields["camera"]:
            raise UsageError(f"--still-camera cannot be used with {header.folder}: it has camera.T_world_cam")
        segments = read.write_clip_segments(header, listed)
        print_result(f"{header.folder / 'clip.json'}: {describe_segments(segments)}")
        return 0


def add_camera_statement(listed: SegmentList, still_camera: bool) -> SegmentList:
    """Add the user's statement that the camera is static to segments."""
    return replace(listed, still_camera=STATED_BY_USER) if still_camera else listed


def describe_segments(segments: tuple[Segment, ...]) -> str:
    """List the segments, in words."""
    return f"{format_count(len(segments), 'segment')}: {', '.join(one.state for one in segments)}"


@dataclass(frozen=True)
class ImportJob:
    """An import into one of many clips."""

    clip: Path
    command: Command | None
    """None unless exactly one file or folder is named like the clip."""
    source: Path
    target: Path
    """The file or folder that the import makes; a clip that has it is done."""
    overwrite: bool
    several: bool
    """True if several files are named like the clip."""


@dataclass(frozen=True)
class Imported:
    """The outcome of a clip that did not fail."""

    clip: str
    kept: bool
    warnings: tuple[str, ...] = ()


def import_many(
    source: Path, clips: Path, target: str, overwrite: bool, command: Callable[[Path, Path], Command], debug: bool
) -> int:
    """Import into all clips in a folder; return 1 if one failed, 3 with warnings, else 0.

    ``command`` makes a clip's command from the file or folder in ``source`` that is named like the clip, and the clip.
    Clips that have ``target`` are done. A clip that fails does not end the others.
    """
    if not source.is_dir():
        raise InputError(source, "", "no such folder", "a folder with something named like each clip")
    by_stem: dict[str, list[Path]] = {}
    for one in sorted([*files.list_files(source), *files.folders_in(source)]):
        by_stem.setdefault(one.name if one.is_dir() else one.stem, []).append(one)

    def job(name: str, folder: Path) -> ImportJob:
        found = by_stem.get(name) or by_stem.get(folder.name) or []
        made = command(found[0], folder) if len(found) == 1 else None
        place = source / (" and ".join(one.name for one in found) or name)
        return ImportJob(folder, made, place, folder / target, overwrite, len(found) > 1)

    imported, failed = for_each_clip([clips], job, import_one, 1, debug)
    for each in imported:
        for text in each.warnings:
            print_note(f"{each.clip}: warning: {text}")
    kept = sum(one.kept for one in imported)
    print_result(f"{format_count(len(imported) - kept, 'clip')} imported, {kept} done already, {failed} failed")
    return 1 if failed else WARNING_EXIT_STATUS if any(one.warnings for one in imported) else 0


def import_one(job: ImportJob, progress: Callable[[str, float], None] = lambda *_: None) -> Imported:
    """Import into one clip, without output."""
    if job.target.exists() and not job.overwrite:
        return Imported(job.clip.name, kept=True)
    if job.command is None:
        got = "several" if job.several else "no such file or folder"
        raise InputError(job.source, "", got, "one file or folder named like the clip")
    with redirect_stdout(NullOutput()), redirect_stderr(NullOutput()), collect_warnings() as warnings:
        job.command.run()
    return Imported(job.clip.name, kept=False, warnings=tuple(warnings))
