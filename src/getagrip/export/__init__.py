"""Results in other programs' formats."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from getagrip.errors import unknown_choice_error
from getagrip.export import (
    arrays_npz,
    bop,
    dex_retargeting,
    gltf,
    lerobot,
    mcap,
    mujoco,
    obj_sequence,
    poses_csv,
    spider,
    usd,
)
from getagrip.export.scene import Scene
from getagrip.io import files
from getagrip.io.plugins import PluginTable

__all__ = ["EXPORT_FORMATS", "Scene", "export"]

Write = Callable[[Scene, Path], dict[str, str]]
"""Function that writes a scene into an empty folder, and describes each file: content, units and axes."""

_FORMATS: dict[str, Write] = {
    "csv": poses_csv.write,
    "npz": arrays_npz.write,
    "obj": obj_sequence.write,
    "glb": gltf.write,
    "bop": bop.write,
    "usd": usd.write,
    "mujoco": mujoco.write,
    "lerobot": lerobot.write,
    "mcap": mcap.write,
    "spider": spider.write,
    "dex-retargeting": dex_retargeting.write,
}
EXPORT_FORMATS = PluginTable("exports", _FORMATS, "a function write(scene, folder)", lambda _, it: callable(it))
ABOUT_FILE = "about.json"


def remove_export(folder: Path) -> bool:
    """Remove a folder that ``export`` wrote, and return whether it was one; others stay.

    Raises the errors of ``files.refuse_link`` for a link in its place.
    """
    files.refuse_link(folder)
    if not (folder / ABOUT_FILE).is_file():
        return False
    shutil.rmtree(folder)
    return True


def export(scene: Scene, folder: str | Path, to: str, overwrite: bool = False) -> Path:
    """Write a scene into a folder in the format ``to``, with ``about.json``: files, units, axes, times and notes.

    Raises ``UsageError`` for a format that ``EXPORT_FORMATS`` lacks, and for an existing folder unless ``overwrite``.
    """
    if to not in EXPORT_FORMATS:
        raise unknown_choice_error("--to", to, EXPORT_FORMATS)
    folder, write = Path(folder), EXPORT_FORMATS[to]
    with files.new_folder(folder, (ABOUT_FILE,) if overwrite else ()) as new:
        about = scene.about(write(scene, new))
        files.write_json(new / ABOUT_FILE, {"format": to} | about)
    return folder
