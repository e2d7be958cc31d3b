"""What the readers of ARCTIC, HOI4D, HO-3D and HOT3D share: true tracks of a hand and an object, cut into clips.

A reader turns a sequence into ``Track``s. Here a track is cut where it has gaps and where the joint of its object
turns, its stable grasps are found (Eq. 2), and each piece becomes a clip, with masks. At no time is more than one
sequence in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks, Truth
from getagrip.clip.plausible import FARTHEST, NEAREST, check_in_view
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, checked_mesh
from getagrip.geometry.render import Surface, true_masks
from getagrip.grasps.stable import Definition, PairwiseIou, stable_grasps
from getagrip.hands.model import Side
from getagrip.io.files import is_plain_name
from getagrip.metrics.contact import close_holes, moving_distance, stable_contact_area

VISIBLE = 25
"""Pixels of the smallest mask that counts as seen."""
MOST_FRAMES = 20_000
"""Of a sequence: ten times as many as the longest of these datasets has. A hand in all of them takes 0.4 GB."""
BETWEEN = "--"
"""Stands between subject, sequence, object and side in a clip's name."""
Note = Callable[[str], None]
"""Is told in words what is left out."""
MaskPair = tuple[Bool[ndarray, "H W"], Bool[ndarray, "H W"]]
"""Where the object is seen, and what to ignore."""


def check_length(path: Path, key: str, frames: int) -> None:
    """Raise ``InputError`` for more frames than a sequence can have, before memory is taken for them."""
    if frames > MOST_FRAMES:
        raise InputError(path, key, f"{frames} frames", f"at most {MOST_FRAMES}")


@dataclass(frozen=True)
class Track:
    """A hand and an object over some frames of a sequence, where both are, in the camera frame."""

    file: Path
    """What it was read from."""
    subject: str
    """Whose hand it is, as far as the dataset tells."""
    sequence: str
    category: str
    side: Side
    fps: float
    numbers: Int[ndarray, "T"]
    """Numbers of the frames, rising; where some are left out, there is a gap."""
    digits: int
    """Of a frame's number in the dataset's own file names."""
    size: tuple[int, int]
    K: Float[ndarray, "3 3"]
    hand: HandTrack
    T_cam_obj: Float[ndarray, "T 4 4"]
    object: Callable[[float], Mesh]
    """The object with its joint at an angle [rad]; always the same where it has none."""
    provenance: dict[str, str]
    """Where hands, masks, camera and scale come from."""
    articulation: Float[ndarray, "T"] | None = None
    """Angle of the object's joint [rad], where it has one."""
    other_hand: HandTrack | None = None
    """The other hand, which hides and is ignored as well, in the same frames."""
    read_masks: Callable[[int], MaskPair] | None = None
    """The dataset's own masks of the frame of some number; rendered from the true poses where it has none."""

    @property
    def name(self) -> str:
        """What its clips are called, the count left out."""
        return BETWEEN.join([self.subject, self.sequence, self.category, self.side])

    def __len__(self) -> int:
        return len(self.numbers)

    def take(self, index: Int[ndarray, "n"]) -> Track:
        """The track at some of its frames."""

        def of(hand: HandTrack) -> HandTrack:
            joints = None if hand.joints is None else hand.joints[index]
            return replace(hand, vertices=hand.vertices[index], T_cam_hand=hand.T_cam_hand[index], joints=joints)

        return replace(
            self,
            numbers=self.numbers[index],
            hand=of(self.hand),
            T_cam_obj=self.T_cam_obj[index],
            articulation=None if self.articulation is None else self.articulation[index],
            other_hand=None if self.other_hand is None else of(self.other_hand),
        )

    def surface(self, row: int) -> Surface:
        """The object in the camera frame as it was in a frame, its joint included."""
        mesh = self.object(0.0 if self.articulation is None else float(self.articulation[row]))
        return se3.transform(self.T_cam_obj[row], mesh.vertices), mesh.faces


@dataclass(frozen=True)
class Source:
    """A sequence that is yet to be read; it can be sent to another process."""

    name: str
    read: Callable[[Note], Iterable[Track]]
    """Raises ``InputError``."""


@dataclass(frozen=True)
class Piece:
    """A part of a track that becomes a clip."""

    track: Track
    name: str
    """What its clip is called."""
    made_of: str
    """What it is, in words."""
    masks: bool = True


