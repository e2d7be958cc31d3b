"""Depth images of sensors and networks, and their import into a clip. ``DEPTH_FORMATS`` has an entry for each program.

Layouts of all formats: a file for each frame, with its name or number (PNG, ``.npy``, ``.npz``, EXR); a folder for each
frame with a file ``depth`` of these types; or one ``.npz`` or ``.npy`` of all frames (N, H, W), in order or with names
in ``frames``. Depth images cover the whole image, at any resolution.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from getagrip.clip.depth import (
    DEPTH_KEY,
    DEPTH_SUFFIXES,
    MAX_DEPTH_PIXELS,
    MAX_DEPTH_UNIT_M,
    MAX_METRIC_DEPTH_M,
    MIN_DEPTH_UNIT_M,
    MIN_SURROUNDINGS_DEPTH_RATIO,
    DepthSource,
    check_depth_array,
    check_depth_shape,
    depth_file,
    depth_source_fields,
    read_depth_image,
    read_png16,
    surroundings_depth_ratio,
)
from getagrip.clip.match_frames import (
    check_frame_numbers,
    matching_names,
    number_of,
    rows_in_order,
    rows_of_frames,
    stem_of,
)
from getagrip.clip.read import ClipHeader
from getagrip.clip.views import ViewHeader
from getagrip.errors import InputError, UsageError, unknown_choice_error
from getagrip.io import arrays, files
from getagrip.io.files import printable, shorten_value
from getagrip.io.images import png_size, read_colour_png, write_depth

DEPTH_STACK_KEYS = ("depths",)
"""Other names of the array of all depth images (MegaSaM)."""
HO3D_DEPTH_UNIT_M = 0.00012498664727900177
"""Metres per unit of HO-3D's depth (``read_depth_img`` of its authors' code)."""
DEPTH_FOCAL_TOLERANCE = 0.15
"""Maximum relative difference of a network's focal length from the clip's."""


def _decode_ho3d_depth(path: Path) -> Float[ndarray, "h w"]:
    """HO-3D's colours: red is the low byte, green the high one."""
    colours = read_colour_png(path, png_size(path, MAX_DEPTH_PIXELS)).astype(float)
    return colours[..., 0] + 256.0 * colours[..., 1]


@dataclass(frozen=True)
class DepthFormat:
    """A program's depth files.

    Attributes:
        takes: the files in a few words, for the command's help.
        source: the meaning of the numbers; ``unit`` is the unit of PNG.
        read_png: the reader of PNG.
        floats: unit of numbers with fractions [m].
    """

    takes: str
    source: DepthSource
    read_png: Callable[[Path], Float[ndarray, "h w"]] = read_png16
    floats: float = 1.0


def _sensor_format(takes: str, unit: float = 0.001, error: float = np.nan, **more: object) -> DepthFormat:
    return DepthFormat(takes, DepthSource("metric", "sensor", unit, error), **more)  # type: ignore[arg-type]


DEPTH_FORMATS: Mapping[str, DepthFormat] = {
    "realsense": _sensor_format("16-bit PNG in mm, aligned to the colour images"),
    "dexycb": _sensor_format("aligned_depth_to_color_*.png"),
    "ho3d": _sensor_format("its colour-coded PNG", HO3D_DEPTH_UNIT_M, read_png=_decode_ho3d_depth),
    "arkit": _sensor_format("of an iPhone's LiDAR: PNG in mm, or arrays in metres", error=0.01),
    "depth-anything-3": DepthFormat("exports/npz/results.npz, or mini_npz", DepthSource("clip", "network")),
    "moge": DepthFormat("--maps: a folder for each image, with depth.exr", DepthSource("frame", "network")),
    "unidepth": DepthFormat("its depth as .npy or .npz", DepthSource("metric", "network")),
    "megasam": DepthFormat("its *_sgd_cvd_hr.npz", DepthSource("clip", "network")),
    "depth-pro": DepthFormat("an .npz for each image", DepthSource("metric", "network")),
}
"""Formats by name; the command's ``--scale`` and ``--error`` override a format's own."""


