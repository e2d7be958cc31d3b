"""Contact of hand and object: where it is, how stable (SCA), and the depth of penetration.

Stable contact area: the mean, over pairs of frames i < j, of IOU(S_i, S_j), S_i the points in contact in frame i
(paper, Sec. 5.2). A point is in contact where its signed distance to the other surface is at most a threshold; inside
it counts at any depth. There are three sets of points:

- ``object``: the object's vertices, against the hand, as in the paper;
- ``hand``: the hand's vertices, against the object, as in the authors' later code;
- ``area``: points sampled evenly over the object's surface, against the hand, independent of the triangulation (a box
  has eight vertices, none of them in the grasp).

Two empty sets have IOU 0, as in the authors' code: a hand that never touches is no stable grasp.

SCA compares equal points in two frames. An object with a new mesh in each frame, as systems without a CAD model
reconstruct it, has no corresponding points: only the ``hand`` side can be measured. All sides can where the meshes
share their faces: one mesh that moves or deforms.
"""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.errors import GetagripError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, edge_table
from getagrip.io.options import check_values
from getagrip.metrics.pose import ObjectTrack
from getagrip.metrics.symmetry import points_at_samples, surface_points, surface_samples

MAX_SCENE_COORDINATE_M = 1e5
"""Maximum coordinate of any point of a scene [m]."""
MAX_CACHED_SURFACES, MAX_CACHED_SURFACE_FACES = 64, 2000
"""Maximum number of surfaces whose search trees are cached (the hands of the latest frames), and of a cached surface's
faces: together 50 MB."""
Side = Literal["object", "hand", "area"]
CONTACT_SIDES: tuple[Side, ...] = get_args(Side)
CONTACT_THRESHOLDS_M = (0.0, 0.005, 0.010)
"""Contact thresholds of ``CONTACT_DEFINITIONS`` [m]."""
MAX_SIGNED_DISTANCE_M = 0.011
"""Signed distance up to which values are exact [m]; beyond, they may be infinite."""
MAX_CONTACT_THRESHOLD_MM = 50.0
"""Maximum threshold of a definition of contact [mm]."""
N_AREA_SAMPLES = 2000
_POINT_DESCRIPTIONS: dict[Side, str] = {
    "object": "object vertices",
    "hand": "hand vertices",
    "area": "object points by area",
}


def signed_distance(
    points: Float[ndarray, "P 3"],
    vertices: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    max_distance: float = np.inf,
) -> Float[ndarray, "P"]:
    """Compute the distance [m] of points to a surface, negative inside; beyond ``max_distance`` it may be infinite.

    Inside is where the winding number exceeds a half (Barill et al., "Fast Winding Numbers for Soups and Clouds",
    2018), which is right for bodies of overlapping closed parts, too, where the nearest surface's normal misleads.
    """
    return moving_distance(points[None], vertices[None], faces, max_distance)[0]


