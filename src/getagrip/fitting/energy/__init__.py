"""The energy (Eq. 5): one term per file, each answering with the same small object, ``Quadratic``."""

from getagrip.fitting.energy.term import (
    Energy,
    HandEnergy,
    HandInCamera,
    HandTerm,
    InHand,
    ObjectWithHand,
    OnHand,
    PosesInCamera,
    Quadratic,
    Term,
    Terms,
    Ties,
    no_bound,
)

__all__ = [
    "Energy",
    "HandEnergy",
    "HandInCamera",
    "HandTerm",
    "InHand",
    "ObjectWithHand",
    "OnHand",
    "PosesInCamera",
    "Quadratic",
    "Term",
    "Terms",
    "Ties",
    "no_bound",
]
