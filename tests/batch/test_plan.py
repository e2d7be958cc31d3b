"""Which clips a call is about."""

from dataclasses import replace
from pathlib import Path

import pytest

from getagrip.batch.plan import OUR_FILES, Plan
from getagrip.clip import write_clip
from helpers.clips import small_clip


@pytest.mark.parametrize("name", OUR_FILES)
def test_no_clip_takes_the_place_of_a_file_beside_the_results(tmp_path: Path, name: str) -> None:
    clip, masks = small_clip()
    folders = [write_clip(replace(clip, name=of), masks, tmp_path / of) for of in (name, "mug")]
    with Plan(folders) as plan:
        assert [found for found, _ in plan] == ["mug"]
        (failed,) = plan.failed
        assert failed.name == name
        assert "name: got" in failed.message
