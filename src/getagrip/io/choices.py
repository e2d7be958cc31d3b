"""Options that come from Python: what no field can hold is refused where it is given, not taken for something else."""

from __future__ import annotations

import math
from functools import cache
from numbers import Integral, Real
from typing import Literal, get_args, get_origin, get_type_hints

from getagrip.errors import UsageError


def check_word(name: str, value: object, words: object) -> None:
    """Raise ``UsageError`` for what is none of the words of a ``Literal``."""
    if not (isinstance(value, str) and value in get_args(words)):
        raise UsageError(f"unknown {name} {value!r}; choose from {', '.join(get_args(words))}")


def check_values(options: object) -> None:
    """Raise ``UsageError`` where a field of a dataclass holds no word of its ``Literal``, or no (finite) number.

    Fields of other types are not looked at.
    """
    kind: type = type(options)
    for name, hint in _hints(kind).items():
        value = getattr(options, name)
        if get_origin(hint) is Literal:
            check_word(name, value, hint)
        elif hint is int and (not isinstance(value, Integral) or isinstance(value, bool)):
            raise UsageError(f"{name} must be a whole number (got {value!r})")
        elif hint is float and not (isinstance(value, Real) and math.isfinite(value)):
            raise UsageError(f"{name} must be a finite number (got {value!r})")


@cache
def _hints(data: type) -> dict[str, object]:
    return get_type_hints(data)
