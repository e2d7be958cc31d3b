"""Masks from files of other programs, one frame at a time: PNG folders, arrays, regions in JSON.

- a folder of folders, one for each thing (``object/`` and perhaps ``ignore/`` and ``hand/``, or any others, chosen by
  their names): one PNG for each frame, non-zero where the mask is set;
- a folder of PNG: the labels of an image each (``label_choice``), or a mask each where there is one label only; or of
  ``.npy`` or ``.npz`` (``array_masks``), or of LabelMe's ``.json`` (``json_masks``);
- ``.json``: COCO's ``images``, ``annotations`` (polygons or run lengths) and ``categories``, YouTube-VIS's ``videos``
  and SA-V's ``masklet`` (``json_masks``);
- ``.pkl`` or ``.npy``: SAM 2's ``video_segments`` (``array_masks``);
- ``.npz`` or ``.npy``: ``object`` (T, H, W) and perhaps ``ignore`` and ``hand``, or ``labels`` (T, H, W) of whole
  numbers; ``frames`` (T,) names or numbers of them, or all of the wanted ones in order; or an array for each frame.

Which labels are the object, which hide it (hands, other things in front), and which of these the hand that holds it, is
chosen by value: a number, a colour as #rrggbb, a folder's or a category's name. Frames may have no mask.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip.array_masks import holds_objects, npy, npy_folder, npz, video_segments
from getagrip.clip.data import FrameMasks
from getagrip.clip.json_masks import coco, label_me, masklets, yolo, youtube_vis
from getagrip.clip.label_choice import LabelChoice, label_name, read_labels
from getagrip.clip.mask_request import MOST_PIXELS, MaskReader, MaskRequest, without_object
from getagrip.clip.naming import MOST_NAMED
from getagrip.clip.segments import union
from getagrip.clip.soft_edges import Load, areas, sharpened
from getagrip.errors import InputError, UsageError
from getagrip.io import files, numbers
from getagrip.io.images import png_size

LOSSY = {".jpg", ".jpeg", ".webp"}
CVAT, LABELS = "SegmentationClass", "labelmap.txt"
"""Folder of images of labels, and names and colours of these, in CVAT's export "Segmentation mask"."""
CONVERT = {
    ".mp4 .mov .mkv .avi .webm": "; of a video of masks: mkdir masks && ffmpeg -i VIDEO masks/%06d.png",
    ".xml": "; CVAT exports them as COCO 1.0 or Segmentation mask 1.1, too",
    ".txt": "; name the folder of YOLO's texts",
}
"""Ways to convert files that are not read, by their suffixes."""


def open_masks(path: Path, request: MaskRequest) -> MaskReader:
    """Open a reader of the masks of some frames.

    Raises ``InputError`` where there are none, ``UsageError`` for labels.
    """
    with numbers.guarded(path):
        return _opened(path, request)


def _opened(path: Path, request: MaskRequest) -> MaskReader:
    if path.is_dir():
        return _folder(path, request)
    if path.suffix in {".pkl", ".pickle", ".npy"} and path.is_file():
        return (npy if path.suffix == ".npy" and not holds_objects(path) else video_segments)(path, request)
    if path.suffix == ".npz":
        return npz(path, request)
    if path.suffix == ".json":
        content = files.read_json(path)
        if "masklet" in content:
            return masklets(path, content, request)
        if "shapes" in content:
            return label_me(path, [path], request)
        return (youtube_vis if "videos" in content and "images" not in content else coco)(path, content, request)
    got = "no folder, .json, .npz, .pkl or .npy" if path.exists() else "no such file or folder"
    convert = next((text for suffixes, text in CONVERT.items() if path.suffix.lower() in suffixes.split()), "")
    raise InputError(path, "", got, f"masks: a folder of PNG, COCO's JSON, arrays, or SAM 2's video_segments{convert}")


def _folder(folder: Path, request: MaskRequest) -> MaskReader:
    """Open a folder of things, or of files of one frame each."""
    things = [sub.name for sub in files.folders_in(folder) if files.listed(sub, (".png",))]
    images = {suffix: files.listed(folder, (suffix,)) for suffix in (".png", ".npy", ".npz", ".json", ".txt")}
    if CVAT in things and (folder / LABELS).is_file():
        return _cvat(folder, request)
    if things and ("object" in things or not images[".png"]):
        return _things(folder, request, things)
    if images[".png"]:
        return _labels(folder, images[".png"], request)
    if images[".npy"] or images[".npz"]:
        return npy_folder(folder, images[".npy"] or images[".npz"], request)
    if images[".json"]:
        return label_me(folder, images[".json"], request)
    if images[".txt"]:
        return yolo(folder, [path for path in images[".txt"] if path.stem not in ("classes", "labels")], request)
    other = next((path.name for path in files.listed(folder, LOSSY)), None)
    got = f"no mask of any of {len(request.frames)} frames"
    got += f"; {files.plain(other)} is no PNG, and has no labels" if other else ""
    raise InputError(folder, "", got, f"a PNG for each frame, named like it, as {files.plain(request.frames[0])}.png")


