"""Synthetic clips with ground truth: a generic hand holds a procedural object before a moving, head-worn camera.

The grasp comes from contact (``grasp``). The object moves in the hand nearly about one axis, or as in real grasps, and
the fingers follow (``in_hand_motion``); hand and head move smoothly. All is drawn for a right hand; a left hand's clip
is the exact mirror image. The ground truth depends on seed, category and the scene's options. Noise has a random stream
of its own, so that clips with and without it share their ground truth (noise is not mirrored).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.clip import Clip, FrameMasks, HandTrack, Masks, Truth, World
from getagrip.errors import UsageError, check_arguments
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import Surface, render_rgb, true_masks
from getagrip.geometry.warp import align_similarity
from getagrip.hands import generic
from getagrip.hands.grips import CATEGORY_PRIORS, Grip
from getagrip.hands.model import hand_track, mirrored
from getagrip.result import Axis
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from getagrip.synthetic.grasp import Grasper, SignedDistance, looseness, perturb_grip
from getagrip.synthetic.in_hand_motion import (
    draw_egocentric_poses,
    draw_hinge_motion,
    draw_measured_motion,
    draw_other_hand,
)
from getagrip.synthetic.noise import perturbed
from getagrip.synthetic.objects import draw_deformation
from getagrip.synthetic.scene_options import SceneOptions

Shape = Callable[[Float[ndarray, "n 3"]], Float[ndarray, "n 3"]]
N_GRIP_DRAWS = 3
"""Number of grips that are drawn for a choice, where grips vary."""


@dataclass(frozen=True)
class Scene:
    """A clip without noise, with the parts of the scene that a clip does not hold.

    Attributes:
        clip: the clip, with ground truth and without noise.
        object: the visible object, at its true size, in the frame of ``truth.T_cam_obj`` [m].
        axis: the axis about which the object turns, in the hand frame.
        other_hand: (T, V, 3) vertices of the other hand in the camera frame [m]; None without another hand.
        options: options of the scene.
    """

    clip: Clip
    object: Mesh
    axis: Axis
    other_hand: Float[ndarray, "T V 3"] | None
    options: SceneOptions

    def surfaces(self, frame: int) -> tuple[Surface, list[Surface]]:
        """Return the grasped object and the hands in the camera frame."""
        clip, truth = self.clip, self.clip.truth
        assert truth is not None
        grasped = se3.transform(truth.T_cam_obj[frame], self.object.vertices)
        hands = [(se3.transform(truth.T_cam_hand[frame], truth.hand_vertices[frame]), clip.hand.faces)]
        if self.other_hand is not None:
            hands.append((self.other_hand[frame], clip.hand.faces[:, ::-1]))
        return (grasped, self.object.faces), hands


@check_arguments
def synthesise(category: str, seed: int = 0, options: SceneOptions | None = None) -> tuple[Clip, Masks]:
    """Make a synthetic clip with ground truth, and its masks, in memory.

    A generic hand grasps an object of the category and rotates it nearly about one axis in front of a moving camera.
    The clip contains the noisy hand, the mesh and, in ``clip.clip``, the ground truth.

    Args:
        category: kind of object, such as "mug": a key of ``getagrip.synthetic.categories.SYNTHETIC_CATEGORIES``.
        seed: seed of the random choices, 0 or more. The same seed and options give the same clip.
        options: length, camera, motion and noise of the clip; by default 30 frames of 640 x 480 pixels without noise.

    Raises:
        UsageError: for an unknown category, a negative seed, or fewer than 2 frames.
    """
    scene = make_scene(category, seed, options or SceneOptions())
    return perturbed(scene.clip, ground_truth_masks(scene), scene.options, noise_seed(category, seed))


def noise_seed(category: str, seed: int) -> list[int]:
    return [seed, *category.encode(), 1]


def make_scene(category: str, seed: int, options: SceneOptions) -> Scene:
    """Make the scene of a clip, without noise. Raises ``UsageError`` as ``synthesise`` does."""
    if category not in SYNTHETIC_CATEGORIES:
        raise UsageError(f"unknown category {category!r}; choose from {', '.join(sorted(SYNTHETIC_CATEGORIES))}")
    if seed < 0:
        raise UsageError(f"seed must be 0 or more (got {seed})")
    if options.frames < 2:
        raise UsageError(f"frames must be at least 2 (got {options.frames})")
    rng, moves = np.random.default_rng([seed, *category.encode()]).spawn(2)
    stretch = 1.0 + options.vary * rng.uniform(-1.0, 1.0, 3)
    mean = SYNTHETIC_CATEGORIES[category]()
    shaped = _object_shape_map(mean, stretch, category, seed, options)
    grasped = Mesh(shaped(mean.vertices), mean.faces)
    grip = CATEGORY_PRIORS[category].grips[rng.integers(len(CATEGORY_PRIORS[category].grips))]
    grip = replace(grip, at=tuple(shaped(np.array([grip.at]))[0] + rng.normal(0.0, 0.002, 3)))
    model = generic.load("right")
    hand = model.with_shape(rng.normal(0.0, 0.04, len(model.shape_names)))
    if options.grip_deg > 0.0:
        grip = _draw_grip(category, seed, shaped, options, Grasper(hand, SignedDistance(grasped), grip.hold))
    grasper = Grasper(hand, SignedDistance(grasped), grip.hold)

    T_base = grasper.approach(grip)
    if options.motion == "measured":
        own = _independent_rng(category, seed, 3)
        moved = draw_measured_motion(grasper, T_base, grasped, options.frames, own)
    else:
        moved = draw_hinge_motion(grasper, T_base, options, rng)
    T_hand_grasped, posed = moved.T_hand_obj, moved.posed
    centre = se3.transform(T_hand_grasped, grasped.centre[None]).mean(axis=0)[0]
    middle = (posed.joints[:, 9].mean(axis=0) + centre) / 2.0
    pose, diameter = T_hand_grasped[0], grasped.diameter
    T_world_cam, T_world_hand = draw_egocentric_poses(pose, middle, diameter, options.frames, moves)
    T_cam_hand = se3.inverse(T_world_cam) @ T_world_hand
    unknown = 1.0 if options.scale == "known" else float(rng.uniform(0.8, 1.25))
    T_grasped_cad, size = np.eye(4), 1.0
    if options.cad == "mean":
        T_grasped_cad, size = align_similarity(mean, grasped, resize=options.scale == "free")
    track = hand_track(posed, T_cam_hand)
    fps = options.frames / moved.duration if moved.duration else options.fps
    width, height = options.size
    K = np.array([[options.focal, 0.0, width / 2.0], [0.0, options.focal, height / 2.0], [0.0, 0.0, 1.0]])
    clip = Clip(
        name=clip_name(category, seed, options),
        category=category,
        side="right",
        fps=fps,
        frames=tuple(f"{n:06d}" for n in range(options.frames)),
        times=np.arange(options.frames) / fps,
        world=World(T_world_cam, np.array([0.0, 0.0, 1.0])),
        size=options.size,
        K=np.broadcast_to(K, (options.frames, 3, 3)).copy(),
        mesh=Mesh((mean if options.cad == "mean" else grasped).vertices / unknown, grasped.faces),
        scale=options.scale,
        hand=track,
        truth=Truth(T_cam_hand @ T_hand_grasped @ T_grasped_cad, size * unknown, T_cam_hand, track.vertices),
        provenance={"source": "synthetic, by getagrip", "seed": seed, "options": asdict(options)},
    )
    other = draw_other_hand(grasper, T_cam_hand, middle, moves) if options.other_hand else None
    shown = Mesh(se3.transform(se3.inverse(T_grasped_cad), grasped.vertices), grasped.faces)
    scene = Scene(clip, shown, moved.axis, other, options)
    return scene if options.side == "right" else mirror_scene(scene)


def _independent_rng(category: str, seed: int, number: int) -> np.random.Generator:
    """Random stream of a clip that leaves the streams shared by all clips unchanged."""
    return np.random.default_rng([seed, *category.encode(), number])


def _object_shape_map(
    mean: Mesh, stretch: Float[ndarray, "3"], category: str, seed: int, options: SceneOptions
) -> Shape:
    """Map from points of the category's mean shape to points of the object."""
    stretched = Mesh(mean.vertices * stretch, mean.faces)
    if options.deform == 0.0:
        return lambda X: X * stretch
    deformation = draw_deformation(stretched, options.deform, _independent_rng(category, seed, 4))
    return lambda X: deformation(X * stretch)


