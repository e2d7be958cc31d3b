"""Many clips: which clips a call is about, their results and summary, and what is printed of them."""

from __future__ import annotations

import csv
import json
import os
import re
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path

import pytest

from getagrip.batch.clips import RESERVED_NAMES, ClipPlan, _Tally, expected_right_message
from getagrip.batch.job import Outcome
from getagrip.batch.scheduling import KeepOptions, Shard
from getagrip.clip import Clip, input_sha256, write_clip
from getagrip.errors import UsageError, escape_unprintable
from getagrip.fitting.options import Options
from getagrip.io import files, plugins
from getagrip.io.files import new_folder, to_json
from getagrip.result import RESULT_FILES, Reconstruction, read_result, write_result
from getagrip.result.findings import ASSUMED_MESH, Probability
from helpers.clips import small_clip
from helpers.environment import Run, import_path
from helpers.folders import FullDisk, contents, results_in
from helpers.scenes import egg_and_mug, perfect

LONG = "ß" * 100
"""200 bytes: as long as a name may be."""


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Three clips."""
    clip, masks = small_clip()
    for name in ("a", "b", LONG):
        write_clip(replace(clip, name=name), masks, tmp_path / "clips" / name)
    return tmp_path / "clips"


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Instead of the method, the truth; the names of the clips that were fitted."""
    names: list[str] = []

    def fit(clip: Clip, masks: object, options: Options, progress: object, threads: int) -> Reconstruction:
        names.append(clip.name)
        given = json.loads(to_json(asdict(options)))
        return replace(perfect(clip), clip=clip.name, options=given, method=options.method, seed=options.seed)

    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", fit)
    return names


def rows(out: Path) -> dict[str, dict[str, str]]:
    """The summary by clip."""
    with (out / "summary.csv").open(encoding="utf-8", newline="") as file:
        return {row["clip"]: row for row in csv.DictReader(file)}


