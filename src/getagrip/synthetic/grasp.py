"""Grasps by contact: an object is brought to an open hand, then each finger closes joint by joint until it touches.

The object comes to one of two places: the ``palm`` (power grasp), or the ``pinch`` between the pads of thumb and
fingers (precision grasp). A finger bends all its joints together until one of its segments touches; the joints up to
this segment stop, the others continue (the automatic grasp of Miller and Allen, "GraspIt!", 2004). The thumb closes
last and stops at the fingers, too; it is steered aside where it would miss or penetrate the object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands.generic import rest_fingers
from getagrip.hands.grips import HOLD_FRAMES, Grip, frame_from_axes
from getagrip.hands.model import KNUCKLES, PosedHand, ShapedHand, joint_transforms, skin

CONTACT_DEPTH_M = 0.0005
"""Depth in the object at which a segment of a finger stops: soft flesh [m]."""
MAX_HOLD_GAP_M = 0.002
"""Maximum distance at which a finger holds the object [m]."""
FLESH_COMPLIANCE_M = 0.0015
"""Depth to which flesh yields [m]."""
THUMB_ABDUCTION_ANGLES_DEG = (-10.0, 10.0, -20.0, 20.0, -30.0, 30.0)
"""Tried sideways turns of the thumb's metacarpal [deg]."""
_FIST_ANGLES_DEG = ((80.0, 95.0, 60.0),) * 4


