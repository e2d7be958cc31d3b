"""The files of others that a reproduction needs: where they are looked for, and where to get those that are missing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from getagrip.errors import UsageError
from getagrip.io.terminal import print_note

AUTHORS_CODE_URL = "https://github.com/zhifanzhu/objects-along-hit"


@dataclass(frozen=True)
class RequiredFile:
    """A file or folder of others."""

    what: str
    places: tuple[str, ...]
    """Paths below any of the given folders; the first that is there counts."""
    source: str
    """Place to get it from."""
    holds: tuple[str, ...] = ()
    """Patterns of which a folder has at least one; none for a file."""

    def find(self, roots: Sequence[Path]) -> Path | None:
        """Return its place; None where it is missing."""
        for place in (root / place for root in roots for place in self.places):
            if place.is_file() if not self.holds else any(next(place.glob(held), None) for held in self.holds):
                return place
        return None

    @property
    def advice(self) -> str:
        """Say what it is, how it has to be called, and where to get it."""
        place = Path("ROOT", self.places[0], *self.holds[:1])  # other names that are found need not be made
        return f"{self.what}: {self.source}; put it at {place.as_posix()}"


MANO_DOWNLOAD = RequiredFile(
    "MANO", (".", "mano", "mano_v1_2/models"), "https://mano.is.tue.mpg.de, after registration", ("MANO_RIGHT.pkl",)
)


def find_required(
    needs: dict[str, RequiredFile], roots: Sequence[Path], later: Iterable[RequiredFile] = ()
) -> dict[str, Path]:
    """Return the place of each. Raises ``UsageError`` where some are missing; where to get each is printed before.

    What is needed ``later`` is printed with it.
    """
    places = {name: need.find(roots) for name, need in needs.items()}
    if missing := [need for name, need in needs.items() if places[name] is None]:
        for need in missing:
            print_note(f"missing: {need.advice}")
        for need in later:
            if need.find(roots) is None:
                print_note(f"needed later: {need.advice}")
        where = ", ".join(map(str, roots)) or "ROOT, which names no folder"
        raise UsageError(f"missing in {where}: {', '.join(need.what for need in missing)}")
    return {name: place for name, place in places.items() if place is not None}
