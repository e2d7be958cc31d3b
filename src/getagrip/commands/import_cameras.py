"""``getagrip import cameras``: the camera's path, and its intrinsics, from other programs' files into a clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.cameras import CameraPath, read_path
from getagrip.clip.intrinsics import camera_warning
from getagrip.clip.naming import check_numbers, number_of, renumbered
from getagrip.clip.per_frame import world
from getagrip.clip.plausible import check_intrinsics
from getagrip.clip.reading import ClipHeader, read_header
from getagrip.commands.command import Command, FirstNumber
from getagrip.errors import UsageError
from getagrip.io import files, numbers
from getagrip.io.arguments import Flag
from getagrip.io.terminal import report, say, warn
from getagrip.provenance import Source, assumed, estimated, measured, report_source

WARNED = 3
"""Exit status where the path is written and something about it is assumed or seems wrong."""
APART = 0.02
"""Largest share by which focal lengths differ without a word."""


@dataclass(frozen=True, kw_only=True)
class ImportCameras(Command):
    """Add the camera's path to a clip.

    Recognised by their files: COLMAP, EPIC-Fields, ViPE, MegaSaM, DROID-SLAM, HaWoR, ARKit (3D Scanner App), Aria MPS,
    TUM and KITTI lines.
    """

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The file or folder."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder."""
    first: FirstNumber = None
    """The number that the files give to the first frame, if they count from another start."""
    start: Annotated[float | None, arg(metavar="S", help_behavior_hint="")] = None
    """The time that the file gives to time 0 of the clip, for files with times."""
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
        found = read_path(self.path)
        report(f"{self.path}: taken for {found.source}")
        names = header.frames if self.first is None else renumbered(header.frames, self.first, "--first")
        check_numbers(header.frames, found.names, self.path, "pose", "--first" if self.first is None else "")
        with numbers.guarded(self.path):
            poses, filled = found.scaled(self.metres or 1.0).at(names, _times(header), self.start)
        camera: dict[str, object] = {**header.fields["camera"], "T_world_cam": poses.tolist()}
        camera.pop("world_up", None), camera.pop("world_support", None)
        if found.up is not None:
            camera["world_up"] = found.up.tolist()
        world(header.folder / "clip.json", camera, header.frames)
        sources = {"world": _world(found, self.path.name, self.metres, int(filled.sum()), len(names))}
        K = header.K
        if found.pinhole is not None and self.intrinsics:
            K = np.tile(found.pinhole.resized(header.size), (len(names), 1, 1))
            check_intrinsics(self.path, K, header.size)
            camera["K"] = K[0].tolist()
            sources["camera"] = measured(f"{found.source}, {self.path.name}")
        provenance = header.fields["provenance"] | sources
        with files.new_file(header.folder / "clip.json") as part:
            files.write_json(part, header.changed({"camera": camera, "provenance": provenance}))
        for topic, source in sources.items():
            report_source(topic, source)
        warnings = [*self._warnings(found, header), *filter(None, [camera_warning(K, header.size)])]
        for text in warnings:
            warn(f"camera: {text}")
        say(f"{header.folder / 'clip.json'}: the camera in {len(names)} frames, {_extent(poses):.2f} m from end to end")
        return WARNED if warnings or any(source.basis == "assumed" for source in sources.values()) else 0

    def _warnings(self, found: CameraPath, header: ClipHeader) -> list[str]:
        """Say where the files' intrinsics do not fit the clip's."""
        if found.pinhole is None:
            return []
        texts = []
        if found.pinhole.distorted:
            texts.append("the files' model has lens distortion: a clip is a pinhole (clip new --distortion)")
        theirs, ours = found.pinhole.resized(header.size)[0, 0], float(np.median(header.K[:, 0, 0]))
        if not self.intrinsics and abs(theirs / ours - 1.0) > APART:
            texts.append(f"focal length {theirs:.5g} px in the files, {ours:.5g} px in the clip; --intrinsics takes it")
        return texts


def _times(header: ClipHeader) -> Float[ndarray, "T"]:
    """Return the times of a clip's frames [s]: as stated, or at its rate by their numbers."""
    if "times" in header.fields:
        return np.array(header.fields["times"], dtype=float)
    numbers = [number_of(name) for name in header.frames]
    at = np.arange(len(numbers)) if None in numbers else np.array(numbers) - int(numbers[0] or 0)
    return np.asarray(at / float(header.fields["fps"]))


def _world(found: CameraPath, name: str, metres: float | None, filled: int, frames: int) -> Source:
    """Say where a path is from, what of it is assumed, and whether its scale is known."""
    known = found.metric or metres is not None
    scale = "" if known else "; its scale is not known, a guess: metres"
    scale = f", {metres:g} m for a unit" if metres is not None else scale
    between = f"; {filled} of {frames} frames between others" if filled else ""
    text = f"{found.source}, {name}{scale}{between}" + ("" if found.up is not None else "; up is not known")
    return estimated(text) if known else assumed(text)


def _extent(poses: Float[ndarray, "T 4 4"]) -> float:
    """Measure the distance between the camera's farthest places along any axis of the world [m]."""
    return float(np.ptp(poses[:, :3, 3], axis=0).max())
