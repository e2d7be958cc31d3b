"""Arrays of untrusted ``.npz`` files and zip archives, read within limits and checked.

No pickle is ever run, and sizes are checked before memory is taken.
"""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray

from getagrip.errors import GetagripError, InputError
from getagrip.io import files, plugins

MAX_ARCHIVE_MEMBERS = 100_000
ZIP_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compressions with a decompressor that can be limited: with others, 1 kB may unpack to gigabytes at once."""
ZIP_ENTRY_MAGIC = b"PK\x01\x02"
"""Start of each entry of an archive's directory."""
ZIP_SEARCH_BYTES = 2**20
"""Bytes of an archive searched at once."""
MAX_NPZ_BYTES = 2**29
"""Limit of a file's unpacked arrays together, and of each array converted to 8 bytes a number."""
MAX_LIST_DEPTH = 8
"""Levels of nested lists of numbers."""
MAX_NAME_CHARS = 1000
"""Length of a name in a list: in an array, every name takes as much memory as the longest."""
MAX_ARRAY_NAMES = 2**20
"""Texts or frame numbers in an array: as Python objects, each takes many times the memory."""


def open_archive_bytes(path: Path | str, content: bytes) -> zipfile.ZipFile:
    """Open an archive in memory. Raises ``InputError`` for too many members, and any error of ``zipfile``."""
    return _open_checked_archive(path, io.BytesIO(content))


