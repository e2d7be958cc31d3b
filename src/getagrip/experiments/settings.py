"""One step of an ablation, an ablation, and what is compared where nothing is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from getagrip.experiments.changes import UNCHANGED, Change
from getagrip.fitting.methods import METHODS
from getagrip.metrics.contact import ContactDefinition

REFERENCE_METHOD = "one-dof"
"""Ours after the paper, the plain hinge: what the others are compared with."""
DEFAULT_METHODS = tuple(name for name, method in METHODS.own.items() if not method.slow)
"""Methods that are compared where none is named; those of other packages only where they are."""
DEFAULT_CONTACT_DEFINITIONS = (ContactDefinition("object", 0.010),)
"""Definitions of contact (docs/metrics.md) in the tables, unless a run or a setting says otherwise."""


@dataclass(frozen=True)
class Setting:
    """One step of an ablation."""

    label: str
    options: Mapping[str, Any] = field(default_factory=dict)
    """``Options`` that differ from those of the run."""
    change: Change = UNCHANGED
    contact: ContactDefinition | None = None
    """Definition of contact in the metrics; None: the run's."""


@dataclass(frozen=True)
class Ablation:
    """Settings that are compared with each other, for each of a few methods."""

    title: str
    usual: str | None
    """Label of the setting that the others are compared with; None: methods are compared in each setting."""
    settings: tuple[Setting, ...]
    methods: tuple[str, ...] = (REFERENCE_METHOD, "soft-hinge")
    """Unless others are named."""
