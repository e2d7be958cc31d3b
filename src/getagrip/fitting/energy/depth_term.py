"""E_depth: distance of the visible surfaces of object and hand from those in depth images, up to the images' errors.

At a sample, r = log z - log z' compares the distance z of the posed surface with the z' of the image, which errs by

    r = a + b_n + g d + h + warp + noise

a factor of the clip (a) and of the frame (b_n), a relief that is too flat or too deep (g, times the sample's own relief
d), a hand that is off against the object (h, on the hand), a warp (a polynomial over the image, the same in all
frames), and noise with heavy tails. Each has a prior of zero mean and a given deviation: that of a is small where depth
is metric, and large where its scale is unknown; the warp's has heavy tails, so that one larger than hands are off costs
little, and moves nothing. The energy is its minimum over all errors (they are *profiled out*): with Student's log for
the noise,

    Q = min  sum over n, i of w_ni c^2 log(1 + (r - a - b_n - g d - h - warp)^2 / (c sigma)^2) + costs of the priors
    E = weight * N kappa log(1 + Q / (N kappa))

At the minimum the derivatives of Q by the errors vanish, so the gradient of Q is that at fixed errors; its curvature is
less, and ties all frames to each other (Schur complement). The outer logarithm reduces the weight of depth that fits
badly at its best, as another scene's does.

Without a moving hand the hand's samples tell a, as accurately as the input hand is known: their sigma is larger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.clip import frame_indices
from getagrip.clip.depth import Depth, DepthSource
from getagrip.compiling import kernel
from getagrip.fitting.energy.term import ObjectWithHand, PosesInCamera, Quadratic, no_bound
from getagrip.geometry import se3
from getagrip.geometry.kernels.depth import add, distances, dot, forward, prior_cost, profile
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.geometry.rasterize import depth_and_face

DEPTH_TAIL_SIGMAS = 2.5
"""c: deviations beyond which an error counts less and less."""
N_DEPTH_SCALE_ERRORS = 3
"""Errors of a clip before its warp: g, h, a."""
DEPTH_MISFIT_KAPPA = 20.0
"""Misfit of a frame at which depth has half its weight [squared deviations]."""
RAY_MISS_ERROR = 0.1
"""Error of a sample whose ray misses the surface [fraction of the distance]."""
HAND_DISTANCE_SIGMA, HAND_SURFACE_SIGMA = 0.02, 0.015
"""Error of the input hand's distance, the same in all frames, and of its surface [fractions of the distance]: 13 to 18
mm, and the effect of 0.28 rad on a surface 5 cm from the middle, at arm's length."""
MAX_IRLS_ITERATIONS, IRLS_TOLERANCE = 12, 1e-2
"""Maximum number of iterations for the images' errors (iteratively reweighted least squares), and step of the errors
that ends them [deviations of the noise]."""
N_INDEPENDENT_SAMPLES = 6.0
"""Independent samples of each body in a frame: its errors are smooth."""
MIN_BODY_SAMPLES = 20
"""Number of samples of a body in a frame below which a sample's weight grows no further."""
DEPTH_PIXEL_STRIDE = 2
"""Step between the samples of a row, and of a column; the pixels between tell where borders are."""
DEPTH_OUTLIER_THRESHOLD = 0.25
"""Deviation from the median of their body beyond which samples show another thing [fraction of the distance]."""
NETWORK_WARP_SIGMA, SENSOR_WARP_SIGMA = 0.01, 1e-6
"""Deviations of a warp's coefficients: a network's, and none of a sensor, whose depth tells how a hand is tilted."""


@dataclass(frozen=True)
class DepthErrors:
    """Standard deviations of depth images' errors: sigma, a, b_n, h, warp [fractions of distance]; g [of relief]."""

    noise: float
    clip: float
    frame: float
    relief: float
    apart: float
    warp: float


