"""The probability of being right, and keeping results by it: where it exists, its fit, and its promises."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.kept import HEADER, calibrated, lines, of_part
from benchmarks.kept_rows import END, REAL, SYNTHETIC, Row, read
from benchmarks.pixel_probability import HEADER as DRAFT_HEADER
from benchmarks.pixel_probability import Results as DraftResults
from benchmarks.pixel_probability import calibrated as calibrated_drafts
from benchmarks.pixel_probability import lines as draft_lines
from benchmarks.pixel_probability import read_rows
from benchmarks.probability import Results, judged, stored, thresholds, write
from benchmarks.reliability import auroc, auroc_interval, bins, calibration_error, fit_weights, least_error
from benchmarks.signed_results import ALWAYS
from getagrip.batch.scheduling import MAX_KEEP_SHARE, MIN_KEEP_SHARE, KeepOptions
from getagrip.bench.comparison import bootstrap_resamples
from getagrip.checks.calibration import (
    CALIBRATION_FILE,
    CALIBRATIONS,
    CORRECTED_CALIBRATIONS,
    ESTIMATED_CALIBRATIONS,
    KEEP_SHARES,
    KEEP_THRESHOLDS,
    LIFTED_CALIBRATIONS,
    LIFTED_KINDS,
    POSE_FRAMES,
    KeepThresholds,
    candidate_set_thresholds,
    keep_threshold,
    kind_of_input,
    read_calibrations,
    sigmoid,
)
from getagrip.checks.features import FEATURES, HAND_FEATURES, LIFTED_FEATURES
from getagrip.clip import Clip
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.fitting.stages.confidence import (
    UNCALIBRATED_DEPTH_FINDINGS,
    probabilities,
    probability_right,
    uncalibrated_reason,
    was_lifted,
)
from getagrip.provenance import Source, assumed, estimated, kind_of_hands, measured
from getagrip.result.findings import Finding, Probability, describe_looks, format_probability
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

DIRECTION = {sign.name: sign.direction for sign in FEATURES}
USUAL = {name: 0.5 * (weight.low + weight.high) for name, weight in CALIBRATIONS["soft-hinge", "hand"].weights.items()}
SERIOUS = Finding("frame-order", True, 3.0, 2.5, "in another order")


@pytest.mark.parametrize(
    ("options", "findings", "why"),
    [
        (Options(method="one-dof"), (), "none is calibrated for one-dof"),
        (Options(method="static"), (), "none is calibrated for static"),
        (Options(inits=10), (), "none is calibrated for fewer than 50 initial poses"),
        (Options(push=0.5), (), "none is calibrated with push 0.5"),
        (Options(hands="as-given"), (), "none is calibrated with hands as-given"),
        (Options(), (SERIOUS,), "a finding is serious"),
    ],
)
def test_there_is_none_where_nothing_is_calibrated(options: Options, findings: tuple[Finding, ...], why: str) -> None:
    assert uncalibrated_reason(options, findings) == why
    assert probability_right(options, USUAL, findings) is None
    assert probability_right(options, USUAL, findings, "camera") is None


@pytest.mark.parametrize("options", [Options(), Options(seed=3), Options(inits=200), Options(frames=10)])
def test_there_is_one_with_the_usual_energy(options: Options) -> None:
    note = replace(SERIOUS, serious=False)
    assert uncalibrated_reason(options, (note,)) == ""
    assert uncalibrated_reason(options, (note, replace(SERIOUS, check="mask-fit"))) == "a finding is serious"
    assert probability_right(options, USUAL, (note,)) == CALIBRATIONS["soft-hinge", "hand"].probability(USUAL)


def test_what_is_worse_than_in_training_is_said_to_be_extrapolated() -> None:
    calibration = CALIBRATIONS["soft-hinge", "hand"]
    worst = {name: -1e3 * DIRECTION[name] for name in USUAL}
    assert calibration.probability(USUAL).beyond == ()
    assert {*calibration.probability(worst).beyond} == {name for name, w in calibration.weights.items() if w.weight}
    assert calibration.probability({name: -value for name, value in worst.items()}).beyond == ()
    one = calibration.probability(USUAL | {"mask-misfit": worst["mask-misfit"]})
    assert str(one).endswith("(extrapolated: mask-misfit)") is bool(calibration.weights["mask-misfit"].weight)


@pytest.mark.parametrize(
    ("value", "words"), [(0.0, "< 1 %"), (0.009, "< 1 %"), (0.01, "1 %"), (0.99, "99 %"), (0.995, "> 99 %")]
)
def test_nothing_is_said_to_be_sure(value: float, words: str) -> None:
    assert format_probability(value) == str(Probability(value, "")) == words


def test_the_calibration_says_on_what_it_was_made() -> None:
    calibration = CALIBRATIONS["soft-hinge", "hand"]
    assert calibration.weights.keys() == DIRECTION.keys()
    assert calibration.data in calibration.probability(USUAL).meaning
    assert "10 % of the diameter" in calibration.probability(USUAL).meaning
    assert "in the hand" in calibration.probability(USUAL).meaning


def test_each_where_has_its_own_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    in_camera = replace(CALIBRATIONS["soft-hinge", "hand"], where="camera", bias=1.0)
    monkeypatch.setitem(CALIBRATIONS, ("soft-hinge", "camera"), in_camera)
    found = probability_right(Options(), USUAL, (), "camera")
    assert found == in_camera.probability(USUAL) != probability_right(Options(), USUAL, ())
    assert found is not None
    assert "in the camera" in found.meaning
    monkeypatch.delitem(CALIBRATIONS, ("soft-hinge", "camera"))
    assert probability_right(Options(), USUAL, (), "camera") is None


def results(n: int = 60) -> list[Row]:
    """Results that are right in the hand by the first sign, and in the camera by the second."""
    numbers = np.random.default_rng(0).normal(size=(n, len(FEATURES)))
    return [
        {
            "clip": f"{k}", "category": f"object {k % 5}", "dataset": "DexYCB", "kind": "measured",
            "condition": [*ALWAYS][k % len(ALWAYS)],
            "rank": {"hand": 1 if x[0] > 0.0 else None, "camera": 1 if x[1] < 0.0 else 2},
            "signs": dict(zip((sign.name for sign in FEATURES), x.tolist(), strict=True)),
        }
        for k, x in enumerate(numbers)
    ]  # fmt: skip


def test_both_are_fitted_to_the_same_results_and_read_back(tmp_path: Path) -> None:
    fitted = [Results(results(), where).fitted("today") for where in POSE_FRAMES]
    write(path := Path(shutil.copy(CALIBRATION_FILE, tmp_path)), measured=stored(one["measured"] for one in fitted))
    back = read_calibrations(path)[0]
    assert [*back] == [("soft-hinge", "hand"), ("soft-hinge", "camera")]
    first, second = (sign.name for sign in FEATURES[:2])
    for there, fit in zip(back.values(), fitted, strict=True):
        made = fit["measured"]
        assert (there.where, there.data) == (made.where, made.data)
        assert there.probability(USUAL).value == pytest.approx(made.probability(USUAL).value, abs=1e-3)
        strongest = max(made.weights, key=lambda name: abs(made.weights[name].weight))
        assert strongest == {"hand": first, "camera": second}[made.where]


def test_no_object_s_probability_comes_from_its_own_results() -> None:
    rows = results(300)
    own = [row["category"] == "object 0" for row in rows]
    turned = [row | {"rank": {"hand": None}} if mine else row for row, mine in zip(rows, own, strict=True)]
    before, after = (judged(Results(some)) for some in (rows, turned))
    assert np.array_equal(before.probability[own], after.probability[own])
    assert np.array_equal(before.kept[own], after.kept[own])
    others = ~np.array(own)
    assert not np.array_equal(before.probability[others], after.probability[others])


def test_thresholds_of_measured_hands_hold_at_every_level_of_their_errors() -> None:
    rows = [row | {"kind": "corrected"} for row in results(600)]
    p = np.array([1.0 / (1.0 + np.exp(-3.0 * row["signs"]["energy-gap"])) for row in rows])
    worse = [row | {"rank": {"hand": None}} if row["condition"] == "strong" and p[k] < 0.97 else row
             for k, row in enumerate(rows)]  # fmt: skip
    usual, careful = (thresholds(Results(some), p)["corrected"] for some in (rows, worse))
    assert {0.5, 0.9} <= careful.least.keys() <= usual.least.keys()
    assert all(careful.least[share] > usual.least[share] for share in careful.least)
    every = Results(worse)
    for kind in ALWAYS:
        mine = np.array([row["condition"] == kind for row in worse])
        for share, least in careful.least.items():
            assert every.right[mine & (p >= least)].mean() >= share


def test_an_assumed_mesh_extrapolates_the_probability_of_estimated_hands() -> None:
    clip, _ = synthesise("box", 0, SceneOptions(frames=3))
    weights = ESTIMATED_CALIBRATIONS["soft-hinge", "hand"].weights
    best = {name: weight.high if weight.weight > 0.0 else weight.low for name, weight in weights.items()}
    hands = estimated("by a network")
    said = {
        basis: replace(clip, provenance={"hands": hands, "mesh": Source("a box", basis)})
        for basis in ("measured", "assumed")
    }
    right = {basis: probabilities(one, Options(), best, (), ())["hand"] for basis, one in said.items()}
    assert right["measured"] is not None
    assert right["assumed"] is not None
    assert right["measured"].value == right["assumed"].value
    assert (right["measured"].beyond, right["assumed"].beyond) == ((), ("assumed mesh",))
    assert right["measured"].keep > right["assumed"].keep == 0.0
    assert (right["measured"].by_eye, right["assumed"].by_eye) == ("", "probably looks right")
    assert replace(right["assumed"], value=0.01).by_eye == "probably looks wrong"


@pytest.mark.parametrize("check", UNCALIBRATED_DEPTH_FINDINGS)
def test_nothing_is_promised_of_results_with_wrong_evidence(check: str) -> None:
    clip, _ = synthesise("box", 0, SceneOptions(frames=3))
    clip = replace(clip, provenance={"hands": estimated("by a network")})
    weights = ESTIMATED_CALIBRATIONS["soft-hinge", "hand"].weights
    best = {name: weight.high if weight.weight > 0.0 else weight.low for name, weight in weights.items()}
    found = Finding(check, False, 3.0, 1.6, "depth is off")
    before, after = (probabilities(clip, Options(), best, some, {"depth"})["hand"] for some in ((), (found,)))
    assert before is not None
    assert after is not None
    assert before.keep >= 0.95
    assert (after.value, after.keep, after.beyond) == (before.value, 0.0, (check,))


SIGN_NAMES = (*CALIBRATIONS["soft-hinge", "hand"].weights, *(sign.name for sign in HAND_FEATURES))


def drawn(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities, and what is right with three quarters of them: an overconfident judge."""
    rng = np.random.default_rng(seed)
    p = rng.random(n)
    return p, rng.random(n) < np.where(p > 0.8, 0.99, 0.75 * p)


