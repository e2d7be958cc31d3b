"""Benchmarks: what is run on which clips, means and intervals, tables, and runs that are interrupted."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.batch.ledger import Ledger
from getagrip.cli import main
from getagrip.clip import Clip, read_clip, write_clip
from getagrip.clip.writing import write_hand
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.datasets.synthetic.splits import PRESETS
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.evaluation import evaluate_result
from getagrip.experiments import trials
from getagrip.experiments.changes import AS_GIVEN, ScaleFree, ScaleKnown, TrueHands
from getagrip.experiments.comparison import COLUMNS, ERRORS, compare, groups
from getagrip.experiments.hand_sources import HandSource
from getagrip.experiments.settings import ABLATIONS, ablation_variants, method_variants
from getagrip.experiments.sources import SOURCES, samples, source_of
from getagrip.experiments.sources.source import Split
from getagrip.experiments.statistics import estimate, resamples
from getagrip.experiments.tables import LATEX, latex, markdown
from getagrip.experiments.trials import Score, Scores
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Departures, Options
from getagrip.geometry import se3
from getagrip.grasps import lists
from getagrip.result import read_result
from helpers.command_line import Run
from helpers.scenes import SHORT, scene


@pytest.fixture(scope="module")
def made(tmp_path_factory: Any) -> Path:
    """A folder of two clips; nothing in it is changed by tests."""
    folder: Path = tmp_path_factory.mktemp("made") / "clips"
    for category in ("can", "box"):
        write_clip(*scene(category, 0, SHORT), folder / category)
    return folder


@pytest.fixture
def unplotted(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures: they take longer than small runs."""
    monkeypatch.setattr("getagrip.experiments.plots.plot", lambda *_: None)


def score(variant: str, value: float, failed: bool = False) -> Score:
    """A score of which every metric in the tables has the same value."""
    kinds = ("sca", "truth_sca", "sca_add", "sca_add_sym", "sca_iou_80", "sca_iou_60")
    keys = ["iou", "add_success", "add_sym_success", *(f"{kind}_object_10mm" for kind in kinds)]
    return Score(variant, {} if failed else dict.fromkeys(keys, value), 1.0, 2.0, False, "stopped", failed)


# ---------------------------------------------------------------- findings


def test_the_papers_metrics_are_columns() -> None:
    shares = "IOU|ADD|ADD sym.|SCA|truth's SCA|SCA-ADD|SCA-ADD sym.|SCA-IOU 0.8|SCA-IOU 0.6"
    assert [metric.label for metric in COLUMNS] == shares.split("|")
    assert [metric.label for metric in ERRORS] == ["ADD sym., mm", "rotation sym., °"]


def test_findings_are_counted_for_each_variant() -> None:
    variants = method_variants(("static",), Options())
    doubted = replace(score("static", 1.0), serious=("mask-fit", "hand-side"), noted=("penetration",))
    scores = [Scores(name, scores=(s,)) for name, s in (("a", doubted), ("b", score("static", 0.0)))]
    (row,) = compare(scores, variants)[0].rows
    assert row.serious == {"mask-fit": 1, "hand-side": 1}
    assert row.noted == {"penetration": 1}
    assert (row.doubtful, row.doubtful_right) == (1, 1)
    assert "1 of 2" in markdown(compare(scores, variants), "Methods", [])


# ---------------------------------------------------------------- statistics


@given(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=20), st.integers(0, 5))
def test_an_interval_holds_its_mean_and_stays_among_the_values(values: list[float], seed: int) -> None:
    x = np.array(values)
    found = estimate(x, resamples([str(n) for n in range(len(x))], seed))
    assert found.mean == pytest.approx(x.mean())
    assert found.clips == len(x)
    if np.ptp(x) > 0.0:
        assert x.min() - 1e-12 <= found.low <= found.high <= x.max() + 1e-12


