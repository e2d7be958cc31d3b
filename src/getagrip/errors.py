"""The package's errors, which the command line shows as one line each, and checks of public functions' arguments."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import ParamSpec, Self, TypeVar, get_args, get_type_hints

MAX_QUOTED_CHARACTERS = 500
"""Length of a value in a message: parsers quote all of an invalid text."""


def escape_unprintable(text: str, kept: str = "") -> str:
    """Escape unprintable characters except for ``kept``, so that a text cannot control a terminal."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else ascii(c)[1:-1] for c in text)


def replace_surrogates(text: str) -> str:
    """Replace invalid UTF-8 of file names, so that pages and tables can be encoded."""
    return re.sub("[\ud800-\udfff]", "\ufffd", text)


class GetagripError(Exception):
    """Base class of all errors that a user can cause. The message names the culprit, its value and allowed values."""


class UsageError(GetagripError):
    """The call itself is wrong (exit status 2)."""


class MissingOptionError(UsageError):
    """An option that the input needs is missing."""


def unknown_choice_error(what: str, got: object, known: Iterable[object]) -> UsageError:
    """Make the error for an unknown name."""
    return UsageError(f"unknown {what} {got!r}; choose from {', '.join(map(str, known))}")


class InputError(GetagripError):
    """A file is missing, malformed or holds impossible values (exit status 1).

    The message, on one line, reads ``<file>: <key> must be <expected> (got <got>)``, then advice after a semicolon;
    ``<file>: missing <key>``; or ``<key> cannot be used with ...`` if ``expected`` begins with "none with".
    """

    def __init__(self, path: str | Path, key: str, got: str, expected: str) -> None:
        self.path, self.key, self.got, self.expected = Path(path), key, got, expected
        short = got if len(got) <= MAX_QUOTED_CHARACTERS else f"{got[:MAX_QUOTED_CHARACTERS]}..."
        super().__init__(escape_unprintable(" ".join(f"{path}{_describe_mismatch(key, short, expected)}".split())))


MISSING_VALUE_TEXTS = ("nothing", "no such key", "no such array")
"""Texts of ``InputError.got`` for a missing key."""


def _describe_mismatch(key: str, got: str, expected: str) -> str:
    verb = "needs" if re.match(r"some\b|one (at least|for each)", expected) else "must be"
    named = f": {key}" if key else ""
    if got in MISSING_VALUE_TEXTS or got.startswith("no "):
        asked = "" if expected in ("it", "the key", "the array") else f"; {verb} {expected}"
        return f": missing {key}{asked}" if key and got in MISSING_VALUE_TEXTS else f"{named}: {got}{asked}"
    if expected.startswith(("none with ", "none without ")):
        return f"{named} cannot be used {expected.removeprefix('none ')}"
    allowed, semicolon, advice = expected.partition("; ")
    return f"{named} {verb} {allowed} (got {got}){semicolon}{advice}"


ARGUMENT_TYPES = {
    "Clip": "a Clip; getagrip.read_clip(folder) reads one",
    "Masks": "Masks; getagrip.read_masks(clip) reads those of a clip",
    "Mesh": "a Mesh; getagrip.read_mesh(path) reads one, getagrip.Mesh(mesh.vertices, mesh.faces) makes one of a "
    "trimesh.Trimesh, or of arrays",
    "HandTrack": "a HandTrack; getagrip.HandTrack(vertices=...) makes one of arrays",
    "Reconstruction": "a Reconstruction; getagrip.reconstruct makes one, getagrip.read_result(folder) reads one",
    "Options": "Options, such as getagrip.Options(seed=1)",
    "SceneOptions": "SceneOptions, such as getagrip.SceneOptions(frames=30)",
    "Path": "a path: a text or a pathlib.Path",
    "str": "a text",
}
"""Classes of checked arguments, by name, with their descriptions in errors: kind, and how to make one."""

P = ParamSpec("P")
R = TypeVar("R")


class NamedFields:
    """A base of dataclasses; an unknown field raises ``UsageError`` with the names most like it."""

    def __new__(cls, *_: object, **named: object) -> Self:
        """Check the names of keyword arguments."""
        if named:
            check_names(f"argument of {cls.__name__}", named, [field.name for field in fields(cls)])  # type: ignore[arg-type]
        return super().__new__(cls)


def check_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function raise ``UsageError`` for an unknown keyword argument, and for an argument of a wrong class.

    The error suggests similar names, including fields of the dataclass ``options`` as ``options=...(field=...)``.
    """
    parameters = signature(function).parameters
    known = [name for name in parameters if not name.startswith("_") and name != "self"]
    kinds = argument_types({name: one.annotation for name, one in parameters.items()})

    @wraps(function)
    def call(*args: P.args, **named: P.kwargs) -> R:
        if not named.keys() <= {*known}:
            check_names(f"argument of {function.__name__}", named, [*known, *_option_fields(function)])
        check_types(f"{{}} of {function.__name__}", dict(zip(parameters, args, strict=False)) | named, kinds)
        return function(*args, **named)

    return call


def argument_types(annotations: Mapping[str, object]) -> dict[str, tuple[str, ...]]:
    """Return the allowed classes by argument, for annotations that name only ``ARGUMENT_TYPES`` and None."""
    split = {name: tuple(str(hint).replace(" ", "").split("|")) for name, hint in annotations.items()}
    return {name: kinds for name, kinds in split.items() if {*kinds} <= {*ARGUMENT_TYPES, "None"}}


def check_types(where: str, given: Mapping[str, object], kinds: Mapping[str, tuple[str, ...]]) -> None:
    """Raise ``UsageError`` for a value outside the classes of its name.

    ``where`` is the value's description in the error, with ``{}`` for its name.
    """
    for name, value in given.items():
        if name not in kinds or _is_instance_of(value, kinds[name]):
            continue
        expected = next(ARGUMENT_TYPES[kind] for kind in ARGUMENT_TYPES if kind in kinds[name])
        is_text = _is_instance_of(value, ("str", "Path"))
        got = repr(str(value)[:80]) if is_text else f"a value of type {type(value).__name__}"
        if any(_is_instance_of(value, of) and not _is_instance_of(given.get(one), of) for one, of in kinds.items()):
            expected = f"{expected.partition(';')[0]}; the order is {', '.join(kinds)}"
        must_be, semicolon, advice = expected.partition(";")
        raise UsageError(f"{where.format(name)} must be {must_be} (got {got}){semicolon}{advice}")


def _is_instance_of(value: object, kinds: tuple[str, ...]) -> bool:
    return (value is None and "None" in kinds) or any(one.__name__ in kinds for one in type(value).__mro__)


def check_names(what: str, given: Collection[str], known: Collection[str]) -> None:
    """Raise ``UsageError`` for an unknown name; the error lists similar names, else all.

    In ``options=Options(inits=...)`` the inner name counts.
    """
    inner = {name.partition("(")[2].removesuffix("=...)"): name for name in known if "(" in name}
    for name in given:
        if name not in known:
            plain = [one for one in known if "(" not in one]
            alike = get_close_matches(name, dict.fromkeys([*plain, *inner]), n=3)
            raise unknown_choice_error(what, name, [one if one in plain else inner[one] for one in alike] or plain)


def _option_fields(function: Callable[..., object]) -> list[str]:
    """List the fields of a function's options, as written in a call."""
    hint = get_type_hints(function).get("options") if "options" in signature(function).parameters else None
    made = next((one for one in get_args(hint) if isinstance(one, type) and is_dataclass(one)), None)
    return [] if made is None else [f"options={made.__name__}({field.name}=...)" for field in fields(made)]
