"""DexYCB (Chao et al., CVPR 2021): every stable grasp, as a clip with true poses and a hand fitted to the true joints.

DexYCB's hands are MANO's, which only licensed users have. Its 21 joints are free numbers, so the generic hand is fitted
to them, with one shape over a sequence. Masks are rendered from the true poses; no image is read.

DexYCB's sequences whole, as timelines: an object lies on the table, is taken, lifted, and held at the end.

The camera stands still. Where no calibration says how it stands to the table, the table is fitted to where the objects
of the subject's other sequences lie at first: the camera is the same in all of them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Sequence as AnyOf
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.clip import FINGERS, FrameMasks, HandTrack, World
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.io.options import Flag
from getagrip.io.terminal import format_count
from getagrip.metrics.contact import signed_distance
from getagrip.readers.datasets import mano_tracks, track_files
from getagrip.readers.datasets.cutting import CutSource, TrackedDataset, clip_of_track
from getagrip.readers.datasets.dataset import Note, Part
from getagrip.readers.datasets.dexycb import dexycb_files as files
from getagrip.readers.datasets.dexycb.dexycb_files import (
    DEXYCB_IMAGE_SIZE_PX,
    DexYcbRecording,
    UnreadSequence,
    find_dexycb_sequences,
)
from getagrip.readers.datasets.track_files import describe_fit
from getagrip.readers.datasets.tracks import SequenceSource, Track, TrackPiece
from getagrip.stable_grasps.definition import MIN_GRASP_FRAMES, Definition, GraspOptions
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR
from getagrip.stable_grasps.segment_states import true_segments

if TYPE_CHECKING:
    from getagrip.geometry.rasterize import Surface

MIN_TABLE_SEQUENCES = 3
"""Sequences whose objects lie on a plane; fewer do not show it."""
INITIAL_UP_DIRECTION = np.array([0.0, -0.8, -0.6])
"""Up as a camera sees it that looks down at a table by about 37 degrees; only a start."""
TABLE_CONTACT_TOLERANCE_M = 0.003
"""Points of an object this near to its lowest one lie on the plane [m]."""
TABLE_OUTLIER_SCALE_M = 0.01
"""An object whose lowest point is this far from the plane counts half [m]: it lies on another, or its pose is wrong."""
N_PLANE_FIT_ITERATIONS = 30


def add_table_pose(sequences: Sequence[files.UnreadSequence], models: Path) -> list[files.UnreadSequence]:
    """Add to the sequences' recordings the camera in the world, with the table at height 0."""
    of_subject = defaultdict(list)
    for sequence in sequences:
        of_subject[_subject_of_sequence(sequence)].append(sequence)
    return [
        files.UnreadSequence(
            s.name,
            partial(
                _read_with_table, s, [other for other in of_subject[_subject_of_sequence(s)] if other is not s], models
            ),
        )
        for s in sequences
    ]


def _subject_of_sequence(sequence: files.UnreadSequence) -> str:
    return sequence.name.partition("/")[0]


def _read_with_table(
    sequence: files.UnreadSequence, others: Sequence[files.UnreadSequence], models: Path
) -> files.DexYcbRecording:
    """Read a recording with its table; where there is none, its world is the camera's own frame."""
    recording = sequence.read()
    if recording.T_table_cam is not None:
        return recording
    resting = [_first_frame_vertices(other.read(), models) for other in others]
    if len(resting) < MIN_TABLE_SEQUENCES:
        return recording
    return replace(recording, T_table_cam=world_of_plane(*support_plane(resting)))


def _first_frame_vertices(recording: files.DexYcbRecording, models: Path) -> np.ndarray:
    """Return the grasped object's vertices in the first frame in which it is known (V, 3) [m]."""
    poses = recording.objects[recording.grasped]
    return se3.transform(
        poses.T_cam_obj[int(np.argmax(poses.known))], mano_tracks.read_ycb_mesh(models, recording.grasped).vertices
    )


def dexycb_timeline_pieces(tracks: Iterable[Track], note: Note, definition: Definition) -> Iterator[TrackPiece]:
    """Yield each track whole, with its segments."""
    for track in tracks:
        world = track.world or World(np.tile(np.eye(4), (len(track), 1, 1)))
        on_table = World(world.T_world_cam, world.up, None if world.up is None else 0.0)
        placed = replace(track, world=on_table)
        segments = true_segments(clip_of_track(placed), definition)
        if not any(segment.state == "static" for segment in segments):
            note(f"{track.name}: the object is never static")
        yield TrackPiece(
            placed, track.name, "a timeline: static, contact and grasp by the true poses", segments=segments
        )


