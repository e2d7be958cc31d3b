"""True tracks of a hand and an object: what the readers of DexYCB, HOT3D, ARCTIC, HOI4D and HO-3D make of a sequence.

``cutting`` cuts tracks into pieces, and makes each piece a clip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import FrameMasks, HandTrack, Joint, Segment, World
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands.model import Side
from getagrip.io.files import Json
from getagrip.io.terminal import format_count
from getagrip.provenance import Provenance
from getagrip.readers.datasets.dataset import Note
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR, ListedGrasp

if TYPE_CHECKING:
    from getagrip.geometry.rasterize import Surface

MAX_SEQUENCE_FRAMES = 20_000
"""Most frames of a sequence: ten times as many as the longest of these datasets has. A hand in all of them takes 0.4
GB."""


def check_length(path: Path, key: str, frames: int) -> None:
    """Raise ``InputError`` for more frames than a sequence can have, before memory is taken for them."""
    if frames > MAX_SEQUENCE_FRAMES:
        raise InputError(path, key, f"{frames} frames", f"at most {MAX_SEQUENCE_FRAMES}")


@dataclass(frozen=True)
class Track:
    """A hand and an object over some frames of a sequence, where both are, in the camera frame."""

    file: Path
    """File that it was read from."""
    subject: str
    """Whose hand it is, as far as the dataset says."""
    sequence: str
    category: str
    side: Side
    fps: float
    numbers: Int[ndarray, "T"]
    """Numbers of the frames, rising; where some are missing, there is a gap."""
    digits: int
    """Number of digits of a frame's number in the dataset's own file names."""
    size: tuple[int, int]
    """Width and height of the images [px]."""
    K: Float[ndarray, "3 3"]
    """Pinhole intrinsics [px]."""
    hand: HandTrack
    T_cam_obj: Float[ndarray, "T 4 4"]
    mesh: Mesh
    """The object; where it has a joint, at ``joint.angle``."""
    provenance: Provenance
    """Sources of hands, masks, camera and scale."""
    joint: Joint | None = None
    """Joint of the object, where it has one."""
    articulation: Float[ndarray, "T"] | None = None
    """Angle of the joint [rad]."""
    origin: int = 0
    """Number of the sequence's first frame, by which lists of grasps count."""
    other_hand: HandTrack | None = None
    """The other hand, which hides and is ignored as well, in the same frames."""
    input_hand: HandTrack | None = None
    """The hand as an estimator has it: its clips are given that one, and ``hand`` is their ground truth."""
    read_masks: Callable[[int], FrameMasks] | None = None
    """The dataset's own masks of the frame of some number; rendered from the true poses where it has none."""
    world: World | None = None
    """Camera poses, if the dataset has them."""
    stamps: Float[ndarray, "T"] | None = None
    """Times of the frames [s], where the dataset has them."""

    @property
    def name(self) -> str:
        """Name of its clips, without the count."""
        return CLIP_NAME_SEPARATOR.join([self.subject, self.sequence, self.category, self.side])

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the frames."""
        return tuple(f"{n:0{self.digits}d}" for n in self.numbers)

    @property
    def times(self) -> Float[ndarray, "T"]:
        """When each frame was taken [s]: as stamped, or by the numbers since the sequence's first frame."""
        return (self.numbers - self.origin) / self.fps if self.stamps is None else self.stamps

    def __len__(self) -> int:
        return len(self.numbers)

    def take(self, index: Int[ndarray, "n"]) -> Self:
        """Return the track at some of its frames."""
        return replace(
            self,
            numbers=self.numbers[index],
            hand=self.hand.take(index),
            T_cam_obj=self.T_cam_obj[index],
            articulation=None if self.articulation is None else self.articulation[index],
            other_hand=self.other_hand and self.other_hand.take(index),
            world=self.world and self.world.take(index),
            stamps=None if self.stamps is None else self.stamps[index],
            input_hand=self.input_hand and self.input_hand.take(index),
        )

    def object(self, angle: float) -> Mesh:
        """Return the object with its joint at an angle [rad]; always the same where it has none."""
        if self.joint is None:
            return self.mesh
        return Mesh(self.joint.at(self.mesh.vertices, np.array([angle]))[0], self.mesh.faces)

    def surface(self, row: int) -> Surface:
        """Return the object in the camera frame in one frame, its joint included."""
        mesh = self.object(0.0 if self.articulation is None else float(self.articulation[row]))
        return se3.transform(self.T_cam_obj[row], mesh.vertices), mesh.faces

    def describe(self, piece: TrackPiece) -> Json:
        """Return the provenance of a piece's clip; this track has the frames of the piece that were kept."""
        out = {"subject": self.subject, **self.provenance, "clip": piece.made_of}
        if piece.masks and self.read_masks is None:
            hands = "hand" if self.other_hand is None else "hands"
            out["masks"] = f"rendered from the true poses, hidden by the {hands}; nothing else is known to be in front"
        if not piece.masks:
            out["masks"] = "none"
        if self.articulation is not None:
            low, high = np.degrees([self.articulation.min(), self.articulation.max()])
            angles = f"between {low:.1f} and {high:.1f} degrees"
            out["articulation"] = f"the joint is {angles}; the mesh has it at the mean, the masks as it was"
        if len(self) < len(piece.track):
            out["dropped"] = f"{format_count(len(piece.track) - len(self), 'frame')} in which the object is not visible"
        return out


@dataclass(frozen=True)
class TrackPiece:
    """A part of a track that becomes a clip."""

    track: Track
    name: str
    """Name of its clip."""
    made_of: str
    """Description, in words."""
    grasp: ListedGrasp | None = None
    """Grasp in the list beside the clips; None for other pieces."""
    stable_area: str = ""
    """For a grasp that was found: mean contact IOU over all pairs of its frames, and the contact's distance."""
    masks: bool = True
    segments: tuple[Segment, ...] = ()
    """Segments of a timeline."""
    other: Track | None = None
    """For a timeline, the object with the hand of the other side, in the frames in which that is known."""


@dataclass(frozen=True)
class SequenceSource:
    """A sequence that is yet to be read; it can be sent to another process."""

    name: str
    read: Callable[[Note], Iterable[Track]]
    """Read a hand file; raise ``InputError`` for a malformed one."""


def subject_from_clip_name(clip_name: str) -> str:
    """Return the person whose hand is in a clip. Raises ``UsageError`` for a name that no track has."""
    subject, between, rest = clip_name.partition(CLIP_NAME_SEPARATOR)
    if not (subject and between and rest):
        raise UsageError(
            f"clip's name must be <subject>{CLIP_NAME_SEPARATOR}<sequence>{CLIP_NAME_SEPARATOR}<object>... (got {clip_name!r})"
        )
    return subject


def intrinsics_from_opencv(K: Float[ndarray, "3 3"], scale: float = 1.0) -> Float[ndarray, "3 3"]:
    """Convert OpenCV's intrinsics to those of an image ``scale`` times as large.

    OpenCV counts from the centre of the first pixel, this package from its corner.
    """
    centred = K.copy()
    centred[:2, 2] += 0.5
    return np.diag([scale, scale, 1.0]) @ centred
