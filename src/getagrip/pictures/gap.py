"""The distance of hand and object, as reports and ``view`` show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.geometry.subdivide import fine
from getagrip.metrics.contact import close_holes, moving_distance
from getagrip.pictures.shown import View

FACES = 20_000
"""Number of faces to which larger meshes are decimated, about."""
VERTICES = 6_000
"""Least number of vertices of a mesh, about, so that an edge inside the hand has some."""
REACH = 0.03
"""The object's vertices count within this distance of the hand [m]; beyond, the hand's alone are near enough."""


def coarse(view: View) -> View:
    """Return the view with a mesh of at most about ``FACES`` faces."""
    return replace(view, clip=replace(view.clip, mesh=decimate(view.clip.mesh, FACES)))


def gap(view: View) -> Float[ndarray, "T"]:
    """Compute the smallest signed distance [m] of either hand and the object in each frame; below 0 they penetrate.

    It is the least over the hand's vertices, to the object, and the object's, to the hand. Of a mesh with more than
    ``FACES`` faces it is to be that of ``coarse``.
    """
    out = _of_own_hand(view)
    if (seen := view.by_other_hand()) is not None:
        known = view.clip.hand_known(view.clip.other_side)
        out[known] = np.minimum(out[known], _of_own_hand(seen))
    return out


def _of_own_hand(view: View) -> Float[ndarray, "T"]:
    """Compute the gap of the clip's own hand."""
    T_hand_obj, hand = view.result.T_hand_obj, view.clip.hand
    grasped = Mesh(view.result.scale * view.clip.mesh.vertices, view.clip.mesh.faces)
    surface, faces = close_holes(grasped.vertices, grasped.faces)
    in_object = se3.transform(se3.inverse(T_hand_obj), hand.vertices)
    of_hand = moving_distance(in_object, np.broadcast_to(surface, (len(in_object), *surface.shape)), faces)
    in_hand = se3.transform(T_hand_obj, fine([grasped], VERTICES)[0].vertices)
    of_object = moving_distance(in_hand, *close_holes(hand.vertices, hand.faces), REACH)
    return np.asarray(np.minimum(of_hand.min(axis=1), of_object.min(axis=1)))
