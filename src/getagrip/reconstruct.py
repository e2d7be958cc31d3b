"""The method on one page: from a clip and its masks to the object in the hand, in every frame (paper, Sec. 3.3)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip import camera, se3
from getagrip.clip import FINGERS, Clip, Masks, seen_frames
from getagrip.contact import HandContacts, distances, solid
from getagrip.energy import Term
from getagrip.energy.mask import MaskTerm, Surface
from getagrip.energy.pull import PullTerm
from getagrip.energy.push import PushTerm
from getagrip.errors import GetagripError, UsageError
from getagrip.kernels.silhouette import silhouettes, unpack
from getagrip.mesh import decimate
from getagrip.motion import Fixed, Free, Hinge, Motion, Soft
from getagrip.observation import Observation, observe
from getagrip.result import Axis, Candidates, Reconstruction
from getagrip.search import Schedule, Stage, hinge_from, search, spread
from getagrip.solve import Solution, Status

Method = Literal["one-dof", "soft-hinge", "static", "dynamic"]

STEP = {64: 1.0, 128: 2.0, 256: 3.0}
"""Distance of contour points at each level [px of the level]."""
DELTA = {64: 2.0, 128: 1.0, 256: 1.0}
"""Distances below this count as this in the curvature of E_mask [px of the crop]."""
CONTACTS = {64: 8, 128: None, 256: None}
"""Vertices of each contact region in use at each level; all of them at the finer ones."""
COARSE_FACES, FINE_FACES = 1000, 4000
"""Objects of more faces are decimated: to so many for 64-pixel silhouettes and contact, and for the finer ones."""
PHYSICAL = 0.25
"""The paper sums E_mask over pixels, which leaves push and pull without effect; the authors' code divides it by the
area of the mask. Ours multiplies push and pull by this fraction of the mean area of the masks instead."""
AMBIGUOUS = 1.05
"""A distinct candidate within this factor of the best energy makes a result ambiguous."""
SAME = 0.02
"""Candidates whose surfaces are nearer than this, in diameters, on average, are one."""


@dataclass(frozen=True)
class Options:
    """How to reconstruct a clip."""

    method: Method = "soft-hinge"
    """How the object may move in the hand: turn about one axis, as in the paper (one-dof); deviate from that a little
    in each frame (soft-hinge); not at all (static); freely (dynamic)."""
    inits: int = 50
    """Starting rotations, spread evenly over all rotations; 50 is about the least, 100 is safe."""
    seed: int = 0
    """Turns the set of starting rotations; the same seed gives the same result."""
    frames: int = 30
    """Frames sampled linearly from the clip."""
    push: float = 0.1
    """Weight of E_push, the paper's lambda_2 without the focal length."""
    pull: float = 0.1
    """Weight of E_pull, the paper's lambda_3 without the focal length."""
    axis: Literal["free", "hand"] = "free"
    """Where the axis of one-dof lies: anywhere (free), or through the origin of the hand frame (hand)."""
    occlusion: bool = True
    """Leave out pixels hidden by the hand (the paper's C_o)."""

    def __post_init__(self) -> None:
        if self.inits < 1 or self.frames < 2:
            raise UsageError(f"inits and frames: got {self.inits} and {self.frames}, expected at least 1 and 2")
        if self.seed < 0:
            raise UsageError(f"seed: got {self.seed}, expected 0 or more")
        if not (0 <= self.push < np.inf and 0 <= self.pull < np.inf):
            raise UsageError(f"push and pull: got {self.push} and {self.pull}, expected finite weights of 0 or more")


def reconstruct(
    clip: Clip, masks: Masks, options: Options = Options(), progress: Callable[[str, float], None] | None = None
) -> Reconstruction:
    """Find the object's pose in the hand in every frame by comparing rendered and observed masks (Eq. 4).

    ``progress`` is called with the name of the stage that has ended and the fraction done. Raises ``InputError`` when
    the object is seen in fewer than two frames and ``GetagripError`` when nothing can be rendered.
    """
    clock = _Clock(progress)
    clip, masks, dropped = seen_frames(clip, masks)
    index = spread(len(clip), options.frames)
    clip, masks = clip.take(index), Masks(masks.object[index], masks.ignore[index])
    centre = clip.mesh.centre
    observation = observe(masks, clip.K, use_ignore=options.occlusion)
    clock("prepare")
    solution = search(
        starts=_starts(clip, masks, options),
        model=_model(options),
        terms_at=_energy(clip, observation, options),
        T_cam_hand=clip.hand.T_cam_hand,
        corners=_box(clip.mesh.vertices - centre),
        schedule=Schedule().softened() if options.method == "soft-hinge" else Schedule(),
        watch=clock,
    )
    if not len(solution.energy):
        raise GetagripError(f"{clip.name}: {Status.INVISIBLE}")
    T, scale = _poses(solution, centre)
    order = _distinct_shapes(clip, T, scale)
    T, scale, solution = T[order], scale[order], solution.take(order)
    iou = mask_iou(clip, masks, T[0], float(scale[0]))
    clock("finish")
    motion = solution.motion
    return Reconstruction(
        clip=clip.name,
        method=options.method,
        frames=clip.frames,
        T_hand_obj=T[0],
        scale=float(scale[0]),
        iou=iou,
        axis=_axis(motion.core if isinstance(motion, Soft) else motion),
        candidates=Candidates(T, scale, solution.energy),
        energy={"total": float(solution.energy[0]), **{k: float(v[0]) for k, v in solution.terms.items()}},
        status=solution.status[0].value,
        ambiguous=bool(len(order) > 1 and solution.energy[1] < AMBIGUOUS * solution.energy[0]),
        seconds=clock.seconds(),
        options=asdict(options),
        seed=options.seed,
        notes=_notes(clip, dropped, float(scale[0])),
    )


