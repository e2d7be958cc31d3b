"""Meshes of users: units, and points that no face uses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.cli.new_clip import MeshOptions, Unit, read_own_mesh
from getagrip.errors import InputError, UsageError
from getagrip.geometry.mesh_files import read_mesh


def box(path: Path, size: float, more: str = "") -> Path:
    """A tetrahedron with three sides of a size."""
    corners = "".join("v {:g} {:g} {:g}\n".format(*point) for point in [np.zeros(3), *(size * np.eye(3))])
    path.write_text(corners + more + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    return path


@pytest.mark.parametrize("more", ["v 0 0 9\n", "v 0 0 9\nv 0 0 8\nf 1 5 6\n"])
@pytest.mark.parametrize(("side", "diameter", "expected"), [(100.0, None, 0.1), (None, 100.0, 0.1 / np.sqrt(2))])
def test_sizes_are_those_of_the_surface(
    tmp_path: Path, more: str, side: float | None, diameter: float | None, expected: float
) -> None:
    made = read_own_mesh(MeshOptions(box(tmp_path / "a.obj", 0.3, more), side, diameter))
    assert np.ptp(made.mesh.vertices, axis=0).max() == pytest.approx(expected)


@pytest.mark.parametrize(("unit", "size"), [("mm", 100.0), ("cm", 10.0), ("m", 0.1), ("in", 0.1 / 0.0254)])
def test_the_unit_of_a_file_is_stated(tmp_path: Path, unit: Unit, size: float) -> None:
    made = read_own_mesh(MeshOptions(box(tmp_path / "a.obj", size), unit=unit, known_scale=True))
    assert np.ptp(made.mesh.vertices, axis=0).max() == pytest.approx(0.1, rel=1e-4)
    assert made.sized


def test_free_scale_needs_no_unit_and_known_scale_names_the_option(tmp_path: Path) -> None:
    path = box(tmp_path / "a.obj", 128.0)
    made = read_own_mesh(MeshOptions(path))
    assert not made.sized
    assert "rescaled" in str(made.provenance["scale"])
    with pytest.raises(InputError, match=r"--unit mm.*--size-mm"):
        read_own_mesh(MeshOptions(path, known_scale=True))
    with pytest.raises(InputError, match=r"millimetres\? .*getagrip clip new takes the unit \(--unit mm"):
        read_mesh(path)
    with pytest.raises(UsageError, match="--unit cannot be used"):
        read_own_mesh(MeshOptions(Path("mug"), unit="mm"))


def with_table(path: Path) -> Path:
    """A tetrahedron of 0.1, and under it a sheet of 0.24."""
    box(path, 0.1)
    sheet = [(-0.12, -0.12), (0.12, -0.12), (0.12, 0.12), (-0.12, 0.12)]
    corners = "".join(f"v {x} {y} -0.01\n" for x, y in sheet)
    path.write_text(path.read_text() + corners + "f 5 6 7\nf 5 7 8\n")
    return path


def test_sizes_are_of_the_part_that_is_held(tmp_path: Path) -> None:
    path = with_table(tmp_path / "scan.obj")
    with pytest.raises(UsageError, match=r"2 separate parts, 0.24 x 0.24 x 0, 0.1 x 0.1 x 0.1.*--part N.*--size-mm"):
        read_own_mesh(MeshOptions(path, 80.0))
    one, all_of = (read_own_mesh(MeshOptions(path, 80.0, part=part)) for part in ("2", "all"))
    assert np.ptp(one.mesh.vertices, axis=0).max() == pytest.approx(0.08)
    assert len(one.mesh.faces) == 4
    assert len(all_of.mesh.faces) == 6
    assert "2 separate parts" in str(read_own_mesh(MeshOptions(path)).provenance["mesh"])
    with pytest.raises(UsageError, match="--part must be 1 to 2"):
        read_own_mesh(MeshOptions(path, 80.0, part="3"))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_mark_before_the_first_vertex_changes_nothing(tmp_path: Path, encoding: str) -> None:
    plain = box(tmp_path / "a.obj", 0.1, "v 0 0 0.05\n")
    (tmp_path / "b.obj").write_text(plain.read_text(), encoding=encoding)
    np.testing.assert_array_equal(read_mesh(tmp_path / "b.obj").vertices, read_mesh(plain).vertices)
