"""DexYCB (Chao et al., CVPR 2021): every stable grasp, as a clip with true poses and a hand fitted to the true joints.

DexYCB's hands are MANO's, which only licensed users have. Its 21 joints are free numbers, so the generic hand is fitted
to them, with one shape over a sequence. Masks are rendered from the true poses; no image is read.
"""

from __future__ import annotations

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
from getagrip.datasets import joint_tracks, ycb
from getagrip.datasets.cutting import CutSource, TrackedDataset
from getagrip.datasets.dataset import Note, Part
from getagrip.datasets.dexycb import timelines
from getagrip.datasets.dexycb.recording import (
    DEXYCB_IMAGE_SIZE_PX,
    DexYcbRecording,
    UnreadSequence,
    find_dexycb_sequences,
)
from getagrip.datasets.joint_tracks import describe_fit
from getagrip.datasets.tracks import SequenceSource, Track, TrackPiece
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.grasps.definition import MIN_GRASP_FRAMES, GraspOptions
from getagrip.grasps.lists import CLIP_NAME_SEPARATOR
from getagrip.io.arguments import Flag
from getagrip.io.terminal import format_count
from getagrip.metrics.surface_distance import signed_distance

if TYPE_CHECKING:
    from getagrip.geometry.render import Surface

GRASPS_WITHIN_10_MM = GraspOptions(contact_mm=10.0)
DEXYCB_FPS = 30.0


@dataclass(frozen=True, kw_only=True)
class DexYcb(TrackedDataset):
    """DexYCB, or a packed file of its sequences: every visible stable grasp."""

    root: Annotated[Positional[Path], arg(metavar="ROOT")]
    """Folder of the dataset, as published; or a packed file of its sequences (.npz), or a folder of such files."""
    grasps: Annotated[GraspOptions, arg(name="")] = GRASPS_WITHIN_10_MM
    """Definition of a stable grasp."""

    meshes: ycb.Models = None
    """Folder of the YCB models."""

    timelines: Flag = False
    """Import whole sequences instead of grasps, with masks and segments (docs/timelines.md)."""

    def sources(self) -> list[SequenceSource]:
        """List the sequences of DexYCB's own folder, of a packed file, or of a folder of such files."""
        models = ycb.ycb_models_folder(self.root, self.meshes)
        shortest = self.grasps.shortest if self.grasps.listed is None else MIN_GRASP_FRAMES
        found = find_dexycb_sequences(self.root)
        if self.timelines:
            found = timelines.add_table_pose(found, models)
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
        of = partial(timelines.dexycb_timeline_pieces, definition=definition)
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
        ycb.read_ycb_mesh(models, recording.grasped),
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
    from getagrip.geometry.render import true_masks  # loads numba

    surfaces: dict[str, Surface] = {}
    for name, poses in recording.objects.items():
        mesh = ycb.find_mesh(models, name)
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
    fitted = joint_tracks.fit_hand(recording.file, recording.sequence, recording.side, joints)
    return FittedRecordingHand(fitted.track, np.flatnonzero(recording.hand_known), fitted.residuals)