def _draw_grip(category: str, seed: int, shaped: Shape, options: SceneOptions, grasper: Grasper) -> Grip:
    """Draw a grip of the category: of a few random deviations from a usual grip, the one that holds best."""
    kind = CATEGORY_PRIORS[category]
    rng = _independent_rng(category, seed, 2)
    grips = (*kind.grips, *kind.rarer)
    usual = grips[rng.integers(len(grips))]
    return draw_near_grip(replace(usual, at=tuple(shaped(np.array([usual.at]))[0])), options.grip_deg, grasper, rng)


def draw_near_grip(usual: Grip, degrees: float, grasper: Grasper, rng: np.random.Generator) -> Grip:
    """Draw a few random deviations from a grip, by a root mean square rotation, and return the one that holds best."""
    grasper = replace(grasper, hold=usual.hold)

    def badness(grip: Grip) -> float:
        T = grasper.approach(grip)[None]
        return looseness(grasper.gaps(grasper.close(T), T)[0], grip.hold)

    return min((perturb_grip(usual, degrees, 8.0, rng) for _ in range(N_GRIP_DRAWS)), key=badness)


def clip_name(category: str, seed: int, options: SceneOptions) -> str:
    return f"{category}-{options.side}-{seed:04d}"


def mirror_scene(scene: Scene) -> Scene:
    """Mirror the scene: a left hand, the object's own y axis reversed so that poses stay rigid."""
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
        world=clip.world and World(flip @ clip.world.T_world_cam @ flip, clip.world.up, clip.world.support),
        mesh=mirror_mesh(clip.mesh),
        hand=hand,
        truth=Truth(flip @ truth.T_cam_obj @ own, truth.scale, hand.T_cam_hand, hand.vertices),
    )
    other = None if scene.other_hand is None else mirrored(scene.other_hand)
    turned = Axis(mirrored(axis.point), -mirrored(axis.direction), axis.angle)  # a mirror reverses rotations
    return replace(scene, clip=mirrored_clip, object=mirror_mesh(scene.object), axis=turned, other_hand=other)


