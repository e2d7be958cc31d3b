"""A term of the energy as the world sees the object, whatever the camera does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic, Term
from getagrip.geometry import se3


@dataclass(frozen=True)
class WorldTerm:
    """Another term, at poses in the world. Its derivatives are taken back to the camera's frame."""

    term: Term
    T_world_cam: Float[ndarray, "N 4 4"]

    @property
    def name(self) -> str:
        return self.term.name

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        R = self.T_world_cam[:, :3, :3]
        centre = se3.transform(self.T_world_cam, poses.centre[:, :, None])[:, :, 0]
        found = self.term(PosesInCamera(R @ poses.R, np.asarray(centre), poses.scale), bound)
        turn = np.zeros((len(R), 7, 7))
        turn[:, :3, :3] = turn[:, 3:6, 3:6] = R
        turn[:, 6, 6] = 1.0
        back = np.swapaxes(turn, -1, -2)
        cross = found.cross
        if cross is not None:
            cross = np.einsum("nji,bnjmk,mkl->bniml", turn, cross, turn, optimize=True)
        return Quadratic(found.value, (back @ found.g[..., None])[..., 0], back @ found.H @ turn, cross)
