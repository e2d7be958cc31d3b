"""Pickled dictionaries of arrays, read without running what is in them."""

from getagrip.io.pickles.reading import (
    MAX_PICKLE_BYTES,
    check_bounded,
    read_pickle_content,
    read_pickle_dict,
    read_pickle_file,
)
from getagrip.io.pickles.stand_ins import PickledInstance

__all__ = [
    "MAX_PICKLE_BYTES",
    "PickledInstance",
    "check_bounded",
    "read_pickle_content",
    "read_pickle_dict",
    "read_pickle_file",
]
