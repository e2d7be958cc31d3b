"""HaMeR's and WiLoR's records: dictionaries from their demos, with one hand or several in a record.

A record has ``global_orient`` (3, 3), ``hand_pose`` (15, 3, 3) and ``betas`` (10), at the top or in
``pred_mano_params``, and the hand's position, the first of

- ``pred_cam_t_full`` (3) with ``scaled_focal_length`` () (by default the demo's 5000 / 256 * max(W, H));
- ``pred_cam`` (s, tx, ty) with ``box_center`` (2) and ``box_size`` ();
- ``pred_cam`` with ``box_xyxy`` (4): the detected box, enlarged twice;
- ``pred_cam`` with ``box_xyxy_456x256`` (4), in an image of 456 x 256: the later code of the paper's authors, with a
  dictionary for each of ``left`` and ``right``.

Boxes and translations are in pixels of ``img_size`` (W, H), by default of the clip's images. ``right`` (or
``is_right``) is 1 for right hands. Both networks are trained on right hands: rotations of a left hand are those of a
right hand in the mirrored crop, and are mirrored here; the sign of ``pred_cam[1]`` is as after both demos. The rotation
vectors of ``wilor_preds`` (WiLoR-mini) and ``hamer_preds`` (hamer-mini) are mirrored already.

fasthamer's results (``hands``, ``focal``, ``image_size``) and V2D's hand tracks (``mano``, ``camera``) have the same
content under other names.

A file may hold many images, by their paths: a record each, a list of records, or lists ``mano`` of parameters (with
``is_right``) and ``cam_trans`` (3), which is ``pred_cam_t_full``. ``hamer_demo`` reads the files that the demos save.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.model import SIDE_MIRROR, Side
from getagrip.io.files import shorten_value
from getagrip.io.options import one_of
from getagrip.provenance import Basis, Source
from getagrip.readers.trackers import hamer_demo
from getagrip.readers.trackers.estimates import (
    Camera,
    Estimate,
    Estimates,
    HandParameters,
    Request,
    WeakPerspective,
    hamer_focal,
    mirror_rotation,
    to_rotation_matrices,
    vitdet_side,
)
from getagrip.readers.trackers.records import PEOPLE_KEY, Record, Sample, child, record_numbers, seen_joints
from getagrip.readers.trackers.tracker import Tracker, per_image

MINI_OUTPUT_KEYS = ("wilor_preds", "hamer_preds")
"""Keys of the network's output in the records of WiLoR-mini and hamer-mini."""
BOX_IMAGE_SIZE_PX = (456, 256)
"""Width and height of the images of the later code's boxes [px]."""
ASPECT_RATIO_LOG_TOLERANCE = 0.1
"""Maximum log ratio between the aspect ratios of images of the same content."""


@dataclass(frozen=True)
class DemoTracker(Tracker):
    """Records, or the saved files of a demo."""

    joints_of: ClassVar[Side | None] = None

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the hand of the requested side in the clip's frames, from records or else from the demo's files."""
        unsaved = [path for path in paths if not hamer_demo.is_demo_file(path)]
        if not unsaved:
            return Estimates(request.side, tuple(hamer_demo.demo_estimates(paths, request, self.joints_of)))
        found = []
        for path, frame, content in per_image(unsaved, request):
            for record in split_people(path, content):
                hands = select_hamer_side(path, record, request.side)
                found += [hamer_estimate(path, frame, hand, request) for hand in hands]
        return Estimates(request.side, tuple(found))


@dataclass(frozen=True)
class HaMeR(DemoTracker):
    """HaMeR's records, and its demo's files."""

    name = "HaMeR"
    takes = "the demo's out_folder with --save_mesh, or a record for each image, as the demo holds it"

    layouts = ("[0-9]/*.json",)
    looks_for = "global_orient and hand_pose with pred_cam, pred_cam_t_full or cam_t; meshes <image>_<person>.obj"

    def recognises(self, sample: Sample) -> str:
        stem, suffix = sample.path.stem, sample.path.suffix.lower()
        if suffix == ".obj":
            return "meshes of HaMeR's or WiLoR's demo" if re.search(r"_\d{1,2}$", stem) else ""
        if suffix == ".npy":
            return "joints of HaMeR's demo" if stem.endswith(hamer_demo.DEMO_JOINTS_SUFFIX) else ""
        placed = sample.keys & {"pred_cam", "pred_cam_t_full", "cam_trans", "cam_t"}
        others = sample.keys & {"wilor_preds", "backend_meta", "schema_version"}  # WiLoR-mini's, EgoHandKit's
        if not placed or others or not sample.has("global_orient", "hand_pose"):
            return ""
        kinds = {"hamer_preds": "hamer-mini's", "cam_t": "fasthamer's", "track_id": "V2D's hand tracks, HaMeR's"}
        return next((kinds[key] for key in kinds if key in sample.keys), "HaMeR's (or WiLoR's)") + " records"

    joints_of: Annotated[Side | None, one_of("left", "right"), arg(help_behavior_hint="")] = None  # type: ignore[misc]
    """Side of all joints that the demo saved with --save_keypoints and without --save_mesh."""


def split_people(path: Path, content: Record) -> list[Record]:
    """Return the records of an image's hands. Raises ``InputError``."""
    listed: object = content
    if isinstance(content, Mapping) and list(content) == [PEOPLE_KEY]:
        listed = content[PEOPLE_KEY]
    elif isinstance(content, Mapping) and isinstance(content.get("hands"), list):  # fasthamer's result of an image
        camera = {key: content[key] for key in ("focal", "image_size") if key in content}
        listed = [{**hand, **camera} if isinstance(hand, Mapping) else hand for hand in content["hands"]]
    elif isinstance(content, Mapping) and isinstance(content.get("mano"), list) and "cam_trans" in content:
        listed = [
            {**hand, "pred_cam_t_full": t} if isinstance(hand, Mapping) else hand
            for hand, t in zip(content["mano"], content["cam_trans"], strict=False)
        ]
    each = [_rename_to_hamer_keys(hand) for hand in (listed if isinstance(listed, list) else [listed])]
    wrong = next((hand for hand in each if not isinstance(hand, Mapping)), None)
    if wrong is not None:
        raise InputError(path, "", shorten_value(wrong), "a dictionary for each hand")
    return each


