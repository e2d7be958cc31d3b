"""Names in calls: an unknown keyword argument raises an error that names the right one."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from typing import ParamSpec, Self, TypeVar, get_args, get_type_hints

from getagrip.errors import unknown

P = ParamSpec("P")
R = TypeVar("R")


class NamedFields:
    """A base of dataclasses; an unknown field raises ``UsageError`` with the names most like it."""

    def __new__(cls, *_: object, **named: object) -> Self:
        """Check the names of the fields that are given."""
        if named:
            check_names(f"argument of {cls.__name__}", named, [field.name for field in fields(cls)])  # type: ignore[arg-type]
        return super().__new__(cls)


def named(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function raise ``UsageError`` for an unknown keyword argument, with the names most like it.

    Fields of the dataclass ``options`` are suggested as ``options=...(field=...)``.
    """
    known = [name for name in signature(function).parameters if not name.startswith("_")]

    @wraps(function)
    def call(*args: P.args, **named: P.kwargs) -> R:
        if not named.keys() <= {*known}:
            check_names(f"argument of {function.__name__}", named, [*known, *_options(function)])
        return function(*args, **named)

    return call


def check_names(what: str, given: Collection[str], known: Collection[str]) -> None:
    """Raise ``UsageError`` for a name that is none of those known; it lists those most like it, else all.

    Of ``options=Options(inits=...)`` the name inside counts.
    """
    inner = {name.partition("(")[2].removesuffix("=...)"): name for name in known if "(" in name}
    for name in given:
        if name not in known:
            plain = [one for one in known if "(" not in one]
            alike = get_close_matches(name, dict.fromkeys([*plain, *inner]), n=3)
            raise unknown(what, name, [one if one in plain else inner[one] for one in alike] or plain)


def _options(function: Callable[..., object]) -> list[str]:
    """List the fields of a function's options, as they are given in a call."""
    hint = get_type_hints(function).get("options")
    made = next((one for one in get_args(hint) if isinstance(one, type) and is_dataclass(one)), None)
    return [] if made is None else [f"options={made.__name__}({field.name}=...)" for field in fields(made)]