def _energy(clip: Clip, observation: Observation, options: Options) -> Callable[[Stage, Int[ndarray, "n"]], list[Term]]:
    """The terms of Eq. 4 for a stage, with lambda_f, the focal length in pixels of the crop."""
    fine = decimate(clip.mesh, FINE_FACES)
    coarse = decimate(clip.mesh, COARSE_FACES)
    centre = clip.mesh.centre
    surface = {64: Surface.of(coarse, centre)}
    surface[128] = surface[256] = surface[64] if fine is coarse else Surface.of(fine, centre)
    touch = solid(coarse, centre)
    hands = {level: HandContacts.of(clip.hand, count) for level, count in CONTACTS.items()}
    physical = PHYSICAL * observation.area.mean() * observation.K[:, 0]

    def terms(stage: Stage, index: Int[ndarray, "n"]) -> list[Term]:
        level = stage.level
        at, hand = observation.take(index), hands[level].take(index)
        coverage = 1.0 if level == 64 else 0.0
        mask = MaskTerm(surface[level], at, level, step=STEP[level], delta=DELTA[level], coverage=coverage)
        push = PushTerm(touch, hand, options.push * physical[index])
        pull = PullTerm(touch, hand, options.pull * physical[index])
        return [mask, *([push] if options.push else []), *([pull] if options.pull else [])]

    return terms


def _model(options: Options) -> Callable[[Soft[Fixed]], Motion]:
    """From the search's loose fit to the motion model of the method."""
    if options.method == "static":
        return lambda loose: loose.core
    if options.method == "dynamic":

        def free(loose: Soft[Fixed]) -> Free:
            held = loose.poses()
            return Free(held.R, held.centre, loose.core.log_scale, loose.core.free_scale)

        return free
    return lambda loose: hinge_from(loose, options.axis == "free", np.zeros(3))


def _starts(clip: Clip, masks: Masks, options: Options) -> Fixed:
    """Rotations spread over SO(3); the object's centre where the hand grips and the masks' centres cross."""
    turn = se3.exp_so3(np.random.default_rng(options.seed).uniform(-1.0, 1.0, 3)) if options.seed else np.eye(3)
    R = turn @ se3.super_fibonacci(options.inits)
    boxes = camera.bounding_boxes(masks.object).astype(float)
    point = _grip_point(clip, (boxes[:, :2] + boxes[:, 2:]) / 2.0)
    scale = 1.0
    if clip.scale == "free":
        depth = se3.transform(clip.hand.T_cam_hand, point[None, None])[:, 0, 2]
        seen = np.linalg.norm(boxes[:, 2:] - boxes[:, :2], axis=1) * depth / clip.K[:, 0, 0]
        scale = float(np.clip(np.median(seen) / clip.mesh.diameter, 0.2, 5.0))
    B = options.inits
    return Fixed(R, np.tile(point, (B, 1)), np.full(B, np.log(scale)), len(clip), clip.scale == "free")


