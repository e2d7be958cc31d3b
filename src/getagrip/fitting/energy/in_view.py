"""Terms in a further view: the same terms on the same object and hand, posed in the frame of another camera.

With ``X' = R X + t`` from the clip's camera to the other one, the local vectors of a pose turn with R (``se3``): their
shifts and turns are vectors of the camera frame. So a term's derivatives by them turn back, by ``J = diag(R, R, 1)``
for each of the bodies: the term knows nothing of the first camera, and the solver nothing of the other one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.energy.term import (
    Energy,
    HandEnergy,
    HandTerm,
    ObjectWithHand,
    PosesInCamera,
    Quadratic,
    Term,
)

VIEW_SEPARATOR = ":"
"""Between the names of a term and of its view."""
P = TypeVar("P", bound=PosesInCamera)


def term_in_any_view(name: str) -> str:
    """Return the name of a term without that of its view."""
    return name.partition(VIEW_SEPARATOR)[0]


@dataclass(frozen=True)
class InView:
    """A term of a further view, on some of the frames.

    Attributes:
        term: the term, at the frames that the view shows.
        view: name of the view.
        at: (n,) places of these frames among the poses' N frames.
        T: (n, 4, 4) ``T_view_cam`` in these frames.
    """

    term: Term | HandTerm
    view: str
    at: Int[ndarray, "n"]
    T: Float[ndarray, "n 4 4"]

    @property
    def name(self) -> str:
        return f"{self.term.name}{VIEW_SEPARATOR}{self.view}"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        seen = self.term(poses_in_view(poses, self.at, self.T), bound)  # type: ignore[arg-type]
        B, N = poses.centre.shape[:2]
        size = seen.g.shape[-1]
        J = jacobian_in_view(self.T, size, size // 7)
        Jt = np.swapaxes(J, 1, 2)
        out = Quadratic(np.zeros((B, N)), np.zeros((B, N, size)), np.zeros((B, N, size, size)))
        out.value[:, self.at] = seen.value
        out.g[:, self.at], out.H[:, self.at] = (Jt @ seen.g[..., None])[..., 0], Jt @ seen.H @ J
        if (between := seen.between_frames) is None:
            return out
        cross = np.zeros((B, N, size, N, size))
        turned = np.einsum("npi,bnpmq,mqj->bnimj", J, between, J)
        cross[:, self.at[:, None], :, self.at] = np.moveaxis(turned, (1, 3), (0, 1))
        return replace(out, cross=cross)


def jacobian_in_view(T: Float[ndarray, "n 4 4"], size: int, bodies: int = 1) -> Float[ndarray, "n size size"]:
    """Differentiate local vectors of bodies in a view by those in the first camera; further numbers stay the same."""
    J = np.tile(np.eye(size), (len(T), 1, 1))
    for first in np.add.outer(7 * np.arange(bodies), [0, 3]).ravel():
        J[:, first : first + 3, first : first + 3] = T[:, :3, :3]
    return J


def poses_in_view(poses: P, at: Int[ndarray, "n"], T: Float[ndarray, "n 4 4"]) -> P:
    """Return poses of some frames in the frame of another camera, by ``T_view_cam``."""
    R, t = T[:, :3, :3], T[:, :3, 3]
    moved: dict[str, Any] = {
        "R": np.ascontiguousarray(R @ poses.R[:, at]),
        "centre": np.ascontiguousarray((R @ poses.centre[:, at, :, None])[..., 0] + t),
    }
    if isinstance(poses, ObjectWithHand):
        return replace(
            poses, **moved, hand=poses_in_view(poses.hand, at, T), in_hand=poses_in_view(poses.in_hand, at, T)
        )
    return replace(poses, **moved)


@dataclass(frozen=True)
class ViewedEnergy:
    """An energy on object or hand at the frames of a further view, as one of all frames of a problem.

    Attributes:
        energy: the energy, by indices into ``rows``.
        view: name of the view.
        rows: (n,) the problem's frames that the view shows.
        T: (n, 4, 4) ``T_view_cam`` in these frames.
    """

    energy: Energy | HandEnergy
    view: str
    rows: Int[ndarray, "n"]
    T: Float[ndarray, "n 4 4"]

    def __call__(self, level: int, index: Int[ndarray, "m"]) -> Sequence[InView]:
        at = np.flatnonzero(np.isin(index, self.rows))
        own = np.searchsorted(self.rows, index[at])
        return [InView(term, self.view, at, self.T[own]) for term in self.energy(level, own)] if len(at) else []
