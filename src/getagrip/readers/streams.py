"""Files too large for the memory, read part by part: members of a JSON object, and columns of Parquet files.

Not ijson: it bounds neither an item nor its depth (20 kB of nested brackets take it 1 GB), and reads a missing list as
an empty one. Parquet is bounded by what is unpacked: few bytes can hold any number of equal rows.
"""

from __future__ import annotations

import codecs
import json
import math
import re
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import arrays, plugins
from getagrip.io.files import printable, shorten_value

if TYPE_CHECKING:
    from pyarrow import Array, DataType, RecordBatch
    from pyarrow.parquet import ParquetFile

MAX_JSON_ITEM_CHARACTERS = 4 * 2**20
"""Maximum number of characters of one item; in memory, an item may take twenty times as much."""
MAX_JSON_STREAM_BYTES, MAX_JSON_STREAM_VALUES = 2**31, 10**6
"""Maximum size of a file, in unpacked bytes and in values: a small ``.zip`` may hold any number."""
JSON_CHUNK_BYTES = 2**16
_JSON_WHITESPACE = re.compile(r"[ \t\n\r]*")


def stream_items(path: Path, key: str) -> Iterator[dict[str, object]]:
    """Yield the objects in the list ``key`` of a JSON object, in order; other members are skipped.

    ``path`` is the JSON file, or a ``.zip`` with one JSON file. Raises ``InputError`` for invalid or truncated JSON,
    NaN, a missing list, a list of anything but objects, and items or files above the limits.
    """
    with _open_json_stream(path) as stream:
        text = _JsonWindow(path, stream)
        text.enter(key)
        text.expect("[", key)
        n = 0
        while not text.skip("]"):
            if n:
                text.expect(",", key)
            item = text.value(f"{key}[{n}]")
            if not isinstance(item, dict):
                raise InputError(path, f"{key}[{n}]", shorten_value(item), "an object")
            yield item
            n += 1


def stream_entries(path: Path, key: str) -> Iterator[tuple[str, object]]:
    """Yield names and values in the object ``key`` of a JSON object, in order.

    Raises ``InputError`` as ``stream_items`` does.
    """
    with _open_json_stream(path) as stream:
        text = _JsonWindow(path, stream)
        text.enter(key)
        text.expect("{", key)
        first = True
        while not text.skip("}"):
            if not first:
                text.expect(",", key)
            name = text.value(key)
            if not isinstance(name, str):
                raise InputError(path, key, shorten_value(name), "an object")
            text.expect(":", f"{key}.{printable(name)}")
            yield name, text.value(f"{key}.{printable(name)}")
            first = False


def read_json_member(path: Path, key: str) -> dict[str, object]:
    """Read the object ``key`` of a JSON object; the rest of the file is not read.

    Raises ``InputError`` as ``stream_items`` does.
    """
    with _open_json_stream(path) as stream:
        text = _JsonWindow(path, stream)
        text.enter(key)
        value = text.value(key)
    if not isinstance(value, dict):
        raise InputError(path, key, shorten_value(value), "an object")
    return value


@contextmanager
def _open_json_stream(path: Path) -> Iterator[IO[bytes]]:
    """Open a file's bytes, or the unpacked bytes of the JSON file in a ``.zip``."""
    try:
        if not path.is_file():  # a pipe would block
            raise InputError(path, "", "no such file", "a JSON file")
        if path.suffix != ".zip":
            with path.open("rb") as stream:
                yield stream
            return
        with arrays.open_archive_file(path) as archive:
            inside = [it for it in archive.infolist() if it.filename.endswith(".json")]
            if len(inside) != 1:
                raise InputError(path, "", f"{len(inside)} JSON files in it", "one")
            with arrays.open_archive_member(archive, inside[0]) as packed:
                yield packed
    except InputError:
        raise
    except (OSError, zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, zlib.error) as error:
        raise InputError(path, "", f"a file that cannot be read ({error})", "a JSON file") from error


