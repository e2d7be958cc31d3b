"""Measure speed, into ``results/``: ``python -m benchmarks`` for all of it, or the names of some sections."""

from __future__ import annotations

import sys
from dataclasses import replace

from benchmarks import batch, cold_start, drafts, reconstruct_speed, scaling, segment_speed, store
from benchmarks.timing import circumstances

SECTIONS = {
    "reconstruct-speed": reconstruct_speed.tables,
    "cold-start": cold_start.tables,
    "two-threads": reconstruct_speed.two_threads,
    "scaling": scaling.tables,
    "scaling-pixels": scaling.pixels,
    "segment-speed": segment_speed.tables,
    "batch": batch.tables,
    "draft-masks": drafts.masks,
    "draft-clicks": drafts.clicks,
    "draft-landmarks": drafts.landmarks,
    "draft-example": drafts.example,
    "draft-results": drafts.results,
}


def main(names: list[str]) -> None:
    """Measure the named sections, all of them if none is named, and keep the tables of each as soon as it is done."""
    unknown = sorted(set(names) - set(SECTIONS))
    if unknown:
        sys.exit(f"unknown section {', '.join(unknown)}; choose from {', '.join(SECTIONS)}")
    for section in names or SECTIONS:
        made = circumstances(f"python -m benchmarks {section}")
        for name, table in SECTIONS[section]().items():
            print(store.write(name, replace(table, made=made)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
