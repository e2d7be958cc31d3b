"""Initial poses: place and scale of uniform rotations, and prior poses from files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import FINGERS, Clip, Masks, with_masks
from getagrip.errors import InputError, UsageError
from getagrip.fitting.methods.all_frames import make_initial_poses
from getagrip.fitting.methods.homan import object_tracks
from getagrip.fitting.options import Init, Options, PriorsFile
from getagrip.fitting.problem import prepare_problem
from getagrip.fitting.solver import initial_poses as priors
from getagrip.fitting.solver.cluster_poses import LearntGrasps, PosePriors, true_grasp_pose
from getagrip.fitting.solver.initial_poses import (
    grip_point,
    initial_poses,
    read_initial_poses,
    read_learnt,
    read_priors_folder,
)
from getagrip.fitting.stages.confidence import uncalibrated_reason
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.io.terminal import format_count
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import small_clip
from helpers.environment import DATA, needs
from helpers.measures import held, old_file, rotations


@pytest.fixture(scope="module")
def made() -> tuple[Clip, Masks]:
    return synthesise("can", 0, SceneOptions(frames=6, scale="free"))


def grip(clip: Clip) -> np.ndarray:
    """The mean of the fingertips' contact regions, in the hand frame."""
    return np.mean([clip.hand.vertices[:, clip.hand.regions[name]].mean(axis=(0, 1)) for name in FINGERS], axis=0)


def projected(clip: Clip, point: np.ndarray) -> np.ndarray:
    """Where a point of the hand frame is in each image [px]."""
    at = se3.transform(clip.hand.T_cam_hand, point[None, None])[:, 0]
    return np.array([project(K, x[None])[0] for K, x in zip(clip.K, at, strict=True)])


@pytest.mark.slow
def test_rays_through_the_grip_itself_give_the_grip(made: tuple[Clip, Masks]) -> None:
    clip = made[0]
    np.testing.assert_allclose(grip_point(clip.hand, clip.K, projected(clip, grip(clip))), grip(clip), atol=1e-9)


def test_rays_pull_the_point_off_the_grip_but_not_all_the_way(made: tuple[Clip, Masks]) -> None:
    clip = made[0]
    target = grip(clip) + np.array([0.0, -0.05, 0.02])
    uv = projected(clip, target)
    start, found, end = (projected(clip, x) for x in (grip(clip), grip_point(clip.hand, clip.K, uv), target))
    assert np.all(np.linalg.norm(found - end, axis=1) < 0.25 * np.linalg.norm(start - end, axis=1))
    assert np.all(np.linalg.norm(found - end, axis=1) > 0.0)


def test_the_camera_frame_does_not_matter(made: tuple[Clip, Masks]) -> None:
    clip = made[0]
    uv = projected(clip, grip(clip) + 0.03)
    about_the_eye = se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 0.4])))
    R = about_the_eye[:2, :2]
    turned = replace(clip, hand=replace(clip.hand, T_cam_hand=about_the_eye @ clip.hand.T_cam_hand))
    centre = clip.K[:, :2, 2]
    np.testing.assert_allclose(
        grip_point(turned.hand, turned.K, (uv - centre) @ R.T + centre), grip_point(clip.hand, clip.K, uv), atol=1e-9
    )


