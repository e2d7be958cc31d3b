"""Polygons cut into triangles, those of files included."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry.mesh_files import obj, parse_mesh, read_mesh
from getagrip.geometry.mesh_files.obj import triangulate_polygons

PATH = Path("m.obj")
U = 0.03 * np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]])


def cut(points: ndarray) -> ndarray:
    return triangulate_polygons(PATH, points, np.array([len(points)]), np.arange(len(points)))


def areas(points: ndarray, faces: ndarray, normal: ndarray) -> ndarray:
    a, b, c = np.moveaxis(points[faces], 1, 0)
    return np.asarray(np.cross(b - a, c - a) @ normal / 2)


@pytest.mark.parametrize("count", [4, 5, 7, 12, 40])
@pytest.mark.parametrize("seed", range(12))
def test_area_boundary_and_turn_of_simple_polygons_are_kept(seed: int, count: int) -> None:
    rng = np.random.default_rng([seed, count])
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.8, count)) / count
    flat = rng.uniform(0.05, 1.0, count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = flat @ axes[:2] + rng.normal(size=3)
    made = cut(points)
    each = areas(points, made, np.cross(axes[0], axes[1]))
    x, y = flat.T
    assert len(made) == count - 2
    assert (each > 0).all()
    assert each.sum() == pytest.approx(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)
    edges = {(int(t[n]), int(t[(n + 1) % 3])) for t in made for n in range(3)}
    assert {edge for edge in edges if edge[::-1] not in edges} == {(n, (n + 1) % count) for n in range(count)}


def test_straight_corners_and_a_hole_that_a_seam_joins_to_the_edge() -> None:
    straight = np.array([[0, 0], [1, 0], [2, 0], [2, 2], [1.5, 2], [1, 2], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])
    outer, hole = np.array([[0, 0], [4, 0], [4, 4], [0, 4]]), np.array([[1, 1], [1, 3], [3, 3], [3, 1]])
    with_hole = np.concatenate([outer, outer[:1], hole, hole[:1]])
    for flat, area in ((straight, 3.0), (with_hole, 12.0)):
        points = np.column_stack([flat, np.zeros(len(flat))]).astype(float)
        each = areas(points, cut(points), np.array([0.0, 0.0, 1.0]))
        assert each.min() >= 0
        assert each.sum() == pytest.approx(area)


def test_polygons_that_are_none_are_fans() -> None:
    for points in (np.zeros((5, 3)), np.full((5, 3), np.nan), np.column_stack([np.arange(5.0)] * 3)):
        assert cut(points).tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert triangulate_polygons(PATH, np.zeros((3, 3)), np.array([4]), np.array([0, 1, 2, 9])).tolist() == [
        [0, 1, 2],
        [0, 2, 9],
    ]


def test_polygons_that_take_too_long_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A comb."""
    x = np.arange(100.0)
    points = np.column_stack([np.r_[x, x[-1], 0], np.r_[10 * (x % 2), -1, -1], np.zeros(102)])[::-1]
    assert areas(points, cut(points), np.array([0.0, 0.0, 1.0])).sum() == pytest.approx(99 * 6)
    monkeypatch.setattr(obj, "MAX_EAR_TESTS", 100)
    with pytest.raises(InputError, match="triangulate the mesh first"):
        cut(points)


def prism(suffix: str, mixed: bool) -> bytes:
    """A profile with a notch, 30 mm high: its two ends have eight corners; its sides four or, ``mixed``, are cut."""
    n = len(U)
    points = np.concatenate([np.column_stack([U, np.full(n, z)]) for z in (0.0, 0.03)])
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    faces = [[*range(n)][::-1], [*range(n, 2 * n)], *sides]
    if mixed:
        faces = faces[:2] + [side[a:b] + side[:c] for side in sides for a, b, c in ((0, 3, 0), (2, 4, 1))]
    if suffix == ".obj":
        lines = ["v {:g} {:g} {:g}".format(*point) for point in points]
        return "\n".join(lines + ["f " + " ".join(str(k + 1) for k in face) for face in faces]).encode()
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[suffix]
    header = (
        f"ply\nformat {suffix} 1.0\ncomment made\nelement vertex {len(points)}\nproperty double x\nproperty float y\n"
        f"property double z\nproperty uchar red\nelement face {len(faces)}\nproperty uchar flags\n"
        "property list uchar int vertex_indices\nproperty list uchar float texcoord\nelement edge 1\n"
        "property int vertex1\nproperty int vertex2\nend_header\n"
    )
    if not order:
        lines = ["{:g} {:g} {:g} 7".format(*point) for point in points]
        lines += [f"0 {len(face)} {' '.join(map(str, face))} 2 .5 .5" for face in faces]
        return (header + "\n".join([*lines, "0 1"]) + "\n").encode()
    body = b"".join(struct.pack(f"{order}dfdB", *point, 7) for point in points)
    for face in faces:
        body += struct.pack(f"{order}BB{len(face)}iB2f", 0, len(face), *face, 2, 0.5, 0.5)
    return header.encode() + body + struct.pack(f"{order}2i", 0, 1)


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("kind", [".obj", "ascii", "binary_little_endian", "binary_big_endian"])
def test_notches_stay_open_in_files(tmp_path: Path, kind: str, mixed: bool) -> None:
    path = tmp_path / ("m.obj" if kind == ".obj" else "m.ply")
    path.write_bytes(prism(kind, mixed))
    mesh = read_mesh(path)
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(7 * 0.03**3, rel=1e-5)
    if kind != ".obj":
        for short in range(0, len(path.read_bytes()) - 10, 37):
            path.write_bytes(prism(kind, mixed)[:short])
            with pytest.raises(InputError):
                parse_mesh(path)