@pytest.mark.parametrize("share", [0.7, 0.9, 0.95])
def test_of_new_results_that_are_kept_the_share_is_right(share: float) -> None:
    of_kept, kept_at_all = [], 0
    for seed in range(60):
        least = keep_threshold(*drawn(300, seed), share)
        p, right = drawn(4000, 1000 + seed)
        of_kept += [right[p >= least].mean()] if np.isfinite(least) else []
        kept_at_all += np.isfinite(least)
    assert np.mean(of_kept) > share - 0.01
    assert kept_at_all > 50, "an empty promise keeps nothing"


@given(st.integers(0, 1000), st.floats(0.5, 0.98), st.floats(0.0, 0.2))
def test_a_larger_share_keeps_fewer(seed: int, share: float, more: float) -> None:
    p, right = drawn(40, seed)
    assert keep_threshold(p, right, share) <= keep_threshold(p, right, share + more)


@given(st.lists(st.booleans(), min_size=1, max_size=30))
def test_the_threshold_keeps_its_promise_where_it_was_chosen(right: list[bool]) -> None:
    rights, p = np.array(right), np.linspace(0.0, 1.0, len(right)).round(1)  # some are alike
    least = keep_threshold(p, rights, 0.8)
    assert np.isinf(least) or np.mean(rights[p >= least]) >= 0.8


