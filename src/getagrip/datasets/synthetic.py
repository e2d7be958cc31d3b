"""Made-up clips with known truth: a generic hand holds a procedural object in front of a moving, egocentric camera.

The grasp comes from contact (``grasp``); the object turns in the hand about a line near the contacts (Eq. 3 of the
paper) and departs from that by a small smooth residual, and the fingers follow it; hand and head move smoothly.
Everything is drawn for a right hand; the left hand's clip is its exact mirror image. The truth depends on the seed, the
category and the options of the scene; noise has its own random stream, so it can be turned on for the same truth
(it is not mirrored).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip import se3
from getagrip.camera import project
from getagrip.clip import Clip, HandTrack, Masks, Truth
from getagrip.datasets.categories import CATEGORIES
from getagrip.datasets.grasp import Grasper, SignedDistance
from getagrip.datasets.noise import Noise, perturbed
from getagrip.errors import UsageError
from getagrip.hands import generic
from getagrip.hands.model import hand_track, mirrored
from getagrip.mesh import Mesh
from getagrip.render import Surface, render_rgb, true_masks
from getagrip.result import Axis

DEEPEST = 0.0035
"""How deep the object may turn into the open hand [m]."""


@dataclass(frozen=True)
class Options(Noise):
    """What a made-up clip is like; the noise on top of its truth is ``Noise``'s."""

    frames: int = 30
    fps: float = 30.0
    size: tuple[int, int] = (640, 480)
    """Width and height of the images [px]."""
    focal: float = 600.0
    """Focal length [px]."""
    side: Literal["left", "right"] = "right"
    scale: Literal["known", "free"] = "known"
    """Free: the clip's mesh is the true object divided by an unknown scale between 0.8 and 1.25."""
    vary: float = 0.08
    """How much each axis of the object may be stretched or shrunk."""
    turn_deg: tuple[float, float] = (10.0, 60.0)
    """Least and largest range of the angle about the axis over the clip."""
    residual_deg: float = 1.0
    """Largest turn of the object in the hand besides the one about the axis."""
    residual_mm: float = 1.0
    """Largest shift of the object in the hand."""
    other_hand: bool = False
    """Whether the other hand comes in front."""


@dataclass(frozen=True)
class Scene:
    """A clip without noise, and what a clip does not hold."""

    clip: Clip
    axis: Axis
    """The line that the object turns about, in the hand frame."""
    other_hand: Float[ndarray, "T V 3"] | None
    """Vertices of the other hand in the camera frame [m]."""
    options: Options

    def surfaces(self, frame: int) -> tuple[Surface, list[Surface]]:
        """The held object and the hands in the camera frame."""
        clip, truth = self.clip, self.clip.truth
        assert truth is not None
        held = se3.transform(truth.T_cam_obj[frame], truth.scale * clip.mesh.vertices)
        hands = [(se3.transform(truth.T_cam_hand[frame], truth.hand_vertices[frame]), clip.hand.faces)]
        if self.other_hand is not None:
            hands.append((self.other_hand[frame], clip.hand.faces[:, ::-1]))
        return (held, clip.mesh.faces), hands


def synthesise(category: str, seed: int, options: Options | None = None) -> tuple[Clip, Masks]:
    """A clip of one category and its masks; the same for the same seed and options.

    Raises ``UsageError`` for an unknown category.
    """
    scene = make_scene(category, seed, options or Options())
    return perturbed(scene.clip, seen_masks(scene), scene.options, noise_seed(category, seed))


def noise_seed(category: str, seed: int) -> list[int]:
    """The seed of a clip's noise."""
    return [seed, *category.encode(), 1]


