"""Where the clips of a benchmark come from, and which of them belong to a split."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import pytest

from getagrip.batch import engine
from getagrip.batch.scheduling import Limits, SchedulingOptions, Shard
from getagrip.bench.sources import read_clip_names, sample_clips
from getagrip.bench.sources.recorded import DexYcb, RecordedSource
from getagrip.bench.sources.source import ClipFolder
from getagrip.bench.sources.synthetic_clips import SyntheticSource
from getagrip.clip import write_clip
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.stable_grasps import grasp_lists
from helpers.environment import Library, Shelf
from helpers.scenes import SHORT, scene


def test_a_folder_of_synthetic_clips_belongs_to_one_preset(tmp_path: Path) -> None:
    clean, clips = SyntheticSource(), tmp_path / "clips"
    found, _ = sample_clips(clean, clips, None, debug=False)
    assert len({sample.name for sample in found}) == len(found) > 100
    assert not list(clips.glob("*/"))  # clips are made when they are needed
    assert len(sample_clips(clean, clips, 7, debug=False)[0]) == 7
    both = {sample.name for sample in sample_clips(replace(clean, split="all"), clips, None, debug=False)[0]}
    train = {sample.name for sample in sample_clips(replace(clean, split="train"), clips, None, debug=False)[0]}
    assert both - train == {sample.name for sample in found}
    two = frozenset({found[3].name, "teapot"})
    chosen, failed = sample_clips(SyntheticSource(only=two), clips, None, debug=False)
    assert [sample.name for sample in chosen] == [found[3].name]
    assert [(outcome.name, outcome.message) for outcome in failed] == [
        ("teapot", "no such clip of synthetic, clean, clips by name")
    ]
    with pytest.raises(UsageError, match="--split validation cannot be used with --only"):
        SyntheticSource(only=two, split="validation")
    with pytest.raises(UsageError, match="another dataset"):
        sample_clips(SyntheticSource(preset="wild"), clips, None, debug=False)


def test_a_folder_that_could_not_be_claimed_is_nobodys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty note would be a damaged file to every later call."""

    def torn(path: Path, _: object) -> None:
        path.write_text('{"dataset"')
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr("getagrip.io.files.write_json", torn)
        with pytest.raises(OSError, match="no space left"):
            SyntheticSource(preset="wild").claim(tmp_path)
    assert list(tmp_path.iterdir()) == []
    SyntheticSource().claim(tmp_path)
    with pytest.raises(UsageError, match="holds clips of another dataset"):
        SyntheticSource(preset="wild").claim(tmp_path)


def test_names_are_read_one_a_line(tmp_path: Path) -> None:
    path = tmp_path / "names.txt"
    path.write_text("b--1\r\n\n a \n")
    assert read_clip_names(path) == {"a", "b--1"}
    for text in ("", "a\n../b\n"):
        path.write_text(text)
        with pytest.raises(InputError, match="must be names of clips, one a line"):
            read_clip_names(path)


@dataclass(frozen=True, kw_only=True)
class Shelves(RecordedSource):
    dataset: ClassVar[str] = "shelves"

    def reader(self, root: Path) -> Library:
        return Library(shelves=(Shelf("s1--a--can"), Shelf("s1--b--can")))


def test_a_dataset_is_imported_first_which_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engine, "PROGRESS_LINE_INTERVAL_S", 0.0)
    source = Shelves(root=tmp_path, split="all")
    assert len(sample_clips(source, tmp_path / "clips", 1, debug=False)[0]) == 1
    said = capsys.readouterr().err
    assert said.startswith("shelves: all clips are imported first")
    assert "\n1 of 2 shelves, " in said
    assert "\n2 of 2 shelves, " in said


def test_an_import_is_shared_as_the_call_is_but_for_its_shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shares = list[SchedulingOptions]()

    def imported(*given: object) -> int:
        shares.extend(one for one in given if isinstance(one, SchedulingOptions))
        return 1

    monkeypatch.setattr("getagrip.batch.import_dataset.import_clips", imported)
    source = Shelves(root=tmp_path, split="all")
    of_call = SchedulingOptions(
        workers=2, engine="ray", limits=Limits(60.0), shard=Shard(2, 2), ledger=tmp_path, fail_fast=True
    )
    with pytest.raises(GetagripError, match="shelves: not all clips could be imported, and --fail-fast ends the call"):
        sample_clips(source, tmp_path / "clips", None, False, of_call)
    assert shares == [SchedulingOptions(workers=2, engine="ray", limits=Limits(60.0), fail_fast=True)]


def test_only_what_is_named_is_imported(tmp_path: Path) -> None:
    source = Shelves(root=tmp_path, only=frozenset({"s1--b--can-0"}))
    for _ in range(2):
        assert [sample.name for sample in sample_clips(source, tmp_path / "clips", None, debug=False)[0]] == [
            "s1--b--can-0"
        ]
        assert [path.parent.name for path in tmp_path.glob("clips/*/clip.json")] == ["s1--b--can-0"]


@pytest.mark.slow
def test_subjects_of_dexycb_are_split(tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    clip, masks = scene("can", 0, SHORT)
    for n in range(7):
        name = f"subject-{n}--sequence--can"
        write_clip(replace(clip, name=name), masks, folder / name)
    source = DexYcb(root=tmp_path)
    (folder / "imported").touch()  # as if from somewhere
    part = {
        which: [sample.name[8] for sample in sample_clips(replace(source, split=which), folder, None, debug=False)[0]]
        for which in ("train", "validation", "all")
    }
    assert part == {"train": list("036"), "validation": list("1245"), "all": list("0123456")}


def test_the_list_beside_clips_says_what_contact_is(tmp_path: Path) -> None:
    source = ClipFolder(folder=tmp_path)
    assert source.contact_mm == 10.0
    grasp_lists.write_listed_grasps(tmp_path / "grasps.json", [], {"contact": 0.0})
    assert source.contact_mm == 0.0
    grasp_lists.write_listed_grasps(tmp_path / "grasps.json", [], {"contact": "wide"})
    with pytest.raises(InputError, match=r"grasps\.json: cut\.contact"):
        _ = source.contact_mm
