"""A process that compiles the kernels and one that loads them compute the same, to the last bit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.registry import CPUDispatcher

import getagrip.reconstruct  # noqa: F401  # and with it, all kernels of a reconstruction

TERM = """
import os
import sys
import numpy as np
from getagrip.fitting.energy import PosesInCamera
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm, _evaluate_contact_consistency
from getagrip.geometry import se3

rng = np.random.default_rng(0)
poses = PosesInCamera(
    se3.exp_so3(rng.normal(size=(9, 8, 3))), rng.normal(scale=0.1, size=(9, 8, 3)), rng.uniform(0.9, 1.1, 9)
)
process = os.fork()  # without compiled kernels, but with all that is imported: the child compiles, the parent loads
if process and os.waitpid(process, 0)[1]:
    sys.exit("the child failed")
points, hand = rng.normal(scale=0.1, size=(30, 3)), rng.normal(scale=0.1, size=(8, 27, 3))
found = ContactConsistencyTerm(points, hand, rng.uniform(1.0, 2.0, 8))(poses, np.full(9, np.inf))
hits = sum(_evaluate_contact_consistency.stats.cache_hits.values())
with open("loaded" if process else "compiled", "wb") as file:
    file.write(bytes([hits]) + found.value.tobytes() + found.g.tobytes() + found.H.tobytes())
"""


@pytest.mark.slow
def test_a_process_that_compiles_a_term_and_one_that_loads_it_agree_to_the_bit(tmp_path: Path) -> None:
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", TERM], env=env, cwd=tmp_path, check=True)
    compiled, loaded = ((tmp_path / name).read_bytes() for name in ("compiled", "loaded"))
    assert (compiled[0], loaded[0]) == (0, 1)
    assert len(compiled) == 1 + 9 * 8 * (1 + 7 + 49) * 8
    assert compiled[1:] == loaded[1:]


def test_every_kernel_whose_sums_may_be_reordered_becomes_part_of_its_callers() -> None:
    ours = [module for name, module in sys.modules.items() if name.startswith("getagrip.")]
    kernels = {it for module in ours for it in vars(module).values() if isinstance(it, CPUDispatcher)}
    assert len(kernels) > 30
    reordered = {kernel for kernel in kernels if kernel.targetoptions.get("fastmath")}
    assert [kernel.__name__ for kernel in reordered if not kernel.targetoptions.get("forceinline")] == []
