"""DexYCB's sequences whole, as timelines: an object lies on the table, is taken, lifted, and held at the end.

The camera stands still. Where no calibration says how it stands to the table, the table is fitted to where the objects
of the subject's other sequences lie at first: the camera is the same in all of them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from getagrip.clip import World
from getagrip.datasets import ycb
from getagrip.datasets.cutting import known_clip
from getagrip.datasets.dataset import Note
from getagrip.datasets.dexycb import recording as files
from getagrip.datasets.support import support_plane, world_of_plane
from getagrip.datasets.tracks import Piece, Track
from getagrip.geometry import se3
from getagrip.grasps.definition import Definition
from getagrip.grasps.states import true_segments

FEWEST_OTHERS = 3
"""Sequences whose objects lie on a plane; fewer do not show it."""


def with_table(sequences: Sequence[files.Sequence], models: Path) -> list[files.Sequence]:
    """The sequences, their recordings with the camera in the world, the table at height 0."""
    of_subject = defaultdict(list)
    for sequence in sequences:
        of_subject[_subject(sequence)].append(sequence)
    return [
        files.Sequence(
            s.name, partial(_read, s, [other for other in of_subject[_subject(s)] if other is not s], models)
        )
        for s in sequences
    ]


def _subject(sequence: files.Sequence) -> str:
    return sequence.name.partition("/")[0]


def _read(sequence: files.Sequence, others: Sequence[files.Sequence], models: Path) -> files.Recording:
    """A recording with its table; where there is none, its world is the camera's own frame."""
    recording = sequence.read()
    if recording.T_table_cam is not None:
        return recording
    resting = [_at_first(other.read(), models) for other in others]
    if len(resting) < FEWEST_OTHERS:
        return recording
    return replace(recording, T_table_cam=world_of_plane(*support_plane(resting)))


def _at_first(recording: files.Recording, models: Path) -> np.ndarray:
    """The held object's vertices as it lies in the first frame in which it is known (V, 3) [m]."""
    poses = recording.objects[recording.held]
    return se3.transform(poses.T_cam_obj[int(np.argmax(poses.known))], ycb.mesh(models, recording.held).vertices)


def pieces(tracks: Iterable[Track], note: Note, definition: Definition) -> Iterator[Piece]:
    """Each track whole, with its segments."""
    for track in tracks:
        world = track.world or World(np.tile(np.eye(4), (len(track), 1, 1)))
        on_table = World(world.T_world_cam, world.up, None if world.up is None else 0.0)
        placed = replace(track, world=on_table)
        segments = true_segments(known_clip(placed), definition)
        if not any(segment.state == "static" for segment in segments):
            note(f"{track.name}: the object is never static")
        yield Piece(placed, track.name, "a timeline: static, contact and grasp by the true poses", segments=segments)
