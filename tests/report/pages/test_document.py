"""A page is one file: what strangers wrote stays text in it, and only its own scripts and styles may run."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.report.pages.index_page import IndexRow, _result_sets, write_index
from getagrip.report.pages.result_page import ARRAY_TYPE_CODES, build_document, json_for_script, pack_arrays

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
