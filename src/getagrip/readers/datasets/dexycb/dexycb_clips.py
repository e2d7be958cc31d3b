"""DexYCB (Chao et al., CVPR 2021): stable grasps or whole timelines, with true poses and a hand fitted to true joints.

DexYCB's hands are MANO's, which only licensed users have. Its 21 joints are free numbers, so the generic hand is fitted
to them, with one shape over a sequence. Masks are rendered from the true poses; no image is read.

In a timeline an object lies on the table, is taken, lifted, and grasped until the end, before a static camera. Without
a calibration of the table, the table is fitted to the objects in the first frames of the subject's other sequences,
which have the same camera.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.clip import FINGERS, HandTrack, World
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.io.options import Flag
from getagrip.io.terminal import format_count
from getagrip.metrics.contact import signed_distance
from getagrip.readers.datasets import mano_tracks, track_files
from getagrip.readers.datasets.cutting import CutSource, SeveralCameras, clip_of_track
from getagrip.readers.datasets.dataset import Note, Part
from getagrip.readers.datasets.dexycb.dexycb_files import (
    DEXYCB_IMAGE_SIZE_PX,
    DexYcbRecording,
    UnreadSequence,
    find_dexycb_sequences,
)
from getagrip.readers.datasets.track_files import describe_fit
from getagrip.readers.datasets.tracks import (
    GRASPS_WITHIN_10_MM,
    SequenceSource,
    Track,
    TrackPiece,
    is_clip_of_sequence,
)
from getagrip.readers.datasets.views import TrackView, check_view_count, with_further_views
from getagrip.stable_grasps.definition import MIN_GRASP_FRAMES, Definition, GraspOptions
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR
from getagrip.stable_grasps.segment_states import true_segments

if TYPE_CHECKING:
    from getagrip.geometry.rasterize import Surface

MIN_TABLE_SEQUENCES = 3
"""Minimum number of objects to which a table is fitted."""
INITIAL_UP_DIRECTION = np.array([0.0, -0.8, -0.6])
"""Initial up direction of the plane fit, for a camera that looks down at the table by about 37 degrees."""
TABLE_CONTACT_TOLERANCE_M = 0.003
"""Maximum height of a contact point above an object's lowest point [m]."""
TABLE_OUTLIER_SCALE_M = 0.01
"""Distance of an object's lowest point from the plane at which its weight is half [m]: it lies on another object, or
its pose is wrong."""
N_PLANE_FIT_ITERATIONS = 30


def add_table_pose(sequences: Sequence[UnreadSequence], models: Path) -> list[UnreadSequence]:
    """Add the camera's pose in the table's world, with the table at height 0, to the sequences' recordings."""
    by_subject = defaultdict(list)
    for sequence in sequences:
        by_subject[sequence.name.partition("/")[0]].append(sequence)

    def with_table(sequence: UnreadSequence) -> UnreadSequence:
        others = [other for other in by_subject[sequence.name.partition("/")[0]] if other is not sequence]
        return replace(sequence, read=partial(_read_with_table, sequence, others, models))

    return [with_table(sequence) for sequence in sequences]


def _read_with_table(sequence: UnreadSequence, others: Sequence[UnreadSequence], models: Path) -> DexYcbRecording:
    """Read a recording with its table; without a table, the camera frame is the world frame."""
    recording = sequence.read()
    if recording.T_table_cam is not None:
        return recording
    resting = [_first_frame_vertices(other.read(), models) for other in others]
    if len(resting) < MIN_TABLE_SEQUENCES:
        return recording
    return replace(recording, T_table_cam=world_of_plane(*support_plane(resting)))


def _first_frame_vertices(recording: DexYcbRecording, models: Path) -> np.ndarray:
    """Return the grasped object's vertices in its first known frame (V, 3) [m]."""
    poses = recording.objects[recording.grasped]
    vertices = mano_tracks.read_ycb_mesh(models, recording.grasped).vertices
    return se3.transform(poses.T_cam_obj[int(np.argmax(poses.known))], vertices)


def dexycb_timeline_pieces(tracks: Iterable[Track], note: Note, definition: Definition) -> Iterator[TrackPiece]:
    """Yield each track whole, with its segments."""
    for track in tracks:
        world = track.world or World(np.tile(np.eye(4), (len(track), 1, 1)))
        on_table = World(world.T_world_cam, world.up, None if world.up is None else 0.0)
        placed = replace(track, world=on_table)
        segments = true_segments(clip_of_track(placed), definition)
        if not any(segment.state == "static" for segment in segments):
            note(f"{track.name}: the object is never static")
        made_of = "a timeline: static, contact and grasp by the true poses"
        yield TrackPiece(placed, track.name, made_of, segments=segments)


