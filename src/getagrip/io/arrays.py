"""Arrays of untrusted ``.npz`` files, checked. No pickle is ever run; sizes are checked before memory is taken.

Untrusted zip archives: neither listing their members nor unpacking these takes more memory than it should.

Numbers of strangers' files: what they make numpy warn of, and Python raise, is an error that names the file.
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
"""Compressions whose decompressors can be limited: 1 kB of the others may be gigabytes at once."""
ZIP_ENTRY_MAGIC = b"PK\x01\x02"
"""Begins each entry of an archive's list."""
ZIP_SEARCH_BYTES = 2**20
"""Bytes of an archive that are searched at once."""


def open_archive_bytes(path: Path | str, content: bytes) -> zipfile.ZipFile:
    """Open an archive in memory. Raises ``InputError`` for too many members, and what ``zipfile`` raises."""
    return _open_checked_archive(path, io.BytesIO(content))


@contextmanager
def open_archive_file(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive in a file. Raises as ``open_archive_bytes`` does, and ``OSError``."""
    with path.open("rb") as stream, _open_checked_archive(path, stream) as found:
        yield found


def _open_checked_archive(path: Path | str, stream: BinaryIO) -> zipfile.ZipFile:
    """Open the archive unless it has too many members: ``zipfile`` keeps all of them in memory."""
    entries, end = 0, b""
    while piece := stream.read(ZIP_SEARCH_BYTES):
        entries += (end + piece).count(ZIP_ENTRY_MAGIC)
        end = piece[1 - len(ZIP_ENTRY_MAGIC) :]
        if entries > MAX_ARCHIVE_MEMBERS:
            raise InputError(
                path, "", f"an archive of more than {MAX_ARCHIVE_MEMBERS} members", f"at most {MAX_ARCHIVE_MEMBERS}"
            )
    return zipfile.ZipFile(stream)


def open_archive_member(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> IO[bytes]:
    """Open a member, to be read piece by piece. Raises what ``zipfile`` raises."""
    if member.compress_type not in ZIP_COMPRESSIONS:
        raise NotImplementedError(f"{member.filename!r} is packed in another way than by deflate")
    return of.open(member)


def read_archive_member(of: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Read a member: as many bytes as the archive says, their checksum verified.

    Raises what ``zipfile`` raises.

    ``ZipFile.read`` unpacks up to 1 GB before it looks at how many there should be.
    """
    with open_archive_member(of, member) as stream:
        return stream.read(member.file_size)


MAX_NPZ_BYTES = 2**29
"""Limit in bytes of the arrays of one file, unpacked, and of each once its numbers have 8 bytes, as here."""
MAX_LIST_DEPTH = 8
"""Lists within lists of numbers."""
MAX_NAME_CHARS = 1000
"""Characters of a name in a list: as an array, all take as much as the longest."""
MAX_ARRAY_NAMES = 2**20
"""Texts, and numbers of frames, of an array: as Python's own, each takes many times as much."""


def read(path: Path, wanted: Callable[[str], bool]) -> dict[str, Shaped[ndarray, "..."]]:
    """Read the wanted arrays of an ``.npz`` file; others stay unread.

    Raises ``InputError`` for damaged files, for arrays of Python objects, and for files that unpack to more than
    ``MAX_NPZ_BYTES`` bytes.
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
    except Exception as error:  # zipfile and its decompressors raise whatever they meet
        raise InputError(path, "", f"a file that does not unpack ({error})", "an .npz file") from error
    return out


def parse_npy(path: Path, key: str, content: bytes) -> Shaped[ndarray, "..."]:
    """Parse the bytes of an ``.npy`` file, whose header may lie about its size. Raises ``InputError``."""
    stream = io.BytesIO(content)
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    try:
        shape, fortran, dtype = headers[np.lib.format.read_magic(stream)](stream)
    except Exception as error:  # the header is a Python literal: its parser raises many things
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
    """Convert nested lists of numbers, as JSON and pickles have them, to an array; arrays stay as they are.

    None for anything else, rows of different lengths included. Every item is looked at before memory is taken: numpy
    would make a text of each where one is a text, all of them as long as the longest. Arrays in lists count in full.
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
    """Convert a list of short names or of whole numbers from 0 on, or an array, to an array.

    None for anything else.

    None also for more than ``MAX_ARRAY_NAMES``.
    """
    if isinstance(value, list):
        value = np.array(value) if all(map(_is_name, value)) else None
    if (
        not isinstance(value, ndarray)
        or value.ndim != 1
        or value.dtype.kind not in "Uiu"
        or len(value) > MAX_ARRAY_NAMES
    ):
        return None
    if value.dtype.kind == "i" and value.size and value.min() < 0:
        return None
    try:
        value.tolist()
    except ValueError:  # code points that do not exist
        return None
    return value


def _is_name(value: object) -> bool:
    return type(value) is int or (isinstance(value, str) and len(value) <= MAX_NAME_CHARS)


def floats(
    path: Path, arrays: dict[str, ndarray], key: str, shape: tuple[int, ...], kinds: str = "f"
) -> Float[ndarray, "..."]:
    """Check that an array is finite and has the given shape, with -1 for any length above 0."""
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
    """Check that an array holds vertex indices."""
    array = _check_shaped(path, arrays, key, shape, "iu", "integers")
    if array.min() < 0 or array.max() >= vertices:
        bad = array.min() if array.min() < 0 else array.max()
        raise InputError(path, key, f"the vertex id {bad}", f"ids of the hand's vertices, 0 to {vertices - 1}")
    return array.astype(np.int64)


def frame_numbers(path: Path, arrays: dict[str, ndarray]) -> tuple[int, ...] | None:
    """Read the frame numbers of a hand file, each once; None where it has no ``frames``."""
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
    """Check that an array is there, of the expected kind and shape, and not too large at 8 bytes a number."""
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
            member = zipfile.ZipInfo(f"{key}.npy")  # dated 1980, not today
            member.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(member, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)
    files.write_bytes(path, whole.getvalue())


@contextmanager
def convert_to_input_errors(path: Path) -> Iterator[None]:
    """Turn warnings of numpy, and all errors but those of files, into ``InputError``: what a file holds causes them."""
    try:
        with warnings.catch_warnings(), plugins.convert_base_exceptions():
            for warning in (RuntimeWarning, np.exceptions.ComplexWarning):
                warnings.simplefilter("error", warning)
            yield
    except (GetagripError, OSError):
        raise
    except Exception as error:
        kind = "" if isinstance(error, Warning) else f"{type(error).__name__}: "
        raise InputError(
            path, "", f"content that cannot be right ({kind}{error})", "as its program writes it"
        ) from error
