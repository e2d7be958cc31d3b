"""Shapes in type hints are checked while the tests run: what does not fit is refused, in what is given and returned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry import se3
from helpers.shapes import checked

Points = Float[ndarray, "n 3"]


@checked
def taken(
    points: Points | None,
    index: Int[ndarray, "m"] | int = 0,
    *more: Points,
    parts: Sequence[Points] = (),
    named: Mapping[str, Points] | None = None,
    pair: tuple[Float[ndarray, "n"], int] | None = None,
    answer: Any = None,
) -> tuple[Points, ...] | None:
    return answer


TWO, THREE = np.zeros((2, 3)), np.zeros((3, 3))


def test_what_fits_is_passed_on() -> None:
    assert taken(None) is None
    answer = (TWO, THREE)
    given = taken(TWO, np.arange(5), TWO, parts=[TWO], named={"a": TWO}, pair=(np.zeros(2), 1), answer=answer)
    assert given is answer


@pytest.mark.parametrize(
    ("args", "kwargs", "words"),
    [
        ((np.zeros((2, 4)),), {}, r"points is ndarray float64 \(2, 4\), expected .*n 3"),
        ((np.zeros((2, 3), int),), {}, "points is ndarray int64"),
        (([[0.0, 0.0, 0.0]],), {}, "points is list"),
        ((TWO, 0.5), {}, "index is float"),
        ((TWO, 0, THREE), {}, "more is tuple"),
        ((TWO,), {"parts": [THREE]}, "parts is list"),  # n is 2 in this call
        ((TWO,), {"named": {"a": THREE}}, "named is dict"),
        ((TWO,), {"pair": (np.zeros(3), 1)}, "pair is tuple"),
        ((TWO,), {"pair": (np.zeros(2),)}, "pair is tuple"),
        ((TWO,), {"answer": (THREE,)}, "returns tuple"),
        ((TWO,), {"answer": TWO}, "returns ndarray"),
    ],
)
def test_what_does_not_is_refused(args: tuple[Any, ...], kwargs: dict[str, Any], words: str) -> None:
    with pytest.raises(TypeError, match=words):
        taken(*args, **kwargs)


def test_functions_of_the_package_are_checked_in_their_first_call() -> None:
    with pytest.raises(TypeError, match="transform: X is "):
        se3.transform(np.eye(4), np.zeros((2, 4)))
