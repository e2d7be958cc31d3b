"""Which clips a call is about."""

import json
from pathlib import Path

import pytest

from getagrip.batch.plan import OUR_FILES, Plan


def clip(folder: Path, name: str) -> Path:
    folder.mkdir()
    (folder / "clip.json").write_text(json.dumps({"version": 3, "name": name}))
    return folder


@pytest.mark.parametrize("name", OUR_FILES)
def test_no_clip_takes_the_place_of_a_file_beside_the_results(tmp_path: Path, name: str) -> None:
    with Plan([clip(tmp_path / "a", name), clip(tmp_path / "b", "mug")]) as plan:
        assert [found for found, _ in plan] == ["mug"]
        (failed,) = plan.failed
        assert failed.name == name
        assert "name: got" in failed.message
