"""Trackers' files to a clip's hand: frames by name, choice of a hand, checks of joints; hostile files are refused."""

from __future__ import annotations

import gzip
import json
import pickle
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.clip.match_frames import frame_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.model import SIDE_MIRROR
from getagrip.provenance import estimated
from getagrip.readers.trackers import read_tracked_hands, records
from getagrip.readers.trackers.estimates import Camera, Estimate, HandParameters, Request, WeakPerspective
from getagrip.readers.trackers.frankmocap import FrankMocap
from getagrip.readers.trackers.hamer import HaMeR
from getagrip.readers.trackers.hawor import HaWoR
from getagrip.readers.trackers.joints import Joints
from getagrip.readers.trackers.read_hands import check_before_camera, choose_frame_hands, reorder_joints
from helpers.hand_files import (
    SIDES,
    SIZE,
    K,
    Known,
    cam_crop_to_full,
    frankmocap_record,
    hamer_record,
    joints_of,
    request,
    write_npz,
)

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


SHAPE = np.random.default_rng(0).uniform(-0.06, 0.06, (21, 3))
FRAMES = tuple(f"{n:06d}" for n in range(1, 7))
HELD, OTHER = [np.stack([x + 0.01 * np.arange(6), np.zeros(6), np.full(6, z)], 1) for x, z in ((-0.1, 0.5), (0.2, 0.6))]


def hand(frame: int, at: ndarray) -> Estimate:
    return Estimate(Path("x"), frame, estimated(""), None, SHAPE + at)


def masked_request(masks: tuple[Path | None, ...] = ()) -> Request:
    return Request("right", FRAMES, np.tile(K, (6, 1, 1)), SIZE, hand_masks=masks)


def chosen(hands: list[Estimate], masks: tuple[Path | None, ...] = ()) -> tuple[ndarray, str]:
    """Where the chosen hands are, and how they were."""
    found, how = choose_frame_hands(hands, masked_request(masks))
    assert [each.frame for each in found] == sorted({each.frame for each in hands})
    return np.array([each.joints.mean(axis=0) - SHAPE.mean(axis=0) for each in found if each.joints is not None]), str(
        how or ""
    )


def test_one_hand_in_each_frame_is_no_choice() -> None:
    at, how = chosen([hand(n, HELD[n]) for n in (3, 0, 1)])
    np.testing.assert_allclose(at, HELD[[0, 1, 3]])
    assert how == ""


@pytest.mark.parametrize("alone", [[0], [5], [2], [0, 5]])
@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_nearest_to_that_of_frames_with_one(alone: list[int], seed: int) -> None:
    hands = [hand(n, HELD[n]) for n in range(6)] + [hand(n, OTHER[n]) for n in range(6) if n not in alone]
    at, how = chosen([hands[n] for n in np.random.default_rng(seed).permutation(len(hands))])
    np.testing.assert_allclose(at, HELD)
    assert f"several right hands in {6 - len(alone)} of 6 frames" in how
    assert "guess" in how


@pytest.mark.parametrize("larger", [0, 1])
def test_of_two_in_every_frame_the_larger_in_the_images_is_followed(larger: int) -> None:
    tracks = [HELD.copy(), OTHER.copy()]
    tracks[larger][:, 2] = 0.35
    both = [hand(n, tracks[row][n]) for n in range(6) for row in ((0, 1) if n % 2 else (1, 0))]
    at, how = chosen(both)
    np.testing.assert_allclose(at, tracks[larger])
    assert "the largest in the images" in how


def test_the_hands_mask_tells_first(tmp_path: Path) -> None:
    """In the frames whose mask shows it; from these on, the nearest."""
    masks: list[Path | None] = []
    for n in range(6):
        image = np.zeros(SIZE[::-1], np.uint8)
        u, v = (K @ OTHER[n])[:2] / OTHER[n][2]
        if n == 3:
            cv2.circle(image, (round(u), round(v)), 60, 255, -1)
        masks.append(tmp_path / f"{n}.png" if n > 1 else None)
        cv2.imwrite(str(tmp_path / f"{n}.png"), image)
    at, how = chosen([hand(n, track[n]) for n in range(6) for track in (HELD, OTHER)], tuple(masks))
    np.testing.assert_allclose(at, OTHER)
    assert "by the hand's mask in 1, the nearest to the hand of the frame before or after in 5" in how


def test_hands_without_joints_are_placed_by_their_pose() -> None:
    def of_mano(frame: int, at: ndarray) -> Estimate:
        return Estimate(Path("x"), frame, estimated(""), HandParameters(np.eye(3), np.zeros(45), np.zeros(10), at))

    hands = [of_mano(0, HELD[0]), of_mano(1, OTHER[1]), of_mano(1, HELD[1])]
    found, _ = choose_frame_hands(hands, masked_request())
    assert [each.mano.t.tolist() for each in found if each.mano is not None] == HELD[:2].tolist()


