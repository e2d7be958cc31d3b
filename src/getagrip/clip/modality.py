"""Modalities: the kinds of evidence that pixels give about a clip.

A modality is all that is known of one kind: its files in a clip's folder, how they are read at some frames, its checks,
and the terms that it gives. A new one is a file in ``getagrip/evidence`` and a line in ``MODALITIES``; a script adds
its own with ``MODALITIES["mine"] = Mine()``, another package by an entry point (``io.plugins``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar, cast

from getagrip.clip.clip import Clip, PerFrame
from getagrip.io.plugins import PluginTable

if TYPE_CHECKING:  # the only upward look: what a modality answers with is defined where it is used
    from getagrip.checks import Check
    from getagrip.fitting.energy import Terms
    from getagrip.fitting.problem import Problem

D_co = TypeVar("D_co", bound=PerFrame, covariant=True)


class Modality(ABC, Generic[D_co]):
    """One kind of evidence, whose data at the T frames of a clip is a ``D_co``."""

    name: ClassVar[str]
    """Key of its data in ``Clip.evidence``."""
    input_checks: ClassVar[tuple[Check, ...]] = ()
    """Checks of the clip, before the fit."""
    result_checks: ClassVar[tuple[Check, ...]] = ()
    """Checks of the poses that were found."""

    @abstractmethod
    def files(self, folder: Path, frames: Sequence[str]) -> Iterable[str]:
        """Yield the names of its files in a clip's folder that these frames need, each once: results depend on them."""

    @abstractmethod
    def read(self, clip: Clip) -> D_co | None:
        """Read and check the data of a clip's frames from its folder; None where it has none. Raises ``InputError``."""

    @abstractmethod
    def write(self, clip: Clip, folder: Path) -> None:
        """Write the data of a clip into its new folder, where there is some."""

    def terms(self, problem: Problem) -> Terms | None:
        """Give terms on the object and on the hand, at the problem's frames; None where there is no data."""
        return None

    def of(self, clip: Clip) -> D_co | None:
        """Return the data that a clip has in memory."""
        return cast("D_co | None", clip.evidence.get(self.name))


BUILTIN_MODALITIES: Mapping[str, Modality[PerFrame] | str] = {
    "object-masks": "getagrip.fitting.evidence.silhouettes:ObjectMasks",
    "hand-masks": "getagrip.fitting.evidence.silhouettes:HandMasks",
    "joints-2d": "getagrip.fitting.evidence.joints_2d:HandJoints2D",
    "depth": "getagrip.fitting.evidence.depth_images:DepthImages",
}
MODALITIES = PluginTable(
    "modalities",
    dict(BUILTIN_MODALITIES),
    "a Modality of the same name",
    lambda name, it: isinstance(it, Modality) and it.name == name,
)
"""Every modality by its name, or where its class is, which is imported when it is first needed."""


def modalities() -> tuple[Modality[PerFrame], ...]:
    """Return every modality of the table."""
    return tuple(_load_modality(entry) if isinstance(entry, str) else entry for entry in MODALITIES.working().values())


@cache
def _load_modality(entry: str) -> Modality[PerFrame]:
    """Return the modality of a class named as ``module:class``."""
    return cast(Modality[PerFrame], resolve_name(entry)())


def with_evidence(clip: Clip) -> Clip:
    """Return the clip with all evidence of its frames in memory; missing data is read from its folder.

    Raises ``InputError``.
    """
    missing = [modality for modality in modalities() if modality.name not in clip.evidence]
    if clip.folder is None or not missing:
        return clip
    for modality in missing:  # each may look at those before it: depth is read about the object's masks
        clip = replace(clip, evidence={**clip.evidence, modality.name: modality.read(clip)})
    return clip


def other_evidence(clip: Clip) -> list[str]:
    """Name the evidence that a clip has in memory besides its masks."""
    return [name for name, data in clip.evidence.items() if data is not None and name not in BUILTIN_MODALITIES]
