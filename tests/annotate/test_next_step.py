"""What to do after a result that does not look right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from getagrip.annotate.next_step import next_step
from getagrip.annotate.reconstruction import Shape
from getagrip.finding import Finding
from getagrip.result import write_result
from helpers.clips import small_clip
from helpers.true_result import true_result


def test_the_next_step_is_a_frame_an_interval_a_mesh_and_a_command(tmp_path: Path) -> None:
    result = true_result(small_clip()[0], None)
    serious = Finding("mask-misfit", True, 9.0, 3.0, "wrong")
    mesh = tmp_path / "own.obj"
    mesh.touch()
    good = write_result(result, tmp_path / "good", "", {}, tmp_path)
    bad = write_result(replace(result, findings=(serious,)), tmp_path / "bad", "", {}, tmp_path)
    video, out, built_in = tmp_path / "a b.mp4", tmp_path / "out", Shape("mug", None)

    def said(result: Path, shape: Shape = built_in, wanted: int | None = 7, lost: tuple[int, ...] = ()) -> str:
        return next_step(result, video, out, shape, wanted, lost, (3, 90))

    assert said(good) == said(tmp_path / "none") == ""
    assert f"next: draw the object on frame 7, and reconstruct again, on the page: getagrip annotate '{video}'" in said(
        bad
    )
    assert "--interval FIRST LAST if it is held only in some of 3 to 90" in said(bad)
    assert "--object FILE, the object's own mesh: the shape of mug is a guess" in said(bad)
    assert "--object FILE" not in said(bad, Shape(str(mesh), None))
    lost = said(good, lost=(8, 9, 10, 12))
    assert "the object is lost in the frames 8 to 10, 12: nothing is known of it there\nnext: draw" in lost
    assert "--interval" not in lost