PATH = Path("j.npz")
HAND = generic.load("right").with_shape().with_pose(np.zeros(45))
JOINTS = np.tile(np.reshape(HAND.joints, (1, 21, 3)) + np.array([0.0, 0.0, 0.6]), (3, 1, 1))
HO3D = np.argsort(JOINT_ORDERS["ho3d"])


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.015])
def test_the_order_that_fits_is_named(noise: float) -> None:
    """Noise alone is no reason to refuse joints."""
    joints = JOINTS + np.random.default_rng(0).normal(scale=noise, size=JOINTS.shape)
    assert reorder_joints(PATH, joints, "openpose", "right") == (pytest.approx(joints), "", "")
    with pytest.raises(InputError, match="--order ho3d fits"):
        reorder_joints(PATH, joints[:, HO3D], "openpose", "right")
    with pytest.raises(InputError, match="--order openpose fits"):
        reorder_joints(PATH, joints, "ho3d", "right")


@pytest.mark.parametrize("side", SIDES)
def test_order_auto(tmp_path: Path, side: str) -> None:
    known = Known(side, None)  # type: ignore[arg-type]
    for order, joints in (("openpose", known.joints), ("ho3d", known.joints[:, HO3D])):
        path = write_npz(tmp_path / "j.npz", {"joints": joints})
        hands = read_tracked_hands([path], Joints("auto"), request(side))  # type: ignore[arg-type]
        assert np.abs(joints_of(hands) - known.joints).max() < 0.01
        assert f"order {order}, a guess" in str(hands.provenance["hands_scale"])
    write_npz(path, {"joints": known.joints[:, np.random.default_rng(0).permutation(21)]})
    with pytest.raises(InputError, match="must be one order that fits"):
        read_tracked_hands([path], Joints("auto"), request(side))  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="openpose, ho3d or auto"):
        read_tracked_hands([path], Joints(), request(side))  # type: ignore[arg-type]


@pytest.mark.parametrize("axis", range(3))
def test_mirrored_joints_are_said_to_be_the_other_hands(axis: int) -> None:
    centre = JOINTS.mean(axis=1, keepdims=True)
    turned = (JOINTS - centre) * np.roll(SIDE_MIRROR, axis) + centre
    with pytest.raises(InputError, match=r"a left hand fits, .*: are they the other hand's, or mirrored"):
        reorder_joints(PATH, turned, "openpose", "right")
    with pytest.raises(InputError, match="a left hand in --order openpose fits"):
        reorder_joints(PATH, turned, "ho3d", "right")
    noisy = turned + np.random.default_rng(0).normal(scale=0.005, size=turned.shape)
    assert "a left hand fits" in reorder_joints(PATH, noisy, "openpose", "right").warning


def test_joints_that_fit_no_hand_are_flagged(tmp_path: Path) -> None:
    known = Known("right", None)
    path = write_npz(tmp_path / "j.npz", {"joints": known.joints})
    assert read_tracked_hands([path], Joints("openpose"), request("right")).warnings == ()
    swapped = known.joints.copy()
    swapped[:, [4, 20]] = swapped[:, [20, 4]]
    write_npz(path, {"joints": swapped})
    assert "mm off every pose of a hand" in read_tracked_hands([path], Joints("openpose"), request("right")).warnings[0]


@pytest.mark.parametrize("about", [[0], [9], range(21)])
def test_joints_relative_to_the_hand_are_refused(about: list[int]) -> None:
    check_before_camera(PATH, JOINTS)
    ahead = JOINTS[..., [2, 0, 1]]  # fingers that point away from the camera
    for joints in (JOINTS, ahead, -ahead):
        with pytest.raises(InputError, match="relative to the wrist"):
            check_before_camera(PATH, joints - joints[:, about].mean(axis=1, keepdims=True))


def test_a_dump_of_joblib_is_named(tmp_path: Path) -> None:
    path = tmp_path / "world.pth"
    named = b"\x80\x04\x8c\x13joblib.numpy_pickle\x94."
    for content in (named, zlib.compress(named), gzip.compress(named)):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"joblib\.load"):
            records.read_tracker_record(path)


def test_weak_perspective_keeps_the_projection() -> None:
    """Whatever the focal lengths, the hand's origin stays in its pixel, and its size in pixels the same."""
    rng = np.random.default_rng(0)
    K2 = np.array([[500.0, 0.0, 300.0], [0.0, 505.0, 260.0], [0.0, 0.0, 1.0]])
    for _ in range(20):
        centre, side = rng.uniform(100, 500, 2), rng.uniform(50, 400)
        cam = np.array([rng.uniform(0.5, 10), *rng.normal(scale=0.1, size=2)])
        weak = WeakPerspective.of_crop(centre, side, cam)
        t = weak.before(Camera(K2, SIZE))
        np.testing.assert_allclose(project(K2, t[None])[0], centre + side * cam[0] / 2 * cam[1:])
        np.testing.assert_allclose(K2[0, 0] / t[2], side * cam[0] / 2)
        full = cam_crop_to_full(cam, centre, side, SIZE, 1234.0)
        other = WeakPerspective.of_translation(full, 1234.0, np.array(SIZE) / 2.0)
        np.testing.assert_allclose(other.origin, weak.origin, rtol=1e-6)
        np.testing.assert_allclose(other.pixels_per_metre, weak.pixels_per_metre, rtol=1e-6)
