"""``getagrip status``: what has become of the clips of a folder of results, also while they are at work."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.commands.command import Command
from getagrip.errors import InputError, escape_unprintable
from getagrip.io.arguments import OptionalFolder, place_argument
from getagrip.io.storage import Place

if TYPE_CHECKING:
    from getagrip.batch.entries import LedgerEntry

MAX_STATUS_ROWS = 40
"""Lines of the table; all clips are in ``summary.csv``."""
STATE_LABELS = {"failed": "failed", "done": "done", "open": "left"}
"""Words for the states."""
MAX_REASON_LENGTH = 100
"""Letters of a reason."""


@dataclass(frozen=True, kw_only=True)
class Status(Command):
    """Print which clips of a reconstruct folder are done, failed and left, and write its summary.csv and index.html.

    Each clip is listed with its IOU and probabilities. Reconstruct may still be running.
    """

    folder: Annotated[Positional[Place], place_argument("DIR"), arg(metavar="DIR", help_behavior_hint="")]
    """The --out of reconstruct."""
    ledger: OptionalFolder = None
    """The --ledger of reconstruct, if it had one. It is not changed."""

    def run(self) -> int:
        """Print the states; raise ``InputError`` where there is neither ledger nor result."""
        import heapq
        from collections import Counter

        from getagrip.batch.entries import open_existing_ledger
        from getagrip.batch.ledger import ledger_folder
        from getagrip.batch.summary import known_entries, ledger_severity_key, write_summary
        from getagrip.io.terminal import print_note, print_result

        out = self.folder
        if isinstance(out, Path) and not out.is_dir():
            raise InputError(out, "", "no such folder", "the folder of results of getagrip reconstruct")
        with open_existing_ledger(ledger_folder(out, self.ledger)) as ledger:
            states = Counter(entry.state for entry in known_entries(ledger, out))
            if not states:
                raise InputError(
                    str(out), "", "neither a ledger nor a result", "the folder of results of getagrip reconstruct"
                )
            _print_status_table(heapq.nsmallest(MAX_STATUS_ROWS, known_entries(ledger, out), key=ledger_severity_key))
            if (more := states.total() - MAX_STATUS_ROWS) > 0:
                print_result(f"and {more} more, in summary.csv")
            print_result(", ".join(f"{states[state]} {STATE_LABELS[state]}" for state in ("done", "failed", "open")))
            try:
                for path in write_summary(ledger, out):
                    print_result(str(path))
            except OSError as error:
                print_note(f"no summary is written: {error}")
        return 0


def _print_status_table(entries: list[LedgerEntry]) -> None:
    """Print a line for each clip: its state, IOU and probabilities, or why there are none."""
    from rich.text import Text

    from getagrip.batch.summary import PROBABILITY_KEYS, display_name, entry_number
    from getagrip.io.terminal import console, make_table
    from getagrip.probability import format_probability

    table = make_table()
    for heading in ("clip", "", "IOU", "right in the hand", "in the camera", ""):
        table.add_column(heading, justify="right" if heading.startswith(("IOU", "right", "in")) else "left")
    for entry in entries:
        iou, *right = (entry_number(entry, key) for key in ("iou", *PROBABILITY_KEYS))
        shown = [
            "" if iou is None else f"{iou:.2f}",
            *("" if one is None else format_probability(one) for one in right),
        ]
        why = "" if entry.state == "done" else entry.why
        why = why[:MAX_REASON_LENGTH] + "..." * (len(why) > MAX_REASON_LENGTH)
        table.add_row(
            Text(escape_unprintable(display_name(entry))),
            STATE_LABELS[entry.state],
            *shown,
            Text(escape_unprintable(why)),
        )
    console().print(table)