def support_plane(resting: Sequence[Float[ndarray, "_ 3"]]) -> tuple[Float[ndarray, "3"], float]:
    """Fit the plane on which objects rest to their posed vertices [m]: unit normal, up, and height along it.

    Least squares over their lowest points, which depend on the plane: a few rounds of it. Each object counts as one,
    and less where it seems to rest on something else (Cauchy's weights).
    """
    up = INITIAL_UP_DIRECTION
    for _ in range(N_PLANE_FIT_ITERATIONS):
        heights = [points @ up for points in resting]
        lowest = [points[h < h.min() + TABLE_CONTACT_TOLERANCE_M] for points, h in zip(resting, heights, strict=True)]
        least = np.array([h.min() for h in heights])
        of_object = 1.0 / (1.0 + ((least - np.median(least)) / TABLE_OUTLIER_SCALE_M) ** 2)
        points = np.concatenate(lowest)
        weight = np.concatenate([np.full(len(p), np.sqrt(w / len(p))) for p, w in zip(lowest, of_object, strict=True)])
        middle = np.average(points, axis=0, weights=weight**2)
        normal = np.linalg.svd(weight[:, None] * (points - middle), full_matrices=False)[2][-1]
        up = normal if normal @ up > 0 else -normal
    return up, float(np.median([(points @ up).min() for points in resting]))


def world_of_plane(up: Float[ndarray, "3"], height: float) -> Float[ndarray, "4 4"]:
    """Return ``T_world_cam`` of a world whose z axis is up, the plane at z = 0, the camera above its origin."""
    x = np.cross([0.0, 1.0, 0.0], up)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    return se3.rigid(R, np.array([0.0, 0.0, -height]))


GRASPS_WITHIN_10_MM = GraspOptions(contact_mm=10.0)
DEXYCB_FPS = 30.0


@dataclass(frozen=True, kw_only=True)
class DexYcb(TrackedDataset):
    """DexYCB, or a packed file of its sequences: every visible stable grasp."""

    root: Annotated[Positional[Path], arg(metavar="ROOT")]
    """Folder of the dataset, as published; or a packed file of its sequences (.npz), or a folder of such files."""
    grasps: Annotated[GraspOptions, arg(name="")] = GRASPS_WITHIN_10_MM
    """Definition of a stable grasp."""

    meshes: mano_tracks.Models = None
    """Folder of the YCB models."""

    timelines: Flag = False
    """Import whole sequences instead of grasps, with masks and segments (docs/timelines.md)."""

    def sources(self) -> list[SequenceSource]:
        """List the sequences of DexYCB's own folder, of a packed file, or of a folder of such files."""
        models = mano_tracks.ycb_models_folder(self.root, self.meshes)
        shortest = self.grasps.shortest if self.grasps.listed is None else MIN_GRASP_FRAMES
        found = find_dexycb_sequences(self.root)
        if self.timelines:
            found = add_table_pose(found, models)
        return [SequenceSource(s.name, partial(_read_dexycb_tracks, s, models, self.whole, shortest)) for s in found]

    def parts(self, note: Note) -> AnyOf[Part]:
        """List its sequences, cut to stable grasps, or whole.

        Raises ``UsageError`` for options that exclude each other.
        """
        if not self.timelines:
            return super().parts(note)
        if self.whole or self.grasps.listed is not None:
            raise UsageError("--timelines cannot be used with --whole or --list")
        definition = self.grasps.definition()
        of = partial(dexycb_timeline_pieces, definition=definition)
        return [CutSource(source, of, definition.shortest) for source in self.sources()]

    def cut_record(self) -> dict[str, object] | None:
        """Return the record of how its clips are cut; None where they are whole."""
        return None if self.timelines else super().cut_record()


@dataclass(frozen=True)
class FittedRecordingHand:
    """The generic hand fitted to the frames of a sequence that have joints."""

    track: HandTrack
    frames: Int[ndarray, "T"]
    """The frames."""
    residuals: Float[ndarray, "T 21"]
    """Distances of its joints from the true ones [m]."""


