"""Plain joints that are no hand in the order that is given, or not before the camera."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.hands import generic
from getagrip.hands.fit import ORDERS, JointOrder, fit_joints
from getagrip.hands.model import Side

MISFIT = 0.010
"""Joints so far from every pose of a hand [m, root mean square] are in another order; the right one leaves 5 mm."""
TRIED = 5
"""Frames of which another order is tried."""


def check_before_camera(path: Path, joints: Float[ndarray, "T 21 3"]) -> None:
    """Raise ``InputError`` for hands whose middle is not before the camera, as of joints about the wrist or the
    hand's middle."""
    z = joints[..., 2].mean(axis=1)
    behind = (z <= 0) | (np.abs(joints).max(axis=(1, 2)) < 0.3) & (z < 0.05)
    if behind.any():
        given = f"a hand at z = {z[np.argmax(behind)]:.3g} m in row {np.argmax(behind)}, at or behind the camera"
        expected = "joints before the camera, z forward [m]; are these about the wrist or the hand's middle?"
        raise InputError(path, "joints", given, expected)


def check_order(path: Path, joints: Float[ndarray, "T 21 3"], order: JointOrder, side: Side) -> None:
    """Raise ``InputError`` for joints that fit no hand in their order, which names the order that fits."""
    some = joints[np.unique(np.linspace(0, len(joints) - 1, TRIED).astype(int))]
    off = _misfit(some, order, side)
    if not MISFIT < off < np.inf:  # what cannot be fitted at all has an error of its own
        return
    others = {other: _misfit(some, other, side) for other in get_args(JointOrder) if other != order}
    best = min(others, key=others.__getitem__)
    fits = f"; --order {best} fits, {1e3 * others[best]:.1f} mm off" if others[best] < MISFIT else ", nor is any other"
    given = f"joints {1e3 * off:.1f} mm off every pose of a {side} hand (root mean square)"
    raise InputError(path, "joints", given, f"at most {1e3 * MISFIT:g} mm: --order {order} is not theirs{fits}")


def _misfit(joints: Float[ndarray, "T 21 3"], order: JointOrder, side: Side) -> float:
    """How far joints in an order are from the nearest hand [m, root mean square]; infinite where there is none."""
    try:
        fit = fit_joints(generic.load(side), joints[:, ORDERS[order]], "openpose")
    except UsageError:
        return np.inf
    return float(np.sqrt(np.mean(fit.residuals**2)))
