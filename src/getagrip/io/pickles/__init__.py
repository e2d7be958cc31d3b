"""Pickled dictionaries of arrays, read without running what is in them."""

from getagrip.io.pickles.reading import LARGEST, check_bounded, read, read_any, read_file
from getagrip.io.pickles.stand_ins import Instance

__all__ = ["LARGEST", "Instance", "check_bounded", "read", "read_any", "read_file"]
