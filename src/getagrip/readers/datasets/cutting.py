"""Clips cut from tracks: at gaps, to stable grasps (Eq. 2), or to the grasps of a list.

At most one sequence is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.clip import Clip, Masks, OtherHand, Segment, Truth
from getagrip.clip.read_arrays import MAX_CAMERA_RANGE_M, MIN_CAMERA_RANGE_M, check_in_view
from getagrip.clip.timeline import at_frames
from getagrip.clip.views import with_views
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import checked_mesh, used_vertices
from getagrip.geometry.mesh_files.obj import OBJ_DECIMALS
from getagrip.io.files import is_portable_name
from getagrip.io.options import Flag
from getagrip.metrics.contact import stable_contact_area
from getagrip.readers.datasets.dataset import Dataset, Draft, Missing, Note, Part
from getagrip.readers.datasets.tracks import SequenceSource, Track, TrackPiece
from getagrip.readers.datasets.views import MIN_VISIBLE_PIXELS, ViewCount, check_view_count, rendered_views
from getagrip.stable_grasps.definition import MIN_GRASP_FRAMES, GraspOptions
from getagrip.stable_grasps.find import FIRST_FRAME_KEY, CutRules, as_listed
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR, ListedGrasp

ALL_KNOWN_FRAMES = "all frames in which hand and object are known"
Pieces = Callable[[Iterable[Track], Note], Iterator[TrackPiece]]
"""A function that cuts tracks into pieces, one for each clip."""


@dataclass(frozen=True, kw_only=True)
class TrackedDataset(Dataset):
    """A dataset with true tracks of hands and objects."""

    root: Annotated[Positional[Path], arg(metavar="ROOT")]
    """Folder of the dataset, as published."""
    grasps: Annotated[GraspOptions, arg(name="")] = field(default_factory=GraspOptions)
    """Definition of a stable grasp."""
    whole: Flag = False
    """Import all frames instead of grasps, without masks: for segment and study."""

    def sources(self) -> list[SequenceSource]:
        """List the sequences. Raises ``UsageError`` for wrong options, ``InputError`` where none is found."""
        raise NotImplementedError

    def parts(self, note: Note) -> Sequence[Part]:
        """List the sequences, cut to stable grasps or, if ``whole``, at gaps only."""
        cut = self.cut(note)
        return [CutSource(s, partial(cut_into_grasps, cut=cut, whole=self.whole), cut.shortest) for s in self.sources()]

    def cut(self, note: Note) -> CutRules:
        """Return the cutting rules. Raises ``UsageError`` for wrong options, ``InputError`` for a malformed list."""
        if self.whole and self.grasps.listed is not None:
            raise UsageError("--list cannot be used with --whole")
        return self.grasps.cut(note)

    def cut_record(self) -> dict[str, object] | None:
        """Return the record of how clips are cut; None for whole tracks."""
        return None if self.whole else self.grasps.cut(lambda _: None).record()


@dataclass(frozen=True, kw_only=True)
class SeveralCameras(TrackedDataset):
    """A dataset with true tracks, recorded by several calibrated cameras."""

    views: ViewCount = 1
    """Number of views of a clip, or all that are calibrated: its own camera's, then those whose lines of sight differ
    most. Their masks are rendered from the true poses."""

    def cut(self, note: Note) -> CutRules:
        """Return the cutting rules. Raises as ``TrackedDataset.cut`` does, and ``UsageError`` for views of no masks."""
        check_view_count(self.views)
        if self.whole and self.views != 1:
            raise UsageError("--views cannot be used with --whole, whose clips have no masks")
        return super().cut(note)


@dataclass(frozen=True)
class CutSource:
    """A sequence with the function that cuts it into clips."""

    source: SequenceSource
    cut: Pieces
    shortest: int
    """Minimum number of frames of a clip."""

    @property
    def name(self) -> str:
        """Name of the sequence."""
        return self.source.name

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        """Yield a clip for each piece."""
        for piece in self.cut(self.source.read(note), note):
            if missing(piece.name):
                yield Draft(piece.name, partial(clip_of_piece, piece, self.shortest, note))


def cut_into_grasps(tracks: Iterable[Track], note: Note, cut: CutRules, whole: bool = False) -> Iterator[TrackPiece]:
    """Yield the stable grasps of some tracks, or (``whole``) the parts of each track without gaps.

    Whole pieces are many frames long and have no masks: they serve to study true poses. Raises ``InputError``.
    """
    for track in tracks:
        if not is_portable_name(track.name):
            raise InputError(track.file, "", f"the name {track.name!r}", "names that can be part of a folder's")
        found = (
            _gapless_pieces(track, cut)
            if whole
            else _found_grasp_pieces(track, cut)
            if cut.listed is None
            else _listed_grasp_pieces(track, cut, note)
        )
        number = 0
        for number, piece in enumerate(found, start=1):
            name = piece.name or track.name + f"{CLIP_NAME_SEPARATOR}{number}" * (number > 1)
            yield replace(piece, name=name, grasp=piece.grasp and replace(piece.grasp, sequence=track.name))
        if number == 0 and cut.listed is None and cut.definition.rule != "touch":  # hands touch few of many objects
            kind = "no run" if whole else "no stable grasp"
            note(f"{track.name}: {kind} of {cut.shortest} frames: skipped")


def _gapless_pieces(track: Track, cut: CutRules) -> Iterator[TrackPiece]:

    for part in split_track_at_gaps(track):
        if len(part) >= cut.shortest:
            yield TrackPiece(part, "", ALL_KNOWN_FRAMES, masks=False)


def _found_grasp_pieces(track: Track, cut: CutRules) -> Iterator[TrackPiece]:
    """Yield the stable grasps of a track, as ``getagrip segment`` finds them in its whole pieces."""
    for part in split_track_at_gaps(track):
        known = clip_of_track(part)
        iou, grasps = cut.of(known)
        for first, last in grasps:
            rows = slice(first, last + 1)
            area = f"{stable_contact_area(iou[rows, rows]):.3f}"
            made_of = f"a stable grasp: {cut.description}; contact IOU {area} on average"
            grasp = as_listed(known, first, last)
            area = f"{area} at {1e3 * cut.definition.contact:.0f} mm"
            yield TrackPiece(part.take(np.arange(first, last + 1)), "", made_of, grasp, area)


def _listed_grasp_pieces(track: Track, cut: CutRules, note: Note) -> Iterator[TrackPiece]:
    """Yield the grasps of a list, in the frames in which hand and object are known."""
    known = track.take(np.flatnonzero(in_front_of_camera(track)))
    assert cut.listed is not None
    for grasp in cut.listed.of(track.name, track.side, track.category):
        rows = grasp.positions(known.frames, track.origin)
        first, last = (f"{n:05d}" if isinstance(n, int) else n for n in (grasp.first, grasp.last))
        name = f"{track.name}{CLIP_NAME_SEPARATOR}{first}-{last}"
        if len(rows) < MIN_GRASP_FRAMES:
            note(f"{name}: hand and object are known in {len(rows)} of its frames: skipped")
            continue
        made_of = f"a grasp of {cut.listed.file}, frames {first} to {last}"
        numbers = known.numbers[rows]
        duration = float(numbers[-1] + 1 - numbers[0]) / track.fps
        ends = known.frames[rows[0]], known.frames[rows[-1]]
        written = ListedGrasp(track.name, track.side, track.category, *ends, grasp.duration or duration)
        yield TrackPiece(known.take(rows), name, made_of, written)


def split_track_at_gaps(track: Track) -> list[Track]:
    """Split a track into parts of consecutive frames, hand and object before the camera in every frame."""
    rows = np.flatnonzero(in_front_of_camera(track))
    breaks = np.flatnonzero(np.diff(track.numbers[rows]) != 1) + 1
    return [track.take(part) for part in np.split(rows, breaks) if part.size]


def in_front_of_camera(track: Track) -> Bool[ndarray, "T"]:
    """Return the frames in which hand and object are before the camera."""
    seen = np.ones(len(track), dtype=bool)
    hands = [hand for hand in (track.hand, track.input_hand) if hand is not None]
    for centre in (
        *(se3.transform(hand.T_cam_hand, hand.vertices.mean(axis=1)[:, None])[:, 0] for hand in hands),
        se3.transform(track.T_cam_obj, track.mesh.centre[None])[:, 0],
    ):
        seen &= (centre[:, 2] > MIN_CAMERA_RANGE_M) & (np.linalg.norm(centre, axis=1) < MAX_CAMERA_RANGE_M)
    return seen


def clip_of_track(
    track: Track, name: str = "", provenance: dict[str, object] | None = None, segments: tuple[Segment, ...] = ()
) -> Clip:
    """Make a clip of a track, without masks. Raises ``InputError`` for an impossible object.

    The mesh of an object with a joint is posed at the mean angle; the ground truth has the true angles.
    """
    angle = 0.0 if track.articulation is None else float(track.articulation.mean())
    mesh = track.object(angle)
    joint = track.joint
    if joint is not None:  # mesh files merge vertices, so the joint is reduced to the merged ones
        mesh = Mesh(mesh.vertices.round(OBJ_DECIMALS), mesh.faces)
        joint = replace(joint, angle=angle, moves=joint.moves[used_vertices(mesh.vertices, mesh.faces)[0]])
    return Clip(
        name=name or track.name,
        category=track.category,
        side=track.side,
        fps=track.fps,
        frames=track.frames,
        times=track.times,
        world=track.world,
        segments=segments,
        size=track.size,
        K=np.tile(track.K, (len(track), 1, 1)),
        mesh=checked_mesh(track.file, mesh.vertices, mesh.faces),
        scale="known",
        hand=track.input_hand or track.hand,
        truth=Truth(track.T_cam_obj, 1.0, track.hand.T_cam_hand, track.hand.vertices, track.articulation, joint),
        provenance=provenance or {},
    )


def clip_of_piece(piece: TrackPiece, shortest: int, note: Note) -> tuple[Clip, Masks | None] | None:
    """Make the clip of a piece, and its masks; None if the object is visible in fewer than ``shortest`` frames.

    Frames with fewer than ``MIN_VISIBLE_PIXELS`` visible pixels of the object are dropped. Masks show an object with a
    joint at its true angles.
    """
    track, masks, segments = piece.track, None, piece.segments
    if piece.masks:
        rows, masks = _visible_frames(track)
        if len(rows) < shortest:
            note(f"{piece.name}: the object is visible in fewer than {shortest} frames: skipped")
            return None
        if len(rows) < len(track):
            track, segments = track.take(rows), at_frames(segments, rows)
    provenance = track.describe(piece) | {FIRST_FRAME_KEY: track.origin}
    if piece.grasp is not None:
        provenance["grasp"] = piece.grasp.row()
    made = clip_of_track(track, piece.name, provenance, segments)
    if piece.other is not None:
        made = replace(made, other_hand=_other_hand_of_track(piece.other, track))
    try:
        check_in_view(track.file, made.hand, made.K, track.size)
    except InputError:
        note(f"{piece.name}: the hand is outside the image in every frame: skipped")
        return None
    if masks is not None and track.views:
        made = with_views(made, rendered_views(track, provenance, note))
    return made, masks


def _other_hand_of_track(other: Track, track: Track) -> OtherHand | None:
    """Return the other hand in a track's frames; None where it is never in the image."""
    _, rows, source = np.intersect1d(track.numbers, other.numbers, return_indices=True)
    if not len(rows):
        return None
    hand = (other.input_hand or other.hand).take(source)
    try:
        check_in_view(other.file, hand, np.tile(track.K, (len(rows), 1, 1)), track.size)
    except InputError:
        return None
    return OtherHand.at(hand, rows, len(track))


def _visible_frames(track: Track) -> tuple[Int[ndarray, "n"], Masks]:
    """Return the frames in which the object is visible, and their masks.

    Masks of a long hold in large images take gigabytes: they are memory-mapped to a temporary file.
    """
    width, height = track.size
    with TemporaryFile() as file:
        all_masks = np.memmap(file, dtype=bool, mode="w+", shape=(3, len(track), height, width))
    rows: list[int] = []
    hand_known = True
    for row in range(len(track)):
        masks = track.masks(row)
        if np.count_nonzero(masks.object) >= MIN_VISIBLE_PIXELS:
            for kind, mask in zip(all_masks, masks, strict=True):
                if mask is not None:
                    kind[len(rows)] = mask
            hand_known &= masks.hand is not None
            rows.append(row)
    visible, ignore, hand = all_masks[:, : len(rows)]
    return np.array(rows, dtype=np.int64), Masks(visible, ignore, hand if hand_known else None)
