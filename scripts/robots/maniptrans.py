"""ManipTrans reads exports of `--to dex-retargeting` by this class, put into its `main/dataset` (docs/robots.md)."""

from pathlib import Path

import numpy as np
import torch
import trimesh
from main.dataset.base import ManipData
from scipy.spatial.transform import Rotation


class GetagripData(ManipData):
    def __init__(self, **options):
        super().__init__(skip=4, **options)
        self.data_pathes = sorted(Path(self.data_dir).glob("*/trajectory.npz"))

    def __getitem__(self, idx):
        path = self.data_pathes[idx]
        of, mesh = np.load(path), trimesh.load(path.with_name("object.obj"), force="mesh")

        def tensor(values):
            return torch.tensor(values, dtype=torch.float32, device=self.device)

        joints, T = tensor(of["joint_pos"]), np.tile(np.eye(4), (len(of["joint_pos"]), 1, 1))
        T[:, :3, :3] = Rotation.from_quat(of["object_pose"][:, 0, :4]).as_matrix()
        T[:, :3, 3] = of["object_pose"][:, 0, 4:]
        wrist = Rotation.from_quat(np.roll(of["wrist_quat"], -1, axis=1)).as_matrix()
        fingers = [
            f"{name}_{part}"
            for name in ("thumb", "index", "middle", "ring", "pinky")
            for part in ("proximal", "intermediate", "distal", "tip")
        ]
        points = tensor(trimesh.sample.sample_surface(mesh, 1000, seed=0)[0])
        data = {
            "data_path": str(path),
            "obj_id": "-1",
            "obj_verts": points,
            "scene_objs": [],
            "obj_urdf_path": str(path.with_name("object.urdf")),
            "obj_trajectory": tensor(T),
            "wrist_pos": joints[:, 0],
            "wrist_rot": tensor(wrist @ self.dexhand.relative_rotation),
            "mano_joints": {name: joints[:, n] for n, name in enumerate(fingers, start=1)},
        }
        self.process_data(data, idx, points)
        self.load_retargeted_data(data, str(path.with_name("retargeted.pkl")))
        return data
