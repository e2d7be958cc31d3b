"""What is wrong with a stated mesh is said before anything is made of it; kinds have pictures."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from getagrip.geometry.mesh_files import write_mesh
from getagrip.studio.jobs import RequestedMesh
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.shapes import KINDS, PICTURE_PX, kind_picture, mesh_error, unusual_size
from helpers.clips import box


def test_a_kind_or_a_file_that_reads_is_a_mesh(tmp_path: Path) -> None:
    good, bad = write_mesh(box(0.1, 0.1, 0.1), tmp_path / "good.obj"), tmp_path / "bad.obj"
    bad.write_text("v 0 0 nothing")
    assert mesh_error(RequestedMesh("mug", None)) == mesh_error(RequestedMesh(str(good), None)) == ""
    assert "bad.obj" in mesh_error(RequestedMesh(str(bad), None))
    for name in ("roll of tape", str(tmp_path), "a\0b"):
        assert "no such file" in mesh_error(RequestedMesh(name, None))


@pytest.mark.parametrize(("size", "odd"), [(None, False), (95.0, False), (300.0, False), (9.5, True), (950.0, True)])
def test_a_size_in_another_unit_is_doubted(size: float | None, odd: bool) -> None:
    assert bool(unusual_size(RequestedMesh("mug", size))) == odd
    assert unusual_size(RequestedMesh("mug.obj", size)) == ""


def test_kinds_have_pictures_of_their_own() -> None:
    pictures = {kind: np.array(Image.open(BytesIO(kind_picture(kind)))) for kind in ("ball", "mug", "scissors")}
    shares = [float((one != one[0, 0]).any(axis=-1).mean()) for one in pictures.values()]
    assert all(one.shape == (PICTURE_PX, PICTURE_PX, 3) for one in pictures.values())
    assert shares[0] > shares[1] > shares[2] > 0.01
    assert "mug" in KINDS
    with pytest.raises(RefusedError):
        kind_picture("axe")