def _rename_to_hamer_keys(hand: object) -> Any:
    """Rename the keys of fasthamer's hands and of V2D's tracks to HaMeR's."""
    if not isinstance(hand, Mapping):
        return hand
    if isinstance(hand.get("mano"), Mapping) and isinstance(hand.get("camera"), Mapping):
        hand = {**hand, **hand["mano"], **hand["camera"]}
    names = {"cam_t": "pred_cam_t_full", "focal": "scaled_focal_length", "image_size": "img_size"}
    names["keypoints_3d"] = "pred_keypoints_3d"
    return {names.get(key, key): value for key, value in hand.items()}


def select_hamer_side(path: Path, record: Record, side: Side) -> list[Record]:
    """Select the records of one side's hands in a record. Raises ``InputError``, also without a stated side."""
    if not record:  # the later code's, of an image without hands
        return []
    if "left" in record or isinstance(record.get("right", 0), dict | None):
        return [child(path, record, side)] if record.get(side) is not None else []
    key = next((key for key in ("right", "is_right") if key in record), None)
    if key is None:
        raise InputError(path, "right", "no such key", "1 for a right hand, 0 for a left one")
    flags = np.atleast_1d(record_numbers(path, record, key, (-1,))).ravel()
    rows = np.flatnonzero((flags > 0.5) == (side == "right"))
    return [dict(_items_of_hand(record, int(row), len(flags))) if len(flags) > 1 else record for row in rows]


def _items_of_hand(record: Record, row: int, of: int) -> Iterator[tuple[str, object]]:
    """Yield a record's items for one of several hands; items without an axis of hands are shared."""
    for key, value in record.items():
        if isinstance(value, dict):
            yield key, dict(_items_of_hand(value, row, of))
        else:
            shape = np.shape(value) if isinstance(value, ndarray | list) else ()
            each = len(shape) > (key == "img_size") and shape[0] == of
            yield key, value[row] if each else value


def hamer_estimate(path: Path, frame: int, record: Record, request: Request) -> Estimate:
    """Convert one record to a hand. Raises ``InputError``."""
    side, camera = request.side, request.camera(frame)
    mini = next((key for key in MINI_OUTPUT_KEYS if key in record), None)
    inner = record if mini is None else {**record, **child(path, record, mini)}
    of = {**inner, **child(path, inner, "pred_mano_params")} if "pred_mano_params" in inner else inner
    R = to_rotation_matrices(path, "global_orient", record_numbers(path, of, "global_orient", (3, 3), (3,)), 0)
    fingers = to_rotation_matrices(path, "hand_pose", _read_finger_rotations(path, of), 1)
    betas = record_numbers(path, of, "betas", (10,))
    if side == "left" and mini is None:
        R, fingers = mirror_rotation(R), mirror_rotation(fingers)
    weak, depth = _weak_perspective(path, inner, camera)
    if not weak.pixels_per_metre > 0:
        raise InputError(path, "pred_cam", f"the scale {weak.pixels_per_metre:g}", "a hand before the camera")
    t = weak.before(camera)
    pose = se3.log_so3(fingers).reshape(45)
    joints = _read_hamer_joints(path, inner, side, R, pose, betas) if "pred_keypoints_3d" in inner else None
    parameters, seen = HandParameters(R, pose, betas, t), seen_joints(path, inner)
    return Estimate(path, frame, depth, parameters, None if joints is None else joints + t, seen=seen)


