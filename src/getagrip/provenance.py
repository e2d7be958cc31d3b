"""Provenance: the source of each part of a clip's data, and whether it is measured, estimated or assumed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import files
from getagrip.io.terminal import print_note, warn

Basis = Literal["measured", "estimated", "assumed"]
"""From a sensor, the ground truth or the user; found by an algorithm; neither."""
HandsKind = Literal["measured", "estimated"]
"""Kind of a clip's hands: from sensors or the ground truth; estimated from images, or assumed."""
EXTRAPOLATED_HANDS_KEY = "hands_held"
"""Key of a clip's provenance: frames with an unknown hand, for which the nearest known one stands still."""
MIN_BASIS_VERSION = 4
"""First version of ``clip.json`` whose sources have a basis; before, assumptions said "guess" in their text."""
PROVENANCE_PREFIX, BASIS_PREFIX = "provenance_", "basis_"
"""Prefixes of arrays in a hand file."""


@dataclass(frozen=True)
class Source:
    """The source of an input.

    Attributes:
        text: a description of the source.
        basis: ``measured``, ``estimated`` (by an algorithm) or ``assumed``.
    """

    text: str
    basis: Basis = "measured"

    def __str__(self) -> str:
        return self.text


Provenance = dict[str, object]
"""A ``Source`` or another JSON value by topic (``camera``, ``scale``, ``hands``)."""


def measured(text: str) -> Source:
    """Make the source of a value from a sensor, the ground truth or the user."""
    return Source(text)


def assumed(text: str) -> Source:
    """Make the source of an assumption."""
    return Source(text, "assumed")


def estimated(text: str) -> Source:
    """Make the source of an algorithm's result."""
    return Source(text, "estimated")


def kind_of_hands(provenance: Mapping[str, object]) -> HandsKind:
    """Return the kind of a clip's hands; without a source, ``measured``."""
    source = provenance.get("hands")
    return "estimated" if isinstance(source, Source) and source.basis != "measured" else "measured"


def is_assumed(source: object) -> bool:
    """Return whether a value of a provenance is assumed."""
    return isinstance(source, Source) and source.basis == "assumed"


def assumptions(provenance: Mapping[str, object]) -> dict[str, str]:
    """Return the texts of the assumptions in a provenance, by topic."""
    return {topic: str(source) for topic, source in provenance.items() if is_assumed(source)}


def join_sources(sources: Iterable[Source]) -> Source:
    """Join several sources to one with the weakest basis."""
    each = tuple(dict.fromkeys(sources))
    weakest = max((source.basis for source in each), key=get_args(Basis).index)
    return Source("; ".join(dict.fromkeys(source.text for source in each)), weakest)


def report_source(topic: str, source: object) -> None:
    """Print the source of a topic, as a warning if it is assumed."""
    (warn if is_assumed(source) else print_note)(f"{topic}: {source}")


def provenance_to_arrays(provenance: Mapping[str, object]) -> dict[str, ndarray]:
    """Convert sources to arrays of a hand file: a text of each, and its basis."""
    texts = {f"{PROVENANCE_PREFIX}{topic}": np.array(str(source)) for topic, source in provenance.items()}
    sources = {topic: source for topic, source in provenance.items() if isinstance(source, Source)}
    return texts | {f"{BASIS_PREFIX}{topic}": np.array(source.basis) for topic, source in sources.items()}


def is_provenance_key(key: str) -> bool:
    """Return whether an array of a hand file is one of ``provenance_to_arrays``."""
    return key.startswith((PROVENANCE_PREFIX, BASIS_PREFIX))


def provenance_from_arrays(path: Path, arrays: Mapping[str, ndarray]) -> dict[str, Source]:
    """Read the sources in a hand file; older files have no basis."""
    texts = {key: str(value) for key, value in arrays.items() if value.dtype.kind == "U" and value.shape == ()}
    out = {}
    for key, text in texts.items():
        if not key.startswith(PROVENANCE_PREFIX):
            continue
        topic = key.removeprefix(PROVENANCE_PREFIX)
        basis = texts.get(f"{BASIS_PREFIX}{topic}")
        entry = text if basis is None else {"text": text, "basis": basis}
        found = _parse_source(path, topic, entry, 0 if basis is None else MIN_BASIS_VERSION)
        out[topic] = found if isinstance(found, Source) else Source(text)
    return out


def parse_provenance(path: Path, entry: Mapping[str, object], version: int) -> Provenance:
    """Read the provenance in a ``clip.json``. Raises ``InputError`` for an unknown basis."""
    return {topic: _parse_source(path, topic, value, version) for topic, value in entry.items()}


def _parse_source(path: Path, topic: str, value: object, version: int) -> object:
    if version < MIN_BASIS_VERSION:
        return assumed(value) if isinstance(value, str) and "guess" in value.lower() else value
    if not isinstance(value, dict) or value.keys() != {"text", "basis"}:
        return value
    if value["basis"] not in get_args(Basis) or not isinstance(value["text"], str):
        expected = f'{{"text": ..., "basis": one of {", ".join(get_args(Basis))}}}'
        raise InputError(path, f"provenance.{files.printable(topic)}", files.shorten_value(value), expected)
    return Source(value["text"], value["basis"])