def moving_distance(
    points: Float[ndarray, "T P 3"],
    vertices: Float[ndarray, "T V 3"],
    faces: Int[ndarray, "F 3"],
    max_distance: float = np.inf,
) -> Float[ndarray, "T P"]:
    """Compute ``signed_distance`` of moving points to a moving surface.

    From frame to frame a distance changes by at most the displacements of point and surface, and its sign changes only
    at zero. Distances that are thus known to exceed ``max_distance``, and sides that are known to be unchanged, are not
    computed again. Raises ``GetagripError`` for coordinates beyond all scenes, at which libigl would exhaust memory.
    """
    if not max(np.abs(points).max(initial=0.0), np.abs(vertices).max(initial=0.0)) < MAX_SCENE_COORDINATE_M:
        limit = f"{MAX_SCENE_COORDINATE_M:g} m away, or of no number"
        raise GetagripError(f"distances of points more than {limit}, are not computed")

    closed = bool(np.all(edge_table(faces)[:, 3] < len(faces)))  # an open surface can be entered without crossing it
    inside, least = np.zeros(points.shape[1], dtype=bool), np.full(points.shape[1], -np.inf)
    out = np.full(points.shape[:2], np.inf)
    moved = np.inf
    for n, (x, surface) in enumerate(zip(points, vertices, strict=True)):
        if n > 0:
            moved = np.linalg.norm(surface - vertices[n - 1], axis=1).max()
            step = x - points[n - 1]
            least -= np.sqrt(np.einsum("pk,pk->p", step, step)) + moved + 1e-9
        if moved > 0.0:
            here = _SearchSurface.of(surface, faces)
        sides = np.maximum(surface.min(axis=0) - x, x - surface.max(axis=0))
        outside = np.maximum(np.maximum(sides[:, 0], sides[:, 1]), sides[:, 2])  # distance from the bounding box
        boxed = outside <= 0.0
        unsure = np.flatnonzero(boxed & ((least <= 0.0) | (not closed)))
        if unsure.size:
            inside[unsure] = here.encloses(x[unsure])
        inside &= boxed
        asked = np.flatnonzero((outside <= max_distance) & (inside | (least <= max_distance)))
        if asked.size:
            least[asked] = here.distance(x[asked])
            out[n, asked] = np.where(inside[asked], -least[asked], least[asked])
    return out


@dataclass(frozen=True)
class _SearchSurface:
    """A static surface and its search trees, each made on first use."""

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]

    @staticmethod
    def of(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> _SearchSurface:
        """Return a surface, cached if it is small: results that are compared on a clip share its hand."""
        vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
        if len(faces) > MAX_CACHED_SURFACE_FACES:
            return _SearchSurface(vertices, faces)
        return _cached_surface(vertices.tobytes(), faces.tobytes())

    def distance(self, points: Float[ndarray, "P 3"]) -> Float[ndarray, "P"]:
        """Compute the unsigned distance of points [m]."""
        return np.sqrt(self._tree.squared_distance(self.vertices, self.faces, points)[0])

    def encloses(self, points: Float[ndarray, "P 3"]) -> Bool[ndarray, "P"]:
        """Return whether points are inside, by their winding numbers."""
        return np.abs(self._winding.winding_number(points)) > 0.5

    @cached_property
    def _tree(self) -> Any:
        import igl

        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    @cached_property
    def _winding(self) -> Any:
        import igl

        winding = igl.FastWindingNumberBVH()
        winding.init(self.vertices, self.faces)
        return winding


@lru_cache(maxsize=MAX_CACHED_SURFACES)
def _cached_surface(vertices: bytes, faces: bytes) -> _SearchSurface:
    return _SearchSurface(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 3))


atexit.register(_cached_surface.cache_clear)  # libigl's bindings report trees that outlive them as leaks


def close_holes(
    vertices: Float[ndarray, "*batch V 3"], faces: Int[ndarray, "F 3"]
) -> tuple[Float[ndarray, "*batch W 3"], Int[ndarray, "G 3"]]:
    """Close each hole, such as MANO's wrist, by a fan of faces about the mean of its border."""
    edges = edge_table(faces)
    border = edges[edges[:, 3] == len(faces), :2]
    if not len(border):
        return vertices, faces
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    V = vertices.shape[-2]
    linked = coo_array((np.ones(len(border)), (border[:, 0], border[:, 1])), shape=(V, V))
    _, hole = np.unique(connected_components(linked, directed=False)[1][border[:, 0]], return_inverse=True)
    # The means of all borders at once: a triangle soup has as many holes as faces.
    around = coo_array((np.ones(len(border)), (hole, border[:, 0])), shape=(int(hole.max()) + 1, V)).tocsr()
    flat = np.moveaxis(vertices, -2, 0).reshape(V, -1)
    tips = (around @ flat / around.sum(axis=1)[:, None]).reshape(-1, *vertices.shape[:-2], 3)
    tips = np.moveaxis(tips, 0, -2)
    fan = np.stack([border[:, 1], border[:, 0], V + hole], axis=1)
    return np.concatenate([vertices, tips], axis=-2), np.concatenate([faces, fan])


