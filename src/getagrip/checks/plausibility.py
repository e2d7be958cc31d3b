"""Sizes and distances that cannot be far from usual while a hand holds an object."""

from __future__ import annotations

import numpy as np

from getagrip.checks.evidence import Evidence

UNKNOWN = float("nan")


def size_input(it: Evidence) -> float:
    """Return the mesh's diameter, where that is the object's, in sizes of the hand."""
    return it.clip.mesh.diameter / it.hand_size if it.clip.scale == "known" else UNKNOWN


def found_size(it: Evidence) -> float:
    """Return the object's diameter at the resulting scale, where it was not known, in sizes of the hand."""
    return it.scale * it.clip.mesh.diameter / it.hand_size if it.clip.scale == "free" else UNKNOWN


def mask_size(it: Evidence) -> float:
    """Return the diameter that the masks show, in diameters of the mesh, where that is the object's."""
    return it.apparent_size / it.clip.mesh.diameter if it.clip.scale == "known" else UNKNOWN


def seen_size(it: Evidence) -> float:
    """Return the diameter that the masks show, in sizes of the hand, where the object's size is not known."""
    return it.apparent_size / it.hand_size if it.clip.scale == "free" else UNKNOWN


def edge_share(it: Evidence) -> float:
    """Measure the share of the image's edge that the masks cover, median over frames; all of it for the background."""
    each = [(mask[[0, -1]].mean(), mask[:, [0, -1]].mean()) for mask in it.masks.object]
    edges = np.array(each).T
    width, height = it.clip.size
    return float(np.median((width * edges[0] + height * edges[1]) / (width + height)))


def focal_jump(it: Evidence) -> float:
    """Return the largest factor by which the focal length changes from one frame to the next."""
    steps = np.abs(np.diff(np.log(it.clip.K[:, [0, 1], [0, 1]]), axis=0))
    return float(np.exp(steps.max(initial=0.0)))


def gap(it: Evidence) -> float:
    """Measure the smallest distance of hand and object, median over frames [mm]; 0 where they touch."""
    return 1e3 * float(np.median(np.maximum(it.to_object.min(axis=1), 0.0)))


def penetration(it: Evidence) -> float:
    """Measure the depth of the hand's deepest point inside the object, median over frames [mm]."""
    return 1e3 * float(np.median(np.maximum(-it.to_object.min(axis=1), 0.0)))


def second_gap(it: Evidence) -> float:
    """Measure the distance of the second nearest contact region of the hand, median over frames [mm].

    0 where it touches.
    """
    regions = it.region_distance
    return 1e3 * float(np.median(np.maximum(np.sort(regions, axis=1)[:, 1], 0.0))) if regions.shape[1] > 1 else UNKNOWN


def hand_off_pixels(it: Evidence) -> float:
    """Measure the share of the hand's own pixels that differ from its silhouette, where its own pixels are known."""
    return it.hand_differing if it.masks.hand is not None else UNKNOWN


def hand_off_ignored(it: Evidence) -> float:
    """Measure how far the hand is off the ignored pixels near it, where these are taken for its own."""
    return it.hand_differing if it.masks.hand is None else UNKNOWN
