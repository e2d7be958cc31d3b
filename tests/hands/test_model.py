"""The generic hand and the skinning that all models share: laws, and a reference that loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.clip import FINGERS
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands import generic
from getagrip.hands.generic import (
    BONE_LENGTHS_MM,
    JOINT_GIRTHS_MM,
    MALE_TO_MEAN_SIZE,
    MANO_WRIST_M,
    half_depth,
    rest_fingers,
)
from getagrip.hands.model import (
    KNUCKLES,
    MANO_JOINTS,
    ORDER_21,
    PALM_REGIONS,
    PARENTS,
    HandModel,
    Side,
    hand_track,
    mirrored,
    mirrored_pose,
    root_transform,
)
from scripts.generic_surface import distance, gradient

SIDES: tuple[Side, Side] = ("right", "left")


def random_pose(seed: int, *batch: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=0.4, size=(*batch, 45))


def skinned_by_loops(model: HandModel, shape: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and the 16 joints, one vertex and one joint at a time (SMPL, Eq. 2-4)."""
    vertices = model.template + model.shape_directions @ shape
    joints = model.joints + model.joint_directions @ shape
    G = [np.eye(4)] * 16
    for j, parent in enumerate(PARENTS):
        local = np.eye(4)
        local[:3, 3] = joints[j] - (joints[parent] if parent >= 0 else 0.0)
        if parent >= 0:
            local[:3, :3] = se3.exp_so3(pose[3 * j - 3 : 3 * j])
            local = G[parent] @ local
        G[j] = local
    out = np.zeros_like(vertices)
    for i, x in enumerate(vertices):
        for j in range(16):
            out[i] += model.weights[i, j] * (G[j] @ np.append(x - joints[j], 1.0))[:3]
    return out, np.array([T[:3, 3] for T in G])


@pytest.mark.parametrize("side", SIDES)
def test_skinning_agrees_with_loops(side: Side) -> None:
    model = generic.load(side)
    rng = np.random.default_rng(1)
    shape, pose = 0.1 * rng.normal(size=len(model.shape_names)), random_pose(2)
    vertices, joints = skinned_by_loops(model, shape, pose)
    posed = model.with_shape(shape).with_pose(pose)
    np.testing.assert_allclose(posed.vertices, vertices, atol=1e-12)
    np.testing.assert_allclose(posed.joints[ORDER_21 < 16], joints[ORDER_21[ORDER_21 < 16]], atol=1e-12)
    np.testing.assert_allclose(posed.joints[4::4], vertices[model.tips], atol=1e-12)


def test_the_rest_pose_is_the_template() -> None:
    model = generic.load("right")
    posed = model.with_shape().with_pose()
    np.testing.assert_allclose(posed.vertices, model.template, atol=1e-15)
    np.testing.assert_array_equal(posed.joints[0], MANO_WRIST_M)


def test_batches_are_what_their_members_are() -> None:
    model = generic.load("right")
    shapes, poses = 0.1 * np.random.default_rng(3).normal(size=(2, 1, len(model.shape_names))), random_pose(4, 3)
    posed = model.with_shape(shapes).with_pose(poses)
    assert posed.vertices.shape == (2, 3, len(model.template), 3)
    one = model.with_shape(shapes[1, 0]).with_pose(poses[2])
    np.testing.assert_allclose(posed.vertices[1, 2], one.vertices, atol=1e-12)
    np.testing.assert_allclose(posed.joints[1, 2], one.joints, atol=1e-12)
    np.testing.assert_allclose(posed.normals[1, 2], one.normals, atol=1e-9)


def test_left_is_right_mirrored() -> None:
    right, left = (generic.load(side).with_shape() for side in SIDES)
    pose = random_pose(5)
    a, b = right.with_pose(pose), left.with_pose(mirrored_pose(pose))
    np.testing.assert_allclose(mirrored(a.vertices), b.vertices, atol=1e-12)
    np.testing.assert_allclose(mirrored(a.joints), b.joints, atol=1e-12)
    np.testing.assert_allclose(mirrored(a.normals), b.normals, atol=1e-9)
    assert Mesh(b.vertices, b.faces).volume > 0