def _read_finger_rotations(path: Path, record: Record) -> ndarray:
    """Read ``hand_pose`` as 15 matrices or vectors, from one row of 45, too."""
    pose = record_numbers(path, record, "hand_pose", (15, 3, 3), (15, 3), (45,))
    return pose.reshape(15, 3) if pose.ndim == 1 else pose


def _weak_perspective(path: Path, record: Record, camera: Camera) -> tuple[WeakPerspective, Source]:
    """Return the network's weak-perspective camera in the pixels of the clip's images, and the source of its depth."""
    size, swapped = _record_image_size(path, record, camera)
    basis: Basis = "assumed" if swapped else "estimated"
    zoom = np.array(camera.size) / size
    if "pred_cam_t_full" in record:
        t = record_numbers(path, record, "pred_cam_t_full", (3,))
        if not t[2] > 0:
            raise InputError(path, "pred_cam_t_full", f"the depth {t[2]:g}", "above 0")
        focal = hamer_focal((int(size[0]), int(size[1])))
        known = "5000 / 256 times the larger side, as the demo assumes, to be divided out again: no focal in the file"
        if "scaled_focal_length" in record:
            focal = float(record_numbers(path, record, "scaled_focal_length", ()))
            known = f"the file's focal length, {focal:.6g} px, divided out"
        if not focal > 0:
            raise InputError(path, "scaled_focal_length", f"{focal:g}", "above 0")
        weak = WeakPerspective.of_translation(t, focal, size / 2.0)
        return weak.resized(zoom), Source(f"pred_cam_t_full, {known}, and the clip's put in{swapped}", basis)
    cam = record_numbers(path, record, "pred_cam", (3,))
    if "box_center" in record:
        centre = record_numbers(path, record, "box_center", (2,))
        side = float(record_numbers(path, record, "box_size", ()))
        source = "box_center and box_size"
    else:
        source = next((key for key in ("box_xyxy_456x256", "box_xyxy") if key in record), "box_center")
        corners = record_numbers(path, record, source, (4,))
        centre, side = (corners[:2] + corners[2:]) / 2.0, vitdet_side(corners[2:] - corners[:2], 2.0)
    if not side > 0:
        raise InputError(path, source, f"a box {side:g} px large", "a box with an area")
    weak = WeakPerspective.of_crop(centre, side, cam)
    depth = f"weak perspective (pred_cam, {source}) and the clip's focal length{swapped}"
    return weak.resized(zoom), Source(depth, basis)


def _record_image_size(path: Path, record: Record, camera: Camera) -> tuple[Float[ndarray, "2"], str]:
    """Return the size of a record's images [px], and a note on a swapped ``img_size``.

    Raises ``InputError`` for images of another aspect ratio than the clip's.
    """
    if "box_xyxy_456x256" in record:
        return np.array(BOX_IMAGE_SIZE_PX, dtype=float), ""
    size = np.array(camera.size, dtype=float)
    if "img_size" in record:
        size = record_numbers(path, record, "img_size", (2,))
    if not size.min() >= 1.0:
        raise InputError(path, "img_size", str(size.tolist()), "width and height [px]")
    clip, wanted = camera.size[0] / camera.size[1], _format_image_size(camera.size)
    if abs(np.log(size[0] / size[1] / clip)) < ASPECT_RATIO_LOG_TOLERANCE:
        return size, ""
    if abs(np.log(size[1] / size[0] / clip)) < ASPECT_RATIO_LOG_TOLERANCE:
        return size[::-1], f"; img_size read as height and width, a guess: the clip's images are {wanted}"
    raise InputError(path, "img_size", _format_image_size(size), f"width and height like the clip's images, {wanted}")


def _format_image_size(size: Sequence[float] | ndarray) -> str:
    return f"{size[0]:g} x {size[1]:g}"


def _read_hamer_joints(
    path: Path, record: Record, side: Side, R: ndarray, pose: ndarray, betas: ndarray
) -> Float[ndarray, "21 3"]:
    """Read ``pred_keypoints_3d``; a left hand's are mirrored if that agrees better with the rotations.

    The demos mirror a left hand's vertices always, but its keypoints not always.
    """
    from getagrip.readers.trackers.read_hands import generic_joints

    joints = record_numbers(path, record, "pred_keypoints_3d", (21, 3))
    if side == "right":
        return joints
    expected = generic_joints(side, R, pose)
    both = [joints, joints * SIDE_MIRROR]
    errors = [np.linalg.norm((x - x[0]) - (expected - expected[0])) for x in both]
    return both[int(np.argmin(errors))]


@dataclass(frozen=True)
class WiLoR(DemoTracker):
    """WiLoR's records, from its demo or from WiLoR-mini (``wilor_preds``), and its demo's meshes."""

    name = "WiLoR"
    takes = "the demo's out_folder with --save_mesh, or a record for each image, of its demo or of WiLoR-mini"
    looks_for = "wilor_preds, as WiLoR-mini has them"

    def recognises(self, sample: Sample) -> str:
        return "WiLoR-mini's records" if "wilor_preds" in sample.keys else ""
