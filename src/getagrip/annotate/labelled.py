"""From a person's labels to what ``getagrip clip new`` takes: a hand file, and a folder of masks."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.annotate.found_hands import FoundHands
from getagrip.annotate.labels import FRONT, HAND, OBJECT, Labels
from getagrip.annotate.lifted_again import LabelMaps, write_lifted_again
from getagrip.annotate.propagated_masks import propagate
from getagrip.annotate.steadied_hands import steadied
from getagrip.annotate.strokes import key_masks
from getagrip.clip.intrinsics import intrinsics
from getagrip.clip.naming import number_of
from getagrip.clip.writing import write_hand
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.depth import covered
from getagrip.geometry.lens import Lens
from getagrip.hands.clicked_hands import SCALE, ClickedHands, hands_from_clicks
from getagrip.io import arrays, files
from getagrip.io.images import write_image
from getagrip.provenance import Source, as_arrays, assumed, estimated

BESIDE = 0.004
"""The fitted hand is so far off its true silhouette: pixels beside it say nothing either [m]."""
EDGE = 1 / 400
"""Pixels so near to the mask of a hand that was found say nothing, as a share of the image's longer side."""


@dataclass(frozen=True)
class Made:
    """The files made of labels."""

    hands: ClickedHands | None
    """None where those that were found are lifted again."""
    confidence: dict[int, float]
    """Confidence of the mask of each frame, 1 where it was drawn; see ``propagated_masks``."""
    command: str
    """Command that makes a clip of it, but for the object's mesh."""


def make(
    labels: Labels,
    image: Callable[[int], UInt8[ndarray, "H W 3"]],
    lens: Lens,
    out: Path,
    overwrite: bool = False,
    done: Callable[[int], None] = lambda _: None,
    found: FoundHands | None = None,
    name: Callable[[int], str] = lambda n: f"{n + 1:06d}",
) -> Made:
    """Write ``out/hand.npz`` and ``out/masks/<name>.png``: ``OBJECT``, ``HAND``, ``FRONT`` for what hides it or may.

    Frames in which the object is lost get no mask: it is unknown.

    The hand is fitted to the joints that were clicked; where none were, that which was ``found`` is lifted again.

    ``image`` gives the footage's frames, from 0, and ``name`` their names in a clip. Where the lens is a guess, or
    nothing is known of it, the files say that depth and size are guesses, too. ``done`` is called with the number
    of masks that are written. Raises ``UsageError`` for labels that do not suffice, for names without a number of
    their own, and where ``out`` exists and is not to be replaced, or is not what this made before.
    """
    K, camera = intrinsics(lens if lens.is_set else Lens(guess_focal=True), labels.size)
    numbers = _numbers(name, labels.first, labels.last)
    seen = _unseen if found is None else found.mask
    hands = None
    if labels.clicks or found is None or not found.path.is_file():
        clicked = hands_from_clicks(labels.clicks, K, labels.side, labels.first, labels.last)
        hands = steadied(clicked, labels.first, K, labels.size, image)
    confidence = {}
    with files.new_folder(out, ("hand.npz", "masks") if overwrite else ()) as new:
        (new / "masks").mkdir()
        drawn, maps = key_masks(labels, image, seen), LabelMaps(labels.size)
        for n, mask, sure in propagate(image, drawn, labels.first, labels.last, hand=seen):
            whole = beside_hand(mask) if hands is None else with_hand(mask, hands, n - labels.first, K)
            if sure > 0.0:
                write_image(new / "masks" / f"{name(n)}.png", whole)
            maps.add(n, whole)
            confidence[n] = sure
            done(len(confidence))
        if hands is not None:
            write_hand(hands.hand, new / "hand.npz", _extra(labels, hands, K, camera, numbers))
        elif found is not None:
            write_lifted_again(found.path, new / "hand.npz", labels.side, numbers, maps)
    return Made(hands, confidence, command(labels, out))


