"""The place of a folder's ledger: beside the results or, for those in an object store, in the user's state folder."""

from __future__ import annotations

import os
from hashlib import sha256
from pathlib import Path

from getagrip.io.storage import Place


def state_folder() -> Path:
    """Return the user's own folder for what is neither input nor result."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "getagrip"


def ledger_folder(out: Place, value: Path | None) -> Path:
    """Return the ledger's folder: the one ``given``, else that of the results, else one in the user's state folder.

    SQLite needs a local disk. Calls on the same results on one machine share the ledger.
    """
    if value is not None:
        return value
    if isinstance(out, Path):
        return out
    return state_folder() / f"{out.name[:40]}-{sha256(out.url.encode()).hexdigest()[:12]}"
