"""Names in figures: short, and different where what they name is."""

from __future__ import annotations

from pathlib import Path

from getagrip.bench.figures import StoredResult
from getagrip.report.pictures.panels import Sheet
from getagrip.report.pictures.stored_results import distinct_path_parts

DPI = 60


def test_folders_are_told_apart_by_what_differs() -> None:
    def names(*paths: str) -> list[str]:
        return distinct_path_parts([StoredResult(Path(path)) for path in paths])

    assert names("/r/a/clip", "/r/b/clip") == ["a", "b"]
    assert names("/r/a/x/clip", "/r/b/y/clip") == ["a/x", "b/y"]
    assert names("/r/clip-1", "/r/clip-2") == ["clip-1", "clip-2"]
    assert names("/r/clip") == ["clip"]


def test_long_names_keep_their_beginning_and_their_end() -> None:
    sheet = Sheet.of(4.0, 1.0, DPI)
    name = "20200709-subject-01--20200709_150413--025_mug-right-000012-000047"
    sheet.text(0.1, 0.1, name, 3.0)
    (text,) = sheet.figure.texts
    head, tail = text.get_text().split("...")
    assert name.startswith(head)
    assert name.endswith(tail)
    assert abs(len(head) - len(tail)) <= 1
    assert 2.8 * DPI < text.get_window_extent().width <= 3.0 * DPI