def mirror_mesh(mesh: Mesh) -> Mesh:
    """Reverse a mesh's own y axis."""
    return Mesh(mesh.vertices * np.array([1.0, -1.0, 1.0]), mesh.faces[:, ::-1].copy(), mesh.colours)


def ground_truth_masks(scene: Scene) -> Masks:
    """Render the scene's true masks."""
    clip = scene.clip
    surfaces = [scene.surfaces(n) for n in range(len(clip))]
    drawn = zip(surfaces, clip.K, strict=True)
    return Masks.of(FrameMasks(*true_masks(grasped, hands, [], K, clip.size)) for (grasped, hands), K in drawn)


def render_pictures(scene: Scene) -> list[UInt8[ndarray, "H W 3"]]:
    """Render plain images of the scene, one per frame."""
    width, height = scene.options.size
    shade = np.linspace(0.93, 0.74, height)[:, None, None] * np.array([1.0, 0.98, 0.95])
    background = np.broadcast_to(255.0 * shade, (height, width, 3)).astype(np.uint8)
    images = []
    for n in range(len(scene.clip)):
        grasped, hands = scene.surfaces(n)
        meshes = [(*grasped, (0.47, 0.60, 0.68)), *((*hand, (0.86, 0.68, 0.58)) for hand in hands)]
        K = scene.clip.K[n]
        uv = project(K, np.concatenate([vertices for vertices, _, _ in meshes]))
        left, top = np.clip(np.floor(uv.min(axis=0)).astype(int), 0, (width - 1, height - 1))
        right, bottom = np.clip(np.ceil(uv.max(axis=0)).astype(int), (left + 1, top + 1), (width, height))
        image = background.copy()
        window = image[top:bottom, left:right]  # rendering the full image would take much longer
        shift = np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
        window[:] = render_rgb(meshes, K - shift, (window.shape[1], window.shape[0]), window)
        images.append(image)
    return images
