"""The base of the reproductions: steps that run other commands, and required files with their download pages.

Every command keeps existing results, so a repeated call continues where the last one stopped.
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
    from getagrip.bench.options import ComparisonOptions
    from getagrip.cli.reproduce.paper_tables import PaperTable
    from getagrip.fitting.options import SearchOptions

AUTHORS_CODE_URL = "https://github.com/zhifanzhu/objects-along-hit"


@dataclass(frozen=True)
class RequiredFile:
    """A file or folder of another project."""

    what: str
    places: tuple[str, ...]
    """Possible paths below the user's folders; the first existing one is used."""
    source: str
    """Download page."""
    holds: tuple[str, ...] = ()
    """Patterns of contents, one of which a folder must match; empty for a file."""

    def find(self, roots: Sequence[Path]) -> Path | None:
        """Return the path; None where it is missing."""
        for place in (root / place for root in roots for place in self.places):
            if place.is_file() if not self.holds else any(next(place.glob(held), None) for held in self.holds):
                return place
        return None

    @property
    def advice(self) -> str:
        """Describe the file, its download page and its path."""
        place = Path("ROOT", self.places[0], *self.holds[:1])
        return f"{self.what}: {self.source}; put it at {place.as_posix()}"


MANO_DOWNLOAD = RequiredFile(
    "MANO", (".", "mano", "mano_v1_2/models"), "https://mano.is.tue.mpg.de, after registration", ("MANO_RIGHT.pkl",)
)


def find_required(
    needs: dict[str, RequiredFile], roots: Sequence[Path], later: Iterable[RequiredFile] = ()
) -> dict[str, Path]:
    """Return the path of each required file. Raises ``UsageError`` for missing files, after printing how to get them.

    Missing files among ``later`` are printed too.
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
"""Our groups, after the paper's, with their methods."""


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
        """Run a command, and return whether it succeeded, with a warning or without."""
        from getagrip.batch.import_dataset import CAMERA_WARNING_STATUS

        print_note(f"== {words}")
        return command.run() in (0, CAMERA_WARNING_STATUS)

    def bench(self, name: str, search: SearchOptions, compared: ComparisonOptions) -> bool:
        """Compare methods on the clips into ``bench/NAME.json``, and return whether all clips succeeded."""
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
        """Write the tables; return 0 if all steps were ``good``, else 1."""
        from getagrip.cli.reproduce.paper_tables import write_paper_tables

        failed = [] if good else ["some clips failed, as listed above; call again to continue with them"]
        write_paper_tables(tables, self.out, [*about, *failed])
        return 0 if good else 1