def pieces(tracks: Iterable[Track], note: Note, definition: Definition, whole: bool) -> Iterator[Piece]:
    """The stable grasps of some tracks, or (``whole``) all of each, as far as nothing is missing and no joint turns.

    Whole pieces have no masks: they are for what looks at true poses only, and are many frames long.
    """
    for track in tracks:
        if not is_plain_name(track.name):
            raise InputError(track.file, "", f"the name {track.name!r}", "names that can be part of a folder's")
        number = 0
        for part in without_gaps(track):
            if whole:
                iou, made_of = None, "all frames in which hand and object are known and its joint is still"
            else:
                iou, made_of = contact_iou(part, definition), "a stable grasp"
            same = still(part) if iou is None else iou
            for first, last in stable_grasps(same, definition.tau, definition.shortest, definition.rule):
                number += 1
                if iou is not None:
                    area = stable_contact_area(iou[slice(first, last + 1), slice(first, last + 1)])
                    made_of = (
                        f"a stable grasp: contact IOU above {definition.tau:g} between all pairs of frames, "
                        f"{area:.3f} on average, at {1e3 * definition.contact:g} mm"
                    )
                name = track.name + f"{BETWEEN}{number}" * (number > 1)
                yield Piece(part.take(np.arange(first, last + 1)), name, made_of, masks=not whole)
        if number == 0:
            kind = "no run" if whole else "no stable grasp"
            note(f"{track.name}: {kind} of {definition.shortest} frames: left out")


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
    """The piece as a clip, and its masks; nothing if the object is seen in fewer than ``shortest`` frames.

    Frames in which fewer than ``VISIBLE`` pixels of the object are seen are dropped. The mesh of an object with a joint
    is that at the mean angle: within a piece, it turns by ``grasps.OPENED`` at most. Masks show the object as it was.
    """
    track, masks, dropped = piece.track, None, 0
    if piece.masks:
        rows, masks = _visible(track)
        if len(rows) < shortest:
            note(f"{piece.name}: the object is seen in fewer than {shortest} frames: left out")
            return None
        if len(rows) < len(track):
            dropped, track = len(track) - len(rows), track.take(rows)
    K = np.tile(track.K, (len(track), 1, 1))
    try:
        check_in_view(track.file, track.hand, K, track.size)
    except InputError:
        note(f"{piece.name}: the hand is outside the image in every frame: left out")
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
        provenance=_provenance(piece, track, dropped),
    )
    return made, masks


def _visible(track: Track) -> tuple[Int[ndarray, "n"], Masks]:
    """The frames in which the object is seen, and their masks.

    Those of a long hold before a large camera are gigabytes: they are in a file, which goes with them.
    """
    width, height = track.size
    with TemporaryFile() as file:
        both = np.memmap(file, dtype=bool, mode="w+", shape=(2, len(track), height, width))
    rows: list[int] = []
    for row in range(len(track)):
        seen, ignore = _mask_pair(track, row)
        if np.count_nonzero(seen) >= VISIBLE:
            both[0, len(rows)], both[1, len(rows)] = seen, ignore
            rows.append(row)
    return np.array(rows, dtype=np.int64), Masks(both[0, : len(rows)], both[1, : len(rows)])


def _mask_pair(track: Track, row: int) -> MaskPair:
    """The dataset's own masks of a frame, or those rendered from the true poses."""
    if track.read_masks is not None:
        return track.read_masks(int(track.numbers[row]))
    hands = [
        (se3.transform(hand.T_cam_hand[row], hand.vertices[row]), hand.faces)
        for hand in (track.hand, track.other_hand)
        if hand is not None
    ]
    return true_masks(track.surface(row), hands, [], track.K, track.size)


def _provenance(piece: Piece, track: Track, dropped: int) -> dict[str, Any]:
    out = {"subject": track.subject, **track.provenance, "clip": piece.made_of}
    if piece.masks and track.read_masks is None:
        hands = "hand" if track.other_hand is None else "hands"
        out["masks"] = f"rendered from the true poses, hidden by the {hands}; nothing else is known to be in front"
    if not piece.masks:
        out["masks"] = "none"
    if track.articulation is not None:
        low, high = np.degrees([track.articulation.min(), track.articulation.max()])
        out["articulation"] = (
            f"the joint is between {low:.1f} and {high:.1f} degrees; the mesh has it at the mean, the masks as it was"
        )
    if dropped:
        out["dropped"] = f"{dropped} frames in which the object is not seen"
    return out


def in_pixels(K: Float[ndarray, "3 3"], scale: float = 1.0) -> Float[ndarray, "3 3"]:
    """Intrinsics of an image ``scale`` times as large, from those of OpenCV.

    OpenCV counts from the centre of the first pixel, this package from its corner.
    """
    centred = K.copy()
    centred[:2, 2] += 0.5
    return np.diag([scale, scale, 1.0]) @ centred
