"""Order in depth: where the image shows the hand, the object is not in front of it; where it shows the object, it is.

A silhouette says nothing about pixels that the hand hides. But a thumb that is seen lies before the object, and a
fingertip that is not seen behind it: on the ray through a point of the hand, the object's surface is farther or nearer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from numpy import ndarray

from getagrip.clip import HandTrack, Masks
from getagrip.compiling import kernel
from getagrip.fitting.energy.contact import farthest_point_sampling, mirror_upper
from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.geometry.rasterize import depth_and_face

MAX_RAYCAST_FACES = 400
"""Maximum number of faces of the mesh that rays are cast at."""
N_ORDER_POINTS = 80
"""Points of the hand."""
HAND_SURFACE_TOLERANCE_M = 0.006
"""Distance behind the hand's nearest surface up to which a point counts as visible [m]."""
MASK_BORDER_MARGIN_M = 0.006
"""Distance to a mask's border below which a point's side is unknown, since the hand is not exact [m]."""
MIN_GRAZING_COSINE = 0.1
"""Minimum cosine between a ray and the surface's normal, in the derivatives."""


@dataclass(frozen=True)
class HandOrder:
    """Points of the hand on rays from the camera.

    Attributes:
        position: (N, Q, 3) the points in the camera frame [m].
        side: (N, Q) 1 where the image shows the point, -1 where it shows the object there, 0 where neither is known.
    """

    position: Float[ndarray, "N Q 3"]
    side: Int8[ndarray, "N Q"]

    @staticmethod
    def of(hand: HandTrack, K: Float[ndarray, "N 3 3"], masks: Masks) -> HandOrder:
        """Read the sides off the masks of the hand and of the object."""
        import cv2

        chosen = farthest_point_sampling(hand.vertices[0], N_ORDER_POINTS)
        whole = se3.transform(hand.T_cam_hand, hand.vertices)
        position = whole[:, chosen]
        side = np.zeros(position.shape[:2], np.int8)
        assert masks.hand is not None
        height, width = masks.object.shape[1:]
        for n, X in enumerate(position):
            near = max(1, round(MASK_BORDER_MARGIN_M * K[n, 0, 0] / max(float(X[:, 2].mean()), 1e-3)))
            near = min(near, width, height)
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * near + 1, 2 * near + 1))
            depth, _ = depth_and_face(whole[n], hand.faces, K[n], (width, height))
            u, v = np.floor(np.nan_to_num(project(K[n], X), posinf=-1.0, neginf=-1.0)).astype(int).T
            there = (X[:, 2] > 0.0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
            u, v = np.where(there, u, 0), np.where(there, v, 0)
            seen, hidden = (_disc_in_mask(mask[n], u, v, disc > 0) for mask in (masks.hand, masks.object))
            side[n, there & seen & (X[:, 2] < depth[v, u] + HAND_SURFACE_TOLERANCE_M)] = 1
            side[n, there & hidden] = -1
        return HandOrder(position, side)

    def take(self, index: Int[ndarray, "n"]) -> HandOrder:
        """Return the points in some of the frames."""
        return replace(self, position=self.position[index], side=self.side[index])


def _disc_in_mask(
    mask: Bool[ndarray, "H W"], u: Int[ndarray, "Q"], v: Int[ndarray, "Q"], disc: Bool[ndarray, "k k"]
) -> Bool[ndarray, "Q"]:
    """Erode a mask at some pixels: mark those whose disc, cut at the image's border, lies in the mask.

    Eroding all of a large image takes a hundred times as long.
    """
    near, out = len(disc) // 2, np.zeros(len(u), dtype=bool)
    for n, (x, y) in enumerate(zip(u.tolist(), v.tolist(), strict=True)):
        left, top = max(x - near, 0), max(y - near, 0)
        part = mask[top : y + near + 1, left : x + near + 1]
        rows, cols = slice(top - y + near, None), slice(left - x + near, None)
        out[n] = part[disc[rows, cols][: part.shape[0], : part.shape[1]]].all()
    return out


def corners_of(mesh: Mesh) -> Float[ndarray, "F 3 3"]:
    """Return the faces that rays are cast at, about the mesh's centre."""
    coarse = decimate(mesh, MAX_RAYCAST_FACES)
    return np.ascontiguousarray((coarse.vertices - mesh.centre)[coarse.faces])


@dataclass(frozen=True)
class OrderTerm:
    """``weight * mean over points of min(cap, max(0, side (length - t) - tolerance))``.

    t is the distance to the first surface of the object on the ray to the point, ``length`` that of the point.
    """

    corners: Float[ndarray, "F 3 3"]
    hand: HandOrder
    weight: Float[ndarray, "N"]
    """Energy per metre of the mean, per frame [px^2 / m]."""
    tolerance: float = 0.004
    """Error that costs nothing [m]."""
    cap: float = 0.04
    """Largest error that counts; beyond it a point costs no more, and does not pull [m]."""
    delta: float = 0.002
    """Errors below this count as this in the curvature [m]."""
    name: str = "order"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses)
        reach = float(np.sqrt((self.corners**2).sum(axis=-1).max()))
        _evaluate_order(
            poses.R, poses.centre, poses.scale, self.corners, reach, self.hand.position, self.hand.side, self.weight,
            self.tolerance, self.cap, self.delta, bound, found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel()
def _first_hit(origin, ray, corners):
    """Return the distance along a ray to the first face, and the face; infinity and -1 without a hit."""
    nearest, face = np.inf, -1
    for f in range(len(corners)):
        ax, ay, az = corners[f, 0, 0], corners[f, 0, 1], corners[f, 0, 2]
        e0, e1, e2 = corners[f, 1, 0] - ax, corners[f, 1, 1] - ay, corners[f, 1, 2] - az
        f0, f1, f2 = corners[f, 2, 0] - ax, corners[f, 2, 1] - ay, corners[f, 2, 2] - az
        p0, p1, p2 = ray[1] * f2 - ray[2] * f1, ray[2] * f0 - ray[0] * f2, ray[0] * f1 - ray[1] * f0
        det = e0 * p0 + e1 * p1 + e2 * p2
        if abs(det) < 1e-14:
            continue
        s0, s1, s2 = origin[0] - ax, origin[1] - ay, origin[2] - az
        a = (s0 * p0 + s1 * p1 + s2 * p2) / det
        if a < 0.0 or a > 1.0:
            continue
        q0, q1, q2 = s1 * e2 - s2 * e1, s2 * e0 - s0 * e2, s0 * e1 - s1 * e0
        b = (ray[0] * q0 + ray[1] * q1 + ray[2] * q2) / det
        if b < 0.0 or a + b > 1.0:
            continue
        t = (f0 * q0 + f1 * q1 + f2 * q2) / det
        if 0.0 < t < nearest:
            nearest, face = t, f
    return nearest, face


@kernel()
def _add_order_residual(sign, ray, t, face, R, centre, unit, delta, error, g, H):
    """Add ``unit error`` to the normal equations, for a hit at ``t ray`` on a face.

    Moving the object by the local 7-vector (v, w, l) changes t by ``n . (v + w x r + l r) / (n . ray)``, r the point
    from the object's centre, n the face's normal. Only the upper half of H is filled.
    """
    e0, e1, e2 = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1], face[1, 2] - face[0, 2]
    f0, f1, f2 = face[2, 0] - face[0, 0], face[2, 1] - face[0, 1], face[2, 2] - face[0, 2]
    m0, m1, m2 = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
    n0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
    n1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
    n2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
    into = n0 * ray[0] + n1 * ray[1] + n2 * ray[2]
    least = MIN_GRAZING_COSINE * np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    if abs(into) < least:
        into = least if into > 0.0 else -least
    k = -sign / into
    r0, r1, r2 = t * ray[0] - centre[0], t * ray[1] - centre[1], t * ray[2] - centre[2]
    a = (
        k * n0, k * n1, k * n2, k * (r1 * n2 - r2 * n1), k * (r2 * n0 - r0 * n2), k * (r0 * n1 - r1 * n0),
        k * (r0 * n0 + r1 * n1 + r2 * n2),
    )  # fmt: skip
    h = unit / max(error, delta)
    for i in range(7):
        g[i] += unit * a[i]
        for j in range(i, 7):
            H[i, j] += h * a[i] * a[j]