@dataclass(frozen=True)
class DepthReader:
    """The depth images of a clip's frames, in the format's unit.

    Attributes:
        read: return the file, image and unit of a frame, by its index; raises ``InputError``.
        known: indices of the frames with an image.
        focal: focal length assumed by the program [widths of the image]; NaN if not stated.
    """

    read: Callable[[int], tuple[Path, Float[ndarray, "h w"], float]]
    known: Sequence[int]
    focal: float = field(default=np.nan)


def open_depth(
    path: Path, name: str, frames: Sequence[str], ask_first: str, images: str = "", counted: bool = False
) -> DepthReader:
    """Open the depth images of some frames in the format ``name``.

    ``images`` is a pattern that selects among several images of a frame. With ``counted`` (``--first``), frames are
    numbered as the files count them. Raises ``InputError`` without images, ``UsageError`` for an unknown format and for
    files apparently counted from another start (``check_frame_numbers``).
    """
    if name not in DEPTH_FORMATS:
        raise unknown_choice_error("--from", name, DEPTH_FORMATS)
    with arrays.convert_to_input_errors(path):
        return _open_depth_files(path, name, frames, ask_first, images, counted)


def _open_depth_files(
    path: Path, name: str, frames: Sequence[str], ask_first: str, images: str, counted: bool
) -> DepthReader:
    form = DEPTH_FORMATS[name]
    exported = [path / "exports" / kind / "results.npz" for kind in ("npz", "mini_npz")]
    paths = [one for one in (path, *exported) if one.is_file()][:1]
    paths = paths or (_list_depth_images(path) if path.is_dir() else [])
    if not paths:
        got = "no depth image" if path.exists() else "no such file or folder"
        raise InputError(path, "", got, f"files of {name}: {form.takes}")
    if len(paths) == 1 and paths[0].suffix.lower() in {".npz", ".npy"}:
        stored = _read_depth_arrays(paths[0])
        if number_of(paths[0].stem) is None or (DEPTH_KEY in stored and stored[DEPTH_KEY].squeeze().ndim > 2):
            if images:
                raise UsageError(f"--images cannot be used with {paths[0]}, an array of all images")
            return _open_depth_stack(paths[0], stored, form, frames, ask_first, counted)
    names = [each.parent.name if each.stem == DEPTH_KEY else each.name for each in paths]
    rows = _match_depth_rows(path, names, frames, ask_first, images)

    def read(n: int) -> tuple[Path, Float[ndarray, "h w"], float]:
        of_frame = paths[rows[n]]
        if of_frame.suffix.lower() == ".png":
            return of_frame, form.read_png(of_frame), form.source.unit
        with arrays.convert_to_input_errors(of_frame):
            image = read_depth_image(of_frame)
        # Whole numbers are a sensor's PNG, saved as an array.
        whole = image.max() > MAX_METRIC_DEPTH_M and np.array_equal(image, np.floor(image))
        return of_frame, image, form.source.unit if whole else form.floats

    return DepthReader(read, sorted(rows), _focal_of_view(paths[rows[min(rows)]]))


def _list_depth_images(folder: Path) -> list[Path]:
    inside = [one for sub in files.folders_in(folder) for one in files.list_files(sub, pattern=f"{DEPTH_KEY}.*")]
    alone = files.list_files(folder)
    alone = [one for one in alone if DEPTH_KEY in one.stem.lower()] or alone  # DexYCB's labels are arrays beside it
    for some in (inside, alone):
        for suffix in reversed(DEPTH_SUFFIXES):  # numbers with fractions rather than pictures of them
            found = [one for one in some if one.suffix.lower() == suffix]
            if found:
                return found
    return []


def _read_depth_arrays(path: Path) -> dict[str, Shaped[ndarray, "..."]]:
    """Read the arrays of depth, frames and camera in a file. Raises ``InputError``."""
    if path.suffix.lower() == ".npy":
        return {DEPTH_KEY: arrays.parse_npy(path, "", files.read_bytes(path, arrays.MAX_NPZ_BYTES))}
    stored = arrays.read(path, {DEPTH_KEY, *DEPTH_STACK_KEYS, "frames", "intrinsics", "intrinsic"}.__contains__)
    key = next((key for key in (DEPTH_KEY, *DEPTH_STACK_KEYS) if key in stored), None)
    return stored if key is None else {**stored, DEPTH_KEY: stored[key]}


