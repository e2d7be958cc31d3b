"""Cost of finding stable grasps in long sequences: contacts of a moving hand and object, then intervals."""

from __future__ import annotations

from statistics import median

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks.store import Table, of_cells
from benchmarks.timing import timed
from getagrip.clip import FINGERS, Clip, HandTrack, Truth
from getagrip.geometry import se3
from getagrip.geometry.mesh import decimate
from getagrip.hands import generic
from getagrip.stable_grasps.definition import GRASP_RULES
from getagrip.stable_grasps.find import PairwiseIou, contact_sets, stable_grasps
from getagrip.synthetic import objects

FRAMES = 2000
"""Length of the sequence whose contacts are timed."""
LONG = 10_000
"""Numbers of frames whose intervals are timed."""
OBJECT = 500
"""Numbers of vertices."""
REPEATS = 3


def tables() -> dict[str, Table]:
    """Measure."""
    clip = sequence(FRAMES)
    rows = []
    for threshold in (0.0, 0.005, 0.010):
        timing, found = timed(lambda mm=threshold: contact_sets(clip, mm), REPEATS)
        cpu, wall = median(timing.cpu), median(timing.wall)
        touched = found[0].sum(axis=1).mean()
        rows.append([f"{1e3 * threshold:g} mm", f"{touched:.0f}", f"{FRAMES / cpu:.0f}", f"{FRAMES / wall:.0f}"])
    sizes = f"{clip.hand.vertices.shape[1]} vertices of the hand, {len(clip.mesh.vertices)} of the object"
    contact = contact_sets(clip, 0.005)
    times = []
    for name, sets in long_contacts(contact).items():
        for rule in GRASP_RULES:
            timing, grasps = timed(lambda rule=rule, sets=sets: stable_grasps(PairwiseIou.of(sets), rule=rule), REPEATS)
            times.append([name, rule, str(len(grasps[0])), f"{median(timing.cpu):.2f}", f"{median(timing.wall):.2f}"])
    titles = f"Speed of contacts, {FRAMES:,} frames", f"Speed of finding stable grasps in {LONG:,} frames"
    header = ["within", "vertices in contact", "frames per CPU second", "frames per second"]
    slower = ["sequence", "rule", "grasps", "CPU, s", "wall, s"]
    return {
        "segment-speed": of_cells(titles[0], header, rows, [f"{sizes}, both moving in every frame"]),
        "segment-speed-grasps": of_cells(titles[1], slower, times, ["once contacts are known"]),
    }


def sequence(frames: int) -> Clip:
    """Make a hand with moving fingers around a mug that moves in it, in all frames."""
    rng = np.random.default_rng(0)
    pose = np.zeros((frames, 5, 3, 3))
    pose[:, :4, :, 2] = (0.5 + 0.1 * np.sin(np.linspace(0.0, 40.0, frames)))[:, None, None]
    posed = generic.load("right").with_shape().with_pose(pose.reshape(frames, 45) + 0.03 * walk(rng, frames, 45))
    mug = decimate(objects.mug(), 2 * OBJECT)
    place = np.array([0.01, -0.045, 0.005]) + 0.01 * walk(rng, frames, 3)
    T_hand_obj = se3.rigid(se3.exp_so3(0.3 * walk(rng, frames, 3)), place)
    T_cam_hand = np.tile(se3.rigid(t=np.array([0.0, 0.0, 0.5])), (frames, 1, 1))
    frames_of = tuple(f"{n:06d}" for n in range(frames))
    K = np.tile([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]], (frames, 1, 1))
    hand = HandTrack(
        posed.vertices, posed.faces, T_cam_hand, {finger: np.array([n]) for n, finger in enumerate(FINGERS)}
    )
    truth = Truth(T_cam_hand @ T_hand_obj, 1.0, T_cam_hand, posed.vertices)
    return Clip(
        name="long", category="mug", side="right", fps=30.0, frames=frames_of, size=(640, 480), K=K, mesh=mug,
        scale="known", hand=hand, truth=truth,
    )  # fmt: skip


def walk(rng: np.random.Generator, frames: int, numbers: int) -> Float[ndarray, "T n"]:
    """Draw random walks with unit standard deviation at frame 1000."""
    return np.cumsum(rng.normal(size=(frames, numbers)), axis=0) / np.sqrt(1000.0)


def long_contacts(contact: Bool[ndarray, "T V"]) -> dict[str, Bool[ndarray, "N V"]]:
    """Make long sequences: repetitions of a sequence; and one grasp throughout, where every pair must be compared."""
    rng = np.random.default_rng(0)
    held = np.tile(rng.random(contact.shape[1]) < 0.5, (LONG, 1))
    return {
        "the one above, repeated": contact[np.arange(LONG) % len(contact)],
        "one grasp from end to end": held ^ (rng.random(held.shape) < 0.02),
    }
