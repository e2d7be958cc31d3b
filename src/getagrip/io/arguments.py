"""How options look on the command line: types for the fields of dataclasses, which are plain paths and flags to Python.

A reader declares its options once, in its own dataclass. The command line takes names, help and defaults from there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, arg
from tyro.constructors import PrimitiveConstructorSpec

from getagrip.io.storage import Place, Remote, place

Folder = Annotated[Path, arg(metavar="DIR")]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
File = Annotated[Path, arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Flag = Annotated[bool, FlagCreatePairsOff, arg(help_behavior_hint="")]


def placed(metavar: str) -> PrimitiveConstructorSpec[Place]:
    """A path, or an address in an object store."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: place(words[0]),
        is_instance=lambda value: isinstance(value, Path | Remote),
        str_from_instance=lambda value: [str(value)],
    )


def one_of(*choices: str) -> PrimitiveConstructorSpec[str | None]:
    """One of some words, or nothing, which is not offered as a word."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{{{','.join(choices)}}}",
        instance_from_str=lambda words: words[0],
        is_instance=lambda value: value is None or value in choices,
        str_from_instance=lambda value: [str(value)],
        choices=choices,
    )


def numbers(count: int, metavar: str) -> PrimitiveConstructorSpec[tuple[float, ...] | None]:
    """So many numbers, or nothing."""
    return PrimitiveConstructorSpec(
        nargs=count,
        metavar=metavar,
        instance_from_str=lambda words: tuple(float(word) for word in words),
        is_instance=lambda value: value is None or (isinstance(value, tuple) and len(value) == count),
        str_from_instance=lambda value: [str(x) for x in value or ()],
    )
