"""Shapes and kinds of arrays in type hints, checked while the tests run. All other types are mypy's to check.

Every function is checked in its first call of every file of tests. Checking all calls takes as long as the tests
themselves, checking the first of every test an eighth of their time.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import is_dataclass
from functools import cache, wraps
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

import jaxtyping
import numpy as np
from jaxtyping import AbstractArray, AbstractDtype, install_import_hook, jaxtyped
from numpy import ndarray

_called: set[Any] = set()


def check_package() -> None:
    """Check every call from here on. Nothing of the package may have been imported before.

    What has no array in its hints stays as it is: calls of it cost nothing, and kernels, which have none, are compiled.
    """

    def where_there_are_arrays(typechecker: Callable[..., Any]) -> Callable[..., Any]:
        return lambda it: in_first_call(it, typechecker) if mentions_arrays(it) else it

    jaxtyping.jaxtyped = where_there_are_arrays  # the import hook puts it before every function and class
    install_import_hook("getagrip", f"{__name__}.checked")


def next_file() -> None:
    """Check first calls again."""
    _called.clear()


def in_first_call(it: Any, check: Callable[[Any], Any]) -> Any:
    """A function that is checked in its first call of every file, or a dataclass whose first instance is."""
    if isinstance(it, type):
        it.__init__ = in_first_call(it.__init__, check)  # type: ignore[misc]
        return it
    made = cache(lambda: check(it))  # when it is first called: most never are

    @wraps(it)
    def call(*args: Any, **kwargs: Any) -> Any:
        if it in _called or jaxtyping.config.jaxtyping_disable:
            return it(*args, **kwargs)
        _called.add(it)
        return made()(*args, **kwargs)

    return call


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that refuses arrays of other shapes than its hints say, in its arguments and its result.

    A checker for all types would take longer to be made than most functions are at work here.
    """
    signature = inspect.signature(function)
    hints = array_hints(function)
    result_hint = hints.pop("return", Any)
    for name in hints:
        if signature.parameters[name].kind is inspect.Parameter.VAR_POSITIONAL:
            hints[name] = tuple[hints[name], ...]  # type: ignore[valid-type]  # of each of them

    def call(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs).arguments
        with jaxtyped("context"):  # in which a name stands for one length
            for name, hint in hints.items():
                if name in given and not fits(given[name], hint):
                    raise TypeError(f"{function.__qualname__}: {name} is {described(given[name])}, expected {hint}")
            result = function(*args, **kwargs)
            if not fits(result, result_hint):
                raise TypeError(f"{function.__qualname__}: returns {described(result)}, expected {result_hint}")
        return result

    return call


def fits(value: Any, hint: Any) -> bool:
    """Whether a value is of a hint; of the entries of a collection, the first is looked at."""
    origin, parts = get_origin(hint), get_args(hint)
    if type(value).__name__ == "PackedMasks" and isinstance(hint, type) and issubclass(hint, AbstractArray | ndarray):
        value = np.broadcast_to(np.False_, value.shape)  # it stands for an array
    if origin is None:
        return hint is Any or not isinstance(hint, type) or isinstance(value, hint)
    if origin in (Union, UnionType):
        return any(fits(value, part) for part in parts)
    if origin is Literal:
        return value in parts
    if origin is tuple and ... not in parts:
        return isinstance(value, tuple) and len(value) == len(parts) and all(map(fits, value, parts))
    if not isinstance(value, origin) or not issubclass(origin, Collection) or not value:
        return isinstance(value, origin)
    entry = next(iter(value.values() if issubclass(origin, Mapping) else value))
    return fits(entry, parts[1] if issubclass(origin, Mapping) else parts[0])


def described(value: Any) -> str:
    """An array by its kind and shape, all else by its type."""
    kind = type(value).__name__
    return f"{kind} {value.dtype} {value.shape}" if hasattr(value, "shape") else kind


def mentions_arrays(it: Any) -> bool:
    """Whether a hint of a function or a dataclass names an array or an alias of one."""
    if isinstance(it, type) and not is_dataclass(it):
        return False
    known = vars(sys.modules[it.__module__])
    return any(names_array(str(hint), known) for hint in it.__annotations__.values())


def array_hints(function: Callable[..., Any]) -> dict[str, Any]:
    """The hints of a function in which there are arrays; their other names must be known."""
    known = vars(sys.modules[function.__module__])
    hints = {name: str(hint) for name, hint in function.__annotations__.items()}
    return {name: eval(hint, known) for name, hint in hints.items() if names_array(hint, known)}


def names_array(hint: str, known: dict[str, Any]) -> bool:
    """Whether a hint as text has the name of an array or of an alias of one in it."""
    return any(is_of_arrays(known[word]) for word in re.findall(r"\w+", hint) if word in known)


def is_of_arrays(hint: Any) -> bool:
    """Whether a hint is of an array, or of a union, a tuple or a mapping with arrays in it."""
    if isinstance(hint, type) and issubclass(hint, AbstractArray | AbstractDtype):
        return True
    return any(is_of_arrays(part) for part in get_args(hint))