@dataclass(frozen=True)
class DepthSamples:
    """Samples of N depth images on the visible pixels of object and hand: at most M, first those on the object.

    Attributes:
        K: (N, 4) fx, fy, cx, cy of the images.
        size: side of the images [px].
        place: (N, M, 2) row and column of each sample.
        on_object, used: (N,) number of samples on the object, and on object and hand.
        log_z: (N, M) logarithm of the depth.
        relief: (N, M) logarithm of the depth, less its mean in the frame.
        weight: (N, M) number of independent samples that each counts as; 0 beyond ``used``.
        input: (N, M) logarithm of the input hand's distance; NaN where the ray misses it.
    """

    K: Float[ndarray, "N 4"]
    size: int
    place: Int[ndarray, "N M 2"]
    on_object: Int[ndarray, "N"]
    used: Int[ndarray, "N"]
    log_z: Float[ndarray, "N M"]
    relief: Float[ndarray, "N M"]
    weight: Float[ndarray, "N M"]
    input: Float[ndarray, "N M"]

    @cached_property
    def modes(self) -> Float[ndarray, "N K M"]:
        """Form of each error that all frames share: relief, the hand, a factor, and warps of the image."""
        y, x = np.moveaxis((2 * self.place + 1) / self.size - 1.0, -1, 0)
        on_hand = np.arange(x.shape[1]) >= self.on_object[:, None]
        warps = np.stack([x, y, x * x, x * y, y * y])
        total = np.maximum(self.weight.sum(axis=1), 1e-9)  # of frames without samples
        warps -= ((self.weight * warps).sum(axis=-1) / total)[..., None]  # else they were a factor as well
        return np.stack([self.relief, on_hand, np.ones_like(x), *warps], axis=1)

    def take(self, index: Int[ndarray, "n"]) -> DepthSamples:
        """Return the samples of some of the frames."""
        return DepthSamples(
            self.K[index], self.size, self.place[index], self.on_object[index], self.used[index], self.log_z[index],
            self.relief[index], self.weight[index], self.input[index],
        )  # fmt: skip


@dataclass(frozen=True)
class Solid:
    """A triangle mesh as the kernel reads it: vertices and planes about its centre, per frame or for all (N = 1)."""

    vertices: Float[ndarray, "N 3 V"]
    planes: Float[ndarray, "N 4 F"]
    faces: Int[ndarray, "F 3"]
    closed: bool

    @staticmethod
    def of(vertices: Float[ndarray, "N V 3"], faces: Int[ndarray, "F 3"]) -> Solid:
        """Build the tables of vertices about a centre."""
        meshes = [Mesh(one, faces) for one in vertices]
        closed = all(mesh.is_closed and mesh.volume > 0.0 for mesh in meshes)  # its faces look outward
        planes = np.stack([mesh.planes.T for mesh in meshes])
        return Solid(np.ascontiguousarray(np.swapaxes(vertices, 1, 2)), np.ascontiguousarray(planes), faces, closed)

    def about(self, middle: Float[ndarray, "3"]) -> Solid:
        """Return it about another centre."""
        planes = self.planes.copy()
        planes[:, 3] += np.einsum("nkf,k->nf", planes[:, :3], middle)
        return replace(self, vertices=self.vertices - middle[:, None], planes=planes)

    def take(self, index: Int[ndarray, "n"]) -> Solid:
        """Return it at some of its frames."""
        return replace(self, vertices=self.vertices[index], planes=self.planes[index])


