"""The object's shape as the page states it: the built-in kinds with their pictures, and what is wrong with a mesh."""

from __future__ import annotations

import io
from functools import lru_cache
from pathlib import Path

import numpy as np

from getagrip.errors import GetagripError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.rasterize import render_rgb
from getagrip.report.pictures.panels import OBJECT_RGB, PAPER_RGB, look_at
from getagrip.studio.jobs import RequestedMesh
from getagrip.studio.store.history import RefusedError
from getagrip.synthetic.categories import SHAPE_MAKERS

KINDS = tuple(sorted(SHAPE_MAKERS))
"""Names of the built-in kinds."""
PICTURE_PX = 72
MAX_SIZE_RATIO = 3.0
"""Ratio of a stated size to the usual one of a kind, or its inverse, above which it may be of another unit."""


@lru_cache(maxsize=len(KINDS))
def _mesh_of_kind(kind: str) -> Mesh:
    return SHAPE_MAKERS[kind]()


@lru_cache(maxsize=len(KINDS))
def kind_picture(kind: str) -> bytes:
    """Return a picture of a built-in kind as PNG. Raises ``RefusedError`` for an unknown one."""
    from PIL import Image

    if kind not in KINDS:
        raise RefusedError(f"kind must be one of {', '.join(KINDS)}")
    mesh = _mesh_of_kind(kind)
    eye = look_at(mesh.vertices, np.array([0.5, -0.9, 0.5]), np.array([0.0, 0.0, 1.0]), PICTURE_PX)
    posed = (se3.transform(eye.T_view_frame, mesh.vertices), mesh.faces, OBJECT_RGB)
    picture = render_rgb([posed], eye.K, (PICTURE_PX, PICTURE_PX), PAPER_RGB)
    content = io.BytesIO()
    Image.fromarray(picture).save(content, "PNG")
    return content.getvalue()


def mesh_error(shape: RequestedMesh) -> str:
    """Return why a mesh is none, in words; empty for a kind, and for a file that reads."""
    path = Path(shape.mesh)
    try:
        if path.is_file():
            read_mesh(path)
        elif shape.mesh not in KINDS:
            return f"{shape.mesh}: no such file on this machine, and no kind of the list"
    except (GetagripError, OSError, ValueError) as error:
        return str(error)
    return ""


def unusual_size(shape: RequestedMesh) -> str:
    """Return what is odd about the stated size of a kind, in words; empty for a usual size, and for a file."""
    if shape.size_mm is None or shape.mesh not in KINDS or Path(shape.mesh).is_file():
        return ""
    usual = 1e3 * float(np.ptp(_mesh_of_kind(shape.mesh).vertices, axis=0).max())
    if 1.0 / MAX_SIZE_RATIO <= shape.size_mm / usual <= MAX_SIZE_RATIO:
        return ""
    return f"{shape.mesh}: the largest side is usually about {usual:.0f} mm; is {shape.size_mm:g} in millimetres?"
