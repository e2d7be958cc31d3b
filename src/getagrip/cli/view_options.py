"""Options of commands that take several cameras: their footage, and the file of their calibration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import UseAppendAction, arg
from tyro.constructors import PrimitiveConstructorSpec

from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.options import expand_user_path

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from jaxtyping import Float, UInt8
    from numpy import ndarray

    from getagrip.provenance import Source
    from getagrip.readers.cameras import Rig
    from getagrip.readers.cameras.rig import RigCamera
    from getagrip.readers.matched_footage import MatchedFootage
    from getagrip.readers.video import FootageInterval

MAX_START_S = 1e6
"""Largest time at which a view's footage may start [s]."""


def named_argument(metavar: str, parse: Callable[[str], object]) -> PrimitiveConstructorSpec[Any]:
    """Take a word NAME=VALUE, as a name of a view and the parsed value."""

    def split(words: list[str]) -> tuple[str, object]:
        name, equals, value = words[0].partition("=")
        if not equals or not files.is_portable_name(name):
            raise ValueError(f"it is {metavar}, with a name that can be a folder's")
        return name, parse(value)

    return PrimitiveConstructorSpec(
        nargs=1, metavar=metavar, instance_from_str=split, is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: [f"{value[0]}={value[1]}"],
    )  # fmt: skip


def parse_start(text: str) -> float:
    """Parse a time in seconds. Raises ``ValueError``."""
    value = float(text)
    if not abs(value) <= MAX_START_S:
        raise ValueError(f"seconds, at most {MAX_START_S:g} either way")
    return value


NamedFootage = Annotated[
    tuple[str, Path], named_argument("NAME=VIDEO|FOLDER", lambda text: Path(expand_user_path(text)))
]
NamedStart = Annotated[tuple[str, float], named_argument("NAME=S", parse_start)]


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Further cameras that see the same grasp, and the calibration of all of them."""

    view: Annotated[tuple[NamedFootage, ...], UseAppendAction, arg(help_behavior_hint="")] = ()
    """Footage of a further camera, by its name in --cameras; once for each."""
    cameras: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """With --view: calibration of all cameras: COLMAP's, Kalibr's, OpenCV's, nerfstudio's, DexYCB's, or a JSON
    (docs/views.md)."""
    camera: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="(default: the one without --view)")] = None
    """The clip's own camera in --cameras."""
    view_start: Annotated[tuple[NamedStart, ...], UseAppendAction, arg(help_behavior_hint="(default: 0)")] = ()
    """Time in a view's footage at time 0 of the clip's; its frames are then matched by time, not by number."""
    metres: Annotated[float | None, arg(metavar="M", help_behavior_hint="")] = None
    """Metres of a unit of length in --cameras, where that is not a metre."""

    @property
    def names(self) -> list[str]:
        """Names of the views."""
        return [name for name, _ in self.view]

    def check(self) -> None:
        """Raise ``UsageError`` for options that do not fit each other."""
        if self.view and self.cameras is None:
            raise UsageError("missing --cameras: the calibration of the cameras, which --view needs")
        needed = {"cameras": self.cameras, "camera": self.camera, "view-start": self.view_start, "metres": self.metres}
        if not self.view and (used := next((key for key, value in needed.items() if value), None)):
            raise UsageError(f"missing --view: --{used} needs it")
        for option, names in {"view": self.names, "view-start": [name for name, _ in self.view_start]}.items():
            if twice := next((name for name in names if names.count(name) > 1), None):
                raise UsageError(f"--{option} must name each view once (got {twice} twice)")
        if unknown := next((name for name, _ in self.view_start if name not in self.names), None):
            raise UsageError(f"--view-start must be of a --view (got {unknown})")

    @cached_property
    def rig(self) -> CalibratedViews | None:
        """The calibration; None without views. Raises ``InputError`` and ``UsageError``."""
        from getagrip.readers.cameras import read_rig

        self.check()
        if self.cameras is None:
            return None
        return CalibratedViews.of(read_rig(self.cameras, self.metres), self.camera, self.names)


