"""Recognition of whose hands files are, by their names and keys: every tracker says what it knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.errors import InputError, MissingOptionError
from getagrip.hands.trackers import records
from getagrip.io import files, numbers

if TYPE_CHECKING:
    from getagrip.hands.trackers.tracker import Tracker

MAX_KEY_DEPTH = 5
"""Dictionaries and lists below each other in which keys are looked for."""


@dataclass(frozen=True)
class Sample:
    """One of the files, as an example of all."""

    path: Path

    @cached_property
    def record(self) -> records.Record:
        """Its content; empty for a format that holds no record."""
        return records.read_tracker_record(self.path) if self.path.suffix.lower() in records.RECORD_SUFFIXES else {}

    @cached_property
    def keys(self) -> frozenset[str]:
        """All of its keys, those of the first record in a list included."""
        return frozenset(_collect_keys(self.record, MAX_KEY_DEPTH))

    def has(self, *keys: str) -> bool:
        """Return whether it has all of these keys."""
        return self.keys.issuperset(keys)


def recognise(paths: Sequence[Path], trackers: Mapping[str, Tracker]) -> tuple[str, str]:
    """Return the name of the tracker whose files these are, and what they are, in words.

    Raises ``InputError`` where none recognises them, with what each looks for, and ``UsageError`` where several do.
    """
    found = {name: words for name, tracker in trackers.items() if (words := _describe_recognition(paths, tracker))}
    if len(found) == 1:
        return next(iter(found.items()))
    if found:
        each = ", ".join(f"--from {name} ({words})" for name, words in found.items())
        raise MissingOptionError(f"missing --from: {paths[0]} may be of several programs: {each}")
    keys = sorted(_first_sample(paths).keys) if paths[0].exists() else []
    got = f"keys {files.shorten_value(', '.join(keys))[1:-1]}" if keys else "names that are of no known program"
    known = "; ".join(f"{name}: {tracker.looks_for}" for name, tracker in trackers.items() if tracker.looks_for)
    raise InputError(paths[0], "", got, f"files of a program that is known, or --from NAME; looked for {known}")


def _describe_recognition(paths: Sequence[Path], tracker: Tracker) -> str:
    """Return what a tracker takes files for, in words; empty where they are not its own."""
    try:
        found = records.list_record_files(paths, tracker.layouts)
    except InputError:
        if all(path.exists() for path in paths):
            return ""
        raise
    with numbers.convert_to_input_errors(found[0]):
        return tracker.recognises(Sample(found[0]))


def _first_sample(paths: Sequence[Path]) -> Sample:
    """Return the first file, for an error; a folder stands for itself."""
    return Sample(next((path for path in paths if path.is_file()), None) or records.list_record_files(paths)[0])


def _collect_keys(content: object, depth: int) -> set[str]:
    """Collect keys; those of one record stand for all in a list, or in a dictionary by images."""
    if depth == 0:
        return set()
    if isinstance(content, list):
        return next((keys for one in content[:100] if (keys := _collect_keys(one, depth - 1))), set())
    if not isinstance(content, Mapping):
        return set()
    named = records.records_by_image(content)
    inner = list(named.values())[:100] if named else list(content.values())[:100]
    own = set() if named else {str(key) for key in content}
    return own.union(*(_collect_keys(one, depth - 1) for one in inner))
