"""Within which distance do fitted hands touch an object where the true ones do?

    python -m benchmarks.contact_threshold TRACKS DEXMACHINA

writes the table into docs/arctic.md.

TRACKS is ArtiGrasp's motion as ``scripts/convert/artigrasp.py`` writes it; the generic hand is fitted to its joints.
DEXMACHINA is DexMachina's (https://github.com/MandiZhao/dexmachina), which holds, in
``assets/arctic/processed/<subject>/<sequence>.npy``, the vertices of the object that lie within 10 mm of the true
MANO surface in each frame. Files that cannot be read are left out; so are scissors, which ArtiGrasp has no poses of.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import page
from getagrip.datasets.cutting import known_clip
from getagrip.datasets.track_files import Tracks
from getagrip.datasets.tracks import Track
from getagrip.experiments.stamp import stamp
from getagrip.geometry import se3
from getagrip.io import pickles
from getagrip.metrics.contact import close_holes, moving_distance

THRESHOLDS = (0.0, 0.0025, 0.005, 0.0075, 0.010, 0.0125, 0.015)
"""Distances that are tried [m]."""
SECTION = "contact-threshold"


def main(converted: Path, dexmachina: Path) -> None:
    """Write the table."""
    agreement, weights = [], []
    for track, touched in pairs(converted, dexmachina):
        distance = nearest(track)
        true = touched[track.numbers]
        agreement.append([np.mean((distance <= threshold) == true) for threshold in THRESHOLDS])
        weights.append(len(true))
        print(track.name, len(true), np.round(agreement[-1], 3))
    rows = {"all frames": np.average(agreement, axis=0, weights=weights), "worst hand": np.min(agreement, axis=0)}
    header = ["contact within", *(f"{1e3 * threshold:g} mm" for threshold in THRESHOLDS)]
    table = page.table(header, [[name, *(f"{100 * share:.1f} %" for share in row)] for name, row in rows.items()])
    page.write(SECTION, f"*{len(weights)} hands, {sum(weights):,} frames; made {stamp()}.*\n\n{table}")


def pairs(converted: Path, dexmachina: Path) -> Iterator[tuple[Track, Bool[ndarray, "T"]]]:
    """Each hand of each sequence that both have, and whether the true one touches, in all frames of the sequence."""
    sources = {source.name: source for source in Tracks(root=converted).sources()}
    for file in sorted(dexmachina.rglob("s[0-9][0-9]/*.npy")):
        source = sources.get(f"s{int(file.parent.name[1:])}-{file.stem}")
        if source is not None and file.stat().st_size:
            world: Any = pickles.read_file(file, "a sequence of ARCTIC")["world_coord"]
            for track in source.read(print):
                yield track, world[f"valid_contacts.{track.side}"].any(axis=1)


def nearest(track: Track) -> Float[ndarray, "T"]:
    """Least signed distance of the object's vertices to the hand in each frame [m]; infinite beyond all thresholds."""
    clip = known_clip(track)
    truth = clip.truth
    assert truth is not None
    hands, faces = close_holes(truth.hand_vertices, clip.hand.faces)
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    vertices = se3.transform(T_hand_obj, truth.object_vertices(clip.mesh.vertices, slice(None)))
    return np.asarray(moving_distance(vertices, hands, faces, max(THRESHOLDS)).min(axis=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