def test_a_free_scale_gives_the_same_size_for_any_unit_of_the_mesh(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    assert clip.truth is not None
    doubled = replace(clip, mesh=replace(clip.mesh, vertices=2.0 * clip.mesh.vertices))
    one, other = (np.exp(initial_poses(c, masks, 3).log_scale) for c in (clip, doubled))
    np.testing.assert_allclose(one, 2.0 * other)
    assert np.all(np.abs(np.log(one / clip.truth.scale)) < np.log(1.5))


@pytest.mark.slow
def test_rotations_are_nearly_uniform(made: tuple[Clip, Masks]) -> None:
    for seed in (0, 7):
        R = initial_poses(*made, 400, seed).R
        np.testing.assert_allclose(R.mean(axis=0), 0.0, atol=0.02)
        angles = se3.angle_between(R[:, None], R[None]) + 10.0 * np.eye(400)
        assert angles.min(axis=1).max() < 2.5 * angles.min(axis=1).min()


REAL = DATA / "epic" / "pose_priors"


def poses_file(path: Path, *clips: Clip) -> Options:
    """Options that start from the poses learnt from some clips."""
    LearntGrasps(tuple(true_grasp_pose(clip) for clip in clips), k=10).write(path)
    return Options(init="clusters", priors=PriorsFile(path), inits=12)


def test_a_file_holds_what_was_learnt(tmp_path: Path) -> None:
    learnt = LearntGrasps(
        (true_grasp_pose(held("a", "Ann")), true_grasp_pose(held("b", "", 1, "mug"))), k=3, way="axis-angle", seed=7
    )
    learnt.write(tmp_path / "poses.npz")
    again = read_learnt(tmp_path / "poses.npz")
    assert isinstance(again, LearntGrasps)
    assert (again.k, again.way, again.seed) == (3, "axis-angle", 7)
    assert [(h.category, h.side, h.clip, h.subject) for h in again.holds] == [
        ("box", "right", "a", "Ann"), ("mug", "right", "b", ""),
    ]  # fmt: skip
    assert np.array_equal(again.poses().T_hand_obj, learnt.poses().T_hand_obj)


def test_one_file_gives_everybody_what_was_learnt_from_others(tmp_path: Path) -> None:
    """Leave one subject out, in one run: as if each had been left out of a file of their own."""
    clips = [held(name, subject, n) for n, (name, subject) in enumerate(zip("abcdef", "AABBC_", strict=True))]
    clips[-1] = replace(clips[-1], provenance={})
    options = poses_file(tmp_path / "all.npz", *clips)
    for clip in (*clips, held("new", "B"), held("new", "D"), held("a")):
        subject = clip.provenance.get("subject")
        others = [c for c in clips if c.name != clip.name and (not subject or c.provenance.get("subject") != subject)]
        own = poses_file(tmp_path / "own.npz", *others)
        poses, (note,) = read_initial_poses(clip, options)
        assert np.array_equal(poses, read_initial_poses(replace(clip, name="x", provenance={}), own)[0])
        assert note.startswith(f"started from {len(others)} poses of all.npz")
        left_out = len(clips) - len(others)
        assert (f"without {format_count(left_out, 'grasp')} of its own subject" in note) == (left_out > 0)
    alone = poses_file(tmp_path / "alone.npz", clips[0])
    assert read_initial_poses(clips[0], alone)[1][0].endswith(
        "has no poses of box in a right hand: 12 uniform rotations"
    )


def test_a_file_of_the_first_version_is_refused_for_own_grasps(tmp_path: Path, refused: Callable[..., str]) -> None:
    options = old_file(tmp_path / "poses.npz", held("a", "Ann"), held("b", "Bob", 1), held("c", "", 2))
    refused(lambda: read_initial_poses(held("a"), options), "poses.npz: clips", "from a itself")
    refused(
        lambda: read_initial_poses(held("d", "Bob"), options), "poses.npz: subjects", "hands of Bob", "--leave-out Bob"
    )
    for clip in (held("d"), held("d", "Cid")):
        poses, notes = read_initial_poses(clip, options)
        assert len(poses) == 3
        assert notes == ("started from 3 poses of poses.npz, and 9 uniform rotations",)


def test_an_object_without_poses_starts_from_uniform_rotations_and_the_result_says_so(tmp_path: Path) -> None:
    options = poses_file(tmp_path / "poses.npz", held("a", "Ann"))
    clip, masks = replace(held("b", "Bob"), side="left"), small_clip()[1]
    problem = prepare_problem(with_masks(clip, masks), options)
    assert "poses.npz has no poses of box in a left hand: 12 uniform rotations" in problem.notes
    starts = initial_poses(clip, masks, 12, 0, problem.prior_poses)
    assert np.array_equal(starts.R, initial_poses(clip, masks, 12).R)


def test_prior_poses_come_first_then_uniform_rotations() -> None:
    clip, masks = small_clip()
    clip = replace(clip, mesh=Mesh(clip.mesh.vertices + np.array([0.0, 0.1, 0.0]), clip.mesh.faces))
    poses = se3.rigid(rotations(3), np.array([0.01, 0.02, 0.03]))
    starts = initial_poses(clip, masks, 8, 5, poses)
    even = initial_poses(clip, masks, 5, 5)
    assert np.array_equal(starts.R[:3], poses[:, :3, :3])
    assert np.allclose(starts.centre[:3], se3.transform(poses, clip.mesh.centre[None])[:, 0])
    assert np.array_equal(starts.R[3:], even.R)
    assert np.array_equal(starts.centre[3:], even.centre)
    assert np.array_equal(initial_poses(clip, masks, 2, 5, poses).R, poses[:2, :3, :3])


@pytest.mark.slow
def test_prior_poses_may_be_used_alone(tmp_path: Path, refused: Callable[..., str]) -> None:
    """At most as many as ``inits``, and no uniform ones; an object without any is an error, not a uniform search."""
    filled = poses_file(tmp_path / "poses.npz", held("a", "Ann"), held("b", "Bob", 1))
    assert filled.priors is not None
    alone = replace(filled, priors_only=True, method="static")
    problem = prepare_problem(with_masks(held("c"), small_clip()[1]), alone)
    assert "started from 2 poses of poses.npz, and no others" in problem.notes
    assert problem.inits == 2
    for start in (make_initial_poses(problem), object_tracks(problem)[0]):
        assert start.log_scale.shape == (2,)
    assert np.array_equal(make_initial_poses(problem).R, read_initial_poses(held("c"), filled)[0][:, :3, :3])
    assert prepare_problem(with_masks(held("c"), small_clip()[1]), replace(alone, inits=1)).inits == 1
    refused(
        lambda: read_initial_poses(replace(held("c"), side="left"), alone), "no poses of box in a left hand", "some"
    )
    apart = replace(alone, priors=poses_file(tmp_path / "own.npz", held("a", "Ann")).priors, method="one-dof")
    refused(lambda: read_initial_poses(held("d", "Ann"), apart), "own.npz", "without 1 grasp of its own subject")
    assert "without uniform rotations" in uncalibrated_reason(replace(alone, method="soft-hinge", inits=50), ())


def test_a_file_that_has_changed_since_it_was_named_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = tmp_path / "poses.npz"
    options = poses_file(path, held("a"))
    poses_file(path, held("b", seed=3))
    refused(lambda: read_initial_poses(held("c"), options), "has changed since")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": np.array(7)}, ("version", "7")),
        ({"version": np.array([1, 1])}, ("version",)),
        ({"T_hand_obj": np.zeros((1, 4, 4))}, ("T_hand_obj", "no rigid motion")),
        ({"T_hand_obj": np.full((1, 4, 4), np.nan)}, ("T_hand_obj", "NaN")),
        ({"T_hand_obj": np.eye(4)}, ("T_hand_obj", "shape")),
        ({"T_hand_obj": se3.rigid(t=np.array([[30.0, 5.0, 0.0]]))}, ("T_hand_obj", "millimetres")),
        ({"category": np.array(["box", "mug"])}, ("category", "2 names")),
        ({"side": np.array([1])}, ("side", "no array of names")),
        ({"subjects": np.array([{}])}, ("subjects", "Python objects")),
        ({"clips": None}, ("clips", "no array of names")),
    ],
)
def test_damaged_files_are_refused(
    tmp_path: Path, refused: Callable[..., str], change: dict[str, ndarray | None], words: tuple[str, ...]
) -> None:
    path = tmp_path / "poses.npz"
    old_file(path, held("a"))
    with np.load(path) as content:
        changed = {**content, **change}
    np.savez(path, **{key: value for key, value in changed.items() if value is not None})  # type: ignore[arg-type]
    refused(lambda: read_learnt(path), str(path), *words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": np.array(3)}, ("version", "1 or 2")),
        ({"k": np.array(10**6)}, ("k must", "1 to 1000")),
        ({"seed": np.array(-1)}, ("seed",)),
        ({"way": np.array("slow")}, ("way", "geodesic")),
        ({"R": np.zeros((1, 3, 3))}, ("R must", "no rigid motion")),
        ({"centre": np.array([[900.0, 0.0, 0.0]])}, ("centre", "millimetres")),
        ({"mesh_centre": np.zeros((2, 3))}, ("mesh_centre", "shape")),
        ({"subjects": np.array(["A", "B"])}, ("subjects", "2 names")),
        ({"clips": None}, ("clips", "no array of names")),
    ],
)
def test_damaged_files_of_grasps_are_refused(
    tmp_path: Path, refused: Callable[..., str], change: dict[str, ndarray | None], words: tuple[str, ...]
) -> None:
    path = tmp_path / "poses.npz"
    poses_file(path, held("a"))
    with np.load(path) as content:
        changed = {**content, **change}
    np.savez(path, **{key: value for key, value in changed.items() if value is not None})  # type: ignore[arg-type]
    refused(lambda: read_learnt(path), str(path), *words)