def make_scene(category: str, seed: int, options: Options) -> Scene:
    """The true motion. Raises ``UsageError`` for an unknown category or fewer than two frames."""
    if category not in CATEGORIES:
        raise UsageError(f"category: got {category!r}, expected one of {', '.join(sorted(CATEGORIES))}")
    if options.frames < 2:
        raise UsageError(f"frames: got {options.frames}, expected at least 2")
    kind = CATEGORIES[category]
    rng, moves = np.random.default_rng([seed, *category.encode()]).spawn(2)
    stretch = 1.0 + options.vary * rng.uniform(-1.0, 1.0, 3)
    made = kind.make()
    mesh = Mesh(made.vertices * stretch, made.faces)
    grip = kind.grips[rng.integers(len(kind.grips))]
    grip = replace(grip, at=tuple(stretch * grip.at + rng.normal(0.0, 0.002, 3)))
    model = generic.load("right")
    hand = model.with_shape(rng.normal(0.0, 0.04, len(model.shape_names)))
    grasper = Grasper(hand, SignedDistance(mesh), grip.hold)

    T_base = grasper.approach(grip)
    axis = _axis(grasper, T_base, options, rng)
    line = se3.rotation_about_line(axis.point, axis.direction, axis.angle)
    residual = _about(
        axis.point,
        np.radians(options.residual_deg) * _smooth(rng, options.frames, 3),
        1e-3 * options.residual_mm * _smooth(rng, options.frames, 3),
    )
    T_hand_obj = residual @ line @ T_base
    keys = np.linspace(axis.angle.min(), axis.angle.max(), 5)
    T_keys = se3.rotation_about_line(axis.point, axis.direction, keys) @ T_base
    closed = grasper.close(T_keys)
    bent = np.stack([np.interp(axis.angle, keys, joint) for joint in closed.reshape(len(keys), 15).T], axis=-1)
    posed = grasper.posed(bent.reshape(-1, 5, 3))

    middle = (posed.joints[:, 9].mean(axis=0) + se3.transform(T_hand_obj, mesh.centre[None]).mean(axis=0)[0]) / 2.0
    T_cam_hand = _seen_from_head(T_hand_obj[0], middle, mesh.diameter, options.frames, moves)
    scale = 1.0 if options.scale == "known" else float(rng.uniform(0.8, 1.25))
    track = hand_track(posed, T_cam_hand)
    width, height = options.size
    K = np.array([[options.focal, 0.0, width / 2.0], [0.0, options.focal, height / 2.0], [0.0, 0.0, 1.0]])
    clip = Clip(
        folder=Path(),
        name=clip_name(category, seed, options),
        category=category,
        side="right",
        fps=options.fps,
        frames=tuple(f"{n:06d}" for n in range(options.frames)),
        size=options.size,
        K=np.broadcast_to(K, (options.frames, 3, 3)).copy(),
        mesh=Mesh(mesh.vertices / scale, mesh.faces),
        scale=options.scale,
        hand=track,
        truth=Truth(T_cam_hand @ T_hand_obj, scale, T_cam_hand, track.vertices),
        provenance={"source": "made up by getagrip", "seed": seed, "options": asdict(options)},
    )
    other = _other_hand(grasper, T_cam_hand, middle, moves) if options.other_hand else None
    scene = Scene(clip, axis, other, options)
    return scene if options.side == "right" else _mirror_image(scene)


def clip_name(category: str, seed: int, options: Options) -> str:
    """What the clip is called."""
    return f"{category}-{options.side}-{seed:04d}"


