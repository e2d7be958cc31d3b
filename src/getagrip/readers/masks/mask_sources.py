"""Masks from other programs' files, one frame at a time: ``open_masks``.

- A folder of folders, one for each object (``object/`` and optionally ``ignore/`` and ``hand/``, or others, chosen by
  name): one PNG for each frame, non-zero in the mask.
- A folder of PNG: an image of labels each (``mask_request``), or a mask each with one label only; or of ``.npy`` or
  ``.npz`` (``mask_arrays``), or of LabelMe's ``.json`` (``mask_regions``).
- ``.json``: COCO's ``images``, ``annotations`` (polygons or run lengths) and ``categories``, YouTube-VIS's ``videos``
  and SA-V's ``masklet`` (``mask_regions``).
- ``.pkl`` or ``.npy``: SAM 2's ``video_segments`` (``mask_arrays``).
- ``.npz`` or ``.npy``: ``object`` (T, H, W) and optionally ``ignore`` and ``hand``, or ``labels`` (T, H, W) of whole
  numbers; ``frames`` (T,), their names or numbers, or all requested frames in order; or an array for each frame.

The labels of the object, of occluders, and of the grasping hand among them are chosen by value: a number, a colour as
#rrggbb, a folder's or a category's name. Frames may lack masks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip.clip import FrameMasks
from getagrip.clip.match_frames import MAX_NAMES_IN_ERROR
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays, files
from getagrip.io.files import printable
from getagrip.io.images import png_size
from getagrip.readers.masks.mask_arrays import (
    Load,
    area_values,
    binarise_soft_masks,
    holds_objects,
    open_npy_folder,
    open_npy_masks,
    open_npz_masks,
    open_video_segments,
)
from getagrip.readers.masks.mask_regions import (
    open_coco_masks,
    open_labelme_masks,
    open_masklets,
    open_yolo_masks,
    open_youtube_vis_masks,
    union,
)
from getagrip.readers.masks.mask_request import (
    MAX_MASK_PIXELS,
    LabelChoice,
    MaskReader,
    MaskRequest,
    combine_hand_object_masks,
    label_name,
    read_label_image,
)

LOSSY_IMAGE_SUFFIXES = {".jpg", ".jpeg", ".webp"}
CVAT_MASK_FOLDER, CVAT_LABEL_FILE = "SegmentationClass", "labelmap.txt"
"""Folder of images of labels, and file of their names and colours, in CVAT's export "Segmentation mask"."""
CONVERSION_HINTS = {
    ".mp4 .mov .mkv .avi .webm": "; for a video of masks: mkdir masks && ffmpeg -i VIDEO masks/%06d.png",
    ".xml": "; CVAT exports them as COCO 1.0 or Segmentation mask 1.1, too",
    ".txt": "; name the folder of YOLO's texts",
}
"""Conversions of unsupported files, by their suffixes."""


def open_masks(path: Path, request: MaskRequest) -> MaskReader:
    """Open the masks of the requested frames. Raises ``InputError`` without masks, ``UsageError`` for labels."""
    with arrays.convert_to_input_errors(path):
        return _open_masks_by_format(path, request)


def _open_masks_by_format(path: Path, request: MaskRequest) -> MaskReader:
    if path.is_dir():
        return _open_mask_folder(path, request)
    if path.suffix in {".pkl", ".pickle", ".npy"} and path.is_file():
        is_array = path.suffix == ".npy" and not holds_objects(path)
        return (open_npy_masks if is_array else open_video_segments)(path, request)
    if path.suffix == ".npz":
        return open_npz_masks(path, request)
    if path.suffix == ".json":
        content = files.read_json(path)
        if "masklet" in content:
            return open_masklets(path, content, request)
        if "shapes" in content:
            return open_labelme_masks(path, [path], request)
        is_youtube_vis = "videos" in content and "images" not in content
        return (open_youtube_vis_masks if is_youtube_vis else open_coco_masks)(path, content, request)
    got = "no folder, .json, .npz, .pkl or .npy" if path.exists() else "no such file or folder"
    convert = next((text for suffixes, text in CONVERSION_HINTS.items() if path.suffix.lower() in suffixes.split()), "")
    raise InputError(path, "", got, f"masks: a folder of PNG, COCO's JSON, arrays, or SAM 2's video_segments{convert}")


def _open_mask_folder(folder: Path, request: MaskRequest) -> MaskReader:
    things = [sub.name for sub in files.folders_in(folder) if files.list_files(sub, (".png",))]
    images = {suffix: files.list_files(folder, (suffix,)) for suffix in (".png", ".npy", ".npz", ".json", ".txt")}
    if CVAT_MASK_FOLDER in things and (folder / CVAT_LABEL_FILE).is_file():
        return _open_cvat_masks(folder, request)
    if things and ("object" in things or not images[".png"]):
        return _open_object_folders(folder, request, things)
    if images[".png"]:
        return _open_label_images(folder, images[".png"], request)
    if images[".npy"] or images[".npz"]:
        return open_npy_folder(folder, images[".npy"] or images[".npz"], request)
    if images[".json"]:
        return open_labelme_masks(folder, images[".json"], request)
    if images[".txt"]:
        texts = [path for path in images[".txt"] if path.stem not in ("classes", "labels")]
        return open_yolo_masks(folder, texts, request)
    other = next((path.name for path in files.list_files(folder, LOSSY_IMAGE_SUFFIXES)), None)
    got = f"no mask of any of {len(request.frames)} frames"
    got += f"; {printable(other)} is no PNG, and has no labels" if other else ""
    raise InputError(folder, "", got, f"a PNG for each frame, named like it, as {printable(request.frames[0])}.png")


