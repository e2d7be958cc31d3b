"""Options as fields of dataclasses: their types on the command line, checks of values from Python, ``help()``.

Each reader declares its options once, in its own dataclass; the command line takes names, help and defaults from it.
"""

from __future__ import annotations

import ast
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import cache
from inspect import Signature, cleandoc, getsource, signature
from itertools import pairwise
from numbers import Integral, Real
from pathlib import Path
from textwrap import dedent
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from tyro.conf import FlagCreatePairsOff, arg
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from getagrip.errors import UsageError, unknown_choice_error
from getagrip.io.storage import Place, RemotePath, parse_place

T = TypeVar("T")
DataclassT = TypeVar("DataclassT", bound=type)


def check_word(name: str, value: object, words: object) -> None:
    """Raise ``UsageError`` for a value outside a ``Literal``."""
    if not (isinstance(value, str) and value in get_args(words)):
        raise unknown_choice_error(name, value, get_args(words))


def check_values(options: object) -> None:
    """Raise ``UsageError`` for a dataclass's field outside its ``Literal``, or not a (finite) number of its type.

    Fields of other types are not checked.
    """
    kind: type = type(options)
    for name, hint in _type_hints(kind).items():
        value = getattr(options, name)
        if get_origin(hint) is Literal:
            check_word(name, value, hint)
        elif hint is int and (not isinstance(value, Integral) or isinstance(value, bool)):
            raise UsageError(f"{name} must be a whole number (got {value!r})")
        elif hint is float and not (isinstance(value, Real) and math.isfinite(value)):
            raise UsageError(f"{name} must be a finite number (got {value!r})")


@cache
def _type_hints(data: type) -> dict[str, object]:
    return get_type_hints(data)


def explain_fields(kind: DataclassT) -> DataclassT:
    """Give a dataclass a ``help()`` that lists its fields with their docstrings, and types without terminal markers."""
    _list_fields(kind)
    plain = get_type_hints(kind)
    _, *value = signature(kind.__init__).parameters.values()  # type: ignore[misc]
    shown = [one.replace(annotation=plain[one.name]) for one in value]
    kind.__signature__ = Signature(shown)  # type: ignore[attr-defined]
    return kind


def explain_all(hint: object) -> None:
    """List the fields of all dataclasses that a type names or nests, so that ``--help`` breaks no sentence.

    tyro would start a new line at each indented line of a field's docstring.
    """
    for inner in get_args(hint):
        explain_all(inner)
    kind = get_origin(hint) or hint
    if isinstance(kind, type) and is_dataclass(kind):
        if "Attributes:" not in (kind.__doc__ or ""):
            _list_fields(kind)
        for field in get_type_hints(kind).values():
            explain_all(field)


def _list_fields(kind: type) -> None:
    """Append the fields of a dataclass and its bases to its docstring."""
    lines = [line for one in reversed(kind.__mro__) if is_dataclass(one) for line in _field_lines(one)]
    kind.__doc__ = "\n".join([cleandoc(kind.__doc__ or ""), "", "Attributes:", *lines])


def _field_lines(kind: type) -> Iterator[str]:
    """Yield a line for each of the class's own fields; none for a class without source."""
    try:
        body = ast.parse(dedent(getsource(kind))).body[0]
    except OSError:
        return
    assert isinstance(body, ast.ClassDef)
    for field, text in pairwise(body.body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            yield f"    {ast.unparse(field.target)}: {' '.join(str(text.value.value).split())}"


Folder = Annotated[Path, arg(metavar="DIR")]
OptionalFolder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
File = Annotated[Path, arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Flag = Annotated[bool, FlagCreatePairsOff, arg(help_behavior_hint="")]
PATH_REGISTRY = ConstructorRegistry()
"""Reading of paths, for all commands."""


@PATH_REGISTRY.primitive_rule
def _path_rule(of: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Path | None] | None:
    """Take a local path, or None, which is not offered as a word."""
    if of.type not in (Path, Path | None):
        return None
    return parsed_argument("PATH", lambda text: Path(expand_user_path(text)), Path)


def expand_user_path(text: str) -> str:
    """Expand a leading ``~``, as shells do at the start of a word only, not in ``--out=~/results``.

    Raises ``ValueError`` for an empty text, as from an unset variable: as a path it would be the current folder.
    """
    if not text:
        raise ValueError("must be a path (got an empty text); . is the current folder")
    return os.path.expanduser(text)


def place_argument(metavar: str) -> PrimitiveConstructorSpec[Place]:
    """Take a path, or an address in an object store."""
    return _word_argument(
        metavar, lambda text: parse_place(expand_user_path(text)), lambda value: isinstance(value, Path | RemotePath)
    )


def parsed_argument(metavar: str, parse: Callable[[str], T], kind: type[T]) -> PrimitiveConstructorSpec[T | None]:
    """Take one word, parsed to a value of a ``kind``, or None. Errors of ``parse`` end the call."""
    return _word_argument(metavar, parse, lambda value: value is None or isinstance(value, kind))


def one_of(*choices: str) -> PrimitiveConstructorSpec[str | None]:
    """Take one of some words, or None, which is not offered as a word."""
    return _word_argument(
        f"{{{','.join(choices)}}}", lambda text: text, lambda value: value is None or value in choices, choices
    )


def _word_argument(
    metavar: str, parse: Callable[[str], T], fits: Callable[[object], bool], choices: tuple[str, ...] | None = None
) -> PrimitiveConstructorSpec[Any]:
    return PrimitiveConstructorSpec(
        nargs=1, metavar=metavar, instance_from_str=lambda words: parse(words[0]), is_instance=fits,
        str_from_instance=lambda value: [str(value)], choices=choices,
    )  # fmt: skip


def switch(value: T) -> PrimitiveConstructorSpec[T]:
    """Make a flag that sets an option to a value."""
    return PrimitiveConstructorSpec(
        nargs=0, metavar="", instance_from_str=lambda _: value, is_instance=lambda _: True,
        str_from_instance=lambda _: [],
    )  # fmt: skip


def numbers_argument(count: int, metavar: str) -> PrimitiveConstructorSpec[tuple[float, ...] | None]:
    """Take a fixed number of numbers, or None."""
    return PrimitiveConstructorSpec(
        nargs=count,
        metavar=metavar,
        instance_from_str=lambda words: tuple(float(word) for word in words),
        is_instance=lambda value: value is None or (isinstance(value, tuple) and len(value) == count),
        str_from_instance=lambda value: [str(x) for x in value or ()],
    )
