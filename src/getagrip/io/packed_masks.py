"""Masks of many frames in little memory: a bit for each pixel of the box around what is set."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray
from numpy.lib.mixins import NDArrayOperatorsMixin


@dataclass(frozen=True, eq=False)
class PackedMask:
    """The mask of one frame."""

    size: tuple[int, int]
    """Height and width of the image [px]."""
    top: int
    left: int
    width: int
    """Width of the box; its height follows from ``bits``."""
    bits: UInt8[ndarray, "h _"]

    @staticmethod
    def of(mask: Bool[ndarray, "H W"]) -> PackedMask:
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not rows.size:
            return PackedMask((mask.shape[0], mask.shape[1]), 0, 0, 0, np.zeros((0, 0), np.uint8))
        box = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        bits = np.packbits(box, axis=1)
        if box.all():
            bits = np.broadcast_to(bits[:1].copy(), bits.shape)  # one row in memory
        return PackedMask((mask.shape[0], mask.shape[1]), rows[0], columns[0], box.shape[1], bits)


@lru_cache(maxsize=4)
def _unpacked(frame: PackedMask) -> Bool[ndarray, "H W"]:
    """Unpack the mask, read-only, since it is kept for the next call."""
    out = np.zeros(frame.size, dtype=bool)
    if frame.width:
        box = np.unpackbits(frame.bits, axis=1, count=frame.width).view(bool)
        out[frame.top : frame.top + len(box), frame.left : frame.left + frame.width] = box
    out.setflags(write=False)
    return out


class PackedMasks(NDArrayOperatorsMixin):
    """Stands for a (T, H, W) array of booleans that is not to be written to.

    Frames are unpacked when they are asked for by number, or one after the other; some of the frames are packed, too.
    All else that arrays can do is done with the whole array, in as much memory.
    """

    dtype = np.dtype(bool)
    ndim = 3

    def __init__(self, frames: Sequence[PackedMask], size: tuple[int, int]) -> None:
        """Hold frames of one size (height, width) [px]."""
        self._frames, self._size = tuple(frames), size

    @staticmethod
    def of(masks: Iterable[Bool[ndarray, "H W"]], size: tuple[int, int]) -> PackedMasks:
        """Pack masks that may be made one by one. ``size``: width and height [px]."""
        return PackedMasks([PackedMask.of(mask) for mask in masks], (size[1], size[0]))

    def as_array(self) -> Bool[ndarray, "T H W"]:
        """Return itself, under the type of what it stands for."""
        return cast(ndarray, self)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, H, W)."""
        return len(self._frames), *self._size

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[Bool[ndarray, "H W"]]:
        return map(_unpacked, self._frames)

    def __getitem__(self, index: Any) -> PackedMasks | ndarray | np.bool_:
        if isinstance(index, int | np.integer):
            return _unpacked(self._frames[index])
        if isinstance(index, slice) or (isinstance(index, ndarray) and index.ndim == 1):
            return PackedMasks([self._frames[n] for n in np.arange(len(self))[index]], self._size)
        return np.asarray(self)[index]

    def any(self, axis: tuple[int, ...] | int | None = None, keepdims: bool = False) -> ndarray | np.bool_ | bool:
        """Reduce by logical or, as an array does."""
        if axis is None and not keepdims:
            return bool(self._shown.any())
        if axis == (1, 2):
            return self._shown[:, None, None] if keepdims else self._shown.copy()
        return np.asarray(self).any(axis=axis, keepdims=keepdims)

    @cached_property
    def _shown(self) -> Bool[ndarray, "T"]:
        """Frames with a pixel."""
        return np.array([frame.width > 0 for frame in self._frames], dtype=bool)

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> ndarray:
        out = np.zeros(self.shape, dtype=bool)
        for n, mask in enumerate(self):
            out[n] = mask
        return out if dtype is None else out.astype(dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **named: object) -> object:
        whole = (np.asarray(each) if isinstance(each, PackedMasks) else each for each in inputs)
        return getattr(ufunc, method)(*whole, **named)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)
