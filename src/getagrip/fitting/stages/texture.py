"""Texture: the colours of the mesh against those of the images, which tell front from back where no silhouette does.

Compared are the solutions, the best one's half turns about its principal axes, and its mirror images in depth: of a
shape with a plane of symmetry, a pose reflected along the ray has nearly the same silhouette. All are fitted to the
masks again, and rendered with the mesh's colours. Inside the visible part of the mask, colours of image and picture are
compared without what light changes: each channel without its smooth part, scaled to unit variance. With correlation r
over n independent places, the image is more probable by -n/2 log(1 - r^2) than without any texture. Plain, missing or
wrong colours correlate with no pose, and decide nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

from getagrip.checks.evidence import TextureVote
from getagrip.clip.clip import frame_indices
from getagrip.errors import InputError
from getagrip.fitting.evidence.texture import TEXTURE_KEY, FrameImages
from getagrip.fitting.methods.all_frames import make_method_result
from getagrip.fitting.motion import Hinge, Soft
from getagrip.fitting.motion.base import hand_object_transforms
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.solve import minimise
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.geometry.rasterize import depth_and_face, interpolate_vertex_values
from getagrip.io.images import read_image

N_TEXTURE_FRAMES, TEXTURE_SIDE_PX, MAX_TEXTURE_FACES = 6, 96, 20_000
"""Number of compared frames, longest side of the object's mask in them [px], and maximum number of the mesh's faces."""
SMOOTH_PX, INDEPENDENT_PX = 12.0, 36.0
"""Standard deviation of the smooth part, which shading makes, and area of an independent place [px, px^2]."""
MIN_CORRELATION, MIN_GAIN_NATS = 0.3, 10.0
"""Least correlation of a pose that texture prefers, and least gain over the best by the masks. Assumed."""
MIN_COMPARED_PX = 200
"""Minimum number of pixels of a frame that are compared."""
MIN_TURN_RAD = np.radians(45.0)
"""Rotation from the result beyond which a pose that texture prefers contradicts the result."""
REFIT_LEVEL_PX, REFIT_ITERATIONS, FINAL_LEVEL_PX = 128, 8, 256
"""Resolution [px] and iterations of the fit of the compared poses, and resolution of the chosen one's."""


def prefer_texture(problem: Problem, found: MethodResult) -> MethodResult:
    """Return the solutions, first the one that texture and masks together prefer, with the texture's vote.

    The problem is as found, so that a hand that was solved with the object stays as it is. Solutions that texture
    finds less probable than the first have more energy. Unchanged are results where mesh or images have no colours.
    """
    images, mesh = _compared_images(problem), decimate(problem.clip.mesh, MAX_TEXTURE_FACES)
    if not images or mesh.colours is None or found.motion is None or found.energy_of is None:
        return found
    motion, T_cam_hand = found.motion, problem.clip.hand.T_cam_hand
    turns = _look_alike_turns(problem, found)
    energy, frames = found.energy_of(problem), np.arange(len(problem.clip))
    some = motion.concatenate(motion.take(np.zeros(len(turns), int)).rotated(turns))
    tried = minimise(some, energy(REFIT_LEVEL_PX, frames), T_cam_hand, REFIT_ITERATIONS, threads=problem.threads)
    poses = tried.motion.poses()
    T_hand_obj = hand_object_transforms(poses, problem.surface.mesh.centre)
    r, n = np.array(
        [_compare(problem, mesh, scale, T, images) for T, scale in zip(T_hand_obj, poses.scale, strict=True)]
    ).T
    nats = -0.5 * n * np.log1p(-(np.clip(r, 0.0, 0.99) ** 2))
    noise = 2.0 * found.terms["mask"] / len(frames)  # of a frame's masks, as in ``confidence.pose_spread``
    cost = np.where(np.isfinite(tried.energy) & (r >= MIN_CORRELATION), tried.energy - noise * nats, np.inf)
    best = int(np.argmin(cost))
    if not cost[best] < tried.energy[0] - noise * (nats[0] + MIN_GAIN_NATS):
        best = 0
    turned = se3.angle_between(poses.R[best], poses.R).mean(axis=-1) > MIN_TURN_RAD
    against = np.max(nats[turned & (r >= MIN_CORRELATION)], initial=nats[best]) - nats[best]
    vote = TextureVote(float(r[best]), float(nats[best] - nats[0]), float(against))
    chosen = found
    if best:
        last = minimise(
            tried.motion.take(np.array([best])), energy(FINAL_LEVEL_PX, frames), T_cam_hand, REFIT_ITERATIONS
        )
        core = last.motion.core if isinstance(last.motion, Soft) else last.motion
        chosen = make_method_result(last, core if isinstance(core, Hinge) else None, found.energy_of)
    first, others = chosen.energy[:1], np.flatnonzero(np.arange(len(found.energy)) != best)
    owed = np.maximum(found.energy[others] + noise * np.maximum(nats[best] - nats[others], 0.0), first)
    order = np.argsort(owed, kind="stable")
    assert chosen.motion is not None
    every = chosen.motion.take(np.zeros(1, int)).concatenate(motion.take(others[order]))
    return replace(
        chosen,
        poses=every.poses(),
        motion=every,
        energy=np.concatenate([first, owed[order]]),
        warp=found.warp,
        hand=found.hand,
        texture=vote,
    )


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


