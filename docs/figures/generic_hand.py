"""Draw docs/images/generic-hand.png: the generic hand from all sides, in a fist, and the contact regions."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from getagrip.geometry import se3
from getagrip.geometry.rasterize import render_rgb
from getagrip.hands import generic
from getagrip.hands.model import MANO_JOINTS, PosedHand

SKIN, PAD = (0.86, 0.68, 0.58), (0.80, 0.36, 0.30)
SIZE = (420, 420)
OUT = Path(__file__).resolve().parents[1] / "images" / "generic-hand.png"


def view(eye: tuple[float, float, float], up: tuple[float, float, float], centre: np.ndarray) -> np.ndarray:
    """T_cam_hand of a camera 0.75 m from the hand's middle, on the side ``eye`` of it."""
    z = -np.array(eye) / np.linalg.norm(eye)
    x = np.cross(-np.array(up), z)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    return se3.rigid(R, np.array([0.0, 0.0, 0.75]) - R @ centre)


def draw(
    hand: PosedHand, eye: tuple[float, float, float], up: tuple[float, float, float], pads: bool = False
) -> np.ndarray:
    centre = (hand.vertices.min(axis=0) + hand.vertices.max(axis=0)) / 2.0
    K = np.array([[1300.0, 0.0, SIZE[0] / 2], [0.0, 1300.0, SIZE[1] / 2], [0.0, 0.0, 1.0]])
    X = se3.transform(view(eye, up, centre), hand.vertices)
    ids = np.concatenate(list(hand.regions.values())) if pads else np.zeros(0, dtype=int)
    marked = np.isin(hand.faces, ids).all(axis=1)
    parts = [(X, hand.faces[~marked], SKIN), (X, hand.faces[marked], PAD)]
    return render_rgb([part for part in parts if len(part[1])], K, SIZE)


def curled(finger: dict[str, tuple[float, float, float]], side: float = 1.0) -> np.ndarray:
    """A pose that bends each finger's three joints [degrees] about its hinges."""
    pose = np.zeros((15, 3))
    for name, rest in generic.rest_fingers().items():
        for k, angle in enumerate(finger[name]):
            pose[MANO_JOINTS.index(f"{name}{k + 1}") - 1] = np.radians(angle) * rest.axes[k, 1]
    return pose.ravel()


FIST = {
    "thumb": (20, 35, 55),
    "index": (75, 95, 60),
    "middle": (80, 95, 60),
    "ring": (82, 95, 60),
    "pinky": (82, 92, 60),
}
GRASP = {
    "thumb": (15, 12, 15),
    "index": (38, 42, 22),
    "middle": (42, 42, 24),
    "ring": (46, 42, 25),
    "pinky": (50, 40, 25),
}


def main() -> None:
    right, left = generic.load("right").with_shape(), generic.load("left").with_shape()
    flat = right.with_pose()
    grasp, fist = right.with_pose(curled(GRASP)), right.with_pose(curled(FIST))
    up = (-1.0, 0.0, 0.0)
    tiles = [
        (draw(flat, (0, -1, 0), up, pads=True), "right, palm and contact regions"),
        (draw(flat, (0, 1, 0), up), "right, back"),
        (draw(left.with_pose(), (0, -1, 0), (1, 0, 0)), "left, palm"),
        (draw(flat, (0, 0, 1), up), "thumb side"),
        (draw(flat, (0, 0, -1), up), "edge"),
        (draw(flat, (-1, -0.1, 0), (0, 1, 0)), "from the fingertips"),
        (draw(grasp, (-0.4, -0.9, 0.7), up), "grasp"),
        (draw(grasp, (0.2, 0.2, 1), up), "grasp, thumb side"),
        (draw(fist, (-0.5, -1, 0.5), up), "fist"),
    ]
    for image, caption in tiles:
        cv2.putText(image, caption, (10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (60, 60, 60), 1, cv2.LINE_AA)
    rows = [np.concatenate([image for image, _ in tiles[k : k + 3]], axis=1) for k in (0, 3, 6)]
    OUT.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(OUT), cv2.cvtColor(np.concatenate(rows), cv2.COLOR_RGB2BGR))


if __name__ == "__main__":
    main()
