"""Frozen dataclasses of arrays: shapes checked on creation, comparison by content, a short ``repr`` for notebooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from importlib import import_module
from textwrap import wrap
from types import UnionType
from typing import Any, get_args, get_type_hints

import numpy as np
from jaxtyping import AbstractArray, Bool, Float, Int, Shaped, UInt8
from numpy import ndarray

from getagrip.errors import NamedFields, UsageError, argument_types, check_types
from getagrip.io import files
from getagrip.io.images import PackedMasks

MAX_REPR_LINES, MAX_REPR_LINE_CHARS = 6, 100
MAX_REPR_ITEMS = 3
"""Longest collection that ``repr`` writes in full."""
ARRAY_KINDS: dict[object, tuple[str, type, str]] = {
    Float: ("f", float, "floats"), Int: ("iu", np.int64, "integers"), Bool: ("b", bool, "booleans"),
    UInt8: ("u", np.uint8, "bytes"),
}  # fmt: skip
"""For each of jaxtyping's types: numpy's kinds, the type of the stored array, and its name in errors."""


class Brief:
    """A base of dataclasses with a ``repr`` of a few lines, and a table with a picture in notebooks."""

    def __init_subclass__(cls) -> None:
        """Set the class's ``repr``, which ``dataclass`` keeps."""
        cls.__repr__ = lambda self: summarise_dataclass(self)  # type: ignore[method-assign]  # noqa: PLW0108

    def _repr_html_(self) -> str:
        return str(view("render_html")(self))


class ArrayData(NamedFields, Brief):  # noqa: PLW1641 - not hashable, as arrays are not
    """Base of frozen dataclasses, declared with ``eq=False``, whose arrays are annotated with jaxtyping's shapes.

    On creation, numbers of another width are converted (float32 to float64). Any other type or shape raises
    ``UsageError``, as does a value that is not of its field's class in ``errors.ARGUMENT_TYPES``; an axis has one
    length in all fields that name it. Objects of one class are equal if all fields hold the same values, NaN equal to
    NaN. Like arrays, they cannot be hashed.
    """

    def __post_init__(self) -> None:
        data: type = type(self)
        check_types(f"{data.__name__}.{{}}", vars(self), _field_kinds(data))
        lengths: dict[str, int] = {}
        for name, kind, axes in _array_fields(data):
            if (value := getattr(self, name)) is not None:
                array = as_array(f"{data.__name__}.{name}", value, kind, axes, lengths)
                object.__setattr__(self, name, array)  # the way to set a field of a frozen dataclass

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return all(equal_content(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))  # type: ignore[arg-type]