def test_a_folder_of_poses_by_category_and_side_is_read(tmp_path: Path, refused: Callable[..., str]) -> None:
    T = se3.rigid(rotations(3), np.array([0.1, 0.0, 0.05]))
    (tmp_path / "mug").mkdir()
    for name, matrix in zip(("left_a", "right_b", "right_c"), T, strict=True):
        np.save(tmp_path / "mug" / f"{name}.npy", matrix)
    read = read_priors_folder(tmp_path)
    assert np.allclose(read.of("mug", "right"), T[1:])
    assert np.allclose(read.of("mug", "left"), T[:1])
    scaled = T[0] @ np.diag([0.7, 0.7, 0.7, 1.0])
    np.save(tmp_path / "mug" / "left_a.npy", scaled)
    assert np.allclose(read_priors_folder(tmp_path).of("mug", "left"), T[:1])
    options = Options(init="priors", priors=PriorsFile(tmp_path))
    clip = replace(held("x", category="mug"), side="left")
    assert "does not say what they were learnt from" in read_initial_poses(clip, options)[1][0]
    for bad, words in (
        (np.diag([1.0, 1.0, -1.0, 1.0]), ("no rigid motion",)),
        (np.eye(3), ("shape",)),
        (np.array([[{}]]), ("Python objects",)),
    ):
        np.save(tmp_path / "mug" / "left_a.npy", bad)
        refused(lambda: read_priors_folder(tmp_path), "left_a.npy", *words)


