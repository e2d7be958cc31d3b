"""A batch: a folder of clips, one of them damaged, reconstructed over processes; a second call makes only what is new.

    python examples/08_batch.py [OUT]

Writes OUT/clips and OUT/results (out/batch by default), with summary.csv. What follows OUT goes to
`getagrip reconstruct` as it is; docs/batch.md says what a killed call leaves, and docs/scale.md how a million are done.
"""

import csv
import sys
from pathlib import Path

import getagrip
from getagrip.cli import main

if __name__ == "__main__":  # the processes of a larger batch import this file, too
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/batch")
    for seed, category in enumerate(("mug", "bottle", "can")):
        clip, masks = getagrip.synthesise(category, seed)
        getagrip.write_clip(clip, masks, out / "clips" / clip.name, replace=True)
    (out / "clips" / clip.name / "hand.npz").write_bytes(b"damaged")

    # A damaged clip fails by itself: what is wrong with which file is said, the others are done, and the status is 1.
    words = ["reconstruct", str(out / "clips"), "--out", str(out / "results"), "--limit-seconds", "120", *sys.argv[2:]]
    first = main(words)

    # The damaged clip is mended. Valid results are kept, so that this call makes one only.
    getagrip.write_clip(clip, masks, out / "clips" / clip.name, replace=True)
    print(f"exit status {first}, then {main(words)}")

    with (out / "results" / "summary.csv").open(newline="", encoding="utf-8") as table:
        for row in csv.DictReader(table):
            print(f"{row['clip']:>18} {row['status']}: IOU {row['IOU']}, {float(row['seconds']):.1f} s")
