"""Records of benchmarks of whole sequences: files of JSON that are kept where they would be made of the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from getagrip.batch.kept import KEY, UNKNOWN, damaged, difference, made_by, without_source
from getagrip.clip import input_sha256
from getagrip.errors import InputError
from getagrip.fitting.options import Options
from getagrip.io import files
from getagrip.io.files import Json

KEYS = {"inputs": "another clip", "options": "other options", "software": "other code or other libraries"}
"""Keys of a record's inputs, and the words for one that differs."""


def made_of(clip: Path, options: Options, *code: str) -> Json:
    """Return what a record depends on; ``code`` are parts of the package that a reconstruction does not depend on."""
    return {"inputs": input_sha256(clip), "options": asdict(options), "software": made_by(options.method, *code)}


def kept_or_made(path: Path, of: Json, overwrite: bool, make: Callable[[], Json]) -> tuple[Json, str]:
    """Read the record in a file, if it is valid, else make and write it; also return why an existing one was not valid.

    The reason is empty where there was none, and with ``overwrite``.
    """
    why = ""
    if path.exists() and not overwrite:
        try:
            record = files.read_json(path)
            why = difference(record, of, KEYS)
            if of["software"].get(KEY) == UNKNOWN:
                why = without_source(of["options"]["method"])
            if not why:
                return record, ""
        except InputError as error:
            why = damaged(error)
    record = {**of, **make()}
    files.write_json(path, record)
    return record, why