def support_plane(resting: Sequence[Float[ndarray, "_ 3"]]) -> tuple[Float[ndarray, "3"], float]:
    """Fit the plane on which objects rest to their posed vertices [m]; return its unit normal, up, and its height.

    Iterated least squares over the objects' lowest points, which depend on the plane. Each object has the same weight,
    less where it seems to rest on something else (Cauchy's weights).
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
    """Return ``T_world_cam`` for a world with z up, the plane at z = 0 and the camera above the origin."""
    x = np.cross([0.0, 1.0, 0.0], up)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    return se3.rigid(R, np.array([0.0, 0.0, -height]))


DEXYCB_FPS = 30.0


@dataclass(frozen=True, kw_only=True)
class DexYcb(SeveralCameras):
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
        if self.views != 1 and any(sequence.further_cameras is None for sequence in found):
            raise UsageError(f"--views {self.views} needs DexYCB's own layout: a packed file has one camera")
        if self.timelines:
            found = add_table_pose(found, models)
        read = partial(_read_dexycb_tracks, models=models, whole=self.whole, shortest=shortest, views=self.views)
        return [SequenceSource(sequence.name, partial(read, sequence)) for sequence in found]

    def parts(self, note: Note) -> Sequence[Part]:
        """List the sequences, cut to stable grasps, or whole. Raises ``UsageError`` for conflicting options."""
        if not self.timelines:
            return super().parts(note)
        if self.whole or self.grasps.listed is not None:
            raise UsageError("--timelines cannot be used with --whole or --list")
        check_view_count(self.views)
        definition = self.grasps.definition()
        of = partial(dexycb_timeline_pieces, definition=definition)
        return [CutSource(source, of, definition.shortest) for source in self.sources()]

    def may_make(self, part: Part, names: Set[str]) -> bool:
        """Return whether one of the names is of the sequence, which is named <subject>/<sequence>."""
        subject, _, sequence = part.name.partition("/")
        return any(is_clip_of_sequence(name, subject, sequence) for name in names)

    def cut_record(self) -> dict[str, object] | None:
        """Return the record of how clips are cut; None for whole sequences."""
        return None if self.timelines else super().cut_record()


@dataclass(frozen=True)
class FittedRecordingHand:
    """The generic hand fitted to the frames of a sequence that have joints."""

    track: HandTrack
    frames: Int[ndarray, "T"]
    residuals: Float[ndarray, "T 21"]
    """Distances of the hand's joints from the true joints [m]."""


@dataclass(frozen=True, kw_only=True)
class FittedTrack(Track):
    """A track of DexYCB with its hand's fit residuals; its clips are named without the side."""

    residuals: Float[ndarray, "_ 21"]
    """Distances of the hand's joints from the true joints [m]."""
    others: bool
    """True if other objects are on the table."""

    @property
    def name(self) -> str:
        """Name of the track's clips, without their number."""
        return CLIP_NAME_SEPARATOR.join([self.subject, self.sequence, self.category])

    def take(self, index: Int[ndarray, "n"]) -> Self:
        """Return the track at some of its frames."""
        return replace(super().take(index), residuals=self.residuals[index])

    def describe(self, piece: TrackPiece) -> dict[str, object]:
        """Return the provenance of a piece's clip, with the residuals and the contact of the fitted hand."""
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


def _read_dexycb_tracks(
    sequence: UnreadSequence, note: Note, *, models: Path, whole: bool, shortest: int, views: int | Literal["all"]
) -> list[Track]:
    """Return the track of a sequence; none with fewer than ``shortest`` known hands. Raises ``InputError``."""
    recording = sequence.read()
    if np.count_nonzero(recording.hand_known) < shortest:
        note(f"{sequence.name}: the hand is known in fewer than {shortest} frames: skipped")
        return []
    mesh, hand = mano_tracks.read_ycb_mesh(models, recording.grasped), fit_recording_hand(recording)
    poses = recording.objects[recording.grasped]
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
        beside=partial(_other_objects, recording, models),
        world=None
        if recording.T_table_cam is None
        else World(np.tile(recording.T_table_cam, (len(hand.frames), 1, 1)), np.array([0.0, 0.0, 1.0])),
    )
    if not whole:
        track = FittedTrack(**vars(track), residuals=hand.residuals, others=len(recording.objects) > 1)
    track = with_further_views(track, views, partial(_further_views, sequence, recording.camera, len(track)), note)
    return [track.take(np.flatnonzero(poses.known[hand.frames]))]


def _further_views(sequence: UnreadSequence, own: str, frames: int) -> list[TrackView]:
    assert sequence.further_cameras is not None
    return [
        TrackView(
            name=camera.serial,
            K=camera.K,
            size=DEXYCB_IMAGE_SIZE_PX,
            T_cam_view=np.tile(camera.T_cam_view, (frames, 1, 1)),
            camera=camera.serial,
        )
        for camera in sequence.further_cameras(own)
    ]


def _other_objects(recording: DexYcbRecording, models: Path, n: int) -> tuple[list[Surface], list[Surface]]:
    """Pose no further hand, and the other objects that have a mesh, in frame n."""
    surfaces: list[Surface] = []
    for name, poses in recording.objects.items():
        mesh = None if name == recording.grasped else mano_tracks.find_mesh(models, name)
        if mesh is not None and poses.known[n]:
            surfaces.append((se3.transform(poses.T_cam_obj[n], mesh.vertices), mesh.faces))
    return [], surfaces


def fit_recording_hand(recording: DexYcbRecording) -> FittedRecordingHand:
    """Fit the generic hand in every frame with joints, with one shape. Raises ``InputError`` for impossible joints."""
    joints = recording.joints[recording.hand_known]
    fitted = track_files.fit_hand(recording.file, recording.sequence, recording.side, joints)
    return FittedRecordingHand(fitted.track, np.flatnonzero(recording.hand_known), fitted.residuals)
