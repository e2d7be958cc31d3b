"""A row of the index has one kind of IOU: the mean and the least of what the result itself holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.metrics.evaluate import evaluate
from getagrip.report.pages import index_row, index_row_without_clip
from getagrip.report.pictures.result_view import View
from helpers.scenes import egg_and_mug, perfect


@pytest.mark.slow
def test_the_worst_frame_is_never_above_the_mean() -> None:
    clip, masks = egg_and_mug()
    iou = np.array([0.999, 1.0, np.nan, 0.999, 1.0])  # as of the whole image; a crop's are lower
    result = replace(perfect(clip), iou=iou)
    evaluation = evaluate(result, clip, masks)
    assert evaluation.metrics["iou"] < 0.995
    rows = (
        index_row("one", View.of(result, clip, masks), evaluation, False),
        index_row_without_clip("one", result, {"iou_full": 0.9}, ""),
    )
    for one in rows:
        assert one.values["IOU"] == pytest.approx(0.9995)
        assert one.values["worst frame"] == pytest.approx(0.999)


def test_without_masks_there_is_none() -> None:
    clip, _ = egg_and_mug()
    values = index_row_without_clip("one", replace(perfect(clip), iou=np.full(len(clip), np.nan)), {}, "").values
    assert np.isnan([values["IOU"], values["worst frame"]]).all()
