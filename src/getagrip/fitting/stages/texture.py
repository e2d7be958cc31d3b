"""Texture: the colours of the mesh against those of the images, which tell front from back where no silhouette does.

Compared are the solutions, the best one's half turns about its principal axes, and its mirror images in depth: of a
shape with a plane of symmetry, a pose reflected along the ray has nearly the same silhouette. All are fitted to the
masks again, and rendered with the mesh's colours. Inside the visible part of the mask, colours of image and picture are
compared without what light changes: each channel without its smooth part, scaled to unit variance. They are compared
where they meet best, since a small error of the pose shifts the picture. With correlation r over n independent places,
the image is more probable by -n/2 log(1 - r^2) than without any texture. Plain, missing or wrong colours correlate with
no pose, and decide nothing. No mask shows the angle of a body of revolution about its axis: the colours of such angles
are compared, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray
from scipy import fft

from getagrip.checks.evidence import TextureVote
from getagrip.clip.clip import frame_indices
from getagrip.errors import InputError
from getagrip.fitting.evidence.texture import TEXTURE_KEY, FrameImages
from getagrip.fitting.methods.all_frames import make_method_result
from getagrip.fitting.motion import Hinge, Motion, Soft
from getagrip.fitting.motion.base import hand_object_transforms
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.solve import minimise
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.geometry.rasterize import depth_and_face, interpolate_vertex_values
from getagrip.io.images import read_image

N_TEXTURE_FRAMES, TEXTURE_SIDE_PX, MAX_TEXTURE_FACES = 6, 96, 20_000
"""Number of compared frames, longest side of the object's mask in them [px], and maximum number of the mesh's faces."""
SMOOTH_PX, FINE_PX, INDEPENDENT_PX = 12.0, 1.0, 36.0
"""Standard deviations of the smooth part, which shading makes, and of the smoothing of noise [px]; area of an
independent place [px^2]."""
MIN_CORRELATION, MIN_GAIN_NATS = 0.3, 10.0
"""Least correlation of a pose that texture prefers, and least gain over the best by the masks. Assumed."""
MIN_COMPARED_PX = 200
"""Minimum number of pixels of a frame that are compared."""
MAX_SHIFT_PX = 8
"""Largest shift of a picture to where it meets its image best, to either side [px]: a draft's pose may err by ten
degrees. Of 12 drafts of scans 11 face right with it, 9 with 5 px, 6 without (docs/trials.md).
"""
MIN_TURN_RAD = np.radians(45.0)
"""Rotation from the result beyond which a pose that texture prefers contradicts the result."""
REFIT_LEVEL_PX, REFIT_ITERATIONS, FINAL_LEVEL_PX = 128, 8, 256
"""Resolution [px] and iterations of the fit of the compared poses, and resolution of the chosen one's."""
N_SPINS, FINER_SPINS_RAD = 12, np.radians([15.0, 7.5])
"""Number of angles about that axis, compared in every other frame, and steps from the best to either side."""
MAX_SPUN_POSES, MAX_SPUN_ENERGY = 3, 1.5
"""Maximum number of poses whose angle is varied, and their maximum energy relative to the least."""


@dataclass(frozen=True)
class _Seen:
    """The object in an image, as it is compared.

    Attributes:
        frame: index of the frame.
        K: camera of the cut, shrunk part of the image.
        mask: its pixels that show the object.
        colours: its colours without their smooth part.
    """

    frame: int
    K: Float[ndarray, "3 3"]
    mask: Bool[ndarray, "h w"]
    colours: Float32[ndarray, "h w 3"]


@dataclass(frozen=True)
class _Votes:
    """Motions, their energies by the masks, correlations of their colours with the images', and nats of these."""

    motion: Motion
    energy: Float[ndarray, "B"]
    correlation: Float[ndarray, "B"]
    nats: Float[ndarray, "B"]

    def and_others(self, other: _Votes) -> _Votes:
        """Return these and other motions."""
        parts = ((self.energy, other.energy), (self.correlation, other.correlation), (self.nats, other.nats))
        return _Votes(self.motion.concatenate(other.motion), *map(np.concatenate, parts))

    def preferred(self, noise: float) -> int:
        """Return the motion that texture and masks prefer: the first, unless another one's gain is large."""
        cost = np.where(
            np.isfinite(self.energy) & (self.correlation >= MIN_CORRELATION), self.energy - noise * self.nats, np.inf
        )
        best = int(np.argmin(cost))
        return best if cost[best] < self.energy[0] - noise * (self.nats[0] + MIN_GAIN_NATS) else 0


