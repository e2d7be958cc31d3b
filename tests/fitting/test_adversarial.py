"""Clips with impossible troubles end in a sound result or in one line, whatever the method.

``python -m benchmarks.adversarial N`` tries many more, within limits of time and memory.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[2]))

from benchmarks.adversarial import Case, attempt, main, quartered
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.fitting.options import Options
from getagrip.fitting.reconstruct import reconstruct
from getagrip.geometry import mesh as meshes
from getagrip.geometry.mesh import clustered
from helpers.clips import box
from helpers.scenes import SHORT, scene

CASES = [
    (("one-pixel masks",), "soft-hinge"), (("behind the camera",), "one-dof"), (("hand at 10 m",), "one-dof"),
    (("flat mesh",), "static"), (("needle mesh",), "dynamic"), (("6 mm mesh",), "soft-hinge"),
    (("soup",), "contact-consistency"), (("one triangle",), "soft-hinge"), (("giant focal length",), "homan"),
    (("contradicting masks",), "single-frame"), (("leaving the image",), "soft-hinge"), (("all ignored",), "homan"),
    (("inside out", "whole image"), "one-dof"), (("noise masks",), "paper-static"),
]  # fmt: skip


@pytest.mark.parametrize(("troubles", "method"), CASES)
@pytest.mark.slow
def test_troubles_end_in_a_sound_result_or_in_one_line(troubles: tuple[str, ...], method: str) -> None:
    frames = 2 if len(troubles[0]) % 2 else 4
    fine, how = attempt(Case(len(troubles[0]), "mug", frames, "known", troubles, method))
    assert fine, how


def test_cases_are_drawn_from_their_numbers_and_failures_counted(capsys: pytest.CaptureFixture[str]) -> None:
    assert Case.draw(7) == Case.draw(7) != Case.draw(8)
    assert main(["3", "--from", "5"], lambda case: (case.number != 6, "how")) == 1
    out = capsys.readouterr().out
    assert f"FAIL {Case.draw(6)}" in out
    assert "3 cases, 1 failed" in out


@pytest.mark.slow
def test_large_meshes_are_fitted_with_fewer_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scene("mug", 0, SHORT)
    fine = replace(clip, mesh=quartered(quartered(clip.mesh)))
    monkeypatch.setattr(meshes, "MOST_FACES", len(clip.mesh.faces))
    result = reconstruct(fine, masks, Options(method="static", inits=6))
    assert f"the mesh of {len(fine.mesh.faces)} faces was fitted with" in " ".join(result.notes)
    assert result.mean_iou > 0.8


def test_clustering_keeps_a_large_meshs_shape() -> None:
    mesh = quartered(quartered(quartered(CATEGORIES["can"].make())))
    few = clustered(mesh, len(mesh.faces) // 6)
    assert len(few.faces) < len(mesh.faces) // 4
    assert few.is_closed
    assert few.volume == pytest.approx(mesh.volume, rel=0.02)
    assert few.diameter == pytest.approx(mesh.diameter, rel=0.01)
    assert clustered(mesh, len(mesh.faces)) is mesh


def test_a_quartered_mesh_has_the_same_surface() -> None:
    mesh = box(0.1, 0.2, 0.3)
    fine = quartered(quartered(mesh))
    assert len(fine.faces) == 16 * len(mesh.faces)
    assert fine.is_closed
    assert fine.volume == pytest.approx(mesh.volume)
    assert fine.vertex_areas.sum() == pytest.approx(mesh.vertex_areas.sum())
