"""HOT3D's folder with one recording, of known poses."""

import csv
import json

import numpy as np
import trimesh

from helpers.umetrack_profile import profile

NAME = "P0000_0123abcd"
HOLD = "P0000--0123abcd--red_box--right"
FRAMES = 16
STEP = 33_333_333


def write_hot3d(folder):
    """A right hand (a ball) that touches a box in frames 2 to 13, seen by a Quest; a second object has no mesh."""
    sequence = folder / "sequences" / NAME
    sequence.mkdir(parents=True)
    times = 10**12 + STEP * np.arange(FRAMES)

    def poses(uid, offsets):
        return [
            [uid, t + 90_000, *x, 1, 0, 0, 0] for t, x in zip(times, np.broadcast_to(offsets, (FRAMES, 3)), strict=True)
        ]

    header = ["object_uid", "timestamp[ns]", "t_wo_x[m]", "t_wo_y[m]", "t_wo_z[m]", "q_wo_w", "q_wo_x", "q_wo_y"]
    header += ["q_wo_z"]
    # The hand's ball reaches from its wrist 12 cm to -x; the box begins there, but for the first and last frames.
    apart = np.where((np.arange(FRAMES) < 2) | (np.arange(FRAMES) > 13), 0.02, 0.0)
    box = np.stack([-0.122 - 0.04 - apart, np.zeros(FRAMES), np.full(FRAMES, 0.6)], axis=1)
    tables = {
        "headset_trajectory.csv": [[1, t, 0, 0, 0, 1, 0, 0, 0] for t in sorted([*times, *(times + 90_000)])],
        "dynamic_objects.csv": [*poses("111", box), *poses("222", [1.0, 0.0, 1.0])],
    }
    for name, rows in tables.items():
        with (sequence / name).open("w", newline="") as file:
            csv.writer(file).writerows([header, *rows])
    wrist = {"q_wxyz": [1, 0, 0, 0], "t_xyz": [0.0, 0.0, 0.6]}
    hands = {"1": {"wrist_xform": wrist, "joint_angles": [0.0] * 22}}
    lines = [json.dumps({"timestamp_ns": int(t), "hand_poses": hands}) for t in times]
    (sequence / "umetrack_hand_pose_trajectory.jsonl").write_text("\n".join(lines))
    (sequence / "umetrack_hand_user_profile.json").write_text(json.dumps(profile()))
    small, large = (
        {
            "T_Device_Camera": {"quaternion_wxyz": [1, 0, 0, 0], "translation_xyz": [0, 0, 0]},
            "imageHeight": height,
            "imageWidth": 640,
            "label": "camera-slam-left",
            "projectionParams": [300.0, 300.0, 319.5, height / 2 - 0.5, *[0.0] * 12],
        }
        for height in (480, 640)
    )
    (sequence / "camera_models.json").write_text(json.dumps([small, large]))
    assets = folder / "assets"
    assets.mkdir()
    instances = {"111": {"instance_name": "red_box"}, "222": {"instance_name": "ghost"}}
    (assets / "instance.json").write_text(json.dumps(instances))
    trimesh.creation.box(extents=[0.08, 0.1, 0.12]).export(assets / "111.glb")
    return folder