def prefer_texture(problem: Problem, found: MethodResult) -> MethodResult:
    """Return the solutions, first the one that texture and masks together prefer, with the texture's vote.

    The problem is as found, so that a hand that was solved with the object stays as it is. Solutions that texture
    finds less probable than the first have more energy. Unchanged are results where mesh or images have no colours, or
    the options leave texture out.
    """
    images, unread = _seen_frames(problem)
    if not images or found.motion is None or found.energy_of is None:
        return replace(found, texture=TextureVote(unread=unread))
    mesh = decimate(problem.clip.mesh, MAX_TEXTURE_FACES)
    motion, T_cam_hand = found.motion, problem.clip.hand.T_cam_hand
    turns = _look_alike_turns(problem, found)
    energy, frames = found.energy_of(problem), np.arange(len(problem.clip))
    some = motion.concatenate(motion.take(np.zeros(len(turns), int)).rotated(turns))
    tried = minimise(some, energy(REFIT_LEVEL_PX, frames), T_cam_hand, REFIT_ITERATIONS, threads=problem.threads)
    noise = 2.0 * found.terms["mask"] / len(frames)  # of a frame's masks, as in ``confidence.pose_spread``

    def votes(motion: Motion, energy: Float[ndarray, "B"], images: list[_Seen]) -> _Votes:
        poses = motion.poses()
        T_hand_obj = hand_object_transforms(poses, problem.surface.mesh.centre)
        compared = [_compare(problem, mesh, *pose, images) for pose in zip(poses.scale, T_hand_obj, strict=True)]
        r, n = np.array(compared).T
        return _Votes(motion, energy, r, -0.5 * n * np.log1p(-(np.clip(r, 0.0, 0.99) ** 2)))

    voted = votes(tried.motion, tried.energy, images)
    if (axis := problem.surface.axis_of_revolution) is not None:
        spun = _spread_poses(voted, axis)
        around = np.linspace(0.0, 2.0 * np.pi, N_SPINS, endpoint=False)[1:]
        spins = np.tile(se3.exp_so3(around[:, None] * axis), (len(spun), 1, 1))
        rows = np.repeat(spun, len(around))
        rough = votes(voted.motion.take(rows).rotated(spins), voted.energy[rows], images[::2])
        each = np.arange(len(spun)) * len(around) + rough.nats.reshape(len(spun), -1).argmax(axis=1)
        voted = voted.and_others(votes(rough.motion.take(each), rough.energy[each], images))
        for step in FINER_SPINS_RAD:
            rows = np.full(2, np.argmin(voted.energy - noise * voted.nats))
            sides = se3.exp_so3(np.array([[-step], [step]]) * axis)
            voted = voted.and_others(votes(voted.motion.take(rows).rotated(sides), voted.energy[rows], images))
    best, nats = voted.preferred(noise), voted.nats
    turned = se3.angle_between(voted.motion.poses().R[best], voted.motion.poses().R).mean(axis=-1) > MIN_TURN_RAD
    others = turned & (voted.correlation >= MIN_CORRELATION)
    against = np.max(nats[others], initial=nats[best]) - nats[best]
    vote = TextureVote(float(voted.correlation[best]), float(nats[best] - nats[0]), float(against), unread)
    chosen = found
    if best:
        last = minimise(
            voted.motion.take(np.array([best])), energy(FINAL_LEVEL_PX, frames), T_cam_hand, REFIT_ITERATIONS
        )
        core = last.motion.core if isinstance(last.motion, Soft) else last.motion
        chosen = make_method_result(last, core if isinstance(core, Hinge) else None, found.energy_of)
    first, kept = chosen.energy[:1], np.flatnonzero(np.arange(len(found.energy)) != best)
    owed = np.maximum(found.energy[kept] + noise * np.maximum(nats[best] - nats[kept], 0.0), first)
    order = np.argsort(owed, kind="stable")
    assert chosen.motion is not None
    every = chosen.motion.take(np.zeros(1, int)).concatenate(motion.take(kept[order]))
    chosen = replace(chosen, poses=every.poses(), motion=every, energy=np.concatenate([first, owed[order]]))
    return replace(chosen, warp=found.warp, hand=found.hand, texture=vote)


def _look_alike_turns(problem: Problem, found: MethodResult) -> Float[ndarray, "6 3 3"]:
    """Return half turns about the principal axes, and reflections along the ray and across each, in the object frame.

    The ray is that to the object in the middle frame.
    """
    axes, middle = problem.surface.axes, len(problem.clip) // 2
    T_cam_hand = problem.clip.hand.T_cam_hand[middle]
    ray = se3.transform(T_cam_hand, found.poses.centre[0, middle][None])[0]
    ray = (T_cam_hand[:3, :3] @ found.poses.R[0, middle]).T @ (ray / np.linalg.norm(ray))
    across = np.eye(3) - 2.0 * axes[:, :, None] * axes[:, None, :]
    return np.concatenate([se3.exp_so3(np.pi * axes), (np.eye(3) - 2.0 * np.outer(ray, ray)) @ across])