@dataclass(frozen=True)
class DepthTerm:
    """E_depth of N frames: a term on the object and, where it is unknown as well, on the hand.

    Attributes:
        object: the object's mesh.
        hand: the hand's mesh in its own frame, in each frame.
        samples: the depth images.
        errors: the images' errors.
        weight: energy per squared deviation of an independent sample [px^2].
    """

    object: Solid
    hand: Solid
    samples: DepthSamples
    errors: DepthErrors
    weight: float
    name: str = "depth"

    def squared_deviations(self, poses: PosesInCamera) -> Float[ndarray, "B"]:
        """Return Q per frame."""
        total = self(poses, no_bound(poses)).value.mean(axis=1) / self.weight
        return np.asarray(DEPTH_MISFIT_KAPPA * np.expm1(total / DEPTH_MISFIT_KAPPA))

    def warp(self, poses: PosesInCamera) -> Float[ndarray, "B"]:
        """Measure the images' warp, root mean square over samples [fraction of the distance]."""
        errors, modes = self._fitted(poses, no_bound(poses))[1], self.samples.modes
        off = np.einsum("bk,nkm->bnm", errors[:, N_DEPTH_SCALE_ERRORS:], modes[:, N_DEPTH_SCALE_ERRORS:])
        return np.sqrt(np.average(off.reshape(len(off), -1) ** 2, axis=1, weights=self.samples.weight.ravel()))

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        return self._fitted(poses, bound)[0]

    def _fitted(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> tuple[Quadratic, Float[ndarray, "B K"]]:
        """Return the term, and the errors that all frames share (``DepthSamples.modes``)."""
        (B, N), s, o = poses.centre.shape[:2], self.samples, self.object
        hand, solid, P = poses, self.hand, 7
        if moves := isinstance(poses, ObjectWithHand):
            hand, solid, P = poses.hand, self.hand.about(poses.hand.middle), 14
        q = replace(Quadratic.zero(poses, P), cross=np.zeros((B, N, P, N, P)))
        K, e = s.modes.shape[1], self.errors
        of_clip, of_frame, left = np.zeros((B, K)), np.zeros((B, N)), np.zeros((B, *s.log_z.shape))
        apart = e.apart if moves else np.hypot(e.apart, HAND_DISTANCE_SIGMA)
        surface = 0.0 if moves else HAND_SURFACE_SIGMA
        sigma = np.array([e.noise, np.hypot(e.noise, surface)])
        priors = np.array([e.relief, apart, e.clip, *[e.warp] * (K - N_DEPTH_SCALE_ERRORS), e.frame]) ** -2.0
        _evaluate_depth(
            poses.R, poses.centre, poses.scale, o.vertices, o.planes, o.faces, o.closed,
            hand.R, hand.centre, hand.scale, solid.vertices, solid.planes, solid.faces, solid.closed, moves,
            s.K, s.size, s.place, s.on_object, s.used, s.log_z, s.modes, s.weight, s.input,
            priors, sigma, self.weight, IRLS_TOLERANCE * e.noise, MAX_IRLS_ITERATIONS, bound,
            q.value, q.g, q.H, q.cross, of_clip, of_frame, left,
        )  # fmt: skip
        return q, of_clip


@kernel("f4 f3 f1 f3 f3 i2 b f4 f3 f1 f3 f3 i2 b b f2 i i3 i1 i1 f2 f3 f2 f2 f1 f1 f f i f1 f2 f3 f4 f5 f2 f2 f3")
def _evaluate_depth(
    R, centre, scale, vertices, planes, faces, closed,
    hand_R, hand_centre, hand_scale, hand_vertices, hand_planes, hand_faces, hand_closed, moves,
    K, size, place, on_object, used, log_z, modes, weight, given,
    priors, sigma, unit, exact, rounds, bound,
    value, g, H, cross, of_clip, of_frame, left,
):  # fmt: skip
    """Fill in value (B, N), g (B, N, P), H (B, N, P, P), cross (B, N, P, N, P).

    Work space: of_clip (B, K) errors by ``modes``; of_frame (B, N) b_n; left (B, N, M) what is left of r, 0 where
    a ray misses.
    """
    B, N = value.shape
    M, C, P = log_z.shape[1], modes.shape[1], g.shape[2]
    uvz, hand_uvz = np.empty((3, vertices.shape[2])), np.empty((3, hand_vertices.shape[2]))
    nearest, face = np.empty((size, size)), np.empty((size, size), np.int64)
    r, u, w, J = np.empty((N, M)), np.empty((N, M)), np.empty((N, M)), np.empty((N, M, 7))
    sums, A, tied = np.empty((N, C + 2)), np.empty((C, C)), np.empty((N, P, C))
    missed, sigmas = (
        DEPTH_TAIL_SIGMAS**2 * np.log1p((RAY_MISS_ERROR / (DEPTH_TAIL_SIGMAS * sigma[0])) ** 2),
        np.full((N, M), sigma[0]),
    )
    most = DEPTH_MISFIT_KAPPA * N
    for n in range(N):
        sigmas[n, on_object[n] :] = sigma[1]
    for b in range(B):
        if not bound[b] >= 0.0:  # the step is rejected, whatever depth says
            continue
        there = True
        for n in range(N):
            k, end = on_object[n], used[n]
            there &= distances(
                vertices[0], planes[0], faces, closed, R[b, n], centre[b, n], scale[b], K[n], place[n], 0, k, size, uvz,
                nearest, face, r[n], J[n],
            )  # fmt: skip
            if moves:
                there &= distances(
                    hand_vertices[n], hand_planes[n], hand_faces, hand_closed, hand_R[b, n], hand_centre[b, n],
                    hand_scale[b], K[n], place[n], k, end, size, hand_uvz, nearest, face, r[n], J[n],
                )  # fmt: skip
            else:
                r[n, k:end] = given[n, k:end]
            for m in range(M):
                hit = m < end and r[n, m] == r[n, m]
                w[n, m] = weight[n, m] if hit else 0.0
                r[n, m] = r[n, m] - log_z[n, m] if hit else 0.0
        if not there:
            value[b] = np.inf
            continue
        profile(
            r, w, modes, priors, N_DEPTH_SCALE_ERRORS, sigmas, DEPTH_TAIL_SIGMAS, rounds, exact, u, left[b], sums, A,
            of_clip[b], of_frame[b],
        )  # fmt: skip
        shared = prior_cost(of_clip[b], priors, N_DEPTH_SCALE_ERRORS)[0] / N
        total = 0.0
        for n in range(N):
            cost = shared + priors[C] * of_frame[b, n] ** 2
            for m in range(M):
                if w[n, m] == 0.0:
                    left[b, n, m] = 0.0
            for m in range(used[n]):
                cost += (
                    w[n, m] * DEPTH_TAIL_SIGMAS**2 * np.log1p((left[b, n, m] / (DEPTH_TAIL_SIGMAS * sigmas[n, m])) ** 2)
                )
                cost += (weight[n, m] - w[n, m]) * missed * (moves or m < on_object[n])
            value[b, n] = cost
            total += cost
        total = max(total, 1e-12)  # without a sample nothing is off
        value[b] *= unit * most * np.log1p(total / most) / total
        slope = 2.0 * unit / (1.0 + total / most)
        _add_depth_derivatives(slope, J, u, left[b], modes, on_object, used, moves, sums, A, tied, g[b], H[b], cross[b])


@kernel()
def _add_depth_derivatives(slope, J, u, left, modes, on_object, used, moves, sums, L, tied, g, H, cross):
    """Fill in g (N, P), H (N, P, P) and cross (N, P, N, P) of a hypothesis. Work space: tied (N, P, K).

    Of the curvature at fixed errors of the images, profiling takes off ``F^T F`` in each frame, for its own error, and
    between all frames, for those of the clip.
    """
    N, P = g.shape
    F = np.empty(P)
    for n in range(N):
        F[:], tied[n] = 0.0, 0.0
        for m in range(used[n]):
            w, hand = u[n, m], m >= on_object[n]
            if w == 0.0 or (hand and not moves):
                continue
            start = 7 * hand
            for p in range(7):
                wJ = w * J[n, m, p]
                g[n, start + p] += slope * wJ * left[n, m]
                F[start + p] += wJ
                add(tied[n, start + p], wJ, modes[n, :, m])
                for q in range(p + 1):
                    H[n, start + p, start + q] += slope * wJ * J[n, m, q]
        s = sums[n, len(L)]
        for p in range(P):
            add(tied[n, p], -F[p] / s, sums[n])
            forward(L, tied[n, p])
        for p in range(P):
            for q in range(p + 1):
                H[n, p, q] -= slope * (F[p] * F[q] / s + dot(tied[n, p], tied[n, q]))
                H[n, q, p] = H[n, p, q]
    for n in range(N):
        for o in range(n):
            for p in range(P):
                for q in range(P):
                    cross[n, p, o, q] = cross[o, q, n, p] = -slope * dot(tied[n, p], tied[o, q])


def depth_errors_of(source: DepthSource) -> DepthErrors:
    """Return the assumed errors of a source's depth.

    The factor of a sensor's depth errs by more than its deviation here. But its prior counts once a clip, and samples
    of all frames count as independent: with a larger deviation, lasting smooth errors would draw the object away.
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
    """Sample at most ``most`` visible pixels of each of object and hand, away from their borders."""
    given, thinned = render_hand_depth(clip, depth), (slice(None), *[slice(None, None, DEPTH_PIXEL_STRIDE)] * 2)
    bodies = [body[thinned] for body in body_masks(clip, masks, depth, given < np.inf)]
    depth, given = depth.thinned(DEPTH_PIXEL_STRIDE), given[thinned]
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
        counts = [len(places) for places in part]
        weight[n, :end] = np.repeat([N_INDEPENDENT_SAMPLES / max(m, MIN_BODY_SAMPLES) for m in counts], counts)
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
    """Return the samples that show the object and those that show the hand, without borders.

    Without masks of the hand, the ignored pixels that the input hand covers (``drawn``) count as the hand's.
    """
    seen, hidden = depth.of_masks(masks.object, clip.size), depth.of_masks(masks.ignore, clip.size)
    hand = hidden & drawn if masks.hand is None else depth.of_masks(masks.hand, clip.size)
    return _erode_masks(seen & ~(hidden & hand)), _erode_masks(hand & ~seen)


def _erode_masks(masks: Bool[ndarray, "T n n"]) -> Bool[ndarray, "T n n"]:
    return np.stack([cv2.erode(m.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool) for m in masks])


def _sample_body(mask: Bool[ndarray, "n n"], z: Float[ndarray, "n n"], most: int) -> Int[ndarray, "m 2"]:
    """Sample rows and columns of a body's pixels whose depth is near the body's median."""
    place = np.argwhere(mask & (z > 0.0))
    if len(place):
        found = z[tuple(place.T)]
        place = place[np.abs(np.log(found / np.median(found))) < DEPTH_OUTLIER_THRESHOLD]
    return place[frame_indices(len(place), most)] if len(place) else place


def missing_and_outlier_fractions(clip: Clip, masks: Masks, depth: Depth) -> tuple[float, float]:
    """Return the fraction of the visible surface without depth, and the fraction of its depth far from the rest."""
    seen = np.zeros(3)
    for body in body_masks(clip, masks, depth, render_hand_depth(clip, depth) < np.inf):
        for mask, z in zip(body, depth.z, strict=True):
            there = z[mask & (z > 0.0)]
            off = np.abs(np.log(there / np.median(there))) >= DEPTH_OUTLIER_THRESHOLD if len(there) else there
            seen += np.array([np.count_nonzero(mask), len(there), np.count_nonzero(off)])
    with np.errstate(invalid="ignore"):
        return float(1.0 - seen[1] / seen[0]), float(seen[2] / seen[1])


def median_hand_depth_ratio(samples: DepthSamples) -> float:
    """Return the median ratio of the hand's distance in depth images to its input distance; NaN without samples."""
    on_hand = np.arange(samples.log_z.shape[1]) >= samples.on_object[:, None]
    off = (samples.log_z - samples.input)[on_hand & (samples.weight > 0.0)]
    off = off[np.isfinite(off)]
    return float(np.exp(np.median(off))) if len(off) else np.nan


def depth_deviation_at(
    clip: Clip, samples: DepthSamples, source: DepthSource, T_hand_obj: Float[ndarray, "T 4 4"], scale: float
) -> tuple[float, float]:
    """Return depth's deviation from an object in the input hand, and its warp, root mean squares.

    The deviation is in standard deviations of depth's errors, without the warp; the warp is a fraction of the distance.
    """
    T, mesh = clip.hand.T_cam_hand @ T_hand_obj, decimate(clip.mesh, 500)
    centre = se3.transform(T, scale * clip.mesh.centre[None, None])[:, 0]
    poses = PosesInCamera(np.ascontiguousarray(T[None, :, :3, :3]), centre[None], np.array([scale]))
    hand = Solid.of(clip.hand.vertices, clip.hand.faces)
    solid = Solid.of(mesh.vertices[None] - clip.mesh.centre, mesh.faces)
    term = DepthTerm(solid, hand, samples, replace(depth_errors_of(source), warp=NETWORK_WARP_SIGMA), 1.0)
    return float(np.sqrt(term.squared_deviations(poses)[0] / (2.0 * N_INDEPENDENT_SAMPLES))), float(term.warp(poses)[0])
