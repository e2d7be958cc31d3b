"""The YCB models that DexYCB and HO-3D hold."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from getagrip.errors import InputError, UsageError
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MESH_SUFFIXES, read_mesh

Models = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: ROOT/models)")]
"""The option that names their folder."""


def ycb_models_folder(root: Path, value: Path | None) -> Path:
    """Return the folder of the models: the one given, or else ``models`` in ``root``.

    Raises ``UsageError`` without it.
    """
    models = value or root / "models"
    if not models.is_dir():
        raise UsageError(f"--meshes must be the folder of the YCB models (got {models}, which is no folder)")
    return models


def read_ycb_mesh(models: Path, name: str) -> Mesh:
    """Read a model in metres. Raises ``InputError``, also where the folder has none of that name."""
    found = find_mesh(models, name)
    if found is None:
        raise InputError(models, name, "no mesh of it", f"{name}.obj or {name}/*.obj")
    return found


@lru_cache
def find_mesh(models: Path, name: str) -> Mesh | None:
    """Find ``<name>.obj`` (or another format), or as YCB has it, ``<name>/textured_simple.obj``; else None."""
    for path in (*(models / f"{name}{suffix}" for suffix in MESH_SUFFIXES), models / name / "textured_simple.obj"):
        if path.is_file():
            return read_mesh(path)
    return None
