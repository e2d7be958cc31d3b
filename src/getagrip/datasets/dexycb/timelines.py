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
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import World
from getagrip.datasets import ycb
from getagrip.datasets.cutting import clip_of_track
from getagrip.datasets.dataset import Note
from getagrip.datasets.dexycb import recording as files
from getagrip.datasets.tracks import Track, TrackPiece
from getagrip.geometry import se3
from getagrip.grasps.definition import Definition
from getagrip.grasps.states import true_segments

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
        poses.T_cam_obj[int(np.argmax(poses.known))], ycb.read_ycb_mesh(models, recording.grasped).vertices
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