def test_the_interval_is_that_of_the_normal_law() -> None:
    x = np.random.default_rng(0).normal(size=400)
    found = estimate(x, resamples([str(n) for n in range(400)]))
    wide = 1.96 * x.std() / np.sqrt(400)
    np.testing.assert_allclose([found.low, found.high], [x.mean() - wide, x.mean() + wide], atol=0.015)


def test_clips_of_a_subject_are_drawn_together() -> None:
    weights = resamples([name for name in "abcdef" for _ in range(2)])
    np.testing.assert_array_equal(weights[:, ::2], weights[:, 1::2])
    np.testing.assert_array_equal(weights.sum(axis=1), 12)
    # Each clip twice says no more than each once.
    x = np.repeat([0.0, 1.0, 0.0, 0.5, 0.2, 0.9], 2)
    assert estimate(x, weights).high == estimate(x[::2], weights[:, ::2]).high


def test_no_interval_where_clips_are_few_alike_or_drawn_together() -> None:
    assert np.isnan(estimate(np.ones(5), resamples(list("abcde"))).low)
    assert np.isnan(estimate(np.arange(4.0), resamples(list("abcd"))).low)
    assert np.isnan(estimate(np.arange(6.0), resamples(list("aaaaaa"))).low)
    nothing = estimate(np.full(3, np.nan), resamples(list("abc")))
    assert np.isnan(nothing.mean)
    assert nothing.clips == 0


# ---------------------------------------------------------------- comparisons


def test_best_second_and_paired_differences() -> None:
    variants = method_variants(["one-dof", "soft-hinge", "static"], Options())
    hinge = [0.5, 0.7, 0.6, 0.4, 0.5]
    values = {
        "one-dof": hinge,
        "soft-hinge": [x + 0.1 + 0.01 * n for n, x in enumerate(hinge)],
        "static": [0.1, 0.2, 0.9, 0.3, 0.2],
    }
    scores = [Scores(f"c{n}", "can", "", True, tuple(score(m, v[n]) for m, v in values.items())) for n in range(5)]
    (table,) = compare(scores, variants)
    iou = table.columns[0]
    assert table.ranks(iou) == [2, 1, 0]
    difference = table.rows[1].differences["IOU"]
    assert difference.mean == pytest.approx(0.12)  # about ten points on every clip: certain, though the values spread
    assert 0.1 < difference.low < difference.high < 0.14
    assert table.rows[0].values["IOU"].high > table.rows[1].values["IOU"].low
    assert table.rows[0].differences == {}
    truth = next(column for column in table.columns if column.label == "truth's SCA")
    assert table.ranks(truth) == [0, 0, 0]


def test_a_failed_method_scores_zero_and_a_failed_clip_nothing() -> None:
    variants = method_variants(["one-dof", "static"], Options())
    scores = [
        Scores("a", "can", "", True, (score("one-dof", 1.0), score("static", 0.0, failed=True))),
        Scores("b", "can", "", True, (score("one-dof", 1.0), score("static", 1.0))),
        Scores("c", failure="no masks"),
    ]
    (table,) = compare(scores, variants)
    assert table.clips == 2
    assert [row.values["ADD"].mean for row in table.rows] == [1.0, 0.5]
    assert [row.failed for row in table.rows] == [0, 1]
    assert "static (1 failed)" in markdown([table], "Methods", [])


def test_medians_and_ambiguous_results_are_of_the_clips_that_were_done() -> None:
    def result(n: int, mm: float, ambiguous: bool) -> Scores:
        metrics = {"iou": 0.9, "add_sym_mm": mm, "add_sym_success": float(mm < 10.0)}
        one = Score("one-dof", metrics, 1.0, 2.0, ambiguous, "stopped")
        return Scores(f"c{n}", "can", "", True, (one, score("static", 0.0, failed=True)))

    scores = [result(n, mm, mm > 15.0 or mm < 2.0) for n, mm in enumerate([1.0, 3.0, 12.0, 20.0, 30.0])]
    (table,) = compare(scores, method_variants(["one-dof", "static"], Options()))
    row, nothing = table.rows
    assert row.medians["ADD sym., mm"] == 12.0
    assert (row.ambiguous, row.wrong_ambiguous, row.wrong) == (3, 2, 3)
    assert np.isnan(nothing.medians["ADD sym., mm"])
    assert (nothing.ambiguous, nothing.wrong) == (0, 0)
    page = markdown([table], "Methods", [])
    assert "| one-dof | 12.0 | 3 of 5 | 2 of 3 |" in page  # no rotation is known, so there is no column of it


