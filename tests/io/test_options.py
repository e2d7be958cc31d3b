"""Words and numbers that nothing can be are refused by name, not taken for something else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from tyro._docstrings import get_field_docstring

from getagrip import Options, SceneOptions, UsageError
from getagrip.hands import generic
from getagrip.io.options import explain_all
from getagrip.metrics.contact import ContactDefinition
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import contact_sets

WRONG: dict[str, Callable[[], object]] = {
    "unknown axis 'anywhere'; choose from free, hand": lambda: Options(axis="anywhere"),
    "unknown hands None; choose from corrected, as-given": lambda: Options(hands=None),
    "unknown init 'random'; choose from uniform, clusters, priors, poses": lambda: Options(init="random"),
    "frames must be a whole number (got '30')": lambda: Options(frames="30"),
    "inits must be a whole number (got 2.5)": lambda: Options(inits=2.5),
    "seed must be a whole number (got True)": lambda: Options(seed=True),
    "pull must be a finite number (got nan)": lambda: Options(pull=float("nan")),
    "unknown side 'Left'; choose from left, right": lambda: SceneOptions(side="Left"),
    "unknown cad 'own'; choose from exact, mean": lambda: SceneOptions(cad="own"),
    "fps must be a finite number (got inf)": lambda: SceneOptions(fps=float("inf")),
    "unknown points 'all'; choose from vertices, area, fragments": lambda: Definition(points="all"),
    "unknown rule 'some'; choose from all-pairs, first, consecutive, touch": lambda: Definition(rule="some"),
    "unknown side 'Right'; choose from left, right": lambda: generic.load("Right"),
    "unknown points 'some'; choose from vertices, area, fragments": lambda: contact_sets(None, points="some"),
    "unknown side 'both'; choose from object, hand, area": lambda: ContactDefinition("both", 0.0),
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


@dataclass(frozen=True)
class Inner:
    """A group of options."""

    size: int = 0
    """A sentence that begins on one line
    and ends on the next."""


@dataclass(frozen=True)
class Outer:
    """A command."""

    inner: Inner | None = None


def test_help_breaks_no_line_inside_a_sentence() -> None:
    explain_all(Annotated[Outer, "as of a subcommand"])
    assert get_field_docstring(Inner, "size", ()) == "A sentence that begins on one line and ends on the next."
    assert str(Inner.__doc__).startswith("A group of options.\n")
