"""Options that come from Python: what no field can hold is refused where it is given, not taken for something else."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import cache
from inspect import Signature, cleandoc, getsource, signature
from itertools import pairwise
from numbers import Integral, Real
from textwrap import dedent
from typing import Literal, TypeVar, get_args, get_origin, get_type_hints

from getagrip.errors import UsageError

T = TypeVar("T", bound=type)


def check_word(name: str, value: object, words: object) -> None:
    """Raise ``UsageError`` for what is none of the words of a ``Literal``."""
    if not (isinstance(value, str) and value in get_args(words)):
        raise UsageError(f"unknown {name} {value!r}; choose from {', '.join(get_args(words))}")


def check_values(options: object) -> None:
    """Raise ``UsageError`` where a field of a dataclass holds no word of its ``Literal``, or no (finite) number.

    Fields of other types are not looked at.
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


def explain_fields(kind: T) -> T:
    """Give a dataclass a ``help`` that lists its fields with their docstrings, and types without terminal markers."""
    _list_fields(kind)
    plain = get_type_hints(kind)
    _, *value = signature(kind.__init__).parameters.values()  # type: ignore[misc]
    shown = [one.replace(annotation=plain[one.name]) for one in value]
    kind.__signature__ = Signature(shown)  # type: ignore[attr-defined]
    return kind


def explain_all(hint: object) -> None:
    """List the fields of all dataclasses that a type names or nests, so that ``--help`` breaks no line in a sentence.

    tyro starts a new line where the docstring of a field is continued with an indent.
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
    """Append the fields of a dataclass and of its bases to its docstring."""
    lines = [line for one in reversed(kind.__mro__) if is_dataclass(one) for line in _field_lines(one)]
    kind.__doc__ = "\n".join([cleandoc(kind.__doc__ or ""), "", "Attributes:", *lines])


def _field_lines(kind: type) -> Iterator[str]:
    """Yield a line for each of its own fields; none for a class that was made without source."""
    try:
        body = ast.parse(dedent(getsource(kind))).body[0]
    except OSError:
        return
    assert isinstance(body, ast.ClassDef)
    for field, text in pairwise(body.body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            yield f"    {ast.unparse(field.target)}: {' '.join(str(text.value.value).split())}"
