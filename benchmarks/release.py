"""Measure the tables of a release, at most an hour on two cores: ``python -m benchmarks.release DEXYCB YCB OTHER``.

DEXYCB, YCB and OTHER are the folders of the dataset, of its models, and of its sequences of the ten test objects. What
is in ``out/`` already is kept, so that an interrupted run goes on. ``benchmarks.results`` then puts the tables into
``results/``. The other tables there belong to studies that chose a constant or a default: their JSON names the commit
and the command that they were made by, and they are not made again.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

DEXYCB = "getagrip bench dexycb --root DEXYCB --meshes YCB --out out/dexycb"
BENCHES = {
    "dexycb-methods": DEXYCB,
    "dexycb-inputs": f"{DEXYCB} --ablation inputs",
    "dexycb-other-final": "getagrip bench dexycb --root OTHER --meshes YCB --split all --out out/dexycb-other "
    "--ablation final",
    "synthetic-methods": "getagrip bench synthetic --out out/synthetic",
    "dexycb-timelines-exact": "getagrip bench dexycb-timelines --root DEXYCB --meshes YCB --preset exact "
    "--out out/dexycb-timelines",
    "dexycb-segments-none": "getagrip bench dexycb-segments --root DEXYCB --meshes YCB --out out/dexycb-segments",
}
"""By the name of the table that each makes."""


def main(dexycb: Path, ycb: Path, other: Path) -> None:
    """Run every bench, then put its tables into ``results/``."""
    from benchmarks import results

    roots, folders = {"DEXYCB": str(dexycb), "YCB": str(ycb), "OTHER": str(other)}, []
    for command in BENCHES.values():
        words = [roots.get(word, word) for word in shlex.split(command)[1:]]
        folders.append(Path(words[words.index("--out") + 1]))
        subprocess.run([sys.executable, "-m", "getagrip", *words], check=True)
    results.main([*dict.fromkeys(folders)])


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("usage: python -m benchmarks.release DEXYCB YCB OTHER")
    main(*map(Path, sys.argv[1:]))
