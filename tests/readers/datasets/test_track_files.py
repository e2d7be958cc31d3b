"""Tracks in this package's own layout: what is written is read, in either order of joints, with or without camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.model import Side
from getagrip.readers.datasets import cutting
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.track_files import Tracks
from getagrip.readers.datasets.tracks import Track
from helpers.motion_capture_files import BOTTOM, JOINT_FRAMES, TAKEN, content, recording, write


def read(file: Path) -> list[Track]:
    (source,) = Tracks(root=file).sources()
    return list(source.read(lambda _: None))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.slow
def test_the_object_is_where_it_is_in_the_hand(tmp_path: Path, side: Side) -> None:
    changes = {"joints_right": None} if side == "left" else {}
    (track,) = read(write(tmp_path, **{**changes, **content(side)}))
    of = recording(side)
    assert (track.side, track.fps, track.other_hand) == (side, 25.0, None)
    assert track.name == f"ann--box-1--box--{side}"
    found, true = se3.inverse(track.hand.T_cam_hand) @ track.T_cam_obj, se3.inverse(of.T_world_hand) @ of.T_world_obj
    np.testing.assert_allclose(found[:, :3, 3], true[:, :3, 3], atol=5e-3)
    joints = se3.transform(track.hand.T_cam_hand, track.hand.joints)
    apart = np.linalg.norm(
        joints - se3.transform(track.T_cam_obj @ se3.inverse(of.T_world_obj), of.joints[side]), axis=-1
    )
    assert np.sqrt(np.mean(apart**2)) < 2e-3


@pytest.mark.slow
def test_the_order_of_the_joints_is_as_stated(tmp_path: Path) -> None:
    as_ho3d = recording().joints["right"][:, np.argsort(JOINT_ORDERS["ho3d"])]
    (ours,) = read(write(tmp_path))
    (theirs,) = read(write(tmp_path, order="ho3d", joints_right=as_ho3d))
    np.testing.assert_array_equal(ours.hand.vertices, theirs.hand.vertices)


@pytest.mark.slow
def test_an_assumed_camera_sees_hand_and_object_upright_and_is_called_a_guess(tmp_path: Path) -> None:
    (track,) = read(write(tmp_path))
    of = recording()
    T_cam_world = track.T_cam_obj @ se3.inverse(of.T_world_obj)
    np.testing.assert_allclose(T_cam_world, np.tile(T_cam_world[0], (JOINT_FRAMES, 1, 1)), atol=1e-9)
    assert T_cam_world[0, 1, 2] < 0  # up is up in the image
    uv = track.T_cam_obj[:, :3, 3] @ track.K.T
    uv = uv[:, :2] / uv[:, 2:]
    assert np.all((uv > 0) & (uv < track.size))
    assert "a guess" in str(track.provenance["camera"])


@pytest.mark.slow
def test_a_camera_that_is_given_is_taken(tmp_path: Path) -> None:
    K, T_cam_world = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]), np.eye(4)
    (track,) = read(write(tmp_path, K=K, size=[640, 480], T_cam_world=T_cam_world))
    np.testing.assert_array_equal(track.K, K)
    np.testing.assert_array_equal(track.T_cam_obj, recording().T_world_obj)
    assert track.size == (640, 480)
    assert "guess" not in str(track.provenance["camera"])


@pytest.mark.slow
def test_clips_are_given_the_estimated_hand_where_there_is_one(tmp_path: Path) -> None:
    true = recording().joints["right"]
    (track,) = read(write(tmp_path, estimated_right=true + np.array([0.0, 0.02, 0.0])))
    clip = cutting.clip_of_track(track)
    assert clip.truth is not None
    up = (track.T_cam_obj @ se3.inverse(recording().T_world_obj))[:, :3, 1]
    np.testing.assert_allclose(clip.hand.T_cam_hand[:, :3, 3] - clip.truth.T_cam_hand[:, :3, 3], 0.02 * up, atol=1e-4)
    assert "estimated" in str(track.provenance["hands"])


@pytest.mark.slow
def test_unknown_frames_are_gaps(tmp_path: Path) -> None:
    joints, poses = recording().joints["right"].copy(), recording().T_world_obj.copy()
    joints[[3, 4]], poses[20] = np.nan, np.nan
    (track,) = read(write(tmp_path, joints_right=joints, T_world_obj=poses, frames=np.arange(100, 100 + JOINT_FRAMES)))
    missing = {103, 104, 120}
    assert list(track.numbers) == [n for n in range(100, 100 + JOINT_FRAMES) if n not in missing]


@pytest.mark.slow
def test_a_lid_turns_about_its_axis(tmp_path: Path) -> None:
    joint = [[0.0, -0.025, 0.025], [2.0, 0.0, 0.0]]
    (track,) = read(write(tmp_path, mesh_top="lid.obj", joint=joint, articulation=recording().angle))
    closed, opened = track.object(0.0).vertices, track.object(np.pi).vertices
    turns = np.linalg.norm(opened - closed, axis=1) > 1e-9
    np.testing.assert_array_equal(turns, closed[:, 1] < -0.5 * BOTTOM[1] - 1e-9)
    mirrored = 2.0 * np.array(joint[0]) - closed[turns]
    np.testing.assert_allclose(opened[turns][:, 1:], mirrored[:, 1:], atol=1e-9)
    assert track.articulation is not None


@pytest.mark.slow
def test_a_clip_of_the_grasp_with_masks(tmp_path: Path) -> None:
    camera = {"K": [[80.0, 0.0, 80.0], [0.0, 80.0, 60.0], [0.0, 0.0, 1.0]], "size": [160, 120]}
    T_cam_world = se3.rigid(None, np.array([0.0, 0.0, -0.5]))
    (made,) = clips(Tracks(root=write(tmp_path, licence="ours", T_cam_world=T_cam_world, **camera).parent))
    clip, masks = made
    assert clip.frames[0] == f"{TAKEN:06d}"
    assert masks is not None
    assert masks.object.any(axis=(1, 2)).all()
    assert clip.provenance["licence"] == "ours"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"order": "mano"}, "openpose, ho3d"),
        ({"joints_right": None}, "joints"),
        ({"joints_right": np.zeros((JOINT_FRAMES, 20, 3))}, "shape"),
        ({"estimated_left": recording().joints["left"]}, "the same sides"),
        ({"joints_right": 1e3 * recording().joints["right"]}, "metre"),
        ({"joints_right": np.where(np.arange(21)[:, None] == 4, np.nan, recording().joints["right"])}, "NaN"),
        ({"T_world_obj": 2.0 * recording().T_world_obj}, "rigid"),
        ({"mesh": "../box.obj"}, "mesh"),
        ({"mesh": "none.obj"}, "no such file"),
        ({"fps": 0}, "frames per second"),
        ({"fps": "fast"}, "fps"),
        ({"subject": "a/b"}, "subject"),
        ({"category": None}, "category"),
        ({"frames": np.zeros(JOINT_FRAMES, dtype=int)}, "rising"),
        ({"K": np.eye(3)}, "all of them, or none"),
        ({"K": np.eye(3), "size": [640, 0], "T_cam_world": np.eye(4)}, "size"),
        ({"articulation": recording().angle}, "all of them, or none"),
        ({"mesh_top": "lid.obj", "joint": np.zeros((2, 3)), "articulation": recording().angle}, "direction"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read(write(tmp_path, **changes))
    assert str(tmp_path) in str(caught.value)


def test_a_folder_without_files_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no \.npz"):
        Tracks(root=tmp_path).sources()
