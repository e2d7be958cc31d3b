"""Laws of keeping: the kept ones are right with the share that is asked for, and sets hold the right candidate."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.kept import HEADER, calibrated, lines, of_part
from benchmarks.kept_rows import END, REAL, SYNTHETIC, Row, read
from benchmarks.probability import stored, write
from getagrip.batch.scheduling import MAX_KEEP_SHARE, MIN_KEEP_SHARE, KeepOptions
from getagrip.checks.calibration import (
    CALIBRATION_FILE,
    CALIBRATIONS,
    CORRECTED_CALIBRATIONS,
    KEEP_SHARES,
    KEEP_THRESHOLDS,
    KeepThresholds,
    candidate_set_thresholds,
    keep_threshold,
    kind_of_input,
    read_calibrations,
)
from getagrip.checks.features import HAND_FEATURES
from getagrip.errors import UsageError
from getagrip.provenance import assumed, estimated, kind_of_hands, measured
from getagrip.result.findings import Probability

USUAL = (*CALIBRATIONS["soft-hinge", "hand"].weights, *(sign.name for sign in HAND_FEATURES))


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
        signs = dict(zip(USUAL, rng.normal(size=len(USUAL)), strict=True))
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
    exact, corrected, fitted, least = read_calibrations(path)
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
