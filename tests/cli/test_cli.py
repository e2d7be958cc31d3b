"""The program: how it starts, exit statuses, messages, and batches that survive their clips."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import getagrip
from getagrip import __main__
from getagrip.cli import command_groups, main
from getagrip.cli.bench import BENCHES
from getagrip.cli.command import Command
from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.result import read_result
from helpers.environment import ROOT, Run
from helpers.folders import results_in

QUICK = ("--inits", "8", "--frames", "4")


def broken_clip(can_and_box: Path, folder: Path) -> Path:
    """A copy of the can whose fps is zero."""
    clip = read_clip(can_and_box / "can")
    write_clip(clip, read_masks(clip), folder)
    path = folder / "clip.json"
    path.write_text(re.sub(r'"fps": [\d.]+', '"fps": 0', path.read_text()))
    return folder


@pytest.mark.parametrize(
    "args",
    [
        ("--help",),
        *((command, "--help") for command in ("demo", "reconstruct", "evaluate", "import", "report", "doctor")),
    ],
)
def test_help_is_there(run: Run, args: tuple[str, ...]) -> None:
    status, out, _ = run(*args)
    assert status == 0
    assert "usage: getagrip" in out


@pytest.mark.parametrize(
    "args",
    [
        (),
        ("reconstrct",),
        ("clip",),
        ("init", "lern"),
        ("reconstruct", "a"),
        ("reconstruct", "--out", "x"),
        ("reconstruct", "a", "--out", "x", "--method", "guess"),
        ("reconstruct", "a", "--out", "x", "--inits", "many"),
        ("reconstruct", "a", "--out", "x", "--inits", "0"),
        ("reconstruct", "a", "--out", "x", "--frames", "1"),
        ("reconstruct", "a", "--out", "x", "--workers", "0"),
        ("reconstruct", "a", "--out", "x", "--seed", "-1"),
        ("reconstruct", "a", "--out", "x", "--color"),
        ("reconstruct", "a", "--out", "x", "--keep", "0.95", "--inits", "10"),
        ("reconstruct", "a", "--out", "x", "--keep", "0.95", "--method", "static"),
        ("reconstruct", "a", "--out", "x", "--keep", "0.95", "--find-grasps"),
        ("refine", "a", "--clips", "a", "--out", "x", "--keep", "0.95", "--given-hands"),
        ("reconstruct", "a", "--out", __file__),
        ("evaluate",),
        ("evaluate", "a", "--json", f"{__file__}/file.json"),
        ("import", "dexycb", "root", "--out", "x"),
        ("report",),
        ("status",),
    ],
)
@pytest.mark.slow
def test_wrong_calls_exit_with_2(run: Run, args: tuple[str, ...], tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = run(*args)
    assert status == 2
    assert err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("recon dexall --out x", "unknown command 'recon'; choose from reconstruct"),
        ("sudy", "unknown command 'sudy'; choose from study"),
        ("cip new v.mp4", "unknown command 'cip'; choose from clip new"),
        ("reproduce", "incomplete command 'reproduce'; choose from reproduce epic-grasps, reproduce arctic-grasps"),
        ("reproduce --help", "incomplete command 'reproduce'; choose from reproduce epic-grasps, reproduce arctic"),
        ("clip --out x", "unknown command 'clip --out'; choose from clip new"),
        ("init lern", "unknown command 'init lern'; choose from init learn"),
        ("e", "unknown command 'e'; choose from export, evaluate, epic candidates"),
        ("frobnicate", "unknown command 'frobnicate'; choose from demo, doctor, synthesise, draft"),
        ("import dexicb root --out x", "unknown command 'import dexicb'; choose from import dexycb"),
        ("import frobnicate", "unknown command 'import frobnicate'; choose from hot3d, dexycb"),
        ("figure galery", "unknown command 'figure galery'; choose from figure gallery"),
        ("bench dexicb --out x", "unknown command 'bench dexicb'; choose from bench dexycb"),
    ],
)
def test_a_mistyped_command_is_answered_with_the_nearest(run: Run, call: str, expected: str) -> None:
    status, out, err = run(*call.split())
    assert (status, out) == (2, "")
    assert err.startswith(f"getagrip: {expected}")
    assert err.count("\n") == 1


@pytest.mark.parametrize("out", ["/proc/u1", "/dev/null", "/dev/null/sub", "a" * 300])
def test_places_that_cannot_be_written_are_refused_first(run: Run, out: str, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    for call in (("reconstruct", "a", "--out"), ("demo", "--out"), ("import", "hot3d", "a", "--out")):
        status, printed, err = run(*call, out)
        assert (status, printed) == (2, "")
        assert err.startswith(f"getagrip: --out must be a folder that can be written (got {out}: ")
        assert err.count("\n") == 1
    status, _, err = run("evaluate", "a", "--json", f"{out}/x.json")
    assert status == 2
    assert "--json must be a folder that can be written (got " in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.long
def test_a_clip_goes_all_the_way(run: Run, can_and_box: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    status, printed, _ = run("reconstruct", can_and_box, "--out", out, *QUICK)
    assert status == 0
    assert "2 done, 0 already done, 0 failed" in printed
    names = {read_clip(can_and_box / name).name for name in ("can", "box")}
    assert {path.name for path in results_in(out)} == names
    assert {path.name for path in out.iterdir()} == names | {"ledger.sqlite", "summary.csv", "index.html"}
    result, record = read_result(results_in(out)[0])
    assert result.options["inits"] == 8
    assert record["metrics"]["iou_full"] == pytest.approx(result.iou.mean())

    # What is done is kept, --overwrite makes it again: the same, in whatever process. Other options make it again, too.
    status, printed, _ = run("reconstruct", can_and_box, "--out", out, *QUICK)
    assert status == 0
    assert "0 done, 2 already done, 0 failed" in printed
    here = {path.name: read_result(path)[0].T_hand_obj for path in results_in(out)}
    status, printed, _ = run("reconstruct", can_and_box / "can", "--out", out, *QUICK, "--seed", 3)
    assert status == 0
    assert "done again, since the earlier result is of another seed: IOU" in printed
    in_a_process = ("--overwrite", "--limit-seconds", 600)
    assert run("reconstruct", can_and_box / "can", "--out", out, *QUICK, *in_a_process)[0] == 0
    for name, T_hand_obj in here.items():
        np.testing.assert_array_equal(read_result(out / name)[0].T_hand_obj, T_hand_obj)

    file = tmp_path / "new" / "numbers.json"
    status, printed, _ = run("evaluate", out, "--clips", can_and_box, "--json", file)
    assert status == 1  # the folders are not named as the clips are
    status, printed, _ = run("evaluate", *sorted(out.iterdir()), "--json", file)  # as `out/*` names them
    assert status == 0
    assert all(name in printed for name in names)
    samples = json.loads(file.read_text())["samples"]
    assert {sample["clip"] for sample in samples} == names
    assert all(0.0 < sample["metrics"]["iou"] <= 1.0 for sample in samples)

    status, printed, _ = run("report", results_in(out)[0])
    assert status == 0
    assert [Path(line).name for line in printed.split("\n")[:-1]] == ["report.html", "report.png"]
    assert all(Path(line).stat().st_size > 10_000 for line in printed.split("\n")[:-1])


@pytest.mark.slow
def test_one_broken_clip_stops_no_other(run: Run, can_and_box: Path, tmp_path: Path) -> None:
    broken = broken_clip(can_and_box, tmp_path / "broken")
    status, printed, err = run(
        "reconstruct", broken, tmp_path / "none", can_and_box / "box", "--out", tmp_path / "out", *QUICK
    )
    assert status == 1
    assert "1 done, 0 already done, 2 failed" in printed
    lines = err.strip().splitlines()
    assert len(lines) == 2
    assert "broken/clip.json: fps must be " in lines[0]
    assert "none: no such folder" in lines[1]
    assert len(results_in(tmp_path / "out")) == 1
    assert "Traceback" in run("reconstruct", broken, "--out", tmp_path / "out", "--debug")[2]


def test_an_archive_on_a_disk_has_an_address(run: Run, tmp_path: Path) -> None:
    (tmp_path / "mug.zip").write_bytes(b"PK")
    status, _, err = run("reconstruct", tmp_path / "mug.zip", "--out", tmp_path / "out")
    assert status == 1
    assert "mug.zip must be a clip, or a folder of clips (got an archive); reconstruct reads" in err
    assert err.strip().endswith(f"local://{tmp_path}/mug.zip")


def test_foreign_folders_are_left_alone(run: Run, can_and_box: Path, tmp_path: Path) -> None:
    mine = tmp_path / read_clip(can_and_box / "can").name
    mine.mkdir()
    (mine / "letter.txt").write_text("dear")
    status, _, err = run("reconstruct", can_and_box / "can", "--out", tmp_path, "--overwrite", *QUICK)
    assert status == 1
    assert "not overwritten" in err
    assert [path.name for path in mine.iterdir()] == ["letter.txt"]


def test_a_folder_without_clips_or_results_is_named(run: Run, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for command in (("reconstruct", "--out", tmp_path / "out"), ("evaluate",)):
        status, _, err = run(*command, tmp_path / "empty")
        assert status == 1
        assert "empty: no " in err


def test_an_import_without_recordings_is_named(run: Run, tmp_path: Path) -> None:
    status, _, err = run("import", "hot3d", tmp_path, "--out", tmp_path / "out")
    assert status == 1
    assert err.startswith("getagrip: ")
    assert not (tmp_path / "out").exists()


def test_an_interrupt_leaves_no_traceback(can_and_box: Path, tmp_path: Path, monkeypatch: Any, run: Run) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("getagrip.batch.clips.reconstruct_one", interrupted)
    status, _, err = run("reconstruct", can_and_box, "--out", tmp_path / "out")
    assert status == 130
    assert "interrupted" in err


def test_commands_stand_under_headings(run: Run) -> None:
    status, out, _ = run("--help")
    headings = [line for line in out.splitlines() if line.istitle() and " " not in line]
    assert (status, headings) == (0, ["Start", "Video", "Solve", "Look", "Use", "Measure"])
    listed = [line[2:].split("  ")[0] for line in out.splitlines() if line.startswith("  ") and line[2] != " "]
    named = [command.__metadata__[0].name for group in command_groups(Command, Command).values() for command in group]
    assert listed == named
    assert len({*named}) == len(named)


def test_options_of_executors_stand_under_one_heading(run: Run) -> None:
    for command in ("reconstruct", "refine", "import dexycb", "bench synthetic", "reproduce epic-grasps"):
        before, _, executor = run(*command.split(), "--help")[1].partition("executor options")
        for option in ("--workers", "--engine", "--address", "--shard", "--ledger", "--limit-seconds", "--limit-gb"):
            listed = re.compile(rf"^\W*{option} ", re.MULTILINE)
            assert listed.search(executor), command
            assert not listed.search(before), command


def test_a_night_s_work_without_probabilities_is_not_begun(run: Run, tmp_path: Path) -> None:
    call = ("reconstruct", tmp_path / "clips", "--out", tmp_path / "out", "--keep", "0.95", "--inits", "10")
    status, _, err = run(*call)
    assert (status, "none is calibrated for fewer than 50 initial poses" in err) == (2, True)


@pytest.mark.parametrize("words", ["clip new", "epic candidates", "init learn"])
def test_help_shows_commands_as_they_are_typed(run: Run, words: str) -> None:
    assert run(*words.split(), "--help")[1].startswith(f"usage: getagrip {words} ")
    assert run(words.split(maxsplit=1)[0], "--help")[1] == run(*words.split(), "--help")[1]
    assert f" {words} " in run("--help")[1]


def test_help_shows_what_may_be_left_out_and_what_a_root_may_be(run: Run) -> None:
    assert "epic-grasps|LIST [CSV]\n" in run("stats", "--help")[1]
    assert "a packed file" in run("import", "dexycb", "--help")[1].split("options ─")[0]


@pytest.mark.parametrize(
    ("args", "words"),
    [(("--K", "1000", "1000", "960"), "Expected 4 values"), (("--side", "l"), "Expected one of ('left', 'right')")],
)
def test_wrong_values_are_explained_without_types(run: Run, args: tuple[str, ...], words: str, tmp_path: Path) -> None:
    status, _, err = run("clip", "new", "v.mp4", "--out", tmp_path / "clip", *args)
    assert status == 2
    assert words in err
    assert "None" not in err


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("demo", "--out", ""), "got an empty text"),
        (("reconstruct", "a", "--out="), "got an empty text"),
        (("evaluate", "a", "--clips", ""), "got an empty text"),
        (("evaluate", ""), "RESULT...: "),
        (("reconstruct", "", "--out", "x"), "CLIP...: "),
    ],
)
def test_empty_texts_are_no_paths(
    run: Run, args: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = run(*args)
    assert status == 2
    assert words in err
    assert list(tmp_path.iterdir()) == []


def test_home_is_meant_where_no_shell_says_so(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for args in (
        ("reconstruct", "~/a", "--out=~/b"),
        ("evaluate", "~/a", "--clips=~/b"),
        ("import", "tracks", "~/a", "--out=~/b"),
    ):
        status, _, err = run(*args)
        assert status
        assert f"{tmp_path}/home/a" in err
    assert not (tmp_path / "~").exists()


def test_an_interrupt_while_modules_load_leaves_no_traceback(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    class Interrupted:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "getagrip.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "getagrip.cli")
    monkeypatch.delattr(getagrip, "cli")
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    assert __main__.main() == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_the_program_is_installed_with_it() -> None:
    content = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert content["project"]["scripts"] == {"getagrip": "getagrip.__main__:main"}


@pytest.mark.slow
def test_help_loads_nothing_heavy() -> None:
    """Not of any command, but for import and figure, whose options are declared with readers and drawings."""
    groups = command_groups(Command, Command).values()
    names = [get_args(command)[1].name for group in groups for command in group]
    calls = [name.split() for name in names if name not in ("import", "figure")]
    calls += [["bench", source.dataset] for _, source in BENCHES]
    code = (
        "import sys, getagrip\n"
        "from getagrip.cli import main\n"
        f"for call in {calls}:\n"
        "    try: main([*call, '--help'])\n"
        "    except SystemExit: pass\n"
        "    heavy = {'numpy', 'numba', 'scipy', 'trimesh', 'cv2', 'matplotlib', 'igl'} & set(sys.modules)\n"
        "    if heavy: sys.exit(f'{call}: {heavy}')\n"
        "for name in ('import', 'import dexycb', 'figure'):\n"
        "    try: main([*name.split(), '--help'])\n"
        "    except SystemExit: pass\n"
        "    if 'scipy.spatial' in sys.modules or 'matplotlib' in sys.modules: sys.exit(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_version_is_printed(run: Run) -> None:
    assert run("--version")[:2] == (0, f"getagrip {getagrip.__version__}\n")


@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_closed_output_is_no_error(closed: str, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(sys, closed, None)
    for args, status in ((["--help"], 0), (["reconstrct"], 2), (["evaluate", "none"], 1)):
        try:
            found = main(args)
        except SystemExit as exit_:
            found = int(exit_.code or 0)
        assert found == status
    getattr(sys, closed).close()
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_reader_that_leaves_ends_the_command_quietly() -> None:
    command = [sys.executable, "-m", "getagrip", "init", "learn", "--help"]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 141
