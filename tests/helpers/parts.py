"""Parts of kernels, which kernels alone can call, as functions that Python can."""

from __future__ import annotations

from typing import Any

from numba import njit

from getagrip.compiling import NUMBA_OPTIONS


def callable_part(part: Any) -> Any:
    """Return the part, compiled with its like's options."""
    return njit(**NUMBA_OPTIONS)(part.py_func)
