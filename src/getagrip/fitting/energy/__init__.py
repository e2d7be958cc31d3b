"""The energy (Eq. 5): one term per file, each answering with the same small object, ``Quadratic``."""

from getagrip.fitting.energy.term import Energy, PosesInCamera, Quadratic, Term, Terms, no_bound

__all__ = ["Energy", "PosesInCamera", "Quadratic", "Term", "Terms", "no_bound"]
