"""Every camera model of COLMAP's binary files keeps the cameras behind it in their places."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from getagrip.readers.cameras import colmap


@pytest.mark.parametrize("kind", colmap.COLMAP_CAMERA_MODELS)
def test_a_camera_behind_another_is_read(kind: int) -> None:
    name, count = colmap.COLMAP_CAMERA_MODELS[kind]
    first = struct.pack("<IiQQ", 1, kind, 640, 480) + np.arange(100.0, 100.0 + count).tobytes()
    behind = struct.pack("<IiQQ", 2, 1, 640, 480) + np.array([500.0, 501.0, 320.0, 240.0]).tobytes()
    cameras = dict(colmap._cameras_bin(struct.pack("<Q", 2) + first + behind))
    np.testing.assert_array_equal(cameras[2].K, [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]])
    assert cameras[1].K[0, 0] == 100.0
    assert cameras[1].K[1, 2] == (102.0 if name in colmap.SINGLE_FOCAL_MODELS else 103.0)
    assert cameras[1].distorted == (name not in ("PINHOLE", "SIMPLE_PINHOLE"))
