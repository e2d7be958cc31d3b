"""Drafts of rendered videos: records round trip, order, tables; with true hands and masks the end is right."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from getagrip.bench.pixels import videos
from getagrip.bench.pixels.video_draft import ORACLES, Oracle, VideoDraft
from getagrip.bench.pixels.videos import PLAIN, VideoBenchmark, VideoScores, VideoTrial
from getagrip.bench.sources import Sample, sample_clips
from getagrip.bench.sources.rendered_videos import ORACLE_NAMES, RenderedVideos
from getagrip.cli.calls import run_call
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.io.files import Json
from getagrip.io.images import write_video
from getagrip.synthetic.filmed import FILM_SIZE_PX, filmed_clips, make_filmed_scene
from getagrip.synthetic.scene import render_pictures

OBJECT = {
    "right": True, "add_mm": 4.0, "add_percent": 4.0, "rotation_deg": 3.0, "along_mm": -6.0, "across_mm": 1.5,
}  # fmt: skip
SAID = {"in_camera": 0.7, "distance_interval_mm": [450.0, 520.0]}
RESULT = {"object": OBJECT, "candidates": [OBJECT], "mask_iou": 0.9, "said": SAID, "distance_mm": 500.0, "seconds": 5.0}
RECORD: Json = {
    "split": "train",
    "stages": {"hand_found": 1.0, "side_right": True, "landmarks_off": 0.05, "interval_off": [0, 2], "masks_iou": 0.9},
    "by": {PLAIN: RESULT, "masks": {"failure": "first mask: nothing stands out in the box", "seconds": 1.0}},
    "seconds": 30.0,
}


def trial(folder: Path, oracles: tuple[str, ...] = ("masks",)) -> VideoTrial:
    filmed = filmed_clips("train")[0]
    sample = Sample(filmed.name, folder / "clips" / filmed.name)
    return VideoTrial(sample, folder / "results", False, filmed, oracles, Options(), None, run_call)


def test_a_record_is_read_back_until_settings_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drafted = list[str]()

    def draft(one: VideoTrial, _: object) -> Json:
        drafted.append(one.name)
        return RECORD

    monkeypatch.setattr(videos, "_draft", draft)
    first = trial(tmp_path).scores()
    again = trial(tmp_path).scores()
    assert first == again
    assert (again.split, again.seconds, again.by["masks"]["seconds"]) == ("train", 30.0, 1.0)
    assert len(drafted) == 1
    other = trial(tmp_path, ("masks", "hands")).scores()
    assert (len(drafted), other.again) == (2, "the earlier result is of another clip")


def test_settings_share_the_draft_and_are_records_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    benchmark = VideoBenchmark(RenderedVideos(split="train"), Options(), (), run_call, "pixels")
    clip = filmed_clips("train")[0]
    (of_ablation,) = benchmark.trials([Sample(clip.name, tmp_path / "clips" / clip.name)], tmp_path / "results", False)
    assert isinstance(of_ablation, VideoTrial)
    assert of_ablation.results != trial(tmp_path).results
    assert of_ablation.settings["all of it"] == Options()
    tried = list[Options]()

    class Draft:
        """A draft whose fits are counted."""

        def __init__(self, *_: object) -> None:
            self.stages: Json = {}

        def solve(self, _: object, options: Options) -> Json:
            tried.append(options)
            return RESULT

    monkeypatch.setattr(videos, "write_rendered_video", lambda *_, **__: None)
    monkeypatch.setattr(videos, "VideoDraft", Draft)
    assert {*of_ablation.scores().by} == {PLAIN, *of_ablation.settings}
    assert tried == list(of_ablation.settings.values())


def test_an_ablation_compares_settings_of_the_same_drafts() -> None:
    benchmark = VideoBenchmark(RenderedVideos(), Options(), (), run_call, "pixels")
    one = {**RESULT, "iou": 0.95, "fit_seconds": 4.0, "object": {**OBJECT, "turned_deg": 3.0}}
    turned = {**one, "fit_seconds": 2.0, "object": {**OBJECT, "rotation_deg": 90.0, "turned_deg": 90.0}}
    failed: Json = {"failure": "nothing", "seconds": 1.0}
    drawn, scan = ({PLAIN: each, **dict.fromkeys(benchmark.settings, each)} for each in (failed, one))
    scan["none of them"] = turned
    stages = {"render_seconds": 10.0}
    page = benchmark.page(
        [
            VideoScores("a", split="train", stages=stages, by=drawn, seconds=20.0),
            VideoScores("b", split="train", stages=stages, by=scan, scanned=True, seconds=20.0),
        ]
    )
    assert page is not None
    assert [*page.texts] == ["pixels.md"]
    lines = [line for line in page.texts["pixels.md"].splitlines() if line.startswith("|")]
    head, _, *rows = [line.strip("| ").split(" | ") for line in lines]
    of = {row[1]: dict(zip(head, row, strict=True)) for row in rows}
    keys = "no result", "right but for distance, %", "gained", "lost", "facing right, %"
    assert [of["all of it"][key] for key in keys] == ["1", "50", "1", "0", "100"]
    assert [of["none of them"][key] for key in keys] == ["1", "0", "0", "0", "0"]
    assert [of[name]["CPU of the fit"] for name in ("all of it", "none of them")] == ["2.00", "1.00"]
    assert of["all of it"]["CPU of the draft"] == "1.25"


def test_ablations_of_other_things_than_options_are_refused() -> None:
    for name in ("hand-noise", "departures", "sca", "luck"):
        with pytest.raises(UsageError, match="--ablation"):
            VideoBenchmark(RenderedVideos(), Options(), (), run_call, name)
    with pytest.raises(UsageError, match="--oracle"):
        VideoBenchmark(RenderedVideos(), Options(), ("masks",), run_call, "inits")


def test_the_first_clips_are_taken(tmp_path: Path) -> None:
    source = RenderedVideos(split="validation")
    found, bad = sample_clips(source, tmp_path, 7, debug=False)
    assert not bad
    assert [sample.name for sample in found] == [clip.name for clip in filmed_clips("validation")[:7]]
    both = [clip.split for clip in RenderedVideos(split="all").filmed()[:14]]
    assert {*both} == {"train", "validation"}


def test_an_unknown_oracle_and_a_folder_without_scans_are_refused(tmp_path: Path) -> None:
    assert tuple(ORACLES) == ORACLE_NAMES
    with pytest.raises(UsageError, match="--oracle"):
        VideoBenchmark(RenderedVideos(), Options(), ("luck",), run_call)
    with pytest.raises(UsageError, match=r"no \.obj file"):
        RenderedVideos(meshes=tmp_path).filmed()


def test_a_failure_counts_as_wrong_in_the_tables() -> None:
    benchmark = VideoBenchmark(RenderedVideos(), Options(), ("masks",), run_call)
    fields = {key: RECORD[key] for key in ("split", "stages", "by", "seconds")}
    failed = VideoScores("c", failure="no video", split="train")
    wrong = {**RESULT, "object": {**OBJECT, "right": False}}
    scores = [
        VideoScores("a", **fields),
        replace(VideoScores("b", **fields), by={**RECORD["by"], PLAIN: wrong}),
        failed,
    ]
    page = benchmark.page(scores)
    assert page is not None
    stages, oracles = (
        [line.strip("| ").split(" | ") for line in page.texts[name].splitlines() if line.startswith("|")]
        for name in ("stages.md", "oracles.md")
    )
    of = dict(zip(stages[0], stages[2], strict=True))
    columns = "videos", "hand found, %", "right kept, %", "right first, %"
    assert [of[key] for key in columns] == ["2", "100", "100", "50"]
    rows = [dict(zip(oracles[0], row, strict=True)) for row in oracles[2:]]
    keys = "truth in place of", "no result", "right, %", "right but for distance, %", "interval holds, %"
    assert [tuple(row[key] for key in keys) for row in rows] == [
        ("nothing", "0", "50", "100", "100"), ("masks", "2", "0", "0", "–"),
    ]  # fmt: skip
    assert benchmark.page([failed]) is None


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", ["mug-300000", "box-300000"])
def test_true_hands_and_masks_end_right(tmp_path: Path, name: str) -> None:
    """Shape and size are not the object's own: what is left is the error of the fit."""
    filmed = next(clip for clip in filmed_clips("train") if clip.name == name)
    scene, _ = make_filmed_scene(filmed)
    video = tmp_path / "video.mp4"
    write_video(video, render_pictures(scene), Fraction(15), FILM_SIZE_PX)
    draft = VideoDraft(filmed, scene, video, tmp_path, None, run_call)
    errors = draft.solve(ORACLES["masks+hands"], Options())
    assert errors["object"]["right"], errors["object"]
    assert errors["mask_iou"] == 1.0
    assert errors["hand_found"]["joints_mm"] < 1e-6
    assert errors["frames"] == 24
    assert Oracle() not in ORACLES.values()
