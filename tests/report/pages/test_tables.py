"""The folded tables of a page say what numbers mean."""

from __future__ import annotations

from dataclasses import replace

from getagrip.metrics.evaluate.results import Evaluation
from getagrip.report.pages.result_page import result_tables
from getagrip.report.pictures.result_view import View
from helpers.scenes import egg_and_mug, perfect


def test_checks_have_their_usual_range_and_a_verdict() -> None:
    clip, masks = egg_and_mug()
    checks = {
        "hand-side": 68.46,
        "visible-size": float("nan"),
        "contact-gap": 20.0,
        "penetration": 40.0,
        "unknown": 1.0,
    }
    result = replace(perfect(clip), checks=checks)
    known = Evaluation.recorded(clip, "static", {})
    (table,) = (
        one for one in result_tables(View.of(result, clip, masks), known, {}) if one["title"].startswith("Checks")
    )
    assert table["head"] == ("check", "value", "usual", "verdict")
    assert table["rows"] == [
        ["hand-side", "68.5 degrees", "at least -5 degrees", "usual"],
        ["visible-size", "", "0.1 to 8", "not applicable"],
        ["contact-gap", "20 mm", "at most 15 mm", "serious"],
        ["penetration", "40 mm", "at most 35 mm", "note"],
        ["unknown", "1", "", ""],
    ]
