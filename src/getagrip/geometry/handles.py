"""The handle of a mesh: a bow with a hole, or else a bar, that sticks out of a body of revolution.

The body's axis is one of the mesh frame's, as in CAD models and most scans. In slices across it, the body's radius is
the median over sectors of the outermost points; what lies farther out in a few neighbouring sectors is a handle or a
spout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh

N_SLICES, N_SECTORS = 24, 36
"""Slices along the body's axis, and sectors about it."""
N_CENTRINGS = 8
"""Steps that move the axis into the middle of the body."""
MAX_ROUGHNESS = 0.012
"""Largest median distance of the outermost points from the body [diameters]: 0 to 0.009 of built-in kinds with a
handle and of scans of a mug and a pitcher, 0.014 and more of other shapes."""
MIN_BODY_RADIUS, MIN_PROTRUSION = 0.11, 0.12
"""Least radius of a body, and least distance from it that a handle reaches [diameters]."""
MIN_STAND_OFF, MIN_HOLE = 0.03, 0.04
"""Least distance from the body of a handle's points, and of the inside of a bow [diameters]."""
MAX_SECTORS = N_SECTORS // 4
"""Most sectors that a handle takes."""
THICKNESS, MAX_LINE_POINTS = 0.05, 250
"""Radius in which points of the surface have the middle line as their mean [diameters], and how many are taken."""
SAMPLES = np.array([[3, 3, 0], [0, 3, 3], [3, 0, 3], [2, 2, 2]]) / 6.0
"""Points of a face besides its corners, in parts of these."""


@dataclass(frozen=True)
class _Body:
    """A body of revolution, with the points of the surface about its axis.

    Attributes:
        slices, sectors: (n,) slice and sector of each point.
        beyond: (n,) how far each point is from the axis beyond the body's radius [m].
        radius: largest radius [m].
        roughness: median distance of the outermost points from the body [m].
    """

    slices: Int[ndarray, "n"]
    sectors: Int[ndarray, "n"]
    beyond: Float[ndarray, "n"]
    radius: float
    roughness: float


def find_handle(mesh: Mesh) -> Float[ndarray, "P 3"] | None:
    """Find points of the middle line of a mesh's handle, in its own frame [m]; None of a mesh without a handle."""
    points = np.concatenate([mesh.vertices, (SAMPLES @ mesh.vertices[mesh.faces]).reshape(-1, 3)])
    bodies = [(body, k) for k in range(3) if (body := _body_about(points, k, mesh.diameter)) is not None]
    for body, _ in sorted(bodies, key=lambda found: found[0].roughness):
        member = _handle_of(body, mesh.diameter)
        if member is not None:
            return _middle_line(points[member], THICKNESS * mesh.diameter)
    return None


def spread_along(corners: Float[ndarray, "P 3"], diameter: float) -> Float[ndarray, "Q 3"]:
    """Return points of the line through ``corners``, at least one, as close as those of ``find_handle`` [m]."""
    step, parts = 0.5 * THICKNESS * diameter, list[ndarray]()
    for start, end in pairwise(corners):
        count = int(np.ceil(np.linalg.norm(end - start) / step))
        parts.append(np.linspace(start, end, count, endpoint=False))
    return np.concatenate([*parts, corners[-1:]])


def _body_about(points: Float[ndarray, "n 3"], k: int, diameter: float) -> _Body | None:
    """Fit a body of revolution about the k-th axis of the frame; None where it is rough or slim."""
    along, across = points[:, k], np.delete(points, k, axis=1)
    if not np.ptp(along) > 0.0:
        return None
    slices = np.minimum((N_SLICES * (along - along.min()) / np.ptp(along)).astype(int), N_SLICES - 1)
    angle = 2.0 * np.pi * (np.arange(N_SECTORS) + 0.5) / N_SECTORS - np.pi
    towards, centre = np.stack([np.cos(angle), np.sin(angle)]), np.median(across, axis=0)
    for _ in range(N_CENTRINGS):
        off = across - centre
        distance = np.linalg.norm(off, axis=1)
        sectors = (N_SECTORS * (np.arctan2(off[:, 1], off[:, 0]) / (2.0 * np.pi) + 0.5)).astype(int) % N_SECTORS
        outer = np.zeros((N_SLICES, N_SECTORS))
        np.maximum.at(outer, (slices, sectors), distance)
        outer[outer == 0.0] = np.nan
        round_ = np.isfinite(outer).sum(axis=1) >= N_SECTORS // 2
        if np.count_nonzero(round_) < 3:
            return None
        radius = np.interp(np.arange(N_SLICES), np.flatnonzero(round_), np.nanmedian(outer[round_], axis=1))
        excess = (outer - radius[:, None])[round_]
        bounded = np.nan_to_num(np.clip(excess, -0.03 * diameter, 0.03 * diameter))
        centre = centre + 2.0 * (towards * bounded.mean(axis=0)).mean(axis=1)
    roughness, largest = float(np.nanmedian(np.abs(excess))), float(radius[round_].max())
    if roughness > MAX_ROUGHNESS * diameter or largest < MIN_BODY_RADIUS * diameter:
        return None
    return _Body(slices, sectors, distance - radius[slices], largest, roughness)


def _handle_of(body: _Body, diameter: float) -> Bool[ndarray, "n"] | None:
    """Mark the points of the handle, a bow before a bar, and the longest of these; None where nothing sticks out."""
    out = body.beyond > MIN_STAND_OFF * diameter
    found: list[tuple[tuple[bool, float], Bool[ndarray, "n"]]] = []
    for run in _runs(np.bincount(body.sectors[out], minlength=N_SECTORS) > 0):
        within = np.isin(body.sectors, run)
        member = within & out
        reach = float(body.beyond[member].max())
        if len(run) <= MAX_SECTORS and reach >= MIN_PROTRUSION * diameter:
            found.append(((_has_hole(body, within, diameter), reach), member))
    return max(found, key=lambda one: one[0])[1] if found else None


def _has_hole(body: _Body, within: Bool[ndarray, "n"], diameter: float) -> bool:
    """Return whether a protrusion leaves the body and returns to it: a spout leaves it only."""
    near = within & (body.beyond > 0.4 * MIN_STAND_OFF * diameter)
    inner = np.full(N_SLICES, np.nan)
    np.fmin.at(inner, body.slices[near], body.beyond[near])
    touching = np.flatnonzero(inner < MIN_HOLE * diameter)
    return len(touching) > 0 and bool((inner[touching[0] : touching[-1]] > MIN_HOLE * diameter).any())


def _runs(on: Bool[ndarray, "n"]) -> Sequence[Int[ndarray, "_"]]:
    """Group neighbouring sectors around the circle that are on; one group where all are."""
    if on.all():
        return [np.arange(len(on))]
    order = np.roll(np.arange(len(on)), -int(np.argmin(on)))  # from a sector that is off
    groups = np.split(order, np.flatnonzero(np.diff(on[order].astype(int))) + 1)
    return [group for group in groups if on[group[0]]]


def _middle_line(points: Float[ndarray, "n 3"], thickness: float) -> Float[ndarray, "P 3"]:
    """Return means of a handle's points, each over ``thickness`` about one of them, and half as far apart."""
    points = points[:: len(points) // MAX_LINE_POINTS + 1]
    near = np.linalg.norm(points[:, None] - points, axis=-1) < thickness
    left, line = (near @ points) / near.sum(axis=1, keepdims=True), list[ndarray]()
    while len(left):
        line.append(left[0])
        left = left[np.linalg.norm(left - left[0], axis=1) >= 0.5 * thickness]
    return np.array(line)
