"""Files are found by the names of frames; what is wrong in those of strangers is named, and nothing in them is run."""

from __future__ import annotations

import json
import pickle
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from getagrip.clip.match_frames import frame_of
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.frankmocap import FrankMocap
from getagrip.readers.trackers.hamer import HaMeR
from getagrip.readers.trackers.hawor import HaWoR
from getagrip.readers.trackers.joints import Joints
from helpers.hand_files import Known, frankmocap_record, hamer_record, request, write_npz

BROKEN: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "global_orient": lambda r: r | {"global_orient": np.full((1, 3, 3), np.nan)},
    "hand_pose": lambda r: r | {"hand_pose": np.zeros((14, 3, 3))},
    "betas": lambda r: r | {"betas": np.full(10, np.inf)},
    "pred_cam": lambda r: r | {"pred_cam": np.array([-1.0, 0.0, 0.0])},
    "box_size": lambda r: r | {"box_size": np.nan},
    "box_center": lambda r: {key: value for key, value in r.items() if key != "box_center"},
    "img_size": lambda r: r | {"img_size": np.zeros(2)},
    "right": lambda r: {key: value for key, value in r.items() if key != "right"},
}


def test_names_of_frames() -> None:
    frames = ("000743", "000744", "7_1")
    assert frame_of("000743", frames) == 0
    assert frame_of("000744_0", frames) == 1
    assert frame_of("000744_prediction_result", frames) == 1
    assert frame_of("frame_0000000743", frames) == 0
    assert frame_of("7_1", frames) == 2
    assert frame_of("000745", frames) is None
    assert frame_of("nothing", frames) is None


def test_paths_that_are_wrong_are_named(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "empty").mkdir()
    right = write_npz(tmp_path / "000007.npz", hamer_record(Known("right", None), 0, "crop"))
    other = write_npz(tmp_path / "000001.npz", hamer_record(Known("right", None), 0, "crop"))
    for path, words in (
        (tmp_path / "none.npz", "no such file or folder"),
        (tmp_path / "none*.npz", "a pattern that matches no file"),
        (tmp_path / "empty", "a folder without such a file"),
        (other, "no name of a frame"),
    ):
        refused(lambda path=path: read_tracked_hands([path], HaMeR(), request("right")), str(path), words)
    refused(
        lambda: read_tracked_hands([right], HaMeR(), request("left")),
        str(right),
        "no left hand",
        "is it the right hand",
    )


@pytest.mark.parametrize("key", BROKEN)
def test_what_is_wrong_is_named(tmp_path: Path, refused: Callable[..., str], key: str) -> None:
    record = BROKEN[key](hamer_record(Known("right", None), 0, "crop"))
    path = write_npz(tmp_path / "000007.npz", record)
    refused(lambda: read_tracked_hands([path], HaMeR(), request("right")), str(path), key)


def test_no_code_is_run(tmp_path: Path, mano_folder: Path, refused: Callable[..., str]) -> None:
    class Hostile:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "was-run",)

    path = tmp_path / "000007_prediction_result.pkl"
    for content in (Hostile(), {"pred_output_list": [Hostile()]}):
        path.write_bytes(pickle.dumps(content))
        refused(
            lambda: read_tracked_hands([path], FrankMocap(), request("right", mano_folder)),
            str(path),
            "nothing in it was run",
        )
    np.save(tmp_path / "j.npy", np.array([Hostile()], dtype=object), allow_pickle=True)
    refused(lambda: read_tracked_hands([tmp_path / "j.npy"], Joints("openpose"), request("right")), "j.npy")
    assert not (tmp_path / "was-run").exists()


def test_nested_and_lying_files(tmp_path: Path, mano_folder: Path, refused: Callable[..., str]) -> None:
    bomb = tmp_path / "6_8.json"
    bomb.write_text('{"init_trans":' + "[" * 100_000 + "]" * 100_000 + "}")
    refused(lambda: read_tracked_hands([bomb], HaWoR(600.0), request("right")), str(bomb))
    itself: dict[str, Any] = {}
    itself["pred_output_list"] = [itself]
    path = tmp_path / "000007.pkl"
    path.write_bytes(pickle.dumps(itself))
    refused(lambda: read_tracked_hands([path], FrankMocap(), request("right", mano_folder)), str(path))
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999, 21, 3), }".ljust(117) + b"\n"
    lying = tmp_path / "j.npy"
    lying.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 64)
    refused(lambda: read_tracked_hands([lying], Joints("openpose"), request("right")), str(lying))


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
@pytest.mark.slow
def test_damaged_files_are_refused_or_read(tmp_path: Path, mano_folder: Path, data: st.DataObject) -> None:
    """Truncated files and swapped bytes: an error of this package's that names the file, or plausible numbers."""
    known = Known("right", None)
    source, name = data.draw(
        st.sampled_from([("hamer", "000007.npz"), ("hawor", "6_8.json"), ("frankmocap", "000007.pkl")])
    )
    path = tmp_path / name
    if source == "hamer":
        write_npz(path, hamer_record(known, 0, "crop"))
    elif source == "hawor":
        path.write_text(json.dumps({"init_root_orient": known.R.tolist(), "init_hand_pose": known.pose.tolist(),
                                    "init_betas": known.betas.tolist(), "init_trans": known.t.tolist()}))  # fmt: skip
    else:
        known.vertices = known.vertices[:, :778]
        path.write_bytes(pickle.dumps(frankmocap_record(known, 0)))
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        for _ in range(data.draw(st.integers(1, 8))):
            a, b = (data.draw(st.integers(0, len(content) - 1)) for _ in range(2))
            content[a], content[b] = content[b], content[a]
    path.write_bytes(bytes(content))
    try:
        tracker = {"hamer": HaMeR(), "hawor": HaWoR(600.0), "frankmocap": FrankMocap()}[source]
        hands = read_tracked_hands([path], tracker, request("right", mano_folder if source == "frankmocap" else None))
    except InputError as error:
        assert path.name in str(error)  # noqa: PT017
    else:
        assert np.isfinite(hands.track.vertices).all()
        assert se3.is_rigid(hands.track.T_cam_hand).all()


@pytest.mark.slow
def test_small_pickles_that_are_large_in_memory(tmp_path: Path, mano_folder: Path, refused: Callable[..., str]) -> None:
    """A list that holds another twice, which holds ...; an array that has a size and no contents."""

    class Vast:
        def __reduce__(self) -> tuple[Any, ...]:
            return np.zeros(0).__reduce__()[0], (np.ndarray, (10**10,), b"d")

    twice: list[Any] = [1.0, 1.0]
    for _ in range(28):
        twice = [twice, twice]
    path = tmp_path / "000007.pkl"
    for value, words in (
        (twice, "5.37e\\+08 values"),
        (Vast(), "_reconstruct with other arguments"),
        ([[[twice] * 2] * 2], ""),
    ):
        hand = frankmocap_record(Known("right", mano_folder), 0)
        hand["pred_output_list"][0]["right_hand"]["pred_camera"] = value
        path.write_bytes(pickle.dumps(hand))
        printed = refused(lambda: read_tracked_hands([path], FrankMocap(), request("right", mano_folder)), str(path))
        assert re.search(words, printed)
