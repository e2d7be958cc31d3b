"""The mesh of a user's own clip: from a file or, by its kind's name, one of this package's shapes; at a stated size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip.provenance import Source, assumed, measured
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.errors import InputError, UsageError
from getagrip.geometry.mesh import Mesh, diameter
from getagrip.geometry.mesh_files import LARGEST, SMALLEST, SUFFIXES, checked_mesh, parse_mesh, with_area
from getagrip.io.counts import counted

Unit = Literal["mm", "cm", "m", "in"]
METRES: dict[Unit, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
FREE_SIZE = 0.1
"""Largest side that a mesh of free scale gets where its own is no hand-held object's in metres [m]."""


@dataclass(frozen=True)
class MeshRequest:
    """The mesh options of a command."""

    path: Path
    """A file or, where there is none of that name, a kind of object."""
    side_mm: float | None
    """Rescale it to this largest side of its bounding box."""
    diameter_mm: float | None
    """Rescale it to this largest distance between two of its points."""
    known_scale: bool
    """It has the object's size as it is."""
    unit: Unit | None = None
    """What one unit of the file is; None for metres."""

    @property
    def kind(self) -> str | None:
        """The kind of object whose own shape is wanted; None for a file."""
        name = str(self.path)
        return name if name in CATEGORIES and not self.path.is_file() else None


@dataclass(frozen=True)
class OwnMesh:
    """A mesh in metres."""

    mesh: Mesh
    sized: bool
    """Whether it has the object's size; else that is to be found with its pose."""
    provenance: dict[str, Source]
    """Where it and its size come from."""


def own_mesh(request: MeshRequest) -> OwnMesh:
    """The mesh at its size.

    Raises ``InputError`` for a file that is missing or no mesh, ``UsageError`` for sizes that make no sense.
    """
    if request.kind is not None and request.known_scale:
        expected = "--size-mm or --diameter-mm: its size is not that of the one in your video"
        raise UsageError(f"--known-scale: got it with this package's own {request.kind}, expected {expected}")
    if request.kind is not None and request.unit is not None:
        raise UsageError(f"--unit: got {request.unit}, expected none: this package's own {request.kind} is in metres")
    vertices, faces, shape = _shape(request)
    words = shape.text
    kept = with_area(vertices, faces)  # generated meshes are full of slivers
    if len(kept) < len(faces):
        words += f", {counted(len(faces) - len(kept), 'face')} without area left out"
    vertices, scale = _rescaled(vertices, kept, request)
    if request.unit is not None:
        words += f", in {request.unit}"
    provenance = {"mesh": replace(shape, text=words)} | ({} if scale is None else {"scale": scale})
    sized = request.known_scale or request.side_mm is not None or request.diameter_mm is not None
    return OwnMesh(checked_mesh(request.path, vertices, kept), sized, provenance)


def _shape(request: MeshRequest) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."], Source]:
    """Vertices, faces, and where they come from."""
    if request.kind is not None:
        made = CATEGORIES[request.kind].make()
        return made.vertices, made.faces, assumed(f"this package's own {request.kind}: a guess of the object's shape")
    if not request.path.is_file():
        kinds = ", ".join(sorted(CATEGORIES))
        expected = f"a triangle mesh ({', '.join(SUFFIXES)}), or the name of one of this package's shapes: {kinds}"
        raise InputError(request.path, "mesh", "no such file", expected)
    return *parse_mesh(request.path), measured(request.path.name)


def _rescaled(
    vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."], request: MeshRequest
) -> tuple[Float[ndarray, "..."], Source | None]:
    """Vertices at the size that is stated, and where it comes from; None where none is stated.

    The size is that of the surface: files hold points that no face uses.
    """
    sizes = {"--size-mm": request.side_mm, "--diameter-mm": request.diameter_mm}
    stated = [(option, value) for option, value in sizes.items() if value is not None]
    if len(stated) > 1:
        raise UsageError("--size-mm, --diameter-mm: got both, expected one")
    known_unit = METRES[request.unit or "m"]
    used = vertices
    if faces.size and vertices.size and 0 <= faces.min() <= faces.max() < len(vertices):
        used = vertices[np.unique(faces)]
    extent = float(np.ptp(used, axis=0).max()) if used.ndim == 2 and used.size and np.isfinite(used).all() else 0.0
    plausible = SMALLEST <= known_unit * extent <= LARGEST or extent == 0
    if not stated and plausible:
        return known_unit * vertices, None
    if not stated and request.known_scale:
        given = f"the object {known_unit * extent:.4g} m large"
        expected = f"{SMALLEST:g} to {LARGEST:g} m; if the file is in another unit than the metre, --unit mm, cm or in"
        raise InputError(request.path, "vertices", given, f"{expected}, or --size-mm or --diameter-mm")
    if not stated:
        factor = FREE_SIZE / extent
        text = f"the mesh, {extent:.4g} units large, rescaled by {factor:.6g}: its size is a guess"
        return factor * vertices, assumed(text)
    option, value = stated[0]
    if not 1e3 * SMALLEST <= value <= 1e3 * LARGEST:
        raise UsageError(f"{option}: got {value:g}, expected {1e3 * SMALLEST:g} to {1e3 * LARGEST:g} millimetres")
    now = (diameter(used) if option == "--diameter-mm" else extent) if extent else 0.0
    factor = value / 1e3 / now if now > 0 else 1.0  # checked_mesh reports what is wrong with the others
    return vertices * factor, measured(f"the mesh rescaled by {factor:.6g}, to {option} {value:g}")