def _spread_poses(voted: _Votes, axis: Float[ndarray, "3"]) -> Int[ndarray, "n"]:
    """Return poses whose axis of revolution points in different directions, and whose masks fit, best first."""
    along, kept = (voted.motion.poses().R @ axis).mean(axis=1), list[int]()
    for k in np.argsort(voted.energy, kind="stable"):
        fits = voted.energy[k] <= MAX_SPUN_ENERGY * voted.energy.min()
        if fits and all(along[k] @ along[other] < np.cos(MIN_TURN_RAD) for other in kept):
            kept.append(int(k))
    return np.array(kept[:MAX_SPUN_POSES])


def _seen_frames(problem: Problem) -> tuple[list[_Seen], int]:
    """Read the images of some frames that have one, and count those that do not read."""
    clip, images, out, unread = problem.clip, problem.clip.evidence.get(TEXTURE_KEY), list[_Seen](), 0
    left_out = TEXTURE_KEY in problem.options.without
    if left_out or not isinstance(images, FrameImages) or clip.mesh.colours is None:
        return out, unread
    for n in frame_indices(len(clip), N_TEXTURE_FRAMES):
        shown = problem.masks.object[n] & ~problem.masks.ignore[n]
        rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
        if (path := images.paths[n]) is None or not len(rows):
            continue
        try:
            image = read_image(path, clip.size)
        except InputError:  # a pose needs no images
            unread += 1
            continue
        top, left, bottom, right = rows[0], columns[0], rows[-1] + 1, columns[-1] + 1
        zoom = min(1.0, TEXTURE_SIDE_PX / max(bottom - top, right - left))
        size = max(2, round((right - left) * zoom)), max(2, round((bottom - top) * zoom))
        seen, mask = (
            cv2.resize(one[top:bottom, left:right].astype(np.float32), size, interpolation=cv2.INTER_AREA)
            for one in (image, shown)
        )
        K = clip.K[n].copy()
        K[:2, 2] -= left, top
        K[:2] *= np.array([size[0] / (right - left), size[1] / (bottom - top)])[:, None]
        out.append(_Seen(int(n), K, mask > 0.99, _without_light(seen, mask > 0.99)))
    return out, unread


def _compare(
    problem: Problem, mesh: Mesh, scale: float, T_hand_obj: Float[ndarray, "T 4 4"], images: list[_Seen]
) -> tuple[float, float]:
    """Return the correlation of a pose's colours with the images', and the number of independent places."""
    assert mesh.colours is not None
    hand, products, places = problem.clip.hand.T_cam_hand, np.zeros(3), 0.0
    for seen in images:
        posed = se3.transform(hand[seen.frame] @ T_hand_obj[seen.frame], scale * mesh.vertices)
        face = depth_and_face(posed, mesh.faces, seen.K, seen.mask.shape[::-1])[1]
        picture = np.zeros(seen.colours.shape, np.float32)
        picture[face >= 0] = interpolate_vertex_values(posed, mesh.faces, seen.K, face, mesh.colours.astype(float))
        mask = seen.mask & (face >= 0)
        inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
        if np.count_nonzero(inner) < MIN_COMPARED_PX:
            continue
        first, second = (
            np.where(inner[..., None], _scaled(one, inner), 0.0)
            for one in (seen.colours, _without_light(picture, mask))
        )
        products += _best_shifted_product(first, second), np.sum(first**2), np.sum(second**2)
        places += np.count_nonzero(inner) / INDEPENDENT_PX
    if not products[1:].all():
        return 0.0, places
    return float(products[0] / np.sqrt(products[1] * products[2])), places


def _without_light(image: Float32[ndarray, "h w 3"], mask: Bool[ndarray, "h w"]) -> Float32[ndarray, "h w 3"]:
    """Return an image without its smooth part within a mask."""
    weight = mask.astype(np.float32)
    share = np.maximum(cv2.GaussianBlur(weight, (0, 0), SMOOTH_PX), 1e-3)[..., None]
    smooth = cv2.GaussianBlur(image * weight[..., None], (0, 0), SMOOTH_PX) / share
    return np.asarray(cv2.GaussianBlur(image, (0, 0), FINE_PX) - smooth, np.float32)


def _scaled(rest: Float32[ndarray, "h w 3"], mask: Bool[ndarray, "h w"]) -> Float32[ndarray, "h w 3"]:
    """Scale colours to about unit variance within a mask; those of a plain image nearly to zero."""
    return np.asarray(rest / (3.0 + rest[mask].std()), np.float32)


def _best_shifted_product(first: Float32[ndarray, "h w 3"], second: Float32[ndarray, "h w 3"]) -> float:
    """Return the sum of the products of two pictures, one of them shifted so that it is largest."""
    size = [fft.next_fast_len(side + MAX_SHIFT_PX, real=True) for side in first.shape[:2]]  # shifts do not wrap around
    both = [fft.rfft2(one, size, axes=(0, 1)) for one in (first, second)]
    shifts = np.arange(-MAX_SHIFT_PX, MAX_SHIFT_PX + 1)
    product = fft.irfft2(np.sum(both[0].conj() * both[1], axis=2), size)
    return float(product[np.ix_(shifts, shifts)].max())
