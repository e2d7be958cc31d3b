"""Words and numbers that nothing can be are refused by name, not taken for something else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from getagrip import Options, SceneOptions, UsageError
from getagrip.grasps.definition import Definition
from getagrip.grasps.stable import contact_sets
from getagrip.hands import generic
from getagrip.metrics.contact import ContactDefinition

WRONG: dict[str, Callable[[], object]] = {
    "axis: got 'anywhere', expected one of free, hand": lambda: Options(axis="anywhere"),
    "hands: got None, expected one of corrected, as-given": lambda: Options(hands=None),
    "init: got 'random', expected one of uniform, clusters, priors": lambda: Options(init="random"),
    "frames: got '30', expected a whole number": lambda: Options(frames="30"),
    "inits: got 2.5, expected a whole number": lambda: Options(inits=2.5),
    "seed: got True, expected a whole number": lambda: Options(seed=True),
    "pull: got nan, expected a finite number": lambda: Options(pull=float("nan")),
    "side: got 'Left', expected one of left, right": lambda: SceneOptions(side="Left"),
    "cad: got 'own', expected one of exact, mean": lambda: SceneOptions(cad="own"),
    "fps: got inf, expected a finite number": lambda: SceneOptions(fps=float("inf")),
    "points: got 'all', expected one of vertices, area, fragments": lambda: Definition(points="all"),
    "rule: got 'some', expected one of all-pairs, first, consecutive, touch": lambda: Definition(rule="some"),
    "side: got 'Right', expected one of left, right": lambda: generic.load("Right"),
    "points: got 'some', expected one of vertices, area, fragments": lambda: contact_sets(None, points="some"),
    "side: got 'both', expected one of object, hand, area": lambda: ContactDefinition("both", 0.0),
}


@pytest.mark.usefixtures("users_hints")
@pytest.mark.parametrize("message", WRONG)
def test_what_no_option_can_be_is_named(message: str) -> None:
    with pytest.raises(UsageError) as caught:
        WRONG[message]()
    assert str(caught.value) == message


@pytest.mark.usefixtures("users_hints")
def test_numbers_of_numpy_are_numbers() -> None:
    assert Options(seed=np.int64(3), push=np.float32(0.5), pull=1).seed == 3
