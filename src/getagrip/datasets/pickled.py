"""Arrays of other people's pickled dictionaries, checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import arrays
from getagrip.io.files import shown


def numbers(
    path: Path, given: Mapping[str, object], key: str, shape: tuple[int, ...], of: str = ""
) -> Float[ndarray, "..."]:
    """A finite array of the given shape, -1 standing for any length above 0; axes of length 1 in front are let be.

    ``of`` names the dictionary that ``given`` is, where it stands in another. Raises ``InputError``.
    """
    name = f"{of}.{key}" if of else key
    if key not in given:
        raise InputError(path, name, "no such key", "the key")
    value: Any = given[key]
    if isinstance(value, list | tuple):
        value = arrays.from_lists(value)
    if not isinstance(value, ndarray):
        raise InputError(path, name, shown(given[key]), f"numbers of shape {shape}")
    if value.dtype.kind not in "fiu":
        raise InputError(path, name, f"an array of {value.dtype}", f"numbers of shape {shape}")
    if value.size == abs(int(np.prod(shape))) and -1 not in shape:
        value = value.reshape(shape)
    return arrays.floats(path, {name: value}, name, shape, kinds="fiu")
