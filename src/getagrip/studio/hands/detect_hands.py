"""Detect the hand of a video without clicks: landmarks, 3D hands and masks, for the page and for ``clip new``.

The folder ``found`` beside the marks holds ``hand.npz``, a hand file whose ``frames`` are numbered from 1 and whose
``joints_2d`` (T, 21, 2) [px] are the landmarks, and ``masks/<number>.png``, non-zero where the hand is visible. Both
are optional when the folder is read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from itertools import takewhile
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.clip.write import write_hand
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands.from_2d.clicks import ASSUMED_SCALE_NOTE
from getagrip.hands.from_2d.landmarks import LIFTED_HANDS_NOTE, hands_from_landmarks
from getagrip.io import arrays, files
from getagrip.io.images import decode_image, write_mask
from getagrip.provenance import Provenance, Source, assumed, estimated, provenance_to_arrays
from getagrip.readers.footage import MAX_FOOTAGE_SIDE_PX, Footage
from getagrip.studio.hands.hand_pixels import hand_mask, skin_colour
from getagrip.studio.hands.hand_selection import HandLandmarks, Side, select_hand, unbiased_log_odds
from getagrip.studio.hands.hand_tracking import Sighting, track_hands
from getagrip.studio.hands.networks import Nets, crop_of_box
from getagrip.studio.hands.redetect import redetect_hand
from getagrip.studio.hands.relift_hands import JOINTS_DEPTH_KEY
from getagrip.studio.masks.box_prompt import MIN_BOX_CORRELATION, MIN_BOX_SIDE_PX, downscale_image, track_box

DETECTED_HANDS_FOLDER = "found"
INPUTS_KEY = "found_by"
"""Key, in a hand file, of the checksum of all that the hands were found by."""
DRAFTS_FOLDER = "drafts"
"""Folder, beside the marks of several videos, of the drafts of each."""
CUT_THUMBNAIL_PX = 24
"""Side of the thumbnails in which cuts are detected [px]."""
SHOT_CUT_THRESHOLDS = (25.0, 0.4)
"""Thresholds of a cut: mean difference of two frames [of 255], and fraction of pixels whose colour changes."""
JUMP_THRESHOLDS = (4.0, 1.0, 5)
"""Thresholds of a jump: difference of two frames as a multiple of the differences before and after, mean difference
[of 255]; number of frames on each side."""
N_BOX_TRACKING_FRAMES, MAX_TRACKING_SIDES_PX = 60, (48.0, 960.0)
"""Number of frames through which the object's box is tracked, and largest sides of box and image in tracking [px]."""
OUTSIDE_CONFIDENCE_FACTOR = 0.25
"""Factor on the confidence of landmarks outside the image."""
REACHING_POSE_SIGMA_RAD = 0.2
"""Standard deviation of each parameter of the fingers' pose from its mean, larger than in a grasp, since the hand also
reaches and lets go [rad]."""


@dataclass(frozen=True)
class HandDetectionFiles:
    """The files of a folder ``found``."""

    folder: Path

    @property
    def path(self) -> Path:
        """The hand file, which may be missing."""
        return self.folder / "hand.npz"

    @cached_property
    def joints(self) -> dict[int, Float[ndarray, "21 2"]]:
        """Joints by frame from 0, NaN where missing [px]. Raises ``InputError`` for a malformed file."""
        if not self.path.is_file():
            return {}
        content = arrays.read(self.path, lambda name: name in ("joints_2d", "frames"))
        frames = arrays.frame_numbers(self.path, content)
        if "joints_2d" not in content or frames is None:
            return {}
        points = content["joints_2d"]
        if points.shape != (len(frames), 21, 2):
            raise InputError(self.path, "joints_2d", f"an array of shape {points.shape}", f"({len(frames)}, 21, 2)")
        seen = np.isfinite(points).all(axis=-1).any(axis=-1)
        return {n - 1: each for n, each, there in zip(frames, points.astype(float), seen, strict=True) if there}

    def mask(self, frame: int) -> Bool[ndarray, "H W"] | None:
        """Return the visible pixels of the hand in a frame, from 0; None without a mask file. Raises ``InputError``."""
        path = self.folder / "masks" / f"{frame + 1:06d}.png"
        if not path.is_file():
            return None
        red, green, blue = np.moveaxis(decode_image(path, "", files.read_bytes(path), MAX_FOOTAGE_SIDE_PX), -1, 0)
        return np.asarray((red | green | blue) != 0)  # numpy is slow on short axes

    @cached_property
    def word(self) -> str:
        """A checksum of the files' names and contents, the same in a copy of the folder; empty without files."""
        masks = self.folder / "masks"
        paths = [self.path, *(sorted(masks.iterdir()) if masks.is_dir() else [])]
        about = [(each.name, sha256(each.read_bytes()).hexdigest()) for each in paths if each.is_file()]
        return sha256(repr(about).encode()).hexdigest()[:16] if about else ""


