"""The surfaces of hand and object coloured by contact, and the gap between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, decimate, edge_length, subdivide_parts, subdivide_surface, vertex_normals
from getagrip.geometry.rasterize import render_rgb
from getagrip.metrics.contact import close_holes, moving_distance
from getagrip.report.pictures.panels import PAPER_RGB, RESULT_COLOUR, look_at
from getagrip.report.pictures.result_view import View

FRAME_CONTACT_COLOURS, CONTACT_SHARE_COLOURS = ("#c9cdcf", RESULT_COLOUR), ("#c9cdcf", "#f0c05a", RESULT_COLOUR)
"""Colours of a surface: out of contact and in contact; and by the fraction of frames in contact, from 0 to 1."""
N_CONTACT_VERTICES = 12_000
"""Approximate number of vertices of the object's coloured surface."""
CONTACT_BORDER_M = 0.0015
"""Half the width of the border over which contact colours fade, so that single faces do not show [m]."""
HAND_VIEW_ANGLE_RAD = np.radians(50.0)
"""Angle to both sides of the palm's contact direction from which the hand is rendered."""
MAX_VIEW_FACES = 20_000
"""Approximate number of faces to which larger meshes are decimated."""
MIN_GAP_VERTICES = 6_000
"""Approximate minimum number of vertices of the object's mesh for the gap, so that an edge inside the hand has some."""
GAP_SEARCH_DISTANCE_M = 0.03
"""Distance from the hand within which the object's vertices count for the gap [m]; beyond, the hand's suffice."""


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """A surface in its own frame, with its contact in each of T frames.

    Attributes:
        vertices: (T, V, 3) [m].
        faces: (F, 3) vertex ids.
        contact: (T, V) 1 in contact, 0 not; fades over twice ``CONTACT_BORDER_M`` between the two.
        sides: (2, 3) two directions to look from.
        up: (3,) upward direction of pictures.
    """

    vertices: Float[ndarray, "T V 3"]
    faces: Int[ndarray, "F 3"]
    contact: Float[ndarray, "T V"]
    sides: Float[ndarray, "2 3"]
    up: Float[ndarray, "3"]

    def at_frame(self, n: int, side: int, size: int) -> UInt8[ndarray, "size size 3"]:
        """Render frame ``n`` from a side, in the colours ``FRAME_CONTACT_COLOURS``."""
        return self._picture(n, self.contact[n], FRAME_CONTACT_COLOURS, side, size)

    def over_all(self, side: int, size: int) -> UInt8[ndarray, "size size 3"]:
        """Render the fraction of frames in contact on the middle frame's surface, in ``CONTACT_SHARE_COLOURS``."""
        return self._picture(len(self.vertices) // 2, self.contact.mean(axis=0), CONTACT_SHARE_COLOURS, side, size)

    def _picture(
        self, n: int, share: Float[ndarray, "V"], ramp: Sequence[str], side: int, size: int
    ) -> UInt8[ndarray, "size size 3"]:
        from matplotlib.colors import LinearSegmentedColormap

        colours = LinearSegmentedColormap.from_list("share", ramp)(share)[:, :3]
        eye = look_at(self.vertices[n], self.sides[side], self.up, size)
        posed = se3.transform(eye.T_view_frame, self.vertices[n])
        return render_rgb([(posed, self.faces, colours)], eye.K, (size, size), PAPER_RGB)


def contact_surfaces(view: View, threshold: float) -> tuple[ContactSurface, ContactSurface]:
    """Return the scaled object in its frame and the hand in the hand frame; contact is within ``threshold`` [m]."""
    clip, T_hand_obj = view.clip, view.result.T_hand_obj
    surface, T = subdivide_object(view), len(T_hand_obj)
    grasped, faces, hand = view.result.scale * surface.vertices, surface.faces, clip.hand.vertices
    on_object, on_hand = (
        np.clip(0.5 + (threshold - d) / (2 * CONTACT_BORDER_M), 0.0, 1.0)
        for d in surface_distances(view, surface, threshold + CONTACT_BORDER_M)
    )

    middle = T // 2
    R_hand = clip.hand.T_cam_hand[middle, :3, :3].T  # camera to hand
    R_obj = T_hand_obj[middle, :3, :3].T @ R_hand
    most = _mean_contact_normal(grasped, faces, on_object, -R_obj[:, 2])
    palm = _mean_contact_normal(hand[middle], clip.hand.faces, on_hand, -R_hand[:, 2])
    fingers = hand[middle, clip.hand.regions["middle"]].mean(axis=0) - hand[middle].mean(axis=0)
    about = fingers / max(float(np.linalg.norm(fingers)), 1e-9)
    beside = np.array([se3.exp_so3(sign * HAND_VIEW_ANGLE_RAD * about) @ palm for sign in (-1.0, 1.0)])
    tiled, up = np.tile(grasped, (T, 1, 1)), _nearest_up_axis(-R_obj[:, 1], most)
    of_object = ContactSurface(tiled, faces, on_object, np.array([most, -most]), up)
    return of_object, ContactSurface(hand, clip.hand.faces, on_hand, beside, fingers)


def subdivide_object(view: View) -> Mesh:
    """Subdivide the object's mesh to about ``N_CONTACT_VERTICES`` vertices, fine enough for the border of contact.

    Colours are interpolated.
    """
    mesh, colours = view.clip.mesh, np.zeros((len(view.clip.mesh.vertices), 0))
    if mesh.colours is not None:
        colours = mesh.colours.astype(float)
    longest = edge_length(float(mesh.vertex_areas.sum()), N_CONTACT_VERTICES)
    made, faces = subdivide_surface(np.concatenate([mesh.vertices, colours], axis=1), mesh.faces, longest)
    vertices, fine = np.split(made, [3], axis=1)
    return Mesh(vertices, faces, None if mesh.colours is None else fine.round().astype(np.uint8))


def surface_distances(view: View, surface: Mesh, reach: float) -> tuple[Float[ndarray, "T V"], Float[ndarray, "T W"]]:
    """Compute the distances of the vertices of ``surface`` to the hand, and vice versa, exact up to ``reach`` [m]."""
    scale, hand, faces = view.result.scale, view.clip.hand.vertices, view.clip.hand.faces
    coarse, T_hand_obj = scale * view.clip.mesh.vertices, view.result.T_hand_obj
    in_hand = se3.transform(T_hand_obj, scale * surface.vertices)
    in_object = se3.transform(se3.inverse(T_hand_obj), hand)
    to_hand = moving_distance(in_hand, *close_holes(hand, faces), reach)
    return to_hand, moving_distance(in_object, np.tile(coarse, (len(hand), 1, 1)), view.clip.mesh.faces, reach)


def _mean_contact_normal(
    vertices: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    contact: Float[ndarray, "T V"],
    instead: Float[ndarray, "3"],
) -> Float[ndarray, "3"]:
    """Return the mean normal of the surface in contact, or ``instead`` without contact."""
    mean = contact.mean(axis=0) @ vertex_normals(vertices, faces)
    return np.asarray(mean if np.linalg.norm(mean) > 1e-9 else instead)


def _nearest_up_axis(up: Float[ndarray, "3"], side: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    """Return the signed coordinate axis nearest to ``up`` among those visible from ``side``."""
    across = np.abs(side) < 0.8 * np.linalg.norm(side)
    best = int(np.argmax(np.abs(up) * across))
    return np.asarray(np.eye(3)[best] * (1.0 if up[best] >= 0.0 else -1.0))


def decimate_view(view: View) -> View:
    """Return the view with a mesh of at most about ``MAX_VIEW_FACES`` faces."""
    return replace(view, clip=replace(view.clip, mesh=decimate(view.clip.mesh, MAX_VIEW_FACES)))


def surface_gap(view: View) -> Float[ndarray, "T"]:
    """Compute the smallest signed distance of either hand and the object in each frame [m]; negative in penetration.

    The minimum over the hand's vertices to the object and the object's vertices to the hand. A mesh of more than
    ``MAX_VIEW_FACES`` faces should be decimated first (``decimate_view``).
    """
    out = _own_hand_gap(view)
    if (seen := view.by_other_hand()) is not None:
        known = view.clip.hand_known(view.clip.other_side)
        out[known] = np.minimum(out[known], _own_hand_gap(seen))
    return out


def _own_hand_gap(view: View) -> Float[ndarray, "T"]:
    T_hand_obj, hand = view.result.T_hand_obj, view.clip.hand
    grasped = Mesh(view.result.scale * view.clip.mesh.vertices, view.clip.mesh.faces)
    surface, faces = close_holes(grasped.vertices, grasped.faces)
    in_object = se3.transform(se3.inverse(T_hand_obj), hand.vertices)
    of_hand = moving_distance(in_object, np.broadcast_to(surface, (len(in_object), *surface.shape)), faces)
    in_hand = se3.transform(T_hand_obj, subdivide_parts([grasped], MIN_GAP_VERTICES)[0].vertices)
    least = of_hand.min(axis=1)  # farther vertices of the object change nothing
    reach = min(GAP_SEARCH_DISTANCE_M, max(float(least.max()), 0.0))
    of_object = moving_distance(in_hand, *close_holes(hand.vertices, hand.faces), reach)
    return np.asarray(np.minimum(least, of_object.min(axis=1)))
