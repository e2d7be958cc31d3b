"""What estimators of hands and masks write, and MANO's files."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuzz.child import Reader, mano_folder
from getagrip.hands import mano
from getagrip.io import arrays
from getagrip.readers.cameras import read_camera_path, read_rig
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from getagrip.readers.trackers import Request, Tracker
from getagrip.readers.trackers import read_tracked_hands as read_hands
from getagrip.readers.trackers.dynhamr import DynHaMR
from getagrip.readers.trackers.egohandkit import EgoHandKit
from getagrip.readers.trackers.egovision import EgoVision
from getagrip.readers.trackers.frankmocap import FrankMocap
from getagrip.readers.trackers.hamer import HaMeR, WiLoR
from getagrip.readers.trackers.hawor import HaWoR
from getagrip.readers.trackers.joints import Joints, Soma
from getagrip.readers.trackers.landmarks_2d import Landmarks
from getagrip.readers.trackers.mano_parameters import ManoParameters
from getagrip.readers.trackers.v2d import V2D
from helpers import hand_files, program_files, rig_files
from helpers.hand_files import Known, hamer_record, write_npz

REQUEST = MaskRequest(program_files.FRAMES, program_files.SIZE, ("1",), ("2", "3"))


def masks(name: str, write: Callable[[Path], object], wanted: MaskRequest = REQUEST) -> Reader:
    """Masks by another program."""

    def read(folder: Path) -> None:
        reader = open_masks(folder / name, wanted)
        for n in range(2):
            reader(n)

    return Reader(lambda folder: write(folder / name), read)


def mask_arrays(path: Path) -> None:
    arrays.write(path, {"labels": program_files.labels()[::-1].astype(np.uint8), "frames": np.array([4, 3])})


def thing_folders(folder: Path) -> None:
    for thing in ("object", "ignore"):
        (folder / thing).mkdir(parents=True)
        for name, values in zip(program_files.FRAMES, program_files.labels(), strict=True):
            program_files.write_png(folder / thing / f"{name}.png", values == 1, 1, 0)


def segments(path: Path) -> None:
    path.write_bytes(pickle.dumps(program_files.segments_of(2)))


def hands(tracker: Tracker, write: Callable[[Path, Known], object], with_mano: bool = False) -> Reader:
    """An estimator's files of three frames."""

    def read(folder: Path) -> None:
        K = np.tile(hand_files.K, (3, 1, 1))
        given = Request("right", hand_files.FRAMES, K, hand_files.SIZE, mano_folder() if with_mano else None)
        read_hands([folder], tracker, given)

    return Reader(lambda folder: write(folder, known_hand(with_mano)), read)


def known_hand(with_mano: bool) -> Known:
    return Known("right", mano_folder() if with_mano else None)


def hamer(folder: Path, known: Known) -> None:
    for n, name in enumerate(hand_files.FRAMES):
        write_npz(folder / f"{name}.npz", hamer_record(known, n, ("crop", "full", "box")[n]))


def hamer_demo(folder: Path, known: Known) -> None:
    for n in range(3):
        hand_files.demo_files(folder, known, n)


def hamer_pickles(folder: Path, known: Known) -> None:
    record = hamer_record(known, 0, "full")
    inner = {key: record[key] for key in ("global_orient", "hand_pose", "betas", "pred_cam_t_full")}
    inner["scaled_focal_length"] = np.float64(record["scaled_focal_length"])
    for name in hand_files.FRAMES:
        (folder / f"{name}.pkl").write_bytes(pickle.dumps({"is_right": 1.0, "wilor_preds": inner}))


def hawor(folder: Path, known: Known) -> None:
    record = {
        "init_root_orient": known.R,
        "init_hand_pose": known.pose,
        "init_betas": known.betas,
        "init_trans": known.t,
    }
    (folder / "6_8.json").write_text(json.dumps({key: value.tolist() for key, value in record.items()}))


def frankmocap(folder: Path, known: Known) -> None:
    known.vertices = known.vertices[:, :778]
    for n, name in enumerate(hand_files.FRAMES):
        (folder / f"{name}_prediction_result.pkl").write_bytes(pickle.dumps(hand_files.frankmocap_record(known, n)))


