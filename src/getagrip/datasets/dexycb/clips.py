"""DexYCB (Chao et al., CVPR 2021): every stable grasp, as a clip with true poses and a hand fitted to the true joints.

DexYCB's hands are MANO's, which only licensed users have. Its 21 joints are free numbers, so the generic hand is fitted
to them, with one shape over a sequence. Masks are rendered from the true poses; no image is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS, Clip, HandTrack, Masks, Truth
from getagrip.datasets.dexycb.files import SIZE, Poses, Recording, Sequence, find
from getagrip.datasets.tracks import Note, Source, Track
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import SUFFIXES, Mesh, read_mesh
from getagrip.geometry.render import Surface, true_masks
from getagrip.grasps.stable import Definition, contact_iou, stable_grasps
from getagrip.hands import generic
from getagrip.hands.fit import fit_joints
from getagrip.hands.model import HandModel, hand_track
from getagrip.metrics.contact import signed_distance, stable_contact_area

CONTACT = 0.010
"""A vertex of the object so near to the hand's surface, or inside it, is in contact [m]."""
TAU = 0.5
"""Contact IOU that all pairs of frames of a grasp exceed (Eq. 2)."""
SHORTEST = 20
"""Frames of the shortest grasp, and the fewest in which its object must be seen."""
VISIBLE = 25
"""Pixels of the smallest mask that counts as seen."""
DEFINITION = Definition(tau=TAU, contact=CONTACT, shortest=SHORTEST)
FPS = 30.0
BETWEEN = "--"
"""Stands between subject, sequence and object in a clip's name."""


@dataclass(frozen=True)
class Hand:
    """The generic hand fitted to the frames of a sequence that have joints."""

    track: HandTrack
    frames: Int[ndarray, "T"]
    """The frames."""
    residuals: Float[ndarray, "T 21"]
    """Distances of its joints from the true ones [m]."""


@dataclass(frozen=True)
class Grasp:
    """A stable grasp of a sequence."""

    recording: Recording
    mesh: Mesh
    hand: Hand
    first: int
    last: int
    """Frames of the sequence, both included."""
    number: int
    """Counts the grasps of the sequence, from 1."""
    stable_area: float
    """Mean contact IOU over all pairs of its frames (SCA of the truth)."""

    @property
    def name(self) -> str:
        """What its clip is called."""
        recording = self.recording
        again = [str(self.number)] if self.number > 1 else []
        return BETWEEN.join([recording.subject, recording.sequence, recording.held, *again])


def clips(
    root: Path, meshes: Path | None = None, note: Callable[[str], None] = lambda _: None
) -> Iterator[tuple[Clip, Masks]]:
    """The visible stable grasps of DexYCB, one by one; what is left out is told to ``note`` in words.

    ``root`` is DexYCB's own folder, a packed file of sequences, or a folder of such files; ``meshes`` the folder of the
    YCB models, ``models`` in ``root`` where left out. Raises ``UsageError`` without meshes, ``InputError`` for files
    that are missing or malformed: for those of one sequence when all others are done.
    """
    folder = mesh_folder(root, meshes)
    failed: list[InputError] = []
    for sequence in find(root):
        try:
            for grasp in grasps(sequence, folder, note):
                made = clip(grasp, folder, note)
                if made is not None:
                    yield made
        except InputError as error:
            failed.append(error)
    for other in failed[1:]:
        note(f"failed: {other}")
    if failed:
        raise failed[0]


def subject_of(clip_name: str) -> str:
    """The person whose hand is in a clip. Raises ``UsageError`` for a name that no clip of DexYCB has."""
    subject, between, rest = clip_name.partition(BETWEEN)
    if not (subject and between and rest):
        raise UsageError(f"clip {clip_name!r}: got no subject, expected <subject>{BETWEEN}<sequence>{BETWEEN}<object>")
    return subject


def mesh_folder(root: Path, meshes: Path | None) -> Path:
    """Where the meshes are. Raises ``UsageError`` where there is no such folder."""
    folder = meshes or root / "models"
    if not folder.is_dir():
        raise UsageError(f"--meshes: got {folder}, which is no folder, expected the folder of the YCB models")
    return folder


def grasps(sequence: Sequence, meshes: Path, note: Callable[[str], None] = lambda _: None) -> list[Grasp]:
    """The stable grasps of a sequence (Eq. 2). Raises ``InputError``."""
    held = _held(sequence, meshes, note)
    if held is None:
        return []
    recording, mesh, hand = held
    iou = contact_iou(contacts(recording, hand, mesh))
    found = stable_grasps(iou, TAU, SHORTEST)
    if not found:
        note(f"{sequence.name}: no stable grasp of {SHORTEST} frames: left out")
    return [
        Grasp(recording, mesh, hand, a, b, number, stable_contact_area(iou[a : b + 1, a : b + 1]))
        for number, (a, b) in enumerate(found, start=1)
    ]


