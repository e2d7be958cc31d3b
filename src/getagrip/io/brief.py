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

LINES, WIDTH = 6, 100
"""The most lines, and the letters in each."""
SHOWN = 3
"""Entries of a collection that are written out."""


class Brief:
    """A base of dataclasses that show themselves in few lines, and in a notebook as a table with a picture."""

    def __init_subclass__(cls) -> None:
        """Give the class its short form; ``dataclass`` keeps one that is there."""
        cls.__repr__ = in_short  # type: ignore[method-assign]

    def _repr_html_(self) -> str:
        return str(view("table_and_picture")(self))


def in_short(data: object) -> str:
    """Write a dataclass in at most ``LINES`` lines: arrays by kind and shape, long collections by their ends."""
    parts = [f"{name}={text}" for name, text in facts(data).items()]
    text = f"{type(data).__name__}({', '.join(parts)})"
    return "\n".join(wrap(text, WIDTH, subsequent_indent="  ", max_lines=LINES, placeholder=" ...)"))


def facts(data: Any) -> dict[str, str]:
    """Write each field of a dataclass in short; fields that are None or empty are left out."""
    values = {field.name: getattr(data, field.name) for field in fields(data)}
    sized = str | list | tuple | Mapping
    return {name: short(it) for name, it in values.items() if (it if isinstance(it, sized) else it is not None)}


def short(value: object) -> str:
    """Write a value in some words."""
    if isinstance(value, np.ndarray | PackedMasks):
        return _array(value)
    if isinstance(value, Mapping):
        return f"{{{_ends([f'{key}: {short(one)}' for key, one in value.items()])}}}"
    if isinstance(value, list | tuple):
        return f"({_ends([short(one) for one in value])})"
    if isinstance(value, Enum | float):
        return str(value.value) if isinstance(value, Enum) else f"{value:.6g}"
    text = " ".join(str(value).split())
    if is_dataclass(value):
        return text if len(text) <= WIDTH / 2 else type(value).__name__
    text = text if len(text) <= WIDTH / 2 else f"{text[: WIDTH // 2]}..."
    return repr(text) if isinstance(value, str) else text


def view(name: str) -> Callable[..., Any]:
    """Return a function of ``getagrip.notebook``, a layer above all data, which is loaded when something is shown."""
    return getattr(import_module("getagrip.notebook"), name)


def _array(value: np.ndarray | PackedMasks) -> str:
    """Write an array: few numbers as they are, a row of numbers by their range, else kind and shape."""
    if isinstance(value, np.ndarray) and value.size <= SHOWN:
        return np.array2string(value, precision=4, separator=", ")
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind == "f" and np.isfinite(value).any():
        return f"{len(value)} of {np.nanmin(value):.4g} to {np.nanmax(value):.4g}"
    return f"{value.dtype}{value.shape}".replace(" ", "")


def _ends(items: list[str]) -> str:
    if len(items) <= SHOWN:
        return ", ".join(items)
    return f"{items[0]}, {items[1]}, ..., {items[-1]}; {len(items)} in all"
