"""Words for a call that a library ends from within, as Ray does where its cluster dies: another process says them."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from getagrip.batch.entries import open_existing_ledger
from getagrip.io import interrupts, own_python
from getagrip.io.terminal import print_note


@contextmanager
def report_on_death(folder: Path, called: str) -> Iterator[None]:
    """Have what is done and left of a ledger's tasks said if this process ends within the block.

    ``folder`` is the ledger's, ``called`` what its tasks are, in the plural.
    """
    again = shlex.join(["getagrip", *sys.argv[1:]]) if interrupts.is_program() else "the same call"
    words = own_python.python_command("-m", "getagrip.batch.last_words", str(folder.absolute()), called, again)
    watcher = subprocess.Popen(words, stdin=subprocess.PIPE, start_new_session=True)  # no Ctrl-C reaches it
    try:
        yield
    finally:
        watcher.communicate(b"ended")


def main(folder: str, called: str, again: str) -> None:
    """Wait for the end of the process that has started this one; say what it could not."""
    if sys.stdin.buffer.read():
        return
    with open_existing_ledger(Path(folder)) as ledger:
        states = Counter[str]() if ledger is None else Counter(entry.state for entry in ledger.entries())
    done = (
        f"{states['done']} of {states.total()} {called} are done, {states['failed']} failed, {states['open']} are left"
    )
    why = "Ray's cluster has died and ended this call, or it was killed"
    print_note(f"getagrip: {why}: {done}; results are whole; on a cluster that runs, this goes on: {again}")


if __name__ == "__main__":
    main(*sys.argv[1:])
