"""Results agree within what docs/batch.md states where BLAS computes as on another CPU."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401 - brings a BLAS of its own
from threadpoolctl import threadpool_info

from getagrip.clip import read_clip, write_clip
from getagrip.geometry import se3
from getagrip.reconstruct import reconstruct
from helpers.environment import import_path
from helpers.scenes import SHORT, scene

KERNELS = {one["architecture"] for one in threadpool_info() if one["internal_api"] == "openblas"}
OTHER = "Prescott" if "Nehalem" in KERNELS else "Nehalem"
"""What every x86-64 can compute with, and this process does not."""
CHILD = """
import json
import sys
from threadpoolctl import threadpool_info
from getagrip.clip import read_clip
from getagrip.reconstruct import reconstruct

result = reconstruct(read_clip(sys.argv[1]))
kernels = [one.get("architecture") for one in threadpool_info()]
print(json.dumps([result.T_hand_obj.tolist(), result.energy["total"], kernels]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not KERNELS, reason="needs OpenBLAS, whose kernels can be chosen")
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason=f"OpenBLAS's {OTHER} is an x86-64")
def test_where_blas_adds_up_in_another_order_poses_stay_within_the_tolerance(tmp_path: Path) -> None:
    folder = write_clip(*scene("pan", 0, SHORT), tmp_path / "pan")
    here = reconstruct(read_clip(folder))
    env = import_path() | {"OPENBLAS_CORETYPE": OTHER}
    child = subprocess.run([sys.executable, "-c", CHILD, folder], env=env, stdout=subprocess.PIPE, check=True)
    there, energy, kernels = json.loads(child.stdout)
    if KERNELS & {*kernels}:
        pytest.skip("this OpenBLAS has the kernels of one CPU only")
    T = np.array(there)
    assert not np.array_equal(T, here.T_hand_obj)
    assert 1e3 * np.linalg.norm((T - here.T_hand_obj)[:, :3, 3], axis=1).max() < 0.01  # mm
    assert np.degrees(se3.angle_between(T[:, :3, :3], here.T_hand_obj[:, :3, :3])).max() < 0.01
    assert energy == pytest.approx(here.energy["total"], rel=1e-6)