class SignedDistance:
    """Signed distance to a mesh of closed parts, which may overlap, negative inside [m]."""

    def __init__(self, mesh: Mesh) -> None:
        import igl

        self._mesh, self._box = mesh, (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))
        self._tree, self._winding = igl.AABB(), igl.FastWindingNumberBVH()
        self._tree.init(mesh.vertices, mesh.faces)
        self._winding.init(mesh.vertices, mesh.faces)

    def __call__(self, X: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch"]:
        """Compute the distances of points in the mesh's frame."""
        flat = np.ascontiguousarray(X.reshape(-1, 3))
        distance = np.sqrt(self._tree.squared_distance(self._mesh.vertices, self._mesh.faces, flat)[0])
        boxed = np.flatnonzero(np.all((flat >= self._box[0]) & (flat <= self._box[1]), axis=1))
        inside = boxed[np.abs(self._winding.winding_number(flat[boxed])) > 0.5] if boxed.size else boxed
        distance[inside] *= -1.0
        return distance.reshape(X.shape[:-1])


class MinSignedDistance:
    """The least signed distance [m] of each of some groups of moving points.

    A distance changes by at most its point's displacement: only points that may be the nearest are looked up.
    """

    def __init__(self, distance: SignedDistance, groups: int, X: Float[ndarray, "*#groups n 3"]) -> None:
        """Look up the points' initial positions ``X``, of each group or common to all."""
        self._distance = distance
        self._known = np.array(np.broadcast_to(distance(X), (groups, X.shape[-2])))
        self._at = np.array(np.broadcast_to(X, (*self._known.shape, 3)))

    def __call__(self, X: Float[ndarray, "B n 3"], which: Int[ndarray, "B"]) -> Float[ndarray, "B"]:
        """Return the least distance of each of the groups ``which``, whose points have moved to X."""
        way, known = np.linalg.norm(X - self._at[which], axis=-1), self._known[which]
        group, point = np.nonzero((known - way <= (known + way).min(axis=1, keepdims=True)) & (way > 0.0))
        if group.size:
            now = X[group, point]
            known[group, point], way[group, point] = self._distance(now), 0.0
            self._known[which[group], point], self._at[which[group], point] = known[group, point], now
        return np.asarray((known - way).min(axis=1))


def perturb_grip(grip: Grip, turn_deg: float, shift_mm: float, rng: np.random.Generator) -> Grip:
    """Turn a grip about a random axis and shift it; both sizes are root mean squares."""
    R = se3.exp_so3(np.radians(turn_deg) / np.sqrt(3.0) * rng.normal(size=3))
    at = np.array(grip.at) + 1e-3 * shift_mm / np.sqrt(3.0) * rng.normal(size=3)
    return Grip(grip.hold, _triple(at), _triple(R @ grip.into), _triple(R @ grip.aside))


def _triple(v: Float[ndarray, "3"]) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


@dataclass(frozen=True)
class _Fingers:
    """The fingers' motion at one of the right hand's places; angles in degrees.

    Attributes:
        opened: angles of the open hand.
        closed: angles of the closed hand.
        thumb_aim: direction of the opposed thumb's metacarpal.
        thumb_pad: direction of the opposed thumb's pad.
    """

    opened: tuple[tuple[float, float, float], ...]
    closed: tuple[tuple[float, float, float], ...]
    thumb_aim: tuple[float, float, float]
    thumb_pad: tuple[float, float, float]


_FINGERS = {
    "palm": _Fingers(
        opened=((-35.0, -10.0, 0.0), *((-12.0, 4.0, 2.0),) * 4),
        closed=((50.0, 55.0, 65.0), *_FIST_ANGLES_DEG),
        thumb_aim=(-0.38, -0.80, 0.46),
        thumb_pad=(-0.85, 0.35, -0.1),
    ),
    "pinch": _Fingers(
        opened=((-10.0, -8.0, -5.0), *((32.0, 22.0, 8.0),) * 4),
        closed=((50.0, 25.0, 30.0), *((70.0, 75.0, 40.0),) * 4),
        thumb_aim=(-0.50, -0.72, 0.45),
        thumb_pad=(-0.85, 0.35, -0.25),
    ),
}


class _Obstacles:
    """The other fingers of posed hands, at which the thumb stops."""

    def __init__(self, posed: PosedHand, members: Bool[ndarray, "V"]) -> None:
        from scipy.spatial import cKDTree

        self._trees = [cKDTree(vertices) for vertices in posed.vertices[:, members]]
        self._points, self._normals = posed.vertices[:, members], posed.normals[:, members]

    def gap(self, X: Float[ndarray, "B n 3"], which: Int[ndarray, "B"]) -> Float[ndarray, "B"]:
        """Compute the least signed distance [m] of the thumb's points to the fingers of the hands ``which``."""
        gap = np.empty(len(X))
        for b, hand in enumerate(which):
            distance, nearest = self._trees[hand].query(X[b])
            side = np.sum((X[b] - self._points[hand, nearest]) * self._normals[hand, nearest], axis=-1)
            gap[b] = (np.where(side < 0.0, -1.0, 1.0) * distance).min()
        return gap


@dataclass(frozen=True)
class Grasper:
    """A right generic hand that grasps an object; poses are of the object in the hand.

    Attributes:
        hand: the hand.
        distance: signed distance to the object.
        hold: the object's place.
        steer: turns of the opposed thumb's metacarpal: sideways, and about itself [deg].
    """

    hand: ShapedHand
    distance: SignedDistance
    hold: Literal["palm", "pinch"]
    steer: tuple[float, float] = (0.0, 0.0)

    def posed(self, angles: Float[ndarray, "*batch 5 3"]) -> PosedHand:
        """Bend the joints of each finger by ``angles`` [rad], thumb first, from the palm to the tip."""
        return self.hand.with_pose(self._pose(angles).reshape(*angles.shape[:-2], 45))

    def _pose(self, angles: Float[ndarray, "*batch 5 3"]) -> Float[ndarray, "*batch 15 3"]:
        """Rotation vectors of the joints, in MANO's order [rad]."""
        hold = _FINGERS[self.hold]
        rest = rest_fingers()
        pose = np.zeros((*angles.shape[:-2], 15, 3))
        for f, name in enumerate(FINGERS):
            hinges = rest[name].axes[:, 1]
            pose[..., KNUCKLES[f] - 1 : KNUCKLES[f] + 2, :] = angles[..., f, :, None] * hinges
        along, _, back = rest["thumb"].axes[0]
        opposed = frame_from_axes(np.array(hold.thumb_aim), np.array(hold.thumb_pad), np.zeros(3))[:3, :3]
        aside, roll = np.radians(self.steer)
        opposed = opposed @ se3.exp_so3(np.array([0.0, aside, 0.0])) @ se3.exp_so3(np.array([roll, 0.0, 0.0]))
        R = opposed @ np.stack([along, -back, np.cross(along, -back)])
        first = KNUCKLES[0] - 1
        pose[..., first, :] = se3.log_so3(R @ se3.exp_so3(pose[..., first, :]))
        return pose

    def opened(self) -> PosedHand:
        """Return the open hand."""
        return self.posed(np.radians(_FINGERS[self.hold].opened))

    def approach(self, grip: Grip) -> Float[ndarray, "4 4"]:
        """Return ``T_hand_obj`` of the object at the open hand: in contact with the palm, or in the pinch."""
        hold = HOLD_FRAMES[self.hold]
        T_hand_grip = frame_from_axes(np.array(hold.into), np.array(hold.aside), np.array(hold.at))
        T_obj_grip = frame_from_axes(np.array(grip.into), np.array(grip.aside), np.array(grip.at))
        T_hand_obj = T_hand_grip @ se3.inverse(T_obj_grip)
        if self.hold == "pinch":
            return T_hand_obj
        away = np.arange(0.12, -0.04, -0.002)
        offset = away[:, None] * np.array(hold.into) / np.linalg.norm(hold.into)
        palm = self.opened().vertices[self._members(0, wrist=True)]
        X = se3.transform(se3.inverse(T_hand_obj), palm - offset[:, None])
        k = 0
        while k < len(away) - 1 and (gap := float(self.distance(X[k]).min())) >= -CONTACT_DEPTH_M:
            k = min(k + max(int(0.9 * (gap + CONTACT_DEPTH_M) / (away[0] - away[1])), 1), len(away) - 1)
        return se3.rigid(None, offset[k]) @ T_hand_obj

    def close(self, T_hand_obj: Float[ndarray, "A 4 4"]) -> Float[ndarray, "A 5 3"]:
        """Close the hand on the object at each pose; return the joint angles [rad]."""
        angles = np.broadcast_to(np.radians(_FINGERS[self.hold].opened), (len(T_hand_obj), 5, 3))
        angles = self._sweep(angles, T_hand_obj, range(1, 5))
        return self._close_thumb(angles, T_hand_obj, self._other_fingers(angles))

    def _other_fingers(self, angles: Float[ndarray, "A 5 3"]) -> _Obstacles:
        return _Obstacles(self.posed(angles), np.any([self._members(f) for f in range(1, 5)], axis=0))

    def _close_thumb(
        self, angles: Float[ndarray, "A 5 3"], T_hand_obj: Float[ndarray, "A 4 4"], others: _Obstacles
    ) -> Float[ndarray, "A 5 3"]:
        angles = angles.copy()
        angles[:, 0] = np.radians(_FINGERS[self.hold].opened[0])
        return self._sweep(angles, T_hand_obj, range(1), others)

    def _sweep(
        self,
        angles: Float[ndarray, "A 5 3"],
        T_hand_obj: Float[ndarray, "A 4 4"],
        fingers: range,
        obstacles: _Obstacles | None = None,
        steps: int = 14,
    ) -> Float[ndarray, "A 5 3"]:
        """Bend fingers, joint by joint, until they touch the object or, if given, the obstacles."""
        angles, closed = angles.copy(), np.radians(_FINGERS[self.hold].closed)
        t = np.linspace(0.0, 1.0, steps)[:, None, None, None]
        T_obj_hand = se3.inverse(T_hand_obj)
        for stage in range(3):
            goal = angles.copy()
            goal[:, list(fingers), stage:] = closed[list(fingers), stage:]
            frames = joint_transforms(se3.exp_so3(self._pose(angles + t * (goal - angles))), self.hand.joints)
            for f in fingers:
                moving = self._members(f, stage)
                X = skin(self.hand.vertices[moving], self.hand.model.weights[moving], frames, self.hand.joints)
                reach = self._reach(X, T_obj_hand, obstacles)[:, None]
                angles[:, f] += reach * (goal[:, f] - angles[:, f])
        return angles

    def _reach(
        self, X: Float[ndarray, "S A n 3"], T_obj_hand: Float[ndarray, "A 4 4"], obstacles: _Obstacles | None
    ) -> Float[ndarray, "A"]:
        """Position of the first contact along the sweep, in [0, 1]; steps that cannot touch are skipped."""
        Y = se3.transform(T_obj_hand, X)
        stride = np.linalg.norm(np.diff(Y, axis=0), axis=-1).max(axis=(0, 2)) + 1e-9
        gap = np.full(X.shape[:2], np.inf)
        step, left = np.zeros(X.shape[1], dtype=int), np.arange(X.shape[1])
        least = MinSignedDistance(self.distance, X.shape[1], Y[0])
        while left.size:
            at = step[left]
            now = least(Y[at, left], left)
            ahead = np.maximum(np.floor(0.9 * (now + CONTACT_DEPTH_M) / stride[left]).astype(int), 1)
            if obstacles is not None:  # their distance is approximate: look at every step
                now, ahead = np.minimum(now, obstacles.gap(X[at, left], left)), np.ones_like(ahead)
            gap[at, left] = now
            step[left] += ahead
            left = left[(now >= -CONTACT_DEPTH_M) & (step[left] < len(X))]
        return _first_below(gap, -CONTACT_DEPTH_M)

    def gaps(self, angles: Float[ndarray, "A 5 3"], T_hand_obj: Float[ndarray, "A 4 4"]) -> Float[ndarray, "A 6"]:
        """Compute the least signed distance of each finger, thumb first, and of the palm to the object [m]."""
        parts = [self._members(f) for f in range(5)] + [self._members(0, wrist=True)]
        posed = self.posed(angles)
        return np.stack([self._gap(posed, part, T_hand_obj) for part in parts], axis=-1)

    def thumb_miss(self, angles: Float[ndarray, "A 5 3"], T_hand_obj: Float[ndarray, "A 4 4"]) -> float:
        """Compute the thumb's maximum distance from the object, or its depth beyond that to which flesh yields [m]."""
        gap = self._gap(self.posed(angles), self._members(0), T_hand_obj)
        return float(np.maximum(gap, -gap - FLESH_COMPLIANCE_M).max())

    def _gap(
        self, posed: PosedHand, part: Bool[ndarray, "V"], T_hand_obj: Float[ndarray, "A 4 4"]
    ) -> Float[ndarray, "A"]:
        """Least signed distance of a part of the hand to the object [m]."""
        X = se3.transform(se3.inverse(T_hand_obj), posed.vertices[:, part])
        return np.asarray(self.distance(X).min(axis=1))

    def steered(self, angles: Float[ndarray, "A 5 3"], T_hand_obj: Float[ndarray, "A 4 4"]) -> Grasper:
        """Turn the thumb as little as possible so that it touches the object at its first, middle and last pose.

        ``angles`` are those of the closed hand.
        """
        some = [0, len(angles) // 2, -1]
        others = self._other_fingers(angles[some])

        def miss(grasper: Grasper) -> float:
            closed = grasper._close_thumb(angles[some], T_hand_obj[some], others)
            return grasper.thumb_miss(closed, T_hand_obj[some])

        best, least = self, miss(self)
        for rolls in ((0.0,), (-20.0, 20.0)):
            for steer in [(aside, roll) for aside in THUMB_ABDUCTION_ANGLES_DEG for roll in rolls]:
                if least > MAX_HOLD_GAP_M and (off := miss(replace(self, steer=steer))) < least - MAX_HOLD_GAP_M / 2.0:
                    best, least = replace(self, steer=steer), off
        return best

    def _members(self, finger: int, stage: int = 0, wrist: bool = False) -> Bool[ndarray, "V"]:
        """Vertices that move with a finger's joints from ``stage`` on; or, for the wrist, with no joint (the palm)."""
        weights = self.hand.model.weights
        if wrist:
            return np.asarray(weights[:, 0] > 0.5)
        first = KNUCKLES[finger]
        return np.asarray(weights[:, first + stage : first + 3].sum(axis=1) > 0.5)


def looseness(gaps: Float[ndarray, "6"], hold: Literal["palm", "pinch"]) -> float:
    """Sum the gaps of the fingers that ought to touch, and tenfold excess depths, of a closed hand [m]."""
    parts = gaps if hold == "palm" else gaps[:3]
    return float(np.clip(parts, 0.0, 0.02).sum() + 10.0 * np.maximum(-gaps - FLESH_COMPLIANCE_M, 0.0).sum())


def _first_below(gap: Float[ndarray, "S A"], level: float) -> Float[ndarray, "A"]:
    """Position in [0, 1] along the first axis where the gap first falls below a level (linear); 1 if never."""
    below = gap < level
    k = np.argmax(below, axis=0)
    column = np.arange(gap.shape[1])
    before, after = gap[np.maximum(k - 1, 0), column], gap[k, column]
    part = np.where(k > 0, (before - level) / np.maximum(before - after, 1e-12), 0.0)
    t = (k - 1 + part) / (len(gap) - 1)
    return np.where(below.any(axis=0), np.maximum(t, 0.0), 1.0)
