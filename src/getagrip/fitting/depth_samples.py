"""Samples of a clip's depth images on the visible pixels of its object and its hand, and what the images may err by."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.depth import Depth, DepthSource
from getagrip.clip.sampling import frame_indices
from getagrip.fitting.energy.depth import DepthErrors, DepthSamples, DepthTerm, Solid
from getagrip.fitting.energy.term import PosesInCamera
from getagrip.geometry import se3
from getagrip.geometry.depth import depth_and_face
from getagrip.geometry.mesh import decimate

N_INDEPENDENT_SAMPLES = 6.0
"""Independent samples of each body in a frame: its errors are smooth."""
MIN_BODY_SAMPLES = 20
"""Samples of a body in a frame below which each counts as if there were that many."""
DEPTH_PIXEL_STRIDE = 2
"""One sample in two of a row, and of a column, is used; the others tell where borders are."""
DEPTH_OUTLIER_THRESHOLD = 0.25
"""Samples beyond the middle of their body by more are of something else [share of the distance]."""

NETWORK_WARP_SIGMA, SENSOR_WARP_SIGMA = 0.01, 1e-6
"""Deviations of a warp's coefficients: a network's, and none of a sensor, whose depth tells how a hand is tilted."""


def depth_errors_of(source: DepthSource) -> DepthErrors:
    """Return what depth of a source may err by.

    The factor of a sensor's depth errs by more than its deviation here. But its prior counts once a clip, and samples
    of all frames count as independent: with a larger deviation, smooth errors that last would draw the object away.
    """
    sensor, free = source.source == "sensor", 1.0
    return DepthErrors(
        noise=source.assumed_error,
        clip=free if source.scale != "metric" else 0.001 if sensor else 0.08,
        frame=free if source.scale == "frame" else 0.001 if sensor else 0.012,
        relief=0.02 if sensor else 0.15,
        apart=0.003 if sensor else 0.008,
        warp=SENSOR_WARP_SIGMA if sensor else NETWORK_WARP_SIGMA,
    )


def sample_depth(clip: Clip, masks: Masks, depth: Depth, most: int) -> DepthSamples:
    """Return at most ``most`` samples on the visible pixels of each of object and hand, but none at their borders."""
    given = render_hand_depth(clip, depth)
    bodies = [
        body[:, ::DEPTH_PIXEL_STRIDE, ::DEPTH_PIXEL_STRIDE] for body in body_masks(clip, masks, depth, given < np.inf)
    ]
    depth, given = depth.thinned(DEPTH_PIXEL_STRIDE), given[:, ::DEPTH_PIXEL_STRIDE, ::DEPTH_PIXEL_STRIDE]
    parts = [[_sample_body(body[n], depth.z[n], most) for body in bodies] for n in range(len(depth))]
    on_object = np.array([len(part[0]) for part in parts])
    used = on_object + [len(part[1]) for part in parts]
    shape = (len(depth), max(1, used.max()))
    place, (log_z, weight, relief, of_hand) = np.zeros((*shape, 2), int), (np.zeros(shape) for _ in range(4))
    for n, part in enumerate(parts):
        end = used[n]
        place[n, :end] = np.concatenate(part)
        rows, columns = place[n, :end].T
        log_z[n, :end] = np.log(depth.z[n, rows, columns])
        relief[n, :end] = log_z[n, :end] - log_z[n, :end].mean() if end else 0.0
        of_hand[n, :end] = np.log(given[n, rows, columns])
        weight[n, :end] = np.repeat(
            [N_INDEPENDENT_SAMPLES / max(len(one), MIN_BODY_SAMPLES) for one in part], [len(one) for one in part]
        )
    of_hand[~np.isfinite(of_hand)] = np.nan
    K = depth.intrinsics(clip)
    fxfycxcy = np.stack([K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2]], axis=1)
    return DepthSamples(fxfycxcy, len(depth.z[0]), place, on_object, used, log_z, relief, weight, of_hand)


def render_hand_depth(clip: Clip, depth: Depth) -> Float[ndarray, "T n n"]:
    """Render the distance of the input hand at the samples; infinite beside it."""
    posed, side = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices), depth.z.shape[1]
    K = depth.intrinsics(clip)
    return np.stack([depth_and_face(v, clip.hand.faces, k, (side, side))[0] for v, k in zip(posed, K, strict=True)])


def body_masks(
    clip: Clip, masks: Masks, depth: Depth, drawn: Bool[ndarray, "T n n"]
) -> tuple[Bool[ndarray, "T n n"], Bool[ndarray, "T n n"]]:
    """Return which samples show the object and which the hand, without those at borders.

    Without masks of the hand, the ignored pixels that the input hand covers (``drawn``) are taken for it.
    """
    seen, hidden = depth.of_masks(masks.object, clip.size), depth.of_masks(masks.ignore, clip.size)
    hand = hidden & drawn if masks.hand is None else depth.of_masks(masks.hand, clip.size)
    return _erode_masks(seen & ~(hidden & hand)), _erode_masks(hand & ~seen)


def _erode_masks(masks: Bool[ndarray, "T n n"]) -> Bool[ndarray, "T n n"]:
    return np.stack([cv2.erode(m.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool) for m in masks])


def _sample_body(mask: Bool[ndarray, "n n"], z: Float[ndarray, "n n"], most: int) -> Int[ndarray, "m 2"]:
    """Return rows and columns of a body's samples that have depth near that of most."""
    place = np.argwhere(mask & (z > 0.0))
    if len(place):
        found = z[tuple(place.T)]
        place = place[np.abs(np.log(found / np.median(found))) < DEPTH_OUTLIER_THRESHOLD]
    return place[frame_indices(len(place), most)] if len(place) else place