def _grip_point(clip: Clip, uv: Float[ndarray, "T 2"]) -> Float[ndarray, "3"]:
    """The point of the hand frame nearest to the rays through the masks' centres and to the hand's grip [m].

    The grip is the mean of the contact regions; a ray counts as much as the grip at 2 cm against 5 cm of spread,
    all rays together as four, since what the hand hides biases them all alike.
    """
    hand = clip.hand
    grip = np.mean([hand.vertices[:, hand.regions[name]].mean(axis=(0, 1)) for name in FINGERS], axis=0)
    R_hand_cam = np.swapaxes(hand.T_cam_hand[:, :3, :3], 1, 2)
    eye = -(R_hand_cam @ hand.T_cam_hand[:, :3, 3, None])[..., 0]
    ray = (R_hand_cam @ camera.backproject(clip.K, uv[:, None])[:, 0, :, None])[..., 0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    ray_weight, grip_weight = 4.0 / (len(ray) * 0.02**2), 1.0 / 0.05**2
    A = ray_weight * across.sum(axis=0) + grip_weight * np.eye(3)
    return np.linalg.solve(A, ray_weight * (across @ eye[..., None])[..., 0].sum(axis=0) + grip_weight * grip)


def _poses(
    solution: Solution[Motion], centre: Float[ndarray, "3"]
) -> tuple[Float[ndarray, "K T 4 4"], Float[ndarray, "K"]]:
    """T_hand_obj of the mesh as it is, not about its centre, and the scale."""
    held = solution.motion.poses()
    offset = held.scale[:, None, None] * (held.R @ centre)
    return se3.rigid(held.R, held.centre - offset), held.scale


def _distinct_shapes(clip: Clip, T: Float[ndarray, "K T 4 4"], scale: Float[ndarray, "K"]) -> Int[ndarray, "n"]:
    """Candidates that place the object's surface differently; turning a bottle about its axis makes no new one."""
    surface = solid(decimate(clip.mesh, COARSE_FACES), np.zeros(3))
    points = clip.mesh.vertices[spread(len(clip.mesh.vertices), 200)]
    T = T[:, spread(len(clip), 3)]
    placed = se3.transform(T, scale[:, None, None, None] * points)
    chosen: list[int] = []
    for k in range(len(T)):
        back = [se3.transform(se3.inverse(T[c]), placed[k]).reshape(-1, 3) / scale[c] for c in chosen]
        grid = (surface.corners, surface.normals, surface.face, surface.distance, surface.origin, surface.spacing)
        gaps = [float(distances(x, *grid).mean()) for x in back]
        if all(gap > SAME * clip.mesh.diameter for gap in gaps):
            chosen.append(k)
    return np.array(chosen)


def mask_iou(clip: Clip, masks: Masks, T_hand_obj: Float[ndarray, "T 4 4"], scale: float) -> Float[ndarray, "T"]:
    """IOU of rendered and observed object mask on the full image, outside ignored pixels."""
    T_cam_obj = clip.hand.T_cam_hand @ T_hand_obj
    surface = Surface.of(clip.mesh, np.zeros(3))
    K = np.stack([clip.K[:, 0, 0], clip.K[:, 1, 1], clip.K[:, 0, 2], clip.K[:, 1, 2]], axis=1)
    width, height = clip.size
    bits = np.empty((len(clip), height, -(-width // 64)), np.uint64)
    R, t = np.ascontiguousarray(T_cam_obj[:, :3, :3]), np.ascontiguousarray(T_cam_obj[:, :3, 3])
    silhouettes(
        R, t, np.full(len(clip), scale),
        surface.vertices, surface.planes, surface.edges, surface.closed, K, bits,
    )  # fmt: skip
    care = masks.object | ~masks.ignore
    rendered = unpack(bits, width) & care
    union = (rendered | masks.object).sum(axis=(1, 2))
    return np.asarray((rendered & masks.object).sum(axis=(1, 2)) / np.maximum(union, 1))


def _axis(motion: Motion) -> Axis | None:
    """The axis of the best candidate, where there is one."""
    if not isinstance(motion, Hinge):
        return None
    hinge = motion.zero_mean()
    return Axis(hinge.point[0], hinge.direction[0], hinge.angle[0])


def _box(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "8 3"]:
    """Corners of the bounding box, the first and the last opposite."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([[(low, high)[(i >> k) & 1][k] for k in range(3)] for i in range(8)])


def _notes(clip: Clip, dropped: tuple[str, ...], scale: float) -> tuple[str, ...]:
    """What a reader must know: dropped frames, guessed quantities."""
    notes = []
    if dropped:
        notes.append(f"{len(dropped)} frames without a visible object were left out: {', '.join(dropped)}")
    if clip.scale == "free":
        notes.append(f"the scale {scale:.3f} is a guess from the masks and the hand's size, not a measurement")
    notes += [f"{key}: {text}" for key, text in clip.provenance.items() if "guess" in str(text).lower()]
    return tuple(notes)


class _Clock:
    """Seconds per stage, and the caller's progress."""

    STAGES = ("prepare", "coarse", "middle", "fine", "finest", "finish")

    def __init__(self, progress: Callable[[str, float], None] | None) -> None:
        self.progress, self.spent, self.since = progress, dict[str, float](), time.perf_counter()

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.spent[stage], self.since = now - self.since, now
        if self.progress:
            self.progress(stage, len(self.spent) / len(self.STAGES))

    def seconds(self) -> dict[str, float]:
        return {"total": sum(self.spent.values()), **self.spent}
