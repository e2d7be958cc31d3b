"""Synthetic clips with ground truth: a generic hand holds a procedural object in front of a moving, egocentric camera.

The grasp comes from contact (``grasp``); the object turns in the hand about a line near the contacts (Eq. 3 of the
paper) and departs from that by a small smooth residual, and the fingers follow it; hand and head move smoothly.
Everything is drawn for a right hand; the left hand's clip is its exact mirror image. The ground truth depends on the
seed, the category and the options of the scene. Noise has its own random stream, so the same ground truth can be had
with and without it (noise is not mirrored).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks, Truth
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.datasets.synthetic.egocentric import about, other_hand, seen_from_head, smooth
from getagrip.datasets.synthetic.grasp import NEAR, Grasper, Grip, SignedDistance, looseness, thumb_miss, varied
from getagrip.datasets.synthetic.noise import perturbed
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.render import Surface, render_rgb, true_masks
from getagrip.hands import generic
from getagrip.hands.model import PosedHand, hand_track, mirrored
from getagrip.result import Axis

DEEPEST = 0.0035
"""How deep the object may turn into the open hand [m]."""
DRAWS = 3
"""Grips to choose from, where they vary."""


@dataclass(frozen=True)
class Scene:
    """A clip without noise, and what a clip does not hold.

    Attributes:
        clip: the clip, with ground truth and without noise.
        object: the object that the images show, at its true size, in the frame of ``truth.T_cam_obj`` [m].
        axis: the axis that the object turns about, in the hand frame.
        other_hand: (T, V, 3) vertices of the other hand in the camera frame [m]; None where it is not in the images.
        options: what the scene was made with.
    """

    clip: Clip
    object: Mesh
    axis: Axis
    other_hand: Float[ndarray, "T V 3"] | None
    options: SceneOptions

    def surfaces(self, frame: int) -> tuple[Surface, list[Surface]]:
        """The held object and the hands in the camera frame."""
        clip, truth = self.clip, self.clip.truth
        assert truth is not None
        held = se3.transform(truth.T_cam_obj[frame], self.object.vertices)
        hands = [(se3.transform(truth.T_cam_hand[frame], truth.hand_vertices[frame]), clip.hand.faces)]
        if self.other_hand is not None:
            hands.append((self.other_hand[frame], clip.hand.faces[:, ::-1]))
        return (held, self.object.faces), hands


def synthesise(category: str, seed: int = 0, options: SceneOptions | None = None) -> tuple[Clip, Masks]:
    """A synthetic clip with ground truth, and its masks, in memory.

    A generic hand grasps an object of the category and turns it about one axis, nearly, before a moving camera. The
    clip holds the noisy hand (``options.hand_*`` and ``finger_*``), the mesh and, in ``clip.truth``, the ground truth.

    Args:
        category: kind of object, such as "mug": a key of ``getagrip.datasets.synthetic.categories.CATEGORIES``.
        seed: seed of all that is random, 0 or more. The same seed and options give the same clip.
        options: length, camera, motion and noise of the clip; by default 30 frames of 640 x 480 pixels without noise.

    Raises:
        UsageError: for an unknown category, a negative seed, or fewer than 2 frames.
    """
    scene = make_scene(category, seed, options or SceneOptions())
    return perturbed(scene.clip, ground_truth_masks(scene), scene.options, noise_seed(category, seed))


def noise_seed(category: str, seed: int) -> list[int]:
    """The seed of a clip's noise."""
    return [seed, *category.encode(), 1]


def make_scene(category: str, seed: int, options: SceneOptions) -> Scene:
    """The scene, without noise. Raises ``UsageError`` as ``synthesise`` does."""
    if category not in CATEGORIES:
        raise UsageError(f"category: got {category!r}, expected one of {', '.join(sorted(CATEGORIES))}")
    if seed < 0:
        raise UsageError(f"seed: got {seed}, expected 0 or more")
    if options.frames < 2:
        raise UsageError(f"frames: got {options.frames}, expected at least 2")
    kind = CATEGORIES[category]
    rng, moves = np.random.default_rng([seed, *category.encode()]).spawn(2)
    stretch = 1.0 + options.vary * rng.uniform(-1.0, 1.0, 3)
    mean = kind.make()
    held = Mesh(mean.vertices * stretch, mean.faces)
    grip = kind.grips[rng.integers(len(kind.grips))]
    grip = replace(grip, at=tuple(stretch * grip.at + rng.normal(0.0, 0.002, 3)))
    model = generic.load("right")
    hand = model.with_shape(rng.normal(0.0, 0.04, len(model.shape_names)))
    if options.grip_deg > 0.0:
        grip = _drawn_grip(category, seed, stretch, options, Grasper(hand, SignedDistance(held), grip.hold))
    grasper = Grasper(hand, SignedDistance(held), grip.hold)

    T_base = grasper.approach(grip)
    axis = _axis(grasper, T_base, options, rng)
    T_hand_held, posed = _turned(grasper, T_base, axis, options, rng)
    middle = (posed.joints[:, 9].mean(axis=0) + se3.transform(T_hand_held, held.centre[None]).mean(axis=0)[0]) / 2.0
    T_cam_hand = seen_from_head(T_hand_held[0], middle, held.diameter, options.frames, moves)
    unknown = 1.0 if options.scale == "known" else float(rng.uniform(0.8, 1.25))
    T_held_cad, size = np.eye(4), 1.0
    if options.cad == "mean":
        T_held_cad, size = aligned(mean, held, resize=options.scale == "free")
    track = hand_track(posed, T_cam_hand)
    width, height = options.size
    K = np.array([[options.focal, 0.0, width / 2.0], [0.0, options.focal, height / 2.0], [0.0, 0.0, 1.0]])
    clip = Clip(
        name=clip_name(category, seed, options),
        category=category,
        side="right",
        fps=options.fps,
        frames=tuple(f"{n:06d}" for n in range(options.frames)),
        size=options.size,
        K=np.broadcast_to(K, (options.frames, 3, 3)).copy(),
        mesh=Mesh((mean if options.cad == "mean" else held).vertices / unknown, held.faces),
        scale=options.scale,
        hand=track,
        truth=Truth(T_cam_hand @ T_hand_held @ T_held_cad, size * unknown, T_cam_hand, track.vertices),
        provenance={"source": "synthetic, by getagrip", "seed": seed, "options": asdict(options)},
    )
    other = other_hand(grasper, T_cam_hand, middle, moves) if options.other_hand else None
    shown = Mesh(se3.transform(se3.inverse(T_held_cad), held.vertices), held.faces)
    scene = Scene(clip, shown, axis, other, options)
    return scene if options.side == "right" else _mirror_image(scene)