@contextmanager
def open_archive_file(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive in a file. Raises as ``open_archive_bytes`` does, and ``OSError``."""
    with path.open("rb") as stream, _open_checked_archive(path, stream) as found:
        yield found


def _open_checked_archive(path: Path | str, stream: BinaryIO) -> zipfile.ZipFile:
    """Open an archive unless it has too many members: ``zipfile`` keeps all of them in memory."""
    entries, end = 0, b""
    while piece := stream.read(ZIP_SEARCH_BYTES):
        entries += (end + piece).count(ZIP_ENTRY_MAGIC)
        end = piece[1 - len(ZIP_ENTRY_MAGIC) :]
        if entries > MAX_ARCHIVE_MEMBERS:
            got = f"an archive of more than {MAX_ARCHIVE_MEMBERS} members"
            raise InputError(path, "", got, f"at most {MAX_ARCHIVE_MEMBERS}")
    return zipfile.ZipFile(stream)


def open_archive_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> IO[bytes]:
    """Open a member as a stream. Raises any error of ``zipfile``."""
    if member.compress_type not in ZIP_COMPRESSIONS:
        raise NotImplementedError(f"{member.filename!r} is packed in another way than by deflate")
    return archive.open(member)


def read_archive_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Read a member up to its stated size, its checksum verified. Raises any error of ``zipfile``.

    ``ZipFile.read`` would unpack up to 1 GB before it compares the size.
    """
    with open_archive_member(archive, member) as stream:
        return stream.read(member.file_size)


def read(path: Path, wanted: Callable[[str], bool]) -> dict[str, Shaped[ndarray, "..."]]:
    """Read the arrays of an ``.npz`` file whose names are ``wanted``.

    Raises ``InputError`` for damaged files, arrays of Python objects, and more than ``MAX_NPZ_BYTES`` unpacked.
    """
    content = files.read_bytes(path)
    out: dict[str, ndarray] = {}
    try:
        with open_archive_bytes(path, content) as archive:
            members = [m for m in archive.infolist() if m.filename.endswith(".npy") and wanted(m.filename[:-4])]
            unpacked = sum(member.file_size for member in members)
            if unpacked > MAX_NPZ_BYTES:
                raise InputError(path, "", f"arrays of {unpacked} bytes", f"at most {MAX_NPZ_BYTES}")
            for member in members:
                key = member.filename[:-4]
                if key in out:
                    raise InputError(path, key, "the array twice", "each array once")
                out[key] = array = parse_npy(path, key, read_archive_member(archive, member))
                if array.dtype.kind in "US" and array.size > MAX_ARRAY_NAMES:
                    raise InputError(path, key, f"{array.size} texts", f"at most {MAX_ARRAY_NAMES}")
    except InputError:
        raise
    except Exception as error:  # zipfile and its decompressors raise many types
        raise InputError(path, "", f"a file that does not unpack ({error})", "an .npz file") from error
    return out


def parse_npy(path: Path, key: str, content: bytes) -> Shaped[ndarray, "..."]:
    """Parse the bytes of an ``.npy`` file, also one with a forged header. Raises ``InputError``."""
    stream = io.BytesIO(content)
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    try:
        shape, fortran, dtype = headers[np.lib.format.read_magic(stream)](stream)
    except Exception as error:  # the header is a Python literal: its parser raises many types
        raise InputError(path, key, f"an array whose header does not parse ({error})", "a .npy array") from error
    if dtype.hasobject:
        raise InputError(path, key, "an array of Python objects", "an array of numbers")
    start, count = stream.tell(), math.prod(shape)  # exact integers: a hostile header must not overflow
    if min(shape, default=1) < 0 or count * dtype.itemsize != len(content) - start:
        got = f"{len(content) - start} bytes for the shape {shape}"
        raise InputError(path, key, got, f"{count * dtype.itemsize} bytes")
    if count == 0:
        return np.zeros(shape, dtype)
    return np.frombuffer(content, dtype, offset=start).reshape(shape, order="F" if fortran else "C")


def from_lists(value: object) -> Shaped[ndarray, "..."] | None:
    """Convert nested lists of numbers, as in JSON and pickles, to an array; arrays stay unchanged.

    None for anything else, rows of different lengths included. Every item is checked before memory is taken: numpy
    would convert all items to texts of the longest's length if one is a text. Arrays in lists count in full.
    """
    if isinstance(value, ndarray):
        return value
    size, waiting = 0, [(value, 0)]
    while waiting:
        item, depth = waiting.pop()
        if isinstance(item, list | tuple) and depth < MAX_LIST_DEPTH:
            waiting += [(inner, depth + 1) for inner in item]
        elif isinstance(item, ndarray) and item.dtype.kind in "fiub":
            size += item.size
        elif not isinstance(item, float | int | np.number | np.bool_):
            return None
        if size + len(waiting) > MAX_NPZ_BYTES // 8:
            return None
    try:
        return np.array(value)
    except (ValueError, OverflowError):  # rows of different lengths
        return None


def array_from_names(value: object) -> Shaped[ndarray, "n"] | None:
    """Convert a list or array of short names, or of whole numbers from 0 on, to an array.

    None for anything else, and for more than ``MAX_ARRAY_NAMES``.
    """
    if isinstance(value, list):
        value = np.array(value) if all(map(_is_name, value)) else None
    if not isinstance(value, ndarray) or value.ndim != 1 or value.dtype.kind not in "Uiu":
        return None
    if len(value) > MAX_ARRAY_NAMES:
        return None
    if value.dtype.kind == "i" and value.size and value.min() < 0:
        return None
    try:
        value.tolist()
    except ValueError:  # invalid code points
        return None
    return value


def _is_name(value: object) -> bool:
    return type(value) is int or (isinstance(value, str) and len(value) <= MAX_NAME_CHARS)


def floats(
    path: Path, arrays: dict[str, ndarray], key: str, shape: tuple[int, ...], kinds: str = "f"
) -> Float[ndarray, "..."]:
    """Return a finite array of ``shape``, -1 for any length > 0, as 64-bit floats. Raises ``InputError``."""
    array = _check_shaped(path, arrays, key, shape, kinds, "floating-point numbers")
    with np.errstate(over="ignore"):
        array = array.astype(float)
    finite = np.isfinite(array)
    if not finite.all():
        first = np.unravel_index(np.argmin(finite), finite.shape)
        bad = f"{np.count_nonzero(~finite)} NaN or infinite numbers (first at {[int(i) for i in first]})"
        raise InputError(path, key, bad, "finite numbers")
    return array


def indices(
    path: Path, arrays: dict[str, ndarray], key: str, vertices: int, shape: tuple[int, ...]
) -> Int[ndarray, "..."]:
    """Return an array of vertex ids of ``shape``, -1 for any length > 0. Raises ``InputError``."""
    array = _check_shaped(path, arrays, key, shape, "iu", "integers")
    if array.min() < 0 or array.max() >= vertices:
        bad = array.min() if array.min() < 0 else array.max()
        raise InputError(path, key, f"the vertex id {bad}", f"ids of the hand's vertices, 0 to {vertices - 1}")
    return array.astype(np.int64)


def frame_numbers(path: Path, arrays: dict[str, ndarray]) -> tuple[int, ...] | None:
    """Return the frame numbers of a hand file, each unique; None without ``frames``. Raises ``InputError``."""
    if "frames" not in arrays:
        return None
    array = arrays["frames"]
    if array.dtype.kind not in "iu" or array.ndim != 1 or not 0 < len(array) <= MAX_ARRAY_NAMES:
        expected = f"the numbers of 1 to {MAX_ARRAY_NAMES} frames"
        raise InputError(path, "frames", f"{files.printable(str(array.dtype))} of shape {array.shape}", expected)
    if array.min() < 0:
        raise InputError(path, "frames", f"the number {array.min()}", "numbers of frames, from 0 on")
    numbers = tuple(array.tolist())
    if len({*numbers}) < len(numbers):
        raise InputError(path, "frames", "a frame twice", "each frame's number once")
    return numbers


def _check_shaped(
    path: Path, arrays: dict[str, ndarray], key: str, shape: tuple[int, ...], kinds: str, what: str
) -> Shaped[ndarray, "..."]:
    """Return an array of the expected kind and shape, not too large at 8 bytes a number. Raises ``InputError``."""
    if key not in arrays:
        raise InputError(path, key, "no such array", f"an array of {what}")
    array = arrays[key]
    if array.dtype.kind not in kinds:
        raise InputError(path, key, f"the type {files.shorten_value(str(array.dtype))}", what)
    fits = len(array.shape) == len(shape) and all(
        have == want or (want == -1 and have > 0) for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        expected = tuple("any" if length == -1 else length for length in shape)
        raise InputError(path, key, f"the shape {array.shape}", f"({', '.join(map(str, expected))})")
    if 8 * array.size > MAX_NPZ_BYTES:
        raise InputError(path, key, f"{array.size} numbers", f"at most {MAX_NPZ_BYTES // 8}")
    return array


def write(path: Path, content: dict[str, Shaped[ndarray, "..."]]) -> None:
    """Write a compressed ``.npz`` file; the same arrays give the same bytes."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for key, array in content.items():
            member = zipfile.ZipInfo(f"{key}.npy")  # dated 1980
            member.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(member, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)
    files.write_bytes(path, whole.getvalue())


@contextmanager
def convert_to_input_errors(path: Path) -> Iterator[None]:
    """Turn numpy's warnings, and all errors except ``OSError``, into ``InputError``: a file's content causes them."""
    try:
        with warnings.catch_warnings(), plugins.convert_base_exceptions():
            for warning in (RuntimeWarning, np.exceptions.ComplexWarning):
                warnings.simplefilter("error", warning)
            yield
    except (GetagripError, OSError):
        raise
    except Exception as error:
        kind = "" if isinstance(error, Warning) else f"{type(error).__name__}: "
        got = f"content that cannot be right ({kind}{error})"
        raise InputError(path, "", got, "as its program writes it") from error
