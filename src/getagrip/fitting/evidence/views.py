"""Further views (``views``): the evidence of other calibrated cameras on the same hand and object."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.clip import Clip, Modality
from getagrip.clip.views import VIEWS_KEY, Views, read_views, view_files, write_view
from getagrip.fitting.energy import Energy, Terms

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.energy.in_view import ViewedEnergy
    from getagrip.fitting.problem import Problem


class FurtherViews(Modality[Views]):
    """Masks, depth and joints of other cameras."""

    name = VIEWS_KEY

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return view_files(folder, frames)

    def read(self, clip: Clip) -> Views | None:
        return read_views(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        for view in () if (views := self.of(clip)) is None else views.each:
            write_view(view, clip, folder)

    def terms(self, problem: Problem) -> Terms | None:
        from getagrip.fitting.energy.in_view import ViewedEnergy

        objects, hands = list[ViewedEnergy](), list[ViewedEnergy]()
        for view in problem.views:
            for terms in problem.in_view(view).evidence:
                for energy, energies in ((terms.object, objects), (terms.hand, hands)):
                    if energy is not None:
                        energies.append(ViewedEnergy(energy, view.name, view.rows, view.T_view_cam))
        return Terms(_sum_of(objects), _sum_of(hands)) if objects or hands else None


def _sum_of(energies: Sequence[ViewedEnergy]) -> Energy | None:
    """Return the energy of all views; None without any."""
    return (lambda level, index: [term for one in energies for term in one(level, index)]) if energies else None
