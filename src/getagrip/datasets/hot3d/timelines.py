"""HOT3D's recordings as timelines: what both hands do with an object, between two long static segments.

Each timeline is a clip of the hand that touches the object in more of its frames, with the segments of both hands: by
the true poses, or as the authors' list has them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.clip.timeline import at_frames
from getagrip.datasets.cutting import clip_of_track, in_front_of_camera
from getagrip.datasets.dataset import Note
from getagrip.datasets.tracks import Track, TrackPiece
from getagrip.grasps.cut import CutRules
from getagrip.grasps.lists import CLIP_NAME_SEPARATOR
from getagrip.grasps.stable import contact_sets
from getagrip.grasps.states import interactions, resolve_overlaps, segment_by_contact
from getagrip.grasps.timelines import ListedTimeline
from getagrip.hands.model import Side

DERIVED_TIMELINE_SOURCE = "a timeline: static, contact and grasp by the true poses; {}"


def hot3d_timeline_pieces(tracks: Iterable[Track], note: Note, cut: CutRules) -> Iterator[TrackPiece]:
    """Yield the timelines of a recording, whose tracks come object by object."""
    for _, of_object in groupby(tracks, key=lambda track: track.category):
        hands = [track.take(np.flatnonzero(in_front_of_camera(track))) for track in of_object]
        if cut.listed is None:
            found = list(_derived_timelines(hands, cut))
        else:
            sides = [track.side for track in hands]
            found = [
                piece
                for track in hands
                for piece in _listed_timelines(track, sides, cut.listed.timelines, cut.description)
            ]
        for piece in (replace(piece, other=_other_hand_track(piece.track, hands)) for piece in found):
            if not any(segment.state == "static" for segment in piece.segments):
                note(f"{piece.name}: the object is never static")
            yield piece


def _derived_timelines(hands: Sequence[Track], cut: CutRules) -> Iterator[TrackPiece]:
    """Yield an object's timelines by the true poses."""
    definition = cut.definition
    contact = {
        track.side: contact_sets(clip_of_track(track), definition.contact, definition.points)
        for track in hands
        if len(track)
    }
    if not any(sets.any() for sets in contact.values()):
        return
    numbers = {track.side: track.numbers for track in hands}
    for track in hands:
        if track.side not in contact:
            continue
        sets = {side: _resample_contacts(numbers[side], of_hand, track.numbers) for side, of_hand in contact.items()}
        touched = {side: np.asarray(of_hand.any(axis=1)) for side, of_hand in sets.items()}
        segments = segment_by_contact(clip_of_track(track), sets, definition)
        for rows in interactions(segments):
            if _main_hand_side({side: int(in_frames[rows].sum()) for side, in_frames in touched.items()}) == track.side:
                made_of = DERIVED_TIMELINE_SOURCE.format(definition.description)
                yield _piece(track.take(rows), at_frames(segments, rows), made_of)


def _resample_contacts(
    value: Int[ndarray, "S"], sets: Bool[ndarray, "S P"], wanted: Int[ndarray, "T"]
) -> Bool[ndarray, "T P"]:
    """Contact sets of the frames ``given`` in the frames ``wanted``; none where they are not known."""
    out = np.zeros((len(wanted), sets.shape[1]), dtype=bool)
    _, rows, source = np.intersect1d(wanted, value, return_indices=True)
    out[rows] = sets[source]
    return out


def _listed_timelines(
    track: Track, sides: Sequence[Side], timelines: Sequence[ListedTimeline], source: str
) -> Iterator[TrackPiece]:
    """Yield the timelines of a list that are of a track's object, and of its hand more than of the others."""
    name = f"{track.subject}_{track.sequence}"
    for timeline in timelines:
        if (timeline.sequence, timeline.category) != (name, track.category):
            continue
        if not timeline.segments:
            continue
        numbers = track.numbers - track.origin
        first, last = min(s.first for s in timeline.segments), max(s.last for s in timeline.segments)
        of_list = np.flatnonzero((numbers >= first) & (numbers <= last))
        known = track.take(of_list)
        spans = [span for s in timeline.segments for span in at_frames([s], numbers[of_list])]
        segments = resolve_overlaps(spans, len(known), track.side)
        for rows in interactions(segments):
            cut = at_frames(segments, rows)
            grasped = {side: sum(len(s) for s in cut if s.state == "grasp" and s.side == side) for side in sides}
            if _main_hand_side(grasped) == track.side:
                yield _piece(known.take(rows), cut, f"a timeline of {source}")


def _other_hand_track(track: Track, hands: Sequence[Track]) -> Track | None:
    return next((other for other in hands if other.side != track.side and len(other)), None)


def _main_hand_side(frames: Mapping[Side, int]) -> Side | None:
    """Return the hand with the most frames, the left one if both have as many; None where none has one."""
    best = max(sorted(frames), key=lambda side: frames[side])
    return best if frames[best] else None


def _piece(track: Track, segments: tuple[Segment, ...], made_of: str) -> TrackPiece:
    name = f"{track.name}{CLIP_NAME_SEPARATOR}{track.frames[0]}-{track.frames[-1]}"
    return TrackPiece(track, name, made_of, segments=segments)
