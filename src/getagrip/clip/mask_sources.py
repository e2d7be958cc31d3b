"""Masks from files of other programs, one frame at a time: PNG folders, COCO, arrays.

- a folder of folders, one for each thing (``object/`` and perhaps ``ignore/`` and ``hand/``, or any others, chosen by
  their names): one PNG for each frame, non-zero where the mask is set;
- a folder of PNG: the labels of an image each (``label_images``), or a mask each where there is one label only;
- ``.json``: COCO's ``images``, ``annotations`` (polygons or run lengths) and ``categories``;
- ``.pkl`` or ``.npy``: SAM 2's ``video_segments`` (``video_segments``);
- ``.npz``: ``object`` (T, H, W) and perhaps ``ignore`` and ``hand``, or ``labels`` (T, H, W) of whole numbers;
  ``frames`` (T,) names or numbers of them, or all of the wanted ones in order.

Which labels are the object, which hide it (hands, other things in front), and which of these the hand that holds it, is
chosen by value: a number, a colour as #rrggbb, a folder's or a category's name.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.label_images import label_value, read_labels
from getagrip.clip.mask_request import MOST_NAMED, MaskReader, MaskRequest, without_object
from getagrip.clip.naming import frame_of
from getagrip.clip.segments import check_count, region, union
from getagrip.clip.video_segments import video_segments
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays, files

LOSSY = {".jpg", ".jpeg", ".webp"}


def open_masks(path: Path, request: MaskRequest) -> MaskReader:
    """A reader of the masks of some frames. Raises ``InputError`` for missing frames, ``UsageError`` for labels."""
    if path.suffix in {".pkl", ".pickle", ".npy"} and path.is_file():
        return video_segments(path, request)
    if path.is_dir():
        request.check_numbers(path, (png.stem for png in sorted(path.rglob("*.png"))))
        things = sorted(sub.name for sub in path.iterdir() if sub.is_dir() and any(sub.glob("*.png")))
        labels = "object" not in things and any(path.glob("*.png"))
        return _thing_folders(path, request, things) if things and not labels else _label_folder(path, request)
    if path.suffix == ".npz":
        return _arrays(path, request)
    if path.suffix == ".json":
        return _coco(path, request)
    given = "no folder, .json, .npz, .pkl or .npy" if path.exists() else "no such file or folder"
    raise InputError(path, "", given, "masks: a folder of PNG, COCO's JSON, arrays, or SAM 2's video_segments")


def _thing_folders(folder: Path, request: MaskRequest, things: Sequence[str]) -> MaskReader:
    """Masks of a thing each in folders of their names.

    An only one need not be named, nor those called ``object``, ``ignore`` and ``hand``.
    """
    chosen = {"object": request.object, "ignore": request.ignore, "hand": request.hand}
    if not any(chosen.values()):
        chosen = {"object": tuple(things[:1]), "ignore": (), "hand": ()}
        if len(things) > 1:
            chosen = {"object": ("object",)} | {kind: tuple({kind} & {*things}) for kind in ("ignore", "hand")}
    for kind, names in chosen.items():
        wrong = next((name for name in names if name not in things), None)
        if wrong is not None or (kind == "object" and not names):
            given = "nothing" if wrong is None else repr(wrong)
            there = ", ".join(files.plain(name) for name in things[:MOST_NAMED])
            raise UsageError(f"--{kind}: got {given}, expected the name of a folder in {folder}: {there}")
    paths = {kind: [_pngs(folder / name, request.frames) for name in names] for kind, names in chosen.items()}

    def read(n: int) -> FrameMasks:
        visible, hidden, hand = (
            union([read_labels(each[n], request.size) != 0 for each in paths[kind]], request.size)
            for kind in ("object", "ignore", "hand")
        )
        return without_object(visible, hidden, hand if paths["hand"] else None)

    return MaskReader(folder, read)


def _label_folder(folder: Path, request: MaskRequest) -> MaskReader:
    """A folder of label images."""
    paths, choose = _pngs(folder, request.frames), _Chooser(request)
    return MaskReader(folder, lambda n: choose(paths[n], read_labels(paths[n], request.size)), choose.others)


def _pngs(folder: Path, frames: Sequence[str]) -> list[Path]:
    """The PNG of each frame. Raises ``InputError`` for a frame without one, or with two."""
    found: dict[int, Path] = {}
    for path in sorted(folder.glob("*.png")):
        n = frame_of(path.stem, frames)
        if n is not None and n in found:
            raise InputError(path, "", f"a second mask of frame {frames[n]}", f"one; {found[n].name} is the first")
        if n is not None:
            found[n] = path
    missing = [frame for n, frame in enumerate(frames) if n not in found]
    if missing:
        other = next((path.name for path in sorted(folder.iterdir()) if path.suffix.lower() in LOSSY), None)
        given = f"no mask of {len(missing)} of {len(frames)} frames (first: {files.plain(missing[0])})"
        given += f"; {files.plain(other)} is no PNG, and has no labels" if other and not found else ""
        raise InputError(folder, "", given, f"a PNG for each frame, named like it, as {files.plain(missing[0])}.png")
    return [found[n] for n in range(len(frames))]


class _Chooser:
    """Picks the object and what hides it from labels."""

    def __init__(self, request: MaskRequest) -> None:
        self.object = [label_value(text, "--object") for text in request.object]
        self.ignore = [label_value(text, "--ignore") for text in request.ignore]
        self.hand = [label_value(text, "--hand") for text in request.hand]
        self.only: int | None = None
        self.others: set[str] = set()

    def __call__(self, path: Path, labels: Int[ndarray, "H W"]) -> FrameMasks:
        """Raises ``InputError`` where no label is named and there are several."""
        ignored = np.isin(labels, [*self.ignore, *self.hand])
        hand = np.isin(labels, self.hand) if self.hand else None
        if self.object:
            visible = np.isin(labels, self.object)
            if not visible.any() and len(self.others) < MOST_NAMED:
                self.others.update(map(_label_name, np.unique(labels)[:MOST_NAMED].tolist()))
            return without_object(visible, ignored, hand)
        visible = (labels != 0) & ~ignored
        there = np.unique(labels[visible])
        self.only = int(there[0]) if self.only is None and there.size else self.only
        if there.size > 1 or (there.size and there[0] != self.only):
            some = ", ".join(map(_label_name, np.union1d(there, [self.only or there[0]])[:MOST_NAMED].tolist()))
            raise InputError(path, "labels", f"several, {some}", "one, or the object's named by --object")
        return without_object(visible, ignored, hand)


def _label_name(label: int) -> str:
    """A label as it can be given."""
    return str(label) if label < 2**16 else f"#{label:06x}"


def _arrays(path: Path, request: MaskRequest) -> MaskReader:
    """Masks or labels in an ``.npz`` file."""
    given = arrays.read(path, {"object", "ignore", "hand", "labels", "frames"}.__contains__)
    key = "labels" if "labels" in given else "object"
    if key not in given:
        raise InputError(path, "object", "no such array", "the array, or one called labels")
    if given[key].ndim != 3:
        raise InputError(path, key, f"{given[key].dtype} of shape {given[key].shape}", "masks of shape (n, H, W)")
    width, height = request.size
    for name in (key, *(name for name in ("ignore", "hand") if name in given)):
        array = given[name]
        expected = f"whole numbers or booleans of shape ({len(given[key])}, {height}, {width})"
        if array.dtype.kind not in "biu" or array.shape != (len(given[key]), height, width):
            raise InputError(path, name, f"{array.dtype} of shape {array.shape}", expected)
    rows = _rows(path, given, len(given[key]), request)
    choose = _Chooser(request)
    if key == "labels":
        return MaskReader(path, lambda n: choose(path, given["labels"][rows[n]].astype(np.int64)), choose.others)

    def read(n: int) -> FrameMasks:
        at = {name: given[name][rows[n]] != 0 for name in ("object", "ignore", "hand") if name in given}
        return without_object(at["object"], at.get("ignore", np.zeros_like(at["object"])), at.get("hand"))

    return MaskReader(path, read)


def _rows(path: Path, given: dict[str, ndarray], count: int, request: MaskRequest) -> list[int]:
    """The row of each frame."""
    frames = request.frames
    if "frames" not in given:
        if count != len(frames):
            raise InputError(path, "frames", f"no such array, {count} masks", f"{len(frames)} masks, or their frames")
        return list(range(count))
    names = given["frames"]
    if names.dtype.kind not in "Uiu" or names.shape != (count,):
        raise InputError(path, "frames", f"{names.dtype} of shape {names.shape}", f"{count} names or numbers")
    request.check_numbers(path, map(str, names))
    found = {frame_of(str(name), frames): row for row, name in enumerate(names)}
    missing = next((frame for n, frame in enumerate(frames) if n not in found), None)
    if missing is not None:
        raise InputError(path, "frames", f"no frame {files.plain(missing)}", "all frames")
    return [found[n] for n in range(len(frames))]


def _coco(path: Path, request: MaskRequest) -> MaskReader:
    """COCO's annotations; a frame without any of the object shows nothing of it."""
    content = files.read_json(path)
    images, annotations = (_objects(path, content, key) for key in ("images", "annotations"))
    categories = _objects(path, content, "categories", needed=False)
    names = {str(item.get("id")): str(item.get("name")) for item in categories}
    index: dict[Any, int] = {}
    request.check_numbers(
        path, (_stem(image["file_name"]) for image in images if isinstance(image.get("file_name"), str))
    )
    for k, image in enumerate(images):
        name = image.get("file_name")
        if not isinstance(name, str) or not isinstance(image.get("id"), int | str):
            raise InputError(path, f"images[{k}]", files.shown(image), "an id and a file_name")
        n = frame_of(_stem(name), request.frames)
        if n is not None:
            size = image.get("width"), image.get("height")
            if size != request.size:
                raise InputError(path, f"images[{k}]", f"{size[0]} x {size[1]}", "{} x {}".format(*request.size))
            index[image["id"]] = n
    missing = next((f for n, f in enumerate(request.frames) if n not in index.values()), None)
    if missing is not None:
        raise InputError(path, "images", f"no image of frame {files.plain(missing)}", "an image for each frame")
    regions: dict[tuple[int, str], list[tuple[str, Any]]] = {}
    for k, item in enumerate(annotations):
        of, category = item.get("image_id"), item.get("category_id")
        if not isinstance(of, int | str) or not isinstance(category, int | str):
            raise InputError(path, f"annotations[{k}]", files.shown(item), "an image_id and a category_id")
        if of in index:
            called = {str(category), names.get(str(category), "")}
            chosen = "object" if called & {*request.object} or not request.object else ""
            kind = "hand" if called & {*request.hand} else "ignore" if called & {*request.ignore} else chosen
            regions.setdefault((index[of], kind), []).append((f"annotations[{k}].segmentation", item))
    used = {str(item["category_id"]) for (_, kind), items in regions.items() if kind == "object" for _, item in items}
    if not request.object and len(used) > 1:
        raise InputError(path, "categories", f"several, {', '.join(sorted(used))}", "one, or --object names it")

    def drawn(n: int, kind: str) -> Bool[ndarray, "H W"]:
        found = regions.get((n, kind), [])
        check_count(path, "annotations", len(found), request.size)
        return union((region(path, key, item.get("segmentation"), request.size) for key, item in found), request.size)

    def read(n: int) -> FrameMasks:
        return without_object(drawn(n, "object"), drawn(n, "ignore"), drawn(n, "hand") if request.hand else None)

    there = {str(item["category_id"]) for item in annotations}
    return MaskReader(path, read, {names.get(label, label) for label in sorted(there)[:MOST_NAMED]})


def _stem(name: str) -> str:
    """A file's name without folders and suffix."""
    return name.rsplit("/", maxsplit=1)[-1].rpartition(".")[0] or name


def _objects(path: Path, content: dict[str, Any], key: str, needed: bool = True) -> list[dict[str, Any]]:
    """A list of JSON objects."""
    value = content.get(key, None if needed else [])
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        given = "no such key" if key not in content else files.shown(value)
        raise InputError(path, key, given, "a list of objects, as COCO has it")
    return value
