"""DexYCB's own layout with one sequence, and the packed one, of known poses.

DexYCB's sequences as tests read them.
"""

import numpy as np
import trimesh

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.readers.datasets.cutting import cut_into_grasps
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb
from getagrip.readers.datasets.tracks import GRASPS_WITHIN_10_MM

SUBJECT, SEQUENCE, HELD, OTHER = "20200709-subject-01", "20200709_141754", "025_mug", "003_cracker_box"
NAME = f"{SUBJECT}--{SEQUENCE}--{HELD}"
SERIALS = ["836212060125", "932122062010"]
FRAMES, TAKEN, LOST = 32, 5, 29
"""The object is taken in frame 5; the hand is not known in frame 29."""
META = """serials:
- '836212060125'
- '932122062010'
num_frames: 32
extrinsics: '20200702_151821'
ycb_ids:
- 2
- 14
ycb_grasp_ind: 1
mano_sides:
- right
mano_calib:
- 20200709-subject-01_right
"""
INTRINSICS = """color:
  fx: 616.6
  fy: 616.2
  ppx: 308.5
  ppy: 248.5
extrinsics: !!python/tuple
- 1.0
- 0.0
"""


def grip(shape=None):
    """A right generic hand with bent fingers, and where the ball lies in it."""
    pose = np.zeros((5, 3, 3))
    pose[:4, :, 2] = 0.5  # bends towards the palm
    posed = generic.load("right").with_shape(shape).with_pose(pose.reshape(45))
    return posed, np.array([0.01, -0.045, 0.005])


def scene():
    """T_cam_hand, T_cam_obj of the ball and joints in the camera frame (N, ...): the hand carries the ball, turning."""
    posed, at = grip()
    t = np.linspace(0.0, 1.0, FRAMES)
    turn = se3.exp_so3(np.stack([0.3 * t - 0.8, 0.5 * t, 0.2 * t], axis=-1))
    T_cam_hand = se3.rigid(turn, np.stack([0.1 * t, -0.05 * t, 0.7 + 0.1 * t], axis=-1))
    T_hand_obj = np.tile(se3.rigid(None, at), (FRAMES, 1, 1))
    T_hand_obj[:TAKEN, 1, 3] -= 0.1
    return T_cam_hand, T_cam_hand @ T_hand_obj, se3.transform(T_cam_hand, posed.joints)


def write_models(folder):
    for name, mesh in {
        HELD: trimesh.creation.icosphere(subdivisions=3, radius=0.03),
        OTHER: trimesh.creation.box(extents=[0.06, 0.16, 0.21]),
    }.items():
        (folder / name).mkdir(parents=True)
        mesh.export(folder / name / "textured_simple.obj")


def write_sequence(root, sequence=SEQUENCE, lost=(LOST,)):
    """A sequence of DexYCB's own layout; the second camera looks from 1 m to the side and sees less of the ball."""
    _, T_cam_obj, joints = scene()
    folder = root / SUBJECT / sequence
    folder.mkdir(parents=True)
    (folder / "meta.yml").write_text(META)
    aside = se3.rigid(None, np.array([1.0, 0.0, 0.0]))
    beside = np.tile(se3.rigid(None, np.array([-0.25, 0.1, 0.9])), (FRAMES, 1, 1))
    for serial, T, pixels in zip(SERIALS, (np.eye(4), aside), (900, 100), strict=True):
        (folder / serial).mkdir()
        for n in range(FRAMES):
            seg = np.zeros((480, 640), np.uint8)
            seg.flat[:pixels] = 14
            seen = joints[n] + T[:3, 3]
            np.savez_compressed(
                folder / serial / f"labels_{n:06d}.npz",
                seg=seg,
                pose_y=np.stack([T @ beside[n], T @ T_cam_obj[n]])[:, :3].astype(np.float32),
                pose_m=np.zeros((1, 51), np.float32),
                joint_3d=np.where(n in lost, -1.0, seen)[None].astype(np.float32),
                joint_2d=np.zeros((1, 21, 2), np.float32),
            )
    return folder


def write_dexycb(folder):
    """DexYCB's own layout with one sequence."""
    write_models(folder / "models")
    intrinsics = folder / "calibration" / "intrinsics"
    intrinsics.mkdir(parents=True)
    for serial in SERIALS:
        (intrinsics / f"{serial}_640x480.yml").write_text(INTRINSICS)
    write_sequence(folder)
    return folder


def packed(**changes):
    """The arrays of a packed file with the same sequence twice, the second of another subject."""
    _, T_cam_obj, joints = scene()
    valid = np.arange(FRAMES) != LOST
    ho3d = np.empty_like(joints)
    ho3d[:, JOINT_ORDERS["ho3d"]] = joints
    once = {
        "obj_quat_xyzw": np.roll(se3.quaternion(T_cam_obj[:, :3, :3]), -1, axis=1).astype(np.float32),
        "obj_trans": T_cam_obj[:, :3, 3].astype(np.float32),
        "joints": ho3d.astype(np.float32),
        "hand_valid": valid,
    }
    return {
        "sequence": np.array([f"{SUBJECT}/{SEQUENCE}", f"20200813-subject-02/{SEQUENCE}"]),
        "object": np.array([HELD, HELD]),
        "offset": np.array([0, FRAMES, 2 * FRAMES], np.int32),
        **{key: np.concatenate([array, array]) for key, array in once.items()},
        **changes,
    }


def read(root, meshes=None, note=lambda _: None):
    """The clips of the stable grasps."""
    return clips(DexYcb(root=root, meshes=meshes), note)


def grasps(sequence, note=lambda _: None):
    """The stable grasps of a sequence, as pieces of its track."""
    return list(cut_into_grasps(sequence.read(note), note, GRASPS_WITHIN_10_MM.cut(note)))


def write_extrinsics(root, T_master_cam, T_master_tag):
    folder = root / "calibration" / "extrinsics_20200702_151821"
    folder.mkdir(exist_ok=True)
    rows = {SERIALS[0]: T_master_cam, SERIALS[1]: np.eye(4), "apriltag": T_master_tag}
    text = f"master: '{SERIALS[1]}'\nextrinsics:\n"
    for key, T in rows.items():
        text += f"  '{key}': {T[:3].ravel().tolist()}\n"
    (folder / "extrinsics.yml").write_text(text)
    return folder / "extrinsics.yml"
