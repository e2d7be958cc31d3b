"""Tracks cut into clips: where they have gaps, where the joint of an object turns, and to stable grasps (Eq. 2).

At no time is more than one sequence in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Int
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.clip import Clip, Masks, Truth
from getagrip.clip.plausible import FARTHEST, NEAREST, check_in_view
from getagrip.datasets.dataset import Dataset, Draft, Missing, Note, Part
from getagrip.datasets.tracks import BETWEEN, MaskPair, Piece, Source, Track
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import checked_mesh
from getagrip.grasps.stable import Definition, PairwiseIou, stable_grasps
from getagrip.io.arguments import Flag
from getagrip.io.files import is_plain_name
from getagrip.metrics.contact import close_holes, moving_distance, stable_contact_area

VISIBLE = 25
"""Pixels of the smallest mask that counts as visible."""
WHOLE = "all frames in which hand and object are known and its joint is still"
Cut = Callable[[Iterable[Track], Note], Iterator[Piece]]
"""How tracks become the pieces that clips are made of."""


@dataclass(frozen=True, kw_only=True)
class TrackedDataset(Dataset):
    """A dataset with true tracks of hands and objects."""

    definition: ClassVar[Definition]
    """What counts as a stable grasp."""

    root: Annotated[Positional[Path], arg(metavar="ROOT")]
    """The folder that holds it, as it came."""
    whole: Flag = False
    """Not the grasps but all frames, without masks: for segment and study."""

    def sources(self) -> list[Source]:
        """Its sequences. Raises ``UsageError`` for wrong options, ``InputError`` where there is no sequence."""
        raise NotImplementedError

    def parts(self, note: Note) -> Sequence[Part]:
        """Its sequences, cut to stable grasps or, if ``whole``, at gaps only."""
        cut = partial(pieces, definition=self.definition, whole=self.whole)
        return [CutSource(source, cut, self.definition.shortest) for source in self.sources()]


@dataclass(frozen=True)
class CutSource:
    """A sequence, and how it is cut into clips."""

    source: Source
    cut: Cut
    shortest: int
    """The fewest frames of a clip."""

    @property
    def name(self) -> str:
        """The sequence's."""
        return self.source.name

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        """A clip for each piece."""
        for piece in self.cut(self.source.read(note), note):
            if missing(piece.name):
                yield Draft(piece.name, partial(clip, piece, self.shortest, note))


def pieces(tracks: Iterable[Track], note: Note, definition: Definition, whole: bool) -> Iterator[Piece]:
    """The stable grasps of some tracks, or (``whole``) all of each, as far as nothing is missing and no joint turns.

    Whole pieces have no masks: they are for what looks at true poses only, and are many frames long.
    """
    for track in tracks:
        if not is_plain_name(track.name):
            raise InputError(track.file, "", f"the name {track.name!r}", "names that can be part of a folder's")
        number = 0
        for part in without_gaps(track):
            iou = still(part) if whole else contact_iou(part, definition)
            for first, last in stable_grasps(iou, definition.tau, definition.shortest, definition.rule):
                number += 1
                name = track.name + f"{BETWEEN}{number}" * (number > 1)
                taken = part.take(np.arange(first, last + 1))
                if whole:
                    yield Piece(taken, name, WHOLE, masks=False)
                    continue
                area = stable_contact_area(iou[slice(first, last + 1), slice(first, last + 1)])
                made_of = (
                    f"a stable grasp: contact IOU above {definition.tau:g} between all pairs of frames, "
                    f"{area:.3f} on average, at {1e3 * definition.contact:g} mm"
                )
                yield Piece(taken, name, made_of, area)
        if number == 0:
            kind = "no run" if whole else "no stable grasp"
            note(f"{track.name}: {kind} of {definition.shortest} frames: skipped")


