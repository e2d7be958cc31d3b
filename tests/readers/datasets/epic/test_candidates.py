"""Candidates for grasps, from contacts that VISOR marks and actions that EPIC-100 lists."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from getagrip.readers.datasets.epic import epic_tables, visor
from helpers.environment import DATA, Run, needs
from helpers.epic_files import V, box, hand, sparse, thing, write, write_mapping, write_table

EPIC = DATA / "epic"
TABLE = EPIC / "epicgrasps_2431.csv"


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
        side = epic_tables.SIDE_BY_HAND_NAME[cells["handside"]]
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