@dataclass(frozen=True, eq=False)
class CalibratedViews:
    """A calibration, with the clip's own camera and those of the views."""

    rig: Rig
    own: RigCamera
    views: Mapping[str, RigCamera]

    @staticmethod
    def of(rig: Rig, camera: str | None, views: Sequence[str]) -> CalibratedViews:
        """Find the cameras by name. Raises ``UsageError``."""
        each = {name: rig.camera(name, "--view") for name in views}
        return CalibratedViews(rig, rig.own(camera, views), each)

    def source(self, one: RigCamera) -> Source:
        """Return the source of a camera's intrinsics and pose, assumed where the rig's scale is."""
        from getagrip.provenance import assumed, measured

        text = f"{one.name} of {self.rig.source}, {self.rig.path.name}"
        return (
            measured(text) if self.rig.metric else assumed(f"{text}; its unit of length is not known, a guess: metres")
        )

    def T_cam_view(self, name: str) -> Float[ndarray, "4 4"]:
        """Return the pose of a view's camera in the clip's camera frame [m]."""
        return self.rig.T_own_view(self.own, self.views[name])

    def undistortion(
        self, one: RigCamera, size: tuple[int, int]
    ) -> tuple[Float[ndarray, "3 3"], Callable[[UInt8[ndarray, "H W 3"]], UInt8[ndarray, "H W 3"]] | None, str]:
        """Return a camera's intrinsics for images of a ``size``, what removes its lens's distortion, and a note on it.

        Raises ``InputError`` for images of another shape, and for a lens that leaves little of the images.
        """
        K, lens = self.rig.K_and_lens(one, size)
        if not lens.distortion:
            return K, None, ""
        try:
            return K, lens.removal(K, size), lens.words
        except UsageError as error:
            expected = "those of this lens, in OpenCV's order"
            raise InputError(self.rig.path, f"{one.name}.distortion", str(error), expected) from error


def write_undistorted(
    path: Path, removal: Callable[[UInt8[ndarray, "H W 3"]], UInt8[ndarray, "H W 3"]], folder: Path
) -> Path:
    """Write the frames of footage, whose lens distorts, without distortion into a folder of images; return it."""
    from contextlib import closing

    from getagrip.io.images import write_image
    from getagrip.readers.footage import ImageFolder, VideoFootage

    to = files.folder_inside(folder, "undistorted") / path.stem
    opened = ImageFolder.open(path) if path.is_dir() else VideoFootage(path)
    with closing(opened) as footage, files.new_folder(to, (f"{opened.name(0)}.jpg",) if to.exists() else ()) as new:
        for n in range(footage.frames):
            write_image(new / f"{footage.name(n)}.jpg", removal(footage.image(n)))
    return to


@dataclass(frozen=True, eq=False)
class NewView:
    """A view of a clip that is being made."""

    name: str
    match: MatchedFootage
    rig: CalibratedViews

    @staticmethod
    def all_of(options: ViewOptions, footage: FootageInterval) -> list[NewView]:
        """Open the views' footage and match it to the clip's. Raises ``InputError``."""
        from getagrip.io.terminal import print_note, warn
        from getagrip.readers.matched_footage import IN_STEP_S, describe_match, match_footage

        if options.rig is None:
            return []
        starts, out = dict(options.view_start), []
        for name, path in options.view:
            match = match_footage(footage, path, starts.get(name))
            options.rig.undistortion(options.rig.views[name], match.footage.size)  # refused before any work
            apart = abs(match.off).max() > IN_STEP_S or len(match.known) < len(footage.names)
            (warn if apart else print_note)(describe_match(name, match, len(footage.names)))
            out.append(NewView(name, match, options.rig))
        return out

    def write(self, clip: Path, frames: Sequence[str]) -> None:
        """Write the view's description and images into a clip's new folder."""
        import numpy as np

        from getagrip.clip.views import VIEWS_KEY, write_view_header
        from getagrip.io.images import write_image
        from getagrip.provenance import Source

        one, match = self.rig.views[self.name], self.match
        K, undistort, words = self.rig.undistortion(one, match.footage.size)
        camera = self.rig.source(one)
        camera = Source(camera.text + words, camera.basis)
        to, n = files.folder_inside(clip, VIEWS_KEY, self.name), len(match.known)
        T, known = self.rig.T_cam_view(self.name), [frames[row] for row in match.known]
        provenance: dict[str, object] = {"source": match.words, "camera": camera, "masks": "none yet"}
        every = np.tile(K, (n, 1, 1)), np.tile(T, (n, 1, 1))
        write_view_header(to, known, match.footage.size, *every, match.time_offset, provenance)
        (to / "frames").mkdir()
        for name, image in zip(known, match.images(), strict=True):
            write_image(to / "frames" / f"{name}.jpg", image if undistort is None else undistort(image))
        match.footage.close()
