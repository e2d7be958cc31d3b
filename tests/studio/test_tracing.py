"""Polygons traced round a mask give it again."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.studio.masks.polygon_drafts import trace_polygons
from helpers.annotation import filled, iou
from helpers.labelled_scene import HEIGHT, WIDTH

shapes = st.lists(
    st.tuples(st.integers(40, 280), st.integers(40, 200), st.integers(8, 60), st.integers(8, 60), st.booleans()),
    min_size=1,
    max_size=4,
)


@given(shapes)
def test_traced_polygons_give_the_mask_again(shapes: list[tuple[int, int, int, int, bool]]) -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    mask = np.zeros((HEIGHT, WIDTH), bool)
    for x, y, a, b, adds in shapes:
        inside = ((u - x) / a) ** 2 + ((v - y) / b) ** 2 < 1
        mask = mask | inside if adds else mask & ~inside
    found = trace_polygons(mask)
    if mask.sum() > 400:
        assert iou(filled(found), mask) > 0.93
    assert all(len(one) >= 3 for one in found)


def test_a_ring_has_one_polygon_with_its_hole() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    distance = np.hypot(u - 150, v - 120)
    ring = (distance < 80) & (distance > 40)
    (outline,) = trace_polygons(ring)
    assert iou(filled([outline]), ring) > 0.97
