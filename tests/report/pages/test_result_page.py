"""A page is one file whose texts stay texts; its folded tables and arrays hold what is known."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from getagrip.clip import OtherHand
from getagrip.geometry import se3
from getagrip.geometry.camera import Crops
from getagrip.metrics.evaluate.results import Evaluation
from getagrip.report.pages import scene_data
from getagrip.report.pages.index_page import IndexRow, _result_sets, write_index
from getagrip.report.pages.result_page import (
    ARRAY_TYPE_CODES,
    build_document,
    json_for_script,
    pack_arrays,
    result_tables,
)
from getagrip.report.pictures.contact_colours import subdivide_object, surface_gap
from getagrip.report.pictures.result_view import View, candidate_views
from helpers.scenes import egg_and_mug, perfect

texts = st.one_of(st.text(), st.sampled_from(["</script>", "<!--", "<script>", "&lt;", "\u2028", "]]>"]))
values = texts | st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.lists(texts, max_size=3)


@given(st.dictionaries(texts, values, max_size=3))
def test_data_ends_no_element_and_is_read_as_it_was(data: dict[str, Any]) -> None:
    text = json_for_script(data)
    assert not set(text) & set("<>&\u2028\u2029")
    assert text.isascii()
    assert json.loads(text) == data


def test_arrays_come_back_as_they_were() -> None:
    rng = np.random.default_rng(0)
    arrays = {
        "a": rng.normal(size=(3, 4)).astype(np.float32),
        "b": rng.integers(0, 2**16, 5).astype(np.uint16),
        "c": rng.integers(0, 2**32, (2, 3)).astype(np.uint32),
        "d": rng.integers(0, 256, 7).astype(np.uint8),
    }
    assert {values.dtype.name for values in arrays.values()} == set(ARRAY_TYPE_CODES)
    where, packed = pack_arrays(arrays)
    content = zlib.decompress(base64.b64decode(packed))
    for name, values in arrays.items():
        place = where[name]
        assert place["offset"] % values.itemsize == 0
        back = np.frombuffer(content, place["type"], values.size, place["offset"]).reshape(place["shape"])
        np.testing.assert_array_equal(back, values)


def test_the_policy_names_the_hashes_of_what_is_there_and_nothing_else() -> None:
    page = build_document("<b>&", "index.html", ("page.js", "index.js"), {"rows": []})
    assert "<title>&lt;b&gt;&amp;</title>" in page
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    styles = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    for kind, codes in (("script-src", scripts), ("style-src", styles)):
        allowed = next(rule.split()[1:] for rule in policy.split("; ") if rule.startswith(kind))
        hashes = [base64.b64encode(hashlib.sha256(code.encode()).digest()).decode() for code in codes]
        assert allowed == [f"'sha256-{value}'" for value in hashes]
    assert policy.startswith("default-src 'none'; ")
    assert not re.search(r"\bon[a-z]+=|\bstyle=|(?:src|href)=(?!\"data:)", re.sub(r"<script.*?</script>", "", page))


def test_results_are_grouped_by_the_folders_that_differ(tmp_path: Any) -> None:
    assert _result_sets(["results/a/x", "results/b/x", "results/b/y"]) == ["a", "b", "b"]
    assert _result_sets(["x", "y"]) == ["", ""]
    assert _result_sets(["x", "more/y"]) == ["", "more"]
    page = write_index([IndexRow("a b/ü#?", page=True)], "all", (), tmp_path / "index.html").read_text("utf-8")
    assert '"link":"./a%20b/%C3%BC%23%3F/report.html"' in page


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


def test_what_the_other_hand_touches_is_touched() -> None:
    """A clip whose own hand is far away, and whose other hand holds the object, as far as it is known."""
    clip, _ = egg_and_mug()
    result, known = perfect(clip), np.array([0, 2])
    aside = se3.rigid(t=np.array([-0.5, 0.0, 0.0])) @ clip.hand.T_cam_hand
    given = replace(
        clip, side="left", hand=replace(clip.hand, T_cam_hand=aside), truth=None,
        other_hand=OtherHand.at(clip.hand.take(known), known, len(clip)),
    )  # fmt: skip
    moved = replace(result, T_hand_obj=se3.inverse(aside) @ clip.hand.T_cam_hand @ result.T_hand_obj)
    one, both = View.of(result, clip, None), View.of(moved, given, None)
    gaps = surface_gap(both)
    np.testing.assert_allclose(gaps[known], surface_gap(one)[known], atol=1e-9)
    assert gaps[[1, 3, 4]].min() > 0.1
    surface = subdivide_object(one)
    alone, found = scene_data.per_frame_arrays(one, surface), scene_data.per_frame_arrays(both, surface)
    assert alone["hand_near"][known].max() == 255
    for name, of in (("object_near", "object_near"), ("other_hand_near", "hand_near")):
        np.testing.assert_array_equal(found[name][known], alone[of][known])
        assert found[name][[1, 3, 4]].max() == 0
    assert found["hand_near"].max() == 0
    assert scene_data.constant_arrays(candidate_views(both), surface)["other_hand_known"].tolist() == [1, 0, 1, 0, 0]


def test_beside_the_footage_a_picture_is_the_pages_own_ground() -> None:
    """A window leaves the image at the left and at the top: its picture holds the image alone."""
    clip, masks = egg_and_mug()
    view = View.of(perfect(clip, "it"), clip, masks)
    width, height = clip.size
    crops = Crops(np.array([[-width / 2, -height / 4]]), 2.0 * width, 100)
    made = scene_data.draw_page_frame(view, 0, crops, 0)
    tall = round(height * crops.zoom)
    assert made["place"] == [25, round(height / 4 * crops.zoom), 50, tall]
    assert Image.open(BytesIO(base64.b64decode(str(made["picture"])))).size == (50, tall)
