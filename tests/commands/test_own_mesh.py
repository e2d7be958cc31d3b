"""Meshes of users: units, and points that no face uses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.commands.own_mesh import MeshOptions, Unit, own_mesh
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
    made = own_mesh(MeshOptions(box(tmp_path / "a.obj", 0.3, more), side, diameter))
    assert np.ptp(made.mesh.vertices, axis=0).max() == pytest.approx(expected)


@pytest.mark.parametrize(("unit", "size"), [("mm", 100.0), ("cm", 10.0), ("m", 0.1), ("in", 0.1 / 0.0254)])
def test_the_unit_of_a_file_is_stated(tmp_path: Path, unit: Unit, size: float) -> None:
    made = own_mesh(MeshOptions(box(tmp_path / "a.obj", size), unit=unit, known_scale=True))
    assert np.ptp(made.mesh.vertices, axis=0).max() == pytest.approx(0.1, rel=1e-4)
    assert made.sized


def test_free_scale_needs_no_unit_and_known_scale_names_the_option(tmp_path: Path) -> None:
    path = box(tmp_path / "a.obj", 128.0)
    made = own_mesh(MeshOptions(path))
    assert not made.sized
    assert "rescaled" in str(made.provenance["scale"])
    with pytest.raises(InputError, match=r"--unit mm.*--size-mm"):
        own_mesh(MeshOptions(path, known_scale=True))
    with pytest.raises(InputError, match=r"millimetres\? .*getagrip clip new takes the unit \(--unit mm"):
        read_mesh(path)
    with pytest.raises(UsageError, match="--unit cannot be used"):
        own_mesh(MeshOptions(Path("mug"), unit="mm"))