def test_poses_learnt_are_written_as_a_folder(tmp_path: Path) -> None:
    clips = [held(name, "Ann", n, "mug" if n % 2 else "box") for n, name in enumerate("abcdef")]
    learnt = LearntGrasps(tuple(true_grasp_pose(clip) for clip in clips)).poses()
    learnt.write(tmp_path / "poses")
    assert sorted(path.name for path in (tmp_path / "poses" / "mug").iterdir()) == [
        "right_000.npy", "right_001.npy", "right_002.npy",
    ]  # fmt: skip
    again = read_priors_folder(tmp_path / "poses")
    for category in ("box", "mug"):
        np.testing.assert_allclose(again.of(category, "right"), learnt.of(category, "right"), atol=1e-12)
    for category, folder in (("box", "poses"), ("../mug", "other")):
        with pytest.raises(UsageError, match=folder):
            PosePriors((category,), ("left",), learnt.T_hand_obj[:1]).write(tmp_path / folder)
    assert not (tmp_path / "other").exists()


@needs(REAL)
def test_the_authors_poses_are_read() -> None:
    read = read_priors_folder(REAL)
    assert (len(read.side), read.side.count("left")) == (74, 38)
    assert len(read.of("mug", "right")) == 5


@pytest.mark.parametrize("init", ["uniform", "clusters", "priors"])
def test_starts_without_their_file_and_files_without_use_are_wrong(init: Init) -> None:
    file = PriorsFile(Path("poses"), "") if init == "uniform" else None
    with pytest.raises(UsageError, match="--priors"):
        Options(init=init, priors=file)


@pytest.mark.parametrize("init", ["clusters", "priors"])
def test_missing_files_are_named(tmp_path: Path, refused: Callable[..., str], init: Init) -> None:
    refused(lambda: priors.priors_checksum(tmp_path / "nothing", init), "nothing")


def test_an_empty_list_of_poses_is_no_file_of_poses(tmp_path: Path) -> None:
    np.savez(tmp_path / "poses.npz", version=np.array(1), T_hand_obj=np.zeros((0, 4, 4)))
    with pytest.raises(InputError):
        read_learnt(tmp_path / "poses.npz")