class _JsonWindow:
    """A window on the text of a JSON object, and the position up to which it is parsed."""

    def __init__(self, path: Path, stream: IO[bytes]) -> None:
        self.path, self.stream = path, stream
        self.decode = codecs.getincrementaldecoder("utf-8-sig")().decode
        self.parse = json.JSONDecoder(parse_constant=self._refuse).raw_decode
        self.window, self.at, self.ended = "", 0, False
        self.length = self.values = 0

    def enter(self, wanted: str) -> None:
        """Move to the value of a key of the object."""
        self.expect("{", "")
        first = True
        while not self.skip("}"):
            if not first:
                self.expect(",", "")
            key = self.value("")
            if not isinstance(key, str):
                raise InputError(self.path, "", shorten_value(key), "a JSON object")
            self.expect(":", printable(key))
            if key == wanted:
                return
            self.value(printable(key))
            first = False
        raise InputError(self.path, wanted, "no such key", "the key")

    def skip(self, mark: str) -> bool:
        """Skip a mark if it comes next; return whether it did."""
        self._pass_space()
        while self.at == len(self.window) and self._more():
            self._pass_space()
        if not self.window.startswith(mark, self.at):
            return False
        self.at += 1
        return True

    def expect(self, mark: str, key: str) -> None:
        """Read a mark that must come next."""
        if not self.skip(mark):
            rest = self.window[self.at : self.at + 20]
            value = shorten_value(rest) if rest else "the end of the file"
            raise InputError(self.path, key, value, f"{mark!r}, as in a JSON object; is the file cut short?")

    def value(self, key: str) -> object:
        """Parse a value from the window, doubling the window until the value is complete."""
        self.values += 1
        if self.values > MAX_JSON_STREAM_VALUES:
            most = f"{MAX_JSON_STREAM_VALUES}"
            raise InputError(self.path, key, f"more than {most} values", f"at most {most}")
        while True:
            self._pass_space()
            try:
                value, end = self.parse(self.window, self.at)
                if end < len(self.window) or self.ended:  # a number may go on
                    self.at = end
                    return value
                trouble = "no end"
            except RecursionError as error:
                raise InputError(self.path, key, "values nested too deep", "a JSON value") from error
            except ValueError as error:
                trouble = f"invalid JSON ({error})"
            unread = len(self.window) - self.at
            if unread > MAX_JSON_ITEM_CHARACTERS:
                got = f"more than {MAX_JSON_ITEM_CHARACTERS} characters, or {trouble}"
                raise InputError(self.path, key, got, "a JSON value")
            if not self._more(unread):
                raise InputError(self.path, key, trouble, "a JSON value; is the file cut short?")

    def _pass_space(self) -> None:
        self.at = _JSON_WHITESPACE.match(self.window, self.at).end()  # type: ignore[union-attr]

    def _more(self, least: int = 0) -> bool:
        """Widen the window; return False at the end of the file."""
        if self.ended:
            return False
        content = self.stream.read(max(least, JSON_CHUNK_BYTES))
        self.ended = not content
        self.length += len(content)
        if self.length > MAX_JSON_STREAM_BYTES:
            most = f"{MAX_JSON_STREAM_BYTES}"
            raise InputError(self.path, "", f"more than {most} bytes", f"at most {most}, unpacked")
        try:
            self.window, self.at = self.window[self.at :] + self.decode(content, self.ended), 0
        except UnicodeDecodeError as error:
            raise InputError(self.path, "", f"invalid UTF-8 ({error.reason})", "JSON text") from error
        return bool(content)

    def _refuse(self, constant: str) -> object:
        raise InputError(self.path, "", f"the number {constant}", "finite numbers")


MAX_PARQUET_BYTES = 2**30
MAX_PARQUET_VALUES_READ, MAX_PARQUET_VALUES_RETURNED = 2**28, 2**25
"""Maximum count of numbers in a file's columns, and in the selected rows."""
PARQUET_BATCH_ROWS = 1024
MAX_PARQUET_ROW_VALUES = 4096
"""Maximum average count of numbers in a row of a column."""
MAX_PARQUET_LIST_DEPTH = 4
"""Maximum nesting of lists in a column."""


def parquet_columns(path: Path) -> list[str]:
    """Return the names of a Parquet file's columns. Raises as ``read_columns`` does."""
    return list(_open_parquet(path).schema_arrow.names)


