"""Trackers' files as records, dictionaries of arrays, from any container and without running code; their recognition.

``recognise`` finds the tracker of some files by their names and keys.
"""

from __future__ import annotations

import glob
import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError, MissingOptionError, UsageError
from getagrip.io import arrays, files, pickles, plugins
from getagrip.io.files import shorten_value

if TYPE_CHECKING:
    from getagrip.readers.trackers.tracker import Tracker

Record = Mapping[str, Any]
"""Arrays, numbers, texts, lists and nested records by name."""
RECORD_SUFFIXES = (".npz", ".npy", ".json", ".pkl", ".pickle", ".pt", ".pth")
RECORD_MESH_SUFFIXES = (".obj",)
RECORD_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")
JOBLIB_COMPRESSION_MAGIC = (b"x\x01", b"x^", b"x\x9c", b"x\xda", b"\x1f\x8b", b"BZh", b"\xfd7zXZ")
"""First bytes of files compressed by joblib."""
HAWOR_CONVERSION_COMMAND = (
    "import joblib, numpy as np; keys = 'pred_trans pred_rot pred_hand_pose pred_betas pred_valid'.split(); "
    "np.savez('world_space_res.npz', **{k: np.asarray(v) for k, v in zip(keys, joblib.load('world_space_res.pth'))})"
)
"""Python code that converts HaWoR's hands in the world to ``.npz``."""
PEOPLE_KEY = "people"
"""Key of the records of several hands, for files that are a list of records."""
MAX_RECORD_BYTES = 256 * 2**20
"""Maximum unpacked size of a ``.npy`` or ``.pt`` file."""
MAX_RECORD_VALUE = 1e7
"""Maximum absolute value in pixels, metres or radians."""


def list_record_files(paths: Sequence[Path], layouts: Sequence[str] = ()) -> list[Path]:
    """List the files of some paths: files, folders (files of known suffixes), or patterns.

    ``layouts`` are patterns of a program's files below a folder, which take precedence. Raises ``InputError`` for paths
    without files.
    """
    known = (*RECORD_SUFFIXES, *RECORD_MESH_SUFFIXES)
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            files_of = _match_layouts(path, layouts) or files.list_files(path, known)
            if not files_of:
                expected = f"files of an estimator ({', '.join(known)})"
                raise InputError(path, "", "a folder without such a file", expected)
        elif path.exists():
            files_of = [path]
        else:  # a shell passes on a pattern that matches nothing
            files_of = sorted(Path(name) for name in glob.glob(str(path)) if not Path(name).name.startswith("."))
            got = "a pattern that matches no file" if glob.has_magic(str(path)) else "no such file or folder"
            if not files_of:
                raise InputError(path, "", got, "an estimator's files")
        found += files_of
    return found


def _match_layouts(folder: Path, layouts: Sequence[str]) -> list[Path]:
    """List the files of the first matching pattern below a folder, without links out of the folder."""
    root = folder.resolve()
    for pattern in layouts:
        found = files.list_files(folder, pattern=pattern)
        if files_of := [one for one in found if one.resolve().is_relative_to(root)]:
            return files_of
    return []


def read_tracker_record(path: Path) -> Record:
    """Read the content of a file.

    A ``.npy`` array becomes a record with the key ``joints``; a list of records, as of the hands in an image, one with
    the key ``PEOPLE_KEY``. Raises ``InputError`` for malformed, hostile and too large files, ``UsageError`` for ``.pt``
    without torch.
    """
    suffix = path.suffix.lower()
    if suffix in {".pkl", ".pickle", ".pt", ".pth"}:
        _check_not_joblib(path)
    if suffix == ".npz":
        return arrays.read(path, lambda _: True)
    if suffix == ".json":
        return _to_record(path, files.read_any_json(path, nan=True))
    if suffix in {".pkl", ".pickle"}:
        content = files.read_bytes(path, pickles.MAX_PICKLE_BYTES)
        return _to_record(path, pickles.read_pickle_content(path, content, "a pickled dictionary of arrays"))
    if suffix in {".pt", ".pth"}:
        return _read_torch(path)
    if suffix == ".npy":
        return {"joints": arrays.parse_npy(path, "", files.read_bytes(path, MAX_RECORD_BYTES))}
    raise InputError(path, "", f"the suffix {shorten_value(path.suffix)}", f"one of {', '.join(RECORD_SUFFIXES)}")


