"""Plots are well-formed SVG that show each value where it is."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from getagrip.view.live.plots import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, Curve, Plot, legend

VALUES = np.array([0.0, 5.0, 10.0, np.nan, 10.0])


def parsed(plot: Plot, n: int, press: str = "") -> ElementTree.Element:
    return ElementTree.fromstring(plot.svg(n, press))


def test_the_mark_and_the_dot_are_at_the_frame_and_its_value() -> None:
    svg = parsed(Plot("angle", "°", [Curve("one", VALUES, "#123456")]), 1)
    (dot,) = svg.findall("circle")
    assert float(dot.attrib["cx"]) == pytest.approx(LEFT + (WIDTH - LEFT - RIGHT) / 4)
    assert float(dot.attrib["cy"]) == pytest.approx((TOP + HEIGHT - BOTTOM) / 2)
    assert "5.0" in "".join(svg.itertext())


def test_a_curve_is_broken_where_nothing_is_known_and_has_no_dot_there() -> None:
    svg = parsed(Plot("gap", "mm", [Curve("one", VALUES, "#123456")]), 3)
    (path,) = [path for path in svg.findall("path") if path.attrib["stroke"] == "#123456"]
    assert path.attrib["d"].count("M") == 2
    assert not svg.findall("circle")


def test_values_beyond_the_limits_stay_in_the_field() -> None:
    svg = parsed(Plot("IOU", "%", [Curve("one", VALUES, "#123456")], (2.0, 4.0)), 2)
    (dot,) = svg.findall("circle")
    assert float(dot.attrib["cy"]) == TOP


@pytest.mark.parametrize("values", [np.full(3, np.nan), np.full(3, 7.0), np.array([1.0])])
def test_nothing_known_nothing_changing_and_a_single_frame_are_drawn_too(values: np.ndarray) -> None:
    assert "nan" not in Plot("gap", "mm", [Curve("one", values, "red")]).svg(0)


def test_names_and_scripts_are_text() -> None:
    curve = Curve("<b>&", VALUES, "#123456")
    svg = parsed(Plot("<i>", "&", [curve]), 0, "f('<a>',\"&\")")
    assert svg.attrib["onpointerdown"].endswith("f('<a>',\"&\")")
    assert "<b>" not in legend([curve])
