"""What to do after a result that does not look right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from getagrip.geometry import se3
from getagrip.result import write_result
from getagrip.result.findings import Finding
from getagrip.studio.jobs import RequestedMesh
from getagrip.studio.next_step import next_step
from helpers.clips import small_clip
from helpers.results import true_result


def test_the_next_step_is_a_frame_an_interval_a_mesh_and_a_command(tmp_path: Path) -> None:
    result = true_result(small_clip()[0], None)
    serious = Finding("mask-misfit", True, 9.0, 3.0, "wrong")
    mesh = tmp_path / "own.obj"
    mesh.touch()
    good = write_result(result, tmp_path / "good", "", {}, tmp_path)
    bad = write_result(replace(result, findings=(serious,)), tmp_path / "bad", "", {}, tmp_path)
    video, out, built_in = tmp_path / "a b.mp4", tmp_path / "out", RequestedMesh("mug", None)

    def said(result: Path, shape: RequestedMesh = built_in, wanted: int | None = 7, lost: tuple[int, ...] = ()) -> str:
        return next_step(result, video, out, shape, wanted, lost, (3, 90))

    assert said(good) == said(tmp_path / "none") == ""
    assert f"next: draw the object on frame 7, and reconstruct again, on the page: getagrip annotate '{video}'" in said(
        bad
    )
    assert "--interval FIRST LAST, if it is held only in some of the frames 3 to 90" in said(bad)
    assert "--object FILE, the object's own mesh: the shape of mug is a guess" in said(bad)
    assert "--object FILE" not in said(bad, RequestedMesh(str(mesh), None))
    R = np.tile(np.eye(3), (40, 1, 1))
    R[25:] = se3.exp_so3(np.array([0.0, 1.0, 0.0]))
    names = tuple(f"{n:06d}" for n in range(3, 43))
    jumps = Finding("regrasp", False, 20.0, 6.0, "it jumps")
    long = replace(
        result, frames=names, frame_kind=("sampled",) * 40, T_hand_obj=se3.rigid(R, np.zeros((40, 3))), iou=np.ones(40),
        candidates=replace(result.candidates, T_hand_obj=se3.rigid(R, np.zeros((40, 3)))[None]), T_cam_hand=None,
        axis=None, findings=(serious, jumps),
    )  # fmt: skip
    step = next_step(
        write_result(long, tmp_path / "long", "", {}, tmp_path),
        video,
        out,
        built_in,
        7,
        (),
        (3, 42),
        (10.0, 20.0, 5.2, 6.0),
    )
    assert "--interval 3 27 --object-box 10,20,5,6: the object jumps in the hand between the frames 27 and 28" in step
    lost = said(good, lost=(8, 9, 10, 12))
    assert "the object is lost in the frames 8 to 10, 12: nothing is known of it there\nnext: draw" in lost
    assert "--interval" not in lost
