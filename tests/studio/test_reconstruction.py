"""What the page asks of a reconstruction, and the processes that make it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from getagrip.clip import read_clip, with_evidence, write_clip
from getagrip.clip.depth import DEPTH_KEY
from getagrip.errors import GetagripError, UsageError
from getagrip.readers.depth_files import DEPTH_FORMATS, DepthReader
from getagrip.result import FrameKind, write_result
from getagrip.studio import jobs
from getagrip.studio.jobs import (
    BackgroundJob,
    CancelledError,
    DepthFiles,
    NewClipCall,
    RequestedMesh,
    parse_requested_mesh,
    reconstruct_grasp_files,
)
from getagrip.studio.store.history import RefusedError
from helpers.clips import small_clip
from helpers.results import true_result


def new_clip(folder: Path) -> NewClipCall:
    """A call for a video that is missing."""
    files = {"hands": folder / "hand.npz", "masks": folder / "masks"}
    return NewClipCall(video=str(folder / "nothing.mp4"), interval=(1, 4), side="left", **files)


def test_what_the_page_says_of_the_mesh() -> None:
    assert parse_requested_mesh({"mesh": " plate ", "size_mm": None}) == RequestedMesh("plate", None)
    assert parse_requested_mesh({"mesh": "a b.obj", "size_mm": 180}) == RequestedMesh("a b.obj", 180.0)
    wrong: list[dict[str, Any]] = [
        {}, {"mesh": ""}, {"mesh": 3}, {"mesh": "--overwrite"}, {"mesh": "a\nb"}, {"mesh": 2000 * "x"},
        {"mesh": "plate", "size_mm": 0}, {"mesh": "plate", "size_mm": "180"}, {"mesh": "plate", "size_mm": True},
    ]  # fmt: skip
    for content in wrong:
        with pytest.raises(RefusedError):
            parse_requested_mesh(content)


@pytest.mark.slow
def test_a_command_that_fails_ends_it_with_its_words(tmp_path: Path) -> None:
    job = BackgroundJob("reconstruct")
    with pytest.raises(GetagripError, match=r"^.*nothing.mp4.*no such file"):
        reconstruct_grasp_files(new_clip(tmp_path), RequestedMesh("plate", None), tmp_path, "it", job)
    assert job.message == "making the clip"


@pytest.mark.parametrize(
    ("status", "printed", "said"),
    [
        (3, "getagrip: warning: no hand in 4 of 6 frames", "warning: no hand"),
        (1, "warning: one\ngetagrip: and another", "^warning: one; and another$"),
        (-9, "", "ended early"),
    ],
)
def test_what_lacks_something_is_made_and_errors_are_one_line(
    monkeypatch: pytest.MonkeyPatch, status: int, printed: str, said: str
) -> None:
    done = SimpleNamespace(returncode=status, communicate=lambda timeout: ("", printed))
    monkeypatch.setattr("getagrip.studio.jobs.subprocess.Popen", lambda *_, **__: done)
    if status == 3:
        assert said in jobs.run_command(["clip", "new"], BackgroundJob("reconstruct"))
    else:
        with pytest.raises(GetagripError, match=said):
            jobs.run_command(["clip", "new"], BackgroundJob("reconstruct"))


@pytest.mark.parametrize("name", [jobs.CLIPS_FOLDER, jobs.RESULTS_FOLDER])
def test_folders_that_are_links_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match="got a link"):
        reconstruct_grasp_files(
            new_clip(tmp_path), RequestedMesh("plate", None), tmp_path / "out", "it", BackgroundJob("reconstruct")
        )


def test_iou_of_a_result_that_may_not_read(tmp_path: Path) -> None:
    clip, _ = small_clip()
    result = replace(true_result(clip, None), iou=np.array([0.8, 0.4, 1.0]))
    written = write_result(result, tmp_path / "it", "", {}, tmp_path)
    assert jobs.iou_by_frame(written) == dict(zip(clip.frames, (0.8, 0.4, 1.0), strict=True))
    kind: tuple[FrameKind, ...] = ("sampled", "interpolated", "sampled")
    unknown = replace(result, iou=np.array([0.8, np.nan, 1.0]), frame_kind=kind)
    other = write_result(unknown, tmp_path / "other", "", {}, tmp_path)
    assert jobs.iou_by_frame(other) == {clip.frames[0]: 0.8, clip.frames[2]: 1.0}
    (written / "result.npz").write_bytes(b"PK nothing")
    assert jobs.iou_by_frame(written) == jobs.iou_by_frame(tmp_path / "nothing") == {}


def test_work_that_is_not_wanted_any_more_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "CANCEL_POLL_S", 0.001)
    job = BackgroundJob("reconstruct")
    job.stop.set()
    with pytest.raises(CancelledError):
        jobs.run_command(["doctor"], job)


@pytest.mark.parametrize(
    ("known", "wrong"), [((0, 3, 4, 6), ""), ((3, 4), "1 of 3 frames"), ((0,), "no depth image of any")]
)
def test_a_clip_takes_the_depth_of_its_own_frames(tmp_path: Path, known: tuple[int, ...], wrong: str) -> None:
    """They are some of a video's frames, at other places, with gaps between."""
    clip, masks = small_clip()
    folder = write_clip(clip, masks, tmp_path / "clip")
    frames = ("first", "second", "gap", clip.frames[0], clip.frames[1], "another", clip.frames[2])
    reader = DepthReader(lambda row: (tmp_path, np.full((24, 32), 500.0 + row), 0.001), known)
    said = DepthFiles(reader, frames, DEPTH_FORMATS["realsense"].source, "from here").add_to(folder)
    assert wrong in said if wrong else not said
    depth = with_evidence(read_clip(folder)).evidence[DEPTH_KEY]
    assert (depth is None) == (known == (0,))
    for n, row in enumerate((3, 4, 6)):
        if depth is not None:
            assert depth.image(n).max() == pytest.approx(0.5 + 0.001 * row if row in known else 0.0)
