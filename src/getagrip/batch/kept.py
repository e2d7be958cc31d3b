"""Whether a result that is there is still good: of the same clip, options and code, and readable."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.result import Reconstruction, is_result, read_result


def good_result(
    folder: Path, checksum: str, method: str, options: Mapping[str, Any], made_by: Mapping[str, str], overwrite: bool
) -> tuple[tuple[Reconstruction, dict[str, Any]] | None, str]:
    """The result in a folder with its record, if it is good, else None and why not; the reason is empty for no result.

    ``checksum`` is that of the clip, ``made_by`` the software that would make it now. With ``overwrite`` none is good,
    for no reason. Raises ``UsageError`` where something else is in the result's place.
    """
    if not folder.exists():
        return None, ""
    if not is_result(folder):
        raise UsageError(f"{folder}: exists and is no result; it is not overwritten")
    if overwrite:
        return None, ""
    try:
        result, record = read_result(folder)
    except InputError as error:
        return None, f"what was there is damaged ({error})"
    then = record["software"]
    same = {
        "another clip": record["input_sha256"] == checksum,
        "another method": record["method"] == method,
        "another seed": record["seed"] == options["seed"],
        "other options": record["options"] == json.loads(files.to_json(options)),
        f"version {files.shown(then.get('getagrip'))}": then.get("getagrip") == made_by["getagrip"],
        "other code": then.get("code") == made_by["code"],
    }
    other = next((what for what, holds in same.items() if not holds), "")
    return (None, f"what was there is of {other}") if other else ((result, record), "")
