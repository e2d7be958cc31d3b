"""Binary glTF: read as trimesh reads it; what is damaged, endless or vast is refused."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from getagrip.geometry.mesh_files import glb, read_mesh
from getagrip.geometry.mesh_files.glb import parse_glb

PART: dict[str, Any] = {"attributes": {"POSITION": 0}, "indices": 1}
POINTS: dict[str, Any] = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
IDS: dict[str, Any] = {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}
OVER = {"buffer": 0, "byteLength": 48, "byteStride": 0}
"""A view of an array all of whose rows are the first."""
LONG, LAST = {"buffer": 0, "byteLength": 48, "byteStride": 8}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}
HUGE = [1e308] * 16


def file(index: int = 2, x: float = 0.1, **changes: object) -> bytes:
    """A file of four vertices and one triangle, its last corner the vertex ``index``, one coordinate ``x``."""
    tree: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [PART]}],
        "buffers": [{"byteLength": 60}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, LAST],
        "accessors": [POINTS, IDS],
    }
    text = json.dumps(tree | changes).encode()
    text += b" " * (-len(text) % 4)
    data = struct.pack("<12f3I", 0, 0, 0, x, 0, 0, 0, 0.1, 0, 0.1, 0.2, 0.3, 0, 1, index)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(data)) + b"BIN\0" + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def scene(*nodes: dict[str, object], roots: tuple[int, ...] = (0,)) -> dict[str, object]:
    """Changes to a file: its nodes."""
    return {"nodes": nodes, "scenes": [{"nodes": roots}]}


BROKEN: dict[str, tuple[bytes, str, str]] = {
    "beyond": (file(index=9), "faces", "must be 0 to 3"),
    "nan": (file(x=np.nan), "vertices", "NaN"),
    "bodiless": (file(accessors=[{"componentType": 5126, "count": 10**9, "type": "VEC3"}] * 2), "mesh", "plain data"),
    "draco": (file(extensionsRequired=["KHR_draco_mesh_compression"]), "mesh", "draco"),
    "brackets": (file()[:12] + struct.pack("<I", 10**5) + b"JSON" + b"[" * 10**5, "mesh", "does not parse"),
    "short": (file()[:-4], "mesh", "cut short"),
    "outside": (file(buffers=[{"uri": "file:///etc/passwd", "byteLength": 60}]), "buffers", "outside the file"),
    "count": (file(accessors=[POINTS | {"count": 10**12}, IDS]), "mesh", "does not parse"),
    "less": (file(accessors=[POINTS | {"count": -1}, IDS]), "mesh", "does not parse"),
    "floats": (file(accessors=[POINTS, IDS | {"componentType": 5126}]), "faces", "the vertex index"),
    "repeated": (file(**scene(*[{"mesh": 0}] * 9000, roots=tuple(range(9000))), accessors=[
        POINTS | {"count": 500, "bufferView": 2}, IDS], bufferViews=[OVER, OVER | {"byteOffset": 48}, OVER]),
        "nodes", "4194500 vertices"),
    "points": (file(accessors=[POINTS | {"count": 10**9}, IDS], bufferViews=[OVER] * 2), "nodes", "1000000000 vert"),
    "corners": (file(accessors=[POINTS, IDS | {"count": 10**9}], bufferViews=[OVER] * 2), "nodes", "1000000000 corn"),
    "circle": (file(**scene({"mesh": 0, "children": [1]}, {"children": [0]})), "mesh", "nodes[0] is in two places"),
    "shared": (file(**scene({"children": [1, 1]}, {"mesh": 0})), "mesh", "nodes[1] is in two places"),
    "before": (file(**scene({"mesh": -1})), "mesh", "no meshes[-1]"),
    "huge": (file(**scene({"mesh": 0, "matrix": HUGE})), "nodes[0]", "a transform with numbers that are vast"),
    "overflow": (file(**scene({"matrix": HUGE, "children": [1]}, {"mesh": 0})), "nodes[0]", "must be at most 1e+06"),
    "unturned": (file(**scene({"mesh": 0, "rotation": [0, 0, 0, 0]})), "nodes[0]", "not finite"),
    "digits": (file(**scene({"mesh": 0, "scale": [10**400, 1, 1]})), "mesh", "does not parse"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_named_in_one_line(tmp_path: Path, refused: Callable[..., str], name: str) -> None:
    content, key, words = BROKEN[name]
    (tmp_path / f"{name}.glb").write_bytes(content)
    refused(lambda: read_mesh(tmp_path / f"{name}.glb"), f"{name}.glb: {key} must be ", "got ", words)


def test_scenes_of_many_parts_are_refused(refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    chain = [*({"children": [n + 1]} for n in range(4)), {"mesh": 0}]
    path, part = Path("a.glb"), {"primitives": [PART] * 5}
    monkeypatch.setattr(glb, "MAX_GLTF_PARTS", 5)
    for content in (file(**scene(*chain)), file(meshes=[part])):
        assert len(parse_glb(path, content)[1])
    monkeypatch.setattr(glb, "MAX_GLTF_PARTS", 4)
    refused(lambda: parse_glb(path, file(**scene(*chain))), "nodes must be ", "got more than 4 in the scene")
    refused(lambda: parse_glb(path, file(meshes=[part])), "nodes must be ", "got more than 4 parts of meshes")
    monkeypatch.setattr(glb, "MAX_GLTF_JSON_BYTES", 100)
    refused(lambda: parse_glb(path, file()), "JSON", "at most 100")


@pytest.mark.parametrize(
    "changes",
    [
        scene({"children": [1], "translation": [1, 2, 3], "rotation": [0.5, 0.5, 0.1, 0.7], "scale": [1, 2, 3]},
              {"mesh": 0, "rotation": [0, 0, 1, 0], "scale": [1, 1, -1]}),
        scene({"mesh": 0, "matrix": [1, 2, 3, 0, 0, 1, 0, 0, 5, 0, 1, 0, 7, 8, 9, 1]}),
        {"meshes": [{"primitives": [PART | {"mode": 5, "indices": 2}]}], "accessors": [
            POINTS, IDS, {"bufferView": 1, "componentType": 5121, "count": 10, "type": "SCALAR"}]},
        {"meshes": [{"primitives": [PART, {"attributes": {"POSITION": 2}}, PART | {"mode": 0}]}], "accessors": [
            POINTS, IDS, POINTS | {"byteOffset": 12, "count": 3}]},
        {"accessors": [POINTS | {"componentType": 5122}, IDS],
         "bufferViews": [LONG, LAST]},
    ],
    ids=["TRS", "matrix", "strip", "parts", "whole numbers, interleaved"],
)  # fmt: skip
def test_files_are_read_as_trimesh_reads_them(changes: dict[str, Any]) -> None:
    content = file(**changes)
    vertices, faces = parse_glb(Path("a.glb"), content)
    other = trimesh.load(BytesIO(content), file_type="glb", force="mesh", process=False)
    assert np.allclose(vertices, other.vertices, rtol=1e-12, atol=1e-12)
    assert faces.tolist() == other.faces.tolist()


def test_the_parts_of_a_scene_stand_where_its_transforms_put_them(tmp_path: Path) -> None:
    part, scene = trimesh.creation.box((0.1, 0.06, 0.04)), trimesh.Scene()
    turned = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0.1, 0, 0])
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirrored[0, 3] = 0.3
    scene.add_geometry(part, node_name="turned", transform=turned)
    scene.add_geometry(part, node_name="nested", parent_node_name="turned", transform=mirrored)
    scene.export(tmp_path / "scene.glb")
    mesh = read_mesh(tmp_path / "scene.glb")
    placed = [trimesh.transform_points(part.vertices, T) for T in (turned, turned @ mirrored)]
    for corner in np.concatenate(placed):
        assert np.linalg.norm(mesh.vertices - corner, axis=1).min() < 1e-6
    assert mesh.volume == pytest.approx(2 * part.volume, rel=1e-4)  # the mirrored part's faces look outward too
