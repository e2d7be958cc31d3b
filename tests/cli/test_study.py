"""``study`` and ``stats``: files, tables and errors; the paper's table from EPIC-Grasps."""

from __future__ import annotations

import csv
import json
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.batch import executor
from getagrip.bench.figures.study_figure import GRASP_BAND_COLOUR
from getagrip.bench.tables import (
    DatasetCounts,
    GraspDuration,
    count_epic_grasps,
    durations_by_category,
    epic_durations,
)
from getagrip.clip import write_clip
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.readers.datasets.epic.epic_tables import read_grasps
from getagrip.report.pictures.panels import AXIS_COLOUR, RESULT_COLOUR
from getagrip.stable_grasps import grasp_lists
from getagrip.stable_grasps.study import NORMALISED_TIMES, STUDY_MEASURES, study
from helpers.environment import DATA, needs
from helpers.pages import pixels_of, read_picture
from helpers.scenes import turning

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.slow
def test_all_is_written_and_printed(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_clip(turning("a"), None, tmp_path / "clips" / "a")
    write_clip(replace(turning("b", "left"), category="[bold]x"), None, tmp_path / "clips" / "b")
    away = turning("away")
    assert away.truth is not None
    far = replace(away.truth, T_cam_obj=away.truth.T_cam_obj @ se3.rigid(t=np.array([0.2, 0.0, 0.0])))
    write_clip(replace(away, truth=far), None, tmp_path / "clips" / "away")
    out, file = tmp_path / "out", tmp_path / "study.json"
    options = ("--tau", 0.3, "--contact-mm", 5, "--shortest", 10, "--workers", 1, "--out", out, "--json", file)
    status, printed, err = run("study", tmp_path / "clips", *options)
    assert (status, err) == (0, "")
    assert "2 stable grasps in 2 of 3 clips" in printed
    assert "[bold]x" in printed
    with (out / "grasps.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["sequence"], row["side"], row["start"], row["end"]) for row in rows] == [
        ("a", "right", "0", "29"),
        ("b", "left", "0", "29"),
    ]
    content = json.loads(file.read_text())
    assert [one["sequence"] for one in content["grasps"]] == ["a", "b"]
    assert content["cut"]["contact"] == pytest.approx(0.005)
    means = {
        (row["object"], row["where"], row["measure"]): row["mean"]
        for row in content["summary"]
        if row["measure"].endswith("rotation")
    }
    assert means["All", "inside", "one_dof_rotation"] < 1e-6 < means["All", "inside", "static_rotation"]
    with (out / "curves.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == len(STUDY_MEASURES) * len(NORMALISED_TIMES)
    with (out / "summary.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 3 * 2 * len(STUDY_MEASURES)
    picture = read_picture(out / "study.png")
    for third in np.array_split(picture, 3, axis=1):
        for half in np.array_split(third, 2):
            assert pixels_of(half, GRASP_BAND_COLOUR) > 1000  # six panels, the time of the grasp in blue
    assert pixels_of(picture, RESULT_COLOUR) > 200  # static
    assert pixels_of(picture, AXIS_COLOUR) > 200  # 1-DoF
    monkeypatch.setattr(executor, "run_in_processes", crossing)
    again = run("study", tmp_path / "clips", *options, "--workers", 2)
    assert again == (status, printed, err)  # a clip without grasps is none that failed


def crossing(work: Callable, jobs: list, _: int) -> Iterator[tuple[object, object]]:
    """What crosses to other processes and back is pickled; that these do the work is tested with ``segment``."""
    for job in jobs:
        there = pickle.loads(pickle.dumps((work, job)))
        yield job, pickle.loads(pickle.dumps(there[0](there[1])))


@pytest.mark.slow
def test_one_bad_clip_stops_no_other(run: Run, tmp_path: Path) -> None:
    write_clip(turning("good"), None, tmp_path / "good")
    write_clip(replace(turning("blind"), truth=None), None, tmp_path / "blind")
    paths = (tmp_path / "blind", tmp_path / "gone", tmp_path / "good")
    options = ("--tau", 0.3, "--contact-mm", 5, "--shortest", 10, "--out", tmp_path / "out")
    status, printed, err = run("study", *paths, *options)
    assert status == 1
    assert "1 stable grasp in 1 of 1 clip" in printed
    assert "gone: no such folder" in err
    assert "truth.npz: no such file" in err
    with pytest.raises(InputError, match=r"truth\.npz"):
        study(replace(turning(), truth=None))


def test_wrong_calls_exit_with_2(run: Run, tmp_path: Path) -> None:
    write_clip(turning(), None, tmp_path / "a")
    for wrong in ((), ("a", "--tau", "1"), ("a", "--contact-mm", "-1"), ("a", "--workers", "0")):
        paths = [tmp_path / word if word == "a" else word for word in wrong]
        assert run("study", *paths, "--out", tmp_path / "out")[0] == 2
    assert not (tmp_path / "out").exists()


EPIC = DATA / "epic" / "epicgrasps_2431.csv"
HEADS = "vid,st_bound,ed_bound,st,ed,contact,handside,cat,hos_name,mp4_name,set_name,round,duration,n_unfiltered_masks,\
n_filtered_masks,good_CAD,example,fmt,ablate_inithand"
LIST = "sequence,side,object,start,end,duration\na,left,box,0,29,1.0\nb,right,box,3,92,3.0\nc,left,cup,0,59,2.0\n"

# Average, standard deviation and longest [s], and number of clips: the paper's table of EPIC-Grasps.
PAPER = {
    "bottle": (4.25, 4.70, 29.40, 311),
    "bowl": (3.59, 5.53, 43.36, 421),
    "can": (3.50, 4.11, 22.76, 105),
    "cup": (2.79, 3.20, 19.72, 125),
    "glass": (2.45, 3.73, 34.72, 226),
    "mug": (2.40, 3.34, 29.74, 167),
    "pan": (6.39, 9.36, 91.28, 526),
    "plate": (2.77, 4.49, 54.60, 473),
    "saucepan": (5.73, 10.08, 76.10, 77),
    "All": (3.95, 6.30, 91.28, 2431),
}
MISSING = {"bottle": 1, "bowl": 1, "can": 3, "All": 5}
"""Clips of the paper's table that the published file does not have."""


def epic_line(n: int, video: str, side: str, category: str, start: int, end: int, duration: int) -> str:
    fmt = f"{category}/{video}_{side}_hand_{start}_{end}"
    bounds = f"{video},1,9000,{start},{end},{start},{side} hand,{category}"
    return f"{bounds},a {category},x.mp4,Set,r,{duration},1,1,1,{n},{fmt},0"


def epic_table(folder: Path) -> Path:
    lines = [
        epic_line(0, "P01_01", "left", "cup", 101, 220, 120),
        epic_line(1, "P01_101", "right", "cup", 1, 200, 200),
        epic_line(2, "P02_03", "right", "pan", 51, 350, 300),
    ]
    (folder / "epic.csv").write_text("\n".join([HEADS, *lines]) + "\n")
    return folder / "epic.csv"


@needs(EPIC)
def test_the_papers_table_comes_out() -> None:
    rows = {row.category: row for row in durations_by_category(epic_durations(read_grasps(EPIC)))}
    assert set(rows) == set(PAPER)
    for category, (mean, std, longest, clips) in PAPER.items():
        row = rows[category]
        assert row.clips == clips - MISSING.get(category, 0)
        assert row.clips == row.left + row.right
        assert round(row.longest, 2) == longest
        if category not in MISSING:
            assert (round(row.mean, 2), round(row.std, 2)) == (mean, std)
        else:  # up to three of some hundred clips are missing
            assert row.mean == pytest.approx(mean, abs=0.05)
            assert row.std == pytest.approx(std, abs=0.05)


@needs(EPIC)
def test_true_rates_make_the_first_videos_shorter_only() -> None:
    paper, true = (
        durations_by_category(epic_durations(read_grasps(EPIC))),
        durations_by_category(epic_durations(read_grasps(EPIC), "true")),
    )
    for one, other in zip(paper, true, strict=True):
        assert other.mean < one.mean <= 1.2 * other.mean
        assert one.clips == other.clips


def test_durations_with_known_answers(tmp_path: Path) -> None:
    assert epic_durations(read_grasps(epic_table(tmp_path))) == [
        GraspDuration("cup", "left", 2.4), GraspDuration("cup", "right", 4.0), GraspDuration("pan", "right", 6.0)
    ]  # fmt: skip
    assert [grasp.duration for grasp in epic_durations(read_grasps(epic_table(tmp_path)), "true")] == [2.0, 4.0, 5.0]
    cup, pan, all_ = durations_by_category(epic_durations(read_grasps(epic_table(tmp_path)), "true"))
    assert (cup.mean, cup.std, cup.longest, cup.clips, cup.left, cup.right) == (3.0, 1.0, 4.0, 2, 1, 1)
    assert (pan.category, all_.category, all_.clips, all_.longest) == ("pan", "All", 3, 5.0)
    assert durations_by_category([]) == []


def errata_table(folder: Path, action: str = "REMAKE", of: str = "cup/P01_01_left_hand_101_220") -> Path:
    (folder / "errata.csv").write_text(f"ACTION,old_fmt,correct_handside\n{action},{of},right hand\n")
    return folder / "errata.csv"


def test_errata_change_hands_or_take_grasps_away(run: Run, tmp_path: Path) -> None:
    table = epic_table(tmp_path)
    assert [grasp.side for grasp in read_grasps(table, errata_table(tmp_path))] == ["right"] * 3
    written = tmp_path / "j"
    call = ("stats", "epic-grasps", table, "--json", written)
    for options, clips in (
        ((), 3), (("--no-errata",), 3), (("--errata-file", errata_table(tmp_path, "DELETE")), 2),
    ):  # fmt: skip
        assert run(*call, *options)[0] == 0
        content = json.loads(written.read_text())
        assert (content["durations"][-1]["clips"], content["counts"]["grasps"]) == (clips, clips)
    assert run(*call, "--errata")[0] == 2  # there are none beside it
    (tmp_path / "errata.csv").rename(tmp_path / "epic_errata.csv")
    assert run(*call, "--errata")[0] == 0
    assert json.loads(written.read_text())["counts"]["grasps"] == 2
    for action, of, words in (("TURN", "cup/P01_01_left_hand_101_220", "ACTION"), ("DELETE", "cup/x", "old_fmt")):
        status, _, err = run("stats", "epic-grasps", table, "--errata-file", errata_table(tmp_path, action, of))
        assert (status, words in err) == (1, True)


@needs(EPIC)
def test_the_published_errata() -> None:
    all_ = durations_by_category(epic_durations(read_grasps(EPIC, EPIC.with_name("epicgrasps_2431_errata.csv"))))[-1]
    assert (all_.clips, all_.left, all_.right) == (2425, 1439, 986)


@needs(EPIC)
def test_the_papers_comparison_of_datasets_comes_out() -> None:
    """141 environments, 31 subjects, 9 categories, about 390 instances; with the errata, 319,661 masks."""
    without = count_epic_grasps(read_grasps(EPIC))
    assert without == DatasetCounts(141, 31, 9, 390, 2426, 1445, 981, 319_764)
    mended = count_epic_grasps(read_grasps(EPIC, EPIC.with_name("epicgrasps_2431_errata.csv")))
    assert mended == DatasetCounts(141, 31, 9, 390, 2425, 1439, 986, 319_661)


def test_figures_of_a_table_and_of_a_list(run: Run, tmp_path: Path) -> None:
    assert count_epic_grasps(read_grasps(epic_table(tmp_path))) == DatasetCounts(3, 2, 2, 3, 3, 1, 2, 3)
    blank = (tmp_path / "epic.csv").read_text().replace(",120,1,", ",120,,", 1)
    (tmp_path / "epic.csv").write_text(blank)
    assert count_epic_grasps(read_grasps(tmp_path / "epic.csv")).masks is None
    rows = [
        {"sequence": f"{who}--x", "side": "left", "object": "cup", "start": 0, "end": 1, "duration": 1} for who in "ab"
    ]
    (tmp_path / "grasps.json").write_text(json.dumps({"version": 1, "grasps": rows}))
    (tmp_path / "a" / "masks" / "object").mkdir(parents=True)
    (tmp_path / "a" / "masks" / "object" / "0.png").touch()
    status, printed, _ = run("stats", tmp_path, "--out", tmp_path / "out")
    assert (status, printed.splitlines()[-2]) == (0, "2 subjects, 1 categories, 2 grasps, 2 left, 0 right, 1 masks")
    with (tmp_path / "out" / "counts.csv").open(newline="") as stream:
        assert [row["masks"] for row in csv.DictReader(stream)] == ["1"]
    assert "| - | 2 | 1 | - | 2 | 2 | 0 | 1 |" in (tmp_path / "out" / "stats.md").read_text()


def test_a_list_in_either_form_says_the_same(run: Run, tmp_path: Path) -> None:
    table, file = tmp_path / "segments.csv", tmp_path / "segments.json"
    table.write_text(LIST)
    with table.open(newline="") as stream:
        rows = [{**row, "duration": float(row["duration"])} for row in csv.DictReader(stream)]
    file.write_text(json.dumps(rows))
    assert grasp_lists.read_listed_grasps(table).grasps == grasp_lists.read_listed_grasps(file).grasps
    first = run("stats", table, "--out", tmp_path / "out", "--json", tmp_path / "stats.json")
    assert (first[0], first[2]) == (0, "")
    assert run("stats", file)[1] in first[1]
    content = json.loads((tmp_path / "stats.json").read_text())["durations"]
    assert [row["category"] for row in content] == ["box", "cup", "All"]
    assert content[0]["mean"] == 2.0
    page = (tmp_path / "out" / "stats.md").read_text()
    assert "| box | 2.00 | 1.00 | 3.00 | 2 | 1 | 1 |" in page
    with (tmp_path / "out" / "stats.csv").open(newline="") as stream:
        assert [row["clips"] for row in csv.DictReader(stream)] == ["2", "1", "3"]


def test_empty_lists_have_no_rows(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[]")
    status, printed, _ = run("stats", tmp_path / "a.json", "--out", tmp_path / "out", "--json", tmp_path / "b.json")
    assert (status, json.loads((tmp_path / "b.json").read_text())["durations"]) == (0, [])
    assert "no grasps" in printed


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("101,220", "101,2x0", "line 2, ed"),
        (",120,1,", ",,1,", "line 2, duration"),
        ("left hand,cup", "third hand,cup", "line 2, handside"),
        ("P01_101,1", "../../x,1", "line 3, vid"),
        (",300,1", ",299,1", "line 4, duration"),
        ("hand,pan", "hand,piano", "line 4, cat"),
        (",0\n", "\n", "line 2"),
        ("handside", "hand", "handside"),
        (",0\n", ',"0\n', "invalid CSV"),
        ("cup", "\0", "line 2"),
    ],
)
def test_damaged_tables_are_reported_by_line_and_column(
    run: Run, tmp_path: Path, old: str, new: str, words: str
) -> None:
    path = epic_table(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    status, _, err = run("stats", "epic-grasps", path)
    assert status == 1
    assert words in err
    assert any(form in err for form in (" must be ", "missing ", " cannot be used "))
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (LIST.replace("3.0", "long"), "line 3, duration"),
        (LIST.replace("3.0", "nan"), "line 3, duration"),
        (LIST.replace("3.0", "-3"), "line 3, duration"),
        (LIST.replace("right", "up"), "line 3, side"),
        (LIST.replace("box", "", 1), "line 2, object"),
        (LIST.replace(",2.0", ""), "line 4"),
        (LIST.replace("duration", "length"), "grasp 1, duration"),
        (LIST.replace("start", "side"), "line 1, side"),
        ("", "line 1, sequence"),
        ('{"a": 1}', "version"),
        ("[1]", "[0]"),
        ('[{"clip": "a", "start": 1, "end": 2}]', "[0].object"),
        ('[{"sequence": "s", "object": "a", "side": "left", "start": 0, "end": 1, "duration": true}]', "[0].duration"),
        ('{"version": 1, "grasps": [{"sequence": "s", "object": "a", "side": "left", "first": 3}]}', "grasps[0].first"),
        ('{"version": 1, "grasps": [], "cuts": {}}', "got an unknown key"),
        (LIST.replace("0,29", "30,29"), "line 2, end"),
        ("[[[", "invalid JSON"),
        ("[" * 100_000, "invalid JSON"),
    ],
)
def test_damaged_lists_are_reported_by_row_and_key(run: Run, tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "list"
    path.write_text(content)
    status, _, err = run("stats", path)
    assert status == 1
    assert words in err
    assert any(form in err for form in (" must be ", "missing ", " cannot be used "))
    assert len(err.splitlines()) == 1


def test_files_that_are_no_text_are_refused(run: Run, tmp_path: Path) -> None:
    (tmp_path / "list").write_bytes(b"\xff\xfe\x00\x01")
    for given in ((tmp_path / "list",), ("epic-grasps", tmp_path / "list"), (tmp_path / "gone",)):
        status, _, err = run("stats", *given)
        assert status == 1
        assert "Traceback" not in err


def test_wrong_calls_of_stats_exit_with_2(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(LIST)
    for wrong in (
        (),
        ("epic-grasps",),
        (tmp_path / "a.csv", tmp_path / "a.csv"),
        (tmp_path / "a.csv", "--fps", "true"),
        (tmp_path / "a.csv", "--errata"),
        (tmp_path / "a.csv", "--errata-file", tmp_path / "a.csv"),
        ("epic-grasps", epic_table(tmp_path), "--fps", "30"),
    ):
        assert run("stats", *wrong)[0] == 2
