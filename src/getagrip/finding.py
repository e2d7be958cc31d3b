"""Findings of the checks: unusual properties of a clip or a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from getagrip.errors import InputError, escape_unprintable
from getagrip.io.files import Json, shorten_value


@dataclass(frozen=True)
class Finding:
    """An unusual property of a clip or a result that a check found (docs/checks.md).

    Attributes:
        check: name of the check.
        serious: whether the result is probably worthless.
        value: what was measured.
        limit: the limit that it is beyond.
        message: what is wrong and what to do, in words.
    """

    check: str
    serious: bool
    value: float
    limit: float
    message: str

    def __str__(self) -> str:
        return escape_unprintable(f"{'serious' if self.serious else 'note'}: {self.check}: {self.message}")


FINDING_FIELD_TYPES: dict[str, tuple[type, ...]] = {
    "check": (str,), "serious": (bool,), "value": (int, float), "limit": (int, float), "message": (str,),
}  # fmt: skip


def read_findings(path: Path, value: Sequence[Json]) -> tuple[Finding, ...]:
    """Read the findings of a ``result.json``. Raises ``InputError``."""
    for n, item in enumerate(value):
        if not isinstance(item, dict) or not all(
            isinstance(item.get(key), kind) for key, kind in FINDING_FIELD_TYPES.items()
        ):
            raise InputError(
                path, f"findings[{n}]", shorten_value(item), f"an object with {', '.join(FINDING_FIELD_TYPES)}"
            )
    return tuple(Finding(**{key: item[key] for key in FINDING_FIELD_TYPES}) for item in value)


def read_checks(path: Path, entry: Mapping[str, object], key: str = "checks") -> dict[str, float]:
    """Read measured values by name, as the ``key`` of a ``result.json`` has them; NaN for null.

    Raises ``InputError``.
    """
    out = {}
    for name, value in entry.items():
        if isinstance(value, bool) or not isinstance(value, int | float | None):
            raise InputError(path, f"{key}.{shorten_value(name)}", shorten_value(value), "a number, or null")
        out[name] = float("nan") if value is None else float(value)
    return out