def _compared_images(problem: Problem) -> dict[int, UInt8[ndarray, "H W 3"]]:
    """Read the images of some frames; those that are missing or do not read are left out: a pose needs none."""
    clip, images = problem.clip, problem.clip.evidence.get(TEXTURE_KEY)
    out = dict[int, UInt8[ndarray, "H W 3"]]()
    if not isinstance(images, FrameImages) or clip.mesh.colours is None:
        return out
    for n in frame_indices(len(clip), N_TEXTURE_FRAMES):
        try:
            if (path := images.paths[n]) is not None:
                out[int(n)] = read_image(path, clip.size)
        except InputError:
            continue
    return out


def _compare(
    problem: Problem,
    mesh: Mesh,
    scale: float,
    T_hand_obj: Float[ndarray, "T 4 4"],
    images: dict[int, UInt8[ndarray, "H W 3"]],
) -> tuple[float, float]:
    """Return the correlation of a pose's colours with the images', and the number of independent places."""
    import cv2

    assert mesh.colours is not None
    clip, products, places = problem.clip, np.zeros(3), 0.0
    for n, image in images.items():
        shown = problem.masks.object[n] & ~problem.masks.ignore[n]
        rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
        if not len(rows):
            continue
        top, left, bottom, right = rows[0], columns[0], rows[-1] + 1, columns[-1] + 1
        zoom = min(1.0, TEXTURE_SIDE_PX / max(bottom - top, right - left))
        size = max(2, round((right - left) * zoom)), max(2, round((bottom - top) * zoom))
        seen = cv2.resize(image[top:bottom, left:right].astype(np.float32), size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(shown[top:bottom, left:right].astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
        K = clip.K[n].copy()
        K[:2, 2] -= left, top
        K[:2] *= np.array([size[0] / (right - left), size[1] / (bottom - top)])[:, None]
        posed = se3.transform(clip.hand.T_cam_hand[n] @ T_hand_obj[n], scale * mesh.vertices)
        face = depth_and_face(posed, mesh.faces, K, size)[1]
        picture = np.zeros((size[1], size[0], 3), np.float32)
        picture[face >= 0] = interpolate_vertex_values(posed, mesh.faces, K, face, mesh.colours.astype(float))
        mask &= face >= 0
        mask = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
        if np.count_nonzero(mask) < MIN_COMPARED_PX:
            continue
        first, second = (_without_light(each, mask) for each in (seen, picture))
        products += np.sum(first * second), np.sum(first**2), np.sum(second**2)
        places += np.count_nonzero(mask) / INDEPENDENT_PX
    if not products[1:].all():
        return 0.0, places
    return float(products[0] / np.sqrt(products[1] * products[2])), places


def _without_light(image: Float32[ndarray, "h w 3"], mask: ndarray) -> Float32[ndarray, "n 3"]:
    """Return the masked pixels without their smooth part, of about unit variance; of a plain image nearly zero."""
    import cv2

    weight = mask.astype(np.float32)
    share = np.maximum(cv2.GaussianBlur(weight, (0, 0), SMOOTH_PX), 1e-3)[..., None]
    smooth = cv2.GaussianBlur(image * weight[..., None], (0, 0), SMOOTH_PX) / share
    rest = (cv2.GaussianBlur(image, (0, 0), 1.0) - smooth)[mask]
    return np.asarray(rest / (3.0 + rest.std()), np.float32)
