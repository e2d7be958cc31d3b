"""HOT3D's raw files as arrays: one ``Hot3dRecording`` with every pose at the times of one camera.

A recording is a folder ``P<person>_<id>``, or several folders of that name below ROOT, with ``dynamic_objects.csv``,
``headset_trajectory.csv``, ``umetrack_hand_pose_trajectory.jsonl``, ``umetrack_hand_user_profile.json`` and the
calibration: ``online_calibration.jsonl`` (Aria) or ``camera_models.json`` (Quest 3). Poses ``T_world_x`` are
quaternions (w, x, y, z) and metres.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.fisheye import Fisheye624, Pinhole, pinhole
from getagrip.hands import umetrack
from getagrip.hands.model import PosedHand, Side
from getagrip.io.files import MAX_JSON_BYTES, Json, is_portable_name, read_bytes, shorten_value
from getagrip.readers.datasets.tracks import MAX_SEQUENCE_FRAMES

OBJECT_POSE_FILES = ("dynamic_objects.csv", "dynamic_objects_v2.csv")
MAX_TIME_DIFFERENCE_NS = 5_000_000
"""Maximum difference between the times of a frame and its pose [ns]; cameras and poses of one instant are stamped
0.1 ms apart, frames 33 ms."""
MAX_HOT3D_FILE_BYTES = 128 * 2**20
"""Maximum size of a file of poses; two minutes take about ten million bytes."""
MAX_HOT3D_SIDE_PX = 8192
"""Maximum side of an image [px]."""
MAX_POSE_NUMBER = 1e9
"""Maximum absolute number in a pose, an angle or a calibration."""
SIDE_BY_HAND_ID: dict[str, Side] = {"0": "left", "1": "right"}
ARIA_CAMERAS = {"camera-rgb": (1408, 1408), "camera-slam-left": (640, 480), "camera-slam-right": (640, 480)}
"""Cameras in order of preference, with their image sizes [px], which the calibration lacks."""


@dataclass(frozen=True)
class RecordedHand:
    """One hand over a recording, and the frames in which it is known."""

    posed: PosedHand
    T_world_hand: Float[ndarray, "N 4 4"]
    known: Bool[ndarray, "N"]


@dataclass(frozen=True)
class WorldPoses:
    """The poses of one object over a recording, and the frames in which they are known."""

    T_world_obj: Float[ndarray, "N 4 4"]
    known: Bool[ndarray, "N"]


@dataclass(frozen=True)
class HeadsetCamera:
    """The fisheye camera of a recording, and the pinhole in its place."""

    device: str
    label: str
    fisheye: Fisheye624
    pinhole: Pinhole
    T_world_cam: Float[ndarray, "N 4 4"]
    """Poses of the pinhole."""

    @property
    def description(self) -> str:
        """Description for the provenance."""
        return f"{self.device}, {self.label}: a pinhole of the fisheye lens's focal length and axis"

    @property
    def bop(self) -> dict[str, str]:
        """Dataset, split and camera, by their names in the BOP benchmark."""
        split = "test-aria" if self.device == "Aria" else "test-quest3"
        return {"dataset": "hot3d", "split": split, "camera": "rgb" if self.label == "camera-rgb" else "gray1"}


@dataclass(frozen=True)
class Hot3dRecording:
    """The cameras, hands and objects of a recording at the first camera's frames."""

    name: str
    times: Int[ndarray, "N"]
    """Times of the frames [ns]."""
    cameras: tuple[HeadsetCamera, ...]
    """The clips' camera first."""
    hands: dict[Side, RecordedHand]
    objects: dict[str, WorldPoses]
    """By HOT3D's object uid."""

    @property
    def camera(self) -> HeadsetCamera:
        """The clips' camera."""
        return self.cameras[0]


HOT3D_CLIPS_PATTERNS = ("clip-*.tar", "*.objects.json", "*.cameras.json")
"""Names of the files of HOT3D-Clips, packed and not."""


