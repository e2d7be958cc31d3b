"""EPIC-Grasps' table and errata, with errors for damaged files, and candidates of grasps."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.errors import InputError
from getagrip.readers.datasets.epic import epic_tables, visor
from helpers.environment import DATA, Run, needs
from helpers.epic_files import V, box, hand, row, sparse, thing, write, write_mapping, write_table

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


def visor_frame(number: int, *annotations: dict[str, Any], tmp: Path) -> visor.VisorFrame:
    return next(visor.read_frames(write(tmp / f"{V}.json", [sparse(V, number, *annotations)])))


def actions(*bounds: tuple[int, int], narration: str = "take cup", noun: str = "cup") -> list[epic_tables.Action]:
    return [epic_tables.Action(V, a, b, narration, noun) for a, b in bounds]


def test_contacts_are_of_hands_and_of_what_their_gloves_touch(tmp_path: Path) -> None:
    cup, pan = thing("c", "coffee cup", 13, box(0, 0, 9, 9)), thing("p", "pan", 5, box(0, 0, 9, 9))
    glove = thing("g", "right glove", 304, box(0, 0, 9, 9), in_contact_object="p", on_which_hand=["right hand"])
    knife = thing("k", "knife", 4, box(0, 0, 9, 9))
    frame = visor_frame(7, cup, pan, knife, glove, hand("left", "c", box(0, 0, 5, 5)), hand("right", "g"), tmp=tmp_path)
    (found,) = epic_tables.contacts([frame], visor.FrameMapping({7: 5}))
    assert {(c.frame, c.side, c.category, c.entity) for c in found} == {
        (5, "left", "cup", "coffee cup"),
        (5, "right", "pan", "pan"),
    }
    nameless = thing("", "cup", 13, box(0, 0, 9, 9))
    idle = visor_frame(8, nameless, hand("left", "hand-not-in-contact"), hand("right", None), tmp=tmp_path)
    assert epic_tables.contacts([idle], visor.FrameMapping({})) == [[]]
    free = visor_frame(8, cup, hand("left", "k", box(0, 0, 5, 5)), knife, tmp=tmp_path)
    assert epic_tables.contacts([free], visor.FrameMapping({})) == [[]]  # marked, and no category


def test_contacts_that_follow_each_other_are_one_candidate() -> None:
    def touch(frame: int, side: Any = "left", entity: str = "cup") -> epic_tables.Contact:
        return epic_tables.Contact(frame, side, entity.rpartition(" ")[2], entity)

    labelled = actions((1, 20), (30, 60), (50, 90), (100, 140), (150, 180), (190, 220))
    touching = [[touch(55)], [touch(70), touch(70, "right", "oil bottle")], [], [touch(160)]]
    found = epic_tables.find_candidates(V, touching, labelled)
    assert [(c.side, c.entity, c.contacts, c.start_bound, c.end_bound) for c in found] == [
        ("left", "cup", (55, 70), 1, 180),
        ("right", "oil bottle", (70,), 1, 180),
        ("left", "cup", (160,), 50, 220),
    ]
    assert found[0].name == f"{V}_1_55_70_180_left_cup"
    assert found[0].narrations == ("take cup",) * 5
    assert epic_tables.find_candidates(V, touching, []) == []  # nothing bounds them


@pytest.mark.parametrize(
    ("entity", "category"),
    [("olive oil bottle", "bottle"), ("saucepan", "saucepan"), ("Frying Pan", "pan"), ("bottle cap", None),
     ("passata bottle/tomato puree bottle", "bottle"), ("dustpan", None), ("", None)],
)  # fmt: skip
def test_categories_are_the_last_word(entity: str, category: str | None) -> None:
    assert epic_tables.category_of(entity) == category


@needs(EPIC)
def test_the_real_table_follows_the_rules_by_which_candidates_are_made() -> None:
    """Contacts are in the names of EPIC-Grasps' videos, actions in EPIC-100's validation labels."""
    labels = epic_tables.read_actions([EPIC / "EPIC_100_validation.csv"])
    with TABLE.open(newline="") as stream:
        rows = [cells for cells in csv.DictReader(stream) if cells["vid"] in labels]
    exact, count = 0, 0
    for cells in rows:
        category = epic_tables.category_of(cells["hos_name"])
        assert category == cells["cat"]
        frames = [int(n) for n in cells["mp4_name"].split("_")[3:-3]]
        if not frames:
            continue
        side = visor.SIDE_BY_HAND_NAME[cells["handside"]]
        touching = [[epic_tables.Contact(n, side, category, cells["hos_name"])] for n in frames]
        (made,) = epic_tables.find_candidates(cells["vid"], touching, labels[cells["vid"]])
        count += 1
        exact += (made.start_bound, made.end_bound) == (int(cells["st_bound"]), int(cells["ed_bound"]))
        if (made.start_bound, made.end_bound) == (int(cells["st_bound"]), int(cells["ed_bound"])):
            assert f"{made.name}.mp4" == cells["mp4_name"]
    assert count > 300
    assert exact >= 0.97 * count


def test_candidates_are_written_as_a_table_and_as_json(run: Run, tmp_path: Path) -> None:
    cup = thing("c", "cup", 13, box(0, 0, 9, 9))
    frames = [sparse(V, n, cup, hand("left", "c", box(0, 0, 5, 5))) for n in (52, 82)]
    write(tmp_path / "visor" / f"{V}.json", [*frames, sparse(V, 300, cup, hand("left", "hand-not-in-contact"))])
    write(tmp_path / "visor" / "P02_01.json", [])
    write_mapping(tmp_path / "visor" / "frame_mapping.json", V, {52: 50, 82: 80, 300: 298})
    label = {"video_id": V, "start_frame": 40, "stop_frame": 90, "narration": "wash cup", "noun": "cup"}
    table = write_table(tmp_path / "labels.csv", label)
    out, found = tmp_path / "made" / "c.csv", tmp_path / "c.json"
    call = ("epic", "candidates", "--visor", tmp_path / "visor", "--actions", table, "--json", found)
    status, printed, err = run(*call, "--out", tmp_path / "c.csv")
    assert status == 1, err  # the mapping knows nothing of the other video
    assert "frame_mapping.json: missing P02_01" in err
    assert "1 candidate from" in printed
    with (tmp_path / "c.csv").open(newline="") as stream:
        (cells,) = csv.DictReader(stream)
    assert cells == {
        "vid": V, "st_bound": "40", "ed_bound": "90", "contact": "-1", "handside": "left hand", "cat": "cup",
        "hos_name": "cup", "mp4_name": f"{V}_40_50_80_90_left_cup.mp4",
    }  # fmt: skip
    (one,) = json.loads(found.read_text())
    assert one["contacts"] == [50, 80]
    assert one["narrations"] == ["wash cup"]
    assert one["seconds"] == 51 / 50
    assert run(*call, "--categories", "pan", "--out", tmp_path / "p.csv")[0] == 1
    assert len((tmp_path / "p.csv").read_text().splitlines()) == 1
    assert run(*call, "--categories", "spoon", "--out", out)[0] == 2
