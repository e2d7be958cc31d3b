"""``getagrip status``: what has become of the clips of a folder of results, also while they are at work."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.commands.command import Command
from getagrip.errors import InputError, cleaned
from getagrip.io.arguments import OptionalFolder, placed
from getagrip.io.storage import Place

if TYPE_CHECKING:
    from getagrip.batch.entries import Entry

MOST = 40
"""Lines of the table; all clips are in ``summary.csv``."""
CALLED = {"failed": "failed", "done": "done", "open": "left"}
"""Words for the states."""
LONGEST = 100
"""Letters of a reason."""


@dataclass(frozen=True, kw_only=True)
class Status(Command):
    """Print which clips of a reconstruct folder are done, failed and left, and write its summary.csv and index.html.

    Each clip is listed with its IOU and probabilities. Reconstruct may still be running.
    """

    folder: Annotated[Positional[Place], placed("DIR"), arg(metavar="DIR", help_behavior_hint="")]
    """The --out of reconstruct."""
    ledger: OptionalFolder = None
    """The --ledger of reconstruct, if it had one. It is not changed."""

    def run(self) -> int:
        """Print the states; raise ``InputError`` where there is neither ledger nor result."""
        import heapq
        from collections import Counter

        from getagrip.batch.entries import ledger_there
        from getagrip.batch.ledger import ledger_folder
        from getagrip.batch.summary import badness, known_entries, write_summary
        from getagrip.io.terminal import report, say

        out = self.folder
        if isinstance(out, Path) and not out.is_dir():
            raise InputError(out, "", "no such folder", "the folder of results of getagrip reconstruct")
        with ledger_there(ledger_folder(out, self.ledger)) as ledger:
            states = Counter(entry.state for entry in known_entries(ledger, out))
            if not states:
                raise InputError(
                    str(out), "", "neither a ledger nor a result", "the folder of results of getagrip reconstruct"
                )
            _print_table(heapq.nsmallest(MOST, known_entries(ledger, out), key=badness))
            if (more := states.total() - MOST) > 0:
                say(f"and {more} more, in summary.csv")
            say(", ".join(f"{states[state]} {CALLED[state]}" for state in ("done", "failed", "open")))
            try:
                for path in write_summary(ledger, out):
                    say(str(path))
            except OSError as error:
                report(f"no summary is written: {error}")
        return 0


def _print_table(entries: list[Entry]) -> None:
    """Print a line for each clip: its state, IOU and probabilities, or why there are none."""
    from rich.text import Text

    from getagrip.batch.summary import PROBABILITIES, number_of, shown_name
    from getagrip.io.terminal import console, plain_table
    from getagrip.probability import percent

    table = plain_table()
    for heading in ("clip", "", "IOU", "right in the hand", "in the camera", ""):
        table.add_column(heading, justify="right" if heading.startswith(("IOU", "right", "in")) else "left")
    for entry in entries:
        iou, *right = (number_of(entry, key) for key in ("iou", *PROBABILITIES))
        shown = ["" if iou is None else f"{iou:.2f}", *("" if one is None else percent(one) for one in right)]
        why = "" if entry.state == "done" else entry.why
        why = why[:LONGEST] + "..." * (len(why) > LONGEST)
        table.add_row(Text(cleaned(shown_name(entry))), CALLED[entry.state], *shown, Text(cleaned(why)))
    console().print(table)
