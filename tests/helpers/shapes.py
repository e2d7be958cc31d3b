"""Shapes and kinds of arrays in type hints, checked while the tests run. All other types are mypy's to check.

Every function is checked in its first call of every file of tests. Checking all calls takes as long as the tests
themselves, checking the first of every test an eighth of their time.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import is_dataclass
from functools import cache, wraps
from typing import Any, get_args

import jaxtyping
from beartype import beartype
from jaxtyping import AbstractArray, AbstractDtype, install_import_hook, jaxtyped

_called: set[Any] = set()


def check_package() -> None:
    """Check every call from here on. Nothing of the package may have been imported before.

    What has no array in its hints stays as it is: calls of it cost nothing, and kernels, which have none, are compiled.
    """

    def where_there_are_arrays(typechecker: Callable[..., Any]) -> Callable[..., Any]:
        check = jaxtyped(typechecker=typechecker)
        return lambda it: in_first_call(it, check) if mentions_arrays(it) else it

    jaxtyping.jaxtyped = where_there_are_arrays  # the import hook puts it before every function and class
    install_import_hook("getagrip", f"{__name__}.arrays_only")


def next_file() -> None:
    """Check first calls again."""
    _called.clear()


def in_first_call(it: Any, check: Callable[[Any], Any]) -> Any:
    """A function that is checked in its first call of every file, or a dataclass whose first instance is."""
    if isinstance(it, type):
        it.__init__ = in_first_call(it.__init__, check)  # type: ignore[misc]
        return it
    checked = cache(lambda: check(it))  # made when it is first called: most never are

    @wraps(it)
    def call(*args: Any, **kwargs: Any) -> Any:
        if it in _called:
            return it(*args, **kwargs)
        _called.add(it)
        return checked()(*args, **kwargs)

    return call


def arrays_only(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that refuses arrays of other shapes than its hints say, in its arguments and its result."""
    hints = function.__annotations__
    function.__annotations__ = {name: hint for name, hint in hints.items() if is_of_arrays(hint)}
    made = cache(lambda: beartype(function))  # when it is first called, for most never are

    def call(*args: Any, **kwargs: Any) -> Any:
        return made()(*args, **kwargs)

    return call


def mentions_arrays(it: Any) -> bool:
    """Whether a hint of a function or a dataclass names an array or an alias of one; its other names must be known."""
    if isinstance(it, type) and not is_dataclass(it):
        return False
    known = vars(sys.modules[it.__module__])
    hints = [str(hint) for hint in it.__annotations__.values()]
    hints = [hint for hint in hints if any(is_of_arrays(known.get(word)) for word in re.findall(r"\w+", hint))]
    for hint in hints:
        eval(hint, known)  # where this fails, jaxtyping would check nothing and say nothing
    return bool(hints)


def is_of_arrays(hint: Any) -> bool:
    """Whether a hint is of an array, or of a union, a tuple or a mapping with arrays in it."""
    if isinstance(hint, type) and issubclass(hint, AbstractArray | AbstractDtype):
        return True
    return any(is_of_arrays(part) for part in get_args(hint))