def equal_content(a: object, b: object) -> bool:
    """Return whether two values are equal, arrays in dictionaries, lists and tuples included; NaN equals NaN."""
    a, b = (np.asarray(each) if isinstance(each, PackedMasks) else each for each in (a, b))
    if isinstance(a, ndarray | float) and isinstance(b, ndarray | float):
        a, b = np.asarray(a), np.asarray(b)
        return np.array_equal(a, b, equal_nan=a.dtype.kind == b.dtype.kind == "f")
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(equal_content(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple) and type(a) is type(b):
        return len(a) == len(b) and all(map(equal_content, a, b))
    return not isinstance(a, ndarray) and not isinstance(b, ndarray) and a == b


def check_ids(name: str, ids: Int[ndarray, "..."], count: int) -> None:
    """Raise ``UsageError`` for vertex ids outside 0 to ``count`` - 1."""
    if ids.size and (ids.min() < 0 or ids.max() >= count):
        bad = ids.min() if ids.min() < 0 else ids.max()
        raise UsageError(f"{name} must be vertex ids from 0 to {count - 1} (got {bad})")


def as_array(
    name: str, value: object, kind: object, axes: tuple[str, ...], lengths: dict[str, int]
) -> Shaped[ndarray, "..."]:
    """Convert a field's value to an array of one of the ``ARRAY_KINDS`` with the given axes.

    Known ``lengths`` of axes are checked, unknown ones are set. Raises ``UsageError`` in the name of the field.
    """
    numpy_kinds, dtype, called = ARRAY_KINDS[kind]
    known = [int(axis) if axis.isdecimal() else lengths.get(axis) for axis in axes]
    expected = str(tuple(axis if n is None else n for axis, n in zip(axes, known, strict=True))).replace("'", "")
    if not isinstance(value, ndarray | PackedMasks):
        raise UsageError(f"{name} must be an array of {called} of shape {expected} (got {files.shorten_value(value)})")
    fits = value.ndim == len(axes) and all(n in (None, m) for n, m in zip(known, value.shape, strict=True))
    if not fits or value.dtype.kind not in numpy_kinds:
        raise UsageError(f"{name} must be {called} of shape {expected} (got {value.dtype} of shape {value.shape})")
    lengths |= zip(axes, value.shape, strict=True)
    return value if isinstance(value, PackedMasks) else np.asarray(value, dtype)  # type: ignore[return-value]


def check_finite(name: str, array: Float[ndarray, "..."] | None) -> None:
    """Raise ``UsageError`` for NaN or infinite numbers in a field."""
    if array is not None and not (finite := np.isfinite(array)).all():
        bad = f"{np.count_nonzero(~finite)} NaN or infinite ones, first at {[*map(int, np.argwhere(~finite)[0])]}"
        raise UsageError(f"{name} must be finite numbers (got {bad})")


@cache
def _field_kinds(data: type) -> dict[str, tuple[str, ...]]:
    return argument_types({field.name: field.type for field in fields(data)})


@cache
def _array_fields(data: type) -> list[tuple[str, object, tuple[str, ...]]]:
    """Return name, kind and axes of a dataclass's array fields."""
    hints = get_type_hints(data)
    found: list[tuple[str, object, tuple[str, ...]]] = []
    for field in fields(data):
        hint = hints[field.name]
        for one in get_args(hint) if isinstance(hint, UnionType) else (hint,):
            if isinstance(one, type) and issubclass(one, AbstractArray):
                found.append((field.name, one.dtype, tuple(one.dim_str.split())))
    return found


def summarise_dataclass(data: object) -> str:
    """Write a dataclass in ``MAX_REPR_LINES`` lines: arrays by kind and shape, long collections by their ends."""
    text = f"{type(data).__name__}({', '.join(f'{name}={text}' for name, text in summarise_fields(data).items())})"
    return "\n".join(
        wrap(text, MAX_REPR_LINE_CHARS, subsequent_indent="  ", max_lines=MAX_REPR_LINES, placeholder=" ...)")
    )


def summarise_fields(data: Any) -> dict[str, str]:
    """Summarise each field of a dataclass that is neither None nor empty."""
    values = {field.name: getattr(data, field.name) for field in fields(data)}
    return {
        name: summarise_value(value)
        for name, value in values.items()
        if (value if isinstance(value, str | list | tuple | Mapping) else value is not None)
    }


def summarise_value(value: object) -> str:
    """Summarise a value in a few words."""
    if isinstance(value, ndarray | PackedMasks):
        return _summarise_array(value)
    if isinstance(value, Mapping):
        return f"{{{_abbreviate_items([f'{key}: {summarise_value(one)}' for key, one in value.items()])}}}"
    if isinstance(value, list | tuple):
        return f"({_abbreviate_items([summarise_value(one) for one in value])})"
    if isinstance(value, Enum | float):
        return str(value.value) if isinstance(value, Enum) else f"{value:.6g}"
    text, most = " ".join(str(value).split()), MAX_REPR_LINE_CHARS // 2
    if is_dataclass(value):
        return text if len(text) <= most else type(value).__name__
    text = text if len(text) <= most else f"{text[:most]}..."
    return repr(text) if isinstance(value, str) else text


def view(name: str) -> Callable[..., Any]:
    """Return a function of ``getagrip.report.notebook``, a higher layer that is imported only for display."""
    return getattr(import_module("getagrip.report.notebook"), name)


def _summarise_array(value: ndarray | PackedMasks) -> str:
    """Summarise an array: a few numbers in full, a row of numbers by its range, else kind and shape."""
    if isinstance(value, ndarray) and value.size <= MAX_REPR_ITEMS:
        return np.array2string(value, precision=4, separator=", ")
    if isinstance(value, ndarray) and value.ndim == 1 and value.dtype.kind == "f" and np.isfinite(value).any():
        return f"{len(value)} of {np.nanmin(value):.4g} to {np.nanmax(value):.4g}"
    return f"{value.dtype}{value.shape}".replace(" ", "")


def _abbreviate_items(items: list[str]) -> str:
    if len(items) <= MAX_REPR_ITEMS:
        return ", ".join(items)
    return f"{items[0]}, {items[1]}, ..., {items[-1]}; {len(items)} in all"