def _open_object_folders(folder: Path, request: MaskRequest, things: Sequence[str]) -> MaskReader:
    """Open a folder of masks for each object, for the frames in all chosen folders.

    A single folder, and folders called ``object``, ``ignore`` and ``hand``, need not be named.
    """
    chosen = {"object": request.object, "ignore": request.ignore, "hand": request.hand}
    if not any(chosen.values()):
        chosen = {"object": tuple(things[:1]), "ignore": (), "hand": ()}
        if len(things) > 1:
            chosen = {"object": ("object",)} | {kind: tuple({kind} & {*things}) for kind in ("ignore", "hand")}
    for kind, names in chosen.items():
        wrong = next((name for name in names if name not in things), None)
        if wrong is not None or (kind == "object" and not names):
            which = f"missing --{kind}" if wrong is None else f"unknown --{kind} {wrong!r}"
            there = ", ".join(printable(name) for name in things[:MAX_NAMES_IN_ERROR])
            raise UsageError(f"{which}; choose from the folders in {folder}: {there}")
    notes = Counter[str]()
    images = {
        kind: [_index_label_images(folder / name, request, notes) for name in names] for kind, names in chosen.items()
    }
    known = set.intersection(*({*frames} for each in images.values() for frames, _ in each))
    if not known:
        raise request.nothing(folder, things)
    loads = {kind: [binarise_soft_masks(load, frames, notes) for frames, load in each] for kind, each in images.items()}

    def of_thing(path: Path, labels: Int[ndarray, "h w"]) -> Bool[ndarray, "H W"]:
        if len(several := area_values(labels)) > 1:
            got = f"several values, {', '.join(map(label_name, several[:MAX_NAMES_IN_ERROR]))}"
            raise InputError(path, "labels", got, f"one in a folder of a thing; else name {path.parent}, and --object")
        return request.resized(labels != 0, notes)

    def read(n: int) -> FrameMasks:
        visible, hidden, hand = (
            union([of_thing(*load(n)) for load in loads[kind]], request.size) for kind in ("object", "ignore", "hand")
        )
        return combine_hand_object_masks(visible, hidden, hand if loads["hand"] else None)

    return MaskReader(folder, read, known, notes=notes)


def _open_cvat_masks(folder: Path, request: MaskRequest) -> MaskReader:
    """Open CVAT's masks, whose labels have names. Raises ``UsageError`` for other names."""
    lines = [
        line.split(":") for line in files.read_text(folder / CVAT_LABEL_FILE).splitlines() if not line.startswith("#")
    ]
    values = {line[0]: line[1] for line in lines if len(line) > 1}
    try:
        colours = {name: "#{:02x}{:02x}{:02x}".format(*map(int, value.split(","))) for name, value in values.items()}
    except (ValueError, IndexError) as error:
        got = f"no colours of labels ({error})"
        raise InputError(folder / CVAT_LABEL_FILE, "", got, "label:red,green,blue::") from error
    names = [name for name, colour in colours.items() if colour != "#000000"]
    chosen = {"object": request.object or tuple(names[:1]), "ignore": request.ignore, "hand": request.hand}
    wrong = next((each for each in chosen.items() if {*each[1]} - {*colours, *colours.values()}), None)
    if wrong is not None or (len(names) > 1 and not request.object) or not names:
        which = "missing --object" if wrong is None else f"unknown --{wrong[0]} {' '.join(wrong[1])}"
        raise UsageError(f"{which}; choose from the labels of {folder}: {', '.join(map(printable, names))}")
    by_colour = {kind: tuple(colours.get(name, name) for name in texts) for kind, texts in chosen.items()}
    source = folder / CVAT_MASK_FOLDER
    return _open_label_images(source, files.list_files(source, (".png",)), replace(request, **by_colour))  # type: ignore[arg-type]


def _open_label_images(folder: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    choose, notes = LabelChoice(request), Counter[str]()
    frames, load = _index_label_images(folder, request, notes, paths)
    sharp = binarise_soft_masks(load, frames, notes, choose.object, bool(choose.ignore or choose.hand))

    def read(n: int) -> FrameMasks:
        path, labels = sharp(n)
        return choose(path, request.resized(labels, notes))

    return MaskReader(folder, read, frames, choose.others, choose.unmet, notes)


def _index_label_images(
    folder: Path, request: MaskRequest, notes: Counter[str], paths: Sequence[Path] | None = None
) -> tuple[list[int], Load]:
    """Return the frames with a PNG, and their loader. Raises ``InputError`` for two images of a frame."""
    paths = files.list_files(folder, (".png",)) if paths is None else paths
    rows = request.places(folder, [path.name for path in paths])

    def load(n: int) -> tuple[Path, Int[ndarray, "h w"]]:
        path = paths[rows[n]]
        return path, read_label_image(path, request.check_size(path, "size", png_size(path, MAX_MASK_PIXELS)), notes)

    return sorted(rows), load
