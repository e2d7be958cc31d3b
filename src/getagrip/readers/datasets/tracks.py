"""True tracks of a hand and an object, which the readers of DexYCB, HOT3D, ARCTIC, HOI4D and HO-3D make of a sequence.

``cutting`` cuts tracks into pieces, and makes each piece a clip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import FrameMasks, HandTrack, Joint, Segment, World
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands.model import Side
from getagrip.io.files import Json, shorten_value
from getagrip.io.terminal import format_count
from getagrip.provenance import Provenance
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.views import Scene, TrackView
from getagrip.stable_grasps.definition import GraspOptions
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR, ListedGrasp

if TYPE_CHECKING:
    from getagrip.geometry.rasterize import Surface

MAX_SEQUENCE_FRAMES = 20_000
"""Maximum number of frames of a sequence: ten times the longest sequence of these datasets, 0.4 GB for a hand."""
GRASPS_WITHIN_10_MM = GraspOptions(contact_mm=10.0)


def check_length(path: Path, key: str, frames: int) -> None:
    """Raise ``InputError`` for sequences that are too long, before memory is taken for them."""
    if frames > MAX_SEQUENCE_FRAMES:
        raise InputError(path, key, f"{frames} frames", f"at most {MAX_SEQUENCE_FRAMES}")


def check_pinhole(path: Path, key: str, K: Float[ndarray, "3 3"], skew: float = 0.0) -> Float[ndarray, "3 3"]:
    """Return pinhole intrinsics; raise ``InputError`` for other matrices, and for more skew than ``skew`` times fx."""
    if not (K[0, 0] > 0 and K[1, 1] > 0 and np.all(K[2] == [0, 0, 1]) and abs(K[0, 1]) <= skew * K[0, 0]):
        raise InputError(path, key, shorten_value(K.tolist()), "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    return K


@dataclass(frozen=True)
class Track:
    """A hand and an object in the camera frame, in the frames of a sequence in which both are known."""

    file: Path
    """The file that was read."""
    subject: str
    """The person, as far as the dataset says."""
    sequence: str
    category: str
    side: Side
    fps: float
    numbers: Int[ndarray, "T"]
    """Numbers of the frames, rising; missing numbers are gaps."""
    digits: int
    """Number of digits of frame numbers in the dataset's file names."""
    size: tuple[int, int]
    """Width and height of the images [px]."""
    K: Float[ndarray, "3 3"]
    """Pinhole intrinsics [px]."""
    hand: HandTrack
    T_cam_obj: Float[ndarray, "T 4 4"]
    mesh: Mesh
    """The object, at ``joint.angle`` if articulated."""
    provenance: Provenance
    """Sources of hands, masks, camera and scale."""
    joint: Joint | None = None
    articulation: Float[ndarray, "T"] | None = None
    """Angle of the joint [rad]."""
    origin: int = 0
    """Number of the sequence's first frame, from which lists of grasps count."""
    other_hand: HandTrack | None = None
    """The other hand in the same frames: an occluder, ignored as well."""
    input_hand: HandTrack | None = None
    """The hand as an estimator has it: the clips' input hand, with ``hand`` as their ground truth."""
    read_masks: Callable[[int], FrameMasks] | None = None
    """Read the dataset's own masks of a frame, by its number; None if masks are rendered from the true poses."""
    beside: Callable[[int], tuple[list[Surface], list[Surface]]] | None = None
    """Pose further hands, and other objects, in the camera frame in a frame, by its number; None without any."""
    covered: Bool[ndarray, "H W"] | None = None
    """Pixels inside the image of the camera's lens; None: all."""
    views: tuple[TrackView, ...] = ()
    """Further cameras."""
    world: World | None = None
    """Camera poses, if the dataset has them."""
    stamps: Float[ndarray, "T"] | None = None
    """Times of the frames [s], if the dataset has them."""

    @property
    def name(self) -> str:
        """Name of the track's clips, without their number."""
        return CLIP_NAME_SEPARATOR.join([self.subject, self.sequence, self.category, self.side])

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the frames."""
        return tuple(f"{n:0{self.digits}d}" for n in self.numbers)

    @property
    def times(self) -> Float[ndarray, "T"]:
        """Times of the frames [s]: the stamps, or by the numbers since the sequence's first frame."""
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
            views=tuple(view.take(index) for view in self.views),
        )

    def object(self, angle: float) -> Mesh:
        """Return the object with its joint at an angle [rad], which rigid objects ignore."""
        if self.joint is None:
            return self.mesh
        return Mesh(self.joint.at(self.mesh.vertices, np.array([angle]))[0], self.mesh.faces)

    def surface(self, row: int) -> Surface:
        """Return the articulated object in the camera frame, in one frame."""
        mesh = self.object(0.0 if self.articulation is None else float(self.articulation[row]))
        return se3.transform(self.T_cam_obj[row], mesh.vertices), mesh.faces

    def scene(self, row: int) -> Scene:
        """Return the surfaces of one frame in the camera frame."""
        known = [hand for hand in (self.hand, self.other_hand) if hand is not None]
        hands = [(se3.transform(hand.T_cam_hand[row], hand.vertices[row]), hand.faces) for hand in known]
        further, others = ([], []) if self.beside is None else self.beside(int(self.numbers[row]))
        return Scene(self.surface(row), [*hands, *further], others)

    def masks(self, row: int) -> FrameMasks:
        """Read the dataset's own masks of a frame, or render those of the true poses."""
        if self.read_masks is not None:
            return self.read_masks(int(self.numbers[row]))
        return self.scene(row).masks(self.K, self.size, self.covered)

    def describe(self, piece: TrackPiece) -> Json:
        """Return the provenance of a piece's clip; this track has the kept frames of the piece."""
        out = {"subject": self.subject, **self.provenance, "clip": piece.made_of}
        if piece.masks and self.read_masks is None and self.beside is None:
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
    """Name of the clip."""
    made_of: str
    """Description of the piece, in words."""
    grasp: ListedGrasp | None = None
    """Grasp in the list beside the clips; None for other pieces."""
    stable_area: str = ""
    """For a grasp found by contact: mean contact IOU over all pairs of frames, and the contact distance."""
    masks: bool = True
    segments: tuple[Segment, ...] = ()
    """Segments of a timeline."""
    other: Track | None = None
    """For a timeline, the track of the object with the other hand."""


