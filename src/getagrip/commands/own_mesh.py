"""The mesh of a user's own clip: from a file or, by its kind's name, one of this package's shapes; at a stated size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from getagrip.errors import InputError, UsageError
from getagrip.io.arguments import Flag, one_of
from getagrip.io.terminal import format_count

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray

    from getagrip.geometry.mesh import Mesh
    from getagrip.provenance import Source

Unit = Literal["mm", "cm", "m", "in"]
METRES_PER_UNIT: dict[Unit, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
MIN_PART_SIZE_FRACTION = 0.05
"""Parts smaller than this do not count as things of their own [share of the mesh's size]."""
FREE_SCALE_SIZE_M = 0.1
"""Largest side that a mesh of free scale gets where its own is no hand-held object's in metres [m]."""


@dataclass(frozen=True)
class MeshOptions:
    """The mesh of a user's own clip, and its size."""

    mesh: Annotated[Path | None, arg(metavar="FILE|KIND", help_behavior_hint="")] = None
    """The object's shape: a file (.obj, .ply, .stl or .glb) or, if there is no such file, the kind of a built-in shape:
    bottle, bowl, can, cup, glass, mug, pan, plate, saucepan, box, ..."""
    size_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest side of its bounding box."""
    diameter_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: as it is)")] = None
    """Rescale the mesh to this largest distance between two of its points."""
    unit: Annotated[Unit | None, one_of("mm", "cm", "m", "in"), arg(help_behavior_hint="(default: m)")] = None
    """The unit of the mesh file."""
    part: Annotated[str | None, arg(metavar="N|all", help_behavior_hint="")] = None
    """The part of the mesh that is the object, if it has separate ones, as a scan has with its table: 1 is the largest.
    all: all of them are."""
    known_scale: Flag = False
    """The mesh, in its unit, has the object's true size. Without this and without rescaling, the size is estimated."""

    @property
    def path(self) -> Path:
        """The mesh. Raises ``UsageError`` where none is named."""
        if self.mesh is None:
            raise UsageError("missing --mesh: the object's shape")
        return self.mesh

    @property
    def kind(self) -> str | None:
        """The kind of object whose own shape is wanted; None for a file."""
        from getagrip.datasets.synthetic.categories import SHAPE_MAKERS

        name = str(self.mesh)
        return name if name in SHAPE_MAKERS and not Path(name).is_file() else None


@dataclass(frozen=True)
class OwnMesh:
    """A mesh in metres."""

    mesh: Mesh
    sized: bool
    """True if it has the object's size; else the size is to be found with the pose."""
    provenance: dict[str, Source]
    """Sources of the mesh and its size."""


def read_own_mesh(request: MeshOptions) -> OwnMesh:
    """Read the mesh at its size.

    Raises ``InputError`` for a file that is missing or no mesh, ``UsageError`` for sizes that make no sense.
    """
    from getagrip.geometry.mesh_files import checked_mesh, drop_degenerate_faces
    from getagrip.provenance import assumed

    if request.kind is not None and request.known_scale:
        own = f"this package's own {request.kind}, whose size is not that of the one in your video"
        raise UsageError(f"--known-scale cannot be used with {own}: --size-mm or --diameter-mm")
    if request.kind is not None and request.unit is not None:
        raise UsageError(f"--unit cannot be used with this package's own {request.kind}, which is in metres")
    vertices, faces, shape = _read_mesh_arrays(request)
    words = shape.text
    kept = drop_degenerate_faces(vertices, faces)  # generated meshes are full of slivers
    if len(kept) < len(faces):
        words += f", {format_count(len(faces) - len(kept), 'face')} without area left out"
    kept, words_of_part, guess = _select_mesh_part(vertices, kept, request)
    words += words_of_part
    vertices, scale = _rescale_vertices(vertices, kept, request)
    if request.unit is not None:
        words += f", in {request.unit}"
    shape = assumed(words) if guess else replace(shape, text=words)
    provenance = {"mesh": shape} | ({} if scale is None else {"scale": scale})
    sized = request.known_scale or request.size_mm is not None or request.diameter_mm is not None
    return OwnMesh(checked_mesh(request.path, vertices, kept), sized, provenance)


def _read_mesh_arrays(request: MeshOptions) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."], Source]:
    """Vertices, faces, and where they come from."""
    from getagrip.datasets.synthetic.categories import SHAPE_MAKERS
    from getagrip.geometry.mesh_files import MESH_SUFFIXES, parse_mesh
    from getagrip.provenance import Source, assumed

    if request.kind is not None:
        made = SHAPE_MAKERS[request.kind]()
        return made.vertices, made.faces, assumed(f"this package's own {request.kind}: a guess of the object's shape")
    if not request.path.is_file():
        kinds = ", ".join(sorted(SHAPE_MAKERS))
        expected = f"a triangle mesh ({', '.join(MESH_SUFFIXES)}), or the name of one of this package's shapes: {kinds}"
        raise InputError(request.path, "mesh", "no such file", expected)
    return *parse_mesh(request.path), Source(request.path.name)


def _select_mesh_part(
    vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."], request: MeshOptions
) -> tuple[Int[ndarray, "..."], str, bool]:
    """Return the faces of the part that is the object, what is said of it, and whether that is a guess.

    Raises ``UsageError`` where a size is stated and it is not known of which of several parts, small debris apart.
    """
    import numpy as np

    from getagrip.geometry.mesh import separate_parts

    if request.part is not None and not (request.part == "all" or (request.part.isdecimal() and int(request.part))):
        raise UsageError(f"--part must be the number of a part, from 1, or all (got {request.part!r})")
    usable = vertices.ndim == 2 and vertices.shape[1:] == (3,) and faces.shape[1:] == (3,) and faces.size
    if not usable or not 0 <= faces.min() <= faces.max() < len(vertices) or not np.isfinite(vertices).all():
        return faces, "", False  # checked_mesh says what is wrong
    parts = separate_parts(vertices, faces)
    sides = [np.ptp(vertices[faces[part].ravel()], axis=0) for part in parts]
    whole = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    count = sum(side.max() >= MIN_PART_SIZE_FRACTION * whole for side in sides)
    listed = ", ".join(
        " x ".join(f"{METRES_PER_UNIT[request.unit or 'm'] * each:.3g}" for each in side) for side in sides[:count]
    )
    if request.part is not None and request.part != "all":
        number = int(request.part)
        if number > len(parts):
            raise UsageError(f"--part must be 1 to {len(parts)}, the parts of {request.path} (got {number})")
        return faces[np.sort(parts[number - 1])], f", part {number} of {len(parts)}", False
    if request.part == "all" or count < 2:
        return faces, "", False
    found = f"{count} separate parts, {listed} (sides [{'m' if request.unit else 'units of the file'}])"
    if request.size_mm is not None or request.diameter_mm is not None:
        option = "--size-mm" if request.size_mm is not None else "--diameter-mm"
        way = f"{option} is of that; or take the others out of the file"
        raise UsageError(f"{request.path}: {found}: missing --part N, the one that is held, or --part all; {way}")
    return faces, f", {found}, all taken as the object: a guess; --part takes one", True


def _rescale_vertices(
    vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."], request: MeshOptions
) -> tuple[Float[ndarray, "..."], Source | None]:
    """Vertices at the size that is stated, and where it comes from; None where none is stated.

    The size is that of the surface: files hold points that no face uses.
    """
    import numpy as np

    from getagrip.geometry.mesh import diameter
    from getagrip.geometry.mesh_files import MAX_MESH_EXTENT_M, MIN_MESH_EXTENT_M
    from getagrip.provenance import Source, assumed

    sizes = {"--size-mm": request.size_mm, "--diameter-mm": request.diameter_mm}
    stated = [(option, value) for option, value in sizes.items() if value is not None]
    if len(stated) > 1:
        raise UsageError("--size-mm cannot be used with --diameter-mm")
    known_unit = METRES_PER_UNIT[request.unit or "m"]
    used = vertices
    if faces.size and vertices.size and 0 <= faces.min() <= faces.max() < len(vertices):
        used = vertices[np.unique(faces)]
    extent = float(np.ptp(used, axis=0).max()) if used.ndim == 2 and used.size and np.isfinite(used).all() else 0.0
    plausible = MIN_MESH_EXTENT_M <= known_unit * extent <= MAX_MESH_EXTENT_M or extent == 0
    if not stated and plausible:
        return known_unit * vertices, None
    if not stated and request.known_scale:
        got = f"the object {known_unit * extent:.4g} m large"
        expected = f"{MIN_MESH_EXTENT_M:g} to {MAX_MESH_EXTENT_M:g} m; if the file is in another unit than the metre, --unit mm, cm or in"
        raise InputError(request.path, "vertices", got, f"{expected}, or --size-mm or --diameter-mm")
    if not stated:
        factor = FREE_SCALE_SIZE_M / extent
        text = f"the mesh, {extent:.4g} units large, rescaled by {factor:.6g}: its size is a guess"
        return factor * vertices, assumed(text)
    option, value = stated[0]
    if not 1e3 * MIN_MESH_EXTENT_M <= value <= 1e3 * MAX_MESH_EXTENT_M:
        raise UsageError(
            f"{option} must be {1e3 * MIN_MESH_EXTENT_M:g} to {1e3 * MAX_MESH_EXTENT_M:g} millimetres (got {value:g})"
        )
    now = (diameter(used) if option == "--diameter-mm" else extent) if extent else 0.0
    factor = value / 1e3 / now if now > 0 else 1.0  # checked_mesh reports what is wrong with the others
    return vertices * factor, Source(f"the mesh rescaled by {factor:.6g}, to {option} {value:g}")
