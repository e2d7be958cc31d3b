"""Provenance: the source of each part of a clip's data, and how far it can be relied on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import files
from getagrip.io.terminal import report, warn

Basis = Literal["measured", "estimated", "assumed"]
"""From a sensor, the ground truth or the user; found by an algorithm; neither of these."""
HandsKind = Literal["measured", "estimated"]
"""Kind of a clip's hands: from sensors or the ground truth; estimated from images, or assumed."""
TYPED = 4
"""The version of ``clip.json`` from which on sources have a basis; before, a guess said so in its text."""


@dataclass(frozen=True)
class Source:
    """The source of an input, and its basis.

    Attributes:
        text: a description of the source.
        basis: ``measured``, ``estimated`` (by an algorithm) or ``assumed``.
    """

    text: str
    basis: Basis = "measured"

    def __str__(self) -> str:
        return self.text


TEXT, BASIS = "provenance_", "basis_"
"""Names of arrays in a hand file begin with these."""

Provenance = dict[str, object]
"""By topic (``camera``, ``scale``, ``hands``): ``Source``, or what else is known of it, as a JSON value."""


def measured(text: str) -> Source:
    """Make the source of a sensor's, the ground truth's or the user's value."""
    return Source(text)


def assumed(text: str) -> Source:
    """Make the source of an assumption."""
    return Source(text, "assumed")


def estimated(text: str) -> Source:
    """Make the source of an algorithm's result."""
    return Source(text, "estimated")


def kind_of_hands(provenance: Mapping[str, object]) -> HandsKind:
    """Return the kind of a clip's hands; without a source they count as measured."""
    source = provenance.get("hands")
    return "estimated" if isinstance(source, Source) and source.basis != "measured" else "measured"


def is_assumed(source: object) -> bool:
    """Return whether a value of a provenance is assumed."""
    return isinstance(source, Source) and source.basis == "assumed"


def assumptions(provenance: Mapping[str, object]) -> dict[str, str]:
    """Return the texts of the assumptions in a provenance, by topic."""
    return {topic: str(source) for topic, source in provenance.items() if is_assumed(source)}


def joined(sources: Iterable[Source]) -> Source:
    """Join several sources to one, as weak as the weakest of them."""
    each = tuple(dict.fromkeys(sources))
    weakest = max((source.basis for source in each), key=get_args(Basis).index)
    return Source("; ".join(dict.fromkeys(source.text for source in each)), weakest)


def report_source(topic: str, source: object) -> None:
    """Print the source of something; a warning where it is assumed."""
    (warn if is_assumed(source) else report)(f"{topic}: {source}")


def as_arrays(provenance: Mapping[str, object]) -> dict[str, ndarray]:
    """Convert the sources to arrays of a hand file: the text of each, and the basis of those that are not measured."""
    texts = {f"{TEXT}{topic}": np.array(str(source)) for topic, source in provenance.items()}
    sources = {topic: source for topic, source in provenance.items() if isinstance(source, Source)}
    return texts | {f"{BASIS}{topic}": np.array(source.basis) for topic, source in sources.items()}


def of_provenance(key: str) -> bool:
    """Return whether an array of a hand file is one of ``as_arrays``."""
    return key.startswith((TEXT, BASIS))


def from_arrays(path: Path, arrays: Mapping[str, ndarray]) -> dict[str, Source]:
    """Read the sources in a hand file; older files have no basis."""
    texts = {key: str(value) for key, value in arrays.items() if value.dtype.kind == "U" and value.shape == ()}
    out = {}
    for key, text in texts.items():
        if not key.startswith(TEXT):
            continue
        topic = key.removeprefix(TEXT)
        basis = texts.get(f"{BASIS}{topic}")
        found = _of_old(text) if basis is None else _parsed(path, topic, {"text": text, "basis": basis}, TYPED)
        out[topic] = found if isinstance(found, Source) else Source(text)
    return out


def parse(path: Path, entry: Mapping[str, object], version: int) -> Provenance:
    """Read the provenance in a ``clip.json``. Raises ``InputError`` for a basis that there is not."""
    return {topic: _parsed(path, topic, value, version) for topic, value in entry.items()}


def _parsed(path: Path, topic: str, value: object, version: int) -> object:
    if version < TYPED:
        return _of_old(value)
    if not isinstance(value, dict) or value.keys() != {"text", "basis"}:
        return value
    if value["basis"] not in get_args(Basis) or not isinstance(value["text"], str):
        expected = f'{{"text": ..., "basis": one of {", ".join(get_args(Basis))}}}'
        raise InputError(path, f"provenance.{files.plain(topic)}", files.shown(value), expected)
    return Source(value["text"], value["basis"])


def _of_old(value: object) -> object:
    """Convert an entry of an older file, in which a word marked assumptions."""
    return assumed(value) if isinstance(value, str) and "guess" in value.lower() else value
