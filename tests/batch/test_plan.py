"""Which clips a call is about."""

from dataclasses import replace
from pathlib import Path

import pytest

from getagrip.batch.clips import RESERVED_NAMES, ClipPlan
from getagrip.clip import write_clip
from getagrip.errors import escape_unprintable
from helpers.clips import small_clip


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
