"""Write an annotator's labels as inputs of ``getagrip clip new``: a hand file, and a folder of masks.

The footage of a label file is recognised by its checksum or, without one, by its name.
"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from getagrip.checks.intrinsics import compute_intrinsics
from getagrip.clip.match_frames import number_of
from getagrip.clip.write import write_hand
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.lens import Lens
from getagrip.geometry.rasterize import render_coverage
from getagrip.hands.from_2d.clicks import ASSUMED_SCALE_NOTE, ClickedHands, hands_from_clicks
from getagrip.hands.model import Side
from getagrip.io import arrays, files
from getagrip.io.images import write_image
from getagrip.provenance import Source, assumed, estimated, provenance_to_arrays
from getagrip.studio.hands.detect_hands import HandDetectionFiles
from getagrip.studio.hands.relift_hands import LabelMaps, write_relifted_hands
from getagrip.studio.hands.stabilize_hands import stabilize_hands
from getagrip.studio.jobs import NewClipCall
from getagrip.studio.masks.filled_maps import NOTHING_FILLED, FilledFrames, propagate_missing
from getagrip.studio.masks.propagate_clip import no_hand_mask
from getagrip.studio.masks.stroke_prompt import keyframe_label_maps
from getagrip.studio.masks.uncertain_pixels import UncertainPixels
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import HAND_LABEL, OCCLUDER_LABEL, Labels
from getagrip.studio.store.tasks import Task


def footage_checksum(path: Path) -> str:
    """Compute the SHA-256 of a video file; of a folder of images, that of their names and contents.

    Raises ``OSError``.
    """
    stats = [(each, each.stat()) for each in (files.list_files(path) if path.is_dir() else [path])]
    return _cached_checksum(tuple((each, stat.st_size, stat.st_mtime_ns) for each, stat in stats), path.is_dir())


@lru_cache(maxsize=8)
def _cached_checksum(known: tuple[tuple[Path, int, int], ...], folder: bool) -> str:
    """Compute the checksum again only if sizes or times of the files change."""
    total = hashlib.sha256()
    for path, size, _ in known:
        if folder:
            total.update(f"{path.name}\0{size}\0".encode())
        with path.open("rb") as stream:
            while part := stream.read(2**20):
                total.update(part)
    return total.hexdigest()


def tasks_of_labels(labels: Labels, tasks: Sequence[Task]) -> list[Task]:
    """Return the tasks with the labels' footage: of the same checksum or, without one, of the same name.

    Raises ``RefusedError`` for labels of other footage.
    """
    present = [(task, task.path) for task in tasks if task.path is not None]
    named = [(task, path) for task, path in present if path.name == labels.video]
    name = files.printable(labels.video)
    if not labels.sha256:
        if not named:
            raise RefusedError(f"video must be the name of an input video (got {name} and no checksum of it)")
        return [task for task, _ in named]
    for some in (named, present):
        same = [task for task, path in some if footage_checksum(path) == labels.sha256]
        if same:
            return same
    if named:
        advice = "if its frames are the same, remove the key sha256 from the labels"
        raise RefusedError(f"sha256: {name} here is another file than the labelled one; {advice}")
    raise RefusedError(f"missing footage of {name}: none has this name or checksum")


HAND_MARGIN_M = 0.004
"""Error of the fitted hand's silhouette, within which pixels beside the hand are ignored [m]."""
HAND_MARGIN_FRACTION = 1 / 400
"""Distance from the detected hand's mask within which pixels are ignored, as a fraction of the image's longer side."""


@dataclass(frozen=True)
class ClipFiles:
    """The files made of labels."""

    hands: ClickedHands | None
    """Hands fitted to clicks; None for detected hands, which are lifted again."""
    confidence: dict[int, float]
    """Confidence of the mask of each frame, 1 where it was drawn (``propagate_clip``)."""
    command: str
    """Command that makes a clip of the files, except for the object's mesh."""


