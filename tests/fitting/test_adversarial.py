"""Clips with impossible troubles end in a sound result or in one line, whatever the method.

``python -m fuzz.adversarial`` tries many more, within limits of time and memory.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import pytest

from fuzz import adversarial
from fuzz.adversarial import Case, attempts, limited, main
from fuzz.troubles import quartered
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.geometry import mesh as meshes
from getagrip.geometry.mesh import cluster_vertices
from getagrip.reconstruct import reconstruct
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
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
    frames = 2 if len(troubles[0]) % 2 else 3
    ((_, fine, how),) = attempts(Case(len(troubles[0]), "mug", frames, "known", troubles, (method,)))
    assert fine, how


@pytest.mark.slow
def test_a_scale_at_which_a_frame_cannot_be_rendered_ends_in_one_line() -> None:
    """Each frame has its own scale at first; the median of them put one too near to the camera."""
    ((_, fine, how),) = attempts(Case(43, "can", 4, "free", ("needle mesh",), ("single-frame",)))
    assert fine, how


def test_cases_are_drawn_from_their_numbers_and_failures_counted(capsys: pytest.CaptureFixture[str]) -> None:
    assert Case.draw(7) == Case.draw(7) != Case.draw(7, seed=1) != Case.draw(8)
    assert {*Case.draw(7).methods} == {*METHODS}
    in_turn = [method for number in range(6) for method in Case.draw(number, methods=len(METHODS) // 3).methods]
    assert Counter(in_turn) == dict.fromkeys(METHODS, 2)

    def trial(case: Case) -> Iterator[tuple[str, bool, str]]:
        yield from ((method, (case.number, method) != (6, "homan"), "how: it ended") for method in case.methods)

    assert main(["--clips", "3", "--from", "5"], trial) == 1
    out = capsys.readouterr().out
    assert f"FAIL 6 ({Case.draw(6).category}" in out
    assert f"3 clips, {3 * len(METHODS)} reconstructions, 1 failed" in out
    assert f"how {3 * len(METHODS) - 1}, FAIL 1" in out


@pytest.mark.slow
def test_a_method_that_dies_or_hangs_ends_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    def some_end_badly(case: Case) -> Iterator[tuple[str, bool, str]]:
        for method in case.methods:
            if method == "static":
                os._exit(3)
            if method == "homan":
                time.sleep(60.0)
            yield method, True, "how"

    monkeypatch.setattr(adversarial, "attempts", some_end_badly)
    ended = list(limited(Case.draw(0), seconds=0.5))
    assert [method for method, _, _ in ended] == [*METHODS]
    assert {method: how for method, fine, how in ended if not fine} == {
        "static": "the process died (3)", "homan": "not done after 0.5 s",
    }  # fmt: skip


@pytest.mark.slow
def test_large_meshes_are_fitted_with_fewer_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scene("mug", 0, SHORT)
    fine = replace(clip, mesh=quartered(quartered(clip.mesh)))
    monkeypatch.setattr(meshes, "MAX_MESH_FACES", len(clip.mesh.faces))
    result = reconstruct(fine, masks, Options(method="static", inits=6))
    assert f"the mesh of {len(fine.mesh.faces)} faces was fitted with" in " ".join(result.notes)
    assert result.mean_iou > 0.8


@pytest.mark.slow
def test_clustering_keeps_a_large_meshs_shape() -> None:
    mesh = quartered(quartered(quartered(SYNTHETIC_CATEGORIES["can"]())))
    few = cluster_vertices(mesh, len(mesh.faces) // 6)
    assert len(few.faces) < len(mesh.faces) // 4
    assert few.is_closed
    assert few.volume == pytest.approx(mesh.volume, rel=0.02)
    assert few.diameter == pytest.approx(mesh.diameter, rel=0.01)
    assert cluster_vertices(mesh, len(mesh.faces)) is mesh


def test_a_quartered_mesh_has_the_same_surface() -> None:
    mesh = box(0.1, 0.2, 0.3)
    fine = quartered(quartered(mesh))
    assert len(fine.faces) == 16 * len(mesh.faces)
    assert fine.is_closed
    assert fine.volume == pytest.approx(mesh.volume)
    assert fine.vertex_areas.sum() == pytest.approx(mesh.vertex_areas.sum())
