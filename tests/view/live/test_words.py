"""Texts from files are nothing but texts on the page."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from getagrip.probability import Probability
from getagrip.view.live import words
from helpers.two_candidates import column


@given(st.text(max_size=40))
def test_quoted_texts_hold_no_tags_and_no_markup(text: str) -> None:
    made = words.quoted(text)
    assert "<" not in made
    assert "\n" not in made
    for mark in "*_`[]!":
        assert made.count(mark) == made.count("\\" + mark) == text.count(mark)


def test_the_summary_says_what_is_known_and_quotes_it() -> None:
    it = column()
    result = replace(it.view.result, message="<img src=x onerror=alert(1)>", notes=("the *scale* is a guess",))
    result = replace(result, probability_right=Probability(0.93, "within <10> %"))
    result = replace(result, probability_right_in_camera=Probability(0.97, "camera"))
    it = replace(it, view=replace(it.view, result=result))
    text = words.about_clip(it) + words.about_result(it)
    assert "ambiguous" in text
    assert "<img" not in text
    assert r"\*scale\* is a guess" in text
    assert "mug in a" in text
    assert "probability right in the camera: 97 %" in text
    assert text.count("10 % of the diameter") == 1
    assert "within" not in text
    meanings = "**right in the hand**: within &lt;10\\> %\n\n**right in the camera**: camera"
    assert words.about_probabilities(it) == meanings
    assert words.about_probabilities(column()) == ""


def test_candidates_are_named_by_their_energy() -> None:
    it = column()
    assert words.candidate_name(it, 0) == "1: lowest energy"
    assert words.candidate_name(it, 1) == "2: energy +50 %"