@dataclass(frozen=True)
class ContactDefinition:
    """A definition of contact: points and a distance.

    Attributes:
        side: the tested points, a field of ``ContactDistances``.
        threshold: maximum signed distance to the other surface [m].
    """

    side: Side
    threshold: float

    def __post_init__(self) -> None:
        check_values(self)

    @property
    def distance(self) -> str:
        """The threshold as text."""
        return f"{1e3 * self.threshold:g} mm"

    @property
    def key(self) -> str:
        """The definition's part of a metric's key: ``object_10mm``."""
        return f"{self.side}_{1e3 * self.threshold:g}mm"

    @property
    def description(self) -> str:
        """The definition in words: "object vertices within 10 mm"."""
        return f"{_POINT_DESCRIPTIONS[self.side]} within {self.distance}"


def contact_definitions_at(thresholds: Sequence[float]) -> tuple[ContactDefinition, ...]:
    """Return the paper's definition, by object vertices, at thresholds of 0 to ``MAX_CONTACT_THRESHOLD_MM``.

    Raises ``UsageError`` for others.
    """
    bad = next((mm for mm in thresholds if not 0.0 <= mm <= MAX_CONTACT_THRESHOLD_MM), None)
    if bad is not None:
        raise UsageError(f"--contact must be 0 to {MAX_CONTACT_THRESHOLD_MM:g} mm (got {bad:g} mm)")
    return tuple(dict.fromkeys(ContactDefinition("object", mm / 1e3) for mm in thresholds))


CONTACT_DEFINITIONS = tuple(
    ContactDefinition(side, threshold) for side in CONTACT_SIDES for threshold in CONTACT_THRESHOLDS_M
)
"""All definitions that are evaluated by default."""


@dataclass(frozen=True)
class ContactDistances:
    """Signed distances [m] of hand and object in each frame, negative inside; exact to ``MAX_SIGNED_DISTANCE_M``.

    Attributes:
        object: (T, Vo) object vertices to the hand.
        hand: (T, Vh) hand vertices to the object.
        area: (T, P) points sampled evenly over the object to the hand.
    """

    object: Float[ndarray, "T Vo"]
    hand: Float[ndarray, "T Vh"]
    area: Float[ndarray, "T P"]

    def take(self, index: Int[ndarray, "n"]) -> ContactDistances:
        """Return the distances of some frames."""
        return ContactDistances(self.object[index], self.hand[index], self.area[index])

    def contact(self, side: Side, threshold: float) -> Bool[ndarray, "T _"]:
        """Return whether points are in contact: signed distance at most ``threshold`` [m]."""
        distance: ndarray = getattr(self, side)
        return distance <= threshold

    def depth(self, side: Side) -> Float[ndarray, "T _"]:
        """Return each point's depth inside the other body [m]; zero outside."""
        distance: ndarray = getattr(self, side)
        return np.maximum(-distance, 0.0)


def contact_distances(
    mesh: Mesh,
    tracks: Sequence[ObjectTrack],
    hand_vertices: Float[ndarray, "T V 3"],
    hand_faces: Int[ndarray, "F 3"],
    max_distance: float = MAX_SIGNED_DISTANCE_M,
) -> list[ContactDistances]:
    """Compute distances between an object and a hand (in the hand frame), both ways, for each track of the object.

    They are exact up to ``max_distance`` [m]. The hand's holes are closed. Tracks share the hand's search trees.
    """
    points = np.concatenate([mesh.vertices, surface_points(mesh, N_AREA_SAMPLES)])
    V, P = len(mesh.vertices), len(points)
    in_hand = np.concatenate([se3.transform(track.T_ref_obj, track.scale * points) for track in tracks], axis=1)
    to_hand = moving_distance(in_hand, *close_holes(hand_vertices, hand_faces), max_distance)
    out = []
    for k, track in enumerate(tracks):
        in_object = se3.transform(se3.inverse(track.T_ref_obj), hand_vertices)
        vertices = np.broadcast_to(track.scale * mesh.vertices, (len(in_object), V, 3))
        to_object = moving_distance(in_object, vertices, mesh.faces, max_distance)
        out.append(ContactDistances(to_hand[:, k * P : k * P + V], to_object, to_hand[:, k * P + V : (k + 1) * P]))
    return out


