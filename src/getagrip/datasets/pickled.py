"""Other people's pickled dictionaries of arrays, read without running anything in them, and checked."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import arrays, pickles
from getagrip.io.files import read_bytes, shown

NPY = b"\x93NUMPY"


def read_dict(path: Path, what: str) -> dict[str, object]:
    """The dictionary in a pickle, or in an ``.npy`` file that holds a pickled one (``np.save`` of a dictionary).

    ``what`` says in errors what is expected. Raises ``InputError``.
    """
    content = read_bytes(path, pickles.LARGEST)
    if content[: len(NPY)] == NPY:
        stream = io.BytesIO(content)
        headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        try:
            shape, _, dtype = headers[np.lib.format.read_magic(stream)](stream)
        except Exception as error:  # the header is a Python literal: its parser raises many things
            raise InputError(path, "", f"an array whose header does not parse ({error})", what) from error
        if shape != () or not dtype.hasobject:
            raise InputError(path, "", f"an array of {dtype} of shape {shape}", what)
        content = content[stream.tell() :]
    return pickles.read(path, content, what)


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
        try:
            value = np.array(value)
        except ValueError:  # rows of different lengths
            value = None
    if not isinstance(value, ndarray):
        raise InputError(path, name, shown(given[key]), f"numbers of shape {shape}")
    if value.dtype.kind not in "fiu":
        raise InputError(path, name, f"an array of {value.dtype}", f"numbers of shape {shape}")
    if value.size == abs(int(np.prod(shape))) and -1 not in shape:
        value = value.reshape(shape)
    return arrays.floats(path, {name: value}, name, shape, kinds="fiu")