def missing_and_outlier_fractions(clip: Clip, masks: Masks, depth: Depth) -> tuple[float, float]:
    """Return the share of the visible surface without depth, and of what has some, the share far from the rest."""
    seen = np.zeros(3)
    for body in body_masks(clip, masks, depth, render_hand_depth(clip, depth) < np.inf):
        for mask, z in zip(body, depth.z, strict=True):
            there = z[mask & (z > 0.0)]
            off = np.abs(np.log(there / np.median(there))) >= DEPTH_OUTLIER_THRESHOLD if len(there) else there
            seen += np.array([np.count_nonzero(mask), len(there), np.count_nonzero(off)])
    with np.errstate(invalid="ignore"):
        return float(1.0 - seen[1] / seen[0]), float(seen[2] / seen[1])


def median_hand_depth_ratio(samples: DepthSamples) -> float:
    """Return how many times as far away depth shows the hand as it is given: the median; NaN where it shows none."""
    on_hand = np.arange(samples.log_z.shape[1]) >= samples.on_object[:, None]
    off = (samples.log_z - samples.input)[on_hand & (samples.weight > 0.0)]
    off = off[np.isfinite(off)]
    return float(np.exp(np.median(off))) if len(off) else np.nan


def depth_deviation_at(
    clip: Clip, samples: DepthSamples, source: DepthSource, T_hand_obj: Float[ndarray, "T 4 4"], scale: float
) -> tuple[float, float]:
    """Return how far depth is off an object in the input hand, and how far it is warped, root mean squares.

    The first in what it may err by, its warp apart; the second as a share of the distance.
    """
    T, mesh = clip.hand.T_cam_hand @ T_hand_obj, decimate(clip.mesh, 500)
    centre = se3.transform(T, scale * clip.mesh.centre[None, None])[:, 0]
    poses = PosesInCamera(np.ascontiguousarray(T[None, :, :3, :3]), centre[None], np.array([scale]))
    hand = Solid.of(clip.hand.vertices, clip.hand.faces)
    solid = Solid.of(mesh.vertices[None] - clip.mesh.centre, mesh.faces)
    term = DepthTerm(solid, hand, samples, replace(depth_errors_of(source), warp=NETWORK_WARP_SIGMA), 1.0)
    return float(np.sqrt(term.squared_deviations(poses)[0] / (2.0 * N_INDEPENDENT_SAMPLES))), float(term.warp(poses)[0])