@dataclass(frozen=True)
class StableContact:
    """The stability of contact by one definition.

    Attributes:
        sca: stable contact area: mean over pairs of different frames.
        diagonal: the mean over all pairs, including each frame with itself.
        share: (T,) fraction of points in contact, in each frame.
    """

    sca: float
    diagonal: float
    share: Float[ndarray, "T"]


def stable_contact(distances: ContactDistances, definition: ContactDefinition) -> StableContact:
    """Measure the stable contact of a sequence."""
    contact = distances.contact(definition.side, definition.threshold)
    overlap = pairwise_iou(contact)
    return StableContact(
        stable_contact_area(overlap), stable_contact_area(overlap, diagonal=True), contact.mean(axis=1)
    )


def pairwise_iou(contact: Bool[ndarray, "T P"]) -> Float[ndarray, "T T"]:
    """Compute the IOU of the contact sets of every pair of frames; 0 for two empty sets, even of the same frame."""
    bits = np.packbits(contact, axis=1)
    both = np.stack([np.bitwise_count(bits & row).sum(axis=1, dtype=float) for row in bits])
    count = np.diag(both)
    either = count[:, None] + count[None, :] - both
    return np.where(either > 0, both / np.maximum(either, 1.0), 0.0)


def stable_contact_area(overlap: Float[ndarray, "T T"], diagonal: bool = False) -> float:
    """Compute SCA from the pairwise IOU: the mean over pairs i < j (the paper's), or over the full T x T matrix.

    With the diagonal (the authors' code) each frame is paired with itself, too: contacts that never overlap then score
    1 / T. NaN without any pair.
    """
    if diagonal:
        return float(overlap.mean())
    T = len(overlap)
    return float(overlap[np.triu_indices(T, k=1)].mean()) if T > 1 else float("nan")


def mesh_distances(
    meshes: Sequence[Mesh | None], hand_vertices: Float[ndarray, "T V 3"], hand_faces: Int[ndarray, "F 3"]
) -> tuple[ContactDistances, tuple[Side, ...]]:
    """Compute distances between each frame's mesh and a hand, both in the hand frame; also return comparable sides.

    Frames without a mesh have infinite distances. Where the numbers of vertices differ, ``object`` is padded with
    infinite distances; where sides are not comparable, ``area`` has no points.
    """
    known = [mesh for mesh in meshes if mesh is not None]
    same = bool(known) and all(np.array_equal(mesh.faces, known[0].faces) for mesh in known)
    face, along = np.zeros(0, int), np.zeros((0, 2))
    if known:
        face, along = surface_samples(known[0], N_AREA_SAMPLES if same else 0)
    hands, faces = close_holes(hand_vertices, hand_faces)
    T = len(meshes)
    out = ContactDistances(
        object=np.full((T, max((len(mesh.vertices) for mesh in known), default=1)), np.inf),
        hand=np.full((T, hand_vertices.shape[1]), np.inf),
        area=np.full((T, len(face)), np.inf),
    )
    for n, mesh in enumerate(meshes):
        if mesh is not None:
            V = len(mesh.vertices)
            points = np.concatenate([mesh.vertices, points_at_samples(mesh, face, along)])
            to_hand = signed_distance(points, hands[n], faces, MAX_SIGNED_DISTANCE_M)
            out.object[n, :V], out.area[n] = to_hand[:V], to_hand[V:]
            out.hand[n] = signed_distance(hand_vertices[n], mesh.vertices, mesh.faces, MAX_SIGNED_DISTANCE_M)
    return out, CONTACT_SIDES if same else ("hand",)
