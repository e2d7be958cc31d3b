"""``getagrip report``: pages and pictures of results, wherever their clips are, with what the checks found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from getagrip.cli.report import find_result_folders
from getagrip.clip import input_sha256
from getagrip.errors import InputError
from getagrip.report.pictures.result_picture import report_figure
from getagrip.result import write_result
from getagrip.result.findings import Finding
from helpers.environment import Run
from helpers.scenes import egg_and_mug, perfect, written


@pytest.mark.slow
def test_the_clip_of_a_report_may_have_moved(run: Run, tmp_path: Path) -> None:
    clip, result = written(egg_and_mug(), tmp_path)
    moved = clip.rename(tmp_path / "elsewhere")
    status, _, err = run("report", result)
    assert status == 1
    assert "say where with --clips" in err
    assert run("report", result, "--clips", moved)[0] == 0
    assert (result / "report.png").stat().st_size > 10_000


@pytest.mark.slow
def test_findings_are_evaluated_and_drawn(run: Run, tmp_path: Path) -> None:
    clip, masks = egg_and_mug()
    folder, _ = written((clip, masks), tmp_path)
    flagged = replace(
        perfect(clip), findings=(Finding("contact-gap", True, 240.0, 15.0, "hand and object are 240 mm apart"),)
    )
    result = write_result(flagged, tmp_path / "flagged", input_sha256(folder), clip_folder=folder)
    assert "serious: contact-gap: hand and object are 240 mm apart" in run("evaluate", result)[2]
    words = [text.get_text() for text in report_figure(flagged, clip, masks).texts]
    assert any("contact-gap: hand and object are 240 mm apart" in text for text in words)


@pytest.mark.slow
def test_a_folder_of_results_has_an_index_and_one_that_is_broken_ends_nothing(run: Run, tmp_path: Path) -> None:
    _, result = written(egg_and_mug(), tmp_path)
    (tmp_path / "results" / "deep" / "er").mkdir(parents=True)
    (tmp_path / "results" / "deep" / "er" / "result.json").write_text("[]")
    (tmp_path / "results" / "methods.md").touch()
    status, out, err = run("report", tmp_path / "results", "--index-only")
    index = tmp_path / "results" / "index.html"
    assert (status, out.split()) == (1, [str(index)])
    assert "deep/er/result.json" in err
    assert err.count("\n") == 1
    assert '"link":""' in index.read_text("utf-8")
    assert not (result / "report.html").exists()
    assert run("report", tmp_path / "results", "--mp4", "--workers", 1)[0] == 1
    text = index.read_text("utf-8")
    assert f'"link":"./{result.name}/report.html"' in text
    assert '"link":"./methods.md"' in text
    assert {file.name for file in result.iterdir()} == {"result.json", "result.npz", "report.html", "report.mp4"}


def test_results_are_found_below_but_not_in_other_results(tmp_path: Path) -> None:
    for name in ("b", "a/x", "a/x/inner", ".hidden/y", "1/2/3/4", "1/2/3/5/6"):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
        (tmp_path / name / "result.json").touch()
    assert [found.relative_to(tmp_path).as_posix() for found in find_result_folders(tmp_path)] == [
        "1/2/3/4",
        "a/x",
        "b",
    ]
    with pytest.raises(InputError, match="no such folder"):
        find_result_folders(tmp_path / "none")


def test_wrong_calls_are_refused(run: Run, tmp_path: Path) -> None:
    for args, words in [
        ((), "PATH: name at least one"),
        ((tmp_path, "--workers", 0), "--workers must be 1 or more (got 0)"),
    ]:
        status, _, err = run("report", *args)
        assert status == 2
        assert words in err
    assert run("report", tmp_path)[0] == 1
