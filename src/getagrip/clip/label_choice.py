"""The object, and what hides it, by the labels of images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.label_images import label_value
from getagrip.clip.mask_request import MOST_NAMED, MaskRequest, without_object
from getagrip.errors import InputError


class LabelChoice:
    """Picks the object and what hides it from labels."""

    def __init__(self, request: MaskRequest) -> None:
        """Raises ``UsageError`` for what is no label."""
        self.object = [label_value(text, "--object") for text in request.object]
        self.ignore = [label_value(text, "--ignore") for text in request.ignore]
        self.hand = [label_value(text, "--hand") for text in request.hand]
        self.only: int | None = None
        self.others: set[str] = set()

    def __call__(self, path: Path, labels: Int[ndarray, "H W"]) -> FrameMasks:
        """Raises ``InputError`` where no label is named and there are several."""
        ignored = np.isin(labels, [*self.ignore, *self.hand])
        hand = np.isin(labels, self.hand) if self.hand else None
        if self.object:
            visible = np.isin(labels, self.object)
            if not visible.any() and len(self.others) < MOST_NAMED:
                self.others.update(map(_label_name, np.unique(labels)[:MOST_NAMED].tolist()))
            return without_object(visible, ignored, hand)
        visible = (labels != 0) & ~ignored
        there = np.unique(labels[visible])
        self.only = int(there[0]) if self.only is None and there.size else self.only
        if there.size > 1 or (there.size and there[0] != self.only):
            some = ", ".join(map(_label_name, np.union1d(there, [self.only or there[0]])[:MOST_NAMED].tolist()))
            raise InputError(path, "labels", f"several, {some}", "one, or the object's named by --object")
        return without_object(visible, ignored, hand)


def _label_name(label: int) -> str:
    """A label as it can be given."""
    return str(label) if label < 2**16 else f"#{label:06x}"
