"""Labels find their footage by its checksum, under whatever name; those of other footage leave nothing behind."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from getagrip.studio.store import labels
from getagrip.studio.store.export_clip import footage_checksum, tasks_of_labels
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import FrameLabels, Labels
from getagrip.studio.store.tasks import Task
from helpers.environment import Run

GIVEN = Labels("cup.mp4", (64, 48), "left", 30.0, 0, 2, {1: FrameLabels(object=())})


def task(path: Path, content: bytes | None = None) -> Task:
    if content is not None:
        path.write_bytes(content)
    return Task(path.stem, path.stem, path)


def test_a_checksum_finds_footage_under_another_name(tmp_path: Path) -> None:
    other, renamed = task(tmp_path / "other.mp4", b"another"), task(tmp_path / "take-3.mp4", b"the footage")
    given = replace(GIVEN, sha256=hashlib.sha256(b"the footage").hexdigest())
    assert tasks_of_labels(given, [other, renamed]) == [renamed]
    named = task(tmp_path / "cup.mp4", b"of the same name")
    assert tasks_of_labels(given, [named, other, renamed]) == [renamed]
    with pytest.raises(RefusedError, match="another file than the one that was labelled"):
        tasks_of_labels(given, [named, other])
    with pytest.raises(RefusedError, match="none has this name or checksum"):
        tasks_of_labels(given, [other])
    assert tasks_of_labels(GIVEN, [other, named]) == [named]
    with pytest.raises(RefusedError, match="no checksum"):
        tasks_of_labels(GIVEN, [other])


def test_the_checksum_of_a_folder_is_of_its_names_and_contents(tmp_path: Path) -> None:
    sums = []
    for name, content in (("a", b"1"), ("a", b"2"), ("b", b"2")):
        folder = tmp_path / str(len(sums))
        folder.mkdir()
        (folder / name).write_bytes(content)
        sums.append(footage_checksum(folder))
    assert len({*sums}) == 3
    assert footage_checksum((tmp_path / "0").rename(tmp_path / "moved")) == sums[0]


def test_labels_of_other_footage_leave_no_database_behind(tmp_path: Path, run: Run) -> None:
    footage = tmp_path / "take-3"
    footage.mkdir()
    for n in range(3):
        cv2.imwrite(str(footage / f"{n:04d}.png"), np.zeros((48, 64, 3), np.uint8))
    file, out = tmp_path / "labels.json", tmp_path / "out"
    labels.write_label_file(GIVEN, file)
    status, _, err = run("annotate", footage, "--out", out, "--import-labels", file)
    assert status == 1
    assert err.startswith(f"getagrip: {file} must be labels of the footage given (got labels of other footage")
    assert not out.exists()
    labels.write_label_file(replace(GIVEN, sha256=footage_checksum(footage)), file)
    assert run("annotate", footage, "--out", out, "--import-labels", file)[0] == 0
    assert run("annotate", footage, "--out", out, "--export")[0] == 1  # labels only: too few for a clip
    (again,) = out.glob("labels-*.json")
    assert labels.read_label_file(again).sha256 == footage_checksum(footage)
