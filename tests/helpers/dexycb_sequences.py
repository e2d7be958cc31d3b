"""DexYCB's sequences as tests read them."""

import numpy as np

from getagrip.readers.datasets.cutting import cut_into_grasps
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.dexycb.dexycb_clips import GRASPS_WITHIN_10_MM, DexYcb
from helpers.dexycb_files import (
    SERIALS,
)


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
