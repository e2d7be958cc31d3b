"""What every method is given and gives back: a clip prepared for fitting, poses made into a reconstruction."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks, read_masks, read_seen, seen_frames
from getagrip.clip.occlusion import hidden_by_hand
from getagrip.fitting import pose_priors as priors
from getagrip.fitting.energy.mask import Surface
from getagrip.fitting.motion import InHand
from getagrip.fitting.observation import Observation, observe
from getagrip.fitting.options import Options
from getagrip.fitting.search import distinct, spread
from getagrip.fitting.surface import Shape
from getagrip.kernels.silhouette import silhouettes, unpack
from getagrip.result import Axis, Candidates, Reconstruction

AMBIGUOUS = 1.05
"""A distinct candidate within this factor of the best energy makes a result ambiguous."""


@dataclass(frozen=True)
class Problem:
    """A clip at the frames that are used."""

    clip: Clip
    masks: Masks
    observation: Observation
    shape: Shape
    options: Options
    poses: Float[ndarray, "k 4 4"]
    """``T_hand_obj`` to start from, besides even rotations."""
    notes: tuple[str, ...]
    """Dropped frames, guesses, starts, what was made up for what was not given."""


@dataclass(frozen=True)
class Found:
    """Solutions of a method, best first: K of them."""

    T_hand_obj: Float[ndarray, "K T 4 4"]
    scale: Float[ndarray, "K"]
    energy: Float[ndarray, "K"]
    terms: dict[str, float]
    """The best one's energy per term."""
    status: str
    axis: Axis | None = None
    """The best one's, where the method has one."""


def read_sampled(clip: Clip, frames: int) -> tuple[Clip, Masks]:
    """The frames of a clip that ``prepare`` uses, and their masks: the others' are read one by one, and not kept."""
    if len(clip) > frames:
        clip = seen_frames(clip, read_seen(clip))
        clip = clip.take(spread(len(clip), frames))
    return clip, read_masks(clip)


def prepare(clip: Clip, masks: Masks, options: Options) -> Problem:
    """Leave out frames without an object, sample the rest linearly, crop.

    Raises ``InputError`` for fewer than 2 frames, and for starting poses as ``priors.poses_for`` does.
    """
    seen = masks.seen
    clip = seen_frames(clip, seen)
    index = spread(len(clip), options.frames)
    clip = clip.take(index)
    if len(clip) < len(seen):
        masks = masks.take(np.flatnonzero(seen)[index])
    notes = []
    if clip.left_out:
        names = ", ".join(clip.left_out)
        notes.append(f"{len(clip.left_out)} frames without a visible object were left out: {names}")
    if options.occlusion and not masks.ignore.any():
        masks = hidden_by_hand(clip, masks)
        notes.append("no ignore masks: what the drawn hand covers outside the object's mask counts as hidden")
    poses, of_starts = priors.poses_for(clip, options)
    notes += of_starts
    notes += [f"{key}: {text}" for key, text in clip.provenance.items() if "guess" in str(text).lower()]
    observation = observe(masks, clip.K, options.occlusion)
    return Problem(clip, masks, observation, Shape.of(clip.mesh), options, poses, tuple(notes))


def answer(problem: Problem, found: Found, clock: Clock) -> Reconstruction:
    """The reconstruction that a method's solutions stand for."""
    clip, options = problem.clip, problem.options
    R = found.T_hand_obj[..., :3, :3]
    centre = R @ clip.mesh.centre * found.scale[:, None, None] + found.T_hand_obj[..., :3, 3]
    order = distinct(InHand(R, centre, found.scale), found.energy, problem.shape, len(found.energy))
    T, scale, energy = found.T_hand_obj[order], found.scale[order], found.energy[order]
    iou = mask_iou(clip, problem.masks, T[0], float(scale[0]))
    guess = f"the scale {scale[0]:.3f} is a guess from the masks and the hand's size, not a measurement"
    clock("finish")
    return Reconstruction(
        clip=clip.name,
        method=options.method,
        frames=clip.frames,
        T_hand_obj=T[0],
        scale=float(scale[0]),
        iou=iou,
        axis=found.axis,
        candidates=Candidates(T, scale, energy),
        energy={"total": float(energy[0]), **found.terms},
        status=found.status,
        ambiguous=bool(len(order) > 1 and energy[1] < AMBIGUOUS * energy[0]),
        seconds=clock.seconds(),
        options=asdict(options),
        seed=options.seed,
        notes=(*problem.notes, *([guess] if clip.scale == "free" else [])),
    )


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


class Clock:
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