@dataclass(frozen=True)
class SequenceSource:
    """A sequence with the function that reads its tracks, which raises ``InputError``. Picklable."""

    name: str
    read: Callable[[Note], Iterable[Track]]


def subject_from_clip_name(clip_name: str) -> str:
    """Return the person in a clip's name. Raises ``UsageError`` for names of other clips."""
    subject, between, rest = clip_name.partition(CLIP_NAME_SEPARATOR)
    if not (subject and between and rest):
        form = CLIP_NAME_SEPARATOR.join(["<subject>", "<sequence>", "<object>..."])
        raise UsageError(f"clip's name must be {form} (got {clip_name!r})")
    return subject


def is_clip_of_sequence(clip_name: str, subject: str, sequence: str) -> bool:
    """Return whether a clip's name is that of a track of a sequence."""
    return clip_name.startswith(CLIP_NAME_SEPARATOR.join([subject, sequence, ""]))


def intrinsics_from_opencv(K: Float[ndarray, "3 3"], scale: float = 1.0) -> Float[ndarray, "3 3"]:
    """Convert OpenCV's intrinsics to an image ``scale`` times as large.

    OpenCV's origin is the centre of the first pixel, this package's its corner.
    """
    centred = K.copy()
    centred[:2, 2] += 0.5
    return np.diag([scale, scale, 1.0]) @ centred