def _things(folder: Path, request: MaskRequest, things: Sequence[str]) -> MaskReader:
    """Masks of a thing each in folders of their names; a frame is known where each of these has it.

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
            which = f"missing --{kind}" if wrong is None else f"unknown --{kind} {wrong!r}"
            there = ", ".join(files.plain(name) for name in things[:MOST_NAMED])
            raise UsageError(f"{which}; choose from the folders in {folder}: {there}")
    notes = Counter[str]()
    images = {kind: [_images(folder / name, request, notes) for name in names] for kind, names in chosen.items()}
    known = set.intersection(*({*frames} for each in images.values() for frames, _ in each))
    if not known:
        raise request.nothing(folder, things)
    loads = {kind: [sharpened(load, frames, notes) for frames, load in each] for kind, each in images.items()}

    def of_thing(path: Path, labels: Int[ndarray, "h w"]) -> Bool[ndarray, "H W"]:
        if len(several := areas(labels)) > 1:
            got = f"several values, {', '.join(map(label_name, several[:MOST_NAMED]))}"
            raise InputError(path, "labels", got, f"one in a folder of a thing; else name {path.parent}, and --object")
        return request.resized(labels != 0, notes)

    def read(n: int) -> FrameMasks:
        visible, hidden, hand = (
            union([of_thing(*load(n)) for load in loads[kind]], request.size) for kind in ("object", "ignore", "hand")
        )
        return without_object(visible, hidden, hand if loads["hand"] else None)

    return MaskReader(folder, read, known, notes=notes)


def _cvat(folder: Path, request: MaskRequest) -> MaskReader:
    """Masks as CVAT exports them, whose labels have names. Raises ``UsageError`` for other names."""
    lines = [line.split(":") for line in files.read_text(folder / LABELS).splitlines() if not line.startswith("#")]
    values = {line[0]: line[1] for line in lines if len(line) > 1}
    try:
        colours = {name: "#{:02x}{:02x}{:02x}".format(*map(int, value.split(","))) for name, value in values.items()}
    except (ValueError, IndexError) as error:
        raise InputError(folder / LABELS, "", f"no colours of labels ({error})", "label:red,green,blue::") from error
    names = [name for name, colour in colours.items() if colour != "#000000"]
    chosen = {"object": request.object or tuple(names[:1]), "ignore": request.ignore, "hand": request.hand}
    wrong = next((each for each in chosen.items() if {*each[1]} - {*colours, *colours.values()}), None)
    if wrong is not None or (len(names) > 1 and not request.object) or not names:
        which = "missing --object" if wrong is None else f"unknown --{wrong[0]} {' '.join(wrong[1])}"
        raise UsageError(f"{which}; choose from the labels of {folder}: {', '.join(map(files.plain, names))}")
    by_colour = {kind: tuple(colours.get(name, name) for name in texts) for kind, texts in chosen.items()}
    source = folder / CVAT
    return _labels(source, files.listed(source, (".png",)), replace(request, **by_colour))  # type: ignore[arg-type]


def _labels(folder: Path, paths: Sequence[Path], request: MaskRequest) -> MaskReader:
    choose, notes = LabelChoice(request), Counter[str]()
    frames, load = _images(folder, request, notes, paths)
    sharp = sharpened(load, frames, notes, choose.object, bool(choose.ignore or choose.hand))

    def read(n: int) -> FrameMasks:
        path, labels = sharp(n)
        return choose(path, request.resized(labels, notes))

    return MaskReader(folder, read, frames, choose.others, choose.unmet, notes)


def _images(
    folder: Path, request: MaskRequest, notes: Counter[str], paths: Sequence[Path] | None = None
) -> tuple[list[int], Load]:
    """Return the frames that have a PNG, and a loader. Raises ``InputError`` for two of a frame."""
    paths = files.listed(folder, (".png",)) if paths is None else paths
    rows = request.places(folder, [path.name for path in paths])

    def load(n: int) -> tuple[Path, Int[ndarray, "h w"]]:
        path = paths[rows[n]]
        return path, read_labels(path, request.check_size(path, "size", png_size(path, MOST_PIXELS)), notes)

    return sorted(rows), load
