"""The energy (Eq. 5): one term per file, each answering with the same small object, ``Quadratic``."""

from getagrip.fitting.energy.hand_term import HandInCamera, HandTerm, InHand, ObjectWithHand, OnHand
from getagrip.fitting.energy.term import Energy, PosesInCamera, Quadratic, Term, no_bound
from getagrip.fitting.energy.terms import HandEnergy, Terms

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
    "no_bound",
]