def _open_depth_stack(
    path: Path, stored: Mapping[str, ndarray], form: DepthFormat, frames: Sequence[str], ask_first: str, counted: bool
) -> DepthReader:
    if DEPTH_KEY not in stored:
        raise InputError(path, DEPTH_KEY, "no such array", f"the depth of all frames, or {DEPTH_STACK_KEYS[0]}")
    depth = stored[DEPTH_KEY]
    if depth.ndim == 4 and 1 in depth.shape[1::2]:
        depth = depth[:, 0] if depth.shape[1] == 1 else depth[..., 0]
    depth = depth[None] if depth.ndim == 2 else depth
    if depth.ndim != 3:
        got = f"{depth.dtype} of shape {depth.shape}"
        raise InputError(path, DEPTH_KEY, got, "numbers of shape (frames, height, width)")
    if "frames" in stored:
        names = arrays.array_from_names(stored["frames"])
        if names is None or len(names) != len(depth):
            got = shorten_value(stored["frames"])
            raise InputError(path, "frames", got, f"{len(depth)} names or numbers of frames")
        rows = _match_depth_rows(path, [str(name) for name in names], frames, ask_first, "")
    else:
        rows = rows_in_order(len(depth), frames, path, "depth image", counted, ask_first or "--first")
    focal, K = np.nan, stored.get("intrinsics", stored.get("intrinsic"))
    if K is not None and K.ndim in (2, 3) and K.shape[-2:] == (3, 3) and K.dtype.kind == "f" and len(K):
        focal = float(np.median(K[..., 0, 0])) / depth.shape[2]
    unit = form.floats if depth.dtype.kind == "f" else form.source.unit
    return DepthReader(lambda n: (path, check_depth_array(path, DEPTH_KEY, depth[rows[n]]), unit), sorted(rows), focal)


def _match_depth_rows(
    path: Path, names: Sequence[str], frames: Sequence[str], ask_first: str, images: str
) -> dict[int, int]:
    stems = [stem_of(names[row]) for row in matching_names(names, images)]
    check_frame_numbers(frames, stems, path, "depth image", ask_first)
    rows = rows_of_frames(names, frames, path, "depth image", images, "--images")
    if not rows:
        some = ", ".join(map(printable, names[:2]))
        got = f"no depth image of any of {len(frames)} frames among {some}"
        raise InputError(path, "", got, f"names like those of frames, {printable(frames[0])}")
    return rows


def _focal_of_view(path: Path) -> float:
    """Read the focal length [widths of the image] from MoGe's ``fov.json`` or MegaSaM's ``fov``; NaN without either."""
    beside, angle = path.with_name("fov.json"), np.array(np.nan)
    if beside.is_file():
        angle = np.asarray(files.read_json(beside).get("fov_x"))
    elif path.suffix == ".npz":
        angle = arrays.read(path, {"fov"}.__contains__).get("fov", angle)
    if angle.size != 1 or angle.dtype.kind not in "fi" or not 0.0 < angle.item() < 180.0:
        return np.nan
    return float(0.5 / np.tan(np.radians(angle.item()) / 2.0))


def check_focal_length(reader: DepthReader, source: DepthSource, K: Float[ndarray, "T 3 3"], width: int) -> str:
    """Describe a difference between a program's and the clip's field of view; empty without one."""
    ratio = reader.focal * width / float(np.median(K[:, 0, 0]))
    if not abs(ratio - 1.0) > DEPTH_FOCAL_TOLERANCE:
        return ""
    off, else_by = ("distances", ", or import with --scale clip") if source.scale == "metric" else ("relief", "")
    said = f"the program assumed {ratio:.2f} times the clip's focal length: its {off} may be off as much; "
    return f"{said}give it the clip's{else_by}"


