"""Help of dataclasses: Python drops the docstrings of fields, which explain options."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import is_dataclass
from inspect import Signature, cleandoc, getsource, signature
from itertools import pairwise
from textwrap import dedent
from typing import TypeVar, get_type_hints

T = TypeVar("T", bound=type)


def explained(kind: T) -> T:
    """Give a dataclass a ``help`` that lists its fields with their docstrings, and types without terminal markers."""
    lines = [line for one in reversed(kind.__mro__) if is_dataclass(one) for line in _fields(one)]
    kind.__doc__ = "\n".join([cleandoc(kind.__doc__ or ""), "", "Attributes:", *lines])
    plain = get_type_hints(kind)
    _, *value = signature(kind.__init__).parameters.values()  # type: ignore[misc]
    shown = [one.replace(annotation=plain[one.name]) for one in value]
    kind.__signature__ = Signature(shown)  # type: ignore[attr-defined]
    return kind


def _fields(kind: type) -> Iterator[str]:
    """Yield a line for each of its own fields."""
    body = ast.parse(dedent(getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    for field, text in pairwise(body.body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            yield f"    {ast.unparse(field.target)}: {' '.join(str(text.value.value).split())}"
