"""Synthetic clips that several tests look at, made once in each process, and how near results come to the truth.

Nothing may be changed in the clips.

Reconstructions of synthetic clips that several tests look at, made once in each process.

A clip whose object turns in the hand.

A synthetic clip that is not cut: an object lies while a hand comes, and is carried away before a moving head.

A synthetic timeline: an object lies, a hand comes, and carries it away.

A mug that turns in a hand, which is an egg: the clip, and its perfect result.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

from getagrip.clip import FINGERS, Clip, HandTrack, Masks, OtherHand, Segment, Truth, World, input_sha256, write_clip
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import render_coverage, true_masks
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import METRICS
from getagrip.reconstruct import reconstruct
from getagrip.result import Axis, Candidates, Reconstruction, Status, write_result
from getagrip.synthetic import objects
from getagrip.synthetic.noise import perturbed
from getagrip.synthetic.scene import ground_truth_masks, make_scene, noise_seed
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import small_clip

SMALL = SceneOptions(frames=8, size=(320, 240), focal=300.0)
SHORT = SceneOptions(frames=4, size=(320, 240), focal=300.0)


@cache
def scene_with_axis(category: str, seed: int, options: SceneOptions = SMALL) -> tuple[Clip, Masks, Axis]:
    """As ``synthesise`` makes it, and the axis that the object turns about."""
    made = make_scene(category, seed, options)
    noise = noise_seed(category, seed)
    return *perturbed(made.clip, ground_truth_masks(made), made.options, noise), made.axis


def scene(category: str, seed: int, options: SceneOptions = SMALL) -> tuple[Clip, Masks]:
    return scene_with_axis(category, seed, options)[:2]


def scores(result: Reconstruction, clip: Clip, masks: Masks) -> dict[str, float]:
    """Metrics of masks and poses alone: those of contact take as long as a reconstruction."""
    wanted = [metric for metric in METRICS.values() if metric.name.startswith(("iou", "add", "scale"))]
    metrics: dict[str, float] = evaluate(result, clip, masks, wanted=wanted).metrics
    return metrics


DEFAULT = Options(inits=16)


@cache
def found(category: str, seed: int, clip_options: SceneOptions = SMALL, options: Options = DEFAULT) -> Reconstruction:
    return reconstruct(*scene(category, seed, clip_options), options)


def unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def ball(radius: float) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def turning(name: str = "turning", side: str = "right") -> Clip:
    """30 frames of 50 an object turns about an axis through the hand's middle, by 1 rad; then it is off, and tumbles.

    The hand is a ball whose fingertips are five patches; the object a long thin one that it holds at one end.
    """
    rng = np.random.default_rng(0)
    hand = ball(0.03)
    mesh = ball(0.03)
    mesh = Mesh(mesh.vertices * [1.0, 0.6, 0.6] + [0.05, 0.0, 0.0], mesh.faces)
    spin = se3.rotation_about_line(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.linspace(-0.1, 0.1, 50))
    spin[30:] = se3.rigid(se3.exp_so3(rng.normal(size=(20, 3))), np.array([0.2, 0.0, 0.0]))
    T_cam_hand = se3.rigid(se3.exp_so3(0.3 * rng.normal(size=(50, 3))), np.array([0.0, 0.0, 0.6]))
    vertices = np.tile(hand.vertices, (50, 1, 1))
    regions = {finger: np.arange(10 * n, 10 * n + 8) for n, finger in enumerate((*FINGERS, "palm_edge"))}
    track = HandTrack(vertices, hand.faces, T_cam_hand, regions)
    truth = Truth(T_cam_hand @ spin, 1.0, T_cam_hand, vertices)
    clip = small_clip(50)[0]
    return replace(clip, name=name, side=side, mesh=mesh, hand=track, truth=truth)


LYING, HOLDING = 18, 24
COMES_FROM = 0.15
"""How far away the hand is at first [m]."""


@cache
def from_table(category: str = "bottle", seed: int = 1) -> tuple[Clip, Masks]:
    """``LYING`` frames in which the object lies and the hand comes near, then ``HOLDING`` in which it is held."""
    held, _ = scene(category, seed, SceneOptions(frames=HOLDING, size=(320, 240), focal=300.0))
    truth, world = held.truth, held.world
    assert truth is not None
    assert world is not None
    back = np.r_[np.arange(LYING, 0, -1), np.arange(HOLDING)]  # the head moves as it will, in reverse
    first = np.r_[np.zeros(LYING, int), np.arange(HOLDING)]  # the hand grips before it comes
    away = np.r_[np.linspace(1.0, 0.1, LYING), np.zeros(HOLDING)]
    T_world_cam = world.T_world_cam[back]
    T_world_hand = (world.T_world_cam @ truth.T_cam_hand)[first]
    T_world_hand[:, :3, 3] += away[:, None] * [0.0, 0.0, COMES_FROM]
    T_cam_world = se3.inverse(T_world_cam)
    T_cam_hand, T_cam_obj = T_cam_world @ T_world_hand, T_cam_world @ (world.T_world_cam @ truth.T_cam_obj)[first]
    hand = HandTrack(truth.hand_vertices[first], held.hand.faces, T_cam_hand, held.hand.regions)
    clip = replace(
        held, frames=(), times=None, K=held.K[first], hand=hand, world=World(T_world_cam, world.up), folder=None,
        truth=Truth(T_cam_obj, truth.scale, T_cam_hand, hand.vertices), name="from-table",
    )  # fmt: skip
    clip = replace(clip, frames=tuple(f"{n:06d}" for n in range(len(T_world_cam))))
    pairs = [
        true_masks(
            (se3.transform(T_cam_obj[n], truth.scale * held.mesh.vertices), held.mesh.faces),
            [(se3.transform(T_cam_hand[n], hand.vertices[n]), hand.faces)], [], clip.K[n], clip.size,
        )
        for n in range(len(clip))
    ]  # fmt: skip
    return clip, Masks(np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs]))


LIES, COMES = 5, 2
"""Frames in which the object lies, and of these at the end, in which the hand is near."""


@cache
def timeline(category: str = "mug", seed: int = 0, options: SceneOptions = SMALL) -> tuple[Clip, Masks]:
    """A grasp of 8 frames; before it, the object lies still as it is grasped, the hand 20 cm aside, then nearer."""
    grasp, masks = scene(category, seed, options)
    assert grasp.world is not None
    assert grasp.truth is not None
    before = np.zeros(LIES + COMES, dtype=int)
    clip = grasp.take(np.concatenate([before, np.arange(len(grasp))]))
    hand = clip.hand.T_cam_hand.copy()
    aside = np.concatenate([np.full(LIES, 0.2), np.linspace(0.15, 0.05, COMES)])
    hand[: len(before), 0, 3] += aside if grasp.side == "right" else -aside
    truth = Truth(clip.truth.T_cam_obj, grasp.truth.scale, hand, clip.truth.hand_vertices)  # type: ignore[union-attr]
    frames = tuple(f"{n:06d}" for n in range(len(clip)))
    lowest = se3.transform(grasp.world.T_world_cam[0] @ grasp.truth.T_cam_obj[0], grasp.mesh.vertices)[:, 2].min()
    world = World(clip.world.T_world_cam, np.array([0.0, 0.0, 1.0]), float(lowest))  # type: ignore[union-attr]
    segments = (
        Segment("static", 0, LIES - 1),
        Segment("contact", LIES, LIES + COMES - 1, grasp.side),
        Segment("grasp", LIES + COMES, len(clip) - 1, grasp.side),
    )
    clip = replace(
        clip, hand=replace(clip.hand, T_cam_hand=hand), truth=truth, frames=frames, times=None, world=world,
        segments=segments,
    )  # fmt: skip
    seen, ignored = [], []
    for n in range(len(before)):
        body = se3.transform(truth.T_cam_obj[n], grasp.mesh.vertices), grasp.mesh.faces
        arm = se3.transform(hand[n], clip.hand.vertices[n]), clip.hand.faces
        visible, ignore, _ = true_masks(body, [arm], [], clip.K[n], clip.size)
        seen.append(visible)
        ignored.append(ignore)
    return clip, Masks(
        np.concatenate([np.stack(seen), masks.object]), np.concatenate([np.stack(ignored), masks.ignore])
    )


def by_other_hand() -> tuple[Clip, Masks]:
    """The same, but the clip's own hand is the other one, which stands 30 cm aside; that which grasps is not known in
    the first two frames, nor in one within the grasp."""
    clip, masks = timeline()
    assert clip.truth is not None
    assert clip.hand.joints is not None
    mirror = np.array([-1.0, 1.0, 1.0])
    T = np.repeat(clip.hand.T_cam_hand[:1], len(clip), axis=0)
    T[:, 0, 3] -= 0.3
    own = HandTrack(
        mirror * clip.hand.vertices, clip.hand.faces[:, ::-1], T, clip.hand.regions, mirror * clip.hand.joints
    )
    known = np.setdiff1d(np.arange(len(clip)), [0, 1, len(clip) - 3])
    return replace(
        clip, side="left", hand=own, other_hand=OtherHand.at(clip.hand.take(known), known, len(clip)),
        truth=replace(clip.truth, T_cam_hand=T, hand_vertices=own.vertices),
    ), masks  # fmt: skip


FRAMES = 5


def egg_and_mug() -> tuple[Clip, Masks]:
    """A mug that turns in a hand, which is an egg."""
    rng = np.random.default_rng(0)
    egg = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    vertices = np.tile(np.asarray(egg.vertices) * [1.5, 1.0, 0.7], (FRAMES, 1, 1))
    steps = se3.exp_so3(rng.normal(scale=0.2, size=(FRAMES, 3)))
    T_cam_hand = se3.rigid(steps, rng.normal([0.0, 0.0, 0.5], 0.02, (FRAMES, 3)))
    line = se3.rotation_about_line(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.linspace(0.0, 0.4, FRAMES))
    T_hand_obj = line @ se3.rigid(t=np.array([0.0, 0.07, -0.05]))
    clip = Clip(
        name="egg-and-mug",
        category="mug",
        side="right",
        fps=30.0,
        frames=tuple(f"{n:06d}" for n in range(FRAMES)),
        size=(320, 240),
        K=np.tile([[400.0, 0.0, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]], (FRAMES, 1, 1)),
        mesh=objects.mug(),
        scale="known",
        hand=HandTrack(vertices, np.asarray(egg.faces), T_cam_hand, {f: np.array([n]) for n, f in enumerate(FINGERS)}),
        truth=Truth(T_cam_hand @ T_hand_obj, 1.0, T_cam_hand, vertices),
    )
    assert clip.truth is not None
    posed = se3.transform(clip.truth.T_cam_obj, clip.mesh.vertices)
    drawn = [
        render_coverage(vertices, clip.mesh.faces, K, clip.size) for vertices, K in zip(posed, clip.K, strict=True)
    ]
    return clip, Masks(np.stack(drawn), np.zeros((FRAMES, 240, 320), dtype=bool))


def perfect(clip: Clip, name: str = "egg-and-mug") -> Reconstruction:
    assert clip.truth is not None
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    return Reconstruction(
        clip=name,
        method="static",
        frames=clip.frames,
        T_hand_obj=T,
        scale=clip.truth.scale,
        iou=np.ones(len(clip)),
        axis=None,
        candidates=Candidates(T[None], np.array([clip.truth.scale]), np.zeros(1)),
        energy={"total": 0.0},
        status=Status.FINISHED,
        ambiguous=False,
        seconds={"total": 0.0},
    )


def written(scene: tuple[Clip, Masks], folder: Path) -> tuple[Path, Path]:
    """The clip and a perfect result of it, in folders."""
    clip = write_clip(*scene, folder / "clips" / scene[0].name)
    result = perfect(scene[0])
    return clip, write_result(result, folder / "results" / scene[0].name, input_sha256(clip), clip_folder=clip)


def same(a: dict[str, float], b: dict[str, float], tolerance: float = 1e-6) -> None:
    assert a.keys() == b.keys()
    for key, value in a.items():
        assert value == pytest.approx(b[key], abs=tolerance, nan_ok=True), key
