"""The base of the reproductions: the steps that datasets share, each the body of a verb of its own.

Every verb keeps what exists, so a call that is repeated continues where the last one stopped.

The files of others that a reproduction needs: where they are looked for, and where to get those that are missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.batch.scheduling import Executors, SchedulingOptions
from getagrip.cli.command import Command
from getagrip.errors import UsageError
from getagrip.io.options import Folder
from getagrip.io.terminal import print_note

if TYPE_CHECKING:
    from getagrip.bench.ablations import ComparisonOptions
    from getagrip.cli.reproduce.paper_tables import PaperTable
    from getagrip.fitting.options import SearchOptions

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


OWN_METHODS = {"1-DoF, ours": "one-dof", "soft hinge": "soft-hinge"}
"""Groups of ours that follow the paper's, and their methods."""
WARNING_EXIT_STATUS = 3
"""Exit status of an import that has succeeded with a warning."""


@dataclass(frozen=True, kw_only=True)
class Reproduce(Command):
    """Options and steps of all reproductions."""

    roots: Annotated[Positional[tuple[Path, ...]], arg(metavar="ROOT...", help_behavior_hint="")] = ()
    """Folders that together hold what is needed; what is missing is listed, with where to get it."""
    out: Folder
    """Folder of clips, results and tables. Called again with the same folder, it continues where it stopped."""
    count: Annotated[int | None, arg(name="clips", metavar="N", help_behavior_hint="(default: all)")] = None
    """Compare methods on N clips, evenly sampled: the paper's own methods take half a minute a clip each."""
    share: Executors = field(default_factory=SchedulingOptions)

    def step(self, words: str, command: Command) -> bool:
        """Run a verb, and return whether all of it succeeded."""
        print_note(f"== {words}")
        return command.run() in (0, WARNING_EXIT_STATUS)

    def bench(self, name: str, search: SearchOptions, compared: ComparisonOptions) -> bool:
        """Compare methods on the clips into ``bench/NAME.json``, and return whether nothing failed."""
        from getagrip.bench.sources.source import ClipFolder
        from getagrip.cli.bench import BenchGrasps

        bench = BenchGrasps[ClipFolder](
            source=ClipFolder(folder=self.out / "clips"), out=self.out / "bench", count=self.count, search=search,
            json=self.page(name), compared=compared, share=self.share, debug=self.debug,
        )  # fmt: skip
        return self.step(f"bench: {name}", bench)

    def page(self, name: str) -> Path:
        """Return the file of a bench's numbers."""
        return self.out / "bench" / f"{name}.json"

    def write(self, tables: Sequence[PaperTable], good: bool, about: Sequence[str]) -> int:
        """Write the tables; return 0, or 1 where some of it failed."""
        from getagrip.cli.reproduce.paper_tables import write_paper_tables

        failed = [] if good else ["some clips failed: the lines above say which; this command goes on where it stopped"]
        write_paper_tables(tables, self.out, [*about, *failed])
        return 0 if good else 1
