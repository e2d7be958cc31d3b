"""``getagrip status``: what has become of the clips of a folder of results, also while they are at work."""

from __future__ import annotations

import heapq
from collections import Counter
from pathlib import Path

from getagrip.batch.entries import Entry, ledger_there
from getagrip.batch.ledger_place import ledger_folder
from getagrip.batch.summary import PROBABILITIES, badness, known_entries, number_of, shown_name, write_summary
from getagrip.errors import InputError, cleaned
from getagrip.io.storage import Place
from getagrip.io.terminal import console, plain_table, report, say
from getagrip.probability import percent

MOST = 40
"""Lines of the table; all clips are in ``summary.csv``."""
CALLED = {"failed": "failed", "done": "done", "open": "left"}
"""What states are called."""
LONGEST = 100
"""Letters of a reason."""


def status(out: Place, given: Path | None) -> int:
    """Print how many clips are done, failed and left, and the worst of them; write summary and index page.

    ``given`` is the ledger's folder, where the user has named one; it is not changed. Raises ``InputError`` where there
    is neither ledger nor result.
    """
    if isinstance(out, Path) and not out.is_dir():
        raise InputError(out, "", "no such folder", "the folder of results of getagrip reconstruct")
    with ledger_there(ledger_folder(out, given)) as ledger:
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
    """A line for each clip: its state, IOU and probabilities, or why there are none."""
    from rich.text import Text

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
