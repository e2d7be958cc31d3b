"""EPIC-Grasps' table and its errata: the traps of the real ones, and the errors about damaged ones."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.errors import InputError
from getagrip.readers.datasets.epic import epic_tables
from helpers.environment import DATA, needs
from helpers.epic_files import V, row, write_table

EPIC = DATA / "epic"
TABLE, ERRATA = EPIC / "epicgrasps_2431.csv", EPIC / "epicgrasps_2431_errata.csv"


@needs(EPIC)
def test_the_real_table_has_what_is_known_of_it() -> None:
    grasps = epic_tables.read_grasps(TABLE)
    assert len(grasps) == 2426
    assert {*range(2431)} - {grasp.example for grasp in grasps} == {48, 149, 190, 229, 560}
    assert Counter(grasp.side for grasp in grasps) == {"left": 1445, "right": 981}
    assert len({grasp.video for grasp in grasps}) == 141
    assert len({epic_tables.subject_of(grasp.video) for grasp in grasps}) == 31
    assert len({(grasp.video, grasp.category) for grasp in grasps}) == 390
    assert len({grasp.name for grasp in grasps}) == 2426  # clips' names differ
    assert sum(grasp.contact is None for grasp in grasps) == 405
    assert {grasp.category for grasp in grasps} == {*epic_tables.EPIC_CATEGORIES}
    rates = Counter(epic_tables.numbering_rate(grasp.video) for grasp in grasps)
    assert rates == {50.0: 1198, 60.0: 1228}


@needs(EPIC)
def test_the_one_clip_whose_bounds_are_wrong_is_mended() -> None:
    (mended,) = [grasp for grasp in epic_tables.read_grasps(TABLE) if grasp.note]
    assert (mended.example, mended.video) == (1994, "P28_109")
    assert (mended.start, mended.end, mended.frames) == (9616, 9854, 239)
    with TABLE.open(newline="") as stream:
        durations = {int(cells["example"]): int(cells["duration"]) for cells in csv.DictReader(stream)}
    assert all(grasp.frames == durations[grasp.example] for grasp in epic_tables.read_grasps(TABLE))


@needs(EPIC)
def test_the_errata_turn_five_hands_and_take_one_clip_away() -> None:
    before = {grasp.example: grasp for grasp in epic_tables.read_grasps(TABLE)}
    after = {grasp.example: grasp for grasp in epic_tables.read_grasps(TABLE, ERRATA)}
    assert {*before} - {*after} == {1769}
    turned = {n for n, grasp in after.items() if grasp.side != before[n].side}
    assert turned == {54, 1334, 1593, 1831, 2031}
    assert {after[n].side for n in turned} == {"right"}
    assert Counter(grasp.side for grasp in after.values()) == {"left": 1439, "right": 986}
    with ERRATA.open(newline="") as stream:  # names as the errata give them
        for cells in csv.DictReader(stream):
            if cells["ACTION"] == "REMAKE":
                category, _, rest = cells["fmt"].partition("/")
                assert after[int(cells["example"])].name == rest.replace("right_hand", f"right_{category}")
    assert epic_tables.errata_beside(TABLE) == ERRATA


@needs(EPIC)
def test_frames_are_numbered_at_one_rate_whatever_the_video_has() -> None:
    """EPIC-100's labels have times and frames: frames / seconds is what they were numbered at."""
    with (EPIC / "EPIC_100_validation.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    late = [cells for cells in rows if int(cells["stop_frame"]) > 20_000]
    for cells in late:
        hours, minutes, seconds = map(float, cells["stop_timestamp"].split(":"))
        rate = int(cells["stop_frame"]) / (3600 * hours + 60 * minutes + seconds)
        assert rate == pytest.approx(epic_tables.numbering_rate(cells["video_id"]), abs=0.01)
    assert len(late) > 1000


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"st": "x"}, ("line 3, st", "got 'x'")),
        ({"st": 0}, ("line 3, st",)),
        ({"ed": 999, "fmt": "other"}, ("line 3, duration", "st 1000 to ed 999")),
        ({"duration": 99, "fmt": "other_0_9"}, ("line 3, duration",)),
        ({"handside": "left"}, ("line 3, handside", "left hand or right hand")),
        ({"cat": "spoon"}, ("line 3, cat", "bottle")),
        ({"vid": "../P01_01"}, ("line 3, vid",)),
        ({"hos_name": ""}, ("line 3, hos_name",)),
        ({"contact": 1.5}, ("line 3, contact",)),
        ({"fmt": f"bottle/{V}_left_hand_1000_1099"}, ("fmt", "twice")),
    ],
)
def test_a_wrong_cell_is_named(
    tmp_path: Path, refused: Callable[..., str], changed: dict[str, object], words: tuple[str, ...]
) -> None:
    path = write_table(tmp_path / "t.csv", row(), row(example=1, fmt="bottle/other_1000_1099") | changed)
    refused(lambda: epic_tables.read_grasps(path), str(path), *words)


def test_errata_must_fit_the_table(tmp_path: Path, refused: Callable[..., str]) -> None:
    table = write_table(tmp_path / "t.csv", row())
    for action, fmt, words in [("DELETE", "x", "old_fmt"), ("BURN", row()["fmt"], "ACTION")]:
        wrong = write_table(tmp_path / "e.csv", {"ACTION": action, "old_fmt": fmt, "correct_handside": "right hand"})
        refused(lambda path=wrong: epic_tables.read_grasps(table, path), str(wrong), f"line 2, {words}")


@given(cut=st.integers(0, 2000), swap=st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), max_size=4))
def test_damaged_tables_are_reported_or_read(
    tmp_path_factory: pytest.TempPathFactory, cut: int, swap: list[tuple[int, int]]
) -> None:
    path = write_table(tmp_path_factory.mktemp("t") / "t.csv", row(), row(example=1, fmt="bottle/other_1000_1099"))
    content = bytearray(path.read_bytes())
    for at, byte in swap:
        content[at % len(content)] = byte
    path.write_bytes(content[: max(len(content) - cut, 0)] if cut % 2 else content)
    for read in (epic_tables.read_grasps, lambda p: epic_tables.read_actions([p])):
        with suppress(InputError):
            read(path)
