"""Imports into the views of a clip: a calibration of all cameras, and joints of the hand in a view's images."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from getagrip.cli.command import WARNING_EXIT_STATUS, refuse_existing
from getagrip.cli.view_options import CalibratedViews
from getagrip.clip.depth import DEPTH_KEY
from getagrip.clip.read import ClipHeader, read_header
from getagrip.clip.read_arrays import check_intrinsics
from getagrip.clip.views import JOINTS_FILE, ViewHeader, find_view, view_folders, write_view_joints
from getagrip.clip.write import collapse_constant
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.io.terminal import print_note, print_result, warn
from getagrip.provenance import is_assumed
from getagrip.readers.cameras import read_rig
from getagrip.readers.trackers import TrackedHands

SEEN = ("frames", "masks", DEPTH_KEY, JOINTS_FILE)
"""Files of a view that are of its images."""
OWN_FOCAL_TOLERANCE = 0.02
"""Relative difference of the clip's focal length from its camera's in a calibration above which it warns."""


def import_rig(
    path: Path, clip: Path, camera: str | None, view: str | None, metres: float | None, undistorted: bool,
    intrinsics: bool,
) -> int:  # fmt: skip
    """Write intrinsics and poses of the cameras of a clip's views, all or one, by a calibration.

    ``camera`` is the clip's own one; with ``intrinsics`` the clip gets its intrinsics, too. Returns 0, or 3 with
    warnings. Raises ``InputError``, and ``UsageError`` for a clip without views, or views of distorted images.
    """
    header = read_header(clip)
    known = [folder.name for folder in view_folders(header.folder)]
    if not known:
        raise UsageError(f"{path} cannot be used with {clip}: it has no views; clip new --view makes them")
    wanted = [find_view(header.folder, name) for name in (known if view is None else [view])]
    rig = CalibratedViews.of(read_rig(path, metres), camera, known)
    warnings = list[str]()
    for each in wanted:
        _write_view_camera(each, rig, undistorted)
        if is_assumed(source := rig.source(rig.views[each.folder.name])):
            warnings.append(f"view {each.folder.name}: {source}")
    warnings += _own_camera(header, rig, intrinsics)
    for text in warnings:
        warn(text)
    print_result(f"{header.folder}: cameras of {', '.join(each.folder.name for each in wanted)}, from {rig.rig.source}")
    return WARNING_EXIT_STATUS if warnings else 0


def _write_view_camera(view: ViewHeader, rig: CalibratedViews, undistorted: bool) -> None:
    name, one = view.folder.name, rig.views[view.folder.name]
    K, lens = rig.rig.K_and_lens(one, view.size)
    if lens.distortion and not undistorted and any(os.path.lexists(view.folder / each) for each in SEEN):
        way = "clip new --view undistorts the images; --undistorted states that they are without it already"
        raise InputError(rig.rig.path, f"{name}.distortion", "a lens that distorts", f"none, for {view.folder}; {way}")
    T = rig.T_cam_view(name)
    moved = np.linalg.norm(T[:3, 3] - view.T_cam_view[0, :3, 3])
    turned = np.degrees(se3.angle_between(T[:3, :3], view.T_cam_view[0, :3, :3]))
    print_note(f"view {name}: its camera moved by {1e3 * moved:.1f} mm and turned by {turned:.2f}°")
    provenance = view.fields["provenance"] | {"camera": rig.source(one)}
    camera = {"K": K.tolist(), "T_cam_view": T.tolist()}
    with files.new_file(view.path) as part:
        files.write_json(part, view.changed({"camera": camera, "provenance": provenance}))


def _own_camera(header: ClipHeader, rig: CalibratedViews, intrinsics: bool) -> list[str]:
    """Write the clip's own intrinsics if asked for; return a warning about others."""
    K, _ = rig.rig.K_and_lens(rig.own, header.size)
    every = np.tile(K, (len(header.frames), 1, 1))
    if not intrinsics:
        apart = abs(header.K[:, 0, 0] / K[0, 0] - 1.0).max()
        ours = f"{header.K[0, 0, 0]:.5g} px in the clip, {K[0, 0]:.5g} px of {rig.own.name} in {rig.rig.path}"
        return [f"camera: focal length {ours}; --intrinsics takes it"] if apart > OWN_FOCAL_TOLERANCE else []
    check_intrinsics(rig.rig.path, every, header.size)
    camera = {**header.fields["camera"], "K": collapse_constant(every)}
    provenance = header.fields["provenance"] | {"camera": rig.source(rig.own)}
    with files.new_file(header.path) as part:
        files.write_json(part, header.changed({"camera": camera, "provenance": provenance}))
    return []


def write_imported_joints(source: Path, hands: TrackedHands, view: ViewHeader, overwrite: bool) -> int:
    """Write the 2D joints of an estimator's hands into a view. Raises ``InputError`` for hands without any."""
    target = view.folder / JOINTS_FILE
    refuse_existing(target, overwrite)
    seen, sure = hands.track.joints_2d, hands.track.joints_2d_confidence
    if seen is None or sure is None:
        raise InputError(source, "", "no 2D joints", "2D landmarks; a view has a camera, the clip has the hand")
    points, confidence = np.zeros((len(view.frames), 21, 2)), np.zeros((len(view.frames), 21))
    points[list(hands.found)], confidence[list(hands.found)] = seen, sure
    with files.new_file(view.path) as part, files.new_file(target) as joints:
        write_view_joints(joints, points, confidence)
        provenance = view.fields["provenance"] | {"joints": f"from {source.name}"}
        files.write_json(part, view.changed({"provenance": provenance}))
    print_result(f"{target}: the hand's joints in {len(hands.found)} of {len(view.frames)} frames")
    return 0