def sources(root: Path, meshes: Path | None = None) -> list[Source]:
    """The whole sequences, hand and held object in every frame in which both are known. Raises as ``clips`` does."""
    folder = mesh_folder(root, meshes)
    return [Source(sequence.name, partial(_tracks, sequence, folder)) for sequence in find(root)]


def _tracks(sequence: Sequence, meshes: Path, note: Note) -> list[Track]:
    """The one track of a sequence; none where the hand is hardly ever known. Raises ``InputError``."""
    held = _held(sequence, meshes, note)
    if held is None:
        return []
    recording, mesh, hand = held
    poses = recording.objects[recording.held]
    track = Track(
        file=recording.file,
        subject=recording.subject,
        sequence=recording.sequence,
        category=recording.held,
        side=recording.side,
        fps=FPS,
        numbers=hand.frames,
        digits=6,
        size=SIZE,
        K=recording.K,
        hand=hand.track,
        T_cam_obj=poses.T_cam_obj[hand.frames],
        object=lambda _: mesh,
        provenance={
            "dataset": "DexYCB, CC BY-NC 4.0",
            "hands": "the generic hand, fitted to DexYCB's 21 joints over all frames: not the true surface",
            "camera": recording.camera or "one of DexYCB's, not necessarily the sequence's own",
            "scale": "YCB mesh, true size",
        },
    )
    return [track.take(np.flatnonzero(poses.known[hand.frames]))]


def _held(sequence: Sequence, meshes: Path, note: Note) -> tuple[Recording, Mesh, Hand] | None:
    """What is in a sequence, its hand fitted; nothing where the hand is hardly ever known. Raises ``InputError``."""
    recording = sequence.read()
    if np.count_nonzero(recording.hand_known) < SHORTEST:
        note(f"{sequence.name}: the hand is known in fewer than {SHORTEST} frames: left out")
        return None
    mesh = ycb_mesh(meshes, recording.held)
    if mesh is None:
        raise InputError(meshes, recording.held, "no mesh of it", f"{recording.held}.obj or {recording.held}/*.obj")
    return recording, mesh, fit_hand(recording)


def fit_hand(recording: Recording) -> Hand:
    """The generic hand in every frame that has joints, of one shape. Raises ``InputError`` where they are no hand's."""
    joints = recording.joints[recording.hand_known]
    model = generic.load(recording.side)
    try:
        fit = fit_joints(model, joints, "openpose")
    except UsageError as error:
        raise InputError(recording.file, recording.sequence, str(error), "the 21 joints of a hand") from error
    posed = model.with_shape(_with_girth(model, fit.shape, joints)).with_pose(fit.pose)
    track = hand_track(posed, fit.hand.T_cam_hand)
    residuals = np.linalg.norm(se3.transform(track.T_cam_hand, posed.joints) - joints, axis=-1)
    return Hand(track, np.flatnonzero(recording.hand_known), residuals)


def _with_girth(model: HandModel, shape: Float[ndarray, "S"], joints: Float[ndarray, "T 21 3"]) -> Float[ndarray, "S"]:
    """The shape with fingers as thick as the hand is long: joints say nothing about girth, but enlarge it by chance."""
    length = np.median(_length(joints)) / _length(model.with_shape().with_pose().joints)
    shape = shape.copy()
    shape[model.shape_names.index("thickness")] = length - 1.0 - shape[model.shape_names.index("size")]
    return shape


def _length(joints: Float[ndarray, "*batch 21 3"]) -> Float[ndarray, "*batch"]:
    """Mean over the four fingers of the length along the bones from the wrist to the tip [m]."""
    wrist = np.broadcast_to(joints[..., None, :1, :], (*joints.shape[:-2], 4, 1, 3))
    chains = np.concatenate([wrist, joints[..., 5:, :].reshape(*joints.shape[:-2], 4, 4, 3)], axis=-2)
    return np.asarray(np.linalg.norm(np.diff(chains, axis=-2), axis=-1).sum(axis=-1).mean(axis=-1))


def contacts(recording: Recording, hand: Hand, mesh: Mesh) -> Bool[ndarray, "N V"]:
    """The vertices of the held object in contact in each frame; none where hand or object are not known."""
    held = recording.objects[recording.held]
    touching = np.zeros((len(recording.hand_known), len(mesh.vertices)), dtype=bool)
    T_hand_obj = se3.inverse(hand.track.T_cam_hand) @ held.T_cam_obj[hand.frames]
    for n, T, vertices in zip(hand.frames, T_hand_obj, hand.track.vertices, strict=True):
        if held.known[n]:
            points = se3.transform(T, mesh.vertices)
            touching[n] = signed_distance(points, vertices, hand.track.faces, CONTACT) <= CONTACT
    return touching