def test_nothing_is_kept_where_nothing_is_sure() -> None:
    p, right = drawn(300, 0)
    assert np.isinf(keep_threshold(p, np.zeros(300, dtype=bool), 0.5))
    assert np.isinf(keep_threshold(p, np.random.default_rng(0).random(300) < 0.7, 0.95))
    assert np.isinf(keep_threshold(p[:18], right[:18] | True, 0.95)), "eighteen are too few to promise 95 %"
    kept = KeepThresholds({}, candidate_set_thresholds(p, np.full(300, np.inf), 0.9)).applied(Probability(0.99, ""))
    assert (kept.keep, kept.candidates) == (0.0, 0)


def ranked(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities, and which candidate is right: the less probable the first, the farther down, or none is."""
    rng = np.random.default_rng(seed)
    p = rng.random(n)
    rank = np.ceil(rng.exponential(3.0 * (1.0 - p)))
    return p, np.where(rank > 7.0, np.inf, np.maximum(rank, 1.0))


def test_sets_hold_the_right_candidate_of_new_results() -> None:
    held, of = np.zeros(8), np.zeros(8)
    for seed in range(100):
        keeping = KeepThresholds({}, candidate_set_thresholds(*ranked(200, seed), 0.9))
        p, rank = ranked(1000, 1000 + seed)
        size = np.array([keeping.applied(Probability(x, "")).candidates for x in p.tolist()])
        held += np.bincount(size, rank <= size, minlength=8)
        of += np.bincount(size, minlength=8)
    assert 0.895 < held[1:].sum() / of[1:].sum() < 0.93
    assert (held[1:] >= 0.85 * of[1:]).all(), "by themselves, small groups are a little worse"
    assert np.count_nonzero(of[1:]) == 5


@given(st.integers(0, 1000))
def test_the_more_probable_a_result_is_the_smaller_is_its_set(seed: int) -> None:
    sets = candidate_set_thresholds(*ranked(80, seed), 0.9)
    assert [*sets] == sorted(sets)
    assert [*sets.values()] == sorted(sets.values(), reverse=True)


def test_a_result_is_kept_for_the_largest_share_that_its_probability_reaches() -> None:
    keeping = KeepThresholds({0.8: 0.5, 0.9: 0.7}, {1: 0.72, 3: 0.5})
    found = [keeping.applied(Probability(p, "")) for p in (0.4, 0.55, 0.75)]
    assert [one.keep for one in found] == [0.0, 0.8, 0.9]
    assert [one.candidates for one in found] == [0, 3, 1]


def test_marks_say_kept_or_dropped_and_nothing_where_none_is_asked_for() -> None:
    sure, unsure = Probability(0.9, "", keep=0.95), Probability(0.9, "", keep=0.8)
    assert KeepOptions().verdict(sure, None) == ""
    keep = KeepOptions(0.95)
    verdicts = {name: keep.verdict(one, None) for name, one in {"a": sure, "b": unsure, "c": None}.items()}
    assert verdicts == {"a": "kept", "b": "dropped", "c": "dropped"}
    assert keep.summary(verdicts).endswith("right in the hand; dropped: b, c")
    assert "1 of 3 (33 %) are kept" in keep.summary(verdicts)
    assert keep.summary({f"{n:02d}": "dropped" for n in range(55)}).endswith("18, 19 and 35 more")
    assert KeepOptions(0.95, "camera").verdict(unsure, sure) == "kept"
    for share in (0.49, 0.99, -1.0):
        with pytest.raises(UsageError, match=r"--keep must be 0.5 to 0.98"):
            KeepOptions(share)
    assert (min(KEEP_SHARES), max(KEEP_SHARES)) == (MIN_KEEP_SHARE, MAX_KEEP_SHARE)


def test_hands_are_measured_unless_their_source_says_otherwise() -> None:
    assert (
        kind_of_hands({})
        == kind_of_hands({"hands": measured("mocap")})
        == kind_of_hands({"hands": "mocap"})
        == "measured"
    )
    assert (
        kind_of_hands({"hands": estimated("a network")}) == kind_of_hands({"hands": assumed("a guess")}) == "estimated"
    )


def test_the_kind_of_an_input_is_that_of_its_hands_and_of_the_evidence_that_counted() -> None:
    terms = {"total", "mask", "hand-mask"}
    assert kind_of_input("measured", terms | {"depth", "joints-2d"}, 2.0) == "measured"
    assert kind_of_input("measured", terms, 0.0, corrected=True) == "corrected"
    assert kind_of_input("estimated", terms, 0.0, corrected=True) == "estimated"
    assert kind_of_input("estimated", terms, 2.0) == "estimated", "depth that did not count"
    assert kind_of_input("estimated", terms | {"joints-2d"}, 0.0) == "joints"
    for sign, kind in ((1.0, "network"), (2.0, "sensor")):
        assert kind_of_input("estimated", terms | {"joints-2d", "depth"}, sign) == kind
        assert kind_of_input("estimated", {"depth"}, sign) == kind


def test_lifted_hands_are_a_kind_of_their_own() -> None:
    terms = {"total", "mask", "joints-2d"}
    assert kind_of_input("estimated", terms, 0.0, lifted=True) == "lifted"
    assert kind_of_input("estimated", terms, 2.0, lifted=True) == "lifted", "depth that did not count"
    assert kind_of_input("estimated", terms | {"depth"}, 2.0, lifted=True) == "lifted-sensor"
    assert kind_of_input("estimated", terms | {"depth"}, 2.0, lifted=True, shape_assumed=True) == "lifted-shape"
    assert kind_of_input("measured", terms, 0.0, lifted=True) == "measured"


def lifted_clip(mesh: Source) -> Clip:
    """A clip whose hands were lifted from 2D joints."""
    clip, _ = synthesise("box", 0, SceneOptions(frames=3))
    seen = np.full((3, 21, 2), 50.0)
    hand = replace(clip.hand, joints_2d=seen, joints_2d_confidence=np.ones((3, 21)))
    known = {"hands": estimated("by a network"), "hands_scale": assumed("a mean hand's"), "mesh": mesh}
    return replace(clip, hand=hand, provenance=known)


def test_a_draft_is_told_how_probably_it_looks_right_also_with_an_assumed_mesh() -> None:
    assert was_lifted(lifted_clip(measured("its own")))
    assert not was_lifted(replace(lifted_clip(measured("its own")), provenance={"hands": estimated("by a network")}))
    weights = LIFTED_CALIBRATIONS["soft-hinge", "image"].weights
    best = {name: weight.high if weight.weight > 0.0 else weight.low for name, weight in weights.items()}
    found = probabilities(lifted_clip(assumed("a box")), Options(), best, (), ())
    for right in found.values():
        assert right is not None
        assert "assumed mesh" not in right.beyond
    assert found["image"] is not None
    assert "distance does not count" in found["image"].meaning
    other = probabilities(replace(lifted_clip(assumed("a box")), provenance={}), Options(), best, (), ())
    assert other["image"] is None, "calibrated for lifted hands only"


def test_an_opening_that_points_away_forbids_to_look_right() -> None:
    weights = LIFTED_CALIBRATIONS["soft-hinge", "image"].weights
    best = {name: weight.high if weight.weight > 0.0 else weight.low for name, weight in weights.items()}
    clip, away = lifted_clip(assumed("a bowl")), Finding("opening-away", False, 27.0, 15.0, "the opening points away")
    before, after = (probabilities(clip, Options(), best, some, ()) for some in ((), (away,)))
    assert describe_looks(None, before["image"]).startswith("probably looks right")
    assert describe_looks(None, after["image"]).startswith("probably looks wrong")
    assert after["image"] is not None
    assert (after["image"].keep, after["image"].beyond[0]) == (0.0, "opening-away")
    assert (before["hand"], before["camera"]) == (after["hand"], after["camera"])


def test_looks_follow_the_probability_that_it_looks_right() -> None:
    extrapolated = Probability(0.5, "", ("assumed mesh",))
    assert describe_looks(None, None) == describe_looks(Probability(0.5, ""), None) == ""
    assert describe_looks(extrapolated, None) == "probably looks right"
    assert describe_looks(extrapolated, Probability(0.3, "")) == "probably looks wrong (30 %)"
    assert describe_looks(None, Probability(0.73, "")) == "probably looks right (73 %)"
    worse = Probability(0.73, "", ("mask-misfit", "contact-gap"))
    assert describe_looks(None, worse) == "probably looks right (73 %, extrapolated: mask-misfit, contact-gap)"


def draft_record(folder: Path, name: str, split: str, gap: float, right: bool, interval: tuple[float, float]) -> None:
    """Write a record of ``bench video`` with three drafts of alike signs."""
    one = {"right": right, "add_mm": 5.0, "add_percent": 5.0, "rotation_deg": 3.0 if right else 60.0, "across_mm": 1.0}
    by = {}
    for draft, level, shape in (("draft", 0.0, 1.0), ("mesh", 0.0, 0.0), ("mesh+depth", 2.0, 0.0)):
        signs = {sign.name: 0.0 for sign in LIFTED_FEATURES}
        signs |= {"energy-gap": gap, "depth-images": level, "shape-assumed": shape}
        said = {"signs": signs, "serious": [], "distance_interval_mm": interval}
        by[draft] = {"candidates": [one], "right_in_hand": [right], "said": said, "distance_mm": 500.0}
    (folder / "results").mkdir(exist_ok=True)
    (folder / "results" / f"{name}.json").write_text(json.dumps({"split": split, "by": by}))


def test_drafts_of_videos_calibrate_their_own_kinds(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for n in range(150):
        gap = float(rng.random())
        right = bool(rng.random() < 1.0 / (1.0 + np.exp(-12.0 * (gap - 0.4))))
        split, held = ("train", "train", "validation")[n % 3], (450.0, 550.0 if n % 10 else 460.0)
        draft_record(tmp_path, f"kind{n % 7}-{n}", split, gap, right, held)
    rows = read_rows(tmp_path)
    assert len(rows) == 450
    assert {row["kind"] for row in rows} == {*LIFTED_KINDS}
    train, test = ([row for row in rows if row["part"] == part] for part in ("train", "validation"))
    fit, least, p = calibrated_drafts(train, "image", "today")
    assert fit.weights["energy-gap"].weight > 0.0
    assert least["lifted"].least[0.9] > 0.5
    assert len(p) == len(train)
    results = DraftResults(test, "image")
    table = [*draft_lines("validation", results, results.probability({"estimated": fit}), least)]
    assert [line[0] for line in table] == [f"validation, {kind}" for kind in (*LIFTED_KINDS, "all")]
    made = dict(zip(DRAFT_HEADER, table[-1][1:], strict=True))
    assert float(made["AUROC"]) > 0.75
    assert float(made["right of kept, %"]) >= 85.0
    assert made["intervals that hold the distance, %"] == "90"


def test_rows_that_were_cut_off_count_as_missing(tmp_path: Path) -> None:
    whole = "".join(f'\n{{"a": {{"n": {n}}}}}{END}' for n in range(3))
    file = tmp_path / "rows.jsonl"
    for cut in range(len(whole) + 1):
        file.write_text(whole[:cut] + whole, encoding="utf-8")
        found = [row["a"]["n"] for row in read(file)]
        assert found == [*range(whole[:cut].count(END)), 0, 1, 2]
    assert read(tmp_path / "none") == []


def made_rows(n: int, seed: int) -> list[Row]:
    """Rows whose first sign says how probable a right result is, and the fewer candidates hold it the less it is."""
    rng = np.random.default_rng(seed)
    kinds = "measured", "estimated", "joints", "network", "sensor"
    rows = []
    for k in range(n):
        signs = dict(zip(SIGN_NAMES, rng.normal(size=len(SIGN_NAMES)), strict=True))
        kind, odds = kinds[k % 5], 3.0 * signs["energy-gap"] + 2.0
        rank = None if rng.random() < 0.03 else 1 if rng.random() < 1.0 / (1.0 + np.exp(-odds)) else 3
        rows.append({
            "clip": f"{k % 30}", "category": f"{k % 7}", "part": ("train", "train", "validation")[k // 5 % 3],
            "condition": kind, "kind": kind, "serious": [], "made": "today", "signs": signs,
            "rank": {"hand": rank, "camera": rank},
        })  # fmt: skip
    return rows


def test_what_was_calibrated_is_written_and_held_against_validation(tmp_path: Path) -> None:
    rows = made_rows(900, 0)
    estimated, keeping = calibrated(rows, "today")
    path = Path(shutil.copy(CALIBRATION_FILE, tmp_path))
    write(path, keeping, estimated=stored(estimated.values()))
    exact, corrected, fitted, _, least = read_calibrations(path)
    assert (exact, corrected) == (CALIBRATIONS, CORRECTED_CALIBRATIONS)
    assert least.keys() == KEEP_THRESHOLDS.keys()
    assert all(least["measured", where] == KEEP_THRESHOLDS["measured", where] for where in estimated), (
        "these are not its"
    )
    assert least["joints", "hand"].sets == pytest.approx(keeping["joints", "hand"].sets, rel=1e-3)
    for where in estimated:
        found = [one.probability(rows[1]["signs"]).value for one in (fitted["soft-hinge", where], estimated[where])]
        assert found[0] == pytest.approx(found[1], abs=1e-3)
    table = [
        dict(zip(("label", *HEADER), line, strict=True)) for line in lines(rows, estimated, KEEP_THRESHOLDS | keeping)
    ]
    depth = next(line for line in table if line["label"] == "validation, in the hand, network")
    assert float(depth["AUROC"].split()[0]) > 0.75
    assert float(depth["sets that hold it, %"].split()[0]) > 80.0


def test_real_hands_are_training_results_too_but_not_in_the_camera() -> None:
    simulated = [row for row in made_rows(600, 0) if row["part"] == "train" and row["kind"] != "measured"]
    real = [row | {"part": REAL} for row in made_rows(600, 4) if row["kind"] != "measured"]
    wrong = [row | {"rank": {"hand": None, "camera": None}} for row in real]
    for share in (0.8, 0.95):
        least = []
        for more in ([], real, wrong):
            of = of_part([*simulated, *more], "train", "hand")
            p = np.array([1.0 / (1.0 + np.exp(-row["signs"]["energy-gap"])) for row in of.rows])
            least.append(of.keeping(p).least.get(share, np.inf))
            assert np.isinf(least[-1]) or of.right[p >= least[-1]].mean() >= share
        assert max(least[:2]) < least[2], "wrong real ones raise it"
    assert len(of_part([*simulated, *real], "train", "hand").rows) == len(simulated) + len(real)
    assert of_part([*simulated, *real], "train", "camera").rows == simulated, "their camera is assumed"


def test_synthetic_results_move_weights_but_not_how_often_results_are_right() -> None:
    rows = [row for row in made_rows(300, 0) if row["part"] == "train" and row["kind"] != "measured"]
    more = [row | {"part": SYNTHETIC, "rank": {"hand": 1, "camera": 1}} for row in made_rows(600, 1)]
    more += [row | {"part": SYNTHETIC} for row in made_rows(300, 2)]
    alone, beside = (of_part([*rows, *some], "train", "hand") for some in ([], more))
    assert len(beside.rows) == len(rows), "they are fitted only"
    fitted = beside.fitted("")
    assert beside.probability(fitted).mean() == pytest.approx(beside.right.mean(), abs=0.01)
    one, other = (fit["estimated"].weights["energy-gap"].weight for fit in (fitted, alone.fitted("")))
    assert one != other


def test_the_fit_finds_what_drew_the_labels() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4000, 3))
    right = rng.random(4000) < sigmoid(0.5 + x @ np.array([2.0, -1.0, 0.0]))
    weights, bias = fit_weights(x, right, (1, -1, 0))
    assert [w.weight for w in weights] == pytest.approx([2.0, -1.0, 0.0], abs=0.2)
    assert bias == pytest.approx(0.5, abs=0.15)


def test_a_sign_of_the_wrong_direction_counts_nothing() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(500, 2))
    right = rng.random(500) < sigmoid(x[:, 0] + x[:, 1])
    weights, _ = fit_weights(x, right, (1, -1))
    assert weights[0].weight > 0.5
    assert weights[1].weight == 0.0


def test_a_constant_sign_counts_nothing() -> None:
    rng = np.random.default_rng(2)
    weights, bias = fit_weights(np.ones((200, 1)), rng.random(200) < 0.7, (1,))
    assert weights[0].weight == 0.0
    assert sigmoid(np.array(bias)) == pytest.approx(0.7, abs=0.1)


def test_the_interval_of_auroc_is_that_of_its_resamples() -> None:
    rng = np.random.default_rng(4)
    p, right = rng.integers(0, 9, 80) / 9.0, rng.random(80) < 0.6
    weights = bootstrap_resamples([str(n // 2) for n in range(80)])
    repeated = [np.repeat(np.arange(80), w.astype(int)) for w in weights[:200]]
    drawn = [auroc(p[index], right[index]) for index in repeated]
    assert auroc_interval(p, right, weights[:200]) == pytest.approx(tuple(np.quantile(drawn, [0.025, 0.975])))


def test_auroc_is_the_share_of_pairs_in_order() -> None:
    rng = np.random.default_rng(3)
    p, right = rng.integers(0, 6, 60) / 6.0, rng.random(60) < 0.5
    pairs = [(a > b) + 0.5 * (a == b) for a in p[right] for b in p[~right]]
    assert auroc(p, right) == pytest.approx(np.mean(pairs))
    assert auroc(-p, right) == pytest.approx(1.0 - np.mean(pairs))
    assert np.isnan(auroc(p, np.ones(60, dtype=bool)))


def test_calibration_error() -> None:
    right = np.array([True, True, False, False])
    assert calibration_error(right.astype(float), right) == 0.0
    assert calibration_error(np.full(4, 0.5), right) == 0.0
    assert calibration_error(np.full(4, 0.9), right) == pytest.approx(0.4)
    for count in (10, 5, 1):
        found = bins(np.array([0.0, 0.3, 0.99, 1.0]), right, count)
        assert sum(b.count for b in found) == 4
        assert len(found) == min(count, 3)


def test_perfect_probabilities_have_little_error_where_results_are_many() -> None:
    p = np.random.default_rng(4).random(5000)
    assert least_error(p, draws=20) < 0.02 < least_error(p[:50], draws=100)
