"""What the page says about a column, as Markdown. Texts that come from files are quoted: they may be anything."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from getagrip.probability import RIGHT
from getagrip.view.figures.kind import about
from getagrip.view.live.column import Column
from getagrip.view.live.evidence import Numbers, arguments

HEADINGS = ("no.", "energy", "IOU %", "gap mm", "depth mm", "SCA %", "ADD mm")


def quoted(text: str) -> str:
    """A text that Markdown and HTML take for nothing but a text."""
    return re.sub(r"([\\`*_{}\[\]<>()#+!|&~:])", r"\\\1", " ".join(text.split())).replace("\\<", "&lt;")


def about_clip(column: Column) -> str:
    """Which clip it is, what it shows, and what of it is a guess."""
    lines = [f"**{quoted(column.view.clip.name)}**", quoted("  ·  ".join(about(column.view)))]
    if not column.posed:
        lines.append("no result and no ground truth: the hand alone")
    return "\n\n".join(lines)


def about_result(column: Column) -> str:
    """Which method found it, how the fit ended, and what the checks have found; of a clip, that it is the truth."""
    result = column.view.result
    if not column.is_result:
        return quoted(column.name) if column.posed else ""
    overlap = "" if np.isnan(result.mean_iou) else f", mean IOU {100 * result.mean_iou:.1f} %"
    lines = [f"**{quoted(column.name)}**{overlap}", quoted(result.message)]
    lines += [f"probability right {where}: {right}" for where, right in result.probabilities.items()]
    lines += [RIGHT] * bool(result.probabilities)
    if result.ambiguous:
        lines.append("**ambiguous**: another candidate explains the masks almost as well")
    lines += [f"**{'serious' if f.serious else 'note'}**: {quoted(f.message)}" for f in result.findings]
    lines += [f"note: {quoted(note)}" for note in result.notes]
    return "\n\n".join(lines)


def about_probabilities(column: Column) -> str:
    """What its probabilities mean, at length; empty where it has none."""
    known = column.view.result.probabilities
    return "\n\n".join(f"**right {where}**: {quoted(right.meaning)}" for where, right in known.items())


def candidate_name(column: Column, rank: int) -> str:
    """What the list of candidates calls one."""
    energy = column.candidates.energy
    excess = 100.0 * (energy[rank] / energy.min() - 1.0) if energy.min() > 0.0 else float("nan")
    more = "lowest energy" if rank == int(energy.argmin()) else f"energy +{excess:.0f} %"
    return f"{rank + 1}: {more}"


def comparison(known: Sequence[Numbers], rank: int) -> str:
    """A table of all candidates, and what speaks for and against the one that is shown."""
    if not known:
        return "measuring ..."
    rows = [[_bold(n + 1, n == rank), *_cells(it)] for n, it in enumerate(known)]
    shown = [k for k in range(len(HEADINGS)) if any(row[k] != "-" for row in rows)]
    table = [[HEADINGS[k] for k in shown], ["---"] * len(shown), *([row[k] for k in shown] for row in rows)]
    lines = ["| " + " | ".join(row) + " |" for row in table]
    pro, con = arguments(known, rank)
    if len(known) == 1:
        con.append("no other distinct candidate was found to compare it with")
    lists = [("Speaks for it", pro), ("Speaks against it", con)]
    parts = [f"\n**{head}**\n\n" + "\n".join(f"- {quoted(text)}" for text in texts) for head, texts in lists if texts]
    return "\n".join(lines) + "\n" + "\n".join(parts)


def _cells(it: Numbers) -> list[str]:
    """What stands in a candidate's line, under all but the first of ``HEADINGS``."""
    whole = {"energy": it.energy, "SCA %": 100 * it.sca}
    fine = {"IOU %": 100 * it.iou, "gap mm": it.gap, "depth mm": it.depth, "ADD mm": it.add}
    texts = {key: f"{value:.0f}" for key, value in whole.items()} | {k: f"{value:.1f}" for k, value in fine.items()}
    return ["-" if texts[key] == "nan" else texts[key] for key in HEADINGS[1:]]


def _bold(number: int, shown: bool) -> str:
    return f"**{number}**" if shown else str(number)
