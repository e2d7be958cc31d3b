"""``getagrip report``: the picture of a result, wherever its clip is, with what the checks found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from getagrip.clip import input_sha256
from getagrip.finding import Finding
from getagrip.result import write_result
from getagrip.view.report import report_figure
from helpers.command_line import Run
from helpers.egg_and_mug import egg_and_mug, perfect, written


def test_the_clip_of_a_report_may_have_moved(run: Run, tmp_path: Path) -> None:
    clip, result = written(egg_and_mug(), tmp_path)
    moved = clip.rename(tmp_path / "elsewhere")
    status, _, err = run("report", result)
    assert status == 1
    assert "say where with --clips" in err
    assert run("report", result, "--clips", moved)[0] == 0
    assert (result / "report.png").stat().st_size > 10_000


def test_findings_are_evaluated_and_drawn(run: Run, tmp_path: Path) -> None:
    clip, masks = egg_and_mug()
    folder, _ = written((clip, masks), tmp_path)
    doubted = replace(
        perfect(clip), findings=(Finding("contact-gap", True, 240.0, 15.0, "hand and object are 240 mm apart"),)
    )
    result = write_result(doubted, tmp_path / "doubted", input_sha256(folder), clip_folder=folder)
    assert "serious: contact-gap: hand and object are 240 mm apart" in run("evaluate", result)[2]
    words = [text.get_text() for text in report_figure(doubted, clip, masks).texts]
    assert any("contact-gap: hand and object are 240 mm apart" in text for text in words)
