"""Colours of meshes: read within limits, kept by every step that makes a mesh of another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from pygltflib import GLTF2
from pygltflib import Image as GltfImage
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import getagrip
from getagrip.cli.new_clip import MeshOptions, OwnMesh, read_own_mesh
from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh, cluster_vertices, decimate
from getagrip.geometry.mesh_files import glb, read_mesh, read_textured_mesh, write_mesh
from getagrip.geometry.mesh_files.colours import colours_of_light, light_of
from getagrip.geometry.warp import Warp
from getagrip.synthetic.scene import mirror_mesh
from tests.synthetic.test_filmed import CUBE, scan_in


def coloured_mug() -> Mesh:
    clip, _ = getagrip.synthesise("mug", seed=0)
    z = clip.mesh.vertices[:, 2]
    level = np.round(255 * (z - z.min()) / np.ptp(z)).astype(np.uint8)
    return replace(clip.mesh, colours=np.stack([level, 255 - level, np.full_like(level, 7)], axis=1))


def test_a_scan_has_the_colours_of_its_texture(tmp_path: Path) -> None:
    mesh = read_textured_mesh(scan_in(tmp_path))
    assert mesh.is_closed
    assert mesh.colours is not None
    below = mesh.vertices[:, 2] < 0.05
    np.testing.assert_allclose(mesh.colours[below], [[255, 0, 0]] * 4, atol=3)
    np.testing.assert_allclose(mesh.colours[~below], [[0, 0, 255]] * 4, atol=3)


def test_files_named_from_the_folder_itself_are_read(tmp_path: Path) -> None:
    path = scan_in(tmp_path, "newmtl a\nmap_Kd ./cube.png\n")
    path.write_text(CUBE.replace("mtllib cube", "mtllib ./cube"))
    assert read_textured_mesh(path).colours is not None


@pytest.mark.parametrize("name", ["../cube.png", "other.png", "", "/etc/hostname"])
def test_a_texture_must_be_beside_its_scan(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="map_Kd"):
        read_textured_mesh(scan_in(tmp_path, f"newmtl a\nmap_Kd {name}\n"))


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    path = scan_in(tmp_path / "in")
    (path.parent / "cube.png").rename(tmp_path / "cube.png")
    (path.parent / "cube.png").symlink_to(tmp_path / "cube.png")
    with pytest.raises(InputError, match="map_Kd"):
        read_textured_mesh(path)


def test_a_scan_without_texture_coordinates_is_refused(tmp_path: Path) -> None:
    path = scan_in(tmp_path)
    path.write_text(CUBE.replace("/1", "").replace("/2", ""))
    with pytest.raises(InputError, match="texture coordinates"):
        read_textured_mesh(path)


def test_a_mesh_whose_texture_does_not_read_is_used_without_it(tmp_path: Path) -> None:
    path = scan_in(tmp_path)
    (tmp_path / "cube.png").write_bytes(b"\x89PNG but not quite")
    own = read_own_mesh(MeshOptions(mesh=path))
    assert own.mesh.colours is None
    assert "without its texture" in str(own.provenance["mesh"])


def test_a_mesh_of_another_unit_keeps_its_texture(tmp_path: Path) -> None:
    own = read_own_mesh(MeshOptions(mesh=scan_in(tmp_path), size_mm=50.0))
    assert own.mesh.colours is not None
    assert np.ptp(own.mesh.vertices, axis=0) == pytest.approx(np.array([0.025, 0.03, 0.05]))
    low, high = own.mesh.centre[2] + [-0.005, 0.005]
    for part, colour in ((own.mesh.vertices[:, 2] < low, [255, 0, 0]), (own.mesh.vertices[:, 2] > high, [0, 0, 255])):
        assert part.sum() > 1000  # the cube's corners alone do not show a texture
        np.testing.assert_allclose(own.mesh.colours[part], np.tile(colour, (part.sum(), 1)), atol=3)
    assert own.mesh.is_closed


def painted_glb(folder: Path, light: list[float] | None = None, **changes: object) -> Path:
    """Write a box of 6 to 10 cm, red below its middle and blue above by its texture; with changes to its JSON."""
    box = trimesh.creation.box(extents=[0.06, 0.08, 0.1])
    height = box.vertices[:, 2] / 0.1 + 0.5
    picture = Image.new("RGB", (8, 8), (0, 0, 255))
    picture.paste((255, 0, 0), (0, 4, 8, 8))  # trimesh's v is up, glTF's down
    material = PBRMaterial(baseColorTexture=picture, baseColorFactor=light)
    box.visual = TextureVisuals(np.stack([0.5 + 0 * height, 0.1 + 0.8 * height], axis=1), material=material)
    gltf = GLTF2.load_from_bytes(box.export(file_type="glb"))
    for name, value in changes.items():
        setattr(gltf, name, value)
    (folder / "box.glb").write_bytes(b"".join(gltf.save_to_bytes()))
    return folder / "box.glb"


def test_a_glb_file_has_the_colours_of_its_texture(tmp_path: Path) -> None:
    own = read_own_mesh(MeshOptions(mesh=painted_glb(tmp_path)))
    assert own.mesh.colours is not None
    for part, colour in ((own.mesh.vertices[:, 2] < -0.01, [255, 0, 0]), (own.mesh.vertices[:, 2] > 0.01, [0, 0, 255])):
        assert part.sum() > 1000  # the box's corners alone do not show a texture
        np.testing.assert_allclose(own.mesh.colours[part], np.tile(colour, (part.sum(), 1)), atol=3)


def test_the_light_of_a_texture_is_multiplied_by_that_of_its_material(tmp_path: Path) -> None:
    mesh = read_textured_mesh(painted_glb(tmp_path, [0.5, 0.5, 0.5, 1.0]))
    assert mesh.colours is not None
    np.testing.assert_allclose(mesh.colours[mesh.vertices[:, 2] < 0.0], [[188, 0, 0]] * 4, atol=3)


def test_a_glb_file_has_the_colours_of_its_vertices(tmp_path: Path) -> None:
    mug = coloured_mug()
    assert mug.colours is not None
    light = np.concatenate([light_of(mug.colours), np.ones((len(mug.vertices), 1))], axis=1).astype(np.float32)
    mesh = trimesh.Trimesh(mug.vertices, mug.faces, process=False, vertex_attributes={"LIGHT": light})
    gltf = GLTF2.load_from_bytes(mesh.export(file_type="glb"))
    attributes = gltf.meshes[0].primitives[0].attributes
    attributes.COLOR_0 = attributes._LIGHT
    path = tmp_path / "mug.glb"
    path.write_bytes(b"".join(gltf.save_to_bytes()))
    own = read_own_mesh(MeshOptions(mesh=path))
    assert own.mesh.colours is not None
    same = mug.coloured_like(own.mesh.vertices, own.mesh.colours).colours
    assert same is not None
    np.testing.assert_allclose(same.astype(int), mug.colours.astype(int), atol=1)


UNREADABLE: dict[str, dict[str, object]] = {
    "outside": {"images": [GltfImage(uri="../box.png")]},
    "beyond": {"images": [GltfImage(bufferView=99)]},
    "no image": {"images": [GltfImage(bufferView=0)]},
    "no images": {"images": []},
    "no textures": {"textures": []},
}


@pytest.mark.parametrize("kind", UNREADABLE)
def test_a_glb_file_whose_texture_does_not_read_is_used_without_it(tmp_path: Path, kind: str) -> None:
    own = read_own_mesh(MeshOptions(mesh=painted_glb(tmp_path, **UNREADABLE[kind])))
    assert own.mesh.colours is None
    assert "without its texture" in str(own.provenance["mesh"])


def test_images_of_a_glb_file_are_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glb, "MAX_GLTF_IMAGES", 0)
    with pytest.raises(InputError, match="images"):
        read_textured_mesh(painted_glb(tmp_path))


def test_an_obj_file_has_the_colours_of_its_vertices(tmp_path: Path) -> None:
    mug, path = coloured_mug(), tmp_path / "mug.obj"
    assert mug.colours is not None
    rows = [["v", *map(str, row)] for row in np.concatenate([mug.vertices, mug.colours / 255.0], axis=1).tolist()]
    faces = [f"f {a} {b} {c}" for a, b, c in mug.faces + 1]

    def read(last: list[str]) -> OwnMesh:
        path.write_text("\n".join([*map(" ".join, [*rows[:-1], last]), *faces]))
        return read_own_mesh(MeshOptions(mesh=path))

    own = read(rows[-1]).mesh
    assert own.colours is not None
    np.testing.assert_array_equal(mug.coloured_like(own.vertices, own.colours).colours, mug.colours)
    for last, why in (([*rows[-1][:-1], "7"], "colours beyond 0 to 1"), (rows[-1][:4], "some have no colour")):
        without = read(last)
        assert without.mesh.colours is None
        assert why in str(without.provenance["mesh"])


def test_light_and_colours_are_inverse() -> None:
    levels = np.arange(256, dtype=np.uint8).reshape(-1, 1) + np.zeros(3, np.uint8)
    np.testing.assert_array_equal(colours_of_light(light_of(levels)), levels)


def test_a_ply_file_keeps_vertices_and_colours_exactly(tmp_path: Path) -> None:
    mesh = coloured_mug()
    again = read_mesh(write_mesh(mesh, tmp_path / "mug.ply"))
    assert again.colours is not None
    order, other = (np.lexsort(each.vertices.T) for each in (mesh, again))
    np.testing.assert_array_equal(mesh.vertices[order], again.vertices[other])
    assert mesh.colours is not None
    np.testing.assert_array_equal(mesh.colours[order], again.colours[other])


@pytest.mark.parametrize("cut", [300, 5_000])
def test_a_ply_file_cut_short_is_refused(tmp_path: Path, cut: int) -> None:
    path = write_mesh(coloured_mug(), tmp_path / "mug.ply")
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(InputError):
        read_mesh(path)


def test_a_clip_folder_keeps_colours(tmp_path: Path) -> None:
    clip, masks = getagrip.synthesise("mug", seed=0)
    mesh = coloured_mug()
    folder = getagrip.write_clip(replace(clip, mesh=mesh), masks, tmp_path / "clip")
    again = getagrip.read_clip(folder).mesh
    assert again.colours is not None
    assert mesh.colours is not None
    assert sorted(map(tuple, again.colours.tolist())) == sorted(map(tuple, mesh.colours.tolist()))


def test_meshes_made_of_a_mesh_keep_its_colours() -> None:
    mesh = coloured_mug()
    assert mesh.colours is not None
    for few in (decimate(mesh, len(mesh.faces) // 3), cluster_vertices(mesh, len(mesh.faces) // 3)):
        assert few.colours is not None
        z = mesh.vertices[:, 2]
        expected = 255 * (few.vertices[:, 2] - z.min()) / np.ptp(z)
        assert np.abs(few.colours[:, 0] - expected).max() < 40
    warp = Warp.by(mesh.centre, 0.1, np.full((9, 3), 0.01))
    for same in (warp(mesh), mirror_mesh(mesh)):
        np.testing.assert_array_equal(same.colours, mesh.colours)