@dataclass(frozen=True)
class DetectedHands:
    """The hand at the object, in the frames of a video in which it is detected."""

    hand: HandTrack
    side: Side
    frames: tuple[int, ...]
    """Frame numbers from 0."""
    landmarks: dict[int, Float[ndarray, "21 2"]]
    """Joints by frame, for the hand's masks [px]."""
    K: Float[ndarray, "3 3"]
    provenance: Provenance
    """Provenance for a clip."""
    depth: Float[ndarray, "n 21"] | None = None
    """Depth of each joint by the network, up to an offset of each frame [m]."""
    inputs: str = ""
    """Checksum of all that it was found by; empty where that is not known."""


def lift_detected_landmarks(
    landmarks: HandLandmarks, first: int, size: tuple[int, int], K: Float[ndarray, "3 3"], camera: Source
) -> DetectedHands:
    """Lift landmarks of the frames from ``first`` on to 3D hands. Raises as ``hands_from_landmarks`` does."""
    beside = (landmarks.points < 0.0) | (landmarks.points > np.array(size))
    weights = landmarks.confidence * np.where(beside.any(axis=-1), OUTSIDE_CONFIDENCE_FACTOR, 1.0)
    fit = hands_from_landmarks(
        landmarks.points, weights, K, landmarks.side, landmarks.world[..., 2], looseness=REACHING_POSE_SIGMA_RAD
    )
    rows = np.array(fit.rows)
    assert fit.hand.joints is not None
    joints, there = se3.transform(fit.hand.T_cam_hand, fit.hand.joints), weights[rows] > 0.0
    points = np.where(there[..., None], landmarks.points[rows], project(K, joints))  # gaps have no landmarks
    depth = landmarks.world[rows, :, 2]
    depth = np.where((there & np.isfinite(depth)).all(axis=1, keepdims=True), depth, joints[..., 2])
    hand = replace(fit.hand, joints_2d=points, joints_2d_confidence=weights[rows])
    seen = {row + first: landmarks.points[row] for row in landmarks.rows}
    known: Provenance = {
        "hands": estimated("; ".join([f"MediaPipe's landmarks, {LIFTED_HANDS_NOTE}", *landmarks.notes])),
        "hands_side": landmarks.side_source,
        "hands_focal": assumed("from the size of the generic hand and the focal length"),
        "hands_scale": assumed(ASSUMED_SCALE_NOTE),
        "camera": camera,
    }
    return DetectedHands(hand, landmarks.side, tuple((rows + first).tolist()), seen, K, known, depth)


def find_landmarks(
    footage: Footage,
    interval: tuple[int, int],
    nets: Nets,
    side: Side | None = None,
    box: Float[ndarray, "4"] | None = None,
    on_frame: Callable[[int], None] = lambda n: None,
) -> HandLandmarks:
    """Find the hand in the frames of an interval, from 0, both ends included.

    ``box`` is the object's in the first frame (left, top, width, height) [px]; ``on_frame`` is called before each
    frame. Raises ``UsageError`` where no hand is found, or the video is cut within the interval, and ``InputError`` for
    a frame that does not decode.
    """
    (first, last), scale = interval, None
    count = last - first + 1
    if box is not None:
        scale = min(1.0, MAX_TRACKING_SIDES_PX[0] / float(box[2:].max()), MAX_TRACKING_SIDES_PX[1] / max(footage.size))
    shot = _Shot(footage, first, scale)
    seen = track_hands(shot.image, count, nets, on_frame, [] if box is None else [crop_of_box(box)])
    boxes = None if box is None or scale is None else _track_object_box(shot.small, scale, box)

    def image(n: int) -> UInt8[ndarray, "H W 3"]:
        return footage.image(first + n)

    def again(hand: Mapping[int, Sighting], sides: Mapping[int, Side]) -> dict[int, Sighting]:
        return redetect_hand(image, hand, count, nets, sides)

    found = select_hand(seen, side, boxes, first + 1, again, lambda n, hand: unbiased_log_odds(image(n), hand, nets))
    said = [f"the picture jumps before frame {first + n + 1}: are frames missing?" for n in find_jumps(shot.apart)]
    return replace(found, notes=(*found.notes, *said))


