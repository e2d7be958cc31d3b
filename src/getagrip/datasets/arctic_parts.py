"""Which vertices of an ARCTIC template turn: by ``parts.json`` and by the parts' own meshes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import LARGEST_FILE, checked_mesh, with_area
from getagrip.geometry.obj import parse_obj
from getagrip.io import arrays
from getagrip.io.files import LARGEST_JSON, read_bytes

MM = 1e-3
TOP = 0
"""The number of the top in ``parts.json``: ARCTIC's code adds 1 and turns what is then 1."""
CLEAR = 0.002
"""A vertex this much nearer to one part than to the other belongs to it [m]; else ``parts.json`` decides."""
CONTRADICTION = 0.05
"""Share of the clear vertices that may differ from ``parts.json``: the template is coarser than its parts."""


def is_top(folder: Path, mesh: Mesh) -> Bool[ndarray, "V"]:
    """Return the vertices of the template in ``folder`` that turn. Raises ``InputError``."""
    numbered = _numbered(folder / "parts.json", len(mesh.vertices)) == TOP
    top, bottom = folder / "top.obj", folder / "bottom.obj"
    if not (top.is_file() and bottom.is_file()):
        return numbered
    nearer = _distance(bottom, mesh.vertices) - _distance(top, mesh.vertices)
    clear = np.abs(nearer) > CLEAR
    differ = clear & ((nearer > 0.0) != numbered)
    if differ.sum() > CONTRADICTION * clear.sum():
        got = f"{differ.sum()} of {clear.sum()} vertices numbered against top.obj and bottom.obj, which lie beside it"
        raise InputError(folder / "parts.json", "", got, f"{TOP} for each vertex of mesh.obj at top.obj, else 1")
    return np.where(clear, nearer > 0.0, numbered)


def _numbered(file: Path, count: int) -> ndarray:
    """Read the numbers in ``parts.json``, (V,)."""
    try:
        part = arrays.from_lists(json.loads(read_bytes(file, LARGEST_JSON)))
    except (ValueError, RecursionError) as error:
        raise InputError(file, "", f"text that is no JSON ({error})", "a JSON list") from error
    if part is None or part.shape != (count,) or not np.isin(part, (0, 1)).all():
        got = f"{len(part)} numbers" if part is not None and part.ndim == 1 else "something else"
        raise InputError(file, "", got, f"0 or 1 for each of the {count} vertices of mesh.obj")
    return part


def _distance(file: Path, points: Float[ndarray, "V 3"]) -> Float[ndarray, "V"]:
    """From points [m] to the surface of the mesh in a file [mm]."""
    import igl

    vertices, faces = parse_obj(file, read_bytes(file, LARGEST_FILE))
    vertices, faces = MM * vertices, with_area(MM * vertices, faces)
    checked_mesh(file, vertices, faces)
    tree = igl.AABB()
    tree.init(vertices, faces)
    return np.sqrt(tree.squared_distance(vertices, faces, points)[0])
