"""Binary glTF files (.glb), read for the triangles of their scene and, where asked for, these triangles' colours.

Not read by trimesh, which decodes every mesh of a file, in the scene or not, before anything can be counted. Here
arrays are views of the file, copied once the total size is known.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry.mesh_files.obj import MAX_OBJ_ELEMENTS
from getagrip.geometry.se3 import from_quaternion, transform
from getagrip.io import files

MAX_GLTF_JSON_BYTES = 16 * 2**20
MAX_GLTF_PARTS = 2**16
"""Maximum number of nodes, and of their meshes' parts."""
MAX_GLTF_IMAGES = 32
"""Maximum number of images that a scene shows; each may take a second to decode."""
MAX_NODE_TRANSFORM = 1e6
"""Largest number in a node's transform."""
COMPONENT_DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Numpy's types by ``componentType``."""
TRIANGLES_MODE, TRIANGLE_STRIP_MODE = 4, 5
"""Values of ``mode`` for parts with triangles."""


def parse_glb(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Parse vertices and faces of the scene, placed by its nodes; ``path`` is only named in errors.

    Materials, normals, textures, skins and animations are ignored. Raises ``InputError``.
    """
    try:
        return _scene_triangles(_split_chunks(path, content))
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise InputError(path, "mesh", f"a file that does not parse ({error})", "a whole .glb file") from error


def parse_glb_colours(path: Path, content: bytes) -> tuple[list[PaintedPart], dict[int, memoryview]]:
    """Parse the parts of a scene with colours and textures, and views of their images' bytes by index.

    Without a texture or colours of vertices, no parts. Raises ``InputError``, also for images outside the file.
    """
    try:
        file = _split_chunks(path, content)
        found = _scene_parts(file)
        parts = [_painted_part(file, *part) for part in found]
        shown = {part.image for part in parts if part.image is not None}
        if len(shown) > MAX_GLTF_IMAGES:
            raise InputError(path, "images", f"{len(shown)} images", f"at most {MAX_GLTF_IMAGES}")
        painted = shown or any("COLOR_0" in part.source["attributes"] for part, _ in found)
        return parts if painted else [], {n: _image_content(file, n) for n in shown}
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise InputError(path, "mesh", f"colours that do not parse ({error})", "a whole .glb file") from error


def names_glb_texture(path: Path, content: bytes) -> bool:
    """Return whether a file has a material with a texture of colours. Raises ``InputError``."""
    try:
        materials = _split_chunks(path, content).tree.get("materials", [])
        return any("baseColorTexture" in one.get("pbrMetallicRoughness", {}) for one in materials)
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise InputError(path, "mesh", f"a file that does not parse ({error})", "a whole .glb file") from error


@dataclass(frozen=True)
class _GltfFile:
    """A file's unchecked JSON, and the bytes of its arrays."""

    path: Path
    tree: files.Json
    data: memoryview

    def item(self, key: str, n: int) -> files.Json:
        """Return an item of a list."""
        if not 0 <= n < len(self.tree[key]):
            raise LookupError(f"no {key}[{n}]")
        return self.tree[key][n]

    def array(self, n: int, width: int) -> Shaped[ndarray, "n width"]:
        """Return a view of an array in the file, of the stated length: rows may overlap."""
        if self.item("accessors", n).get("normalized"):
            raise InputError(self.path, "mesh", "arrays without plain data", "a .glb exported without compression")
        return self._view(n, width)

    def fractions(self, n: int, width: int) -> Float[ndarray, "n width"]:
        """Return a copy of an array of fractions, which are stored as such or as whole numbers."""
        values = self._view(n, width)
        most = 1.0 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
        if not np.isfinite(values).all():
            raise ValueError(f"accessors[{n}] is not finite")
        return values / most

    def _view(self, n: int, width: int) -> Shaped[ndarray, "n width"]:
        accessor = self.item("accessors", n)
        if "bufferView" not in accessor or "sparse" in accessor:
            raise InputError(self.path, "mesh", "arrays without plain data", "a .glb exported without compression")
        if accessor["type"] != {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[width]:
            raise ValueError(f"accessors[{n}] is not what it is used for")
        view, dtype = accessor["bufferView"], np.dtype(COMPONENT_DTYPES[accessor["componentType"]])
        strides = (self.item("bufferViews", view).get("byteStride", width * dtype.itemsize), dtype.itemsize)
        offset = accessor.get("byteOffset", 0)
        return np.ndarray((accessor["count"], width), dtype, self.bytes_of(view), offset, strides)

    def bytes_of(self, view: int) -> memoryview:
        """Return the bytes of a view."""
        found = self.item("bufferViews", view)
        if found["buffer"] != 0 or "uri" in self.item("buffers", 0):
            raise InputError(self.path, "buffers", "arrays outside the file", "a .glb with all arrays in it")
        start = found.get("byteOffset", 0)
        return self.data[start : start + found["byteLength"]]


class _MeshPrimitive(NamedTuple):
    """A part of a mesh, viewed in the file."""

    points: Shaped[ndarray, "n 3"]
    ids: Shaped[ndarray, "m 1"] | None
    """Vertex id of each corner; None: each vertex is a corner, in order."""
    is_strip: bool
    """True if each corner from the third on forms a triangle with the two before it."""
    source: files.Json
    """Content of the file."""


class PaintedPart(NamedTuple):
    """A part of a scene with its colours."""

    corners: Float[ndarray, "n 8"]
    """Place in the scene; place in the image, to the right and down, in its sides; red, green and blue, as intensities
    of light, by which the image's are multiplied."""
    faces: Int[ndarray, "F 3"]
    image: int | None
    """Index of the image's bytes, of ``parse_glb_colours``."""


def _split_chunks(path: Path, content: bytes) -> _GltfFile:
    if content[:4] != b"glTF" or content[16:20] != b"JSON":
        raise ValueError("no glTF header")
    end = 20 + int.from_bytes(content[12:16], "little")
    if end - 20 > MAX_GLTF_JSON_BYTES:
        raise InputError(path, "JSON", f"{end - 20} bytes", f"at most {MAX_GLTF_JSON_BYTES}")
    tree = json.loads(content[20:end])
    compressed = [name for name in tree.get("extensionsRequired", []) if "compress" in name]
    if compressed:
        raise InputError(path, "mesh", files.printable(str(compressed[0])), "a .glb exported without compression")
    data = memoryview(content)[end + 8 :]
    length = int.from_bytes(content[end : end + 4], "little")
    if len(data) < length:
        raise ValueError("it is cut short")
    return _GltfFile(path, tree, data[:length])


def _scene_parts(file: _GltfFile) -> list[tuple[_MeshPrimitive, Float[ndarray, "4 4"]]]:
    """Return all parts with their poses in the scene, scale included."""
    parts, vertices, corners = [], 0, 0
    of_mesh: dict[int, list[_MeshPrimitive]] = {}
    for mesh, T_scene_node in _iterate_mesh_poses(file):
        if mesh not in of_mesh:
            of_mesh[mesh] = list(_triangle_primitives(file, mesh))
        for part in of_mesh[mesh]:
            vertices += len(part.points)
            corners += len(part.points if part.ids is None else part.ids)
            parts.append((part, T_scene_node))
            if len(parts) > MAX_GLTF_PARTS:
                got = f"more than {MAX_GLTF_PARTS} parts of meshes"
                raise InputError(file.path, "nodes", got, f"at most {MAX_GLTF_PARTS}")
            if vertices > MAX_OBJ_ELEMENTS or corners > 3 * MAX_OBJ_ELEMENTS:
                got = f"{vertices} vertices and {corners} corners of faces, or more"
                most = f"at most {MAX_OBJ_ELEMENTS} vertices and {3 * MAX_OBJ_ELEMENTS} corners"
                raise InputError(file.path, "nodes", got, most)
    return parts


def _scene_triangles(file: _GltfFile) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Return vertices and faces of all parts."""
    first, placed, joined = 0, [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    for part, T_scene_node in _scene_parts(file):
        placed.append(transform(T_scene_node, part.points.astype(float)))
        joined.append(first + _placed_faces(file, part, T_scene_node))
        first += len(part.points)
    return np.concatenate(placed), np.concatenate(joined)


def _placed_faces(file: _GltfFile, part: _MeshPrimitive, T_scene_node: Float[ndarray, "4 4"]) -> Int[ndarray, "F 3"]:
    ids = np.arange(len(part.points)) if part.ids is None else part.ids.ravel()
    faces = _primitive_faces(file.path, ids, len(part.points), part.is_strip)
    return faces[:, ::-1] if np.linalg.det(T_scene_node[:3, :3]) < 0 else faces


def _painted_part(file: _GltfFile, part: _MeshPrimitive, T_scene_node: Float[ndarray, "4 4"]) -> PaintedPart:
    """Return a part with its colours: those of its material, of its vertices and of its texture, multiplied."""
    attributes, material = part.source["attributes"], {}
    if "material" in part.source:
        material = file.item("materials", part.source["material"]).get("pbrMetallicRoughness", {})
    light = np.ones((len(part.points), 3)) * np.array(material.get("baseColorFactor", [1.0] * 4), dtype=float)[:3]
    if "COLOR_0" in attributes:
        width = 4 if file.item("accessors", attributes["COLOR_0"])["type"] == "VEC4" else 3
        light = light * file.fractions(attributes["COLOR_0"], width)[:, :3]
    uv, image, texture = np.zeros((len(part.points), 2)), None, material.get("baseColorTexture")
    if texture is not None:
        if texture.get("extensions"):
            raise InputError(file.path, "textures", "a texture with extensions", "one placed by its coordinates")
        uv = file.fractions(attributes[f"TEXCOORD_{texture.get('texCoord', 0)}"], 2)
        image = int(file.item("textures", texture["index"])["source"])
    placed = transform(T_scene_node, part.points.astype(float))
    if not np.isfinite(light).all():
        raise ValueError("its colours are not finite")
    corners = np.concatenate([placed, uv, np.clip(light, 0.0, 1.0)], axis=1)
    return PaintedPart(corners, _placed_faces(file, part, T_scene_node), image)


def _image_content(file: _GltfFile, n: int) -> memoryview:
    image = file.item("images", n)
    if "bufferView" not in image:
        raise InputError(file.path, "images", "an image outside the file", "a .glb with all images in it")
    return file.bytes_of(image["bufferView"])


def _iterate_mesh_poses(file: _GltfFile) -> Iterator[tuple[int, Float[ndarray, "4 4"]]]:
    """Yield each mesh of the scene with its pose, scale included."""
    if not file.tree.get("scenes"):
        return
    scene, seen = file.item("scenes", file.tree.get("scene", 0)), set()
    waiting = [(scene.get("nodes", []), np.eye(4))]
    for children, T_scene_parent in waiting:
        for n in children:
            node = file.item("nodes", n)
            if n in seen:
                raise ValueError(f"nodes[{n}] is in two places")
            seen.add(n)
            if len(seen) > MAX_GLTF_PARTS:
                raise InputError(file.path, "nodes", f"more than {MAX_GLTF_PARTS} in the scene", "at most that")
            with np.errstate(all="ignore"):
                T_scene_node = T_scene_parent @ _node_transform(node)
            if not (np.abs(T_scene_node) <= MAX_NODE_TRANSFORM).all():
                got = "a transform with numbers that are vast or not finite"
                raise InputError(file.path, f"nodes[{n}]", got, f"at most {MAX_NODE_TRANSFORM:g}, in the scene")
            waiting.append((node.get("children", []), T_scene_node))
            if "mesh" in node:
                yield node["mesh"], T_scene_node


def _node_transform(node: files.Json) -> Float[ndarray, "4 4"]:
    """Return the pose of a node in its parent, scale included."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T  # stored by columns
    T = np.eye(4)
    if "rotation" in node:
        x, y, z, w = np.array(node["rotation"], dtype=float)
        T[:3, :3] = from_quaternion(np.array([w, x, y, z]))
    T[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), dtype=float)
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


def _triangle_primitives(file: _GltfFile, mesh: int) -> Iterator[_MeshPrimitive]:
    """Yield a mesh's parts with triangles."""
    for part in file.item("meshes", mesh)["primitives"]:
        mode = part.get("mode", TRIANGLES_MODE)
        if mode in (TRIANGLES_MODE, TRIANGLE_STRIP_MODE):
            ids = file.array(part["indices"], 1) if "indices" in part else None
            yield _MeshPrimitive(file.array(part["attributes"]["POSITION"], 3), ids, mode == TRIANGLE_STRIP_MODE, part)


def _primitive_faces(path: Path, ids: Shaped[ndarray, "n"], vertices: int, is_strip: bool) -> Int[ndarray, "F 3"]:
    if ids.dtype.kind == "f" or (len(ids) and not 0 <= ids.min() <= ids.max() < vertices):
        raise InputError(path, "faces", f"the vertex index {ids.max()}", f"0 to {vertices - 1}, counted from 0")
    if not is_strip:
        return ids.astype(np.int64).reshape(-1, 3)
    faces = np.stack([ids[:-2], ids[1:-1], ids[2:]], axis=1).astype(np.int64)
    faces[1::2] = faces[1::2, ::-1]  # every second triangle has the opposite winding
    return faces
