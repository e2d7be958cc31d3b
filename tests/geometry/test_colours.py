"""Colours of meshes: read within limits, kept by every step that makes a mesh of another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import getagrip
from getagrip.cli.new_clip import MeshOptions, read_own_mesh
from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh, cluster_vertices, decimate
from getagrip.geometry.mesh_files import read_mesh, read_textured_mesh, write_mesh
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