def find_hot3d_recordings(root: Path) -> dict[str, dict[str, Path]]:
    """Find the files of each recording below a folder, by name. Raises ``InputError`` without a recording."""
    if root.is_file() and fnmatch(root.name, HOT3D_CLIPS_PATTERNS[0]):
        raise _clips_layout_error(root)
    if not root.is_dir():
        raise InputError(root, "", "no such folder", "a folder with HOT3D recordings")
    folders: dict[str, dict[str, Path]] = {}
    for path in sorted(root.rglob("*")):
        if path.is_file():
            folders.setdefault(path.parent.name, {})[path.name] = path
    found = {name: files for name, files in sorted(folders.items()) if {*OBJECT_POSE_FILES} & files.keys()}
    names = [name for files in folders.values() for name in files]
    if not found and any(fnmatch(name, pattern) for name in names for pattern in HOT3D_CLIPS_PATTERNS):
        raise _clips_layout_error(root)
    if not found:
        raise InputError(root, "", f"no {OBJECT_POSE_FILES[0]} below it", "HOT3D recordings")
    return found


def _clips_layout_error(root: Path) -> InputError:
    got = "HOT3D-Clips (clip-*.tar), another layout, which is not read"
    return InputError(root, "", got, "HOT3D's full recordings, as its own downloader saves them")


def read_recording(name: str, files: dict[str, Path], all_cameras: bool = False) -> Hot3dRecording:
    """Read the files of one recording, with its first camera or with all. Raises ``InputError``.

    A file may be missing or malformed.
    """

    def need(*alternatives: str) -> Path:
        for alternative in alternatives:
            if alternative in files:
                return files[alternative]
        folder = next(iter(files.values())).parent
        raise InputError(folder, " or ".join(alternatives), "no such file", f"it among the files of recording {name}")

    headset = next(iter(_read_poses_csv(need("headset_trajectory.csv")).values()))
    stamps = np.array(sorted(headset))
    # The cameras of one instant are stamped a little apart: one of each pair of poses is used.
    times = stamps[np.concatenate([[True], np.diff(stamps) > MAX_TIME_DIFFERENCE_NS])]
    if not 2 <= len(times) <= MAX_SEQUENCE_FRAMES:
        raise InputError(need("headset_trajectory.csv"), "", f"{len(times)} frames", f"2 to {MAX_SEQUENCE_FRAMES}")
    T_world_device, _ = _nearest_values(times, headset)
    object_poses = _read_poses_csv(need(*OBJECT_POSE_FILES))
    objects = {uid: WorldPoses(*_nearest_values(times, poses)) for uid, poses in object_poses.items()}
    calibration = need("online_calibration.jsonl", "camera_models.json")
    cameras = (
        _read_aria_cameras(calibration, times, T_world_device, all_cameras)
        if calibration.suffix == ".jsonl"
        else _read_quest_cameras(calibration, T_world_device, all_cameras)
    )
    labels = [camera.label for camera in cameras]
    if all_cameras and (len(set(labels)) < len(labels) or not all(map(is_portable_name, labels))):
        raise InputError(calibration, "cameras", shorten_value(labels), "different names of cameras")
    model = umetrack.load(need("umetrack_hand_user_profile.json"))
    hands = _read_recorded_hands(need("umetrack_hand_pose_trajectory.jsonl"), model, times)
    return Hot3dRecording(name, times, cameras, hands, objects)


def _read_recorded_hands(
    path: Path, model: umetrack.UmeTrackHand, times: Int[ndarray, "N"]
) -> dict[Side, RecordedHand]:
    wrists: dict[Side, dict[int, Float[ndarray, "4 4"]]] = {"left": {}, "right": {}}
    angles: dict[Side, dict[int, Float[ndarray, "22"]]] = {"left": {}, "right": {}}
    for number, line in _read_json_lines(path):
        with _input_errors_at(path, f"line {number}", "a time and the poses of the hands"):
            time = _parse_positive_integer(line["timestamp_ns"])
            for key, pose in line["hand_poses"].items():
                wrist = pose["wrist_xform"]
                wrists[SIDE_BY_HAND_ID[key]][time] = _rigid_from_quaternion([*wrist["q_wxyz"], *wrist["t_xyz"]])
                angles[SIDE_BY_HAND_ID[key]][time] = _parse_bounded_numbers(pose["joint_angles"], 22)
    hands = {}
    for side in SIDE_BY_HAND_ID.values():
        if wrists[side]:
            T_world_wrist, known = _nearest_values(times, wrists[side])
            posed = model.with_pose(side, _nearest_values(times, angles[side])[0])
            hands[side] = RecordedHand(posed, umetrack.T_world_hand(side, T_world_wrist), known)
    return hands