def mano_parameters(folder: Path, known: Known) -> None:
    orient = np.zeros((3, 3))
    write_npz(
        folder / "h.npz", {"global_orient": orient, "hand_pose": known.pose, "betas": known.betas, "transl": known.t}
    )


def joint_arrays(folder: Path, known: Known) -> None:
    write_npz(folder / "j.npz", {"joints": known.joints, "frames": np.array(hand_files.FRAMES)})


def mano_files(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        (folder / "mano").mkdir()
        hand_files.write_mano_files(folder / "mano", patch)


def rigs(write: rig_files.RigWriter, names: int) -> Reader:
    """A calibration of several cameras."""

    def read(folder: Path) -> None:
        inside = sorted(one for one in folder.iterdir() if one.name not in ("intrinsics",))
        read_rig(inside[0] if len(inside) == 1 else folder)

    return Reader(lambda folder: write(folder, rig_files.known_rig(names)), read)


def cameras(write: Callable[[Path, np.ndarray], Path]) -> Reader:
    """A camera's path by another program, in one file or a folder."""

    def read(folder: Path) -> None:
        inside = sorted(folder.iterdir())
        read_camera_path(inside[0] if len(inside) == 1 and inside[0].is_file() else folder)

    return Reader(lambda folder: write(folder, program_files.known()), read)


def soma(folder: Path, known: Known) -> None:
    write_npz(folder / "j.npz", {"joints": hand_files.soma_joints(known.joints)})


READERS: dict[str, Reader] = {
    **{f"cameras {name}": cameras(write) for name, (write, _, _) in program_files.WRITERS.items()},
    **{f"rig {name}": rigs(write, len(names)) for name, (write, names, _) in rig_files.RIG_WRITERS.items()},
    "hands hawor world": hands(HaWoR(), lambda folder, known: hand_files.hawor_folder(folder, known, None)),
    "hands dynhamr": hands(DynHaMR(), lambda folder, known: hand_files.dynhamr_file(folder, known, None)),
    "hands fasthamer": hands(HaMeR(), hand_files.fasthamer_files),
    "hands v2d result": hands(V2D(), hand_files.v2d_result),
    "hands egovision": hands(EgoVision(), hand_files.egovision_file),
    "hands egohandkit": hands(EgoHandKit(), hand_files.egohandkit_pickle),
    "hands egohandkit v1": hands(EgoHandKit(), hand_files.egohandkit_results),
    "hands v2d": hands(HaMeR(), hand_files.v2d_tracks),
    "hands soma": hands(Soma(), soma),
    "hands mediapipe": hands(Landmarks(), hand_files.mediapipe_files),
    "hands mmpose": hands(Landmarks(), hand_files.mmpose_file),
    "masks labels": masks("labels", program_files.label_folder),
    "masks things": masks("things", thing_folders, replace(REQUEST, object=(), ignore=())),
    "masks coco": masks("a.json", program_files.coco, replace(REQUEST, object=("cup",), ignore=("hand", "3"))),
    "masks coco lists": masks(
        "a.json", lambda path: program_files.coco(path, False), replace(REQUEST, object=("cup",))
    ),
    "masks arrays": masks("a.npz", mask_arrays),
    "masks sam2": masks("a.pkl", segments, replace(REQUEST, frames=("000000", "000001"))),
    "masks youtube-vis": masks("a.json", program_files.youtube_vis),
    "masks sa-v": masks("a.json", program_files.masklets, replace(REQUEST, frames=("000000", "000004"))),
    "masks labelme": masks("a", program_files.label_me),
    "masks npy": masks("a", program_files.array_folder),
    "hands hamer": hands(HaMeR(), hamer),
    "hands hamer demo": hands(HaMeR(), hamer_demo, with_mano=True),
    "hands wilor": hands(WiLoR(), hamer_pickles),
    "hands hawor": hands(HaWoR(600.0), hawor),
    "hands frankmocap": hands(FrankMocap(), frankmocap, with_mano=True),
    "hands mano": hands(ManoParameters(), mano_parameters, with_mano=True),
    "hands joints": hands(Joints("openpose"), joint_arrays),
    "MANO": Reader(mano_files, lambda folder: mano.load(folder / "mano" / "MANO_RIGHT.pkl", "right")),
}
"""By name."""
