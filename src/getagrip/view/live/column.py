"""What stands in one column of the page: a result, one of its candidates, or a clip that nothing is known of yet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.fitting.methods import METHODS
from getagrip.geometry import se3
from getagrip.geometry.mesh import diameter
from getagrip.grasps.approximation import pose_hinge
from getagrip.result import Axis, Candidates, Reconstruction, Status
from getagrip.view.shown import View
from getagrip.view.tiles import axis_points

TRUTH = "ground truth"


@dataclass(frozen=True, eq=False)
class Column:
    """A view with a name.

    Attributes:
        name: the method, what tells the result from others, or ``TRUTH``.
        view: the result with its clip and masks at its frames.
        posed: whether the object's poses are known; else the hand is shown alone.
        rank: which of the result's candidates it is, from 0, the result itself.
    """

    name: str
    view: View
    posed: bool = True
    rank: int = 0

    @staticmethod
    def of_clip(clip: Clip, masks: Masks | None) -> Column:
        """A clip: with its ground truth where it has one, else its hand alone."""
        T, truth = len(clip), clip.truth
        still = np.tile(np.eye(4), (T, 1, 1))
        one = Candidates(T_hand_obj=still[None], scale=np.ones(1), energy=np.zeros(1))
        nothing = Reconstruction(
            clip=clip.name, method="", frames=clip.frames, T_hand_obj=still, scale=1.0, iou=np.full(T, np.nan),
            axis=None, candidates=one, energy={}, status=Status.GIVEN, ambiguous=False, seconds={},
        )  # fmt: skip
        view = View(clip.light(), masks, nothing)
        true = view.true()
        if truth is None or true is None:
            return Column(clip.name, view, posed=False)
        given = replace(one, T_hand_obj=true.result.T_hand_obj[None], scale=np.array([truth.scale]))
        return Column(TRUTH, replace(true, result=replace(true.result, candidates=given)))

    @property
    def is_result(self) -> bool:
        """Whether it is a method's result, and not a clip's own."""
        return bool(self.view.result.method)

    @property
    def candidates(self) -> Candidates:
        """The distinct solutions that the result holds, best first."""
        return self.view.result.candidates

    def candidate(self, rank: int) -> Column:
        """Of a result, another candidate in its place; ``iou`` of all but the result itself is not known."""
        if rank == 0:
            return self
        found = self.view.result
        T_hand_obj, scale = self.candidates.T_hand_obj[rank], float(self.candidates.scale[rank])
        axis = None if found.axis is None else hinge(T_hand_obj, scale * self.view.clip.mesh.vertices)
        other = replace(
            found, T_hand_obj=T_hand_obj, scale=scale, iou=np.full(len(found.frames), np.nan), axis=axis,
            findings=(), probability_right=None, probability_right_in_camera=None,
        )  # fmt: skip
        return Column(self.name, replace(self.view, result=other), self.posed, rank)

    @property
    def T_cam_hand(self) -> Float[ndarray, "T 4 4"]:
        """Pose of the hand, hand frame to camera frame."""
        return self.view.clip.hand.T_cam_hand

    @property
    def T_cam_obj(self) -> Float[ndarray, "T 4 4"]:
        """Pose of the object, object frame to camera frame."""
        return np.asarray(self.T_cam_hand @ self.view.result.T_hand_obj)

    @property
    def axis_ends(self) -> Float[ndarray, "2 3"] | None:
        """The latent axis as a segment through the object, in the hand frame [m]."""
        return None if self.view.result.axis is None else axis_points(self.view)[[0, -1]]

    @property
    def truth(self) -> View | None:
        """The ground truth, to be drawn faintly beside what was found."""
        return self.view.true() if self.is_result else None


def hinge(T_hand_obj: Float[ndarray, "T 4 4"], vertices: Float[ndarray, "V 3"]) -> Axis | None:
    """The axis about which poses turn best (Eq. 4), with the angles from the first frame on; None for a single pose.

    Results state their own axis; their other candidates are kept as poses alone.
    """
    if len(T_hand_obj) < 2:
        return None
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    R, c = T_hand_obj[:, :3, :3], se3.transform(T_hand_obj, centre[None])[:, 0]
    best = pose_hinge(R, c, diameter(vertices) / 2.0)
    angle = np.unwrap(best.angles(R, c))
    return Axis(point=best.point, direction=best.direction, angle=angle - angle[0])


def named(views: list[tuple[str, View]]) -> list[Column]:
    """Columns named by the results' methods; where these agree, also by the folders that tell the results apart."""
    labels = [METHODS[v.result.method].label if v.result.method in METHODS else v.result.method for _, v in views]
    names = [
        label if labels.count(label) == 1 else f"{label} ({folder})"
        for label, (folder, _) in zip(labels, views, strict=True)
    ]
    return [Column(name, view) for name, (_, view) in zip(names, views, strict=True)]
