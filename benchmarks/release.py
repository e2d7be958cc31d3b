"""Measure the tables of a release: ``python -m benchmarks.release DEXYCB YCB``.

DEXYCB and YCB are the folders of the dataset and of its models. The most important tables come first, and each is put
into ``results/`` as soon as it is measured. Existing results in ``out/`` are kept, so the same call continues a run
that was cut off. ``--clips N`` tries every section on N clips and puts nothing into ``results/``. Nothing else runs the
test objects, and each of their runs is noted before it starts (``benchmarks.test_runs``). The other tables
there belong to studies that chose a constant or a default: their JSON names the commit and the command that they were
made by, and they are not made again.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

DEXYCB = "getagrip bench dexycb --root DEXYCB --meshes YCB --out out/dexycb"
BENCHES = {
    "dexycb-inputs": f"{DEXYCB} --ablation inputs",
    "dexycb-methods": DEXYCB,
    "dexycb-final": f"{DEXYCB} --ablation final --methods paper --clips 35",
    "dexycb-departures": f"{DEXYCB} --ablation departures --clips 35",
    "dexycb-paper-methods": "getagrip bench dexycb --root DEXYCB --meshes YCB --out out/dexycb-paper --clips 35 "
    "--methods paper-single-frame paper-homan paper-static paper-dynamic paper single-frame homan static dynamic "
    "one-dof soft-hinge",
    "dexycb-views": f"{DEXYCB} --views 1 2 4",
    "dexycb-wrong-evidence": f"{DEXYCB} --ablation wrong-evidence",
    "synthetic-methods": "getagrip bench synthetic --clips 66 --out out/synthetic",
    "dexycb-segments-none": "getagrip bench dexycb-segments --root DEXYCB --meshes YCB --clips 48 "
    "--out out/dexycb-segments",
    "dexycb-timelines-exact": "getagrip bench dexycb-timelines --root DEXYCB --meshes YCB --preset exact "
    "--clips 48 --out out/dexycb-timelines",
    "dexycb-other-methods": "getagrip bench dexycb --root OTHER --meshes YCB --split all --out out/dexycb-other "
    "--methods soft-hinge",
    "dexycb-other-final": "getagrip bench dexycb --root OTHER --meshes YCB --split all --out out/dexycb-other "
    "--ablation final",
    "dexycb-other-views": "getagrip bench dexycb --root OTHER --meshes YCB --split all --out out/dexycb-other "
    "--views 1 2 4 --clips 48",
    "dexycb-other-final-evidence": "getagrip bench dexycb --root OTHER --meshes YCB --split all --out out/dexycb-other "
    "--ablation final-evidence --clips 48 --keep 0.95",
}
"""Commands, by the name of their table.

Minutes on a small virtual machine whose two CPUs are threads of one core, imports included: 30, 6, 6, 6, 3 and 5; from
a part of the clips, 16 and 5 for the test objects. A row of a clip takes 2 s of a CPU, evaluated and written.
"""


def main(words: Sequence[str]) -> int:
    """Run the benchmarks, put their tables into ``results/``, and summarise; 1 if one failed, else 0."""
    from benchmarks import test_runs

    parser = _parser()
    asked = parser.parse_args(words)
    workers = [] if asked.workers is None else ["--workers", str(asked.workers)]
    clips = [] if asked.clips is None else ["--clips", str(asked.clips)]
    roots, summary = {"DEXYCB": asked.dexycb, "YCB": asked.ycb, "OTHER": asked.other}, list[str]()
    chosen = asked.only or [name for name in BENCHES if asked.other or "OTHER" not in BENCHES[name]]
    if not asked.other and any("OTHER" in BENCHES[name] for name in chosen):
        parser.error("missing --other")
    for n, name in enumerate(chosen, start=1):
        words = [str(roots.get(word, word)) for word in shlex.split(BENCHES[name])[1:]]
        place = words.index("--out") + 1
        words[place] = str(asked.out / Path(words[place]).name)
        print(f"\n{n} of {len(chosen)}, {name}: getagrip {shlex.join([*words, *clips])}", flush=True)
        if name in test_runs.tables():
            test_runs.note(name, shlex.join([*shlex.split(BENCHES[name]), *clips]))
        start = time.monotonic()
        status = subprocess.run([sys.executable, "-m", "getagrip", *words, *clips, *workers], check=False).returncode
        try:
            kept = _keep(name, Path(words[place]), write=not clips)
        except (FileNotFoundError, KeyError):
            kept, status = "no table", status or 1
        failed = f"; failures: exit status {status}" if status else ""
        summary.append(f"{name}: {(time.monotonic() - start) / 60.0:.1f} min, {kept}{failed}")
    print("", *summary, sep="\n")
    return int(any("failures" in line for line in summary))


def _keep(name: str, folder: Path, write: bool) -> str:
    """Put the tables of a benchmark into ``results/``. Raises ``FileNotFoundError`` or ``KeyError`` if missing."""
    from benchmarks import results

    rows = len(results.found(folder)[name].rows)
    if write:
        results.main([folder])
    return f"{rows} rows" + ("" if write else ", not kept")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m benchmarks.release", description="Measure the tables of a release.")
    parser.add_argument("dexycb", type=Path, metavar="DEXYCB", help="DexYCB")
    parser.add_argument("ycb", type=Path, metavar="YCB", help="the YCB models")
    parser.add_argument("--other", type=Path, metavar="DIR", help="DexYCB's sequences of the ten test objects")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out"), help="clips and results (default: out)")
    parser.add_argument("--clips", type=int, metavar="N", help="try every section on N clips; no table is kept")
    parser.add_argument("--workers", type=int, metavar="N", help="number of processes (default: one per core)")
    parser.add_argument("--only", nargs="+", choices=BENCHES, metavar="TABLE", help=f"of {', '.join(BENCHES)}")
    return parser


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
