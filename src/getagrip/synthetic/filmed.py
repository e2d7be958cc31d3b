"""Scenes of rendered videos for measurements: a person reaches for an object, moves it as measured, and lets go.

A benchmark whose pictures show the fitted model would measure the inverse crime. Here the hand is a person's, which
differs from the generic hand in all that a fit assumes: the length of every bone, by itself; the thickness of every
finger; the places of the joints within the flesh; how far a bend of a joint draws the skin; the depth to which flesh
yields. None of these lies in the span of the generic hand's shape parameters. Their sizes are those of human variation:
Buryanov and Kotiuk (``hands.generic``) find 7 to 15 % for single bones, some of it the error of the measurement;
thickness and the rest are assumed.

The object is a scan, or a built-in kind of another size and shape, smoothly deformed; at either end it stands while the
hand comes or goes; the camera is worn on the head or stands in front. All is drawn from kind and seed. Kinds, motions
and looks of validation lack in training: the split is a table here.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count, product
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import FINGERS, Clip, Truth, World
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import read_textured_mesh
from getagrip.geometry.warp import align_similarity
from getagrip.hands import generic
from getagrip.hands.generic import metacarpal_base, rest_fingers
from getagrip.hands.grips import CATEGORY_PRIORS, Grip
from getagrip.hands.model import KNUCKLES, PARENTS, HandModel, PosedHand, Side, hand_track
from getagrip.result import Axis
from getagrip.synthetic.categories import SHAPE_MAKERS, Split
from getagrip.synthetic.grasp import Grasper, SignedDistance
from getagrip.synthetic.in_hand_motion import (
    InHand,
    draw_measured_motion,
    draw_smooth_curves,
    rotate_about_point,
)
from getagrip.synthetic.objects import draw_deformation
from getagrip.synthetic.scene import Scene, draw_near_grip, mirror_mesh, mirror_scene
from getagrip.synthetic.scene_options import SceneOptions
from getagrip.synthetic.video import CLOTH_TONES, LAMP_DIRECTION, SKIN_TONES, TABLE_TONES, VideoLook

VALIDATION_KINDS = (
    "banana", "book", "cup", "jar", "kettle", "ketchup", "pitcher", "plate", "saucepan", "tape",
)  # fmt: skip
LATER_KINDS: dict[Split, tuple[str, ...]] = {
    "train": ("french_press", "jug", "hammer", "knife", "remote", "screwdriver"),
    "validation": ("spray_bottle", "watering_can"),
}
"""Kinds whose clips come last, so that those of the others stay as they were."""
KINDS: dict[Split, tuple[str, ...]] = {
    "train": tuple(kind for kind in SHAPE_MAKERS if kind not in (*VALIDATION_KINDS, *sum(LATER_KINDS.values(), ()))),
    "validation": VALIDATION_KINDS,
}
"""Built-in kinds, but for the later ones: of validation, and all others of training."""
SEEDS: dict[Split, range] = {"train": range(300_000, 300_008), "validation": range(400_000, 400_006)}
"""Seeds of each kind's clips, and of each scan's: 200 clips and 72 without scans."""
MOTIONS: dict[Split, tuple[str, ...]] = {"train": ("arctic",), "validation": ("dexycb", "arctic")}
"""Datasets by whose measured motion objects move in the hand."""
REACH_FRAMES, GRASP_FRAMES, FILM_FPS = 6, 24, 15.0
"""Number of frames before the grasp, and after it; number of frames of the grasp; frames per second."""
FILM_SIZE_PX = 640, 480
OBJECT_SIZE_SIGMA, MAX_STRETCH, DEFORMATION = 0.12, 0.08, 0.02
"""Standard deviation of the logarithm of a built-in kind's size, maximum relative stretch along each axis, root mean
square displacement by the smooth deformation [diameters]."""
GRIP_DEG = 10.0
"""Root mean square rotation of an object in the hand away from its usual grip [degrees]."""
RETREAT_M = np.array([0.15, 0.12, 0.08, 0.045, 0.015, 0.004])
OPENNESS = np.array([1.0, 1.0, 1.0, 0.9, 0.6, 0.25])
"""Distance of the hand from its grasp [m] and how far it is open, in the frames before the grasp and, in reverse, after
it."""
RETREAT_DIRECTION = np.array([0.55, 0.83, 0.0])
"""Direction in which an open hand leaves, in the hand frame of a right hand: back, and away from the palm."""
MAX_PALM_SPAN_M = 0.09
"""Largest side of an object around which fingers close; else a hand takes it from its thinner side [m]."""
MAX_SCAN_FACES = 40_000


HAND_SIZE_SIGMA, BONE_SIGMA = 0.05, 0.05
"""Standard deviations of the logarithms of a person's size and, besides, of each bone's length: 7 % together."""
THICKNESS_SIGMA, FINGER_THICKNESS_SIGMA = 0.08, 0.06
"""Standard deviations of the logarithms of the thickness of a person's flesh and, besides, of each finger's: 10 %."""
JOINT_SIGMA_M = 0.0015
"""Standard deviation, along each axis, of a joint's place within the flesh [m]."""
SKIN_SIGMA = 0.35
"""Standard deviation of the logarithm of the power of skinning weights: above 1 the skin folds sharply at joints."""
MAX_YIELD_M = 0.003
"""Greatest depth to which a person's flesh yields at contacts, uniform from 0 [m]; the object hides what is inside."""
SLEEVE_STARTS_M: dict[Split, tuple[float, ...]] = {"train": (0.18, 0.30, 0.45), "validation": (0.03, 0.10, 0.18, 0.45)}
"""Distances behind the wrist at which a sleeve may begin; at 0.45 m the arm is bare [m]."""