def _axis(grasper: Grasper, T_base: Float[ndarray, "4 4"], options: Options, rng: np.random.Generator) -> Axis:
    """A line near the contacts about which the object can turn with the least way into the open hand."""
    closed = grasper.posed(grasper.close(T_base[None]))
    gap = grasper.distance(se3.transform(se3.inverse(T_base), closed.vertices[0]))
    contact = closed.vertices[0][gap < 0.003]
    directions = rng.normal(size=(24, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = contact.mean(axis=0) + rng.normal(0.0, 0.008, (24, 3))
    curve = _smooth(rng, options.frames, 1)[:, 0]
    curve = (curve - curve.min()) / np.ptp(curve) - 0.5
    least, most = np.radians(options.turn_deg)
    turn = rng.uniform(least, most)
    while True:  # a smaller turn where every axis leads deep into the hand
        ends = np.array([-0.5, 0.5]) * turn
        T = se3.rotation_about_line(points[:, None], directions[:, None], ends) @ T_base
        depth = -grasper.distance(se3.transform(se3.inverse(T), grasper.opened().vertices)).min(axis=(1, 2))
        best = int(np.argmin(depth))
        if depth[best] < DEEPEST or turn <= least:
            return Axis(points[best], directions[best], turn * curve)
        turn = max(0.8 * turn, least)


def _seen_from_head(
    T_hand_obj: Float[ndarray, "4 4"],
    middle: Float[ndarray, 3],
    diameter: float,
    frames: int,
    rng: np.random.Generator,
) -> Float[ndarray, "T 4 4"]:
    """``T_cam_hand`` of a hand that lifts, carries and tilts, before a head that follows it.

    World: x right, y ahead, z up, the middle of hand and object near the origin. The object starts upright, turned
    such that the forearm comes from the right shoulder.
    """
    forearm = (T_hand_obj[:3, :3].T @ [1.0, 0.0, 0.0])[:2]
    yaw = np.arctan2(-0.8, 0.6) - np.arctan2(forearm[1], forearm[0]) + rng.normal(0.0, 0.25)
    upright = se3.exp_so3(np.array([0.0, 0.0, yaw])) @ T_hand_obj[:3, :3].T
    tilt = np.radians(rng.uniform(15.0, 45.0)) * _smooth(rng, frames, 3)
    carried = np.array([0.06, 0.04, 0.05]) * _smooth(rng, frames, 3)
    T_world_hand = _about(np.zeros(3), tilt, carried) @ se3.rigid(upright, -upright @ middle)

    away = np.clip(0.24 + 1.05 * diameter, 0.36, 0.62)
    down = np.radians(rng.uniform(30.0, 60.0))
    eye = away * np.array([0.0, -np.cos(down), np.sin(down)]) + 0.025 * _smooth(rng, frames, 3)
    target = 0.6 * carried + 0.02 * _smooth(rng, frames, 3)
    z = target - eye
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(z, np.array([0.0, 0.0, 1.0]) + 0.06 * _smooth(rng, frames, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    T_world_cam = se3.rigid(np.stack([x, np.cross(z, x), z], axis=-1), eye)
    return se3.inverse(T_world_cam) @ T_world_hand


def _other_hand(
    grasper: Grasper, T_cam_hand: Float[ndarray, "T 4 4"], middle: Float[ndarray, 3], rng: np.random.Generator
) -> Float[ndarray, "T V 3"]:
    """A relaxed left hand that drifts over part of the object, in the camera frame [m]."""
    frames = len(T_cam_hand)
    relaxed = np.radians([(0.0, 10.0, 10.0), *((25.0, 30.0, 15.0),) * 4])
    vertices = mirrored(grasper.posed(relaxed).vertices)
    vertices = vertices - vertices.mean(axis=0)
    turn = se3.exp_so3(rng.normal(0.0, 0.25, 3))
    # Seen from the head: back of the hand towards the eye, fingers up and to the right.
    facing = np.array([[-0.45, 0.0, 0.9], [-0.9, 0.0, -0.45], [0.0, -1.0, 0.0]]).T
    about = se3.transform(T_cam_hand, middle[None])[:, 0].mean(axis=0)
    place = about * rng.uniform(0.72, 0.82) + np.array([-0.09, 0.03, 0.0])
    moves = _about(np.zeros(3), 0.2 * _smooth(rng, frames, 3), 0.03 * _smooth(rng, frames, 3))
    return se3.transform(se3.rigid(None, place) @ moves, vertices @ (turn @ facing).T)


def _mirror_image(scene: Scene) -> Scene:
    """The scene seen in a mirror: a left hand, the object's own y axis turned round so that poses stay rigid."""
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    own = np.diag([1.0, -1.0, 1.0, 1.0])
    clip, truth, axis = scene.clip, scene.clip.truth, scene.axis
    assert truth is not None
    assert clip.hand.joints is not None
    hand = HandTrack(
        vertices=mirrored(clip.hand.vertices),
        faces=clip.hand.faces[:, ::-1].copy(),
        T_cam_hand=flip @ clip.hand.T_cam_hand @ flip,
        regions=clip.hand.regions,
        joints=mirrored(clip.hand.joints),
    )
    mirrored_clip = replace(
        clip,
        side="left",
        mesh=Mesh(clip.mesh.vertices * np.array([1.0, -1.0, 1.0]), clip.mesh.faces[:, ::-1].copy()),
        hand=hand,
        truth=Truth(flip @ truth.T_cam_obj @ own, truth.scale, hand.T_cam_hand, hand.vertices),
    )
    other = None if scene.other_hand is None else mirrored(scene.other_hand)
    turned = Axis(mirrored(axis.point), -mirrored(axis.direction), axis.angle)  # a mirror turns rotations round
    return replace(scene, clip=mirrored_clip, axis=turned, other_hand=other)


def seen_masks(scene: Scene) -> Masks:
    """True masks of the scene."""
    pairs = []
    for n in range(len(scene.clip)):
        held, hands = scene.surfaces(n)
        pairs.append(true_masks(held, hands, [], scene.clip.K[n], scene.clip.size))
    objects, ignored = zip(*pairs, strict=True)
    return Masks(np.stack(objects), np.stack(ignored))


def pictures(scene: Scene) -> list[UInt8[ndarray, "H W 3"]]:
    """Plain pictures of the scene, one per frame."""
    width, height = scene.options.size
    shade = np.linspace(0.93, 0.74, height)[:, None, None] * np.array([1.0, 0.98, 0.95])
    background = np.broadcast_to(255.0 * shade, (height, width, 3)).astype(np.uint8)
    images = []
    for n in range(len(scene.clip)):
        held, hands = scene.surfaces(n)
        meshes = [(*held, (0.47, 0.60, 0.68)), *((*hand, (0.86, 0.68, 0.58)) for hand in hands)]
        K = scene.clip.K[n]
        uv = project(K, np.concatenate([vertices for vertices, _, _ in meshes]))
        left, top = np.clip(np.floor(uv.min(axis=0)).astype(int), 0, (width - 1, height - 1))
        right, bottom = np.clip(np.ceil(uv.max(axis=0)).astype(int), (left + 1, top + 1), (width, height))
        image = background.copy()
        window = image[top:bottom, left:right]  # drawing all of the image would take much longer
        shift = np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
        window[:] = render_rgb(meshes, K - shift, (window.shape[1], window.shape[0]), window)
        images.append(image)
    return images


def _smooth(rng: np.random.Generator, frames: int, curves: int) -> Float[ndarray, "T curves"]:
    """Random slow curves with values in [-1, 1]: a few low frequencies over the clip."""
    t = np.linspace(0.0, 1.0, frames)[:, None, None]
    frequency = np.pi * np.array([1.0, 2.0, 3.0])[:, None]
    amplitude = rng.normal(size=(3, curves)) / np.array([1.0, 2.0, 4.0])[:, None]
    curve = np.sum(amplitude * np.sin(frequency * t + rng.uniform(0.0, 2.0 * np.pi, (3, curves))), axis=1)
    return np.asarray(curve / np.abs(amplitude).sum(axis=0))


def _about(
    point: Float[ndarray, 3], turn: Float[ndarray, "T 3"], shift: Float[ndarray, "T 3"]
) -> Float[ndarray, "T 4 4"]:
    """Turn by rotation vectors [rad] about a point, then shift [m]."""
    R = se3.exp_so3(turn)
    return se3.rigid(R, point + shift - R @ point)