def _numbers(name: Callable[[int], str], first: int, last: int) -> dict[int, int]:
    """Return the numbers by which a clip finds the hands of frames, from their names."""
    numbers = {n: number_of(name(n)) for n in range(first, last + 1)}
    known = {n: number for n, number in numbers.items() if number is not None}
    if len({*known.values()}) < len(numbers):
        without = next((n for n, number in numbers.items() if number is None), first)
        needs = "each image needs a number of its own at the end of its name"
        raise UsageError(f"{needs} (got {files.plain(name(without))})")
    return known


def _unseen(_: int) -> None:
    """Return the hand's mask where there is none."""


def beside_hand(drawn: UInt8[ndarray, "H W"]) -> UInt8[ndarray, "H W"]:
    """Return a mask in which pixels at the hand's border, but the object's own, are in front of it."""
    import cv2

    beside = max(1, round(EDGE * max(drawn.shape)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * beside + 1, 2 * beside + 1))
    near = cv2.dilate((drawn == HAND).astype(np.uint8), disc) > 0
    return np.where(near & (drawn == 0), FRONT, drawn).astype(np.uint8)


def with_hand(
    drawn: UInt8[ndarray, "H W"], hands: ClickedHands, row: int, K: Float[ndarray, "3 3"]
) -> UInt8[ndarray, "H W"]:
    """Return a mask in which pixels that the fitted hand may cover, and nobody drew, are in front of the object."""
    import cv2

    posed = se3.transform(hands.hand.T_cam_hand[row], hands.hand.vertices[row])
    hand = covered(posed, hands.hand.faces, K, (drawn.shape[1], drawn.shape[0])).astype(np.uint8)
    beside = max(1, round(BESIDE * K[0, 0] / float(posed[:, 2].mean())))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * beside + 1, 2 * beside + 1))
    return np.where((cv2.dilate(hand, disc) > 0) & (drawn == 0), FRONT, drawn).astype(np.uint8)


def command(labels: Labels, out: Path, segments: Path | None = None) -> str:
    """Return the call that makes a clip of the files of ``make``; a timeline, where there is a file of segments."""
    words = ["getagrip", *clip_words(labels, out, labels.video, segments)]
    return " ".join(map(shlex.quote, words)) + " --mesh MESH --out CLIP"


def clip_words(labels: Labels, out: Path, video: str, segments: Path | None = None) -> list[str]:
    """Return the words of that call after the program's name, but for the mesh and the clip's folder.

    The side is that of the hand in ``out``, which may be another one than the labels' (``lifted_again``).
    """
    hand = out / "hand.npz"
    side = str(arrays.read(hand, {"side"}.__contains__).get("side", labels.side)) if hand.is_file() else labels.side
    return [
        *("clip", "new", video, "--interval", str(labels.first + 1), str(labels.last + 1), "--side", side),
        *("--hands", str(out / "hand.npz"), "--masks", str(out / "masks")),
        *("--object", str(OBJECT), "--ignore", str(FRONT), "--hand", str(HAND)),
        *(() if segments is None else ("--segments", str(segments))),
    ]


def _extra(
    labels: Labels, hands: ClickedHands, K: Float[ndarray, "3 3"], camera: Source, numbers: Mapping[int, int]
) -> dict[str, ndarray]:
    """Return the fields of a hand file on its frames, its camera and its sources."""
    off = float(np.sqrt(np.nanmean(hands.residuals**2)))
    provenance = {
        "hands": estimated(
            f"joints clicked on {len(hands.keys)} frames, the generic hand fitted ({off:.1f} px off, root mean "
            "square), in between moved with the footage"
        ),
        "hands_scale": assumed(SCALE),
        "camera": camera,
    }
    extra = {"frames": np.array([*numbers.values()]), "K": K, "side": np.array(labels.side)}
    return extra | as_arrays(provenance)
