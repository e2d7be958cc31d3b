"""Cameras see all that they look at; names in figures are short and distinct."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.bench.figures import StoredResult
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.report.pictures.panels import DistantCamera, Sheet, look_at
from getagrip.report.pictures.stored_results import distinct_path_parts


@pytest.mark.parametrize(("side", "up"), [([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]), ([1.0, 2.0, -3.0], [1.0, 2.0, -3.0])])
def test_cameras_see_all_that_they_look_at(side: list[float], up: list[float]) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)) * [0.1, 0.02, 0.05] + [1.0, 2.0, 3.0]
    eye: DistantCamera = look_at(points, np.array(side), np.array(up), 100)
    seen = se3.transform(eye.T_view_frame, points)
    uv = project(eye.K, seen)
    assert se3.is_rigid(eye.T_view_frame)
    assert 0.0 < uv.min() < uv.max() < 100.0
    assert np.ptp(uv, axis=0).max() > 70.0
    towards = eye.T_view_frame[:3, :3] @ (np.array(side) / np.linalg.norm(side))
    np.testing.assert_allclose(towards, [0.0, 0.0, -1.0], atol=1e-12)
    if side != up:
        assert (eye.T_view_frame[:3, :3] @ np.array(up))[1] < 0.0  # rows count downwards


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