def test_a_table_for_each_category() -> None:
    variants = method_variants(["one-dof"], Options())
    scores = [Scores(f"{c}{n}", c, "", True, (score("one-dof", n / 2),)) for c in ("can", "mug") for n in range(3)]
    tables = compare(scores, variants)
    assert [(table.title, table.clips) for table in tables] == [("all", 6), ("can", 3), ("mug", 3)]


def test_subjects_are_the_groups_where_every_clip_has_one() -> None:
    two = [Scores("a", subject="s1"), Scores("b", subject="s2"), Scores("c", subject="s2")]
    assert groups(two) == ["s1", "s2", "s2"]
    assert groups([*two, Scores("d")]) == ["a", "b", "c", "d"]
    assert groups([Scores("a", subject="s"), Scores("b", subject="s")]) == ["a", "b"]


def test_columns_without_truth_are_left_out() -> None:
    metrics = {"iou": 0.9, "sca_object_10mm": 0.5}
    scores = [Scores("a", "can", "", False, (Score("one-dof", metrics, 1.0, 2.0, False, "stopped"),))]
    (table,) = compare(scores, method_variants(["one-dof"], Options()))
    assert [column.label for column in table.columns] == ["IOU", "SCA"]


def test_latex_braces_match_and_symbols_are_spelt() -> None:
    variants = ablation_variants("physical", ["one-dof"], Options())
    scores = [
        Scores(f"c{n}", "a_b", "", True, tuple(score(variant.folder, n / 7) for variant in variants)) for n in range(7)
    ]
    text = latex(compare(scores, variants), ABLATIONS["physical"].title, [])
    tables = text[text.index(r"\begin{table}") :]
    assert tables.count("{") == tables.count("}")
    assert tables.count(r"\begin") == tables.count(r"\end")
    assert tables.isascii()
    assert LATEX.text("a_b 5 %") == r"a\_b 5 \%"


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize("name", ABLATIONS)
def test_settings_have_folders_of_their_own_and_something_to_compare_with(name: str) -> None:
    ablation = ABLATIONS[name]
    variants = ablation_variants(name, [], Options())
    labels = [variant.label for variant in variants]
    assert len(set(labels)) == len(labels)
    assert all(variant.against in labels for variant in variants)
    assert all(re.fullmatch(r"[a-z0-9.+-]+", variant.folder) for variant in variants)
    kinds = {(variant.folder, repr(variant.options), repr(variant.change)) for variant in variants}
    assert len(kinds) == len({variant.folder for variant in variants})
    assert {variant.group for variant in variants} == set(ablation.methods)


def test_a_setting_that_changes_nothing_shares_the_methods_results() -> None:
    folders = {variant.step: variant.folder for variant in ablation_variants("inits", ["one-dof"], Options())}
    assert folders["50"] == "one-dof"
    assert folders["10"] == "one-dof+inits-10"
    folders = {variant.step: variant.folder for variant in ablation_variants("inits", ["one-dof"], Options(inits=100))}
    assert folders["100"] == "one-dof"
    assert folders["50"] != "one-dof"
    assert {variant.folder for variant in ablation_variants("sca", ["static"], Options())} == {"static"}


def test_all_methods_but_the_slow_ones_where_none_is_named() -> None:
    usual = [name for name, method in METHODS.items() if not method.slow]
    assert [variant.folder for variant in method_variants([], Options())] == usual
    assert [variant.folder for variant in method_variants(["paper"], Options())] == ["paper"]


