"""Measure and write docs/benchmarks.md: ``python -m benchmarks`` for all of it, or the names of some sections."""

from __future__ import annotations

import sys

from benchmarks import (
    against_deodr,
    beside_commit,
    busy_neighbour,
    cpus,
    large_meshes,
    page,
    reconstruct_speed,
    scaling,
    segment_speed,
    two_threads,
)

SECTIONS = {
    "reconstruct-speed": reconstruct_speed.section,
    "beside-commit": beside_commit.section,
    "large-meshes": large_meshes.section,
    "busy-neighbour": busy_neighbour.section,
    "two-threads": two_threads.section,
    "against-deodr": against_deodr.section,
    "scaling": scaling.section,
    "segment-speed": segment_speed.section,
    "cpus": cpus.section,
}


def main(names: list[str]) -> None:
    """Measure the named sections, all of them if none is named, and put each into the page as soon as it is done."""
    unknown = sorted(set(names) - set(SECTIONS))
    if unknown:
        sys.exit(f"no such section: {', '.join(unknown)}; expected some of {', '.join(SECTIONS)}")
    for name in names or SECTIONS:
        before = page.circumstances()
        text = SECTIONS[name]()
        page.write(name, f"{before}\n\n{text}")
        print(f"## {name}\n\n{before}\n\n{text}\n", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