def clip(grasp: Grasp, meshes: Path, note: Callable[[str], None] = lambda _: None) -> tuple[Clip, Masks] | None:
    """The grasp as a clip and its masks, without frames in which its object is not seen; nothing if few are left."""
    recording = grasp.recording
    held = recording.objects[recording.held]
    others = {
        name: (poses, mesh)
        for name, poses in recording.objects.items()
        if name != recording.held and (mesh := ycb_mesh(meshes, name)) is not None
    }
    rows, seen, ignore = [], [], []
    for row in np.searchsorted(grasp.hand.frames, np.arange(grasp.first, grasp.last + 1)):
        n = grasp.hand.frames[row]
        hand = se3.transform(grasp.hand.track.T_cam_hand[row], grasp.hand.track.vertices[row])
        visible, hidden = true_masks(
            _placed(held, grasp.mesh, n),
            [(hand, grasp.hand.track.faces)],
            [_placed(poses, mesh, n) for poses, mesh in others.values() if poses.known[n]],
            recording.K,
            SIZE,
        )
        if np.count_nonzero(visible) >= VISIBLE:
            rows.append(row)
            seen.append(visible)
            ignore.append(hidden)
    if len(rows) < SHORTEST:
        note(f"{grasp.name}: the object is seen in fewer than {SHORTEST} frames: left out")
        return None
    frames = grasp.hand.frames[rows]
    track = HandTrack(
        vertices=grasp.hand.track.vertices[rows],
        faces=grasp.hand.track.faces,
        T_cam_hand=grasp.hand.track.T_cam_hand[rows],
        regions=grasp.hand.track.regions,
        joints=None if grasp.hand.track.joints is None else grasp.hand.track.joints[rows],
    )
    made = Clip(
        name=grasp.name,
        category=recording.held,
        side=recording.side,
        fps=FPS,
        frames=tuple(f"{n:06d}" for n in frames),
        size=SIZE,
        K=np.tile(recording.K, (len(frames), 1, 1)),
        mesh=grasp.mesh,
        scale="known",
        hand=track,
        truth=Truth(held.T_cam_obj[frames], 1.0, track.T_cam_hand, track.vertices),
        provenance=_provenance(grasp, rows),
    )
    return made, Masks(np.array(seen), np.array(ignore))


def _placed(poses: Poses, mesh: Mesh, n: int) -> Surface:
    return se3.transform(poses.T_cam_obj[n], mesh.vertices), mesh.faces


def _provenance(grasp: Grasp, rows: list[int]) -> dict[str, Any]:
    recording, hand = grasp.recording, grasp.hand
    residuals = 1e3 * hand.residuals[rows]
    depth = _depths(grasp, rows)
    pads = [np.median(depth[:, hand.track.regions[finger]].min(axis=1)) for finger in FINGERS]
    dropped = grasp.last + 1 - grasp.first - len(rows)
    return {
        "source": f"DexYCB, sequence {recording.subject}/{recording.sequence}, frames {grasp.first} to {grasp.last}",
        "subject": recording.subject,
        "licence": "made from DexYCB, CC BY-NC 4.0",
        "hands": "the generic hand, fitted to DexYCB's 21 joints over all frames of the sequence: not the true surface",
        "hand_fit": f"joints {np.sqrt(np.mean(residuals**2)):.1f} mm off (root mean square; median "
        f"{np.median(residuals):.1f}, worst {residuals.max():.1f})",
        "masks": "rendered from the true poses, hidden by the fitted hand"
        + " and by the other objects that have a mesh" * (len(recording.objects) > 1),
        "camera": recording.camera or "one of DexYCB's, not necessarily the sequence's own",
        "scale": "YCB mesh, true size",
        "contact": "fingertips "
        + ", ".join(f"{f} {1e3 * d:.1f}" for f, d in zip(FINGERS, pads, strict=True))
        + f" mm from the object (median over frames; negative: inside), at most {-1e3 * depth.min():.1f} mm inside",
        "stable_contact_area": f"{grasp.stable_area:.3f} at {1e3 * CONTACT:.0f} mm",
        "dropped": f"{dropped} frames in which the object is not seen",
    }


def _depths(grasp: Grasp, rows: list[int]) -> Float[ndarray, "T V"]:
    """Signed distances of the hand's vertices to the object [m]."""
    track, held = grasp.hand.track, grasp.recording.objects[grasp.recording.held]
    T_obj_hand = se3.inverse(held.T_cam_obj[grasp.hand.frames[rows]]) @ track.T_cam_hand[rows]
    points = se3.transform(T_obj_hand, track.vertices[rows])
    return signed_distance(points.reshape(-1, 3), grasp.mesh.vertices, grasp.mesh.faces).reshape(points.shape[:2])


@lru_cache
def ycb_mesh(folder: Path, name: str) -> Mesh | None:
    """A YCB model: ``<name>.obj`` (or another format), or as YCB has it, ``<name>/textured_simple.obj``; else None."""
    for path in (*(folder / f"{name}{suffix}" for suffix in SUFFIXES), folder / name / "textured_simple.obj"):
        if path.is_file():
            return read_mesh(path)
    return None
