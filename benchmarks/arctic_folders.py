"""Folders of links to the sequences and clips that docs/arctic.md measures.

    python -m benchmarks.arctic_folders ARTIGRASP DIR           DIR/study and DIR/test, for convert/artigrasp.py
    python -m benchmarks.arctic_folders --quarter WHOLE DIR     every fourth clip of WHOLE, sorted by name

ARTIGRASP is ArtiGrasp's folder or its ``rsc``. What is there already is kept.
"""

from __future__ import annotations

import sys
from pathlib import Path

from scripts.convert.artigrasp import LETTERS, PARTS, folder_rsc, sequence_of
from scripts.convert.artigrasp import sequences as all_sequences

STUDIED = slice(None, None, 6)
"""Of all sequences, sorted by subject and name: every sixth."""
TESTED = slice(None, None, 11)
"""Of those of the ``TEST_SUBJECTS``, sorted by object, subject and name: every eleventh."""
TEST_SUBJECTS = ("s2", "s5", "s6", "s8", "s9", "s10")
QUARTER = slice(None, None, 4)
"""Of clips, sorted by name."""


def sequences(rsc: Path) -> tuple[list[Path], list[Path]]:
    """The files of the objects of the study's sequences, and of the test's."""
    everything = all_sequences(rsc)
    tested = [f for f in everything if f.parent.name in TEST_SUBJECTS]
    return (
        sorted(everything, key=lambda f: (f.parent.name, sequence_of(f)))[STUDIED],
        sorted(tested, key=lambda f: (f.parent.parent.name, f.parent.name, sequence_of(f)))[TESTED],
    )


def link_sequences(rsc: Path, chosen: list[Path], folder: Path) -> None:
    """A folder as ArtiGrasp's: links to the files of some sequences, and to the objects' meshes."""
    for poses in chosen:
        hands = rsc / "mano_double" / "ee" / poses.parent.name
        joints = [hands / f"{sequence_of(poses)}_{letter}.npy" for letter in LETTERS.values()]
        meshes = [poses.parent.parent / f"{part}_watertight_tiny.obj" for part in PARTS]
        for file in (poses, *joints, *meshes):
            link(file, folder / file.relative_to(rsc))


def link(target: Path, path: Path) -> None:
    """A link to a file or folder, unless there is one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_symlink():
        path.symlink_to(target.resolve())


def main(artigrasp: Path, out: Path) -> None:
    """DIR/study and DIR/test."""
    rsc = folder_rsc(artigrasp)
    for name, chosen in zip(("study", "test"), sequences(rsc), strict=True):
        link_sequences(rsc, chosen, out / name)
        subjects, objects = {f.parent.name for f in chosen}, {f.parent.parent.name for f in chosen}
        print(f"{out / name}: {len(chosen)} sequences, {len(subjects)} subjects, {len(objects)} objects")


def quarter(whole: Path, out: Path) -> None:
    """Every fourth clip of a folder."""
    clips = sorted(path.parent for path in whole.glob("*/clip.json"))[QUARTER]
    for clip in clips:
        link(clip, out / clip.name)
    print(f"{out}: {len(clips)} clips")


if __name__ == "__main__":
    if sys.argv[1] == "--quarter":
        quarter(*map(Path, sys.argv[2:]))
    else:
        main(*map(Path, sys.argv[1:]))
