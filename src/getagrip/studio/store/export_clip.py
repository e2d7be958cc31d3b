"""From a person's labels to what ``getagrip clip new`` takes: a hand file, and a folder of masks.

The footage of a file of labels, recognised by its checksum or, without one, by its name.
"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.clip.intrinsics import compute_intrinsics
from getagrip.clip.match_frames import number_of
from getagrip.clip.write import write_hand
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import Lens
from getagrip.geometry.rasterize import render_coverage
from getagrip.hands.from_2d.clicks import ASSUMED_SCALE_NOTE, ClickedHands, hands_from_clicks
from getagrip.io import arrays, files
from getagrip.io.images import write_image
from getagrip.provenance import Source, assumed, estimated, provenance_to_arrays
from getagrip.studio.hands.detect_hands import HandDetectionFiles
from getagrip.studio.hands.relift_hands import LabelMaps, write_relifted_hands
from getagrip.studio.hands.stabilize_hands import stabilize_hands
from getagrip.studio.masks.propagate_clip import propagate_labels
from getagrip.studio.masks.stroke_prompt import keyframe_label_maps
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, Labels
from getagrip.studio.store.tasks import Task


def footage_checksum(path: Path) -> str:
    """Compute the checksum of a video file; of a folder of images, that of their names and contents.

    Raises ``OSError``.
    """
    found = files.list_files(path) if path.is_dir() else [path]
    return _cached_checksum(
        tuple((each, each.stat().st_size, each.stat().st_mtime_ns) for each in found), path.is_dir()
    )


@lru_cache(maxsize=8)
def _cached_checksum(known: tuple[tuple[Path, int, int], ...], folder: bool) -> str:
    """Return the checksum of files whose sizes and times are unchanged."""
    total = hashlib.sha256()
    for path, size, _ in known:
        if folder:
            total.update(f"{path.name}\0{size}\0".encode())
        with path.open("rb") as stream:
            while part := stream.read(2**20):
                total.update(part)
    return total.hexdigest()


def tasks_of_labels(labels: Labels, tasks: Sequence[Task]) -> list[Task]:
    """Return the tasks whose footage the labels are of, whatever its name is now; that of their name is tried first.

    Raises ``RefusedError`` where there is none.
    """
    there = [(task, task.path) for task in tasks if task.path is not None]
    named = [(task, path) for task, path in there if path.name == labels.video]
    name = files.printable(labels.video)
    if not labels.sha256:
        if not named:
            raise RefusedError(
                f"video must be the name of a video that is given here (got {name} and no checksum of it)"
            )
        return [task for task, _ in named]
    for some in (named, there):
        same = [task for task, path in some if footage_checksum(path) == labels.sha256]
        if same:
            return same
    if named:
        raise RefusedError(
            f"sha256: {name} here is another file than the one that was labelled; if its frames are the same ones, "
            "take the key sha256 out of the labels"
        )
    raise RefusedError(f"missing footage of {name}: none has this name or checksum")


HAND_MARGIN_M = 0.004
"""The fitted hand is so far off its true silhouette: pixels beside it say nothing either [m]."""
HAND_MARGIN_FRACTION = 1 / 400
"""Pixels so near to the mask of a hand that was found say nothing, as a share of the image's longer side."""


@dataclass(frozen=True)
class ClipFiles:
    """The files made of labels."""

    hands: ClickedHands | None
    """None where those that were found are lifted again."""
    confidence: dict[int, float]
    """Confidence of the mask of each frame, 1 where it was drawn; see ``propagated_masks``."""
    command: str
    """Command that makes a clip of it, but for the object's mesh."""


def write_labelled_clip_files(
    labels: Labels,
    image: Callable[[int], UInt8[ndarray, "H W 3"]],
    lens: Lens,
    out: Path,
    overwrite: bool = False,
    done: Callable[[int], None] = lambda _: None,
    found: HandDetectionFiles | None = None,
    name: Callable[[int], str] = lambda n: f"{n + 1:06d}",
) -> ClipFiles:
    """Write ``out/hand.npz`` and ``out/masks/<name>.png``: ``OBJECT_LABEL``, ``HAND_LABEL``, ``OCCLUDER_LABEL`` for what hides it or may.

    Frames in which the object is lost get no mask: it is unknown.

    The hand is fitted to the joints that were clicked; where none were, that which was ``found`` is lifted again.

    ``image`` gives the footage's frames, from 0, and ``name`` their names in a clip. Where the lens is a guess, or
    nothing is known of it, the files say that depth and size are guesses, too. ``done`` is called with the number
    of masks that are written. Raises ``UsageError`` for labels that do not suffice, for names without a number of
    their own, and where ``out`` exists and is not to be replaced, or is not what this made before.
    """
    K, camera = compute_intrinsics(lens if lens.is_set else Lens(guess_focal=True), labels.size)
    numbers = _numbers_of_names(name, labels.first, labels.last)
    seen = _no_hand_mask if found is None else found.mask
    hands = None
    if labels.clicks or found is None or not found.path.is_file():
        clicked = hands_from_clicks(labels.clicks, K, labels.side, labels.first, labels.last)
        hands = stabilize_hands(clicked, labels.first, K, labels.size, image)
    confidence = {}
    with files.new_folder(out, ("hand.npz", "masks") if overwrite else ()) as new:
        (new / "masks").mkdir()
        drawn, maps = keyframe_label_maps(labels, image, seen), LabelMaps(labels.size)
        for n, mask, sure in propagate_labels(image, drawn, labels.first, labels.last, hand=seen):
            whole = (
                occlude_hand_border(mask) if hands is None else occlude_fitted_hand(mask, hands, n - labels.first, K)
            )
            if sure > 0.0:
                write_image(new / "masks" / f"{name(n)}.png", whole)
            maps.add(n, whole)
            confidence[n] = sure
            done(len(confidence))
        if hands is not None:
            write_hand(hands.hand, new / "hand.npz", _hand_file_fields(labels, hands, K, camera, numbers))
        elif found is not None:
            write_relifted_hands(found.path, new / "hand.npz", labels.side, numbers, maps)
    return ClipFiles(hands, confidence, clip_command(labels, out))


