"""Views: what further calibrated cameras see of a clip (``views/NAME`` in its folder, docs/formats.md).

A view is a clip of the same hand and object, at another camera (``clip_in_view``): so whatever reads, checks or
compares the masks, depth and joints of a clip does the same in each of its views. The camera of the clip itself is the
first one; poses of the other cameras are in its frame.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip.clip import Clip, Masks, OtherHand
from getagrip.clip.depth import DEPTH_KEY, VIEW_FILE, Depth, depth_file, read_depth, write_clip_depth
from getagrip.clip.masks import (
    mask_files,
    masks_in_memory,
    read_available_masks,
    with_masks,
    write_masks,
)
from getagrip.clip.read import parse_frame_names, parse_image_size, parse_intrinsics, parse_matrices
from getagrip.clip.read_arrays import check_camera_poses, parse_joints_2d
from getagrip.clip.write import collapse_constant
from getagrip.errors import InputError, UsageError, unknown_choice_error
from getagrip.geometry import se3
from getagrip.io import arrays, files
from getagrip.io.array_data import ArrayData, check_finite
from getagrip.io.files import Json
from getagrip.io.images import PackedMask, PackedMasks, pack_masks
from getagrip.provenance import Provenance, parse_provenance

VIEWS_KEY = "views"
"""Key of ``Clip.evidence``, and the folder of the views in a clip's folder."""
VIEW_FORMAT_VERSION = 1
VIEW_KEYS = ("version", "frames", "size", "camera", "time_offset", DEPTH_KEY, "provenance")
VIEW_CAMERA_KEYS = ("K", "T_cam_view")
MAX_VIEWS = 64
MAX_TIME_OFFSET_S = 1.0
"""Maximum difference between the times of a view's images and the clip's [s]: more is another moment."""
OWN_VIEW, BETTER_VIEW_RATIO = "first camera", 2.0
"""Name of a clip's own view in a clip that is fitted from a further one, and the ratio of frames that show the object
from which on it is."""
JOINTS_FILE = "joints.npz"
"""File of the hand's joints in a view's images."""


@dataclass(frozen=True, eq=False, kw_only=True)
class View(ArrayData):
    """A further camera's view of a clip's T frames.

    Attributes:
        name: name of the view, and of its folder.
        size: width and height of its images [px].
        K: (T, 3, 3) pinhole intrinsics of each frame [px].
        T_cam_view: (T, 4, 4) pose of its camera in the clip's camera frame [m], in each frame.
        masks: masks of the object and of its occluders; unknown in frames that the view lacks. Hand masks, if known.
        joints_2d: (T, 21, 2) joints of the hand in its images [px]; None if unknown.
        joints_2d_confidence: (T, 21) confidence of each joint, from 0 (not detected) to 1.
        depth: its depth images; None without any.
        time_offset: time of its images after the clip's [s]; 0 if cameras are in step.
        folder: its folder; None for a view that is only in memory.
        provenance: source of its data, by topic.
    """

    name: str
    size: tuple[int, int]
    K: Float[ndarray, "T 3 3"]
    T_cam_view: Float[ndarray, "T 4 4"]
    masks: Masks
    joints_2d: Float[ndarray, "T 21 2"] | None = None
    joints_2d_confidence: Float[ndarray, "T 21"] | None = None
    depth: Depth | None = None
    time_offset: float = 0.0
    folder: Path | None = None
    provenance: Provenance = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("K", "T_cam_view"):
            check_finite(f"View.{key}", getattr(self, key))
        if not files.is_portable_name(self.name):
            raise UsageError(f"View.name must be able to name a folder (got {files.shorten_value(self.name)})")
        if (self.joints_2d is None) != (self.joints_2d_confidence is None):
            raise UsageError("View.joints_2d and View.joints_2d_confidence go together")
        expected = (len(self.K), self.size[1], self.size[0])
        if self.masks.object.shape != expected:
            raise UsageError(f"View.masks must be of the shape {expected} (got {self.masks.object.shape})")

    def take(self, index: Int[ndarray, "n"]) -> View:
        """Return the view of some frames, in the given order."""
        seen, confidence = (None if a is None else a[index] for a in (self.joints_2d, self.joints_2d_confidence))
        return replace(
            self, K=self.K[index], T_cam_view=self.T_cam_view[index], masks=self.masks.take(index),
            joints_2d=seen, joints_2d_confidence=confidence, depth=self.depth and self.depth.take(index),
        )  # fmt: skip

    @property
    def T_view_cam(self) -> Float[ndarray, "T 4 4"]:
        """Poses of the clip's camera in this camera's frame."""
        return se3.inverse(self.T_cam_view)


