"""Arguments of calls: an unknown name or a value of another kind raises an error that says what is right."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from typing import ParamSpec, Self, TypeVar, get_args, get_type_hints

from getagrip.errors import UsageError, unknown_choice_error

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
"""The kinds of values that are checked, by the names of their classes, and how to get one."""

P = ParamSpec("P")
R = TypeVar("R")


class NamedFields:
    """A base of dataclasses; an unknown field raises ``UsageError`` with the names most like it."""

    def __new__(cls, *_: object, **named: object) -> Self:
        """Check the names of the fields that are given."""
        if named:
            check_names(f"argument of {cls.__name__}", named, [field.name for field in fields(cls)])  # type: ignore[arg-type]
        return super().__new__(cls)


def check_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function raise ``UsageError`` for an unknown keyword argument, and for an argument of another kind.

    It suggests the names most like it, fields of the dataclass ``options`` as ``options=...(field=...)``.
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
    """Return the names of the classes that values may have, of those whose annotations name ``ARGUMENT_TYPES`` and None only."""
    split = {name: tuple(str(hint).replace(" ", "").split("|")) for name, hint in annotations.items()}
    return {name: kinds for name, kinds in split.items() if {*kinds} <= {*ARGUMENT_TYPES, "None"}}


def check_types(where: str, given: Mapping[str, object], kinds: Mapping[str, tuple[str, ...]]) -> None:
    """Raise ``UsageError`` for a value of another kind than its name may have.

    ``where`` is how the error calls it, with its name for ``{}``.
    """
    for name, value in given.items():
        if name not in kinds or _is_instance_of(value, kinds[name]):
            continue
        expected = next(ARGUMENT_TYPES[kind] for kind in ARGUMENT_TYPES if kind in kinds[name])
        got = (
            repr(str(value)[:80])
            if _is_instance_of(value, ("str", "Path"))
            else f"a value of type {type(value).__name__}"
        )
        if any(
            _is_instance_of(value, kinds[other]) and not _is_instance_of(given.get(other), kinds[other])
            for other in kinds
        ):
            expected = f"{expected.partition(';')[0]}; the order is {', '.join(kinds)}"
        must_be, semicolon, advice = expected.partition(";")
        raise UsageError(f"{where.format(name)} must be {must_be} (got {got}){semicolon}{advice}")


def _is_instance_of(value: object, kinds: tuple[str, ...]) -> bool:
    return (value is None and "None" in kinds) or any(one.__name__ in kinds for one in type(value).__mro__)


def check_names(what: str, given: Collection[str], known: Collection[str]) -> None:
    """Raise ``UsageError`` for a name that is none of those known; it lists those most like it, else all.

    Of ``options=Options(inits=...)`` the name inside counts.
    """
    inner = {name.partition("(")[2].removesuffix("=...)"): name for name in known if "(" in name}
    for name in given:
        if name not in known:
            plain = [one for one in known if "(" not in one]
            alike = get_close_matches(name, dict.fromkeys([*plain, *inner]), n=3)
            raise unknown_choice_error(what, name, [one if one in plain else inner[one] for one in alike] or plain)


def _option_fields(function: Callable[..., object]) -> list[str]:
    """List the fields of a function's options, as they are given in a call."""
    hint = get_type_hints(function).get("options") if "options" in signature(function).parameters else None
    made = next((one for one in get_args(hint) if isinstance(one, type) and is_dataclass(one)), None)
    return [] if made is None else [f"options={made.__name__}({field.name}=...)" for field in fields(made)]
