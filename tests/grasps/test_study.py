"""The study: the best hinge of known poses, what it says of synthetic grasps, and the command."""

from __future__ import annotations

import csv
import json
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.clip import FINGERS, Clip, HandTrack, Truth, write_clip
from getagrip.commands import each_clip
from getagrip.datasets.dexycb.reader import DexYcb
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.grasps.approximation import AxisRotation, _Moves, _refined, mean_rotation, pose_hinge, rotation_hinge
from getagrip.grasps.definition import Definition
from getagrip.grasps.stable import PairwiseIou
from getagrip.grasps.study import MEASURES, TIMES, Spread, fingers, kept_contact, mean_curves, study
from getagrip.view.study import INSIDE
from getagrip.view.style import AXIS, FOUND
from helpers.clips import small_clip
from helpers.paths import DATA, needs
from helpers.pictures import pixels_of, read_picture

Run = Callable[..., tuple[int, str, str]]
PosesInCamera = tuple[np.ndarray, np.ndarray]
SIZE = 0.05
AT_HAND = np.zeros(3)
seeds = st.integers(0, 10_000)


def unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def exact(
    rng: np.random.Generator, through: np.ndarray | None = None, frames: int = 20
) -> tuple[AxisRotation, PosesInCamera]:
    """A random hinge and poses on it, less than a full turn apart."""
    point = 0.1 * rng.normal(size=3) if through is None else through
    hinge = AxisRotation(se3.exp_so3(2.0 * rng.normal(size=3)), unit(rng), point, 0.1 * rng.normal(size=3), SIZE)
    return hinge, hinge.at(rng.uniform(-1.2, 1.2, frames))


def noisy(rng: np.random.Generator, noise: float) -> PosesInCamera:
    R, c = exact(rng)[1]
    return se3.exp_so3(noise * rng.normal(size=(len(R), 3))) @ R, c + noise * SIZE * rng.normal(size=c.shape)


def static_energy(R: np.ndarray, c: np.ndarray, size: float = SIZE) -> float:
    return float(np.sum((R - mean_rotation(R)) ** 2) + np.sum((c - c.mean(axis=0)) ** 2) / size**2)


def each_energy(found: PosesInCamera, true: PosesInCamera, size: float) -> np.ndarray:
    """E of each frame."""
    return np.asarray(
        np.sum((found[0] - true[0]) ** 2, axis=(1, 2)) + np.sum((found[1] - true[1]) ** 2, axis=1) / size**2
    )


# The best hinge.


@settings(max_examples=6)
@given(seeds)
@pytest.mark.slow
def test_angles_are_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, c = noisy(rng, 0.5)
    for size in (SIZE, np.inf):
        hinge = replace(exact(rng)[0], size=size)
        least = each_energy(hinge.nearest(R, c), (R, c), size)
        assert hinge.energy(R, c) == pytest.approx(least.sum())
        for angle in np.linspace(-np.pi, np.pi, 181):
            assert np.all(least <= each_energy(hinge.at(np.full(len(R), angle)), (R, c), size) + 1e-9)


@settings(max_examples=4)
@given(seeds)
@pytest.mark.slow
def test_an_exact_hinge_is_found_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for through in (None, AT_HAND):
        true, (R, c) = exact(rng, through)
        for found in (rotation_hinge(R, c), pose_hinge(R, c, SIZE, through)):
            assert np.linalg.norm(np.cross(found.direction, true.direction)) < 1e-5
            np.testing.assert_allclose(found.nearest(R, c)[0], R, atol=1e-6)
            if found.size == SIZE or through is None:
                np.testing.assert_allclose(found.nearest(R, c)[1], c, atol=1e-6)
        across = found.point - true.point
        assert np.linalg.norm(np.cross(across, true.direction)) < 1e-4