@dataclass(frozen=True)
class FilmedClip:
    """Choices of a rendered video.

    Attributes:
        kind: key of ``SHAPE_MAKERS``, or the name of the scan.
        seed: seed of the random choices, of ``SEEDS``.
        split: part of the benchmark.
        side: hand.
        camera: on the head, or in front of the person.
        sized: whether the user states the object's size.
        scan: textured OBJ file of the object; None for a built-in kind.
    """

    kind: str
    seed: int
    split: Split
    side: Side
    camera: Literal["head", "front"]
    sized: bool
    scan: Path | None = None

    @property
    def name(self) -> str:
        """Name of the clip."""
        return f"{self.kind}-{self.seed}"


def split_of_scan(name: str) -> Split:
    """Return the part of a scan, by its name alone: about a third of scans are for validation."""
    return "validation" if zlib.crc32(name.encode()) % 3 == 0 else "train"


def filmed_clips(split: Split, scans: Sequence[Path] = ()) -> list[FilmedClip]:
    """List the clips of a split in a fixed order, in which kinds and scans alternate, and sides, cameras and sizes."""
    kinds: list[tuple[str, Path | None]] = [(kind, None) for kind in KINDS[split]]
    named = {f"scan-{scan.parent.name}-{scan.stem}": scan for scan in sorted(scans)}  # many are called textured.obj
    kinds += [(name, scan) for name, scan in named.items() if split_of_scan(name) == split]
    out, number = [], count()
    for some in (kinds, [(kind, None) for kind in LATER_KINDS[split]]):
        for seed, (kind, scan) in product(SEEDS[split], some):
            n = next(number)
            side: Side = "left" if n % 2 else "right"
            out.append(FilmedClip(kind, seed, split, side, "front" if n // 2 % 2 else "head", n // 4 % 2 == 0, scan))
    return out


def make_filmed_scene(clip: FilmedClip) -> tuple[Scene, Float[ndarray, "V 3"] | None]:
    """Make the scene of a clip, and the colours of a scan's vertices.

    The scene's clip has the mesh that a user has: the scan, or the built-in kind. Raises ``InputError`` for a scan that
    does not read.
    """
    rng = np.random.default_rng([clip.seed, *clip.kind.encode(), *b"filmed"])
    mean = SHAPE_MAKERS[clip.kind]() if clip.scan is None else read_scan(clip.scan)
    colours = None if mean.colours is None else mean.colours / 255.0
    if clip.side == "left":
        mean = mirror_mesh(mean)  # the scene is mirrored at the end
    grasped, usual = mean, usual_grip(mean, rng)
    if clip.scan is None:
        stretch = np.exp(rng.normal(0.0, OBJECT_SIZE_SIGMA)) * (1.0 + MAX_STRETCH * rng.uniform(-1.0, 1.0, 3))
        deformation = draw_deformation(Mesh(mean.vertices * stretch, mean.faces), DEFORMATION, rng)
        grasped = Mesh(deformation(mean.vertices * stretch), mean.faces)
        if clip.kind in CATEGORY_PRIORS:
            grips = CATEGORY_PRIORS[clip.kind].grips
            usual = grips[rng.integers(len(grips))]
            usual = replace(usual, at=tuple(deformation(np.array([usual.at]) * stretch)[0].tolist()))
        else:
            usual = usual_grip(grasped, rng)
    person = Person.draw(clip.seed + zlib.crc32(clip.kind.encode()))
    grasper = Grasper(person.model.with_shape(), YieldingDistance(grasped, person.yields), usual.hold)
    T_base = grasper.approach(draw_near_grip(usual, GRIP_DEG, grasper, rng))
    moved = _window(draw_measured_motion(grasper, T_base, grasped, _whole_frames(rng), rng, MOTIONS[clip.split]), rng)
    T_world_cam, T_world_obj, T_world_hand = _draw_poses(clip, moved, grasped, rng)
    table = float(se3.transform(T_world_obj[0], grasped.vertices)[:, 2].min())
    posed = _with_reach(moved.posed, grasper.opened())
    T_grasped_mesh, size = align_similarity(mean, grasped, resize=True)
    T_cam_world = se3.inverse(T_world_cam)
    track, frames = hand_track(posed, T_cam_world @ T_world_hand), len(T_world_cam)
    focal, (width, height) = float(rng.uniform(520.0, 720.0)), FILM_SIZE_PX
    K = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
    made = Clip(
        name=clip.name,
        category=clip.kind,
        side="right",
        fps=FILM_FPS,
        frames=tuple(f"{n + 1:06d}" for n in range(frames)),
        times=np.arange(frames) / FILM_FPS,
        world=World(T_world_cam, np.array([0.0, 0.0, 1.0]), support=table),
        size=FILM_SIZE_PX,
        K=np.tile(K, (frames, 1, 1)),
        mesh=mean,
        scale="known" if clip.sized else "free",
        hand=track,
        truth=Truth(T_cam_world @ T_world_obj @ T_grasped_mesh, size, track.T_cam_hand, track.vertices),
        provenance={"source": "rendered, by getagrip"},
    )
    shown = Mesh(se3.transform(se3.inverse(T_grasped_mesh), grasped.vertices), grasped.faces)
    scene = Scene(made, shown, moved.axis, None, SceneOptions(frames=frames, fps=FILM_FPS))
    return (scene if clip.side == "right" else mirror_scene(scene)), colours


def usual_grip(mesh: Mesh, rng: np.random.Generator) -> Grip:
    """Return a power grip about the longest principal axis of an object of any shape."""
    areas = mesh.vertex_areas / mesh.vertex_areas.sum()
    centre = areas @ mesh.vertices
    axes = np.linalg.eigh((mesh.vertices - centre).T * areas @ (mesh.vertices - centre))[1].T
    low, high = ((mesh.vertices - centre) @ axes.T).min(axis=0), ((mesh.vertices - centre) @ axes.T).max(axis=0)
    thin, middle, long = np.argsort(high - low)
    into = middle if (high - low)[thin] <= MAX_PALM_SPAN_M else thin
    ahead, aside = rng.choice([-1.0, 1.0]) * axes[into], rng.choice([-1.0, 1.0]) * axes[long]
    at = centre - 0.5 * (high - low)[into] * ahead
    return Grip("palm", tuple(at.tolist()), tuple(ahead.tolist()), tuple(aside.tolist()))


def _whole_frames(rng: np.random.Generator) -> int:
    """Draw the number of frames of a whole grasp, of which the video shows a part."""
    return int(np.clip(FILM_FPS * np.exp(rng.normal(np.log(2.5), 0.4)), GRASP_FRAMES, 4 * GRASP_FRAMES))


def _window(whole: InHand, rng: np.random.Generator) -> InHand:
    """Return a part of a motion, ``GRASP_FRAMES`` long."""
    first = int(rng.integers(len(whole.T_hand_obj) - GRASP_FRAMES + 1))
    part = slice(first, first + GRASP_FRAMES)
    posed, axis = whole.posed, whole.axis
    return InHand(
        whole.T_hand_obj[part],
        Axis(axis.point, axis.direction, axis.angle[part]),
        replace(posed, vertices=posed.vertices[part], joints=posed.joints[part]),
        None,
    )


def _with_reach(closed: PosedHand, opened: PosedHand) -> PosedHand:
    """Add the frames before and after the grasp, in which the hand opens."""
    share = OPENNESS[:, None, None]
    added = [
        [here[end] + share * (there - here[end]) for end in (0, -1)]
        for here, there in ((closed.vertices, opened.vertices), (closed.joints, opened.joints))
    ]
    vertices, joints = (
        np.concatenate([before, here, after[::-1]])
        for (before, after), here in zip(added, (closed.vertices, closed.joints), strict=True)
    )
    return replace(closed, vertices=vertices, joints=joints)


def _draw_poses(
    clip: FilmedClip, moved: InHand, grasped: Mesh, rng: np.random.Generator
) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"]]:
    """Draw the poses of camera, object and hand in the world, of a right hand.

    World: x right, y ahead, z up, the object's centre near the origin. The object stands upright at either end, the
    forearm comes from the right shoulder, and in between hand and object are lifted, carried and tilted.
    """
    T_hand_obj = moved.T_hand_obj
    forearm = (T_hand_obj[0, :3, :3].T @ [1.0, 0.0, 0.0])[:2]
    yaw = np.arctan2(-0.8, 0.6) - np.arctan2(forearm[1], forearm[0]) + rng.normal(0.0, 0.3)
    upright = se3.exp_so3(np.array([0.0, 0.0, yaw]))
    aloft = np.sin(np.linspace(0.0, np.pi, GRASP_FRAMES))[:, None] ** 0.7
    tilt = aloft * np.radians(rng.uniform(15.0, 45.0)) * draw_smooth_curves(rng, GRASP_FRAMES, 3)
    carried = np.array([0.06, 0.04, 0.03]) * draw_smooth_curves(rng, GRASP_FRAMES, 3) + [0.0, 0.0, 0.06]
    lifted = rotate_about_point(np.zeros(3), tilt, aloft * carried) @ se3.rigid(upright, -upright @ grasped.centre)
    T_world_hand = lifted @ se3.inverse(T_hand_obj)
    retreats = [
        se3.rigid(None, RETREAT_M[:, None] * (T_world_hand[end, :3, :3] @ RETREAT_DIRECTION)) @ T_world_hand[end]
        for end in (0, -1)
    ]
    hand = np.concatenate([retreats[0], T_world_hand, retreats[1][::-1]])
    object_ = np.concatenate(
        [np.tile(lifted[0], (REACH_FRAMES, 1, 1)), lifted, np.tile(lifted[-1], (REACH_FRAMES, 1, 1))]
    )
    frames = len(hand)
    middle = 0.5 * se3.transform(T_world_hand[0], moved.posed.joints[:1, 9])[0]
    followed = middle + 0.6 * object_[:, :3, 3] - 0.6 * object_[0, :3, 3]
    away = float(np.clip(0.26 + 1.05 * grasped.diameter, 0.38, 0.62)) * rng.uniform(0.9, 1.2)
    down, around = np.radians(rng.uniform(30.0, 60.0)), 0.0
    if clip.camera == "front":
        away, down, around = 1.25 * away, np.radians(rng.uniform(8.0, 35.0)), np.pi + rng.uniform(-0.7, 0.7)
    ahead = np.array([np.sin(around) * np.cos(down), -np.cos(around) * np.cos(down), np.sin(down)])
    sway = 1.0 if clip.camera == "head" else 0.3  # a camera in front stands, or is held
    eye = middle + away * ahead + sway * 0.025 * draw_smooth_curves(rng, frames, 3)
    target = (followed if clip.camera == "head" else middle) + sway * 0.02 * draw_smooth_curves(rng, frames, 3)
    z = target - eye
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(z, np.array([0.0, 0.0, 1.0]) + sway * 0.06 * draw_smooth_curves(rng, frames, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return se3.rigid(np.stack([x, np.cross(z, x), z], axis=-1), eye), object_, hand


@cache
def read_scan(path: Path) -> Mesh:
    """Read a textured scan [m]. Raises ``InputError`` for a file that does not read, or without a texture beside it."""
    mesh = read_textured_mesh(path)
    if len(mesh.faces) > MAX_SCAN_FACES:
        raise InputError(path, "faces", f"{len(mesh.faces)} faces", f"a scan of at most {MAX_SCAN_FACES}, decimated")
    return mesh


@dataclass(frozen=True)
class Person:
    """A person's right hand; the left one is its mirror image.

    Attributes:
        model: hand model, with the generic hand's number of vertices, faces and regions.
        yields: depth to which the flesh yields at contacts [m].
    """

    model: HandModel
    yields: float

    @classmethod
    def draw(cls, seed: int) -> Person:
        """Draw a person."""
        rng = np.random.default_rng([seed, *b"person"])
        mean = generic.load("right")
        size = np.exp(rng.normal(0.0, HAND_SIZE_SIGMA))
        M, metacarpals = _draw_stretches(rng)
        shift = np.zeros((16, 3))
        for child, parent in enumerate(PARENTS):
            if parent >= 0:
                shift[child] = shift[parent] + M[parent] @ (mean.joints[child] - mean.joints[parent])
                shift[child] += metacarpals.get(child, 0.0)
        arm = mean.template[:, None] - mean.joints
        moved = mean.template + np.einsum("vj,vja->va", mean.weights, shift + np.einsum("jab,vjb->vja", M, arm))
        joints = mean.joints + shift + rng.normal(0.0, JOINT_SIGMA_M, (16, 3))
        joints[0] = mean.joints[0]  # the hand frame's own
        weights = mean.weights ** np.exp(rng.normal(0.0, SKIN_SIGMA))
        wrist = mean.joints[0]
        model = replace(
            mean,
            name="person",
            template=wrist + size * (moved - wrist),
            joints=wrist + size * (joints - wrist),
            weights=weights / weights.sum(axis=1, keepdims=True),
        )
        return cls(model, float(rng.uniform(0.0, MAX_YIELD_M)))


def _draw_stretches(rng: np.random.Generator) -> tuple[Float[ndarray, "16 3 3"], dict[int, Float[ndarray, "3"]]]:
    """Draw the stretch of the space around each joint's bone, and the displacement of each knuckle by its metacarpal.

    Stretches are relative: zero for the generic hand.
    """
    M, metacarpals = np.zeros((16, 3, 3)), {}
    thickness = rng.normal(0.0, THICKNESS_SIGMA)
    M[0] = np.diag([rng.normal(0.0, BONE_SIGMA), thickness, rng.normal(0.0, BONE_SIGMA)])
    fingers = rest_fingers()
    for finger, knuckle in zip(FINGERS, KNUCKLES, strict=True):
        thick = thickness + rng.normal(0.0, FINGER_THICKNESS_SIGMA)
        for k in range(3):
            along = np.outer(fingers[finger].axes[k, 0], fingers[finger].axes[k, 0])
            M[knuckle + k] = rng.normal(0.0, BONE_SIGMA) * along + thick * (np.eye(3) - along)
        if finger != "thumb":  # its metacarpal is its first bone
            metacarpals[knuckle] = rng.normal(0.0, BONE_SIGMA) * (fingers[finger].points[0] - metacarpal_base(finger))
    return M, metacarpals


class YieldingDistance(SignedDistance):
    """Signed distance to a mesh as flesh that yields feels it: larger by the depth to which it yields [m]."""

    def __init__(self, mesh: Mesh, yields: float) -> None:
        super().__init__(mesh)
        self._yields = yields

    def __call__(self, X: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch"]:
        """Compute the distances of points in the mesh's frame."""
        return super().__call__(X) + self._yields


def draw_look(split: Split, seed: int, colours: Float[ndarray, "V 3"] | None = None) -> VideoLook:
    """Draw skin, sleeve, paint, table and lamp of a video; ``colours`` are a scan's, by vertex, instead of paint.

    Looks of validation lack in training: skins, cloths and tables are mixed of two tones of the tables, the lamp is on
    the other side, and sleeves may end at the hand.
    """
    rng, look = np.random.default_rng([seed, *b"room"]), VideoLook.draw(seed)
    turn = np.radians(rng.uniform(-70.0, 40.0)) + (np.pi / 2.0 if split == "validation" else 0.0)
    lamp = se3.exp_so3(np.array([0.0, 0.0, turn])) @ LAMP_DIRECTION
    look = replace(look, lamp=lamp, sleeve_start=float(rng.choice(SLEEVE_STARTS_M[split])), colours=colours)
    if split == "train":
        return look
    skin, sleeve, table = (_mixed_tone(tones, rng) for tones in (SKIN_TONES, CLOTH_TONES, TABLE_TONES))
    return replace(look, skin=skin, sleeve=sleeve, table=table)


def _mixed_tone(tones: tuple[tuple[float, float, float], ...], rng: np.random.Generator) -> Float[ndarray, "3"]:
    one, other = (np.array(tones[n]) for n in rng.choice(len(tones), 2, replace=False))
    return np.asarray(one + rng.uniform(0.3, 0.7) * (other - one))