def _check_not_joblib(path: Path) -> None:
    """Raise ``InputError`` for a file of ``joblib.dump``, whatever its suffix."""
    content = files.read_bytes(path, MAX_RECORD_BYTES)
    if b"joblib.numpy_pickle" in content or content.startswith(JOBLIB_COMPRESSION_MAGIC):
        plain = f"{path.stem}_plain.pkl"
        line = f"import joblib, pickle; pickle.dump(joblib.load({path.name!r}), open({plain!r}, 'wb'))"
        line = HAWOR_CONVERSION_COMMAND if path.name == "world_space_res.pth" else line
        got = "a file of joblib.dump, which could run code when loaded"
        raise InputError(path, "", got, f"a plain file; where it was made, Python converts it: {line}")


def records_by_image(record: Record) -> Record:
    """Return a record whose keys are paths of images; an empty one for other records."""
    named = all(isinstance(key, str) and Path(key).suffix.lower() in RECORD_IMAGE_SUFFIXES for key in record)
    return record if named else {}


def _read_torch(path: Path) -> Record:
    """Read a file of ``torch.save`` with torch's safe reader, which refuses anything but tensors."""
    try:
        import torch
    except ModuleNotFoundError as error:
        raise UsageError(
            f"{path}: reading {path.suffix} files needs torch: {plugins.install_command('torch')}, or save the same "
            "dictionary as .npz where the file was made"
        ) from error
    content = files.read_bytes(path, MAX_RECORD_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:  # torch before 1.6 wrote other archives
            unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > MAX_RECORD_BYTES:
            raise InputError(path, "", f"tensors of {unpacked} bytes", f"at most {MAX_RECORD_BYTES}")
        loaded = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        pickles.check_bounded(path, loaded, "a dictionary of tensors")
    except InputError:
        raise
    except Exception as error:  # torch raises whatever its parsers meet
        reason = str(error).partition("\n")[0]
        raise InputError(path, "", f"a file that does not load safely ({reason})", "a dictionary of tensors") from error

    def plain(value: object) -> object:
        if isinstance(value, torch.Tensor):
            return value.detach().float().numpy() if value.is_floating_point() else value.detach().numpy()
        if isinstance(value, dict):
            return {str(key): plain(item) for key, item in value.items()}
        return [plain(item) for item in value] if isinstance(value, list | tuple) else value

    return _to_record(path, plain(loaded))


def _to_record(path: Path, content: object) -> Record:
    if isinstance(content, list) and all(isinstance(each, Mapping) for each in content):
        return {PEOPLE_KEY: content}
    if not isinstance(content, Mapping):
        got = "a list of other things" if isinstance(content, list) else f"a {type(content).__name__}"
        raise InputError(path, "", got, "a dictionary, or a list of one for each hand")
    return content


def record_numbers(
    path: Path, record: Record, key: str, *shapes: tuple[int, ...], of: str = ""
) -> Float[ndarray, "..."]:
    """Return a finite array in the first of some shapes that it fits, except for axes of length 1.

    A length of -1 stands for any length above 0. ``of`` names a nested record. Raises ``InputError``.
    """
    name = f"{of}.{key}" if of else key
    if key not in record:
        raise InputError(path, name, "no such key", "the key")
    value = arrays.from_lists(record[key])
    expected = " or ".join(str(shape).replace("-1", "any") for shape in shapes)
    if value is None or value.dtype.kind not in "fiub":
        raise InputError(path, name, shorten_value(record[key]), f"numbers of shape {expected}")
    for shape in shapes:
        if (fitted := _reshape_if_fits(value, shape)) is not None:
            array = arrays.floats(path, {name: fitted}, name, fitted.shape, kinds="fiub")
            if np.abs(array).max() > MAX_RECORD_VALUE:
                raise InputError(path, name, f"the number {array.flat[np.abs(array).argmax()]:.3g}", "plausible ones")
            return array
    raise InputError(path, name, f"the shape {value.shape}", f"{expected}")


def _reshape_if_fits(value: ndarray, shape: tuple[int, ...]) -> ndarray | None:
    """Return an array in a shape; None for another shape, except for axes of length 1."""
    if value.size == 0:
        return None
    squeezed = [n for n in value.shape if n != 1]
    for count in [1, *squeezed[:1]] if -1 in shape else [1]:
        wanted = tuple(count if n == -1 else n for n in shape)
        if [n for n in wanted if n != 1] == squeezed:
            return value.reshape(wanted)
    return None


def child(path: Path, record: Record, key: str) -> Record:
    """Return a nested record. Raises ``InputError``."""
    value = record.get(key)
    if not isinstance(value, Mapping):
        got = "no such key" if key not in record else shorten_value(value)
        raise InputError(path, key, got, "a dictionary")
    return value


def seen_joints(path: Path, record: Record, *leading: int) -> Float[ndarray, "*leading 21 3"] | None:
    """Read ``joints_2d`` of a record [px of the clip's images] with confidence, in this package's order.

    (21, 2), or (21, 3) with the confidence; ``joints_2d_confidence`` (21) is optional. Unseen joints are 0. None
    without the key. Raises ``InputError``.
    """
    if "joints_2d" not in record:
        return None
    value = arrays.from_lists(without_none(record["joints_2d"]))
    if value is None or value.dtype.kind not in "fiu" or value.shape not in {(*leading, 21, 2), (*leading, 21, 3)}:
        given = shorten_value(record["joints_2d"]) if value is None else f"the shape {value.shape}"
        raise InputError(path, "joints_2d", given, f"numbers of shape {(*leading, 21, 2)}, or 3 with the confidence")
    value = value.astype(float)
    there = np.isfinite(value).all(axis=-1)
    if np.abs(value[there]).max(initial=0.0) > MAX_RECORD_VALUE:
        raise InputError(path, "joints_2d", f"the number {np.abs(value[there]).max():.3g}", "pixels")
    confidence = np.ones(there.shape) if value.shape[-1] == 2 else value[..., 2]
    if "joints_2d_confidence" in record:
        confidence = record_numbers(path, record, "joints_2d_confidence", (*leading, 21))
    confidence = np.where(there, np.clip(confidence, 0.0, 1.0), 0.0)
    return np.concatenate([np.where(there[..., None], value[..., :2], 0.0), confidence[..., None]], axis=-1)


def without_none(value: object) -> object:
    """Replace null by NaN in nested lists."""
    if isinstance(value, list):
        return [without_none(item) for item in value]
    return np.nan if value is None else value


MAX_KEY_DEPTH = 5
"""Maximum depth of collected keys."""


@dataclass(frozen=True)
class Sample:
    """A file as an example of all files."""

    path: Path

    @cached_property
    def record(self) -> Record:
        """The file's record; empty for other formats."""
        return read_tracker_record(self.path) if self.path.suffix.lower() in RECORD_SUFFIXES else {}

    @cached_property
    def keys(self) -> frozenset[str]:
        """All keys of the file, including those of the first record in a list."""
        return frozenset(_collect_keys(self.record, MAX_KEY_DEPTH))

    def has(self, *keys: str) -> bool:
        """Return whether the file has all of some keys."""
        return self.keys.issuperset(keys)


def recognise(paths: Sequence[Path], trackers: Mapping[str, Tracker]) -> tuple[str, str]:
    """Return the name of the files' tracker, and a description of the files.

    Raises ``InputError`` for unknown files, with the names and keys of known ones, and ``UsageError`` for files that
    several trackers recognise.
    """
    found = {name: words for name, tracker in trackers.items() if (words := _describe_recognition(paths, tracker))}
    if len(found) == 1:
        return next(iter(found.items()))
    if found:
        each = ", ".join(f"--from {name} ({words})" for name, words in found.items())
        raise MissingOptionError(f"missing --from: {paths[0]} may be of several programs: {each}")
    keys = sorted(_first_sample(paths).keys) if paths[0].exists() else []
    got = f"keys {shorten_value(', '.join(keys))[1:-1]}" if keys else "names of no known program"
    known = "; ".join(f"{name}: {tracker.looks_for}" for name, tracker in trackers.items() if tracker.looks_for)
    raise InputError(paths[0], "", got, f"files of a known program, or --from NAME; looked for {known}")


def _describe_recognition(paths: Sequence[Path], tracker: Tracker) -> str:
    """Return a tracker's description of some files; empty for files of other programs."""
    try:
        found = list_record_files(paths, tracker.layouts)
    except InputError:
        if all(path.exists() for path in paths):
            return ""
        raise
    with arrays.convert_to_input_errors(found[0]):
        return tracker.recognises(Sample(found[0]))


def _first_sample(paths: Sequence[Path]) -> Sample:
    return Sample(next((path for path in paths if path.is_file()), None) or list_record_files(paths)[0])


def _collect_keys(content: object, depth: int) -> set[str]:
    """Collect keys to a depth; one record represents a list, or a dictionary by images."""
    if depth == 0:
        return set()
    if isinstance(content, list):
        return next((keys for one in content[:100] if (keys := _collect_keys(one, depth - 1))), set())
    if not isinstance(content, Mapping):
        return set()
    named = records_by_image(content)
    inner = list(named.values())[:100] if named else list(content.values())[:100]
    own = set() if named else {str(key) for key in content}
    return own.union(*(_collect_keys(one, depth - 1) for one in inner))
