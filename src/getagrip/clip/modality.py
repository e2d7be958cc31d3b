"""Modalities: kinds of evidence in the images of a clip.

A modality defines its files in a clip's folder, their reading, its checks, and its terms. A new one is a file in
``getagrip/fitting/evidence`` and a line in ``MODALITIES``; a script adds its own with ``MODALITIES["mine"] = Mine()``,
another package by an entry point (``io.plugins``).
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

if TYPE_CHECKING:  # the only upward imports, of types alone
    from getagrip.checks import Check
    from getagrip.fitting.energy import Terms
    from getagrip.fitting.problem import Problem

D_co = TypeVar("D_co", bound=PerFrame, covariant=True)


class Modality(ABC, Generic[D_co]):
    """One kind of evidence, with data of type ``D_co`` at the T frames of a clip."""

    name: ClassVar[str]
    """Key of its data in ``Clip.evidence``."""
    input_checks: ClassVar[tuple[Check, ...]] = ()
    """Checks of the clip, before the fit."""
    result_checks: ClassVar[tuple[Check, ...]] = ()
    """Checks of the fitted poses."""

    @abstractmethod
    def files(self, folder: Path, frames: Sequence[str]) -> Iterable[str]:
        """Yield the names of its files for some frames in a clip's folder, each once: results depend on them."""

    @abstractmethod
    def read(self, clip: Clip) -> D_co | None:
        """Read and check the data of a clip's frames from its folder; None without any. Raises ``InputError``."""

    @abstractmethod
    def write(self, clip: Clip, folder: Path) -> None:
        """Write the data of a clip, if any, into its new folder."""

    def terms(self, problem: Problem) -> Terms | None:
        """Give terms on the object and on the hand, at the problem's frames; None without data."""
        return None

    def of(self, clip: Clip) -> D_co | None:
        """Return the data of a clip in memory; None without any."""
        return cast("D_co | None", clip.evidence.get(self.name))


BUILTIN_MODALITIES: Mapping[str, Modality[PerFrame] | str] = {
    "object-masks": "getagrip.fitting.evidence.silhouettes:ObjectMasks",
    "hand-masks": "getagrip.fitting.evidence.silhouettes:HandMasks",
    "joints-2d": "getagrip.fitting.evidence.joints_2d:HandJoints2D",
    "depth": "getagrip.fitting.evidence.depth_images:DepthImages",
    "texture": "getagrip.fitting.evidence.texture:Texture",
    "views": "getagrip.fitting.evidence.views:FurtherViews",
}
MODALITIES = PluginTable(
    "modalities",
    dict(BUILTIN_MODALITIES),
    "a Modality of the same name",
    lambda name, it: isinstance(it, Modality) and it.name == name,
)
"""Modalities by name, each as an object, or as ``module:class`` to import on first use."""


def modalities() -> tuple[Modality[PerFrame], ...]:
    """Return every modality of the table."""
    return tuple(_load_modality(entry) if isinstance(entry, str) else entry for entry in MODALITIES.working().values())


@cache
def _load_modality(entry: str) -> Modality[PerFrame]:
    return cast(Modality[PerFrame], resolve_name(entry)())


def with_evidence(clip: Clip) -> Clip:
    """Return the clip with all evidence of its frames in memory; missing data is read from its folder.

    Raises ``InputError``.
    """
    missing = [modality for modality in modalities() if modality.name not in clip.evidence]
    if clip.folder is None or not missing:
        return clip
    for modality in missing:  # one by one: depth is read around the object's masks
        clip = replace(clip, evidence={**clip.evidence, modality.name: modality.read(clip)})
    return clip


def other_evidence(clip: Clip) -> list[str]:
    """Name the evidence of plug-ins and scripts that a clip has in memory."""
    return [name for name, data in clip.evidence.items() if data is not None and name not in BUILTIN_MODALITIES]