def read_columns(
    path: Path, names: Sequence[str], where: tuple[str, int] | None = None
) -> dict[str, Float[ndarray, "T *n"]]:
    """Read columns: (T,) of numbers, (T, n) of lists; NaN for missing values.

    ``where`` selects rows: one of the columns, and its number in these rows. Raises ``InputError`` for columns of other
    types, rows of different lengths and too many numbers, and ``UsageError`` without pyarrow.
    """
    file = _open_parquet(path)
    for name in names:
        if name not in file.schema_arrow.names:
            raise InputError(path, name, "no such column", f"one of {', '.join(file.schema_arrow.names)}")
        kind = file.schema_arrow.field(name).type
        if not _is_numeric_type(kind):
            raise InputError(path, name, f"the type {printable(str(kind))}", "numbers, or lists of numbers")
    kept: dict[str, list[ndarray]] = {name: [] for name in names}
    total = 0
    for batch in _read_parquet_batches(path, file, names):
        columns = {name: _column_to_array(path, name, batch.column(name)) for name in names}
        if where is not None:
            chosen = columns[where[0]] == where[1]
            columns = {name: values[chosen] for name, values in columns.items()}
        total += sum(values.size for values in columns.values())
        if total > MAX_PARQUET_VALUES_RETURNED:
            raise InputError(path, "", f"more than {MAX_PARQUET_VALUES_RETURNED} numbers in the columns", "fewer")
        for name, values in columns.items():
            kept[name].append(values)
    return {name: _concatenate_batches(path, name, parts) for name, parts in kept.items()}


def _open_parquet(path: Path) -> ParquetFile:
    parquet = plugins.import_extra("pyarrow.parquet", "lerobot", path.name)
    if path.stat().st_size > MAX_PARQUET_BYTES:
        raise InputError(path, "", f"{path.stat().st_size} bytes", f"at most {MAX_PARQUET_BYTES}")
    try:
        return parquet.ParquetFile(path)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "Parquet") from error


def _read_parquet_batches(path: Path, file: ParquetFile, names: Sequence[str]) -> Iterator[RecordBatch]:
    """Yield the columns part by part, after a check of their stated size."""
    try:
        about = file.metadata
        groups = [about.row_group(n) for n in range(about.num_row_groups)]
        parts = [group.column(k) for group in groups for k in range(group.num_columns)]
        numbers = sum(part.num_values for part in parts if part.path_in_schema.split(".")[0] in names)
        rows = max(about.num_rows, 1)
        in_row = numbers / rows
        if max(numbers, rows) > MAX_PARQUET_VALUES_READ or in_row > MAX_PARQUET_ROW_VALUES * len(names):
            got = f"{numbers} numbers in {about.num_rows} rows"
            raise InputError(path, "", got, f"at most {MAX_PARQUET_VALUES_READ}, {MAX_PARQUET_ROW_VALUES} in a row")
        yield from file.iter_batches(PARQUET_BATCH_ROWS, columns=list(names))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "Parquet") from error


def _is_numeric_type(kind: DataType, deep: int = 0) -> bool:
    from pyarrow import types

    if deep < MAX_PARQUET_LIST_DEPTH and (
        types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
    ):
        return _is_numeric_type(kind.value_type, deep + 1)
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind))


def _column_to_array(path: Path, name: str, column: Array) -> Float[ndarray, "T *n"]:
    from pyarrow import compute, types

    there, shape, flat = column.is_valid().to_numpy(zero_copy_only=False), list[int](), column
    while types.is_nested(flat.type):
        flat = flat.drop_null()
        lengths = compute.unique(compute.list_value_length(flat)).to_pylist()
        if len(lengths) > 1:
            raise InputError(path, name, f"rows of {lengths[0]} and {lengths[1]} numbers", "rows of one count")
        shape += lengths or [0]
        flat = flat.flatten()
    values = flat.to_numpy(zero_copy_only=False).astype(float)
    if not shape:
        return np.asarray(values)
    if values.size != np.count_nonzero(there) * math.prod(shape):
        raise InputError(path, name, "nested lists with missing items", "rows of one count")
    out = np.full((len(column), math.prod(shape)), np.nan)
    out[there] = values.reshape(-1, out.shape[1])
    return out


def _concatenate_batches(path: Path, name: str, parts: list[ndarray]) -> Float[ndarray, "T *n"]:
    """Join the parts; parts without numbers take the width of the others."""
    width = max((part.shape[1] for part in parts if part.ndim == 2), default=0)
    parts = [np.full((len(part), width), np.nan) if part.ndim == 2 and not part.shape[1] else part for part in parts]
    counts = sorted({part.shape[1:] for part in parts if len(part)})
    if len(counts) > 1:
        raise InputError(path, name, f"rows of {counts[0][0]} and {counts[1][0]} numbers", "rows of one count")
    return np.concatenate(parts) if parts else np.zeros(0)
