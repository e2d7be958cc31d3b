"""How options look on the command line: types for the fields of dataclasses, which are plain paths and flags to Python.

A reader declares its options once, in its own dataclass. The command line takes names, help and defaults from there.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

from tyro.conf import FlagCreatePairsOff, arg
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from getagrip.io.storage import Place, RemotePath, parse_place

Folder = Annotated[Path, arg(metavar="DIR")]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
File = Annotated[Path, arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Flag = Annotated[bool, FlagCreatePairsOff, arg(help_behavior_hint="")]


T = TypeVar("T")

PATH_REGISTRY = ConstructorRegistry()
"""How paths are read, of all commands."""


@PATH_REGISTRY.primitive_rule
def _path_rule(of: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Path | None] | None:
    """Take a path on a disk, or nothing, which is not offered as a word."""
    if of.type not in (Path, Path | None):
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="PATH",
        instance_from_str=lambda words: Path(expand_user_path(words[0])),
        is_instance=lambda value: value is None or isinstance(value, Path),
        str_from_instance=lambda value: [str(value)],
    )


def expand_user_path(text: str) -> str:
    """Expand ``~`` at the beginning of a path.

    Shells do so only at the beginning of a word, not in ``--out=~/results``.

    Raises ``ValueError`` for an empty text, as of a variable that is not set: as a path it would be the current folder.
    """
    if not text:
        raise ValueError("must be a path (got an empty text); . is the current folder")
    return os.path.expanduser(text)


def place_argument(metavar: str) -> PrimitiveConstructorSpec[Place]:
    """Take a path, or an address in an object store."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse_place(expand_user_path(words[0])),
        is_instance=lambda value: isinstance(value, Path | RemotePath),
        str_from_instance=lambda value: [str(value)],
    )


def parsed_argument(metavar: str, parse: Callable[[str], T], kind: type[T]) -> PrimitiveConstructorSpec[T | None]:
    """Take one word that is parsed to a value of a ``kind``, or nothing. What ``parse`` raises ends the call."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse(words[0]),
        is_instance=lambda value: value is None or isinstance(value, kind),
        str_from_instance=lambda value: [str(value)],
    )


def switch(value: T) -> PrimitiveConstructorSpec[T]:
    """Make a flag that sets an option to a value."""
    return PrimitiveConstructorSpec(
        nargs=0,
        metavar="",
        instance_from_str=lambda _: value,
        is_instance=lambda _: True,
        str_from_instance=lambda _: [],
    )


def one_of(*choices: str) -> PrimitiveConstructorSpec[str | None]:
    """Take one of some words, or nothing, which is not offered as a word."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{{{','.join(choices)}}}",
        instance_from_str=lambda words: words[0],
        is_instance=lambda value: value is None or value in choices,
        str_from_instance=lambda value: [str(value)],
        choices=choices,
    )


def numbers_argument(count: int, metavar: str) -> PrimitiveConstructorSpec[tuple[float, ...] | None]:
    """Take a fixed number of numbers, or nothing."""
    return PrimitiveConstructorSpec(
        nargs=count,
        metavar=metavar,
        instance_from_str=lambda words: tuple(float(word) for word in words),
        is_instance=lambda value: value is None or (isinstance(value, tuple) and len(value) == count),
        str_from_instance=lambda value: [str(x) for x in value or ()],
    )
