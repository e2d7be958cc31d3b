"""``report`` and ``status``: pages and pictures wherever the clips are, and states of clips after any end of a call."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path

import pytest

from getagrip.batch.ledger import LEDGER_FILE, Ledger, LedgerEntry
from getagrip.cli.report import find_result_folders
from getagrip.clip import Clip, input_sha256, write_clip
from getagrip.errors import InputError
from getagrip.fitting.options import Options
from getagrip.io.files import to_json
from getagrip.report.pictures.result_picture import report_figure
from getagrip.result import Reconstruction, read_result_record, write_result
from getagrip.result.findings import Finding
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.folders import contents
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


NAMES = ("a", "b", "c", "d")


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Four clips, of which b has no hand, two more that share a name, and a folder that is no clip."""
    clip, masks = small_clip()
    for name in NAMES:
        write_clip(replace(clip, name=name), masks, tmp_path / "clips" / name)
    (tmp_path / "clips" / "b" / "hand.npz").unlink()
    for folder in ("twin1", "twin2"):
        write_clip(replace(clip, name="twin"), masks, tmp_path / "clips" / folder)
    (tmp_path / "clips" / "torn").mkdir()
    (tmp_path / "clips" / "torn" / "clip.json").write_text("{")
    return tmp_path / "clips"


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The truth in place of the method, and Ctrl-C at c."""

    def fit(clip: Clip, masks: object, options: Options, progress: object, threads: int) -> Reconstruction:
        if clip.name == "c":
            signal.raise_signal(signal.SIGINT)
        given = json.loads(to_json(asdict(options)))
        return replace(perfect(clip), clip=clip.name, options=given, method=options.method, seed=options.seed)

    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", fit)


def rows(out: Path) -> dict[str, list[str]]:
    """The states in the summary by clip."""
    found: dict[str, list[str]] = {}
    for row in csv.DictReader((out / "summary.csv").read_text("utf-8").splitlines()):
        found.setdefault(row["clip"], []).append(row["status"])
    return found


STATES = {"a": ["done"], "b": ["failed"], "c": ["open"], "d": ["open"], "twin": ["failed"] * 2, "torn": ["failed"]}


def test_an_interrupt_leaves_a_summary_and_status_shows_it(
    clips: Path, tmp_path: Path, run: Run, interrupted: None
) -> None:
    out = tmp_path / "out"
    status, _, err = run("reconstruct", clips, "--out", out, "--workers", "1", "--seed", "7", "--method", "static")
    assert status == 130
    assert f"getagrip status {out}" in err
    assert rows(out) == STATES
    page = (out / "index.html").read_text("utf-8")
    assert '"counts":{"results":1,"failed":4,"left":2}' in page
    (row,) = (row for row in csv.DictReader((out / "summary.csv").read_text().splitlines()) if row["clip"] == "a")
    version = read_result_record(out / "a")["software"]["getagrip"]
    assert [row[key] for key in ("method", "seed", "version", "ambiguous")] == ["static", "7", version, "False"]
    for name in ("summary.csv", "index.html"):
        (out / name).unlink()

    status, printed, err = run("status", out)
    assert (status, err) == (0, "")
    assert "1 done, 4 failed, 2 left" in printed
    lines = [line.split() for line in printed.splitlines()]
    assert ["a", "done", "1.00"] in lines
    assert any(line[:2] == ["b", "failed"] and "hand.npz:" in " ".join(line) for line in lines)
    assert rows(out) == STATES
    assert "already done in" in run("reconstruct", clips / "a", "--out", out, "--method", "static", "--seed", "7")[1]


def test_a_kill_leaves_what_status_and_report_show(clips: Path, tmp_path: Path, run: Run, interrupted: None) -> None:
    """A killed process has written a result, but not into the ledger, whose last transactions are in its log."""
    done, out = tmp_path / "done", tmp_path / "out"
    run("reconstruct", clips / "a", "--out", done)
    with Ledger(tmp_path / "at work") as ledger:
        ledger.expect(NAMES, ())
        ledger.claim("a", "", "")
        shutil.copytree(tmp_path / "at work", out)
    shutil.copytree(done / "a", out / "a")
    assert (out / f"{LEDGER_FILE}-wal").stat().st_size
    before = {name: content for name, content in contents(out).items() if name.startswith(LEDGER_FILE)}
    status, printed, _ = run("status", out)
    assert (status, "1 done, 0 failed, 3 left" in printed) == (0, True)
    after = contents(out)
    assert all(after[name] == before[name] for name in (LEDGER_FILE, f"{LEDGER_FILE}-wal"))  # only read
    for name in ("summary.csv", "index.html"):
        (out / name).unlink()
    assert run("report", out, "--index-only", "--clips", clips)[0] == 0
    assert rows(out) == {"a": ["done"], "b": ["open"], "c": ["open"], "d": ["open"]}
    assert '"counts":{"results":1,"failed":0,"left":3}' in (out / "index.html").read_text("utf-8")


def test_results_do_without_a_ledger(clips: Path, tmp_path: Path, run: Run, interrupted: None) -> None:
    out = tmp_path / "out"
    run("reconstruct", clips / "a", clips / "d", "--out", out)
    (out / LEDGER_FILE).write_bytes(b"none" * 100)
    status, printed, err = run("status", out)
    assert (status, "2 done, 0 failed, 0 left" in printed, "only results are listed" in err) == (0, True, True)
    assert (out / LEDGER_FILE).read_bytes() == b"none" * 100
    (out / LEDGER_FILE).unlink()
    before = sorted(path.name for path in out.iterdir())
    assert run("status", out)[0] == 0
    assert sorted(path.name for path in out.iterdir()) == before


def test_a_ledger_of_a_stranger_does_no_harm(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    about = {
        "iou": 10**300,
        "probability_right": [1],
        "findings": 7,
        "method": "=cmd",
        "seed": {},
        "clip": "\x1b[2J[red]",
    }
    with Ledger(out) as ledger:
        ledger.expect(["[bold]", ".."], [LedgerEntry("/a/b", "failed", "\x1b[2J", about=about)])
    (tmp_path / "canary").write_text("mine")
    (out / "summary.csv").symlink_to(tmp_path / "canary")
    status, printed, _ = run("status", out)
    assert (status, "0 done, 1 failed, 2 left" in printed) == (0, True)
    assert "\x1b" not in printed
    assert "[bold]" in printed
    assert "'=cmd" in (out / "summary.csv").read_text("utf-8")
    assert (tmp_path / "canary").read_text() == "mine"
    ledger_file = (out / LEDGER_FILE).rename(tmp_path / "elsewhere")
    (out / LEDGER_FILE).symlink_to(ledger_file)
    assert "a link" in run("status", out)[2]


def test_nothing_is_no_status(tmp_path: Path, run: Run) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        status, _, err = run("status", folder)
        assert (status, "must be the folder of results" in err) == (1, True)
    assert [*tmp_path.iterdir()] == []


def test_folders_whose_names_are_no_utf_8(clips: Path, tmp_path: Path, run: Run, interrupted: None) -> None:
    strange = Path(os.fsdecode(os.fsencode(tmp_path) + b"/s\xff"))
    clips = clips.rename(strange.with_name("c\udcfe"))
    assert run("reconstruct", clips / "a", clips / "d", "--out", strange)[0] == 0
    result = (strange / "a").rename(strange / "r\udcff")
    assert run("report", strange)[0] == 0
    page = (strange / "index.html").read_text("utf-8")
    assert "<title>s\ufffd</title>" in page
    assert '"link":"./r%FF/report.html"' in page
    assert '"folder":"r\\ufffd"' in page
    assert run("report", result)[0] == 0
    assert "report.html" in contents(result)
    status, printed, _ = run("status", strange)
    assert (status, "2 done, 0 failed, 1 left" in printed) == (0, True)
    assert rows(strange) == {"a": ["open"], "d": ["done"], "r\ufffd": ["done"]}
    written = tmp_path / "all.json"
    assert run("evaluate", strange, "--json", written)[0] == 0
    assert written.read_text("utf-8").count('"iou_full"') >= 2
    for kind in ("csv", "obj"):
        assert run("export", result, "--to", kind)[0] == 0
