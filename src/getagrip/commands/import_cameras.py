"""``getagrip import cameras``: the camera's path, and its intrinsics, from other programs' files into a clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.cameras import CameraPath, read_camera_path
from getagrip.clip.intrinsics import camera_warning
from getagrip.clip.naming import check_frame_numbers, matching_names, renumber_frames, stem_of
from getagrip.clip.per_frame import parse_world
from getagrip.clip.plausible import check_intrinsics
from getagrip.clip.reading import ClipHeader, read_header
from getagrip.commands.command import Command, FirstNumber
from getagrip.errors import UsageError
from getagrip.io import files, numbers
from getagrip.io.arguments import Flag, one_of
from getagrip.io.terminal import print_note, print_result, warn
from getagrip.provenance import Source, assumed, estimated, measured, report_source

WARNING_EXIT_STATUS = 3
"""Exit status where the path is written and something about it is assumed or seems wrong."""
FOCAL_WARNING_FRACTION = 0.02
"""Largest share by which focal lengths differ without a word."""
PRINCIPAL_POINT_WARNING_FRACTION = 0.1
"""Largest distance of principal points without a word [shares of the images' sides]."""
STATIC_POSE_TOLERANCE = 1e-9
"""Largest change of a pose that is none [m, or entries of a rotation]."""
Quaternion = Literal["xyzw", "wxyz"]


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
        """Write ``clip.json`` anew; return 0, or 3 where something is assumed.

        Raises ``InputError``, and ``UsageError`` where there is a path already.
        """
        header = read_header(self.clip)
        if "T_world_cam" in header.fields["camera"] and not self.overwrite:
            raise UsageError(f"{header.folder}: has camera.T_world_cam already; --overwrite replaces it")
        if self.metres is not None and not 0.0 < self.metres < 1e6:
            raise UsageError(f"--metres must be above 0 (got {self.metres:g})")
        if self.start is not None and not np.isfinite(self.start):
            raise UsageError(f"--start must be a time in seconds (got {self.start:g})")
        found = self._found(header)
        counted = self.first is not None
        names = header.frames if self.first is None else renumber_frames(header.frames, self.first, "--first")
        stems = [stem_of(found.names[row]) for row in matching_names(found.names, self.images)]
        check_frame_numbers(header.frames, stems, self.path, "pose", "" if counted else "--first")
        how = names, header.times, self.start, counted, self.images
        with numbers.convert_to_input_errors(self.path):
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
        print_result(
            f"{header.folder / 'clip.json'}: the camera in {len(names)} frames, {_camera_path_extent(poses):.2f} m from end to end"
        )
        return WARNING_EXIT_STATUS if warnings or any(source.basis == "assumed" for source in sources.values()) else 0

    def _found(self, header: ClipHeader) -> CameraPath:
        """Read the path, of several models that with the most of the clip's frames. Raises ``UsageError``."""
        found = read_camera_path(self.path, self.quaternion or "")
        print_note(f"{self.path}: taken for {found.source}")
        if found.others:
            models = (found, *found.others)
            counts = ", ".join(f"{one.path.parent} ({len(one.names)} images)" for one in models)
            found = found.best(header.frames)
            print_note(
                f"{self.path}: {len(models)} models, {counts}; {found.path.parent} is used, which has most frames"
            )
        if self.intrinsics and not found.pinholes:
            raise UsageError(f"--intrinsics cannot be used with {self.path}: {found.source} have no intrinsics")
        return found

    def _warnings(
        self, found: CameraPath, poses: Float[ndarray, "T 4 4"], theirs: Float[ndarray, "T 3 3"] | None,
        header: ClipHeader,
    ) -> list[str]:  # fmt: skip
        """Say where the files' intrinsics do not fit the clip's, and of a camera that stands still by mistake."""
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
            texts.append(
                f"focal length {some} in the files, {ours[apart.argmax()]:.5g} px in the clip; --intrinsics takes it"
            )
        off = abs(theirs[:, :2, 2] - header.K[:, :2, 2]) / header.size
        if off.max() > PRINCIPAL_POINT_WARNING_FRACTION:
            x, y = theirs[off.max(axis=1).argmax(), :2, 2]
            texts.append(f"principal point ({x:.4g}, {y:.4g}) px in the files, another in the clip: cropped images?")
        return texts


def _camera_path_source(found: CameraPath, name: str, metres: float | None, filled: int, frames: int) -> Source:
    """Say where a path is from, what of it is assumed, and whether its scale is known."""
    known = found.metric or metres is not None
    scale = "" if known else "; its scale is not known, a guess: metres"
    scale = f", {metres:g} m for a unit" if metres is not None else scale
    between = f"; {filled} of {frames} frames between others" if filled else ""
    text = f"{found.source}, {name}{scale}{between}" + ("" if found.up is not None else "; up is not known")
    return estimated(text) if known else assumed(text)


def _camera_path_extent(poses: Float[ndarray, "T 4 4"]) -> float:
    """Measure the distance between the camera's farthest places along any axis of the world [m]."""
    return float(np.ptp(poses[:, :3, 3], axis=0).max())