def _read_aria_cameras(
    path: Path, times: Int[ndarray, "N"], T_world_device: Float[ndarray, "N 4 4"], all_cameras: bool
) -> tuple[HeadsetCamera, ...]:
    """Read the RGB camera, or else the left SLAM camera, calibrated online, optionally with those after it.

    The calibration's clock differs from the poses' clock and drifts little, so both are set equal at the first frame.
    The lens is taken from the first frame, the camera's mount on the headset from every frame.
    """
    lenses: dict[str, Fisheye624] = {}
    mounts: dict[str, dict[int, Float[ndarray, "4 4"]]] = {}
    for number, line in _read_json_lines(path):
        with _input_errors_at(path, f"line {number}", f"the calibration of one of {', '.join(ARIA_CAMERAS)}"):
            cameras = {camera["Label"]: camera for camera in line["CameraCalibrations"] if camera["Calibrated"]}
            if not mounts:
                labels = [name for name in ARIA_CAMERAS if name in cameras]
                mounts = {label: {} for label in (labels if all_cameras else [next(iter(labels))])}
            for label in mounts.keys() & cameras.keys():
                mount = cameras[label]["T_Device_Camera"]
                w, xyz = mount["UnitQuaternion"]
                time = 1000 * _parse_positive_integer(line["tracking_timestamp_us"])
                mounts[label][time] = _rigid_from_quaternion([w, *xyz, *mount["Translation"]])
                params = cameras[label]["Projection"]["Params"]
                lenses.setdefault(label, Fisheye624.from_parameters(params, ARIA_CAMERAS[label]))
    if not mounts:
        raise InputError(path, "", "no line", "a calibration for every frame")
    start = min(next(iter(mounts.values())))
    out = []
    for label, of_label in mounts.items():
        T_device_fisheye, _ = _nearest_values(times - times[0] + start, of_label)
        out.append(_headset_camera("Aria", label, lenses[label], T_world_device @ T_device_fisheye))
    return tuple(out)


def _read_quest_cameras(
    path: Path, T_world_device: Float[ndarray, "N 4 4"], all_cameras: bool
) -> tuple[HeadsetCamera, ...]:
    """Read the first large camera of a Quest 3, which is stream 1201-1, or all large ones."""
    try:
        described = json.loads(read_bytes(path, MAX_JSON_BYTES))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(path, "", f"an unreadable file ({error})", "a JSON list of cameras") from error
    cameras = []
    with _input_errors_at(path, "cameras", "a list of Fisheye624 cameras"):
        large = (camera for camera in described if camera["imageHeight"] >= 640)
        for camera in large if all_cameras else [next(large)]:
            sides = camera["imageWidth"], camera["imageHeight"]
            width, height = (_parse_positive_integer(side, MAX_HOT3D_SIDE_PX) for side in sides)
            fisheye = Fisheye624.from_parameters(camera["projectionParams"], (width, height))
            mount = camera["T_Device_Camera"]
            T_device_fisheye = _rigid_from_quaternion([*mount["quaternion_wxyz"], *mount["translation_xyz"]])
            cameras.append(_headset_camera("Quest 3", str(camera["label"]), fisheye, T_world_device @ T_device_fisheye))
    if not cameras:
        raise InputError(path, "cameras", "no large camera", "one of 640 rows or more")
    return tuple(cameras)


def _headset_camera(device: str, label: str, lens: Fisheye624, T_world_lens: Float[ndarray, "N 4 4"]) -> HeadsetCamera:
    view = _make_upright_pinhole(lens)
    return HeadsetCamera(device, label, lens, view, T_world_lens @ view.T_fisheye_pinhole)


