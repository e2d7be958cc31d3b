"""Laws of the distance's interval: it shrinks with every measure that is better known, and contains the result."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.bench.inputs.simulated_evidence import SimulatedDepth
from getagrip.clip import Clip, with_masks
from getagrip.errors import InputError
from getagrip.fitting.hand.joint_hand_object import with_hand_size
from getagrip.fitting.options import Options
from getagrip.fitting.stages.distance import distance_interval
from getagrip.geometry import se3
from getagrip.provenance import assumed, estimated
from getagrip.result import Reconstruction, read_result, write_result
from helpers.scenes import SMALL, scene

LIFTED, GUESSED = {"hands_scale": assumed("a mean hand's")}, {"mesh": assumed("a built-in mug")}


def true_result(clip: Clip) -> Reconstruction:
    assert clip.truth is not None
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    result = Reconstruction.external(clip.name, "truth", clip.frames, T)
    return replace(result, T_cam_hand=clip.truth.T_cam_hand)


def half_width(clip: Clip) -> float:
    """Half of the interval's width, as a ratio."""
    found = distance_interval(with_hand_size(clip, Options()), true_result(clip))
    assert found is not None
    return float(np.log(found[1] / found[0])) / 2.0


def test_better_known_sizes_make_it_narrower() -> None:
    clip, masks = scene("mug", 1, SMALL)
    clip = with_masks(clip, masks)
    seen = SimulatedDepth("realsense")(clip, masks, 0)[0].evidence
    shown, hands = clip.evidence, {"hands": estimated("a tracker")}
    unknown, guessed, stated, own, sensed = (
        half_width(replace(clip, provenance=known, scale=scale, evidence=evidence))
        for known, scale, evidence in (
            (LIFTED, "free", shown), (LIFTED | GUESSED, "free", shown), (LIFTED | GUESSED, "known", shown),
            (LIFTED, "known", shown), (LIFTED, "known", seen),
        )
    )  # fmt: skip
    assert unknown > guessed > stated > own > sensed
    measured, tracked = (half_width(replace(clip, provenance=known, scale="free")) for known in ({}, hands))
    assert unknown > tracked > measured
    guess = replace(clip, provenance=LIFTED | GUESSED)
    assert distance_interval(guess, true_result(clip)) == distance_interval(
        with_hand_size(guess, Options()), true_result(clip)
    )


def test_it_contains_the_result_and_needs_a_hand_in_the_camera() -> None:
    clip, _ = scene("mug", 1, SMALL)
    result = true_result(clip)
    assert clip.truth is not None
    low, high = distance_interval(clip, result) or (0.0, 0.0)
    centre = se3.transform(clip.truth.T_cam_obj, clip.mesh.centre[None])[:, 0]
    assert low < 1e3 * np.median(np.linalg.norm(centre, axis=1)) < high
    assert distance_interval(clip, replace(result, T_cam_hand=None)) is None


def test_files_keep_it_and_malformed_ones_are_refused(tmp_path: Path) -> None:
    clip, _ = scene("mug", 1, SMALL)
    result = replace(true_result(clip), distance_interval_mm=(480.0, 520.5), iou=np.ones(len(clip)))
    folder = write_result(result, tmp_path / "result")
    assert read_result(folder)[0].distance_interval_mm == (480.0, 520.5)
    record = json.loads((folder / "result.json").read_text())
    for wrong in ([1.0], [2.0, 1.0], "near", [None, 1.0], [-1.0, 1.0], [1.0, 1e12], {"low": 1.0}):
        (folder / "result.json").write_text(json.dumps(record | {"distance_interval_mm": wrong}))
        with pytest.raises(InputError, match="distance_interval_mm"):
            read_result(folder)
    del record["distance_interval_mm"]
    (folder / "result.json").write_text(json.dumps(record))
    assert read_result(folder)[0].distance_interval_mm is None
