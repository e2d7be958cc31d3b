"""Validity of existing results and of a benchmark's records: of the same clip, options and code, and readable."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

from getagrip.clip import input_sha256
from getagrip.errors import InputError, UsageError
from getagrip.fitting.methods import BUILTIN_METHODS, Method, method_of
from getagrip.fitting.options import Options
from getagrip.io import files, plugins
from getagrip.io.files import Json
from getagrip.io.source_checksum import UnknownSourceError, source_checksum
from getagrip.result import Reconstruction, is_result, read_result, software_versions

METHOD_CODE_KEY = "method_code"
"""Key in a record's ``software_versions``: the checksum of a method from outside."""
UNKNOWN_CHECKSUM = "unknown"
"""The checksum of a method whose source cannot be found: its results are never kept."""
RESULT_INPUT_LABELS = {
    "input_sha256": "another clip",
    "method": "another method",
    "seed": "another seed",
    "options": "other options",
    "getagrip": "another version",
    "code": "other code",
    METHOD_CODE_KEY: "another source of its method",
    "plugins": "other plug-ins",
}
"""In what a record may differ, by its key."""
_METHOD_CHECKSUMS: dict[str, tuple[Method, str]] = {}
"""Checksums of methods from outside, as their files were when first asked for: later changes do not run here."""
RECORD_INPUT_LABELS = {
    "inputs": "another clip",
    "options": "other options",
    "software": "other code or other libraries",
}
"""Keys of a record's inputs, and the words for one that differs."""


def software_of_method(method: str, *also: str) -> dict[str, str]:
    """Return ``result.software``, the additions of other packages, and the checksum of a method from outside."""
    there, made = method_of(method), software_versions(*also) | plugins.plugin_dependencies(method)
    if there is BUILTIN_METHODS.get(method):
        return made
    known, code = _METHOD_CHECKSUMS.get(method, (None, ""))
    if known is not there:
        try:
            code = source_checksum((there.fit, there.has_axis, there.checks_masks, there.as_published))
        except UnknownSourceError:
            code = UNKNOWN_CHECKSUM
        _METHOD_CHECKSUMS[method] = there, code
    return made | {METHOD_CODE_KEY: code}


def valid_result(
    folder: Path, checksum: str, method: str, options: Mapping[str, object], made_by: Mapping[str, str], overwrite: bool
) -> tuple[tuple[Reconstruction, dict[str, object]] | None, str]:
    """Return the result in a folder with its record, if it is valid, else None and the reason, empty for no result.

    ``source_checksum`` is that of the clip, ``software_of_method`` the software that would make it now. With ``overwrite`` none is good,
    for no reason. Raises ``UsageError`` where something else is in the result's place.
    """
    if not folder.exists():
        return None, ""
    if not is_result(folder):
        raise UsageError(f"{folder}: exists and is no result; it is not overwritten")
    if overwrite:
        return None, ""
    if made_by.get(METHOD_CODE_KEY) == UNKNOWN_CHECKSUM:
        return None, unknown_source_reason(method)
    try:
        result, record = read_result(folder)
    except InputError as error:
        return None, damaged_reason(error)
    there = record | record["software"]
    now = {"input_sha256": checksum, "method": method, "seed": options["seed"], "options": options, **made_by}
    why = describe_difference(
        there, now, RESULT_INPUT_LABELS | {"getagrip": f"version {files.shorten_value(there.get('getagrip'))}"}
    )
    return (None, why) if why else ((result, record), "")


def describe_difference(there: Mapping[str, object], now: Mapping[str, object], called: Mapping[str, str]) -> str:
    """Explain in which entry a record differs from the one that would be made now; empty where it does not.

    ``called`` are the entries that count, and how each is called.
    """
    of_now = json.loads(files.to_json({key: now.get(key) for key in called}))
    other = next((what for key, what in called.items() if there.get(key) != of_now[key]), "")
    return f"what was there is of {other}" if other else ""


def unknown_source_reason(method: str) -> str:
    """Return the reason where it cannot be known whether a method has changed."""
    return f"the source of the method {method} is in no file, and it may have changed"


def damaged_reason(error: object) -> str:
    """Return the reason where a record, or what belongs to it, cannot be read."""
    return f"what was there is damaged ({error})"


def provenance_of(clip: Path, options: Options, *code: str) -> Json:
    """Return what a record depends on; ``code`` are parts of the package that a reconstruction does not depend on."""
    return {
        "inputs": input_sha256(clip),
        "options": asdict(options),
        "software": software_of_method(options.method, *code),
    }


def load_or_compute(path: Path, of: Json, overwrite: bool, make: Callable[[], Json]) -> tuple[Json, str]:
    """Read the record in a file, if it is valid, else make and write it; also return why an existing one was not valid.

    The reason is empty where there was none, and with ``overwrite``.
    """
    why = ""
    if path.exists() and not overwrite:
        try:
            record = files.read_json(path)
            why = describe_difference(record, of, RECORD_INPUT_LABELS)
            if of["software"].get(METHOD_CODE_KEY) == UNKNOWN_CHECKSUM:
                why = unknown_source_reason(of["options"]["method"])
            if not why:
                return record, ""
        except InputError as error:
            why = damaged_reason(error)
    record = {**of, **make()}
    files.write_json(path, record)
    return record, why