def test_departures_lead_step_by_step_from_the_paper_to_ours() -> None:
    first, *between, last = [variant.options for variant in ablation_variants("departures", [], Options())]
    made = [sum(asdict(options.departures).values()) for options in between]
    assert first == Options(method="paper")
    assert made == list(range(1, len(fields(Departures)) + 1))
    assert last == Options(method="soft-hinge", hands="as-given")


@pytest.mark.slow
def test_scale_made_free_and_known_again() -> None:
    clip, masks = scene("can", 0, SHORT)
    free, _ = ScaleFree()(clip, masks, 0)
    assert free.scale == "free"
    assert free.truth is not None
    assert 0.8 <= free.truth.scale <= 1.25
    known, _ = ScaleKnown()(free, masks, 0)
    np.testing.assert_allclose(known.mesh.vertices, clip.mesh.vertices, atol=1e-12)
    assert AS_GIVEN(clip, masks, 0) == (clip, masks)


# ---------------------------------------------------------------- runs


@pytest.mark.slow
def test_a_run_writes_tables_and_goes_on_where_it_stopped(made: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    out, written = tmp_path / "out", tmp_path / "all.json"
    call = ("bench", made, "--out", out, "--workers", "1", "--inits", "4", "--json", written)
    status, text, err = run(*call, "--methods", "static")
    assert (status, err) == (0, "")
    assert "1 done, 0 already done" in text
    status, text, _ = run(*call, "--methods", "one-dof", "static")
    assert status == 0
    assert text.count("1 done, 1 already done") == 2
    with monkeypatch.context() as patch:  # all is there: nothing is reconstructed, no mask is read
        patch.setattr(trials, "read_masks", lambda _: pytest.fail("masks were read"))
        status, text, _ = run(*call, "--methods", "one-dof", "static")
    assert text.count("0 done, 2 already done") == 2

    rows = list(csv.DictReader((out / "methods-clips.csv").read_text().splitlines()))
    names = ["box-right-0000", "can-right-0000"]
    assert [(row["clip"], row["method"]) for row in rows] == [(n, m) for n in names for m in ("one-dof", "static")]
    result, record = read_result(out / "results" / "one-dof" / names[0])
    assert float(rows[0]["iou"]) == record["metrics"]["iou"]
    assert float(rows[0]["energy"]) == result.energy["total"]
    content = json.loads(written.read_text())
    mean = content["tables"][0]["rows"][0]["values"]["IOU"]["mean"]
    assert mean == pytest.approx(np.mean([float(row["iou"]) for row in rows if row["method"] == "one-dof"]))
    page = (out / "methods.md").read_text()
    assert f"{100 * mean:.1f}" in page
    assert "Box: 1 clip" in page
    assert run("evaluate", out / "results" / "static")[0] == 0  # they are results like any other


@pytest.mark.slow
def test_a_run_has_a_ledger_shards_and_an_end_at_the_first_failure(
    made: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []

    def unreadable(trial: trials.Trial) -> Scores:
        tried.append(trial.name)
        return Scores(trial.name, failure="no masks")

    monkeypatch.setattr("getagrip.commands.bench.run", unreadable)
    call = ("bench", made, "--out", tmp_path, "--workers", "1")
    assert run(*call, "--fail-fast")[0] == 1
    assert tried == ["box-right-0000"]
    with Ledger(tmp_path) as ledger:
        assert [(entry.name, entry.state, entry.why) for entry in ledger.entries()] == [
            ("box-right-0000", "failed", "no masks")
        ]
    for shard in ("1/2", "2/2"):
        run(*call, "--shard", shard)
    assert sorted(tried[1:]) == ["box-right-0000", "can-right-0000"]


@pytest.mark.slow
def test_results_of_other_systems_are_rows(made: Path, tmp_path: Path, run: Run) -> None:
    """Poses by clip, evaluated in the frames of ours; again where they change, and failed where they are missing."""
    theirs, out = tmp_path / "theirs", tmp_path / "out"
    theirs.mkdir()
    truths = {}
    for folder in sorted(made.iterdir()):
        clip = read_clip(folder)
        assert clip.truth is not None
        truths[clip.name] = clip.truth.T_cam_obj
        np.save(theirs / f"{clip.name}.npy", clip.truth.T_cam_obj)
    call = ("bench", made, "--out", out, "--workers", "1", "--inits", "4", "--methods", "static")
    status, text, err = run(*call, "--with", f"theirs={theirs}")
    assert (status, err) == (0, "")
    assert text.count("2 done, 0 already done") == 2
    rows = {(r["clip"], r["method"]): r for r in csv.DictReader((out / "methods-clips.csv").read_text().splitlines())}
    assert {method for _, method in rows} == {"static", "theirs"}
    assert all(float(rows[name, "theirs"]["add_mm"]) < 1e-3 for name in truths)
    assert "theirs" in (out / "methods.md").read_text()
    assert run("evaluate", out / "results" / "theirs")[0] == 0  # results like any other
    first, second = truths
    np.save(theirs / f"{first}.npy", truths[first] @ se3.rigid(None, np.array([0.01, 0.0, 0.0])))
    (theirs / f"{second}.npy").unlink()
    status, text, err = run(*call, "--with", f"theirs={theirs}")
    assert status == 1
    assert f"{second}: theirs" in text + err
    assert "no poses of the clip" in text + err
    rows = {(r["clip"], r["method"]): r for r in csv.DictReader((out / "methods-clips.csv").read_text().splitlines())}
    assert float(rows[first, "theirs"]["add_mm"]) == pytest.approx(10.0, abs=1e-3)


@pytest.mark.slow
def test_an_ablation_changes_clips_and_draws_a_plot(made: Path, tmp_path: Path, run: Run) -> None:
    call = ("bench", made, "--out", tmp_path, "--workers", "1", "--inits", "4", "--clips", "1")
    status, _, _ = run(*call, "--ablation", "mask-noise", "--methods", "static")
    assert status == 0
    assert (tmp_path / "mask-noise.png").stat().st_size > 10_000
    rows = list(csv.DictReader((tmp_path / "mask-noise-clips.csv").read_text().splitlines()))
    assert [row["setting"] for row in rows] == ["none", "0.5 px", "1 px", "2 px", "4 px"]
    assert len({row["add_mm"] for row in rows}) == 5
    noisy = tmp_path / "results" / "static+mask-noise-4-px"
    status, _, err = run("evaluate", noisy)  # its clip is no longer the one in the folder
    assert status == 1
    assert "input_sha256" in err


def hand_file(folder: Path, clip: Clip, frames: list[int], mm: float = 0.0, **extra: Any) -> None:
    """A clip's hands in some frames, so far displaced, as `import hands --out` writes them."""
    folder.mkdir(exist_ok=True)
    hand = clip.take(np.array(frames)).hand
    T = hand.T_cam_hand.copy()
    T[:, 0, 3] += mm / 1e3
    numbers = np.array([int(clip.frames[n]) for n in frames])
    write_hand(replace(hand, T_cam_hand=T), folder / f"{clip.name}.npz", {"frames": numbers, **extra})


@pytest.mark.slow
@pytest.mark.usefixtures("unplotted")
def test_hands_are_compared_on_the_frames_that_all_have(made: Path, tmp_path: Path, run: Run) -> None:
    for name in ("can", "box"):
        clip = read_clip(made / name)
        hand_file(tmp_path / "exact", clip, [0, 1, 2, 3], K=clip.K[0])
        hand_file(tmp_path / "off", clip, [1, 2, 3], mm=6.0, side=np.array(clip.side))
    out, written = tmp_path / "out", tmp_path / "all.json"
    sources = (f"exact={tmp_path / 'exact'}", f"off={tmp_path / 'off'}")
    call = ("bench", made, "--out", out, "--workers", "1", "--inits", "4", "--methods", "static", "--json", written)
    status, printed, err = run(*call, "--hands", *sources)
    assert (status, err) == (0, "")
    assert printed.count("2 done, 0 already done") == 2
    (table, *_) = json.loads(written.read_text())["tables"]
    assert [(row["row"], row["against"]) for row in table["rows"]] == [
        ("static, exact", None), ("static, off", "static, exact"),
    ]  # fmt: skip
    assert (out / "hands.md").read_text().startswith("# Hands, on the frames that all of them have")
    for variant in ("static+hands-exact", "static+hands-off"):
        assert read_result(out / "results" / variant / clip.name)[0].frames == clip.frames[1:]
    assert run(*call, "--hands", *sources)[1].count("0 done, 2 already done") == 2
    hand_file(tmp_path / "off", clip, [1, 2], mm=6.0)  # one clip's hands are others now
    assert run(*call, "--hands", *sources)[1].count("2 done, 0 already done") == 1
    assert read_result(out / "results" / "static+hands-exact" / clip.name)[0].frames == clip.frames[1:3]
    # Clips are hands, too; what does not fit is named.
    write_clip(replace(clip, hand=clip.hand), trials.read_masks(clip), tmp_path / "clips" / clip.name)
    assert HandSource.of(f"c={tmp_path / 'clips'}").read(clip).track == clip.hand
    for bad, words in (
        ({"frames": [1]}, "1 of the 4 frames"), ({"frames": [1, 2], "side": np.array("left")}, "side: got 'left'"),
    ):  # fmt: skip
        hand_file(tmp_path / "off", clip, **bad)
        status, _, err = run(*call, "--hands", *sources)
        assert (status, f"failed: {clip.name}" in err, words in err) == (1, True, True)
    (tmp_path / "off" / f"{clip.name}.npz").unlink()
    assert "expected off's hands of the clip" in run(*call, "--hands", *sources)[2]
    for wrong in (("exact",), ("exact=nowhere",), (sources[0], sources[0])):
        assert run(*call, "--hands", *wrong)[0] == 2
    assert run(*call, "--hands", *sources, "--ablation", "scale")[0] == 2


@pytest.mark.slow
def test_contact_is_measured_within_any_distance(made: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    """Of results that are there, by evaluating them again; wider contact has more points in it."""
    from getagrip.fitting import reconstruct as module

    out = tmp_path / "out"
    call = ("bench", made, "--out", out, "--workers", "1", "--methods", "static", "--clips", "1", "--inits", "4")
    assert run(*call)[0] == 0
    assert "contact: object vertices within 10 mm" in (out / "methods.md").read_text()
    monkeypatch.setattr(module, "reconstruct", lambda *_: pytest.fail("reconstructed again"))
    written = tmp_path / "all.json"
    assert run(*call, "--contact", "0", "2.5", "20", "--json", written)[0] == 0
    rows = json.loads(written.read_text())["tables"][0]["rows"]
    assert [row["row"] for row in rows] == ["static, 0 mm", "static, 2.5 mm", "static, 20 mm"]
    assert [row["contact"] for row in rows] == ["object_0mm", "object_2.5mm", "object_20mm"]
    (result,) = out.glob("results/static/*")
    metrics = read_result(result)[1]["metrics"]
    for row, mm in zip(rows, ("0", "2.5", "20"), strict=True):
        assert row["values"]["SCA"]["mean"] == metrics[f"sca_object_{mm}mm"]
    shares = evaluate_result(result)["per_frame"]
    assert np.mean(shares["contact_share_object_0mm"]) <= np.mean(shares["contact_share_object_10mm"])
    assert "0 done, 1 already" in run(*call, "--contact", "2.5")[1]
    assert "contact: object vertices within 2.5 mm" in (out / "methods.tex").read_text()
    assert run(*call, "--contact", "51")[0] == 2


def test_the_list_beside_clips_says_what_contact_is(tmp_path: Path) -> None:
    source = source_of(str(tmp_path))
    assert source.contact_mm == 10.0
    lists.write(tmp_path / "grasps.json", [], {"contact": 0.0})
    assert source.contact_mm == 0.0
    lists.write(tmp_path / "grasps.json", [], {"contact": "wide"})
    with pytest.raises(InputError, match=r"grasps\.json: cut\.contact"):
        _ = source.contact_mm


@pytest.mark.slow
def test_results_of_other_options_are_made_again(made: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    call = ("bench", made, "--out", tmp_path, "--workers", "1", "--methods", "static", "--clips", "1")
    assert "1 done" in run(*call, "--inits", "4")[1]
    assert "1 done" in run(*call, "--inits", "5")[1]
    monkeypatch.setattr(trials, "_code_changed", lambda: 1.0)
    _, out, err = run(*call, "--inits", "5")
    assert "0 done, 1 already" in out
    assert err == ""
    record = next(tmp_path.glob("results/static/*/result.json"))
    os.utime(record, (0.0, 0.0))
    assert "1 results are older" in run(*call, "--inits", "5")[2]
    assert "1 done" in run(*call, "--inits", "5", "--overwrite")[1]


@pytest.mark.slow
def test_what_fails_is_named_and_the_rest_done(made: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    folder = tmp_path / "clips"
    for name in ("can", "box"):
        clip = read_clip(made / name)
        write_clip(clip, trials.read_masks(clip), folder / name)
    for mask in (folder / "can" / "masks" / "object").iterdir():
        mask.write_bytes(b"")
    from getagrip.fitting import reconstruct as module

    exact = module.reconstruct

    def sometimes(clip: Any, masks: Any, options: Options) -> Any:
        if options.method == "static":
            raise GetagripError("nothing is seen")
        return exact(clip, masks, options)

    monkeypatch.setattr(module, "reconstruct", sometimes)
    call = ("bench", folder, "--out", tmp_path / "out", "--workers", "1", "--inits", "4")
    status, out, err = run(*call, "--methods", "one-dof", "static")
    assert status == 1
    assert "failed: can-right-0000" in err
    assert "failed: box-right-0000: static: nothing is seen" in err
    assert "1 done, 0 already done, 1 failed" in out
    rows = list(csv.DictReader((tmp_path / "out" / "methods-clips.csv").read_text().splitlines()))
    assert [row["status"].startswith("failed") for row in rows] == [False, True, True]


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--init", "clusters"), "--init"),
        (("--workers", "0"), "--workers"),
        (("--clips", "0"), "--clips"),
        (("--split", "train"), "--split"),
        (("--root", "x"), "--root"),
        (("--preset", "wild"), "--preset"),
        (("--ablation", "none"), "expected one of physical"),
        (("--json", "nowhere/x.json"), "--json"),
        (("--inits", "0"), "inits"),
        (("--with", "x=nowhere"), "--with"),
        (("--with", "static=."), "another one than those of the methods"),
        (("--with", "x=.", "--ablation", "scale"), "--with"),
    ],
)
def test_wrong_calls_are_refused(made: Path, tmp_path: Path, run: Run, args: tuple[str, ...], word: str) -> None:
    status, _, err = run("bench", made, "--out", tmp_path / "out", *args)
    assert status == 2
    assert word in err


def test_folders_that_are_no_clips_are_refused(tmp_path: Path, run: Run) -> None:
    status, _, err = run("bench", tmp_path / "nowhere", "--out", tmp_path / "out")
    assert status != 0
    assert "nowhere" in err
    assert main(["bench", "dexycb", "--out", str(tmp_path / "out")]) == 2


@pytest.mark.parametrize(
    ("preset", "message"),
    [
        ("tame", "preset: got 'tame', expected one of clean"),
        ("hamer", "preset: 'hamer' is now called 'moderate'"),
        ("frankmocap", "preset: 'frankmocap' is now called 'strong'"),
    ],
)
def test_an_unknown_preset_is_refused_before_a_folder_is_claimed(
    preset: str, message: str, tmp_path: Path, run: Run
) -> None:
    status, _, err = run("bench", "synthetic", "--out", tmp_path / "out", "--preset", preset)
    assert status == 2
    assert message in err
    assert not (tmp_path / "out" / "clips").exists()


def test_a_folder_of_synthetic_clips_belongs_to_one_preset(tmp_path: Path) -> None:
    clean, clips = source_of("synthetic"), tmp_path / "clips"
    found, _ = samples(clean, clips, None, debug=False)
    assert len({sample.name for sample in found}) == len(found) > 100
    assert not list(clips.glob("*/"))  # clips are made when they are needed
    assert len(samples(clean, clips, 7, debug=False)[0]) == 7
    both = {sample.name for sample in samples(replace(clean, split="all"), clips, None, debug=False)[0]}
    train = {sample.name for sample in samples(replace(clean, split="train"), clips, None, debug=False)[0]}
    assert both - train == {sample.name for sample in found}
    with pytest.raises(UsageError, match="another dataset"):
        samples(source_of("synthetic", preset="wild"), clips, None, debug=False)


@pytest.mark.slow
def test_subjects_of_dexycb_are_split(tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    clip, masks = scene("can", 0, SHORT)
    for n in range(7):
        name = f"subject-{n}--sequence--can"
        write_clip(replace(clip, name=name), masks, folder / name)
    source = source_of("dexycb", root=tmp_path)
    (folder / "imported").touch()  # as if from somewhere
    part = {
        which: [sample.name[8] for sample in samples(replace(source, split=which), folder, None, debug=False)[0]]
        for which in ("train", "test", "all")
    }
    assert part == {"train": list("036"), "test": list("1245"), "all": list("0123456")}


@pytest.mark.slow
def test_true_hands_replace_given_ones() -> None:
    noisy, masks = synthesise("can", 0, SceneOptions(frames=3, size=(64, 48), focal=60.0, hand_bias_mm=10.0))
    clip, _ = TrueHands()(noisy, masks, 0)
    assert noisy.truth is not None
    np.testing.assert_array_equal(clip.hand.T_cam_hand, noisy.truth.T_cam_hand)
    assert np.linalg.norm(clip.hand.T_cam_hand[:, :3, 3] - noisy.hand.T_cam_hand[:, :3, 3], axis=1).min() > 0.009
    with pytest.raises(InputError, match="no ground truth"):
        TrueHands()(replace(noisy, truth=None), masks, 0)


@pytest.mark.slow
def test_subjects_of_arctic_are_split_whichever_are_there(tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    clip, masks = synthesise("can", 0, SceneOptions(frames=2, size=(64, 48), focal=60.0))
    for subject in ("s1", "s5", "s7"):
        name = f"{subject}--box_use_01--box--left"
        write_clip(replace(clip, name=name), masks, folder / name)
    (folder / "imported").touch()
    source = source_of("artigrasp", root=tmp_path)

    def subjects(which: Split) -> list[str]:
        return [s.name.split("-")[0] for s in samples(replace(source, split=which), folder, None, debug=False)[0]]

    assert [subjects(which) for which in ("train", "test", "all")] == [["s1", "s7"], ["s5"], ["s1", "s5", "s7"]]
    for path in (folder / "s1--box_use_01--box--left", folder / "s7--box_use_01--box--left"):
        shutil.rmtree(path)
    with pytest.raises(UsageError, match="no clip of artigrasp"):
        subjects("train")


def test_the_commands_ablations_are_those_that_exist(run: Run) -> None:
    _, out, _ = run("bench", "--help")
    assert all(
        name in out.replace(" ", "").replace("\n", "").replace("│", "") for name in (*ABLATIONS, *PRESETS, *SOURCES)
    )
