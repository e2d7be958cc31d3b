"""HOT3D (Banerjee et al., CVPR 2025): every hold of an object by a hand, as a clip with true hands and true masks.

HOT3D's images are in VRS recordings, which this reader does not open. It needs none: the masks are rendered from the
true poses of the objects and of both hands, in a pinhole that takes the place of the fisheye camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip import se3
from getagrip.clip import Clip, HandTrack, Masks, Truth
from getagrip.datasets.hot3d_files import Recording, find, read_recording
from getagrip.errors import InputError
from getagrip.files import plain, read_json, shown
from getagrip.hands.model import Side
from getagrip.mesh import SUFFIXES, Mesh, read_mesh
from getagrip.render import Surface, true_masks

CONTACT = 0.005
"""A hand with a vertex so near to an object's surface touches it [m]."""
SHORTEST = 10
"""Frames of the shortest hold, and the fewest in which its object must be seen."""
VISIBLE = 25
"""Pixels of the smallest mask that counts as seen."""


@dataclass(frozen=True)
class Hold:
    """A hand that touches an object without a break, as long as it does."""

    recording: Recording
    side: Side
    uid: str
    first: int
    last: int
    """Frames of the recording, both included."""
    number: int
    """Counts the holds of this object by this hand in this recording, from 1."""
    nearest: float
    """Mean over the frames of the smallest distance from the hand's vertices to the object's surface [m]."""


def read(root: Path, note: Callable[[str], None] = lambda _: None) -> Iterator[tuple[Clip, Masks]]:
    """The holds of all recordings below ``root``, one by one; what is left out is told to ``note`` in words.

    Hands, cameras, poses and meshes are the dataset's own. Frames in which the object is not seen are dropped, objects
    without a mesh are left out. Raises ``InputError`` for files that are missing or malformed: for those of one
    recording when all others are done.
    """
    root = Path(root).resolve()
    found = find(root)
    names, meshes = _objects(root, note)
    failed: list[InputError] = []
    for name, files in found.items():
        try:
            recording = read_recording(name, files)
        except InputError as error:
            failed.append(error)
            continue
        for uid in sorted(set(recording.objects) - set(meshes)):
            note(f"{recording.name}: no mesh of {names.get(uid, uid)}: its holds are left out and it hides nothing")
        for hold in holds(recording, meshes):
            clip = _clip(hold, names[hold.uid], meshes)
            if clip is None:
                note(f"{_name(hold, names[hold.uid])}: the object is seen in fewer than {SHORTEST} frames: left out")
            else:
                yield clip
    for other in failed[1:]:
        note(f"failed: {other}")
    if failed:
        raise failed[0]


def holds(recording: Recording, meshes: dict[str, Mesh]) -> Iterator[Hold]:
    """All holds of a recording: maximal runs of at least ``SHORTEST`` frames with contact."""
    for side, hand in recording.hands.items():
        for uid, poses in recording.objects.items():
            if uid not in meshes:
                continue
            mesh = meshes[uid]
            distance = np.full(len(recording.times), np.inf)
            T_obj_hand = se3.inverse(poses.T_world_obj) @ hand.T_world_hand
            for n in np.flatnonzero(hand.known & poses.known):
                distance[n] = _nearest(mesh, se3.transform(T_obj_hand[n], hand.posed.vertices[n]))
            runs = [run for run in _runs(distance < CONTACT) if run[1] - run[0] + 1 >= SHORTEST]
            for number, (first, last) in enumerate(runs, start=1):
                yield Hold(recording, side, uid, first, last, number, float(distance[first : last + 1].mean()))


def _nearest(mesh: Mesh, points: Float[ndarray, "N 3"]) -> float:
    """Distance from points to the surface of a mesh [m]; infinite where all are out of reach of it."""
    import igl

    beyond = np.linalg.norm(np.maximum(np.abs(points - mesh.centre) - np.ptp(mesh.vertices, axis=0) / 2.0, 0.0), axis=1)
    within = points[beyond < CONTACT]
    if len(within) == 0:
        return np.inf
    return float(np.sqrt(igl.point_mesh_squared_distance(within, mesh.vertices, mesh.faces)[0].min()))


def _runs(flags: Bool[ndarray, "N"]) -> list[tuple[int, int]]:
    """First and last index of each run of true values."""
    steps = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return list(zip(np.flatnonzero(steps == 1).tolist(), (np.flatnonzero(steps == -1) - 1).tolist(), strict=True))