def aligned(cad: Mesh, held: Mesh, resize: bool) -> tuple[Float[ndarray, "4 4"], float]:
    """``T_held_cad`` and the scale that bring a CAD nearest to the object that it stands for, vertex by vertex.

    Minimised is sum_i a_i |x_i - (R s y_i + t)|^2 over corresponding vertices x of ``held`` and y of ``cad``, with a_i
    the areas of ``held``; s stays 1 unless ``resize`` (Umeyama, "Least-squares estimation of transformation
    parameters", 1991).
    """
    a = held.vertex_areas / held.vertex_areas.sum()
    x0, y0 = a @ held.vertices, a @ cad.vertices
    x, y = held.vertices - x0, cad.vertices - y0
    R = se3.nearest_rotation((a[:, None] * x).T @ y)
    size = float(np.sum(a[:, None] * x * (y @ R.T)) / np.sum(a[:, None] * y * y)) if resize else 1.0
    return se3.rigid(R, x0 - size * R @ y0), size


def _drawn_grip(
    category: str, seed: int, stretch: Float[ndarray, "3"], options: SceneOptions, grasper: Grasper
) -> Grip:
    """Any grip of the category, at random off the usual: of a few draws the one that holds the object best."""
    kind = CATEGORIES[category]
    rng = np.random.default_rng([seed, *category.encode(), 2])
    grips = (*kind.grips, *kind.rarer)
    usual = grips[rng.integers(len(grips))]
    usual = replace(usual, at=tuple(stretch * usual.at))
    grasper = replace(grasper, hold=usual.hold)

    def badness(grip: Grip) -> float:
        T = grasper.approach(grip)[None]
        return looseness(grasper.gaps(grasper.close(T), T)[0], grip.hold)

    return min((varied(usual, options.grip_deg, 8.0, rng) for _ in range(DRAWS)), key=badness)


def _turned(
    grasper: Grasper, T_base: Float[ndarray, "4 4"], axis: Axis, options: SceneOptions, rng: np.random.Generator
) -> tuple[Float[ndarray, "T 4 4"], PosedHand]:
    """``T_hand_obj`` of the object as it turns about the axis, nearly, and the hand that follows it."""
    line = se3.rotation_about_line(axis.point, axis.direction, axis.angle)
    residual = about(
        axis.point,
        np.radians(options.residual_deg) * smooth(rng, options.frames, 3),
        1e-3 * options.residual_mm * smooth(rng, options.frames, 3),
    )
    keys = np.linspace(axis.angle.min(), axis.angle.max(), 5)
    T_keys = se3.rotation_about_line(axis.point, axis.direction, keys) @ T_base
    closed = grasper.close(T_keys)
    if thumb_miss(grasper.gaps(closed, T_keys)) > NEAR:
        grasper = grasper.steered(closed, T_keys)
        closed = grasper.close(T_keys)
    bent = np.stack([np.interp(axis.angle, keys, joint) for joint in closed.reshape(len(keys), 15).T], axis=-1)
    return residual @ line @ T_base, grasper.posed(bent.reshape(-1, 5, 3))


def clip_name(category: str, seed: int, options: SceneOptions) -> str:
    """What the clip is called."""
    return f"{category}-{options.side}-{seed:04d}"


def _axis(grasper: Grasper, T_base: Float[ndarray, "4 4"], options: SceneOptions, rng: np.random.Generator) -> Axis:
    """A line near the contacts about which the object can turn with the least way into the open hand."""
    closed = grasper.posed(grasper.close(T_base[None]))
    gap = grasper.distance(se3.transform(se3.inverse(T_base), closed.vertices[0]))
    contact = closed.vertices[0][gap < 0.003]
    directions = rng.normal(size=(24, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = contact.mean(axis=0) + rng.normal(0.0, 0.008, (24, 3))
    curve = smooth(rng, options.frames, 1)[:, 0]
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
        mesh=_flipped(clip.mesh),
        hand=hand,
        truth=Truth(flip @ truth.T_cam_obj @ own, truth.scale, hand.T_cam_hand, hand.vertices),
    )
    other = None if scene.other_hand is None else mirrored(scene.other_hand)
    turned = Axis(mirrored(axis.point), -mirrored(axis.direction), axis.angle)  # a mirror turns rotations round
    return replace(scene, clip=mirrored_clip, object=_flipped(scene.object), axis=turned, other_hand=other)


def _flipped(mesh: Mesh) -> Mesh:
    """The mesh with its own y axis turned round."""
    return Mesh(mesh.vertices * np.array([1.0, -1.0, 1.0]), mesh.faces[:, ::-1].copy())


def ground_truth_masks(scene: Scene) -> Masks:
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