def _track_object_box(
    small: Sequence[UInt8[ndarray, "h w 3"]], scale: float, box: Float[ndarray, "4"]
) -> dict[int, Float[ndarray, "4"]]:
    """Track the object's box [px] through reduced frames: of two hands at the object, the one that stays grasps it."""
    size = np.array(small[0].shape[1::-1], dtype=float)
    low, high = (np.clip(scale * corner, 0.0, size) for corner in (box[:2], box[:2] + box[2:]))
    if (high - low).min() < MIN_BOX_SIDE_PX:
        return {0: box}
    seen = (*low.tolist(), *(high - low).tolist())
    boxes = track_box(small.__getitem__, seen, 0, len(small) - 1)
    known = takewhile(lambda each: each[1] >= MIN_BOX_CORRELATION, boxes)
    return {n: np.array(each) / scale for n, (each, _) in enumerate(known)}


@dataclass
class _Shot:
    """The frames of an interval, read in order and checked for cuts."""

    footage: Footage
    first: int
    scale: float | None
    """Factor by which the first frames are reduced into ``small``; None: they are not stored."""
    small: list[UInt8[ndarray, "h w 3"]] = field(default_factory=list)
    newest: int = -1
    before: UInt8[ndarray, "n n 3"] | None = None
    apart: list[float] = field(default_factory=list)
    """Mean difference of each two consecutive frames [of 255]."""

    def image(self, n: int) -> UInt8[ndarray, "H W 3"]:
        """Return a frame of the interval. Raises ``UsageError`` at a cut."""
        at = self.first + n + 1
        try:
            image = self.footage.image(at - 1)
        except InputError as error:
            rest = f"{error.expected}; --interval {self.first + 1} {at - 1} takes the frames before"
            raise InputError(error.path, f"frame {at}", error.got, rest if n > 1 else error.expected) from error
        if n == self.newest + 1:
            now = _thumbnail(image)
            if self.before is not None and is_cut(self.before, now):
                parts = f"--interval {self.first + 1} {at - 1} or --interval {at} LAST"
                raise UsageError(f"{self.footage.name(at - 1)}: the video is cut before this frame: choose {parts}")
            if self.before is not None:
                self.apart.append(float(np.abs(self.before.astype(float) - now).mean()))
            self.newest, self.before = n, now
            if self.scale is not None and n < N_BOX_TRACKING_FRAMES:
                self.small.append(downscale_image(image, self.scale))
        return image


def _thumbnail(image: UInt8[ndarray, "H W 3"]) -> UInt8[ndarray, "n n 3"]:
    import cv2

    return np.asarray(cv2.resize(image, (CUT_THUMBNAIL_PX, CUT_THUMBNAIL_PX), interpolation=cv2.INTER_AREA), np.uint8)


def find_jumps(apart: Sequence[float]) -> list[int]:
    """Return the frames before which the picture jumps, from the differences of each two consecutive frames."""
    times, least, about = JUMP_THRESHOLDS
    out = []
    for n, each in enumerate(apart):
        nearby = [*apart[max(0, n - about) : n], *apart[n + 1 : n + 1 + about]]
        if each > least and each > times * max(nearby, default=each):
            out.append(n + 1)
    return out


def is_cut(one: UInt8[ndarray, "n n 3"], other: UInt8[ndarray, "n n 3"]) -> bool:
    """Return whether two thumbnails are of different shots: both colours and places differ."""
    counts = [np.bincount((each // 32).reshape(-1, 3) @ np.array([64, 8, 1]), minlength=512) for each in (one, other)]
    share = 0.5 * float(np.abs(counts[0] - counts[1]).sum()) / counts[0].sum()
    return float(np.abs(one.astype(float) - other).mean()) > SHOT_CUT_THRESHOLDS[0] and share > SHOT_CUT_THRESHOLDS[1]


def write_detected_hands(
    out: Path, found: DetectedHands, image: Callable[[int], UInt8[ndarray, "H W 3"]], done: Callable[[int], None]
) -> Path:
    """Write the folder ``found`` into ``out``, in place of an older one; return its path.

    Masks are made for frames with landmarks. ``done`` is called with the number of masks written so far.
    """
    folder = files.folder_inside(out) / DETECTED_HANDS_FOLDER
    with files.new_folder(folder, ("hand.npz", "masks") if folder.exists() else ()) as new:
        places = np.array(found.frames) + 1
        extra = {"frames": places, "K": found.K, "side": np.array(found.side), INPUTS_KEY: np.array(found.inputs)}
        extra |= {} if found.depth is None else {JOINTS_DEPTH_KEY: found.depth}
        write_hand(found.hand, new / "hand.npz", extra | provenance_to_arrays(found.provenance))
        (new / "masks").mkdir()
        skin = skin_colour(image, found.landmarks)
        for count, (n, points) in enumerate(found.landmarks.items(), start=1):
            write_mask(new / "masks" / f"{n + 1:06d}.png", hand_mask(image(n), points, skin=skin))
            done(count)
    return folder
