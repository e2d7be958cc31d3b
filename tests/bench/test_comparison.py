"""Comparisons of methods: means and their intervals, ranks, paired differences, failures, tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.bench.ablations import ABLATIONS, ablation_variants, method_variants
from getagrip.bench.comparison import (
    GraspClipScores,
    GraspVariantScore,
    bootstrap_resamples,
    compare_variants,
    error_columns,
    estimate_mean,
    independent_groups,
    mean_columns,
)
from getagrip.bench.tables import (
    CATEGORIES_TITLE,
    DIFFERENCES_TITLE,
    FINDINGS_TITLE,
    LATEX_STYLE,
    MEDIANS_TITLE,
    SETTINGS_TITLE,
    comparison_latex,
    comparison_markdown,
)
from getagrip.fitting.options import Options
from helpers.measures import score


@given(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=20))
def test_an_interval_holds_its_mean(values: list[float]) -> None:
    x = np.array(values)
    found = estimate_mean(x, [str(n) for n in range(len(x))])
    assert found.mean == pytest.approx(x.mean())
    assert found.clips == len(x)
    if np.ptp(x) > 0.0:
        assert found.low <= found.mean <= found.high


def test_the_interval_is_that_of_the_normal_law() -> None:
    x = np.random.default_rng(0).normal(size=400)
    found = estimate_mean(x, [str(n) for n in range(400)])
    wide = 1.966 * x.std(ddof=1) / np.sqrt(400)
    np.testing.assert_allclose([found.low, found.high], [x.mean() - wide, x.mean() + wide], atol=1e-4)


def test_intervals_of_six_subjects_cover_the_mean() -> None:
    rng, subjects = np.random.default_rng(0), [name for name in "abcdef" for _ in range(8)]
    draws = [np.repeat(rng.normal(size=6), 8) + rng.normal(size=48) for _ in range(2000)]
    found = [estimate_mean(x, subjects) for x in draws]
    assert 0.935 < np.mean([e.low <= 0.0 <= e.high for e in found]) < 0.965


def test_clips_of_a_subject_are_drawn_together() -> None:
    subjects = [name for name in "abcdef" for _ in range(2)]
    weights = bootstrap_resamples(subjects)
    np.testing.assert_array_equal(weights[:, ::2], weights[:, 1::2])
    np.testing.assert_array_equal(weights.sum(axis=1), 12)
    # Each clip twice says no more than each once.
    x = np.repeat([0.0, 1.0, 0.0, 0.5, 0.2, 0.9], 2)
    assert estimate_mean(x, subjects).high == pytest.approx(estimate_mean(x[::2], subjects[::2]).high)


def test_no_interval_where_clips_are_few_alike_or_of_one_subject() -> None:
    assert np.isnan(estimate_mean(np.ones(5), list("abcde")).low)
    assert np.isnan(estimate_mean(np.arange(4.0), list("abcd")).low)
    assert np.isnan(estimate_mean(np.arange(6.0), list("aaaaaa")).low)
    nothing = estimate_mean(np.full(3, np.nan), list("abc"))
    assert np.isnan(nothing.mean)
    assert nothing.clips == 0


def test_the_papers_metrics_are_columns() -> None:
    shares = "IOU|ADD|ADD sym.|SCA|truth's SCA|SCA-ADD|SCA-ADD sym.|SCA-IOU 0.8|SCA-IOU 0.6"
    assert [metric.label for metric in mean_columns()] == [*shares.split("|"), "stays"]  # shown where it was simulated
    assert [metric.label for metric in error_columns()] == ["ADD sym., mm", "rotation sym., °"]


def test_findings_are_counted_for_each_variant() -> None:
    variants = method_variants(("static",), Options())
    flagged = replace(score("static", 1.0), serious=("mask-fit", "hand-side"), noted=("penetration",))
    scores = [GraspClipScores(name, scores=(s,)) for name, s in (("a", flagged), ("b", score("static", 0.0)))]
    (row,) = compare_variants(scores, variants)[0].rows
    assert row.serious == {"mask-fit": 1, "hand-side": 1}
    assert row.noted == {"penetration": 1}
    assert (row.flagged, row.flagged_right) == (1, 1)
    assert "1 of 2" in comparison_markdown(compare_variants(scores, variants), "Methods", [], [])


def test_best_second_and_paired_differences() -> None:
    variants = method_variants(["one-dof", "soft-hinge", "static"], Options())
    hinge = [0.5, 0.7, 0.6, 0.4, 0.5]
    values = {
        "one-dof": hinge,
        "soft-hinge": [x + 0.1 + 0.01 * n for n, x in enumerate(hinge)],
        "static": [0.1, 0.2, 0.9, 0.3, 0.2],
    }
    scores = [
        GraspClipScores(f"c{n}", "can", "", True, tuple(score(m, v[n]) for m, v in values.items())) for n in range(5)
    ]
    (table,) = compare_variants(scores, variants)
    iou = table.columns[0]
    assert table.ranks(iou) == [2, 1, 0]
    difference = table.rows[1].differences["IOU"]
    assert difference.mean == pytest.approx(0.12)  # about ten points on every clip: certain, though the values spread
    assert 0.1 < difference.low < difference.high < 0.14
    assert table.rows[0].values["IOU"].high > table.rows[1].values["IOU"].low
    assert table.rows[0].differences == {}
    truth = next(column for column in table.columns if column.label == "truth's SCA")
    assert table.ranks(truth) == [0, 0, 0]


def test_a_method_that_failed_on_every_clip_shows_no_number() -> None:
    clips = [
        GraspClipScores(name, kind, "", True, (score("one-dof", 1.0), score("static", 0.0, failed=True)))
        for name, kind in (("a", "can"), ("b", "mug"))
    ]
    tables = compare_variants(clips, method_variants(["one-dof", "static"], Options()))
    for page in (comparison_markdown(tables, "Methods", [], []), comparison_latex(tables, "Methods", [])):
        rows = [line for line in page.splitlines() if "static (" in line]
        assert rows
        assert all("failed" in line.split("failed)")[1] and "0.0" not in line for line in rows)
    assert all(np.isnan(value.mean) for value in tables[0].rows[1].values.values())
    assert tables[0].ranks(tables[0].columns[0]) == [0, 0]  # there is nothing to be better than


def test_a_failed_method_scores_zero_and_a_failed_clip_nothing() -> None:
    variants = method_variants(["one-dof", "static"], Options())
    scores = [
        GraspClipScores("a", "can", "", True, (score("one-dof", 1.0), score("static", 0.0, failed=True))),
        GraspClipScores("b", "can", "", True, (score("one-dof", 1.0), score("static", 1.0))),
        GraspClipScores("c", failure="no masks"),
    ]
    (table,) = compare_variants(scores, variants)
    assert table.clips == 2
    assert [row.values["ADD"].mean for row in table.rows] == [1.0, 0.5]
    assert [row.failed for row in table.rows] == [0, 1]
    assert "static (1 failed)" in comparison_markdown([table], "Methods", [], [])


def test_medians_and_ambiguous_results_are_of_the_clips_that_were_done() -> None:
    def result(n: int, mm: float, ambiguous: bool) -> GraspClipScores:
        metrics = {"iou": 0.9, "add_sym_mm": mm, "add_sym_success": float(mm < 10.0)}
        one = GraspVariantScore("one-dof", metrics, 1.0, 2.0, ambiguous, "stopped")
        return GraspClipScores(f"c{n}", "can", "", True, (one, score("static", 0.0, failed=True)))

    scores = [result(n, mm, mm > 15.0 or mm < 2.0) for n, mm in enumerate([1.0, 3.0, 12.0, 20.0, 30.0])]
    (table,) = compare_variants(scores, method_variants(["one-dof", "static"], Options()))
    row, nothing = table.rows
    assert row.medians["ADD sym., mm"] == 12.0
    assert (row.ambiguous, row.wrong_ambiguous, row.wrong) == (3, 2, 3)
    assert np.isnan(nothing.medians["ADD sym., mm"])
    assert (nothing.ambiguous, nothing.wrong) == (0, 0)
    page = comparison_markdown([table], "Methods", [], [])
    assert "| one-dof | – | 12.0 | 3 of 5 | 2 of 3 |" in page  # no rotation is known, so there is no column of it


def test_a_folded_mean_is_of_all_clips_or_of_none() -> None:
    """Results that were made before it was measured show a dash, and failures do not become the mean of the rest."""
    right = GraspVariantScore(
        "static", {"add_sym_success": 0.0, "add_sym_cam_success": 1.0}, 1.0, 2.0, False, "stopped"
    )
    before = GraspVariantScore("one-dof", {"add_sym_success": 0.0}, 1.0, 2.0, False, "stopped")
    pairs = [(right, before), (right, score("one-dof", 0.0, failed=True)), (score("static", 0.0, failed=True), before)]
    scores = [GraspClipScores(name, "can", "", True, pair) for name, pair in zip("abc", pairs, strict=True)]
    (table,) = compare_variants(scores, method_variants(["static", "one-dof"], Options()))
    page = comparison_markdown([table], "Methods", [], [])
    assert "|  | right in the camera, % | ambiguous | of wrong poses |" in page
    assert "| static | 66.7 | 0 of 3 | 0 of 2 |" in page
    assert "| one-dof | – | 0 of 3 | 0 of 2 |" in page
    assert table.ranks(table.folded[0]) == [0, 0]
    assert "right in the camera" not in [column.label for column in table.columns]


def test_a_table_for_each_category() -> None:
    variants = method_variants(["one-dof"], Options())
    scores = [
        GraspClipScores(f"{c}{n}", c, "", True, (score("one-dof", n / 2),)) for c in ("can", "mug") for n in range(3)
    ]
    tables = compare_variants(scores, variants)
    assert [(table.title, table.clips) for table in tables] == [("all", 6), ("can", 3), ("mug", 3)]


def test_a_page_shows_the_means_and_folds_the_rest_away() -> None:
    variants = method_variants(["one-dof", "static"], Options())
    scores = [
        GraspClipScores(f"{c}{n}", c, "", True, (score("one-dof", n / 2), score("static", 0.1)))
        for c in ("can", "mug")
        for n in range(3)
    ]
    page = comparison_markdown(compare_variants(scores, variants), "Methods", ["what was run"], ["how"])
    shown, *folded = page.split("<details>")
    assert "- what was run" in shown
    assert shown.count("\n| one-dof |") == 1
    titles = [SETTINGS_TITLE, DIFFERENCES_TITLE, MEDIANS_TITLE, FINDINGS_TITLE, CATEGORIES_TITLE]
    assert [fold.split("</summary>\n\n")[0] for fold in folded] == [f"<summary>{title}" for title in titles]
    assert all(fold.rstrip().endswith("\n\n</details>") for fold in folded)


def test_subjects_are_the_groups_where_every_clip_has_one() -> None:
    two = [GraspClipScores("a", subject="s1"), GraspClipScores("b", subject="s2"), GraspClipScores("c", subject="s2")]
    assert independent_groups(two) == ["s1", "s2", "s2"]
    assert independent_groups([*two, GraspClipScores("d")]) == ["a", "b", "c", "d"]
    assert independent_groups([GraspClipScores("a", subject="s"), GraspClipScores("b", subject="s")]) == ["a", "b"]


def test_columns_without_truth_are_left_out() -> None:
    metrics = {"iou": 0.9, "sca_object_10mm": 0.5}
    scores = [
        GraspClipScores("a", "can", "", False, (GraspVariantScore("one-dof", metrics, 1.0, 2.0, False, "stopped"),))
    ]
    (table,) = compare_variants(scores, method_variants(["one-dof"], Options()))
    assert [column.label for column in table.columns] == ["IOU", "SCA"]


def test_latex_braces_match_and_symbols_are_spelt() -> None:
    variants = ablation_variants("physical", ["one-dof"], Options())
    scores = [
        GraspClipScores(f"c{n}", "a_b", "", True, tuple(score(variant.folder, n / 7) for variant in variants))
        for n in range(7)
    ]
    text = comparison_latex(compare_variants(scores, variants), ABLATIONS["physical"].title, [])
    tables = text[text.index(r"\begin{table}") :]
    assert tables.count("{") == tables.count("}")
    assert tables.count(r"\begin") == tables.count(r"\end")
    assert tables.isascii()
    assert LATEX_STYLE.text("a_b 5 %") == r"a\_b 5 \%"