def test_hand_frame() -> None:
    """Right: wrist towards +x, fingers to -x, palm to -y, thumb at +z; a positive bend closes the hand."""
    model = generic.load("right")
    joints = model.with_shape().with_pose().joints
    wrist, tips = joints[0], joints[4::4]
    assert (tips[1:, 0] < wrist[0] - 0.1).all()
    assert tips[0, 2] > tips[1, 2] > tips[2, 2] > tips[3, 2] > tips[4, 2]
    pose = np.zeros((15, 3))
    pose[[MANO_JOINTS.index(f"{finger}1") - 1 for finger in FINGERS[1:]], 2] = 1.0
    bent = model.with_shape().with_pose(pose.ravel()).joints[4::4]
    assert (bent[1:, 1] < tips[1:, 1] - 0.03).all()


@pytest.mark.parametrize("side", SIDES)
def test_generic_is_one_closed_outward_surface(side: Side) -> None:
    model = generic.load(side)
    mesh = Mesh(model.template, model.faces)
    assert 700 <= len(mesh.vertices) <= 1000
    assert mesh.is_closed
    assert mesh.volume > 0
    assert len(mesh.faces) == 2 * len(mesh.vertices) - 4  # Euler: a sphere
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)


def test_generic_file_lies_on_the_surface_of_the_sources() -> None:
    vertices = generic.load("right").template
    off = distance(vertices) / np.linalg.norm(gradient(vertices), axis=1)
    assert np.abs(off).max() < 1e-4


@pytest.mark.parametrize("finger", FINGERS)
def test_bones_have_the_published_lengths(finger: str) -> None:
    points = rest_fingers()[finger].points
    given = np.array(BONE_LENGTHS_MM[finger] if finger == "thumb" else BONE_LENGTHS_MM[finger][1:])
    lengths = 1e3 * np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(lengths, [given[0], given[1], given[2] + given[3]], atol=1e-9)


def test_reach_and_breadth_are_as_published() -> None:
    """Greiner's distances from fingertips to wrist [mm], and ANSUR II's hand breadth."""
    reach = dict(zip(FINGERS, (137.9, 185.2, 194.5, 185.0, 159.9), strict=True))
    for finger, rest in rest_fingers().items():
        assert 1e3 * np.linalg.norm(rest.points[3] - MANO_WRIST_M) == pytest.approx(
            MALE_TO_MEAN_SIZE * reach[finger], rel=0.02
        )
    vertices = generic.load("right").template
    knuckles = np.abs(vertices[:, 0] - 0.012) < 0.012
    palm = knuckles & (vertices[:, 2] < rest_fingers()["index"].points[0, 2] + 0.02)
    assert np.ptp(vertices[palm, 2]) == pytest.approx(0.085, rel=0.06)


@pytest.mark.parametrize("finger", FINGERS[1:])
def test_fingers_have_the_published_girth(finger: str) -> None:
    """Circumferences of the mesh's sections through the two joints between the phalanges."""
    import trimesh

    model, rest = generic.load("right"), rest_fingers()[finger]
    mesh = trimesh.Trimesh(model.template, model.faces, process=False)
    for k, (_, circumference) in enumerate(JOINT_GIRTHS_MM[finger]):
        joint = rest.points[k + 1]
        cuts = trimesh.intersections.mesh_plane(mesh, rest.axes[k, 0], joint)
        own = np.linalg.norm(cuts.mean(axis=1) - joint, axis=1) < 0.014
        girth = np.linalg.norm(cuts[own, 1] - cuts[own, 0], axis=1).sum()
        assert 1e3 * girth == pytest.approx(MALE_TO_MEAN_SIZE * circumference, rel=0.06)


@given(b=st.floats(10.0, 30.0), ratio=st.floats(0.7, 1.0))
def test_half_depth_inverts_the_circumference(b: float, ratio: float) -> None:
    d = ratio * b
    assert 2.0 * half_depth(b, np.pi * np.sqrt((b**2 + d**2) / 2.0)) == pytest.approx(d)


def test_regions_are_disjoint_pads_and_palms() -> None:
    model = generic.load("right")
    assert tuple(model.regions) == (*FINGERS, *PALM_REGIONS)
    every = np.concatenate(list(model.regions.values()))
    assert len(np.unique(every)) == len(every)
    assert min(len(ids) for ids in model.regions.values()) >= 12
    normals = model.with_shape().with_pose().normals
    for name in (*FINGERS[1:], *PALM_REGIONS):
        assert normals[model.regions[name], 1].mean() < -0.3, f"{name} must face the palm's side"