@dataclass(frozen=True, eq=False)
class Views(ArrayData):
    """The further views of a clip, each of the same T frames."""

    each: tuple[View, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.each or len({view.name for view in self.each}) < len(self.each):
            raise UsageError(f"Views.each must be one view or more, of different names (got {self.names})")
        if len({len(view.K) for view in self.each}) > 1:
            raise UsageError(f"Views.each must have the same number of frames (got {[len(v.K) for v in self.each]})")

    def __len__(self) -> int:
        return len(self.each[0].K)

    @property
    def names(self) -> list[str]:
        """Names of the views."""
        return [view.name for view in self.each]

    def take(self, index: Int[ndarray, "n"]) -> Views:
        """Return the views of some frames, in the given order."""
        return Views(tuple(view.take(index) for view in self.each))


def views_of(clip: Clip) -> tuple[View, ...]:
    """Return the further views of a clip that are in memory; none without any."""
    views = clip.evidence.get(VIEWS_KEY)
    assert views is None or isinstance(views, Views)
    return () if views is None else views.each


def with_views(clip: Clip, views: Sequence[View]) -> Clip:
    """Return the clip with further views in memory; without any, even if its folder has some."""
    return replace(clip, evidence={**clip.evidence, VIEWS_KEY: Views(tuple(views)) if views else None})


def without_views(clip: Clip, names: Collection[str]) -> Clip:
    """Return the clip without some of its further views that are in memory."""
    return with_views(clip, [view for view in views_of(clip) if view.name not in names]) if names else clip


def clip_in_view(clip: Clip, view: View) -> Clip:
    """Return a clip as a further camera sees it: hands, truth and camera in that camera's frame, and its evidence."""
    T, other, truth = view.T_view_cam, clip.other_hand, clip.truth
    hand = replace(
        clip.hand, T_cam_hand=T @ clip.hand.T_cam_hand, joints_2d=view.joints_2d,
        joints_2d_confidence=view.joints_2d_confidence,
    )  # fmt: skip
    if other is not None:
        track = replace(other.track, T_cam_hand=T @ other.track.T_cam_hand, joints_2d=None, joints_2d_confidence=None)
        other = OtherHand(track, other.known)
    if truth is not None:
        truth = replace(truth, T_cam_obj=T @ truth.T_cam_obj, T_cam_hand=T @ truth.T_cam_hand)
    seen = replace(
        clip, name=f"{clip.name}/{VIEWS_KEY}/{view.name}", hand=hand, other_hand=other, truth=truth, K=view.K,
        size=view.size, world=None, folder=view.folder, segments=(), left_out=(),
        evidence={"texture": None, VIEWS_KEY: None, DEPTH_KEY: view.depth},
    )  # fmt: skip
    return with_masks(seen, view.masks)


def rows_in_view(clip: Clip, view: View, rows: Int[ndarray, "n"]) -> Clip:
    """Return some frames of a clip as a further camera sees them."""
    return clip_in_view(with_views(clip, []).take(rows), view.take(rows))


def with_packed_views(clip: Clip) -> Clip:
    """Return the clip with the masks of its views in little memory (``Masks.in_bits``), where frames cost little."""
    views = views_of(clip)
    return with_views(clip, [replace(view, masks=view.masks.in_bits) for view in views]) if views else clip


def from_best_view(clip: Clip) -> tuple[Clip, View | None]:
    """Return a clip as the view sees it that shows the object in most frames, and that view.

    That is the clip's own, None, unless a further one shows the object in more than ``BETTER_VIEW_RATIO`` times as many
    frames. The clip's own view is then a further one. A timeline stays as it is: its segments are of the own camera's
    world. Raises ``InputError`` as reading views does.
    """
    in_memory = VIEWS_KEY in clip.evidence
    if clip.segments or not (views_of(clip) if in_memory else clip.folder is not None and view_folders(clip.folder)):
        return clip, None
    masks = masks_in_memory(clip) or read_available_masks(clip, with_hand=True) or _unknown_masks(len(clip), clip.size)
    shown = BETTER_VIEW_RATIO * masks.observed.sum()
    if shown >= len(clip):
        return clip, None
    clip = clip if in_memory else replace(clip, evidence={**clip.evidence, VIEWS_KEY: read_views(clip)})
    best = max(views_of(clip), key=lambda view: int(view.masks.observed.sum()))
    if best.masks.observed.sum() <= shown:
        return clip, None
    depth, T = clip.evidence.get(DEPTH_KEY), best.T_view_cam
    own = View(
        name=OWN_VIEW, size=clip.size, K=clip.K, T_cam_view=T, masks=masks, joints_2d=clip.hand.joints_2d,
        joints_2d_confidence=clip.hand.joints_2d_confidence, depth=depth if isinstance(depth, Depth) else None,
    )  # fmt: skip
    others = [replace(view, T_cam_view=T @ view.T_cam_view) for view in views_of(clip) if view is not best]
    return with_views(replace(clip_in_view(clip, best), name=clip.name), [own, *others]), best


def view_folders(folder: Path) -> list[Path]:
    """List the folders of views in a clip's folder, by name. Raises ``InputError``, as for too many."""
    top, what = folder / VIEWS_KEY, "the description of a view"
    if not os.path.lexists(top):
        return []
    if not top.is_dir():
        raise InputError(top, "", "no folder", "a folder of views")
    found = sorted(path.name for path in top.iterdir() if not path.name.startswith("."))
    if len(found) > MAX_VIEWS:
        raise InputError(top, "", f"{len(found)} views", f"at most {MAX_VIEWS}")
    return [files.inside(folder, f"{VIEWS_KEY}/{name}/{VIEW_FILE}", "", what).parent for name in found]


def view_files(folder: Path, frames: Sequence[str]) -> list[str]:
    """Name the files of all views in a clip's folder for some of its frames: results depend on them."""
    out = []
    for path in view_folders(folder):
        names = [VIEW_FILE, *([JOINTS_FILE] if os.path.lexists(path / JOINTS_FILE) else [])]
        names += [name for kind in ("object", "ignore", "hand") for name in mask_files(path, kind, frames)]
        names += [name for frame in frames if (name := depth_file(path, frame)) is not None]
        out += [f"{VIEWS_KEY}/{path.name}/{name}" for name in names]
    return out


def read_views(clip: Clip) -> Views | None:
    """Read and check the views in a clip's folder, at the clip's frames; None without any. Raises ``InputError``."""
    if clip.folder is None:
        return None
    found = [read_view(clip, folder) for folder in view_folders(clip.folder)]
    return Views(tuple(found)) if found else None


def find_cameras(clip: Clip) -> tuple[View, ...]:
    """Return the further views of a clip: those in memory, else the cameras in its folder, whose masks are unknown.

    ``masks_in_view`` reads the masks where they are needed. Raises ``InputError``.
    """
    if VIEWS_KEY in clip.evidence or clip.folder is None:
        return views_of(clip)
    return tuple(_read_camera(clip, folder).view for folder in view_folders(clip.folder))


def masks_in_view(seen: Clip, view: View) -> Masks | None:
    """Return the masks of a view, at the frames of ``seen``, the clip as it sees it; None without a folder of masks.

    They are in memory or in the view's folder (``find_cameras``). Raises ``InputError``.
    """
    if view.masks.known.any() or view.folder is None:
        return view.masks
    frames, masks = {*read_view_header(view.folder).frames}, read_available_masks(seen)
    return masks and _masks_at(masks, np.array([name in frames for name in seen.frames]))


def read_view(clip: Clip, folder: Path) -> View:
    """Read and check one view of a clip from its folder, at the clip's frames. Raises ``InputError``."""
    view, n_frames, rows, known = _read_camera(clip, folder)
    seen = replace(clip_in_view(clip, view), evidence={})
    if (masks := read_available_masks(seen, with_hand=True)) is not None:
        view = replace(view, masks=_masks_at(masks, known))
    if os.path.lexists(folder / JOINTS_FILE):
        source = files.inside(folder, JOINTS_FILE, "", "joints of the hand in the view")
        stored = arrays.read(source, {"joints_2d", "joints_2d_confidence"}.__contains__)
        points, confidence = parse_joints_2d(source, stored, n_frames)
        confidence = np.where(known[:, None], confidence[rows], 0.0)
        view = replace(view, joints_2d=points[rows], joints_2d_confidence=confidence)
    depth = read_depth(with_masks(seen, view.masks)) if view.masks.observed.any() else None
    return replace(view, depth=depth)


@dataclass(frozen=True)
class ViewHeader:
    """The checked content of ``view.json``, at the n frames that the view has; its masks and depth are not read.

    Attributes:
        folder: the view's folder.
        fields: the content.
        frames: names of its frames, as the clip's.
        size: width and height of its images [px].
        K: (n, 3, 3) intrinsics [px].
        T_cam_view: (n, 4, 4) pose of its camera in the clip's camera frame [m].
        time_offset: time of its images after the clip's [s].
    """

    folder: Path
    fields: Json
    frames: tuple[str, ...]
    size: tuple[int, int]
    K: Float[ndarray, "n 3 3"]
    T_cam_view: Float[ndarray, "n 4 4"]
    time_offset: float

    @property
    def path(self) -> Path:
        """The file."""
        return self.folder / VIEW_FILE

    def changed(self, new: Mapping[str, object]) -> Json:
        """Return the content of ``view.json`` with ``new`` fields."""
        return {**self.fields, **new}


def find_view(clip: Path, name: str) -> ViewHeader:
    """Read the header of a view in a clip's folder. Raises ``InputError``, and ``UsageError`` for an unknown view."""
    found = {folder.name: folder for folder in view_folders(clip)}
    if not found:
        raise UsageError(f"--view cannot be used with {clip}: it has no views; clip new --view makes them")
    if name not in found:
        raise unknown_choice_error("--view", name, found)
    return read_view_header(found[name])


def read_view_header(folder: Path) -> ViewHeader:
    """Read and check the description of a view in its folder. Raises ``InputError``."""
    path = files.inside(folder, VIEW_FILE, "", "the description of a view")
    fields = files.read_json(path)
    unknown = next((key for key in fields if key not in VIEW_KEYS), None)
    if unknown is not None:
        raise InputError(path, files.printable(unknown), "an unknown key", f"one of {', '.join(VIEW_KEYS)}")
    if fields.get("version") != VIEW_FORMAT_VERSION:
        raise InputError(path, "version", files.shorten_value(fields.get("version")), str(VIEW_FORMAT_VERSION))
    camera, offset = fields.get("camera"), fields.get("time_offset", 0.0)
    if not isinstance(camera, dict) or sorted(camera) != sorted(VIEW_CAMERA_KEYS):
        expected = '{"K": 3x3 or one for each frame, "T_cam_view": 4x4 or one for each frame}'
        raise InputError(path, "camera", files.shorten_value(camera), expected)
    if isinstance(offset, bool) or not isinstance(offset, int | float) or not abs(offset) <= MAX_TIME_OFFSET_S:
        expected = f"seconds after the clip's images, at most {MAX_TIME_OFFSET_S:g} either way"
        raise InputError(path, "time_offset", files.shorten_value(offset), expected)
    frames, size = parse_frame_names(path, fields.get("frames")), parse_image_size(path, fields.get("size"))
    K = parse_intrinsics(path, camera, len(frames), size)
    T = parse_matrices(path, "camera.T_cam_view", camera["T_cam_view"], 4, len(frames))
    check_camera_poses(path, T, frames, "camera.T_cam_view")
    stated = fields.get("provenance", {})
    if not isinstance(stated, dict):
        raise InputError(path, "provenance", files.shorten_value(stated), "an object")
    fields = {**fields, "provenance": parse_provenance(path, stated, 4)}
    return ViewHeader(folder, fields, tuple(frames), size, K, T, float(offset))


class _Camera(NamedTuple):
    """A view whose pixels are not read."""

    view: View
    n_frames: int
    """Number of its own frames."""
    rows: Int[ndarray, "T"]
    """Own frame of each of the clip's, or the nearest one."""
    known: Bool[ndarray, "T"]
    """True in the clip's frames that it has."""


def _read_camera(clip: Clip, folder: Path) -> _Camera:
    """Read and check the camera of a view. Raises ``InputError``."""
    about = read_view_header(folder)
    frames, size = about.frames, about.size
    place = {name: n for n, name in enumerate(frames)}
    known = np.array([name in place for name in clip.frames])
    rows = _nearest_known(np.array([place.get(name, 0) for name in clip.frames]), known)
    view = View(
        name=folder.name, size=size, K=about.K[rows], T_cam_view=about.T_cam_view[rows],
        masks=_unknown_masks(len(clip), size), time_offset=about.time_offset, folder=folder,
        provenance=about.fields["provenance"],
    )  # fmt: skip
    return _Camera(view, len(frames), rows, known)


def _nearest_known(rows: Int[ndarray, "T"], known: Bool[ndarray, "T"]) -> Int[ndarray, "T"]:
    """Return the row of each frame, or of the nearest frame that has one; the first row if none has one."""
    at = np.flatnonzero(known)
    if not len(at):
        return np.zeros_like(rows)
    nearest = at[np.abs(np.arange(len(rows))[:, None] - at).argmin(axis=1)]
    return rows[nearest]


def _unknown_masks(frames: int, size: tuple[int, int]) -> Masks:
    """Make masks that say nothing in any frame."""
    nothing, everything = (make(size[::-1]) for make in (PackedMask.empty, PackedMask.full))
    return Masks(*(PackedMasks([each] * frames, size[::-1]).as_array() for each in (nothing, everything)))


def _masks_at(masks: Masks, known: Bool[ndarray, "T"]) -> Masks:
    """Return masks that are unknown in the frames that a view lacks, though its folder may have files of them."""
    if known.all():
        return masks
    height, width = masks.object.shape[1:]
    blank = _unknown_masks(len(known), (width, height))

    def kept(read: Bool[ndarray, "T H W"], unknown: Bool[ndarray, "T H W"]) -> Bool[ndarray, "T H W"]:
        each = zip(pack_masks(read).frames, pack_masks(unknown).frames, known, strict=True)
        return PackedMasks([mine if has else none for mine, none, has in each], (height, width)).as_array()

    hand = None if masks.hand is None else kept(masks.hand, blank.object)
    return Masks(kept(masks.object, blank.object), kept(masks.ignore, blank.ignore), hand)


def write_view_header(
    folder: Path, frames: Sequence[str], size: tuple[int, int], K: Float[ndarray, "n 3 3"],
    T_cam_view: Float[ndarray, "n 4 4"], time_offset: float, provenance: Provenance,
) -> None:  # fmt: skip
    """Write the description of a view of some of a clip's frames into the view's folder."""
    camera = {"K": collapse_constant(K), "T_cam_view": collapse_constant(T_cam_view)}
    about: Json = {"version": VIEW_FORMAT_VERSION, "frames": frames, "size": size, "camera": camera}
    about |= {"time_offset": time_offset} if time_offset else {}
    files.write_json(folder / VIEW_FILE, {**about, "provenance": provenance})


def write_view_joints(path: Path, points: Float[ndarray, "n 21 2"], confidence: Float[ndarray, "n 21"]) -> None:
    """Write the hand's joints in a view's n frames [px] to ``joints.npz``."""
    arrays.write(path, {"joints_2d": points, "joints_2d_confidence": confidence})


def write_view(view: View, clip: Clip, folder: Path) -> None:
    """Write a view of a clip into ``views/NAME`` of the clip's new folder."""
    to = files.folder_inside(folder, VIEWS_KEY, view.name)
    write_view_header(to, clip.frames, view.size, view.K, view.T_cam_view, view.time_offset, view.provenance)
    masks = view.masks
    if masks.known.any():
        write_masks(masks.object, masks.known, clip.frames, to / "masks" / "object")
        if masks.say_what_hides:
            write_masks(masks.ignore, masks.known, clip.frames, to / "masks" / "ignore")
        if masks.hand is not None:
            write_masks(masks.hand, masks.known, clip.frames, to / "masks" / "hand")
    if view.joints_2d is not None and view.joints_2d_confidence is not None:
        write_view_joints(to / JOINTS_FILE, view.joints_2d, view.joints_2d_confidence)
    if view.depth is not None:
        write_clip_depth(clip_in_view(clip, view), view.depth, to)
