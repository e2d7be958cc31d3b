"""The result on the page: steps after its findings, outlines over the footage, and a candidate that becomes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.checks import INPUT_CHECKS, RESULT_CHECKS
from getagrip.clip import input_sha256, write_clip
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.result import Reconstruction, SegmentResult, read_result, write_result
from getagrip.result.findings import Finding, Probability
from getagrip.studio.shown_result import (
    STEPS_OF_CHECKS,
    ResultOutlines,
    describe_result,
    largest_jump,
    take_candidate,
    trace_outlines,
)
from helpers.annotation import filled
from helpers.results import OFF, two_candidates

RESULT, CLIP, MASKS = two_candidates()


def stored(tmp_path: Path, result: Reconstruction = RESULT) -> Path:
    """The result in a folder beside its clip."""
    clip = tmp_path / "clips" / CLIP.name
    if not clip.is_dir():
        write_clip(CLIP, MASKS, clip)
    folder = tmp_path / "results" / CLIP.name
    return write_result(result, folder, input_sha256(clip), {}, clip, overwrite=folder.is_dir())


def described(tmp_path: Path, result: Reconstruction) -> dict[str, Any]:
    return describe_result(stored(tmp_path, result))


def finding(check: str, serious: bool = True) -> Finding:
    return Finding(check, serious, 1.0, 0.5, check)


def test_steps_are_of_checks_that_exist() -> None:
    assert STEPS_OF_CHECKS.keys() <= {*INPUT_CHECKS, *RESULT_CHECKS}


def test_each_finding_has_its_steps_and_the_serious_ones_are_next(tmp_path: Path) -> None:
    found = replace(RESULT, findings=(finding("mask-misfit", serious=False), finding("object-over-hand")))
    about = described(tmp_path, found)
    assert [[step["do"] for step in one["steps"]] for one in about["findings"]] == [
        ["candidate", "size"], ["draw", "mesh"],
    ]  # fmt: skip
    assert [step["do"] for step in about["steps"]] == ["candidate", "size"]
    worst = about["findings"][1]["steps"][0]["frames"]
    assert worst == [RESULT.frames[int(np.argmin(RESULT.iou))]]
    right = replace(found, findings=(), probability_right=Probability(0.97, ""))
    assert described(tmp_path, right)["steps"] == []
    unsure = replace(right, probability_right=None)
    assert [step["do"] for step in described(tmp_path, unsure)["steps"]] == ["candidate", "draw", "size"]
    one = replace(
        unsure.candidates, **{name: getattr(unsure.candidates, name)[:1] for name in ("T_hand_obj", "scale", "energy")}
    )
    alone = described(tmp_path, replace(unsure, candidates=one))
    assert [step["do"] for step in alone["steps"]] == ["draw", "size"]  # what cannot be done is not offered


@pytest.mark.parametrize(("at", "kept"), [(1, (2, 4)), (3, (0, 3))])
def test_a_regrasp_is_cut_where_the_object_jumps(tmp_path: Path, at: int, kept: tuple[int, int]) -> None:
    T = RESULT.T_hand_obj.copy()
    T[at + 1 :] = se3.rigid(np.eye(3), np.array([0.1, 0.0, 0.0])) @ T[at + 1 :]
    moved = replace(RESULT, T_hand_obj=T, findings=(finding("regrasp"),))
    assert largest_jump(moved) == (at, at + 1)
    (step,) = described(tmp_path, moved)["findings"][0]["steps"]
    assert step == {"do": "cut", "frames": [RESULT.frames[n] for n in kept]}


def test_what_was_guessed_is_named(tmp_path: Path) -> None:
    guessed = replace(RESULT, assumptions={"scale": "from the hand", "an_other": "so"})
    assert described(tmp_path, guessed)["guessed"] == {"the object's size": "from the hand", "an other": "so"}


def test_outlines_are_the_silhouettes_in_the_footage(tmp_path: Path) -> None:
    outlines, width = ResultOutlines(stored(tmp_path)), 2 * CLIP.size[0]
    for n, name in enumerate(RESULT.frames):
        lines = outlines.of(name, 0, width)
        shape = filled([(np.array(line) / 2.0).tolist() for line in lines["object"]], CLIP.size)
        seen, hidden = MASKS.object[n], MASKS.ignore[n]
        assert (shape & seen).sum() > 0.95 * seen.sum()
        assert (shape & ~seen & ~hidden).sum() < 0.05 * shape.sum()
        assert lines["hand"]
    result, moved = (np.vstack(outlines.of(RESULT.frames[0], rank, width)["object"]).mean(axis=0) for rank in (0, 1))
    assert np.linalg.norm(result - moved) > 5.0
    for name, rank in (("nothing", 0), (RESULT.frames[0], 2), (RESULT.frames[0], -1)):
        with pytest.raises(UsageError):
            outlines.of(name, rank, width)


def test_a_hole_has_an_outline_of_its_own() -> None:
    v, u = np.mgrid[:200, :200]
    distance = np.hypot(u - 100, v - 100)
    outside, hole = sorted(trace_outlines((distance < 80) & (distance > 40)), key=np.ptp, reverse=True)
    assert np.allclose(np.linalg.norm(outside - 100.5, axis=1), 80, atol=1.5)
    assert np.allclose(np.linalg.norm(hole - 100.5, axis=1), 40, atol=1.5)


def test_a_candidate_becomes_the_result_and_back(tmp_path: Path) -> None:
    """Its masks are compared and its findings are its own; no probability is calibrated for it."""
    sure = Probability(0.97, "")
    input_finding = finding("mesh-open", serious=False)
    folder = stored(
        tmp_path,
        replace(
            RESULT,
            findings=(input_finding, finding("mask-fit"), finding("depth-misfit"), finding("texture-contradicts")),
            probability_right=sure,
            probability_looks_right=sure,
            distance_interval_mm=(400.0, 500.0),
        ),
    )
    taken = take_candidate(folder, 1)
    read = read_result(folder)[0]
    assert read.distance_interval_mm is None, "it is that of the other pose"
    assert {one.check for one in read.findings}.isdisjoint({"depth-misfit", "texture-contradicts"})
    assert read.energy == {"total": RESULT.candidates.energy[1]}
    assert np.allclose(read.T_hand_obj, RESULT.candidates.T_hand_obj[1])
    assert np.allclose(read.candidates.T_hand_obj, RESULT.candidates.T_hand_obj[::-1])
    assert np.nanmean(read.iou) < 0.9  # it is off by
    assert OFF > 0.01
    assert read.probability_right is read.probability_right_in_camera is read.probability_looks_right is None
    assert input_finding in read.findings
    assert taken.notes[-1] == "candidate 2 of the fit was chosen by a person"
    take_candidate(folder, 1)
    back = read_result(folder)[0]
    assert np.allclose(back.T_hand_obj, RESULT.T_hand_obj)
    assert np.nanmean(back.iou) > np.nanmean(read.iou)
    assert "mask-fit" not in {one.check for one in back.findings}
    for rank in (0, 2):
        with pytest.raises(UsageError, match="no candidate"):
            take_candidate(folder, rank)


def test_a_timeline_has_no_candidates(tmp_path: Path) -> None:
    segment = SegmentResult(state="grasp", first=RESULT.frames[0], last=RESULT.frames[-1], side="right")
    folder = stored(tmp_path, replace(RESULT, segments=(segment,)))
    assert describe_result(folder)["candidates"] == 0
    with pytest.raises(UsageError, match="no candidate"):
        take_candidate(folder, 1)