def check_depth_direction(
    reader: DepthReader, masks: Mapping[int, tuple[ndarray, ndarray]], source: DepthSource
) -> str:
    """Describe numbers that grow towards the camera, as disparities do; empty if they do not.

    ``masks`` are the masks of the object and of its occluders, in the frames to check. Raises ``InputError`` for a
    network's numbers; a sensor's, in a known unit, may be right.
    """
    each, path = list[float](), Path()
    for n, (seen, others) in masks.items():
        path, z, _ = reader.read(n)
        sides = zip(z.shape, seen.shape, strict=True)
        rows, columns = (((np.arange(few) + 0.5) * many / few).astype(int) for few, many in sides)
        each.append(surroundings_depth_ratio(z, seen[rows[:, None], columns], others[rows[:, None], columns]))
    known = np.array(each)[np.isfinite(each)]
    if not len(known) or np.median(known) >= MIN_SURROUNDINGS_DEPTH_RATIO:
        return ""
    got = f"numbers around the object of {np.median(known):.2f} times those on it, in {len(known)} frames looked at"
    if source.source == "sensor":
        return f"{got}: is something nearer than the object around it, or are these disparities (inverse depth)?"
    expected = "distances, larger behind the object; these are disparities (inverse depth): use a model of depth"
    raise InputError(path, "", got, f"{expected}, as Depth Anything 3, MoGe or UniDepth")


def select_depth_source(name: str, scale: str | None, unit: float | None, error: float | None) -> DepthSource:
    """Return a format's source of depth, with the values that the user states. Raises ``UsageError``."""
    source = DEPTH_FORMATS[name].source
    if error is not None and not 0.0 < error < 1.0:
        raise UsageError(f"--error must be a share of the distance, above 0 and below 1 (got {error})")
    if unit is not None and not MIN_DEPTH_UNIT_M <= unit <= 1e3:
        raise UsageError(f"--unit must be metres that 1 stands for, {MIN_DEPTH_UNIT_M:g} to 1000 (got {unit})")
    return DepthSource(
        scale or source.scale,  # type: ignore[arg-type]
        source.source,
        source.unit if unit is None else unit,
        source.error if error is None else error,
    )


MAX_UINT16_DEPTH = 65534
"""Maximum number of a 16-bit image that is a distance."""
MEDIAN_UINT16_DEPTH = 16384
"""Written median of the first image with depth, if its numbers have fractions."""


def add_depth(
    header: ClipHeader | ViewHeader,
    reader: DepthReader,
    source: DepthSource,
    said: str,
    unit: float | None = None,
    overwrite: bool = False,
) -> None:
    """Write ``depth/`` of a clip or a view, its source and provenance (``said``) into its JSON. Raises ``InputError``.

    ``unit`` is the files' unit, where the user states it [m].
    """
    older = (depth_file(header.folder, frame) for frame in header.frames if overwrite)
    there = tuple(Path(name).name for name in older if name is not None)
    whence = header.fields["provenance"] | {DEPTH_KEY: said}
    with files.new_folder(header.folder / DEPTH_KEY, there) as new:
        found = _write_depth_images(reader, header.frames, header.size, unit, new)
        with files.new_file(header.path) as part:
            stored = depth_source_fields(replace(source, unit=found))
            files.write_json(part, header.changed({DEPTH_KEY: stored, "provenance": whence}))


def _write_depth_images(
    reader: DepthReader, frames: Sequence[str], size: tuple[int, int], stated: float | None, folder: Path
) -> float:
    """Write the images, one at a time in memory, and return the unit of the written numbers. Whole numbers stay."""
    unit, written, path, shape = 0.0, 0.0, folder, (0, 0)
    for n in reader.known:
        path, image, one = reader.read(n)
        check_depth_shape(path, image, size)
        if shape not in ((0, 0), image.shape):
            got = f"{image.shape[1]} x {image.shape[0]} pixels"
            raise InputError(path, "size", got, f"{shape[1]} x {shape[0]}, as the first image")
        shape = image.shape
        with arrays.convert_to_input_errors(path):
            one = one if stated is None else stated
            if not unit and image.any():
                whole = bool(np.all(image == np.floor(image))) and image.max() <= MAX_UINT16_DEPTH
                middle = float(np.median(image[image > 0.0]))
                unit = one if whole else one * (middle / MEDIAN_UINT16_DEPTH)
                if not MIN_DEPTH_UNIT_M <= unit <= MAX_DEPTH_UNIT_M:
                    raise InputError(path, "", f"distances about {one * middle:g} m", "distances near a camera")
            whole_numbers = np.rint(image * (one / (unit or one)))
            whole_numbers[whole_numbers > MAX_UINT16_DEPTH] = 0.0  # farther than anything near a hand
            written += float(whole_numbers.sum())
        write_depth(folder / f"{frames[n]}.png", whole_numbers.astype(np.uint16))
    if not written:
        raise InputError(path, "", "0 in all images", "distances, 0 for none")
    return unit