@dataclass(frozen=True, kw_only=True)
class FittedTrack(Track):
    """A track of DexYCB that says how well its hand fits; its clips are named without the side."""

    residuals: Float[ndarray, "_ 21"]
    """Distances of the hand's joints from the true ones [m]."""
    others: bool
    """True if other objects are on the table."""

    @property
    def name(self) -> str:
        """Name of its clips, without the count."""
        return CLIP_NAME_SEPARATOR.join([self.subject, self.sequence, self.category])

    def take(self, index: Int[ndarray, "n"]) -> Self:
        """Return the track at some of its frames."""
        return replace(super().take(index), residuals=self.residuals[index])

    def describe(self, piece: TrackPiece) -> dict[str, object]:
        """Return the provenance of a piece's clip, with the limits of its hand."""
        first, last = piece.track.numbers[[0, -1]]
        depth = self.hand_depth()
        pads = [np.median(depth[:, self.hand.regions[finger]].min(axis=1)) for finger in FINGERS]
        return {
            "source": f"DexYCB, sequence {self.subject}/{self.sequence}, frames {first} to {last}",
            "subject": self.subject,
            "licence": "made from DexYCB, CC BY-NC 4.0",
            "hands": "the generic hand, fitted to DexYCB's 21 joints over all frames of the sequence: not the true "
            "surface",
            "hand_fit": describe_fit(self.residuals),
            "masks": "rendered from the true poses, hidden by the fitted hand"
            + " and by the other objects that have a mesh" * self.others,
            "camera": self.provenance["camera"],
            "scale": self.provenance["scale"],
            "contact": "fingertips "
            + ", ".join(f"{finger} {1e3 * d:.1f}" for finger, d in zip(FINGERS, pads, strict=True))
            + f" mm from the object (median over frames; negative: inside), at most {-1e3 * depth.min():.1f} mm inside",
            **({"stable_contact_area": piece.stable_area} if piece.stable_area else {}),
            "dropped": f"{format_count(len(piece.track) - len(self), 'frame')} in which the object is not visible",
        }

    def hand_depth(self) -> Float[ndarray, "T V"]:
        """Compute the signed distances of the hand's vertices to the object [m], negative inside."""
        mesh = self.mesh
        points = se3.transform(se3.inverse(self.T_cam_obj) @ self.hand.T_cam_hand, self.hand.vertices)
        return signed_distance(points.reshape(-1, 3), mesh.vertices, mesh.faces).reshape(points.shape[:2])


def _read_dexycb_tracks(sequence: UnreadSequence, models: Path, whole: bool, shortest: int, note: Note) -> list[Track]:
    """Return the one track of a sequence; none where the hand is hardly ever known. Raises ``InputError``."""
    recording = sequence.read()
    if np.count_nonzero(recording.hand_known) < shortest:
        note(f"{sequence.name}: the hand is known in fewer than {shortest} frames: skipped")
        return []
    mesh, hand, poses = (
        mano_tracks.read_ycb_mesh(models, recording.grasped),
        fit_recording_hand(recording),
        recording.objects[recording.grasped],
    )
    track = Track(
        file=recording.file,
        subject=recording.subject,
        sequence=recording.sequence,
        category=recording.grasped,
        side=recording.side,
        fps=DEXYCB_FPS,
        numbers=hand.frames,
        digits=6,
        size=DEXYCB_IMAGE_SIZE_PX,
        K=recording.K,
        hand=hand.track,
        T_cam_obj=poses.T_cam_obj[hand.frames],
        mesh=mesh,
        provenance={
            "dataset": "DexYCB, CC BY-NC 4.0",
            "hands": "the generic hand, fitted to DexYCB's 21 joints over all frames: not the true surface",
            "camera": recording.camera or "one of DexYCB's, not necessarily the sequence's own",
            "scale": "YCB mesh, true size",
        },
        read_masks=partial(_render_dexycb_masks, recording, hand, models),
        world=None
        if recording.T_table_cam is None
        else World(np.tile(recording.T_table_cam, (len(hand.frames), 1, 1)), np.array([0.0, 0.0, 1.0])),
    )
    if not whole:
        track = FittedTrack(**vars(track), residuals=hand.residuals, others=len(recording.objects) > 1)
    return [track.take(np.flatnonzero(poses.known[hand.frames]))]


def _render_dexycb_masks(recording: DexYcbRecording, hand: FittedRecordingHand, models: Path, n: int) -> FrameMasks:
    """Render the grasped object's mask in frame n, and the ignored pixels (the hand, other objects with a mesh)."""
    from getagrip.geometry.rasterize import true_masks  # loads numba

    surfaces: dict[str, Surface] = {}
    for name, poses in recording.objects.items():
        mesh = mano_tracks.find_mesh(models, name)
        if mesh is not None and poses.known[n]:
            surfaces[name] = se3.transform(poses.T_cam_obj[n], mesh.vertices), mesh.faces
    grasped = surfaces.pop(recording.grasped)
    row = int(np.searchsorted(hand.frames, n))
    in_front = se3.transform(hand.track.T_cam_hand[row], hand.track.vertices[row]), hand.track.faces
    return FrameMasks(*true_masks(grasped, [in_front], list(surfaces.values()), recording.K, DEXYCB_IMAGE_SIZE_PX))


def fit_recording_hand(recording: DexYcbRecording) -> FittedRecordingHand:
    """Fit the generic hand in every frame that has joints, with one shape.

    Raises ``InputError`` where they are no hand's.
    """
    joints = recording.joints[recording.hand_known]
    fitted = track_files.fit_hand(recording.file, recording.sequence, recording.side, joints)
    return FittedRecordingHand(fitted.track, np.flatnonzero(recording.hand_known), fitted.residuals)