def _clip(hold: Hold, category: str, meshes: dict[str, Mesh]) -> tuple[Clip, Masks] | None:
    recording, camera = hold.recording, hold.recording.camera
    held, hand = recording.objects[hold.uid], recording.hands[hold.side]
    covered = camera.pinhole.covered(camera.fisheye)
    frames, seen, ignore = [], [], []
    for n in range(hold.first, hold.last + 1):
        visible, hidden = _masks(recording, n, hold, meshes)
        if np.count_nonzero(visible & covered) >= VISIBLE:
            frames.append(n)
            seen.append(visible & covered)
            ignore.append(hidden | ~covered)
    if len(frames) < SHORTEST:
        return None
    T_cam_world = se3.inverse(camera.T_world_cam[frames])
    track = HandTrack(
        vertices=hand.posed.vertices[frames],
        faces=hand.posed.faces,
        T_cam_hand=T_cam_world @ hand.T_world_hand[frames],
        regions=hand.posed.regions,
        joints=hand.posed.joints[frames],
    )
    name = _name(hold, category)
    clip = Clip(
        folder=Path(name),
        name=name,
        category=category,
        side=hold.side,
        fps=round(1e9 / float(np.median(np.diff(recording.times))), 3),
        frames=tuple(f"{n:06d}" for n in frames),
        size=camera.pinhole.size,
        K=np.tile(camera.pinhole.K, (len(frames), 1, 1)),
        mesh=meshes[hold.uid],
        scale="known",
        hand=track,
        truth=Truth(T_cam_world @ held.T_world_obj[frames], 1.0, track.T_cam_hand, track.vertices),
        provenance=_provenance(hold, hold.last + 1 - hold.first - len(frames)),
    )
    return clip, Masks(np.array(seen), np.array(ignore))


def _masks(
    recording: Recording, n: int, hold: Hold, meshes: dict[str, Mesh]
) -> tuple[Bool[ndarray, "H W"], Bool[ndarray, "H W"]]:
    """Where the held object is seen, and what to ignore, in frame n."""
    T_cam_world = se3.inverse(recording.camera.T_world_cam[n])
    hands: list[Surface] = [
        (se3.transform(T_cam_world @ hand.T_world_hand[n], hand.posed.vertices[n]), hand.posed.faces)
        for hand in recording.hands.values()
        if hand.known[n]
    ]
    objects: dict[str, Surface] = {
        uid: (se3.transform(T_cam_world @ poses.T_world_obj[n], meshes[uid].vertices), meshes[uid].faces)
        for uid, poses in recording.objects.items()
        if uid in meshes and poses.known[n]
    }
    held = objects.pop(hold.uid)
    pinhole = recording.camera.pinhole
    return true_masks(held, hands, list(objects.values()), pinhole.K, pinhole.size)


def _name(hold: Hold, category: str) -> str:
    again = f"-{hold.number}" if hold.number > 1 else ""
    return f"{hold.recording.name}-{category}-{hold.side}{again}"


def _provenance(hold: Hold, dropped: int) -> dict[str, Any]:
    recording, camera = hold.recording, hold.recording.camera
    return {
        "source": f"HOT3D, recording {recording.name}, frames {hold.first} to {hold.last} "
        f"({recording.times[hold.first]} to {recording.times[hold.last]} ns)",
        "object_uid": hold.uid,
        "hands": "HOT3D's UmeTrack hands (true)",
        "masks": "rendered from the true poses, hidden by both hands and by the other objects that have a mesh",
        "camera": f"{camera.device}, {camera.label}: a pinhole of the fisheye lens's focal length and axis",
        "scale": "HOT3D's scanned mesh, true size",
        "times": "poses are the nearest in time to the frame, at most 5 ms off",
        "contact": f"the hand is {1e3 * hold.nearest:.2f} mm from the object, mean over the frames",
        "dropped": f"{dropped} frames in which the object is not seen",
    }


def _objects(root: Path, note: Callable[[str], None]) -> tuple[dict[str, str], dict[str, Mesh]]:
    """Names and meshes of the objects by uid. A mesh is a file called by the uid or the name, somewhere in ``root``."""
    instances = next(iter(sorted(root.rglob("instance.json"))), None)
    if instances is None:
        raise InputError(root, "", "no instance.json below it", "HOT3D's list of objects")
    names = {}
    for uid, entry in read_json(instances).items():
        name = entry.get("instance_name") if isinstance(entry, dict) else None
        if not isinstance(name, str) or not name.replace("_", "").isalnum():
            raise InputError(instances, plain(uid), shown(name), "an instance_name of letters, digits and _")
        names[uid] = name
    files: dict[str, Path] = {}
    for path in sorted(root.rglob("*")):
        if path.suffix.lower() in SUFFIXES and path.is_file():
            files.setdefault(path.stem, path)
    meshes = {}
    for uid, name in names.items():
        path = files.get(uid, files.get(name, root))
        if path != root:
            try:
                meshes[uid] = read_mesh(path)
            except InputError as error:
                note(f"left out: {error}")
    return names, meshes