def _numbers_of_names(name: Callable[[int], str], first: int, last: int) -> dict[int, int]:
    """Return the numbers by which a clip finds the hands of frames, from their names."""
    numbers = {n: number_of(name(n)) for n in range(first, last + 1)}
    known = {n: number for n, number in numbers.items() if number is not None}
    if len({*known.values()}) < len(numbers):
        without = next((n for n, number in numbers.items() if number is None), first)
        needs = "each image needs a number of its own at the end of its name"
        raise UsageError(f"{needs} (got {files.printable(name(without))})")
    return known


def _no_hand_mask(_: int) -> None:
    """Return the hand's mask where there is none."""


def occlude_hand_border(drawn: UInt8[ndarray, "H W"]) -> UInt8[ndarray, "H W"]:
    """Return a mask in which pixels at the hand's border, but the object's own, are in front of it."""
    import cv2

    beside = max(1, round(HAND_MARGIN_FRACTION * max(drawn.shape)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * beside + 1, 2 * beside + 1))
    near = cv2.dilate((drawn == HAND_LABEL).astype(np.uint8), disc) > 0
    return np.where(near & (drawn == 0), OCCLUDER_LABEL, drawn).astype(np.uint8)


def occlude_fitted_hand(
    drawn: UInt8[ndarray, "H W"], hands: ClickedHands, row: int, K: Float[ndarray, "3 3"]
) -> UInt8[ndarray, "H W"]:
    """Return a mask in which pixels that the fitted hand may cover, and nobody drew, are in front of the object."""
    import cv2

    posed = se3.transform(hands.hand.T_cam_hand[row], hands.hand.vertices[row])
    hand = render_coverage(posed, hands.hand.faces, K, (drawn.shape[1], drawn.shape[0])).astype(np.uint8)
    beside = max(1, round(HAND_MARGIN_M * K[0, 0] / float(posed[:, 2].mean())))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * beside + 1, 2 * beside + 1))
    return np.where((cv2.dilate(hand, disc) > 0) & (drawn == 0), OCCLUDER_LABEL, drawn).astype(np.uint8)


def clip_command(labels: Labels, out: Path, segments: Path | None = None) -> str:
    """Return the call that makes a clip of the files of ``write_labelled_clip_files``; a timeline, where there is a file of segments."""
    words = ["getagrip", *clip_arguments(labels, out, labels.video, segments)]
    return " ".join(map(shlex.quote, words)) + " --mesh MESH --out CLIP"


def clip_arguments(labels: Labels, out: Path, video: str, segments: Path | None = None) -> list[str]:
    """Return the words of that call after the program's name, but for the mesh and the clip's folder.

    The side is that of the hand in ``out``, which may be another one than the labels' (``lifted_again``).
    """
    hand = out / "hand.npz"
    side = str(arrays.read(hand, {"side"}.__contains__).get("side", labels.side)) if hand.is_file() else labels.side
    return [
        *("clip", "new", video, "--interval", str(labels.first + 1), str(labels.last + 1), "--side", side),
        *("--hands", str(out / "hand.npz"), "--masks", str(out / "masks")),
        *("--object", str(OBJECT_LABEL), "--ignore", str(OCCLUDER_LABEL), "--hand", str(HAND_LABEL)),
        *(() if segments is None else ("--segments", str(segments))),
    ]


def _hand_file_fields(
    labels: Labels, hands: ClickedHands, K: Float[ndarray, "3 3"], camera: Source, numbers: Mapping[int, int]
) -> dict[str, ndarray]:
    """Return the fields of a hand file on its frames, its camera and its sources."""
    off = float(np.sqrt(np.nanmean(hands.residuals**2)))
    provenance = {
        "hands": estimated(
            f"joints clicked on {len(hands.keys)} frames, the generic hand fitted ({off:.1f} px off, root mean "
            "square), in between moved with the footage"
        ),
        "hands_scale": assumed(ASSUMED_SCALE_NOTE),
        "camera": camera,
    }
    extra = {"frames": np.array([*numbers.values()]), "K": K, "side": np.array(labels.side)}
    return extra | provenance_to_arrays(provenance)