@kernel()
def _order_error(sign, point, R, centre, scale, corners, reach, origin, local, ray):
    """Return how far a point is on the wrong side of the surface [m], the surface's distance, and its face, -1: none.

    Fills in the ray to the point.
    """
    length = np.sqrt(point[0] ** 2 + point[1] ** 2 + point[2] ** 2)
    along = 0.0
    for i in range(3):
        ray[i] = point[i] / length
        along += ray[i] * centre[i]
    off = centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2 - along * along
    if off > (scale * reach) ** 2:  # the ray misses the ball around the object
        return 0.0, 0.0, -1
    for i in range(3):
        local[i] = R[0, i] * ray[0] + R[1, i] * ray[1] + R[2, i] * ray[2]
        origin[i] = -(R[0, i] * centre[0] + R[1, i] * centre[1] + R[2, i] * centre[2]) / scale
    t, face = _first_hit(origin, local, corners)
    return sign * (length - scale * t), scale * t, face


@kernel("f4 f3 f1 f3 f f3 t2 f1 f f f f1 f2 f3 f4")
def _evaluate_order(
    R, centre, scale, corners, reach, hand, side, weight, tolerance, cap, delta, bound, value, g, H
):  # fmt: skip
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    Q = hand.shape[1]
    origin, local, ray = np.empty(3), np.empty(3), np.empty(3)
    for b in range(B):
        if not bound[b] >= 0.0:  # the step is rejected already, or no number
            continue
        for n in range(N):
            unit = weight[n] / Q
            for q in range(Q):
                sign = side[n, q]
                if sign == 0:
                    continue
                error, t, face = _order_error(
                    sign, hand[n, q], R[b, n], centre[b, n], scale[b], corners, reach, origin, local, ray
                )  # fmt: skip
                error -= tolerance
                if face >= 0 and error > 0.0:
                    value[b, n] += unit * min(error, cap)
                    if error < cap:
                        _add_order_residual(
                            sign, ray, t, corners[face], R[b, n], centre[b, n], unit, delta, error, g[b, n], H[b, n]
                        )  # fmt: skip
            mirror_upper(H[b, n])
