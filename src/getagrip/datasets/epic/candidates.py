"""Candidates of stable grasps: the first step of how EPIC-Grasps was annotated.

VISOR says in which frames a hand touches an object of one of the categories. EPIC-100's actions give the extent: it
begins with the third last action that has begun by the first of these frames, and ends with the third action that ends
from the last of them on. This rule is read off EPIC-Grasps' own bounds, nearly all of which it gives exactly.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from getagrip.datasets.epic.tables import EPIC_CATEGORIES, Action, numbering_rate
from getagrip.datasets.epic.visor import FrameMapping, VisorFrame
from getagrip.hands.model import Side

N_EXTENT_ACTIONS = 3
"""Number of actions on either side of a contact that make the extent."""


@dataclass(frozen=True)
class Contact:
    """A hand touches an object of a category, as somebody has marked it in one frame."""

    frame: int
    """EPIC's number."""
    side: Side
    category: str
    entity: str
    """VISOR's name of the object."""


@dataclass(frozen=True)
class Candidate:
    """Contacts of a hand with one object, in annotated frames that follow each other, and their rough extent."""

    video: str
    side: Side
    category: str
    entity: str
    contacts: tuple[int, ...]
    """EPIC's frame numbers, rising."""
    start_bound: int
    end_bound: int
    narrations: tuple[str, ...]
    """Actions within the extent that name the category."""

    @property
    def seconds(self) -> float:
        """How long the extent is."""
        return (self.end_bound - self.start_bound + 1) / numbering_rate(self.video)

    @property
    def name(self) -> str:
        """Name as EPIC-Grasps gives its clips: extent, first and last contact, hand, category."""
        frames = (self.start_bound, *dict.fromkeys((self.contacts[0], self.contacts[-1])), self.end_bound)
        return "_".join(map(str, (self.video, *frames, self.side, self.category)))


def category_of(entity: str) -> str | None:
    """Return the category that the name of a thing ends in ("olive oil bottle": bottle); None for other things."""
    last = re.split(r"[^a-z]+", entity.lower().strip())[-1]
    return last if last in EPIC_CATEGORIES else None


def contacts(frames: Iterable[VisorFrame], mapping: FrameMapping) -> list[list[Contact]]:
    """Return the contacts in frames, one list for every frame in which the hands are marked, in order of time.

    A hand in a glove counts as touching what the glove touches.
    """
    out: dict[int, list[Contact]] = {}
    for frame in frames:
        by_id = {a.id: a for a in frame.annotations}
        hands = [a for a in frame.annotations if a.hands]
        if not hands:
            continue
        found = out.setdefault(mapping.number(frame), [])
        for hand in hands:
            touched = by_id.get(hand.touches) if hand.touches else None
            category = None if touched is None or touched.hands else category_of(touched.name)
            if touched is not None and category is not None:
                found += [Contact(mapping.number(frame), side, category, touched.name) for side in hand.hands]
    return [out[number] for number in sorted(out)]


def find_candidates(video: str, touching: Sequence[Sequence[Contact]], actions: Sequence[Action]) -> list[Candidate]:
    """Find the candidates of a video, in order of time, from ``contacts`` and its actions in order of start.

    Contacts without an action before and after them are skipped: nothing bounds them.
    """
    runs: list[list[Contact]] = []
    open_runs: dict[tuple[Side, str], list[Contact]] = {}
    for now in touching:
        going_on: dict[tuple[Side, str], list[Contact]] = {}
        for contact in now:
            key = contact.side, contact.entity
            if key in going_on:  # hand and glove say the same
                continue
            going_on[key] = open_runs.get(key, [])
            if not going_on[key]:
                runs.append(going_on[key])
            going_on[key].append(contact)
        open_runs = going_on
    starts, stops = sorted(a.start for a in actions), sorted(a.stop for a in actions)
    found = []
    for run in runs:
        first, last = run[0], run[-1]
        before, after = bisect_right(starts, first.frame), bisect_left(stops, last.frame)
        if before == 0 or after == len(stops):
            continue
        bounds = starts[max(before - N_EXTENT_ACTIONS, 0)], stops[min(after + N_EXTENT_ACTIONS, len(stops)) - 1]
        named = [
            a.narration
            for a in actions
            if a.start <= bounds[1] and a.stop >= bounds[0] and _action_names_category(a, first)
        ]
        frames = tuple(contact.frame for contact in run)
        found.append(Candidate(video, first.side, first.category, first.entity, frames, *bounds, tuple(named)))
    return sorted(found, key=lambda candidate: candidate.contacts)


def _action_names_category(action: Action, contact: Contact) -> bool:
    """Return whether an action is about the object's category.

    Either its noun is the category, as "bottle:oil", or the narration names it.
    """
    words = re.split(r"[^a-z]+", f"{action.noun} {action.narration}".lower())
    return not {contact.category, f"{contact.category}s", f"{contact.category}es"}.isdisjoint(words)