@pytest.mark.slow
def test_what_is_done_is_done_again_only_where_something_differs_and_that_is_said(
    clips: Path, tmp_path: Path, run: Run, fitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    call = ("reconstruct", clips, "--out", out)
    assert run(*call)[0] == 0
    assert fitted == ["a", "b", LONG]
    before = contents(out / "a")
    (out / "ledger.sqlite").unlink()  # results do without
    assert "0 done, 3 already done, 0 failed" in run(*call)[1]
    assert (len(fitted), contents(out / "a")) == (3, before)

    (out / "b" / "result.npz").write_bytes(b"PK")
    said = run(*call)[1]
    assert "b: done again, since the earlier result is damaged (" in said
    monkeypatch.setattr(plugins, "fingerprint", lambda: "0123456789abcdef")
    assert run(*call)[1].count("done again, since the earlier result is of other code") == 3
    mesh = clips / "a" / "object.obj"
    mesh.write_text(mesh.read_text() + "# edited\n")
    assert "a: done again, since the earlier result is of another clip" in run(*call)[1]
    assert fitted[3:] == ["b", "a", "b", LONG, "a"]


def test_a_clip_that_changes_while_it_is_read_is_not_called_done(
    clips: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fit(clip: Clip, *_: object) -> Reconstruction:
        if clip.name == "a":
            mesh = clips / "a" / "object.obj"
            mesh.write_text(mesh.read_text() + "# edited\n")
        return perfect(clip, clip.name)

    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", fit)
    status, printed, err = run("reconstruct", clips, "--out", tmp_path / "out")
    assert status == 1
    assert "2 done, 0 already done, 1 failed" in printed
    assert "files that changed while they were read" in err
    assert len(results_in(tmp_path / "out")) == 2


def test_the_summary_has_a_row_for_each_clip_and_the_index_shows_the_worst(
    clips: Path, tmp_path: Path, run: Run, fitted: list[str]
) -> None:
    (clips / "torn").mkdir()
    (clips / "torn" / "clip.json").write_text("{")
    (clips / "b" / "hand.npz").unlink()
    out = tmp_path / "out"
    assert run("reconstruct", clips, "--out", out)[0] == 1
    table = rows(out)
    assert {name: row["status"] for name, row in table.items()} == {
        "a": "done", LONG: "done", "b": "failed", "torn": "failed",
    }  # fmt: skip
    assert "hand.npz: no such file" in table["b"]["why"]
    assert table["a"]["IOU"] == "1.0000"
    assert float(table["a"]["seconds"]) > 0
    page = (out / "index.html").read_text()
    assert page.index('"folder":"b"') < page.index('"folder":"a"')
    for path in out.glob("a/*"):
        path.unlink()
    (out / "a").rmdir()
    assert run("reconstruct", clips / "b", clips / "torn", "--out", out)[0] == 1
    assert rows(out)["a"]["why"] == "its result has been removed"


def test_of_clips_that_share_a_name_only_these_fail(clips: Path, tmp_path: Path, run: Run, fitted: list[str]) -> None:
    clip, masks = small_clip()
    write_clip(replace(clip, name="a"), masks, clips / "copied")
    status, printed, err = run("reconstruct", clips, "--out", tmp_path / "out")
    assert (status, sorted(fitted)) == (1, ["b", LONG])
    assert "2 done, 0 already done, 2 failed" in printed
    assert f"failed: a: {clips / 'a'}: name must be" in err
    assert f"failed: a: {clips / 'copied'}: name must be" in err


def test_fail_fast_begins_no_other_clip(clips: Path, tmp_path: Path, run: Run, fitted: list[str]) -> None:
    (clips / "a" / "hand.npz").unlink()
    assert run("reconstruct", clips, "--out", tmp_path / "out", "--fail-fast")[0] == 1
    assert fitted == []


def test_shards_are_parts_of_all_clips(clips: Path) -> None:
    paths = [clips]
    with ClipPlan(paths) as plan:
        everything = dict(plan)
    parts = []
    for index in (1, 2, 3):
        with ClipPlan(paths, Shard(index, 3)) as plan:
            parts.append(dict(plan))
    assert sum(map(len, parts)) == len(everything) == 3
    assert parts[0] | parts[1] | parts[2] == everything
    for text in ("0/3", "4/3", "3", "a/b", "1/0"):
        with pytest.raises(UsageError, match="must be i/N"):
            Shard.of(text)


def test_a_pattern_stands_for_the_clips_that_it_matches(
    clips: Path, tmp_path: Path, run: Run, fitted: list[str]
) -> None:
    assert run("reconstruct", clips / "[ab]", "--out", tmp_path / "out")[0] == 0
    assert fitted == ["a", "b"]
    status, _, err = run("reconstruct", clips / "x*", "--out", tmp_path / "out")
    assert status == 1
    assert "got a pattern that no clip matches" in err


# Faults.


@pytest.mark.parametrize("size", [100, 5_000, 40_000])
@pytest.mark.slow
def test_a_full_disk_leaves_no_broken_result(
    clips: Path, tmp_path: Path, run: Run, fitted: list[str], full_disk: FullDisk, size: int
) -> None:
    out = tmp_path / "out"
    with full_disk(size):
        status, _, err = run("reconstruct", clips, "--out", out)
    assert status == 1
    assert err
    for folder in results_in(out):
        read_result(folder)
    assert not [path for path in out.rglob("*") if path.name.startswith(files.TEMPORARY_FOLDER_PREFIX)]
    assert run("reconstruct", clips, "--out", out)[0] == 0
    assert len(results_in(out)) == len(rows(out)) == 3


def test_a_folder_that_may_not_be_written_is_named(clips: Path, run: Run, fitted: list[str]) -> None:
    """Root may write everywhere: it becomes somebody else meanwhile."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        out.mkdir(mode=0o555)
        Path(folder).chmod(0o755)
        root = os.geteuid() == 0
        if root:
            os.seteuid(65534)
        try:
            status, _, err = run("reconstruct", clips, "--out", out)
        finally:
            if root:
                os.seteuid(0)
        assert status == 2
        assert err.startswith(f"getagrip: --out must be a folder that can be written (got {out}: ")
        assert fitted == []


@pytest.mark.parametrize("how", ["foreign", "text", "endless", "row", "long"])
@pytest.mark.slow
def test_a_ledger_that_is_none_is_refused_in_one_line(
    clips: Path, tmp_path: Path, run: Run, fitted: list[str], how: str
) -> None:
    out = tmp_path / "out"
    run("reconstruct", clips, "--out", out)
    path = out / "ledger.sqlite"
    if how == "text":
        path.write_text("letters" * 1000)
    else:
        if how == "foreign":
            path.unlink()
        with closing(sqlite3.connect(path)) as db, db:
            endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n"
            change = {
                "foreign": "CREATE TABLE letters (text)",
                "endless": f"CREATE VIEW tasks_of AS {endless}",
                "row": "UPDATE tasks SET about = '['",
                "long": "UPDATE tasks SET about = json_object('a', hex(zeroblob(524288)))",
            }
            db.execute(change[how])
    status, _, err = run("reconstruct", clips, "--out", out)
    assert status == 1
    assert err.count("\n") == 1
    assert re.search(r"ledger\.sqlite(: tasks)? must be", err)
    assert "results do without" in err


@pytest.fixture
def killed(tmp_path: Path) -> Iterator[Path]:
    """The target of a writer that is at work; it is killed in the end."""
    target = tmp_path / "out" / "clip"
    code = (
        "import sys, time; from pathlib import Path; from getagrip.io.files import new_folder\n"
        f"with new_folder(Path({str(target)!r})) as new:\n"
        "    (new / 'half').touch(); print(flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], env=import_path(), stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        assert files.remove_stale_folders(target.parent) == []  # it lives
        writer.kill()
        writer.wait()
        yield target


@pytest.mark.slow
def test_what_a_killed_writer_leaves_is_swept_and_what_it_was_replacing_returns(
    killed: Path, clips: Path, run: Run, fitted: list[str]
) -> None:
    out = killed.parent
    (left,) = out.glob(f"{files.TEMPORARY_FOLDER_PREFIX}*")
    assert (left / "new" / "clip" / "half").exists()
    replaced = left / "old" / "older"  # as where it is killed between the two renames
    with new_folder(replaced) as new:
        for name in RESULT_FILES:
            (new / name).touch()
    assert "unfinished work of a process that has died" in run("reconstruct", clips, "--out", out)[2]
    assert not left.exists()
    assert (out / "older" / RESULT_FILES[0]).exists()
    assert not (out / "clip").exists()


def test_a_result_has_the_checksum_of_the_clip_that_it_was_made_from(
    clips: Path, tmp_path: Path, run: Run, fitted: list[str]
) -> None:
    run("reconstruct", clips / "a", "--out", tmp_path / "out")
    assert read_result(tmp_path / "out" / "a")[1]["input_sha256"] == input_sha256(clips / "a")
    assert not (tmp_path / "out" / "summary.csv").exists()  # of one clip


@pytest.mark.parametrize("name", RESERVED_NAMES)
def test_no_clip_takes_the_place_of_a_file_beside_the_results(tmp_path: Path, name: str) -> None:
    clip, masks = small_clip()
    folders = [write_clip(replace(clip, name=of), masks, tmp_path / of) for of in (name, "mug")]
    with ClipPlan(folders) as plan:
        assert [found for found, _ in plan] == ["mug"]
        (failed,) = plan.failed
        assert failed.name == name
        assert "name must be" in failed.message


def test_clips_that_share_a_name_fail_and_no_others(tmp_path: Path) -> None:
    clip, masks = small_clip()
    names = {"a": "mug", "b": "cup", "c": "mug", "d": "pan", "e": "mug", "r\udcff": "pan"}
    folders = [write_clip(replace(clip, name=name), masks, tmp_path / folder) for folder, name in names.items()]
    with ClipPlan([tmp_path]) as plan:
        assert [name for name, _ in plan] == ["cup"]
        assert len(plan) == 1
        for outcome in plan.failed:
            here = next(
                folder
                for folder in folders
                if outcome.message.startswith(f"{escape_unprintable(str(folder))}: name must be")
            )
            assert names[here.name] == outcome.name
            assert "a name of its own" in outcome.message
            others = [f for f in folders if names[f.name] == outcome.name and f != here]
            assert any(escape_unprintable(f"{other} has the same") in outcome.message for other in others)
        assert len({outcome.message for outcome in plan.failed}) == 5


@pytest.mark.parametrize(("folds", "left"), [(False, ["Mug", "cup", "mug"]), (True, ["cup"])])
def test_where_case_makes_no_other_file_names_that_differ_in_it_alone_are_shared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folds: bool, left: list[str]
) -> None:
    """As on Windows and macOS."""
    monkeypatch.setattr("getagrip.batch.clips.FOLDS_CASE", folds)
    clip, masks = small_clip()
    for folder, name in enumerate(("Mug", "cup", "mug")):
        write_clip(replace(clip, name=name), masks, tmp_path / str(folder))
    with ClipPlan([tmp_path]) as found:
        assert [name for name, _ in found] == left
        assert len(found.failed) == 3 - len(left)


def test_a_clip_that_is_named_twice_counts_once(tmp_path: Path) -> None:
    clip, masks = small_clip()
    for name in ("mug", "cup"):
        write_clip(replace(clip, name=name), masks, tmp_path / "clips" / name)
    (tmp_path / "link").symlink_to(tmp_path / "clips" / "mug")
    with ClipPlan([tmp_path / "clips", tmp_path / "clips" / "mug", tmp_path / "link"]) as plan:
        assert (list(plan), plan.failed) == ([(n, tmp_path / "clips" / n) for n in ("cup", "mug")], [])


RED = "bad\x1b[31mRED\x07"
"""The name of a folder that colours what follows, and rings."""


def test_a_batch_is_summed_up_by_its_probabilities() -> None:
    assert (
        expected_right_message({"a": 0.95, "b": 0.98}) == "about 2 of 2 are right in the hand, by their probabilities"
    )
    assert expected_right_message({"a": 0.95}, "right in the camera").startswith(
        "about 1 of 1 are right in the camera, by"
    )
    text = expected_right_message({"a": 0.9, "b": 0.4, "c": 0.1, "d": 0.6})
    assert text.startswith("about 2 of 4 are right")
    assert text.endswith("worst first: c, b")


def test_a_batch_counts_apart_how_results_of_assumed_meshes_look(capsys: pytest.CaptureFixture[str]) -> None:
    tally = _Tally()
    for name, value, beyond in (("a", 0.9, ()), ("b", 0.12, (ASSUMED_MESH,)), ("c", 0.01, (ASSUMED_MESH,))):
        tally.add(Outcome(name, "done", "", probability_right=Probability(value, "", beyond)), KeepOptions())
    tally.print()
    assert capsys.readouterr().out.splitlines()[1:] == [
        "1 of 2 by eye: probably looks right: b",
        "1 of 2 by eye: probably looks wrong: c",
        "about 1 of 1 are right in the hand, by their probabilities",
    ]


def test_names_of_folders_move_no_cursor(clip_folder: Path, tmp_path: Path, run: Run) -> None:
    """Nor do traces, which keep their lines."""
    (tmp_path / "clips" / RED).mkdir(parents=True)
    (tmp_path / "clips" / RED / "clip.json").write_text("{")
    for command in (("reconstruct", "--out", tmp_path / "out"), ("segment",)):
        status, out, err = run(*command, tmp_path / "clips", "--debug")
        assert status == 1
        assert "\x1b" not in out + err
        assert "\x07" not in out + err
        assert err.startswith(r"failed: bad\x1b[31mRED\x07: ")
        assert "\nTraceback (most recent call last):\n" in err


@pytest.mark.slow
def test_what_results_say_moves_no_cursor(tmp_path: Path, run: Run) -> None:
    clip, masks = egg_and_mug()
    written = write_clip(clip, masks, tmp_path / "clips" / clip.name)
    made_from = input_sha256(written)
    folders = [write_result(perfect(clip), tmp_path / name / RED, made_from, clip_folder=written) for name in "ab"]
    for folder, method in zip(folders, (RED, "static"), strict=True):
        fields = json.loads((folder / "result.json").read_text())
        (folder / "result.json").write_text(json.dumps(fields | {"method": method}))
    status, out, err = run("evaluate", *folders)
    assert (status, err) == (0, "")
    assert "\x1b" not in out
    assert r"\x1b[31mRED" in out
    status, out, err = run("export", folders[0].parent, "--to", "glb")
    assert (status, err) == (0, "egg-and-mug is uncertain\n")
    assert r"bad\x1b[31mRED" in out


@pytest.mark.slow
def test_two_workers_have_the_same_bits_as_one(can_and_box: Path, tmp_path: Path, run: Run) -> None:
    call = ("reconstruct", can_and_box, "--method", "static", "--inits", "4")
    found = []
    for workers in ("1", "2"):
        out = tmp_path / workers
        assert run(*call, "--out", out, "--workers", workers)[0] == 0
        read = [read_result(folder) for folder in results_in(out)]
        found.append([(replace(result, seconds={}), record | {"seconds": {}}) for result, record in read])
    assert len(found[0]) == 2
    assert found[0] == found[1]
