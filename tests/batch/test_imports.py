"""``getagrip import``: its subcommands are the table of datasets, and what happens to clips is the same for all."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import pytest
from conftest import Run, small_clip

from getagrip.batch.imports import import_clips
from getagrip.clip import Clip, Masks
from getagrip.commands.datasets import DATASETS
from getagrip.datasets.cutting import TrackedDataset
from getagrip.datasets.dataset import Dataset, Draft, Missing, Note, clips
from getagrip.errors import InputError
from getagrip.io import leftovers


@pytest.mark.parametrize("name", DATASETS)
def test_a_subcommand_has_the_options_of_its_dataset_and_no_others(run: Run, name: str) -> None:
    status, out, _ = run("import", name, "--help")
    assert status == 0
    positional, *named = [field.name.replace("_", "-") for field in fields(DATASETS[name])]
    if issubclass(DATASETS[name], TrackedDataset):
        named.remove("grasps")
        named += ["tau", "contact-mm", "points", "rule", "shortest", "intervals"]  # the same of all, as of segment
    options = re.findall(r"^\W*(?:-h, )?--([a-z][a-z-]*)", out, re.MULTILINE)
    assert sorted(options) == sorted(["help", "debug", "quiet", "out", *named])
    assert positional.upper() in out
    assert DATASETS[name].__doc__.split()[0] in out


def test_an_unknown_dataset_is_refused_and_the_known_ones_are_named(run: Run) -> None:
    status, _, err = run("import", "arctik", "root", "--out", "x")
    assert status == 2
    assert all(name in err for name in DATASETS)


@pytest.mark.slow
def test_help_loads_no_reader() -> None:
    code = (
        "import sys\n"
        "from getagrip.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "loaded = {'numpy', 'getagrip.datasets', 'getagrip.hands'} & set(sys.modules)\n"
        "sys.exit(','.join(loaded) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_the_table_loads_no_compiler() -> None:
    """Or else ``getagrip import --help`` would wait for numba."""
    code = "import sys, getagrip.cli.imports\nsys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@dataclass(frozen=True)
class Shelf:
    """A part with four clips: the second is damaged, of the third nothing is left."""

    name: str
    handless: bool = False

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        for n in range(4):
            name = f"{self.name}-{n}"
            if missing(name, with_hands=not self.handless):
                yield Draft(name, partial(self.make, n, name, note))
        if self.name == "torn":
            raise InputError(self.name, "", "half a file", "a whole one")

    def make(self, n: int, name: str, note: Note) -> tuple[Clip, Masks | None] | None:
        clip, masks = small_clip()
        if n == 1:
            raise InputError(name, "", "a damaged file", "a whole one")
        if n == 2:
            note(f"{name}: nothing is visible: skipped")
            return None
        if self.handless:
            clip = replace(
                clip, hand=replace(clip.hand, vertices=clip.hand.vertices[:, :0], faces=clip.hand.faces[:0], regions={})
            )
        return replace(clip, name=name), masks


@dataclass(frozen=True, kw_only=True)
class Library(Dataset):
    parts_are = "shelves"

    shelves: tuple[Shelf, ...]

    def parts(self, note: Note) -> tuple[Shelf, ...]:
        return self.shelves

    def advice(self, made: object, handless: int) -> Iterator[str]:
        yield f"{handless} handless"


def test_the_trouble_of_a_clip_or_a_part_ends_no_other(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    library = Library(shelves=(Shelf("torn"), Shelf("fine")))
    (tmp_path / f"{leftovers.PREFIX}0" / "new").mkdir(parents=True)  # of a process that was killed
    assert import_clips(library, tmp_path, debug=False) == 1
    printed = capsys.readouterr()
    assert {folder.name for folder in tmp_path.iterdir()} == {"torn-0", "torn-3", "fine-0", "fine-3"}
    assert printed.out.splitlines()[-1] == "4 clips, 0 already there, 2 shelves failed"
    for words in (
        "failed: torn-1: torn-1: got a damaged file",
        "failed: torn: torn: got half a file",
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


def test_clips_in_memory_are_read_to_the_end_before_an_error_is_raised() -> None:
    notes: list[str] = []
    found = clips(Library(shelves=(Shelf("a"), Shelf("torn"))), notes.append)
    assert [next(found)[0].name for _ in range(2)] == ["a-0", "torn-0"]
    with pytest.raises(InputError, match="a-1"):
        next(found)
    assert any("torn-1" in note for note in notes)
