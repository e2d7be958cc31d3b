"""The energy (Eq. 4): one term per file. A term maps posed objects to the same small object, ``Local``.

A term is called with ``Poses`` of B hypotheses in N frames and answers with its value, gradient and Hessian per frame,
in the frame's local 7-vector (``se3``). The solver only sums and solves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float
from numpy import ndarray


@dataclass(frozen=True)
class Poses:
    """The object in the camera frame: ``X_cam = scale * R @ (X_obj - c) + centre``, with c the mesh's centre."""

    R: Float[ndarray, "B N 3 3"]
    centre: Float[ndarray, "B N 3"]
    scale: Float[ndarray, "B"]


@dataclass(frozen=True)
class Local:
    """A term's value [px^2 of the 256-pixel crop] and its derivatives by each frame's local 7-vector."""

    value: Float[ndarray, "B N"]
    g: Float[ndarray, "B N 7"]
    H: Float[ndarray, "B N 7 7"]
    across: Float[ndarray, "B N 7 N 7"] | None = None
    """The Hessian between frames, of terms that tie frames to each other; ``[:, n, :, n]`` is zero, see ``H``."""

    def __add__(self, other: Local) -> Local:
        across = [a for a in (self.across, other.across) if a is not None]
        total = across[0] + across[1] if len(across) == 2 else across[0] if across else None
        return Local(self.value + other.value, self.g + other.g, self.H + other.H, total)

    def take(self, index: ndarray) -> Local:
        """Some of the hypotheses."""
        across = None if self.across is None else self.across[index]
        return Local(self.value[index], self.g[index], self.H[index], across)


class Term(Protocol):
    """One term of the energy."""

    @property
    def name(self) -> str: ...

    def __call__(self, poses: Poses, bound: Float[ndarray, "B"]) -> Local:
        """Evaluate at the poses. Where the sum of values over frames exceeds ``bound`` the derivatives may be left
        zero: the solver is going to reject that step."""
        ...


def no_bound(poses: Poses) -> Float[ndarray, "B"]:
    """A bound that asks for the derivatives everywhere."""
    return np.full(len(poses.scale), np.inf)
