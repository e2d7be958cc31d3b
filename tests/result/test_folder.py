"""Results: round trips, and each fault named in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.profile import N_PROFILE_RADII, Profile
from getagrip.geometry.warp import Warp
from getagrip.result import Axis, Candidates, Reconstruction, Status, is_result, read_result, write_result
from getagrip.result.findings import Probability
from getagrip.synthetic.objects import bottle

Refused = Callable[..., str]


def small_result(frames: int = 3, candidates: int = 2, hinged: bool = True, seed: int = 0) -> Reconstruction:
    """A valid result of random numbers."""
    rng = np.random.default_rng(seed)
    T = se3.rigid(
        se3.exp_so3(rng.standard_normal((candidates, frames, 3))), rng.standard_normal((candidates, frames, 3))
    )
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    return Reconstruction(
        clip="small",
        method="one-dof" if hinged else "static",
        frames=tuple(f"{n:04d}" for n in range(frames)),
        T_hand_obj=T[0],
        scale=1.25,
        iou=rng.uniform(size=frames),
        axis=Axis(rng.standard_normal(3), direction, rng.standard_normal(frames)) if hinged else None,
        candidates=Candidates(T, rng.uniform(0.5, 2.0, candidates), np.sort(rng.uniform(size=candidates))),
        energy={"total": 3.0, "mask": 2.0, "push": 1.0},
        status=Status.CONVERGED,
        ambiguous=True,
        seconds={"total": 0.5},
        options={"inits": 50},
        seed=7,
        notes=("a note",),
        hand_covariance=np.cov(rng.standard_normal((6, 20))),
        hand_alternatives=se3.rigid(se3.exp_so3(rng.standard_normal((2, 3))), rng.standard_normal((2, 3))),
        hand_energy={"hand-mask": (40.0, 30.5)},
        signs={"contact-gap": -2.5},
        probability_right=Probability(0.75, "of being right", ("contact-gap",)),
        probability_right_in_camera=Probability(0.875, "of being right"),
        probability_looks_right=Probability(0.625, "of looking right", keep=0.5),
    )


@given(frames=st.integers(1, 4), candidates=st.integers(1, 3), hinged=st.booleans(), seed=st.integers(0, 99))
@pytest.mark.slow
def test_what_is_written_is_read(tmp_path_factory: Any, frames: int, candidates: int, hinged: bool, seed: int) -> None:
    result = small_result(frames, candidates, hinged, seed)
    folder = write_result(result, tmp_path_factory.mktemp("round") / "trip", "sum", {"add": 1.5}, clip_folder="clip")
    back, record = read_result(folder)
    for name in (
        "clip",
        "method",
        "frames",
        "scale",
        "energy",
        "status",
        "message",
        "assumptions",
        "ambiguous",
        "seconds",
        "options",
        "seed",
        "notes",
        "hand_energy",
        "signs",
        "probability_right",
        "probability_right_in_camera",
        "probability_looks_right",
    ):
        assert getattr(back, name) == getattr(result, name)
    np.testing.assert_array_equal(back.T_hand_obj, result.T_hand_obj)
    np.testing.assert_array_equal(back.hand_covariance, result.hand_covariance)
    np.testing.assert_array_equal(back.hand_alternatives, result.hand_alternatives)
    np.testing.assert_array_equal(back.iou, result.iou)
    for name in ("T_hand_obj", "scale", "energy"):
        np.testing.assert_array_equal(getattr(back.candidates, name), getattr(result.candidates, name))
    assert (back.axis is None) == (result.axis is None)
    if back.axis and result.axis:
        np.testing.assert_array_equal(back.axis.point, result.axis.point)
        np.testing.assert_array_equal(back.axis.angle, result.axis.angle)
    assert record["input_sha256"] == "sum"
    assert record["metrics"] == {"add": 1.5}
    assert record["clip_folder"] == str(Path("clip").resolve())
    assert record["software"]["numpy"] == np.__version__


def test_the_object_in_the_camera_is_known_where_the_hand_is(tmp_path: Path) -> None:
    result = small_result()
    T_cam_hand = se3.rigid(se3.exp_so3(np.full((3, 3), 0.4)), np.array([0.1, 0.2, 0.9]))
    folder = write_result(replace(result, T_cam_hand=T_cam_hand), tmp_path / "result")
    expected = T_cam_hand @ result.T_hand_obj
    np.testing.assert_array_equal(np.load(folder / "result.npz")["T_cam_obj"], expected)
    np.testing.assert_array_equal(read_result(folder)[0].T_cam_obj, expected)
    np.testing.assert_array_equal(read_result(folder)[0].take(np.array([2, 0])).T_cam_obj, expected[[2, 0]])
    assert "T_cam_obj" not in np.load(write_result(result, tmp_path / "older") / "result.npz")
    with pytest.raises(UsageError, match=r"missing T_cam_hand: .*; compute clip\.hand\.T_cam_hand"):
        _ = read_result(tmp_path / "older")[0].T_cam_obj


def test_a_fitted_profile_is_kept(tmp_path: Path) -> None:
    profile = Profile.of(bottle()).widened(np.linspace(0.8, 1.3, N_PROFILE_RADII))
    result = replace(small_result(), warp=Warp.by(np.zeros(3), 0.1, np.full((9, 3), 0.01), profile))
    assert read_result(write_result(result, tmp_path / "r"))[0].warp == result.warp


def test_numbers_that_json_lacks_become_null(tmp_path: Path) -> None:
    metrics = {"nan": float("nan"), "infinite": np.inf, "count": np.int64(3)}
    _, record = read_result(write_result(small_result(), tmp_path / "r", "sum", metrics))
    assert record["metrics"] == {"nan": None, "infinite": None, "count": 3}


def test_only_results_are_overwritten_and_only_on_request(tmp_path: Path) -> None:
    folder = write_result(small_result(), tmp_path / "r", "sum")
    with pytest.raises(UsageError, match="exists already"):
        write_result(small_result(), folder, "other")
    write_result(replace(small_result(), message="again"), folder, "other", overwrite=True)
    assert read_result(folder)[0].message == "again"
    foreign = tmp_path / "mine"
    foreign.mkdir()
    (foreign / "letter.txt").write_text("dear")
    with pytest.raises(UsageError, match="exists already"):
        write_result(small_result(), foreign, "sum", overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "r"]
    assert not is_result(foreign)


def edited(folder: Path, arrays: dict[str, object], fields: dict[str, object]) -> None:
    """Set arrays and fields of a result; None removes one."""
    with np.load(folder / "result.npz") as loaded:
        changed = dict(loaded) | arrays
    np.savez(folder / "result.npz", **{key: value for key, value in changed.items() if value is not None})
    record = json.loads((folder / "result.json").read_text()) | fields
    (folder / "result.json").write_text(json.dumps({k: v for k, v in record.items() if v is not None}))


EYE = np.tile(np.eye(4), (3, 1, 1))
SEGMENT = {"state": "grasp", "first": "0000", "last": "0002"}
WARP: dict[str, object] = {
    "warp_centre": np.zeros(3),
    "warp_radius": np.array(0.1),
    "warp_coefficients": np.zeros((10, 3)),
    "profile_axis": np.zeros(2),
    "profile_ends": np.array([0.0, 0.1]),
    "profile_before": np.full(10, 0.03),
    "profile_after": np.full(10, 0.04),
}
BROKEN: dict[str, tuple[dict[str, object], dict[str, object], str]] = {
    "a warp beyond all shapes": (
        {"warp_centre": np.zeros(3), "warp_radius": np.array(0.1), "warp_coefficients": np.full((10, 3), 1e9)},
        {},
        "result.npz: warp_coefficients",
    ),
    "a profile upside down": (WARP | {"profile_ends": np.array([0.1, 0.0])}, {}, "result.npz: profile_ends"),
    "a profile of negative radii": (WARP | {"profile_after": np.full(10, -0.1)}, {}, "result.npz: profile_after"),
    "a profile of two radii": (WARP | {"profile_before": np.full(2, 0.1)}, {}, "result.npz: profile_before"),
    "a profile without its axis": (WARP | {"profile_axis": None}, {}, "result.npz: missing profile_axis"),
    "no version": ({}, {"version": None}, "result.json: version"),
    "other version": ({}, {"version": 4}, "result.json: version"),
    "no method": ({}, {"method": None}, "result.json: missing method"),
    "clip a path": ({}, {"clip": "../x"}, "result.json: clip"),
    "seed a text": ({}, {"seed": "7"}, "result.json: seed"),
    "signs texts": ({}, {"signs": {"a": "b"}}, "result.json: signs."),
    "probability a number": ({}, {"probability_right": 0.5}, "result.json: probability_right"),
    "looks a text": ({}, {"probability_looks_right": "1"}, "result.json: probability_looks_right"),
    "in camera a text": ({}, {"probability_right_in_camera": "1"}, "result.json: probability_right_in_camera"),
    "probability of 2": (
        {},
        {"probability_right": {"value": 2, "meaning": "", "beyond": []}},
        "result.json: probability_right.value",
    ),
    "energy a number": ({}, {"energy": 7}, "result.json: energy"),
    "energy of a text": ({}, {"energy": {"total": "x"}}, "result.json: energy.'total'"),
    "seconds a text": ({}, {"seconds": {"total": "x"}}, "result.json: seconds.'total'"),
    "metrics a list": ({}, {"metrics": {"iou": [1]}}, "result.json: metrics.'iou'"),
    "notes numbers": ({}, {"notes": [1]}, "result.json: notes[0]"),
    "segment of a third hand": ({}, {"segments": [SEGMENT | {"side": 7}]}, "result.json: segments[0].side"),
    "segment's IOU a text": ({}, {"segments": [SEGMENT | {"iou": "z"}]}, "result.json: segments[0].'iou'"),
    "segment's checks a list": ({}, {"segments": [SEGMENT | {"checks": [1]}]}, "result.json: segments[0].checks"),
    "segment's pose short": ({}, {"segments": [SEGMENT | {"T_world_obj": [[1]]}]}, "segments[0].T_world_obj"),
    "segment's pose too far": (
        {},
        {"segments": [SEGMENT | {"T_world_obj": [[1, 0, 0, 1e300], *np.eye(4).tolist()[1:]]}]},
        "segments[0].T_world_obj",
    ),
    "no poses": ({"T_hand_obj": None}, {}, "result.npz: missing T_hand_obj"),
    "poses short": ({"T_hand_obj": EYE[:2]}, {}, "result.npz: T_hand_obj"),
    "poses not rigid": ({"T_hand_obj": 2 * EYE}, {}, "result.npz: T_hand_obj"),
    "poses too far": ({"T_hand_obj": se3.rigid(EYE[:, :3, :3], np.full((3, 3), 1e300))}, {}, "result.npz: T_hand_obj"),
    "poses NaN": ({"T_hand_obj": np.nan * EYE}, {}, "result.npz: T_hand_obj"),
    "scale negative": ({"scale": np.array(-1.0)}, {}, "result.npz: scale"),
    "scale of nothing": ({"scale": np.array(1e-300)}, {}, "result.npz: scale"),
    "scale of a world": ({"scale": np.array(1e300)}, {}, "result.npz: scale"),
    "candidate too large": ({"candidate_scale": np.full(2, 1e50)}, {}, "result.npz: candidate_scale"),
    "a frame twice": ({"frames": np.array(["0000", "0001", "0000"])}, {}, "result.npz: frames"),
    "iou above one": ({"iou": np.full(3, 1e300)}, {}, "result.npz: iou"),
    "frames numbers": ({"frames": np.arange(3)}, {}, "result.npz: frames"),
    "frames objects": ({"frames": np.array(["a", None, "b"])}, {}, "result.npz: frames"),
    "no frames": ({"frames": None}, {}, "result.npz: frames"),
    "iou long": ({"iou": np.ones(4)}, {}, "result.npz: iou"),
    "covariance short": ({"hand_covariance": np.eye(3)}, {}, "result.npz: hand_covariance"),
    "alternatives scaled": ({"hand_alternatives": 2 * EYE}, {}, "result.npz: hand_alternatives"),
    "hand's energy single": ({}, {"hand_energy": {"hand-mask": 3.0}}, "result.json: hand_energy."),
    "hand's energy texts": ({}, {"hand_energy": {"hand-mask": ["a", 1]}}, "result.json: hand_energy."),
    "no axis": ({"axis_point": None}, {}, "result.npz: missing axis_point"),
    "axis long": ({"axis_direction": np.ones(3)}, {}, "result.npz: axis_direction"),
    "no angle": ({"angle": None}, {}, "result.npz: missing angle"),
    "candidates short": ({"candidate_scale": np.ones(1)}, {}, "result.npz: candidate_scale"),
    "no candidates": ({"candidate_energy": None}, {}, "result.npz: candidate"),
    "candidates not rigid": ({"candidate_T_hand_obj": np.ones((2, 3, 4, 4))}, {}, "result.npz: candidate_T_hand_obj"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_each_fault_is_named_in_one_line(tmp_path: Path, refused: Refused, case: str) -> None:
    arrays, fields, culprit = BROKEN[case]
    folder = write_result(small_result(), tmp_path / "r", "sum")
    edited(folder, arrays, fields)
    refused(lambda: read_result(folder), culprit)


def test_older_results_lack_a_probability(tmp_path: Path) -> None:
    folder = write_result(small_result(), tmp_path / "r", "sum")
    edited(folder, {}, {"probability_right_in_camera": None})
    result, _ = read_result(folder)
    assert [*result.probabilities] == ["in the hand"]


@pytest.mark.parametrize("file", ["result.json", "result.npz"])
def test_missing_files(tmp_path: Path, refused: Refused, file: str) -> None:
    folder = write_result(small_result(), tmp_path / "r", "sum")
    (folder / file).unlink()
    refused(lambda: read_result(folder), file, "no such file")
    refused(lambda: read_result(tmp_path / "none"), "none", "no such folder")


@pytest.fixture(scope="module")
def damaged_folder(tmp_path_factory: Any) -> Path:
    return write_result(small_result(), tmp_path_factory.mktemp("damaged") / "r", "sum")


@pytest.mark.parametrize("file", ["result.json", "result.npz"])
@given(data=st.data())
@pytest.mark.slow
def test_a_damaged_file_is_an_input_error_or_still_valid(damaged_folder: Path, file: str, data: st.DataObject) -> None:
    whole = (damaged_folder / file).read_bytes()
    broken = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        broken[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    (damaged_folder / file).write_bytes(broken[: data.draw(st.integers(0, len(whole)) | st.just(len(whole)))])
    try:
        with suppress(InputError):
            read_result(damaged_folder)
    finally:
        (damaged_folder / file).write_bytes(whole)
