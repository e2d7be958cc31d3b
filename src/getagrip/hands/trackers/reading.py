"""Estimators' files to ``Estimates``: which hand, in which frame, before which camera."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.clip.naming import frame_of
from getagrip.clip.plausible import check_in_hand, check_poses
from getagrip.errors import InputError, UsageError
from getagrip.hands.fit import JointOrder
from getagrip.hands.model import Side
from getagrip.hands.trackers import frankmocap, hamer, hawor, plain, records
from getagrip.hands.trackers.estimates import Camera, Estimates, NamedHand, Seen
from getagrip.hands.trackers.hand import fitted, load_mano, track
from getagrip.io import files

Source = Literal["hamer", "wilor", "hawor", "frankmocap", "mano", "joints"]
SOURCES: tuple[Source, ...] = ("hamer", "wilor", "hawor", "frankmocap", "mano", "joints")
NAMES = {"hamer": "HaMeR", "wilor": "WiLoR", "hawor": "HaWoR", "frankmocap": "FrankMocap"}


@dataclass(frozen=True)
class Reading:
    """What the files themselves do not say."""

    side: Side
    frames: tuple[str, ...]
    """Names of the clip's frames."""
    K: Float[ndarray, "T 3 3"]
    """The clip's intrinsics in each of them [px]."""
    size: tuple[int, int]
    """Width and height of the clip's images [px]."""
    mano: Path | None = None
    """Folder of the user's MANO files."""
    pose: plain.Encoding | None = None
    """mano: what ``hand_pose`` holds."""
    mean: plain.Mean | None = None
    """mano: what poses are relative to."""
    order: JointOrder | None = None
    """joints: their order."""
    focal: float | None = None
    """hawor: the focal length that it was run with [px]."""
    first: int = 1
    """hawor: number of the first image that it was run on, which it calls 0."""

    def camera(self, frame: int) -> Camera:
        """The camera in a frame."""
        return Camera(self.K[frame], self.size)


@dataclass(frozen=True)
class Hands:
    """The hand in the frames in which it was seen, and where it comes from."""

    track: HandTrack
    found: tuple[int, ...]
    """These frames, as indices into those of ``Reading``."""
    provenance: dict[str, str]


def read(paths: Sequence[Path], source: Source, reading: Reading) -> Hands:
    """The hand of one side in some frames of a clip. Files of other frames are passed over.

    Raises ``InputError`` for files that are missing, malformed, hostile or tell of no such hand, ``UsageError`` for
    what the source needs to be told and is not.
    """
    if source == "joints":
        return _joints(paths, reading)
    mean = frankmocap.mean_pose(reading.mano, reading.side) if source == "frankmocap" else np.zeros(45)
    hands: list[NamedHand] = []
    depths: Counter[str] = Counter()
    for path, record, frame in _rows(paths, source, reading):
        seen, depth = _seen(path, record, source, reading, frame, mean)
        hands.append(NamedHand(path, reading.frames[frame], seen))
        depths[depth] += 1
    if source == "mano":
        hands, depths = _plain(paths, reading), Counter({"transl, as the file has it": 1})
    if not hands:
        raise InputError(paths[0], "", f"no {reading.side} hand in the clip's frames", f"one; {_frames_are(reading)}")
    _each_once(hands)
    index = {name: n for n, name in enumerate(reading.frames)}
    hands.sort(key=lambda hand: index[hand.frame])
    estimates = Estimates(reading.side, tuple(hands), "own" if source == "mano" else "mirrored")
    made, what = track(estimates, reading.mano)
    path = estimates.hands[0].path
    check_in_hand(path, "betas", made.vertices, "a hand")
    check_poses(path, "T_cam_hand", made.T_cam_hand, made.vertices.mean(axis=1), "the hand")
    name = NAMES.get(source, "MANO parameters")
    size = "MANO's shape parameters, as estimated" if reading.mano else "the estimator's joints, or the mean hand"
    if source == "frankmocap":
        size = "the mean hand"
    provenance = {
        "hands": f"{name}: {what}",
        "hands_focal": "; ".join(depths) + _guess(source),
        "hands_scale": f"{size}; one camera tells neither the size nor the depth of a hand",
    }
    return Hands(made, tuple(index[hand.frame] for hand in hands), provenance)


def _guess(source: Source) -> str:
    """A warning where nobody can tell with what focal length numbers were made."""
    return "; that the file was made with the clip's focal length is a guess" if source == "mano" else ""


