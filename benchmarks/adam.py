"""Adam on the 1-DoF parameters, as in the code that the paper's authors published later (the paper names no optimiser).

Every initial pose gets the same number of iterations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import Term, no_bound
from getagrip.fitting.motion import Hinge
from getagrip.fitting.solve import in_camera
from getagrip.geometry import se3

ITERATIONS = 200
UNIT = 0.01
"""Adam's step at rate 1 is 0.01 rad, the authors' learning rate; a centimetre counts as 0.1 rad, as in our solver."""
METRES = 0.1


@dataclass(frozen=True)
class Descent:
    """The best iterate from each of B initial poses."""

    motion: Hinge
    energy: Float[ndarray, "B"]
    """As the term that was minimised sees it [px^2, summed over frames]."""


def start(R: Float[ndarray, "B 3 3"], centre: Float[ndarray, "B 3"], origin: Float[ndarray, "3"], frames: int) -> Hinge:
    """The paper's start: the axis is the object's z-axis through ``origin`` (the mesh's, from its centre)."""
    return Hinge(
        R=R,
        centre=centre,
        log_scale=np.zeros(len(R)),
        point=centre + R @ origin,
        direction=R[:, :, 2].copy(),
        angle=np.zeros((len(R), frames)),
    )


def gradient(hinge: Hinge, term: Term, T_cam_hand: Float[ndarray, "N 4 4"]) -> tuple[ndarray, ndarray, ndarray]:
    """Energy (B,) and its gradient by shared (B, 10) and per-frame (B, N) parameters, through the hinge's Jacobian."""
    poses = in_camera(hinge, T_cam_hand)
    local = term(poses, no_bound(poses))
    Rt = np.swapaxes(T_cam_hand[:, :3, :3], -1, -2)
    in_hand = [(Rt @ part[..., None])[..., 0] for part in (local.g[..., :3], local.g[..., 3:6])]
    g = np.concatenate([*in_hand, local.g[..., 6:]], axis=-1)
    J_shared, J_local = hinge.jacobian()
    return local.value.sum(axis=1), np.einsum("bnis,bni->bs", J_shared, g), np.einsum("bni,bni->bn", J_local[..., 0], g)


def minimise(
    hinge: Hinge, term: Term, T_cam_hand: Float[ndarray, "N 4 4"], rate: float, iterations: int = ITERATIONS
) -> Descent:
    """Adam (Kingma and Ba, 2015) with its default decay rates and a cosine schedule; the best iterate is kept.

    Its parameters are local: each step turns and shifts the current pose and axis, whose rotations thus stay rotations.
    """
    B, N = hinge.angle.shape
    unit = UNIT * np.concatenate([np.full(3, METRES), np.ones(5), np.full(2, METRES), np.ones(N)])
    mean, square = np.zeros((B, 10 + N)), np.zeros((B, 10 + N))
    best, least = hinge, np.full(B, np.inf)
    for k in range(iterations + 1):
        energy, *parts = gradient(hinge, term, T_cam_hand)
        best, least = hinge.where(energy < least, best), np.minimum(energy, least)
        g = unit * np.concatenate(parts, axis=1)  # by parameters of one scale
        mean, square = 0.9 * mean + 0.1 * g, 0.999 * square + 0.001 * g**2
        corrected = mean / (1.0 - 0.9 ** (k + 1)) / (np.sqrt(square / (1.0 - 0.999 ** (k + 1))) + 1e-12)
        step = -0.5 * rate * (1.0 + np.cos(np.pi * k / iterations)) * unit * corrected
        hinge = hinge.retract(step[:, :10], step[:, 10:, None])
    return Descent(best, least)


def poses(hinge: Hinge, centre: Float[ndarray, "3"]) -> Float[ndarray, "B N 4 4"]:
    """T_hand_obj of the mesh as it is, not about its centre."""
    held = hinge.poses()
    return se3.rigid(held.R, held.centre - held.R @ centre)
