"""HOT3D (Banerjee et al., CVPR 2025): a hand and an object, true hands and poses, masks rendered from them.

HOT3D's images are in VRS recordings, which this reader does not open. It needs none: the masks are rendered from the
true poses of the objects and of both hands, in a pinhole that takes the place of the fisheye camera.

Each hand and object of a recording is a track. It becomes a clip for every hold (``holds``), one of all frames
(``whole``), or one for each grasp of a list (``hot3d_timelines``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks
from getagrip.datasets.hot3d.files import Recording, find, read_recording
from getagrip.datasets.tracks import MaskPair, Note, Piece, Source, Track, clip, pieces
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import SUFFIXES, Mesh, read_mesh
from getagrip.geometry.render import Surface, true_masks
from getagrip.grasps.stable import Definition
from getagrip.hands.model import Side
from getagrip.io.files import is_plain_name, plain, read_json, shown

CONTACT = 0.005
"""A hand with a vertex so near to an object's surface touches it [m]."""
SHORTEST = 10
"""Frames of the shortest hold, and the fewest in which its object must be seen."""
DEFINITION = Definition(contact=CONTACT, shortest=SHORTEST)
DIGITS = 6


@dataclass(frozen=True)
class Objects:
    """The objects of HOT3D, by uid."""

    names: dict[str, str]
    meshes: dict[str, Path]
    """Files; some may be missing."""

    @staticmethod
    def below(root: Path) -> Objects:
        """As ``instance.json`` names them; a mesh is called by the uid or the name. Raises ``InputError``."""
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
        found = {uid: files.get(uid) or files.get(name) for uid, name in names.items()}
        return Objects(names, {uid: path for uid, path in found.items() if path is not None})

    def read(self, recording: Recording, note: Note) -> dict[str, Mesh]:
        """The meshes of a recording's objects; what lacks one is told."""
        meshes = {}
        for uid in sorted(recording.objects):
            name = self.names.get(uid, uid)
            try:
                if uid in self.meshes:
                    meshes[uid] = read_mesh(self.meshes[uid])
                else:
                    note(f"{recording.name}: no mesh of {name}: its holds are left out and it hides nothing")
            except InputError as error:
                note(f"{recording.name}: {name} is left out and hides nothing: {error}")
        return meshes


def read(root: Path, note: Note = lambda _: None) -> Iterator[tuple[Clip, Masks]]:
    """The holds of all recordings below ``root``, one by one; what is left out is told to ``note`` in words.

    Hands, cameras, poses and meshes are the dataset's own. Frames in which the object is not seen are dropped, objects
    without a mesh are left out. Raises ``InputError`` for files that are missing or malformed: for those of one
    recording when all others are done.
    """
    failed: list[InputError] = []
    for source in sources(root):
        try:
            for piece in holds(source.read(note)):
                made = clip(piece, SHORTEST, note)
                if made is not None and made[1] is not None:
                    yield made[0], made[1]
        except InputError as error:
            failed.append(error)
    for other in failed[1:]:
        note(f"failed: {other}")
    if failed:
        raise failed[0]


def sources(root: Path, frames: Mapping[str, int | None] | None = None) -> list[Source]:
    """The recordings below ``root``, or those that ``frames`` names, by the number of frames that each must have.

    Raises ``InputError`` where there is no recording, and where objects have no names.
    """
    root = Path(root).resolve()
    found = find(root)
    if frames is None:
        frames = dict.fromkeys(found)
    objects = Objects.below(root)
    return [
        Source(name, partial(_tracks, name, files, objects, frames[name]))
        for name, files in found.items()
        if name in frames
    ]


def _tracks(name: str, files: dict[str, Path], objects: Objects, frames: int | None, note: Note) -> Iterator[Track]:
    """Every hand with every object of a recording, in the frames that have both. Raises ``InputError``."""
    folder = next(iter(files.values())).parent
    if not is_plain_name(name):
        raise InputError(folder, "", f"the name {shown(name)}", "P<person>_<id>")
    recording = read_recording(name, files)
    if frames not in (None, len(recording.times)):
        expected = f"{frames}, as the list counts them: say with --first-frame what number the first has"
        raise InputError(folder, "headset_trajectory.csv", f"{len(recording.times)} frames", expected)
    meshes = objects.read(recording, note)
    covered = recording.camera.pinhole.covered(recording.camera.fisheye)
    for side, hand in recording.hands.items():
        for uid, poses in recording.objects.items():
            both = np.flatnonzero(hand.known & poses.known)
            if uid in meshes and both.size:
                masks = partial(_masks, recording, uid, meshes, covered)
                yield _track(folder, recording, side, uid, objects.names[uid], meshes[uid], both, masks)


