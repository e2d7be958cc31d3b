"""Which part of an ARCTIC template turns: that of ARCTIC's own code, by an independent formula."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.readers.datasets.arctic import read_template


def box_template(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """A box with a lid [mm], as ARCTIC has its templates; its vertices and which are the lid's."""
    lid = trimesh.creation.box((120.0, 90.0, 30.0))
    base = trimesh.creation.box((120.0, 90.0, 60.0))
    lid.apply_translation((0.0, 0.0, 60.0))
    joined = trimesh.Trimesh(
        np.concatenate([base.vertices, lid.vertices]),
        np.concatenate([base.faces, lid.faces + len(base.vertices)]),
        process=False,
    )
    top = np.arange(len(joined.vertices)) >= len(base.vertices)
    folder.mkdir(exist_ok=True)
    for name, mesh in (("mesh", joined), ("top", lid), ("bottom", base)):
        mesh.export(folder / f"{name}.obj")
    (folder / "parts.json").write_text(json.dumps(np.where(top, 0, 1).tolist()))
    return np.asarray(joined.vertices), top


@pytest.mark.parametrize("beside", [True, False])
def test_part_0_turns_as_in_arctics_own_code(tmp_path: Path, beside: bool) -> None:
    vertices, top = box_template(tmp_path)
    if not beside:
        (tmp_path / "top.obj").unlink()
    template, angle = read_template(tmp_path), np.radians(60.0)
    k, x = np.array([0.0, 0.0, -1.0]), vertices / 1000.0  # Rodrigues about k
    turned = x * np.cos(angle) + np.cross(k, x) * np.sin(angle) + np.outer(x @ k, k) * (1.0 - np.cos(angle))
    found = se3.transform(
        se3.inverse(template.T_neutral_template), template.joint.at(template.mesh.vertices, np.array([angle]))[0]
    )
    np.testing.assert_allclose(found, np.where(top[:, None], turned, x), atol=1e-6)


def test_numbers_against_the_parts_meshes_are_refused(tmp_path: Path) -> None:
    _, top = box_template(tmp_path)
    (tmp_path / "parts.json").write_text(json.dumps(np.where(top, 1, 0).tolist()))
    with pytest.raises(InputError, match=r"parts\.json.*top\.obj and bottom\.obj"):
        read_template(tmp_path)