def without_gaps(track: Track) -> list[Track]:
    """The parts of a track whose frames follow each other, hand and object before the camera in all of them."""
    ahead = np.ones(len(track), dtype=bool)
    for centre in (
        se3.transform(track.hand.T_cam_hand, track.hand.vertices.mean(axis=1)[:, None])[:, 0],
        se3.transform(track.T_cam_obj, track.object(0.0).centre[None])[:, 0],
    ):
        ahead &= (centre[:, 2] > NEAREST) & (np.linalg.norm(centre, axis=1) < FARTHEST)
    rows = np.flatnonzero(ahead)
    breaks = np.flatnonzero(np.diff(track.numbers[rows]) != 1) + 1
    return [track.take(part) for part in np.split(rows, breaks) if part.size]


def still(track: Track) -> PairwiseIou:
    """1 for frames between which the object's joint has turned by no more than ``grasps.OPENED``, else 0."""
    return PairwiseIou.of(np.ones((len(track), 1), dtype=bool), articulation=track.articulation)


def contact_iou(track: Track, definition: Definition) -> PairwiseIou:
    """Contact IOU of all pairs of frames, 0 where the object's joint has turned in between.

    In contact are the vertices of the object, its joint as it was, within ``definition.contact`` of the hand.
    """
    points = np.stack([track.surface(row)[0] for row in range(len(track))])
    in_hand = se3.transform(se3.inverse(track.hand.T_cam_hand), points)
    distance = moving_distance(in_hand, *close_holes(track.hand.vertices, track.hand.faces), definition.contact)
    return PairwiseIou.of(distance <= definition.contact, articulation=track.articulation)


def clip(piece: Piece, shortest: int, note: Note) -> tuple[Clip, Masks | None] | None:
    """The piece as a clip, and its masks; nothing if the object is visible in fewer than ``shortest`` frames.

    Frames in which fewer than ``VISIBLE`` pixels of the object are visible are dropped. The mesh of an object with a
    joint is that at the mean angle: within a piece, it turns by ``grasps.OPENED`` at most. Masks show it as it was.
    """
    track, masks = piece.track, None
    if piece.masks:
        rows, masks = _visible(track)
        if len(rows) < shortest:
            note(f"{piece.name}: the object is visible in fewer than {shortest} frames: skipped")
            return None
        if len(rows) < len(track):
            track = track.take(rows)
    K = np.tile(track.K, (len(track), 1, 1))
    try:
        check_in_view(track.file, track.hand, K, track.size)
    except InputError:
        note(f"{piece.name}: the hand is outside the image in every frame: skipped")
        return None
    mesh = track.object(0.0 if track.articulation is None else float(track.articulation.mean()))
    made = Clip(
        name=piece.name,
        category=track.category,
        side=track.side,
        fps=track.fps,
        frames=tuple(f"{n:0{track.digits}d}" for n in track.numbers),
        size=track.size,
        K=K,
        mesh=checked_mesh(track.file, mesh.vertices, mesh.faces),
        scale="known",
        hand=track.hand,
        truth=Truth(track.T_cam_obj, 1.0, track.hand.T_cam_hand, track.hand.vertices, track.articulation),
        provenance=track.describe(piece),
    )
    return made, masks


def _visible(track: Track) -> tuple[Int[ndarray, "n"], Masks]:
    """The frames in which the object is visible, and their masks.

    Those of a long hold before a large camera are gigabytes: they are in a file, which goes with them.
    """
    width, height = track.size
    with TemporaryFile() as file:
        both = np.memmap(file, dtype=bool, mode="w+", shape=(2, len(track), height, width))
    rows: list[int] = []
    for row in range(len(track)):
        visible, ignore = _mask_pair(track, row)
        if np.count_nonzero(visible) >= VISIBLE:
            both[0, len(rows)], both[1, len(rows)] = visible, ignore
            rows.append(row)
    return np.array(rows, dtype=np.int64), Masks(both[0, : len(rows)], both[1, : len(rows)])


def _mask_pair(track: Track, row: int) -> MaskPair:
    """The dataset's own masks of a frame, or those rendered from the true poses."""
    if track.read_masks is not None:
        return track.read_masks(int(track.numbers[row]))
    from getagrip.geometry.render import true_masks  # loads numba

    hands = [
        (se3.transform(hand.T_cam_hand[row], hand.vertices[row]), hand.faces)
        for hand in (track.hand, track.other_hand)
        if hand is not None
    ]
    return true_masks(track.surface(row), hands, [], track.K, track.size)