def _track(
    folder: Path,
    recording: Recording,
    side: Side,
    uid: str,
    category: str,
    mesh: Mesh,
    frames: Int[ndarray, "T"],
    masks: Callable[[int], MaskPair],
) -> Track:
    """A hand and an object in some frames of a recording."""
    hand, camera = recording.hands[side], recording.camera
    T_cam_world = se3.inverse(camera.T_world_cam[frames])
    subject, _, sequence = recording.name.partition("_")
    return Track(
        file=folder,
        subject=subject,
        sequence=sequence,
        category=category,
        side=side,
        fps=round(1e9 / float(np.median(np.diff(recording.times))), 3),
        numbers=frames,
        digits=DIGITS,
        size=camera.pinhole.size,
        K=camera.pinhole.K,
        hand=HandTrack(
            vertices=hand.posed.vertices[frames],
            faces=hand.posed.faces,
            T_cam_hand=T_cam_world @ hand.T_world_hand[frames],
            regions=hand.posed.regions,
            joints=hand.posed.joints[frames],
        ),
        T_cam_obj=T_cam_world @ recording.objects[uid].T_world_obj[frames],
        object=lambda _: mesh,
        read_masks=masks,
        provenance={
            "source": f"HOT3D, recording {recording.name}",
            "object_uid": uid,
            "hands": "HOT3D's UmeTrack hands (true)",
            "masks": "rendered from the true poses, hidden by both hands and by the other objects that have a mesh",
            "camera": f"{camera.device}, {camera.label}: a pinhole of the fisheye lens's focal length and axis",
            "scale": "HOT3D's scanned mesh, true size",
            "times": "poses are the nearest in time to the frame, at most 5 ms off",
        },
    )


def _masks(
    recording: Recording, uid: str, meshes: dict[str, Mesh], covered: Bool[ndarray, "H W"], n: int
) -> tuple[Bool[ndarray, "H W"], Bool[ndarray, "H W"]]:
    """Where an object is seen in frame n, and what to ignore; ``covered`` is what the fisheye image shows."""
    T_cam_world = se3.inverse(recording.camera.T_world_cam[n])
    hands: list[Surface] = [
        (se3.transform(T_cam_world @ hand.T_world_hand[n], hand.posed.vertices[n]), hand.posed.faces)
        for hand in recording.hands.values()
        if hand.known[n]
    ]
    objects: dict[str, Surface] = {
        other: (se3.transform(T_cam_world @ poses.T_world_obj[n], meshes[other].vertices), meshes[other].faces)
        for other, poses in recording.objects.items()
        if other in meshes and poses.known[n]
    }
    held = objects.pop(uid)
    pinhole = recording.camera.pinhole
    seen, ignore = true_masks(held, hands, list(objects.values()), pinhole.K, pinhole.size)
    return seen & covered, ignore | ~covered


def holds(tracks: Iterable[Track], _: Note = lambda _: None) -> Iterator[Piece]:
    """Where a hand touches an object without a break, for ``SHORTEST`` frames or more."""
    for track in tracks:
        distance = nearest(track)
        rows = np.flatnonzero(distance < CONTACT)
        runs = np.split(rows, np.flatnonzero(np.diff(track.numbers[rows]) != 1) + 1)
        for number, run in enumerate((run for run in runs if len(run) >= SHORTEST), start=1):
            first, last = track.numbers[run[[0, -1]]]
            yield Piece(
                track.take(run),
                name=hold_name(track) + f"-{number}" * (number > 1),
                made_of=f"a hold, frames {first} to {last}: the hand is {1e3 * distance[run].mean():.2f} mm from the "
                "object, mean over the frames",
            )


def hold_name(track: Track) -> str:
    """What clips of holds are called, the count left out."""
    return f"{track.subject}_{track.sequence}-{track.category}-{track.side}"


def whole(tracks: Iterable[Track], note: Note) -> Iterator[Piece]:
    """All frames of each hand and object that touch for ``SHORTEST`` frames or more, as far as nothing is missing."""
    for track in tracks:
        if next(holds([track]), None) is not None:
            yield from pieces([track], note, DEFINITION, whole=True)


def nearest(track: Track) -> Float[ndarray, "T"]:
    """Distance of the hand's nearest vertex to the object's surface [m]; infinite where it may be above ``CONTACT``."""
    import igl

    mesh = track.object(0.0)
    tree = igl.AABB()
    tree.init(mesh.vertices, mesh.faces)
    low, high = mesh.vertices.min(axis=0) - CONTACT, mesh.vertices.max(axis=0) + CONTACT
    out = np.full(len(track), np.inf)
    for n, T_obj_hand in enumerate(se3.inverse(track.T_cam_obj) @ track.hand.T_cam_hand):
        points = se3.transform(T_obj_hand, track.hand.vertices[n])
        points = points[np.all((points >= low) & (points <= high), axis=1)]
        if len(points):
            out[n] = np.sqrt(tree.squared_distance(mesh.vertices, mesh.faces, points)[0].min())
    return out