def _make_upright_pinhole(fisheye: Fisheye624) -> Pinhole:
    """Make an upright pinhole of the lens's focal length and image size: both headsets mount cameras sideways."""
    width, height = fisheye.size
    return pinhole(fisheye, fisheye.f, (height, width), quarter_turns=1)


def _nearest_values(
    times: Int[ndarray, "N"], values: dict[int, ndarray]
) -> tuple[Float[ndarray, "N ..."], Bool[ndarray, "N"]]:
    """Return the values nearest in time, and which of them are within ``MAX_TIME_DIFFERENCE_NS``."""
    stamps = np.array(sorted(values))
    after = np.minimum(np.searchsorted(stamps, times), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(stamps[before] - times) <= np.abs(stamps[after] - times), before, after)
    near = np.abs(stamps[nearest] - times) <= MAX_TIME_DIFFERENCE_NS
    return np.stack([values[int(t)] for t in stamps[nearest]]), near


def _read_poses_csv(path: Path) -> dict[str, dict[int, Float[ndarray, "4 4"]]]:
    """Read ``T_world_x`` by object and time [ns]."""
    columns = ["t_wo_x[m]", "t_wo_y[m]", "t_wo_z[m]", "q_wo_w", "q_wo_x", "q_wo_y", "q_wo_z"]
    expected = f"columns object_uid, timestamp[ns], {', '.join(columns)}"
    poses: dict[str, dict[int, Float[ndarray, "4 4"]]] = {}
    text = read_bytes(path, MAX_HOT3D_FILE_BYTES)
    try:
        with io.StringIO(text.decode("utf-8-sig"), newline="") as file:
            for number, row in enumerate(csv.DictReader(file), start=2):
                with _input_errors_at(path, f"line {number}", expected):
                    numbers = [float(row[c]) for c in columns]
                    T = _rigid_from_quaternion([*numbers[3:], *numbers[:3]])
                    poses.setdefault(row["object_uid"], {})[_parse_positive_integer(row["timestamp[ns]"])] = T
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(path, "", f"an unreadable file ({error})", "a table of poses") from error
    if not poses:
        raise InputError(path, "", "no row", "poses")
    return poses


def _read_json_lines(path: Path) -> Iterator[tuple[int, Json]]:
    content = read_bytes(path, MAX_HOT3D_FILE_BYTES)
    try:
        for number, line in enumerate(io.BytesIO(content), start=1):
            if line.strip():
                yield number, json.loads(line)
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(path, "", f"an unreadable file ({error})", "one JSON object a line") from error


def _rigid_from_quaternion(numbers: Sequence[float]) -> Float[ndarray, "4 4"]:
    """Convert a quaternion (w, x, y, z) and a translation."""
    q_t = _parse_bounded_numbers(numbers, 7)
    if abs(np.linalg.norm(q_t[:4]) - 1.0) > 1e-2:
        raise ValueError("a quaternion that is not of unit length")
    return se3.rigid(se3.from_quaternion(q_t[:4]), q_t[4:])


def _parse_positive_integer(value: str | float, largest: int = 2**53) -> int:
    number = int(value)
    if not 0 < number <= largest:
        raise ValueError(f"{number}, which is not between 1 and {largest}")
    return number


def _parse_bounded_numbers(values: Sequence[float], count: int) -> Float[ndarray, "n"]:
    array = np.asarray(values, dtype=float)
    if array.shape != (count,) or not (np.abs(array) < MAX_POSE_NUMBER).all():
        raise ValueError(f"not {count} numbers below {MAX_POSE_NUMBER:g}")
    return array


@contextmanager
def _input_errors_at(path: Path, key: str, expected: str) -> Iterator[None]:
    """Convert errors of reading untyped data to an ``InputError`` with the place in the file."""
    try:
        yield
    except KeyError as error:
        raise InputError(path, key, f"no {error}", expected) from error
    except (TypeError, ValueError, OverflowError, AttributeError, StopIteration) as error:
        raise InputError(path, key, str(error) or "something else", expected) from error
