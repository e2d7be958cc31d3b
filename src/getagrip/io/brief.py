"""Data in few lines, for the last line of a notebook's cell; tables, pictures and pages of it are made further up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from textwrap import wrap
from typing import Any

import numpy as np

from getagrip.io.packed_masks import PackedMasks

MAX_BRIEF_LINES, BRIEF_WIDTH_CHARS = 6, 100
"""The most lines, and the letters in each."""
MAX_BRIEF_ITEMS = 3
"""Entries of a collection that are written out."""


class Brief:
    """A base of dataclasses that show themselves in few lines, and in a notebook as a table with a picture."""

    def __init_subclass__(cls) -> None:
        """Give the class its short form; ``dataclass`` keeps one that is there."""
        cls.__repr__ = summarise_dataclass  # type: ignore[method-assign]

    def _repr_html_(self) -> str:
        return str(view("render_html")(self))


def summarise_dataclass(data: object) -> str:
    """Write a dataclass in at most ``MAX_BRIEF_LINES`` lines: arrays by kind and shape, long collections by their ends."""
    parts = [f"{name}={text}" for name, text in summarise_fields(data).items()]
    text = f"{type(data).__name__}({', '.join(parts)})"
    return "\n".join(
        wrap(text, BRIEF_WIDTH_CHARS, subsequent_indent="  ", max_lines=MAX_BRIEF_LINES, placeholder=" ...)")
    )


def summarise_fields(data: Any) -> dict[str, str]:
    """Write each field of a dataclass in short; fields that are None or empty are left out."""
    values = {field.name: getattr(data, field.name) for field in fields(data)}
    sized = str | list | tuple | Mapping
    return {
        name: summarise_value(it) for name, it in values.items() if (it if isinstance(it, sized) else it is not None)
    }


def summarise_value(value: object) -> str:
    """Write a value in some words."""
    if isinstance(value, np.ndarray | PackedMasks):
        return _summarise_array(value)
    if isinstance(value, Mapping):
        return f"{{{_abbreviate_items([f'{key}: {summarise_value(one)}' for key, one in value.items()])}}}"
    if isinstance(value, list | tuple):
        return f"({_abbreviate_items([summarise_value(one) for one in value])})"
    if isinstance(value, Enum | float):
        return str(value.value) if isinstance(value, Enum) else f"{value:.6g}"
    text = " ".join(str(value).split())
    if is_dataclass(value):
        return text if len(text) <= BRIEF_WIDTH_CHARS / 2 else type(value).__name__
    text = text if len(text) <= BRIEF_WIDTH_CHARS / 2 else f"{text[: BRIEF_WIDTH_CHARS // 2]}..."
    return repr(text) if isinstance(value, str) else text


def view(name: str) -> Callable[..., Any]:
    """Return a function of ``getagrip.notebook``, a layer above all data, which is loaded when something is shown."""
    return getattr(import_module("getagrip.notebook"), name)


def _summarise_array(value: np.ndarray | PackedMasks) -> str:
    """Write an array: few numbers as they are, a row of numbers by their range, else kind and shape."""
    if isinstance(value, np.ndarray) and value.size <= MAX_BRIEF_ITEMS:
        return np.array2string(value, precision=4, separator=", ")
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind == "f" and np.isfinite(value).any():
        return f"{len(value)} of {np.nanmin(value):.4g} to {np.nanmax(value):.4g}"
    return f"{value.dtype}{value.shape}".replace(" ", "")


def _abbreviate_items(items: list[str]) -> str:
    if len(items) <= MAX_BRIEF_ITEMS:
        return ", ".join(items)
    return f"{items[0]}, {items[1]}, ..., {items[-1]}; {len(items)} in all"
