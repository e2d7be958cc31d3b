"""Decide whether an earlier result or benchmark record is valid: readable, and of the same clip, options and code."""

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
"""Key in a record's software: the checksum of the source of a method that is not built in."""
UNKNOWN_CHECKSUM = "unknown"
"""Checksum of a method without source files: its results are never kept."""
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
"""Names for differing entries of a result's record, by key."""
RECORD_INPUT_LABELS = {
    "inputs": "another clip", "options": "other options", "software": "other code or other libraries",
}  # fmt: skip
"""Names for differing entries of a benchmark's record, by key."""
_METHOD_CHECKSUMS: dict[str, tuple[Method, str]] = {}
"""Checksums of methods that are not built in, computed once: a process does not run later changes of the source."""


def software_of_method(method: str, *also: str) -> dict[str, str]:
    """Return the software that results of a method depend on: versions, plug-ins, and the checksum of its source.

    ``also`` are parts of the package that reconstructions do not depend on. Built-in methods have no checksum.
    """
    current, software = method_of(method), software_versions(*also) | plugins.plugin_dependencies(method)
    if current is BUILTIN_METHODS.get(method):
        return software
    known, code = _METHOD_CHECKSUMS.get(method, (None, ""))
    if known is not current:
        try:
            code = source_checksum((current.fit, current.has_axis, current.checks_masks, current.as_published))
        except UnknownSourceError:
            code = UNKNOWN_CHECKSUM
        _METHOD_CHECKSUMS[method] = current, code
    return software | {METHOD_CODE_KEY: code}


def valid_result(
    folder: Path, checksum: str, method: str, options: Mapping[str, object], made_by: Mapping[str, str], overwrite: bool
) -> tuple[tuple[Reconstruction, dict[str, object]] | None, str]:
    """Return the result in a folder with its record if it is valid, else None and the reason (empty without a result).

    ``checksum`` is the clip's; ``made_by`` the present ``software_of_method``. With ``overwrite`` no result is valid,
    and the reason is empty. Raises ``UsageError`` where the folder holds something else.
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
    earlier = record | record["software"]
    now = {"input_sha256": checksum, "method": method, "seed": options["seed"], "options": options, **made_by}
    version = {"getagrip": f"version {files.shorten_value(earlier.get('getagrip'))}"}
    why = describe_difference(earlier, now, RESULT_INPUT_LABELS | version)
    return (None, why) if why else ((result, record), "")


def describe_difference(earlier: Mapping[str, object], now: Mapping[str, object], labels: Mapping[str, str]) -> str:
    """Describe the first entry in which an earlier record differs from a present one; empty if none.

    ``labels`` maps the keys that count to their names.
    """
    json_now = json.loads(files.to_json({key: now.get(key) for key in labels}))
    other = next((label for key, label in labels.items() if earlier.get(key) != json_now[key]), "")
    return f"the earlier result is of {other}" if other else ""


def unknown_source_reason(method: str) -> str:
    """Return the reason to repeat the work of a method without source files."""
    return f"the source of the method {method} is in no file, and it may have changed"


def damaged_reason(error: object) -> str:
    """Return the reason to repeat work with an unreadable record."""
    return f"the earlier result is damaged ({error})"


def provenance_of(clip: Path, options: Options, *code: str) -> Json:
    """Return the inputs of a benchmark's record; ``code`` are parts of the package beyond those of a reconstruction."""
    return {
        "inputs": input_sha256(clip),
        "options": asdict(options),
        "software": software_of_method(options.method, *code),
    }


def load_or_compute(path: Path, of: Json, overwrite: bool, make: Callable[[], Json]) -> tuple[Json, str]:
    """Read the record in a file if it is valid, else make and write it; also return why an earlier one was invalid.

    ``of`` is its ``provenance_of``. The reason is empty without an earlier record, and with ``overwrite``.
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
