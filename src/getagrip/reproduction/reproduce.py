"""The base of the reproductions: the steps that datasets share, each the body of a verb of its own.

Every verb keeps what exists, so a call that is repeated continues where the last one stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.batch.share import Executors, SchedulingOptions
from getagrip.commands.command import Command
from getagrip.io.arguments import Folder
from getagrip.io.terminal import print_note

if TYPE_CHECKING:
    from getagrip.experiments.compared import ComparisonOptions
    from getagrip.fitting.options import SearchOptions
    from getagrip.reproduction.tables import PaperTable

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
        from getagrip.commands.bench import BenchGrasps
        from getagrip.experiments.sources.source import ClipFolder

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
        from getagrip.reproduction.tables import write_paper_tables

        failed = [] if good else ["some clips failed: the lines above say which; this command goes on where it stopped"]
        write_paper_tables(tables, self.out, [*about, *failed])
        return 0 if good else 1
