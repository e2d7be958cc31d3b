"""The list of grasps beside the clips of an import: how they were cut, and which grasp each of them is.

It is made from the clips themselves, so the clips of a folder and their table cannot come from two segmentations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from getagrip.clip.reading import read_header
from getagrip.errors import InputError, UsageError
from getagrip.grasps import lists
from getagrip.io import files


def claim(out: Path, cut: Mapping[str, Any] | None) -> None:
    """Note in the folder how its clips are cut (None: they are not), before there are any.

    Raises ``UsageError`` where it holds clips that were cut in another way, ``InputError`` for a damaged list.
    """
    path = out / lists.FILE
    if path.exists():
        if cut is None or lists.read_cut(path) != cut:
            here = "no grasps" if cut is None else files.shown(dict(cut))
            why = f"it holds clips cut as {path.name} there says, not {here}"
            raise UsageError(f"--out {out} cannot be used with this import: {why}")
    elif cut is not None:
        if next(out.glob("*/clip.json"), None) is not None:
            why = f"it holds clips and no {path.name} that says how they were cut"
            raise UsageError(f"--out {out} cannot be used with this import: {why}")
        out.mkdir(parents=True, exist_ok=True)
        lists.write(path, [], cut)


def write(out: Path, cut: Mapping[str, Any], note: Callable[[str], None]) -> int:
    """Write the list of the clips that are there; returns how many they are."""
    grasps = []
    for folder in sorted(path.parent for path in out.glob("*/clip.json")):
        try:
            path = folder / "clip.json"
            row = read_header(folder).fields["provenance"].get("grasp")
            if not isinstance(row, dict):
                raise InputError(path, "provenance.grasp", files.shown(row), "the grasp that the clip is")
            grasps.append(lists.grasp_of(path, "provenance.grasp.", row))
        except InputError as error:
            note(f"not in {lists.FILE}: {error}")
    lists.write(out / lists.FILE, grasps, cut)
    return len(grasps)
