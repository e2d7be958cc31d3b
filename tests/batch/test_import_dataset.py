"""``getagrip import``: its subcommands are the table of datasets; all treat clips alike."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from dataclasses import fields
from pathlib import Path

import pytest

from getagrip.batch.import_dataset import ImportJob, import_clips, import_part
from getagrip.batch.ledger import LEDGER_FILE, Ledger
from getagrip.batch.scheduling import Limits, SchedulingOptions, Shard
from getagrip.cli.datasets import DATASETS
from getagrip.errors import InputError
from getagrip.io import files
from getagrip.readers.datasets.cutting import TrackedDataset
from getagrip.readers.datasets.dataset import clips
from helpers.environment import ROOT, Library, Run, Shelf

SHARING = ("workers", "engine", "address", "limit-seconds", "limit-gb", "fail-fast", "shard", "ledger")


@pytest.mark.parametrize("name", DATASETS)
@pytest.mark.slow
def test_a_subcommand_has_the_options_of_its_dataset_and_no_others(run: Run, name: str) -> None:
    status, out, _ = run("import", name, "--help")
    assert status == 0
    positional, *named = [field.name.replace("_", "-") for field in fields(DATASETS[name])]
    if issubclass(DATASETS[name], TrackedDataset):
        named.remove("grasps")
        named += ["tau", "contact-mm", "points", "rule", "shortest", "intervals"]  # the same of all, as of segment
    options = re.findall(r"^\W{0,5}(?:-h, )?--([a-z][a-z-]*)", out, re.MULTILINE)
    assert sorted(options) == sorted(["help", "debug", "quiet", "out", *SHARING, *named])
    assert positional.upper() in out
    assert DATASETS[name].__doc__.split()[0] in out


def test_the_definitions_of_grasps_are_those_of_the_documentation() -> None:
    """The paper: tau 0.5 and 0 mm on ARCTIC, 0.3 and 10 mm on HOI4D, of any length. A clip has two frames at least."""
    stated = {}
    for line in (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8").splitlines():
        row = re.fullmatch(r"\| (`.+`) \| ([\d.]+|-) \| (\d+) mm.* \| ([a-z ]+) \| (\d+) frames \|.*", line)
        for name in re.findall(r"`([\w-]+)`", row[1]) if row else ():
            stated[name] = (row[2], float(row[3]), row[4].replace(" ", "-"), int(row[5]))
    made = {}
    for name, dataset in DATASETS.items():
        if issubclass(dataset, TrackedDataset):
            it = dataset(root=Path("nowhere")).grasps.definition()
            made[name] = ("-" if it.rule == "touch" else f"{it.tau:g}", 1e3 * it.contact, it.rule, it.shortest)
    assert made == stated
    assert made["arctic"] == ("0.5", 0.0, "first", 20)
    assert made["hoi4d"] == ("0.3", 10.0, "all-pairs", 2)


@pytest.mark.slow
def test_an_unknown_dataset_is_refused_and_the_known_ones_are_named(run: Run) -> None:
    status, _, err = run("import", "nowhere", "root", "--out", "x")
    assert status == 2
    assert all(name in err for name in DATASETS)


@pytest.mark.slow
def test_help_loads_no_reader() -> None:
    code = (
        "import sys\n"
        "from getagrip.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "loaded = {'numpy', 'getagrip.readers.datasets', 'getagrip.hands'} & set(sys.modules)\n"
        "sys.exit(','.join(loaded) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_the_table_loads_no_compiler() -> None:
    """Or else ``getagrip import --help`` would wait for numba."""
    code = "import sys, getagrip.cli.datasets\nsys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_trouble_of_a_clip_or_a_part_ends_no_other(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    library = Library(shelves=(Shelf("torn"), Shelf("fine")))
    (tmp_path / f"{files.TEMPORARY_FOLDER_PREFIX}0" / "new").mkdir(parents=True)  # of a process that was killed
    assert import_clips(library, tmp_path, debug=False) == 1
    printed = capsys.readouterr()
    assert {folder.name for folder in tmp_path.iterdir()} == {"torn-0", "torn-3", "fine-0", "fine-3", LEDGER_FILE}
    assert printed.out.splitlines()[-1] == "4 clips, 0 already there, 2 of 2 shelves failed"
    for words in (
        "got a damaged file",
        "got half a file",
        "fine-2: nothing",
    ):
        assert words in printed.err


def test_clips_are_made_again_when_hands_are_found_that_they_lack(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    without, with_hands = Library(shelves=(Shelf("a", handless=True),)), Library(shelves=(Shelf("a"),))
    for library, line, handless in (
        (without, "2 clips, 0 already there", 2),
        (without, "0 clips, 2 already there", 2),
        (with_hands, "2 clips, 0 already there", 0),
        (with_hands, "0 clips, 2 already there", 0),
    ):
        import_clips(library, tmp_path, debug=False)
        printed = capsys.readouterr()
        assert line in printed.out
        assert f"{handless} handless" in printed.err


@pytest.mark.slow
def test_a_part_that_takes_too_long_is_left_behind_and_the_ledger_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    library = Library(shelves=(Shelf("endless"), Shelf("a")))
    limits = Limits(seconds=10.0)  # the other part takes a tenth of a second, on a busy machine more than one
    assert import_clips(library, tmp_path, debug=False, share=SchedulingOptions(limits=limits)) == 1
    assert "endless: it took longer than 10 s (--limit-seconds)" in capsys.readouterr().err
    with Ledger(tmp_path) as ledger:
        entries = {entry.name: entry for entry in ledger.entries()}
    assert {name: entry.state for name, entry in entries.items()} == {"endless": "failed", "a": "failed"}
    assert "(got a damaged file" in entries["a"].why
    assert entries["a"].about == {"done": 2, "failed": 1}


def test_nothing_is_begun_after_a_failure_where_that_is_asked_for(tmp_path: Path) -> None:
    library = Library(shelves=(Shelf("a"), Shelf("b")))
    assert import_clips(library, tmp_path, debug=False, share=SchedulingOptions(fail_fast=True)) == 1
    assert {path.parent.name for path in tmp_path.glob("*/clip.json")} == {"a-0", "a-3"}


@pytest.mark.slow
def test_shards_read_each_part_once(tmp_path: Path) -> None:
    shelves = tuple(Shelf(f"s{n}") for n in range(5))
    made = []
    for index in (1, 2):
        out = tmp_path / str(index)
        import_clips(Library(shelves=shelves), out, debug=False, share=SchedulingOptions(shard=Shard(index, 2)))
        made += [path.parent.name for path in out.glob("*/clip.json")]
    assert sorted(made) == sorted(f"s{n}-{k}" for n in range(5) for k in (0, 3))


@pytest.mark.slow
def test_a_part_that_another_call_reads_is_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with Ledger(tmp_path) as other:
        assert other.claim("a", "", "") is not None
        call = threading.Thread(target=import_clips, args=(Library(shelves=(Shelf("a"),)), tmp_path, False))
        call.start()
        call.join(0.7)
        assert call.is_alive()
        assert not list(tmp_path.glob("a-*"))
    call.join(30.0)  # the other one has left
    assert {path.name for path in tmp_path.glob("a-*")} == {"a-0", "a-3"}


def test_clips_in_memory_are_read_to_the_end_before_an_error_is_raised() -> None:
    notes: list[str] = []
    found = clips(Library(shelves=(Shelf("a"), Shelf("torn"))), notes.append)
    assert [next(found)[0].name for _ in range(2)] == ["a-0", "torn-0"]
    with pytest.raises(InputError, match="a-1"):
        next(found)
    assert any("torn-1" in note for note in notes)


def test_a_camera_of_other_images_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("getagrip.checks.intrinsics.camera_warning", lambda K, size: "it fits images of 8 x 6")
    imported = import_part(ImportJob(Shelf("a"), tmp_path))
    assert imported.warned == len(imported.made) == 2
    assert f"{tmp_path / 'a-0'}: warning: camera: it fits images of 8 x 6" in imported.notes
