"""Masks and pictures of posed meshes, from one z-buffer. For ground truth and for people; no energy uses it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from getagrip.geometry.depth import depth_and_face, interpolate_vertex_values, render_coverage
from getagrip.geometry.mesh import vertex_normals

Surface = tuple[Float[ndarray, "_V 3"], Int[ndarray, "_F 3"]]
"""Vertices in the camera frame [m] and faces."""
Colour = tuple[float, float, float]
"""Red, green, blue in [0, 1]."""

MIN_OCCLUDER_FRACTION = 0.01
"""Share of the grasped object's silhouette that another object must cover to count as in front of it. Less is noise of
the poses, such as a keyboard that cuts into the mouse on it."""
KEY_LIGHT_DIRECTION = np.array([-0.35, -0.6, -0.72])
"""Direction to the light in the camera frame: from above the left shoulder."""


def nearest_surface(
    surfaces: Sequence[Surface], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> Int[ndarray, "H W"]:
    """Return the index of the nearest surface in each pixel; -1 where there is none."""
    vertices, faces, _ = _concatenate_surfaces(surfaces)
    owner = np.repeat(np.arange(len(surfaces)), [len(f) for _, f in surfaces])
    return np.append(owner, -1)[depth_and_face(vertices, faces, K, size)[1]]  # no face, -1, is the last entry


def true_masks(
    grasped: Surface,
    hands: Sequence[Surface],
    others: Sequence[Surface],
    K: Float[ndarray, "3 3"],
    size: tuple[int, int],
) -> tuple[Bool[ndarray, "H W"], Bool[ndarray, "H W"], Bool[ndarray, "H W"]]:
    """Render the object's visible pixels, those that say nothing about it, and the grasping hand's visible pixels.

    Ignored is every pixel whose nearest surface is a hand, or another object that hides part of the grasped one;
    objects that hide nothing are background, which does say where the grasped object is not. An object in front is
    ignored as a whole, so that the ignored area does not betray the silhouette of what it hides.
    """
    part = nearest_surface([grasped, *hands, *others], K, size)  # 0: held, then hands, then others
    ignore = (part > 0) & (part <= len(hands))
    if others:
        shown = np.bincount(part[render_coverage(*grasped, K, size)], minlength=1 + len(hands) + len(others))
        for k in range(1 + len(hands), len(shown)):
            if shown[k] > MIN_OCCLUDER_FRACTION * shown.sum():
                ignore |= part == k
    return part == 0, ignore, (part == 1) & bool(hands)


def render_rgb(
    meshes: Sequence[tuple[Float[ndarray, "_V 3"], Int[ndarray, "_F 3"], Colour | Float[ndarray, "_V 3"]]],
    K: Float[ndarray, "3 3"],
    size: tuple[int, int],
    background: UInt8[ndarray, "H W 3"] | Colour | None = None,
) -> UInt8[ndarray, "H W 3"]:
    """Render meshes in the camera frame, lit and smoothly shaded, four samples a pixel.

    A mesh has one colour, or one for each vertex, between which colours are interpolated.
    ``background`` is an image of ``size``, a colour, or nothing: white.
    """
    width, height = size
    if background is None:
        background = (1.0, 1.0, 1.0)
    behind = np.broadcast_to(
        background / 255.0 if isinstance(background, ndarray) else np.array(background), (height, width, 3)
    )
    picture = np.repeat(np.repeat(behind.astype(np.float32), 2, axis=0), 2, axis=1)
    if meshes:
        vertices, faces, _ = _concatenate_surfaces([(v, f) for v, f, _ in meshes])
        brightness = _lambert(vertices, np.concatenate([vertex_normals(v, f) for v, f, _ in meshes]))
        colours = np.concatenate([np.broadcast_to(np.asarray(colour), v.shape) for v, _, colour in meshes])
        K2 = np.diag([2.0, 2.0, 1.0]) @ K
        _, face = depth_and_face(vertices, faces, K2, (2 * width, 2 * height))
        lit = interpolate_vertex_values(
            vertices, faces, K2, face, np.concatenate([brightness[:, None], colours], axis=1)
        )
        picture[face >= 0] = np.clip(lit[:, :1] * lit[:, 1:], 0.0, 1.0)
    mean = (picture[::2, ::2] + picture[::2, 1::2] + picture[1::2, ::2] + picture[1::2, 1::2]) / 4.0
    return np.asarray(np.round(255.0 * mean), dtype=np.uint8)


def _lambert(points: Float[ndarray, "n 3"], normals: Float[ndarray, "n 3"]) -> Float[ndarray, "n"]:
    """Brightness: ambient light, a key light, and a head light that gives form to what the key light leaves dark."""
    to_eye = -points / np.linalg.norm(points, axis=1, keepdims=True)
    n = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    facing = np.sum(n * to_eye, axis=1)
    n = np.where(facing[:, None] < 0.0, -n, n)  # the inside of an open mesh is lit as well
    key = np.clip(n @ (KEY_LIGHT_DIRECTION / np.linalg.norm(KEY_LIGHT_DIRECTION)), 0.0, 1.0)
    return np.asarray(0.3 + 0.5 * key + 0.3 * np.abs(facing))


def _concatenate_surfaces(
    surfaces: Sequence[Surface],
) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"], Int[ndarray, "n"]]:
    """One mesh from several, and the first face of each."""
    offsets = [0, *accumulate(len(v) for v, _ in surfaces)]
    first = np.array([0, *accumulate(len(f) for _, f in surfaces)])[:-1]
    vertices = np.concatenate([v for v, _ in surfaces])
    faces = np.concatenate([f + o for (_, f), o in zip(surfaces, offsets, strict=False)])
    return vertices, faces, first
