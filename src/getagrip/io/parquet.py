"""Columns of numbers of Parquet files: part after part, since few bytes hold any number of equal rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import extras, files

if TYPE_CHECKING:
    from pyarrow import Array, DataType, RecordBatch
    from pyarrow.parquet import ParquetFile

MAX_PARQUET_BYTES = 2**30
"""Bytes of a file."""
MAX_PARQUET_VALUES_READ, MAX_PARQUET_VALUES_RETURNED = 2**28, 2**25
"""Numbers of a file's columns that are gone through, and those of the rows that are kept."""
PARQUET_BATCH_ROWS = 1024
"""Rows of a part."""
MAX_PARQUET_ROW_VALUES = 4096
"""Numbers of a row."""
MAX_PARQUET_LIST_DEPTH = 4
"""Lists within lists."""


def parquet_columns(path: Path) -> list[str]:
    """Return the names of a Parquet file's columns. Raises as ``read_columns`` does."""
    return list(_open_parquet(path).schema_arrow.names)


def read_columns(
    path: Path, names: Sequence[str], where: tuple[str, int] | None = None
) -> dict[str, Float[ndarray, "T *n"]]:
    """Read columns: (T,) of numbers, (T, n) of lists; NaN where a row has none.

    ``where`` is one of the columns, and the number in it of the rows that are kept. Raises ``InputError`` for other
    columns, rows of different lengths and too many numbers, and ``UsageError`` without pyarrow.
    """
    file = _open_parquet(path)
    for name in names:
        if name not in file.schema_arrow.names:
            raise InputError(path, name, "no such column", f"one of {', '.join(file.schema_arrow.names)}")
        kind = file.schema_arrow.field(name).type
        if not _is_numeric_type(kind):
            raise InputError(path, name, f"the type {files.printable(str(kind))}", "numbers, or lists of numbers")
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
    """Open a Parquet file."""
    parquet = extras.import_extra("pyarrow.parquet", "lerobot", path.name)
    if path.stat().st_size > MAX_PARQUET_BYTES:
        raise InputError(path, "", f"{path.stat().st_size} bytes", f"at most {MAX_PARQUET_BYTES}")
    try:
        return parquet.ParquetFile(path)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "Parquet") from error


def _read_parquet_batches(path: Path, file: ParquetFile, names: Sequence[str]) -> Iterator[RecordBatch]:
    """Yield the columns part by part, after a look at how many numbers they say to have."""
    try:
        about = file.metadata
        groups = [about.row_group(n) for n in range(about.num_row_groups)]
        parts = [group.column(k) for group in groups for k in range(group.num_columns)]
        numbers = sum(part.num_values for part in parts if part.path_in_schema.split(".")[0] in names)
        rows = max(about.num_rows, 1)
        if (
            numbers > MAX_PARQUET_VALUES_READ
            or rows > MAX_PARQUET_VALUES_READ
            or numbers / rows > MAX_PARQUET_ROW_VALUES * len(names)
        ):
            got = f"{numbers} numbers in {about.num_rows} rows"
            raise InputError(path, "", got, f"at most {MAX_PARQUET_VALUES_READ}, {MAX_PARQUET_ROW_VALUES} in a row")
        yield from file.iter_batches(PARQUET_BATCH_ROWS, columns=list(names))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "Parquet") from error


def _is_numeric_type(kind: DataType, deep: int = 0) -> bool:
    """Return whether a type is one of numbers, or of lists of them."""
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
        raise InputError(path, name, "lists within lists of which some are missing", "rows of one count")
    out = np.full((len(column), math.prod(shape)), np.nan)
    out[there] = values.reshape(-1, out.shape[1])
    return out


def _concatenate_batches(path: Path, name: str, parts: list[ndarray]) -> Float[ndarray, "T *n"]:
    """Join the parts; those without a number have as many columns as the others."""
    width = max((part.shape[1] for part in parts if part.ndim == 2), default=0)
    parts = [np.full((len(part), width), np.nan) if part.ndim == 2 and not part.shape[1] else part for part in parts]
    counts = sorted({part.shape[1:] for part in parts if len(part)})
    if len(counts) > 1:
        raise InputError(path, name, f"rows of {counts[0][0]} and {counts[1][0]} numbers", "rows of one count")
    return np.concatenate(parts) if parts else np.zeros(0)