def write_labelled_clip_files(
    labels: Labels,
    image: Callable[[int], UInt8[ndarray, "H W 3"]],
    lens: Lens,
    out: Path,
    overwrite: bool = False,
    done: Callable[[int], None] = lambda _: None,
    found: HandDetectionFiles | None = None,
    name: Callable[[int], str] = lambda n: f"{n + 1:06d}",
    filled: FilledFrames = NOTHING_FILLED,
) -> ClipFiles:
    """Write ``out/hand.npz`` and ``out/masks/<name>.png``, whose values are ``OBJECT_LABEL`` and so on.

    Pixels that the hand or an occluder may hide, and ``UncertainPixels``, get ``OCCLUDER_LABEL``, too.
    Frames in which the object is lost get no mask. The hand is fitted to the clicked joints; without clicks, the
    ``found`` hand is lifted again.

    ``image`` returns the footage's frames, from 0, and ``name`` their names in a clip. If the lens is a guess or not
    set, the files note that depth and size are guesses, too. Masks that are ``filled`` in already are not propagated
    again. ``done`` is called with the number of frames that are done.
    Raises ``UsageError`` for insufficient labels, for names without a unique number, and if ``out`` exists without
    ``overwrite`` or holds other files.
    """
    K, camera = compute_intrinsics(lens if lens.is_set else Lens(guess_focal=True), labels.size)
    numbers = _numbers_of_names(name, labels.first, labels.last)
    seen = no_hand_mask if found is None else found.mask
    hands = None
    if labels.clicks or found is None or not found.path.is_file():
        clicked = hands_from_clicks(labels.clicks, K, labels.side, labels.first, labels.last)
        hands = stabilize_hands(clicked, labels.first, K, labels.size, image)
    confidence = {}
    with files.new_folder(out, ("hand.npz", "masks") if overwrite else ()) as new:
        (new / "masks").mkdir()
        drawn, maps = keyframe_label_maps(labels, image, seen), LabelMaps(labels.size)
        uncertain = UncertainPixels.of_keys(drawn, image, seen, {} if found is None else found.joints)
        for n, mask, sure in propagate_missing(image, drawn, labels.first, labels.last, filled, seen):
            if hands is None:
                whole = _occlude_hand_border(mask)
                whole[uncertain.find(n, whole, image(n))] = OCCLUDER_LABEL
                maps.add(n, whole)  # landmarks do not vouch for themselves when the hand is lifted again
                whole[uncertain.behind_fingers(n, whole)] = OCCLUDER_LABEL
            else:
                whole = _occlude_hand(mask, hands, n - labels.first, K)
            if sure > 0.0:
                write_image(new / "masks" / f"{name(n)}.png", whole)
            confidence[n] = sure
            done(len(confidence))
        if hands is not None:
            write_hand(hands.hand, new / "hand.npz", _hand_file_fields(labels, hands, K, camera, numbers))
        elif found is not None:
            write_relifted_hands(found.path, new / "hand.npz", labels.side, numbers, maps)
    return ClipFiles(hands, confidence, clip_command(labels, out))


def _numbers_of_names(name: Callable[[int], str], first: int, last: int) -> dict[int, int]:
    """Return the numbers in frames' names, by which a clip finds their hands."""
    numbers = {n: number_of(name(n)) for n in range(first, last + 1)}
    known = {n: number for n, number in numbers.items() if number is not None}
    if len({*known.values()}) < len(numbers):
        without = next((n for n, number in numbers.items() if number is None), first)
        needs = "each image needs a unique number at the end of its name"
        raise UsageError(f"{needs} (got {files.printable(name(without))})")
    return known


def _occlude_hand_border(drawn: UInt8[ndarray, "H W"]) -> UInt8[ndarray, "H W"]:
    """Label the unlabelled pixels at the hand's border as occluder."""
    return _occlude_around(drawn, drawn == HAND_LABEL, HAND_MARGIN_FRACTION * max(drawn.shape))


def _occlude_hand(
    drawn: UInt8[ndarray, "H W"], hands: ClickedHands, row: int, K: Float[ndarray, "3 3"]
) -> UInt8[ndarray, "H W"]:
    """Label the unlabelled pixels that the fitted hand may cover as occluder."""
    posed = se3.transform(hands.hand.T_cam_hand[row], hands.hand.vertices[row])
    hand = render_coverage(posed, hands.hand.faces, K, (drawn.shape[1], drawn.shape[0]))
    return _occlude_around(drawn, hand, HAND_MARGIN_M * K[0, 0] / float(posed[:, 2].mean()))


def _occlude_around(drawn: UInt8[ndarray, "H W"], hand: Bool[ndarray, "H W"], margin: float) -> UInt8[ndarray, "H W"]:
    import cv2

    beside = max(1, round(margin))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * beside + 1, 2 * beside + 1))
    near = cv2.dilate(hand.astype(np.uint8), disc) > 0
    return np.where(near & (drawn == 0), OCCLUDER_LABEL, drawn).astype(np.uint8)


def clip_command(labels: Labels, out: Path, segments: Path | None = None) -> str:
    """Return the command that makes a clip of the files in ``out``; with a file of segments, a timeline."""
    return shlex.join(["getagrip", *new_clip_call(labels, out, labels.video, segments).words])


def new_clip_call(labels: Labels, out: Path, video: str, segments: Path | None = None) -> NewClipCall:
    """Return the call that makes a clip, without mesh and output folder.

    The side is that of the hand in ``out``, which may differ from the labels' side (``relift_hands``).
    """
    hand, masks, interval = out / "hand.npz", out / "masks", (labels.first + 1, labels.last + 1)
    stored = arrays.read(hand, {"side"}.__contains__).get("side", labels.side) if hand.is_file() else labels.side
    side: Side = "left" if str(stored) == "left" else "right"
    return NewClipCall(video=video, interval=interval, side=side, hands=hand, masks=masks, segments=segments)


def _hand_file_fields(
    labels: Labels, hands: ClickedHands, K: Float[ndarray, "3 3"], camera: Source, numbers: Mapping[int, int]
) -> dict[str, ndarray]:
    """Return the fields of a hand file for frame numbers, camera, side and provenance."""
    off = float(np.sqrt(np.nanmean(hands.residuals**2)))
    fit = f"the generic hand fitted ({off:.1f} px off, root mean square), in between moved with the footage"
    provenance = {
        "hands": estimated(f"joints clicked on {len(hands.keys)} frames, {fit}"),
        "hands_scale": assumed(ASSUMED_SCALE_NOTE),
        "camera": camera,
    }
    extra = {"frames": np.array([*numbers.values()]), "K": K, "side": np.array(labels.side)}
    return extra | provenance_to_arrays(provenance)
