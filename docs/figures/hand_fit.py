"""How well the generic hand fits tracked joints: python docs/figures/hand_fit.py left_hand_sequences.npz

The file holds DexYCB's left hands: ``joints`` (N,21,3) in HO-3D order, ``hand_valid`` (N,), ``offset`` of the
sequences (and the end).
"""

from __future__ import annotations

import sys
import time
from itertools import pairwise

import numpy as np

from getagrip.hands import generic
from getagrip.hands.fit_joints import fit_joints


def main(path: str) -> None:
    with np.load(path, allow_pickle=False) as data:
        joints, valid, offset = data["joints"].astype(float), data["hand_valid"], data["offset"]
    model, residuals, seconds, converged = generic.load("left"), [], [], 0
    for start, end in pairwise(offset):
        observed = joints[start:end][valid[start:end]]
        began = time.perf_counter()
        fit = fit_joints(model, observed, "ho3d")
        seconds.append(time.perf_counter() - began)
        residuals.append(1e3 * fit.residuals)
        converged += fit.converged
    r = np.concatenate(residuals)
    others = np.delete(r, 1, axis=1)
    print(f"{len(seconds)} sequences, {len(r)} frames, {converged} converged")
    print(f"joint distance [mm]: mean {r.mean():.2f}, median {np.median(r):.2f}, 95 % {np.percentile(r, 95):.2f}")
    print(f"  without the thumb's saddle joint: mean {others.mean():.2f}, 95 % {np.percentile(others, 95):.2f}")
    print(f"  fingertips: mean {r[:, 4::4].mean():.2f}, 95 % {np.percentile(r[:, 4::4], 95):.2f}")
    print(f"seconds per sequence: median {np.median(seconds):.3f}, largest {max(seconds):.3f}")


if __name__ == "__main__":
    main(sys.argv[1])
