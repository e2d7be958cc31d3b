"""People for rendered videos: hands that are not the hand that is fitted, and how they and their rooms look.

A benchmark whose pictures show the fitted model would measure the inverse crime. A person's right hand differs from
the generic hand in all that a fit assumes: the length of every bone, by itself; the thickness of every finger; the
places of the joints within the flesh; how far a bend of a joint draws the skin; the depth to which flesh yields. None
of these lies in the span of the generic hand's shape parameters. The sizes are those of human variation: Buryanov and
Kotiuk (``hands.generic``) find 7 to 15 % for single bones, some of it the error of the measurement; thickness and the
rest are assumed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands import generic
from getagrip.hands.generic import metacarpal_base, rest_fingers
from getagrip.hands.model import KNUCKLES, PARENTS, HandModel
from getagrip.synthetic.categories import Split
from getagrip.synthetic.grasp import SignedDistance
from getagrip.synthetic.video import CLOTH_TONES, LAMP_DIRECTION, SKIN_TONES, TABLE_TONES, VideoLook

SIZE_SIGMA, BONE_SIGMA = 0.05, 0.05
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
"""Where the sleeve begins behind the wrist; at 0.45 m the arm is bare."""


@dataclass(frozen=True)
class Person:
    """A person's right hand; the left one is its mirror image.

    Attributes:
        model: hand model, with the vertices, faces and regions of the generic hand, elsewhere.
        yields: depth to which the flesh yields at contacts [m].
    """

    model: HandModel
    yields: float

    @classmethod
    def draw(cls, seed: int) -> Person:
        """Draw a person."""
        rng = np.random.default_rng([seed, *b"person"])
        mean = generic.load("right")
        size = np.exp(rng.normal(0.0, SIZE_SIGMA))
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
