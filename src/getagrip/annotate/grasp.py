"""A finished grasp or a whole interaction that somebody has marked, and its footage."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import cast

from getagrip.annotate.footage import Footage
from getagrip.annotate.interaction import Interaction
from getagrip.annotate.marks import Mark
from getagrip.annotate.tasks import Task
from getagrip.annotate.versions import RefusedError
from getagrip.hands.model import Side

MAX_GRASP_NAME_LENGTH = 100
"""Characters of a grasp's name in files."""


@dataclass(frozen=True)
class Grasp:
    """A finished grasp, or a whole interaction, and the footage that shows it."""

    task: Task
    footage: Footage
    mark: Mark
    whole: Interaction | None = None
    """Segments of a whole interaction."""

    @property
    def extent(self) -> tuple[int, int]:
        """First and last frame. Raises ``RefusedError`` where they are not marked yet."""
        if self.mark.interval is None:
            raise RefusedError("mark the start and the end of the grasp first")
        return self.mark.interval

    @property
    def side(self) -> Side:
        """Which hand. Raises ``RefusedError`` where the mark does not have it."""
        if self.mark.side not in ("left", "right"):
            raise RefusedError("say first which hand holds the object")
        return cast(Side, self.mark.side)

    @property
    def name(self) -> str:
        """Name of its files; names that had to be cut or changed for that differ by a checksum."""
        parts = [self.mark.annotator, self.task.video, self.mark.start_number, self.mark.end_number, self.side]
        whole = "-".join(map(str, parts))
        plain = re.sub(r"[^\w.-]", "_", whole).lstrip(".")[:MAX_GRASP_NAME_LENGTH]
        return plain if plain == whole else f"{plain}-{_name_checksum(whole)[:8]}"

    @property
    def path(self) -> Path:
        """Path of the footage, which is open."""
        assert self.task.path is not None
        return self.task.path


def _name_checksum(name: str) -> str:
    return sha256(json.dumps([name]).encode()).hexdigest()[:16]