@pytest.mark.parametrize("n", range(5))
def test_a_finger_moves_no_other_pad(n: int) -> None:
    model = generic.load("right")
    pose = np.zeros((15, 3))
    pose[KNUCKLES[n] - 1 : KNUCKLES[n] + 2, 2] = 0.5
    moved = np.linalg.norm(model.with_shape().with_pose(pose.ravel()).vertices - model.template, axis=1)
    for k, finger in enumerate(FINGERS):
        assert (moved[model.regions[finger]] > 1e-3).all() == (k == n)
        assert k == n or moved[model.regions[finger]].max() < 1e-12


def test_bent_fingers_keep_their_volume() -> None:
    model = generic.load("right")
    for k in range(3):
        pose = np.zeros((15, 3))
        for finger, rest in rest_fingers().items():
            pose[MANO_JOINTS.index(f"{finger}{k + 1}") - 1] = (
                np.radians(30.0 if finger == "thumb" else 90.0) * rest.axes[k, 1]
            )
        bent = model.with_shape().with_pose(pose.ravel())
        assert Mesh(bent.vertices, bent.faces).volume > 0.93 * Mesh(model.template, model.faces).volume


def test_weights_are_shares() -> None:
    weights = generic.load("right").weights
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)


def test_size_scales_about_the_wrist() -> None:
    model = generic.load("right")
    shape = np.zeros(len(model.shape_names))
    shape[model.shape_names.index("size")] = 0.1
    larger = model.with_shape(shape)
    np.testing.assert_allclose(larger.vertices - MANO_WRIST_M, 1.1 * (model.template - MANO_WRIST_M), atol=1e-12)
    np.testing.assert_allclose(larger.joints - MANO_WRIST_M, 1.1 * (model.joints - MANO_WRIST_M), atol=1e-12)


@pytest.mark.parametrize("name", generic.SHAPE_PARAMETER_NAMES)
def test_every_shape_parameter_is_a_fraction(name: str) -> None:
    """The bones that a parameter names grow by that fraction, the others keep their lengths."""
    model = generic.load("right")
    shape = np.zeros(len(generic.SHAPE_PARAMETER_NAMES))
    shape[generic.SHAPE_PARAMETER_NAMES.index(name)] = 0.2
    before, after = (model.with_shape(s).with_pose().joints[1:].reshape(5, 4, 3) for s in (None, shape))
    growth = np.linalg.norm(np.diff(after, axis=1), axis=2) / np.linalg.norm(np.diff(before, axis=1), axis=2) - 1.0
    expected = np.zeros((5, 3))
    rows = {finger: n for n, finger in enumerate(FINGERS)}
    if name == "size":
        expected[:] = 0.2
    elif name.endswith("_phalanges"):
        expected[1:, ("proximal", "middle", "distal").index(name.removesuffix("_phalanges"))] = 0.2
    elif name.endswith("_length") and name != "palm_length":
        expected[rows[name.removesuffix("_length")]] = 0.2
    elif name.startswith("thumb_"):
        expected[0, ("metacarpal", "proximal", "distal").index(name.removeprefix("thumb_"))] = 0.2
    np.testing.assert_allclose(growth, expected, atol=0.02)  # the tip is a vertex of the skin, near the bone's line


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_root_transform_turns_about_the_root_joint(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, t, X = se3.exp_so3(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=(4, 3))
    np.testing.assert_allclose(
        se3.transform(root_transform(R, t, MANO_WRIST_M), X), (X - MANO_WRIST_M) @ R.T + MANO_WRIST_M + t, atol=1e-12
    )


def test_hand_track_repeats_one_hand_and_checks_many() -> None:
    model = generic.load("left")
    T = se3.rigid(se3.super_fibonacci(4))
    track = hand_track(model.with_shape().with_pose(), T)
    assert track.vertices.shape == (4, len(model.template), 3)
    assert track.joints is not None
    assert track.joints.shape == (4, 21, 3)
    with pytest.raises(UsageError, match="4 frames"):
        hand_track(model.with_shape().with_pose(random_pose(0, 3)), T)
    with pytest.raises(UsageError, match="rigid"):
        hand_track(model.with_shape().with_pose(), 2.0 * T)


def test_wrong_sizes_are_refused() -> None:
    model = generic.load("right")
    with pytest.raises(UsageError, match="shape"):
        model.with_shape(np.zeros(10))
    with pytest.raises(UsageError, match="pose"):
        model.with_shape().with_pose(np.zeros(48))