def _joints(paths: Sequence[Path], reading: Reading) -> Hands:
    """The generic hand fitted to joints."""
    if reading.order is None:
        raise UsageError("--order: got nothing, expected openpose or ho3d: the order of the joints is in no file")
    path = _only(paths, "joints")
    record = records.read(path)
    values = plain.joints(path, record, reading.order)
    found = _named(path, record, len(values), reading)
    rows = [n for n, frame in enumerate(found) if frame is not None]
    if not rows:
        given = f"hands in other frames ({files.plain(str(np.asarray(record['frames'])[0]))}, ...)"
        named = " to ".join(files.plain(frame) for frame in (reading.frames[0], reading.frames[-1]))
        raise InputError(path, "frames", given, f"hands in the clip's, {named}")
    made, what = fitted(path, reading.side, values[rows])
    provenance = {
        "hands": f"joints from a file: {what}",
        "hands_focal": "joints before the camera, as the file has them; that it was the clip's camera is a guess",
        "hands_scale": "the joints, as the file has them",
    }
    return Hands(made, tuple(frame for frame in found if frame is not None), provenance)


def _plain(paths: Sequence[Path], reading: Reading) -> list[NamedHand]:
    """The hands of a file of MANO parameters."""
    if reading.pose is None or reading.mean is None:
        missing = "--pose" if reading.pose is None else "--mean"
        choices = "axis-angle, pca or matrix" if reading.pose is None else "flat or mean"
        raise UsageError(f"{missing}: got nothing, expected {choices}: what MANO's pose numbers are is in no file")
    path = _only(paths, "parameters")
    record = records.read(path)
    model = load_mano(reading.mano, reading.side)
    seen = plain.parameters(path, record, reading.pose, reading.mean, model)
    found = _named(path, record, len(seen), reading)
    return [
        NamedHand(path, reading.frames[frame], hand)
        for frame, hand in zip(found, seen, strict=True)
        if frame is not None
    ]


def _rows(paths: Sequence[Path], source: Source, reading: Reading) -> Iterator[tuple[Path, records.Record, int]]:
    """The records of the wanted hand and the frames that they are of."""
    if source == "mano":
        return
    for path in paths:
        if source == "hawor":
            record = records.read(path)
            T = hawor.length(path, record)
            for n, frame in enumerate(_named(path, record, T, reading, first_and_last=True)):
                if frame is not None:
                    yield path, hawor.row(path, record, n, T), frame
            continue
        frame = frame_of(path.stem, reading.frames)
        if frame is None:
            continue
        record = records.read(path)
        chosen = frankmocap.of_side if source == "frankmocap" else hamer.of_side
        hand = chosen(path, record, reading.side)
        if hand is not None:
            yield path, hand, frame


def _seen(
    path: Path, record: records.Record, source: Source, reading: Reading, frame: int, mean: Float[ndarray, "45"]
) -> tuple[Seen, str]:
    camera = reading.camera(frame)
    if source == "frankmocap":
        return frankmocap.seen(path, record, camera, mean)
    if source == "hawor":
        if reading.focal is None:
            raise UsageError("--estimator-focal: got nothing, expected the focal length that HaWoR was run with [px]")
        return hawor.seen(path, record, camera, reading.focal)
    return hamer.seen(path, record, reading.side, camera)


def _named(
    path: Path, record: records.Record, count: int, reading: Reading, first_and_last: bool = False
) -> list[int | None]:
    """Which of the clip's frames each row of a file is of; None for frames that the clip does not have.

    ``frames`` in the file tells; else the file's own name (HaWoR's ``<first>_<last>``, counted from 0); else the rows
    are the clip's.
    """
    if "frames" in record:
        names = np.asarray(record["frames"])
        if names.dtype.kind not in "Uiu" or names.shape != (count,):
            raise InputError(path, "frames", files.shown(record["frames"]), f"{count} names or numbers of frames")
        return [frame_of(str(name), reading.frames) for name in names]
    if first_and_last and (found := re.fullmatch(r"(\d{1,9})_(\d{1,9})", path.stem)):
        first, last = int(found[1]), int(found[2])
        if last - first + 1 != count:
            raise InputError(path, "init_trans", f"{count} frames", f"{last - first + 1}, as the file's name says")
        return [frame_of(str(n + reading.first), reading.frames) for n in range(first, last + 1)]
    if count != len(reading.frames):
        expected = f"{len(reading.frames)} as the clip has, or an array frames with their names"
        raise InputError(path, "frames", f"{count} hands and no names of frames", expected)
    return list(range(count))


def _each_once(hands: Sequence[NamedHand]) -> None:
    twice = next((name for name, count in Counter(hand.frame for hand in hands).items() if count > 1), None)
    if twice is not None:
        last = next(hand for hand in reversed(hands) if hand.frame == twice)
        raise InputError(last.path, "", f"a second hand in frame {twice}", "one; leave out other people's")


def _only(paths: Sequence[Path], what: str) -> Path:
    if len(paths) != 1:
        raise UsageError(f"FILE: got {len(paths)} files, expected one, with the {what} of all frames")
    return paths[0]


def _frames_are(reading: Reading) -> str:
    return f"files are named like its frames, {files.plain(reading.frames[0])} to {files.plain(reading.frames[-1])}"
