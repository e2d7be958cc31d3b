"""Plain joints that are no hand in the order and of the side that are stated, or not before the camera."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.hands import generic
from getagrip.hands.fit import JOINT_ORDERS, JointOrder, fit_joints
from getagrip.hands.model import Side

Order = Literal[JointOrder, "auto"]

MAX_JOINT_MISFIT_M = 0.010
"""Joints so far from every pose of a hand [m, root mean square] are noise, or no hand's. The right ones of datasets
leave 2 mm, noise of 10 mm leaves 12 mm, another order 30 mm and more."""
EXACT_JOINT_MISFIT_M = 0.003
"""Joints within this distance [m, root mean square] give no warning."""
CERTAIN_MISFIT_RATIO, POSSIBLE_MISFIT_RATIO = 0.5, 0.85
"""Another order or side whose misfit is less than this part of the stated one's is the right one, or may be."""
MIN_JOINT_DISTANCE_M = 0.05
"""No joint is as near to a camera [m]."""
N_ORDER_TEST_FRAMES = 5
"""Frames of which orders are tried."""


class Ordered(NamedTuple):
    """Joints in this package's order."""

    joints: Float[ndarray, "T 21 3"]
    chosen: str
    """How their order was chosen, in words; empty where it was stated."""
    warning: str
    """A warning about the joints, in words; empty where there is none."""


def check_before_camera(path: Path, joints: Float[ndarray, "T 21 3"]) -> None:
    """Raise ``InputError`` for hands behind the camera or about it, as of joints relative to the wrist."""
    z, nearest = joints[..., 2].mean(axis=1), np.linalg.norm(joints, axis=-1).min(axis=1)
    wrong = (z <= 0) | (nearest < MIN_JOINT_DISTANCE_M)
    if wrong.any():
        row = int(np.argmax(wrong))
        where = f"{-z[row]:.2g} m behind the camera" if z[row] <= 0 else f"{nearest[row]:.2g} m from the camera"
        expected = "joints before the camera, z forward [m]; are these relative to the wrist or to the hand's middle?"
        raise InputError(path, "joints", f"a hand {where} in row {row}", expected)


def reorder_joints(path: Path, joints: Float[ndarray, "T 21 3"], order: Order, side: Side) -> Ordered:
    """Return joints (T, 21, 3) [m] in an order that is stated, or that is found by the hand that fits.

    Raises ``InputError`` for joints that another order or the other side fits clearly better.
    """
    some = joints[np.unique(np.linspace(0, len(joints) - 1, N_ORDER_TEST_FRAMES).astype(int))]
    if order == "auto":
        fits = sorted((joint_misfit(some, each, side), each) for each in JOINT_ORDERS)
        (best, order), (second, other) = fits[:2]
        both = f"joints {_mm(best)} off a {side} hand as {order}, {_mm(second)} as {other}"
        if best > min(2 * MAX_JOINT_MISFIT_M, POSSIBLE_MISFIT_RATIO * second):
            raise InputError(path, "joints", both, "one order that fits; are they in metres, and of this side?")
        chosen = f"order {order}, a guess: {both}"
    else:
        best, chosen = joint_misfit(some, order, side), ""
    return Ordered(joints[:, JOINT_ORDERS[order]], chosen, _order_warning(path, some, order, side, best))


def _order_warning(path: Path, some: Float[ndarray, "T 21 3"], order: JointOrder, side: Side, off: float) -> str:
    """Which other order or side may fit better, in words. Raises ``InputError`` where one clearly does."""
    if off < EXACT_JOINT_MISFIT_M:
        return ""
    mirrored: Side = "left" if side == "right" else "right"
    others = {
        (o, s): joint_misfit(some, o, s) for o in JOINT_ORDERS for s in (side, mirrored) if (o, s) != (order, side)
    }
    (other, of), best = min(others.items(), key=lambda item: item[1])
    if best > POSSIBLE_MISFIT_RATIO * off or (
        off == np.inf and best > MAX_JOINT_MISFIT_M
    ):  # what cannot be fitted has an error of its own
        return ""
    is_order = f"--order {other} fits, {_mm(best)} off"
    is_side = f"a {of} hand{'' if other == order else f' in --order {other}'} fits, {_mm(best)} off"
    fits = is_order if of == side else f"{is_side}: are they the other hand's, or mirrored (an axis reversed)?"
    got = f"joints {_mm(off)} off every pose of a {side} hand in --order {order}"
    if best < CERTAIN_MISFIT_RATIO * off:
        raise InputError(path, "joints", got, f"joints of such a hand; {fits}")
    return f"{got}; {fits}"


def joint_misfit(joints: Float[ndarray, "T 21 3"], order: JointOrder, side: Side) -> float:
    """Compute the distance of joints in an order from the nearest hand [m, root mean square].

    Infinite where there is none.
    """
    try:
        fit = fit_joints(generic.load(side), joints[:, JOINT_ORDERS[order]], "openpose")
    except UsageError:
        return np.inf
    return float(np.sqrt(np.mean(fit.residuals**2)))


def _mm(metres: float) -> str:
    return "far" if metres == np.inf else f"{1e3 * metres:.1f} mm"
