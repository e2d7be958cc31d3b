"""Findings of the checks, and calibrated probabilities, as stored in results (docs/checks.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from getagrip.errors import InputError, escape_unprintable
from getagrip.io.files import Json, shorten_value


@dataclass(frozen=True)
class Finding:
    """An unusual property of a clip or a result that a check found (docs/checks.md).

    Attributes:
        check: name of the check.
        serious: whether the result is probably worthless.
        value: the measured value.
        limit: the exceeded limit.
        message: the problem and its remedy, in words.
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
        if not _has_types(item, FINDING_FIELD_TYPES):
            expected = f"an object with {', '.join(FINDING_FIELD_TYPES)}"
            raise InputError(path, f"findings[{n}]", shorten_value(item), expected)
    return tuple(Finding(**{key: item[key] for key in FINDING_FIELD_TYPES}) for item in value)


def _has_types(item: object, types: Mapping[str, tuple[type, ...]]) -> bool:
    return isinstance(item, dict) and all(isinstance(item.get(key), kind) for key, kind in types.items())


def read_checks(path: Path, entry: Mapping[str, object], key: str = "checks") -> dict[str, float]:
    """Read measured values by name, under a key of a ``result.json``; NaN for null. Raises ``InputError``."""
    out = {}
    for name, value in entry.items():
        if isinstance(value, bool) or not isinstance(value, int | float | None):
            raise InputError(path, f"{key}.{shorten_value(name)}", shorten_value(value), "a number, or null")
        out[name] = float("nan") if value is None else float(value)
    return out


CANDIDATE_SET_COVERAGE = 0.9
"""Probability that a result's set of candidates contains the right one."""
MIN_SHOWN_PROBABILITY = 0.01
"""Distance from 0 and 1 below which the calibration is too coarse to show a number."""
ASSUMED_MESH = "assumed mesh"
"""Entry of ``Probability.beyond`` for a mesh that is not the object's own."""
Verdict: TypeAlias = Literal["right", "uncertain", "wrong"]
"""Judgement of a result in a word."""
RIGHT_PROBABILITY, WRONG_PROBABILITY = 0.8, 0.2
"""Probabilities, of a draft that it looks right, else of its pose in the hand, from which on a result looks right, and
up to which wrong."""
MIN_PLAUSIBLE_PROBABILITY = 0.015
"""Probability from which on a result with an assumed mesh probably looks right (docs/draft.md)."""


@dataclass(frozen=True)
class Probability:
    """A calibrated probability, computed without ground truth.

    Attributes:
        value: fraction of right results among those with such a value.
        meaning: the definition of "right", and the data of the calibration.
        beyond: signs (``checks.features``) worse than in nearly all calibration data, and inputs that were exact in it:
            an extrapolation.
        keep: guaranteed fraction of right results among those at least as probable (``checks.calibration``); 0:
            unknown.
        candidates: number of first candidates that contain the right one with ``CANDIDATE_SET_COVERAGE``; 0: even all
            of them may not.
    """

    value: float
    meaning: str
    beyond: tuple[str, ...] = ()
    keep: float = 0.0
    candidates: int = 0

    @property
    def keeping(self) -> str:
        """Say for which fraction of right results it is kept, and how many candidates contain the right one."""
        kept = f"; kept where {100.0 * self.keep:.3g} % are to be right" if self.keep else ""
        held = f"; {self.candidates} candidates hold the right one" if self.candidates > 1 else ""
        return kept + held

    @property
    def by_eye(self) -> str:
        """Say how a result with an assumed mesh, rarely within 10 % of the diameter, probably looks; else empty."""
        if ASSUMED_MESH not in self.beyond:
            return ""
        return f"probably looks {'right' if self.value >= MIN_PLAUSIBLE_PROBABILITY else 'wrong'}"

    def __str__(self) -> str:
        return format_probability(self.value) + (f" (extrapolated: {', '.join(self.beyond)})" if self.beyond else "")


def describe_looks(right: Probability | None, looks_right: Probability | None) -> str:
    """Say how a result probably looks, by the probability that it looks right, else by that of its pose in the hand."""
    if looks_right is None:
        return "" if right is None else right.by_eye
    word = "right" if looks_right.value >= 0.5 else "wrong"
    beyond = f", extrapolated: {', '.join(looks_right.beyond)}" if looks_right.beyond else ""
    return f"probably looks {word} ({format_probability(looks_right.value)}{beyond})"


def format_probability(value: float) -> str:
    """Write a probability, 0 to 1, as a percentage: never 0 % or 100 %."""
    if value < MIN_SHOWN_PROBABILITY or value > 1.0 - MIN_SHOWN_PROBABILITY:
        return "< 1 %" if value < MIN_SHOWN_PROBABILITY else "> 99 %"
    return f"{100.0 * value:.0f} %"


PROBABILITY_FIELDS: dict[str, tuple[type, ...]] = {"value": (int, float), "meaning": (str,), "beyond": (list,)}


def read_probability(path: Path, value: object, key: str = "probability_right") -> Probability | None:
    """Read the probability under a key of a ``result.json``; None for null. Raises ``InputError``."""
    if value is None:
        return None
    typed = isinstance(value, dict) and _has_types(value, PROBABILITY_FIELDS) and not isinstance(value["value"], bool)
    if not isinstance(value, dict) or not typed or not all(isinstance(name, str) for name in value["beyond"]):
        raise InputError(path, key, shorten_value(value), f"an object with {', '.join(PROBABILITY_FIELDS)}, or null")
    if not 0.0 <= value["value"] <= 1.0:
        raise InputError(path, f"{key}.value", shorten_value(value["value"]), "0 to 1")
    more = value.get("keep", 0.0), value.get("candidates", 0)  # absent in older results
    if not all(isinstance(one, int | float) and not isinstance(one, bool) for one in more) or not 0.0 <= more[0] <= 1.0:
        raise InputError(path, f"{key}.keep", shorten_value(more), "0 to 1, and a number of candidates")
    return Probability(float(value["value"]), value["meaning"], tuple(value["beyond"]), float(more[0]), int(more[1]))