@settings(max_examples=3)
@given(seeds, st.sampled_from([0.0, 0.03, 0.3, 3.0]))
@pytest.mark.slow
def test_a_hinge_is_never_worse_than_one_pose(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    R, c = noisy(rng, noise)
    static = static_energy(R, c)
    assert rotation_hinge(R, c).energy(R, c) <= static_energy(R, c, np.inf) + 1e-9
    free = pose_hinge(R, c, SIZE).energy(R, c)
    at_hand = pose_hinge(R, c, SIZE, AT_HAND).energy(R, c)
    assert free <= at_hand + 1e-6 * static + 1e-9  # one that passes anywhere may pass there
    assert at_hand <= static + 1e-9


@settings(max_examples=10)
@given(seeds, st.sampled_from([0.03, 0.3, 3.0]))
@pytest.mark.slow
def test_no_hinge_fits_rotations_better(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    R, c = noisy(rng, noise)
    best = rotation_hinge(R, c)
    for _ in range(50):
        other = replace(best, R=se3.exp_so3(rng.normal(size=3)) @ best.R, direction=unit(rng))
        near = replace(
            best,
            R=se3.exp_so3(0.02 * rng.normal(size=3)) @ best.R,
            direction=se3.exp_so3(0.02 * rng.normal(size=3)) @ best.direction,
        )
        for hinge in (other, near):
            assert best.energy(R, c) <= hinge.energy(R, c) + 1e-9


@pytest.mark.parametrize("free", [True, False])
def test_the_gradient_is_that_of_finite_differences(free: bool) -> None:
    rng = np.random.default_rng(3)
    R, c = noisy(rng, 0.3)
    moves = _Moves.of(exact(rng)[0], free)
    x = 0.3 * rng.normal(size=11 if free else 8)

    def energy(x: np.ndarray) -> float:
        return moves.hinge(x).energy(R, c)

    hinge = moves.hinge(x)
    angles = hinge.angles(R, c)
    R_found, c_found = hinge.at(angles)
    off = np.concatenate([(R_found - R).reshape(-1, 9), (c_found - c) / SIZE], axis=1).ravel()
    steps = 1e-6 * np.eye(len(x))
    differences = [(energy(x + step) - energy(x - step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(
        2.0 * moves.jacobian(x, angles).T @ off, differences, atol=1e-6 * np.abs(differences).max()
    )


@pytest.mark.parametrize("noise", [0.05, 0.5])
@pytest.mark.parametrize("through", [None, AT_HAND], ids=["anywhere", "at the hand"])
@pytest.mark.slow
def test_random_restarts_find_no_better_hinge(noise: float, through: np.ndarray | None) -> None:
    rng = np.random.default_rng(int(100 * noise))
    R, c = noisy(rng, noise)
    best = pose_hinge(R, c, SIZE, through).energy(R, c)
    for _ in range(5):
        start = replace(exact(rng, through)[0], R=se3.exp_so3(2.0 * rng.normal(size=3)))
        assert best <= _refined(start, R, c, through, 60).energy(R, c) * (1.0 + 1e-6)


@pytest.mark.slow
def test_the_hand_frame_does_not_matter_for_an_axis_anywhere() -> None:
    rng = np.random.default_rng(0)
    R, c = noisy(rng, 0.2)
    Q, t = se3.exp_so3(rng.normal(size=3)), rng.normal(size=3)
    one, other = pose_hinge(R, c, SIZE), pose_hinge(Q @ R, c @ Q.T + t, SIZE)
    assert one.energy(R, c) == pytest.approx(other.energy(Q @ R, c @ Q.T + t), rel=1e-6)
    assert np.linalg.norm(np.cross(Q @ one.direction, other.direction)) < 1e-3


def test_poses_that_do_not_move_have_no_error() -> None:
    rng = np.random.default_rng(1)
    R, c = np.tile(se3.exp_so3(rng.normal(size=3)), (5, 1, 1)), np.tile(rng.normal(size=3), (5, 1))
    for hinge in (rotation_hinge(R, c), pose_hinge(R, c, SIZE), pose_hinge(R, c, SIZE, AT_HAND)):
        np.testing.assert_allclose(hinge.nearest(R, c)[0], R, atol=1e-6)
        np.testing.assert_allclose(hinge.nearest(R, c)[1], c, atol=1e-6)


# The measures.


def ball(radius: float) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def turning(name: str = "turning", side: str = "right") -> Clip:
    """30 frames of 50 an object turns about an axis through the hand's middle, by 1 rad; then it is off, and tumbles.

    The hand is a ball whose fingertips are five patches; the object a long thin one that it holds at one end.
    """
    rng = np.random.default_rng(0)
    hand = ball(0.03)
    mesh = ball(0.03)
    mesh = Mesh(mesh.vertices * [1.0, 0.6, 0.6] + [0.05, 0.0, 0.0], mesh.faces)
    spin = se3.rotation_about_line(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.linspace(-0.1, 0.1, 50))
    spin[30:] = se3.rigid(se3.exp_so3(rng.normal(size=(20, 3))), np.array([0.2, 0.0, 0.0]))
    T_cam_hand = se3.rigid(se3.exp_so3(0.3 * rng.normal(size=(50, 3))), np.array([0.0, 0.0, 0.6]))
    vertices = np.tile(hand.vertices, (50, 1, 1))
    regions = {finger: np.arange(10 * n, 10 * n + 8) for n, finger in enumerate((*FINGERS, "palm_edge"))}
    track = HandTrack(vertices, hand.faces, T_cam_hand, regions)
    truth = Truth(T_cam_hand @ spin, 1.0, T_cam_hand, vertices)
    clip = small_clip(50)[0]
    return replace(clip, name=name, side=side, mesh=mesh, hand=track, truth=truth)


DEFINITION = Definition(tau=0.3, contact=0.005, shortest=10)


@pytest.mark.slow
def test_a_grasp_with_known_answers() -> None:
    (found,) = study(turning(), DEFINITION)
    assert (found.clip, found.start, found.end) == ("turning", 0, 29)
    assert found.duration == pytest.approx(1.0)
    angle = np.linspace(-0.1, 0.1, 50)[:30]
    # The chordal mean of turns about one axis is the mean angle's turn, all but exactly.
    assert found.inside["static_rotation"] == pytest.approx(np.abs(angle - angle.mean()).mean(), rel=1e-3)
    assert found.turned == pytest.approx(np.ptp(angle), rel=1e-6)
    assert found.inside["contact_iou"] > 0.3
    for name in ("one_dof_rotation", "free_rotation", "free_place", "at_hand_rotation", "at_hand_place"):
        assert found.inside[name] < 1e-6
        assert found.outside[name] > 0.05
    assert found.outside["contact_iou"] == 0.0
    assert abs(found.hinge.direction[0]) == pytest.approx(1.0)
    assert found.inside["fingers_moved"] < 1e-9
    assert found.outside["fingers_turned"] < 1e-9
    curve = found.curves["static_rotation"]
    assert np.isnan(curve[TIMES < 0.0]).all()
    assert np.isfinite(curve[TIMES >= 0.0]).all()
    assert curve[np.argmin(np.abs(TIMES - 1.0))] == pytest.approx(abs(angle[-1] - angle.mean()), rel=1e-3)


@pytest.mark.slow
def test_moving_hand_and_object_together_changes_nothing() -> None:
    clip = turning()
    assert clip.truth is not None
    rng = np.random.default_rng(1)
    G = se3.rigid(se3.exp_so3(rng.normal(size=(50, 3))), rng.normal(size=(50, 3)))
    moved = replace(clip.truth, T_cam_hand=G @ clip.truth.T_cam_hand, T_cam_obj=G @ clip.truth.T_cam_obj)
    (one,), (other,) = study(clip, DEFINITION), study(replace(clip, truth=moved), DEFINITION)
    for name in MEASURES:
        assert one.inside[name] == pytest.approx(other.inside[name], abs=1e-5)


def test_fingers_that_turn_and_move_by_known_amounts() -> None:
    rng = np.random.default_rng(2)
    points = 0.01 * rng.normal(size=(12, 3))
    points -= points.mean(axis=0)
    angle = np.array([0.0, 0.0, 0.0, 0.3, -0.5])
    T = se3.rigid(se3.exp_so3(angle[:, None] * unit(rng)), np.array([0.0, 0.0, 0.0, 0.02, 0.03])[:, None] * unit(rng))
    vertices = se3.transform(T, points)
    turned, moved = fingers(vertices, [np.arange(12)] * 5, slice(0, 3))
    np.testing.assert_allclose(turned, np.abs(angle), atol=1e-6)
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.0, 0.02, 0.03], atol=1e-9)
    turned, moved = fingers(vertices, [np.arange(12), np.arange(2)], slice(0, 3))
    assert np.isnan(turned).all()
    assert np.isfinite(moved).all()


def test_contact_is_compared_with_all_other_frames_of_the_grasp() -> None:
    contact = np.random.default_rng(3).random((9, 20)) < 0.4
    found = kept_contact(PairwiseIou.of(contact), slice(1, 9), slice(3, 7))
    for n, value in zip(range(1, 9), found, strict=True):
        others = [k for k in range(3, 7) if k != n]
        ious = [np.sum(contact[n] & contact[k]) / np.sum(contact[n] | contact[k]) for k in others]
        assert value == pytest.approx(np.mean(ious))
    assert np.isnan(kept_contact(np.eye(2), slice(0, 1), slice(0, 1))).all()


@pytest.mark.slow
def test_spread_leaves_out_what_has_no_value() -> None:
    assert Spread.of([1.0, np.nan, 3.0]) == Spread(2.0, 1.0, 1.5, 2.0, 2.5, 2)
    assert Spread.of([np.nan]).grasps == 0
    grasps = study(turning(), DEFINITION)
    curves = mean_curves([*grasps, *grasps])
    assert {spread.grasps for spread in curves["contact_iou"]} == {0, 2}
    assert len(curves["contact_iou"]) == len(TIMES)


# The command.


@pytest.mark.slow
def test_all_is_written_and_printed(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_clip(turning("a"), None, tmp_path / "clips" / "a")
    write_clip(replace(turning("b", "left"), category="[bold]x"), None, tmp_path / "clips" / "b")
    away = turning("away")
    assert away.truth is not None
    far = replace(away.truth, T_cam_obj=away.truth.T_cam_obj @ se3.rigid(t=np.array([0.2, 0.0, 0.0])))
    write_clip(replace(away, truth=far), None, tmp_path / "clips" / "away")
    out, file = tmp_path / "out", tmp_path / "study.json"
    options = ("--tau", 0.3, "--contact-mm", 5, "--shortest", 10, "--workers", 1, "--out", out, "--json", file)
    status, printed, err = run("study", tmp_path / "clips", *options)
    assert (status, err) == (0, "")
    assert "2 stable grasps in 2 of 3 clips" in printed
    assert "[bold]x" in printed
    with (out / "grasps.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["sequence"], row["side"], row["start"], row["end"]) for row in rows] == [
        ("a", "right", "0", "29"),
        ("b", "left", "0", "29"),
    ]
    content = json.loads(file.read_text())
    assert [one["sequence"] for one in content["grasps"]] == ["a", "b"]
    assert content["cut"]["contact"] == pytest.approx(0.005)
    means = {
        (row["object"], row["where"], row["measure"]): row["mean"]
        for row in content["summary"]
        if row["measure"].endswith("rotation")
    }
    assert means["All", "inside", "one_dof_rotation"] < 1e-6 < means["All", "inside", "static_rotation"]
    with (out / "curves.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == len(MEASURES) * len(TIMES)
    with (out / "summary.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 3 * 2 * len(MEASURES)
    picture = read_picture(out / "study.png")
    for third in np.array_split(picture, 3, axis=1):
        for half in np.array_split(third, 2):
            assert pixels_of(half, INSIDE) > 1000  # six panels, the time of the grasp in blue
    assert pixels_of(picture, FOUND) > 200  # static
    assert pixels_of(picture, AXIS) > 200  # 1-DoF
    monkeypatch.setattr(each_clip, "in_processes", crossing)
    again = run("study", tmp_path / "clips", *options, "--workers", 2)
    assert again == (status, printed, err)  # a clip without grasps is none that failed


def crossing(work: Callable, jobs: list, _: int) -> Iterator[tuple[object, object]]:
    """What crosses to other processes and back is pickled; that these do the work is tested with ``segment``."""
    for job in jobs:
        there = pickle.loads(pickle.dumps((work, job)))
        yield job, pickle.loads(pickle.dumps(there[0](there[1])))


@pytest.mark.slow
def test_one_bad_clip_stops_no_other(run: Run, tmp_path: Path) -> None:
    write_clip(turning("good"), None, tmp_path / "good")
    write_clip(replace(turning("blind"), truth=None), None, tmp_path / "blind")
    paths = (tmp_path / "blind", tmp_path / "gone", tmp_path / "good")
    options = ("--tau", 0.3, "--contact-mm", 5, "--shortest", 10, "--out", tmp_path / "out")
    status, printed, err = run("study", *paths, *options)
    assert status == 1
    assert "1 stable grasps in 1 of 1 clips" in printed
    assert "gone: got no such folder" in err
    assert "truth.npz: got no such file" in err
    with pytest.raises(InputError, match=r"truth\.npz"):
        study(replace(turning(), truth=None))


def test_wrong_calls_exit_with_2(run: Run, tmp_path: Path) -> None:
    write_clip(turning(), None, tmp_path / "a")
    for wrong in ((), ("a", "--tau", "1"), ("a", "--contact-mm", "-1"), ("a", "--workers", "0")):
        paths = [tmp_path / word if word == "a" else word for word in wrong]
        assert run("study", *paths, "--out", tmp_path / "out")[0] == 2
    assert not (tmp_path / "out").exists()


@needs(DATA / "dexycb")
@pytest.mark.slow
def test_a_real_sequence() -> None:
    source = DexYcb(root=DATA / "dexycb", meshes=DATA / "ycb", whole=True).sources()[0]
    (track,) = source.read(lambda _: None)
    assert len(track) > 40
    assert np.all(np.diff(track.numbers) == 1)
    R = (se3.inverse(track.hand.T_cam_hand) @ track.T_cam_obj)[-25:, :3, :3]
    hinge = rotation_hinge(R, np.zeros((25, 3)))
    off = se3.angle_between(hinge.nearest(R, np.zeros((25, 3)))[0], R).mean()
    assert 0.0 < off < se3.angle_between(mean_rotation(R), R).mean()
