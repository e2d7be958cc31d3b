"""Rows of an array that are equal, in a fraction of the time of ``np.unique(axis=0)``."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int, Shaped
from numpy import ndarray


def same_rows(rows: Shaped[ndarray, "N K"]) -> Int[ndarray, "N"]:
    """For each row a number, the same for equal rows: 0, 1, ... in the rows' lexicographic order."""
    order = np.lexsort(rows.T[::-1])
    in_order = rows[order]
    new = np.any(in_order[1:] != in_order[:-1], axis=1)
    number = np.zeros(len(rows), dtype=np.int64)
    number[order[1:]] = np.cumsum(new)
    return number
