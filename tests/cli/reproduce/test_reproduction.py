"""The paper's tables by one command each, on small files in the official layouts."""

from __future__ import annotations

import math
import shutil
from contextlib import suppress
from pathlib import Path

import pytest

from getagrip.cli.reproduce import arctic_grasps, epic_grasps
from getagrip.cli.reproduce.paper_tables import ALL_ROW_LABEL, PaperTable, bench_values, published, write_paper_tables
from getagrip.errors import InputError
from getagrip.io.files import read_json, write_json
from helpers.environment import Run
from helpers.epic_files import CATEGORIES, clip_name, write_demos, write_epic_paper
from helpers.held_ball import write_mano
from helpers.motion_capture_files import write_arctic

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.slow
def test_epic_grasps(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without hands the clips are made; with them all tables are; a second call keeps everything."""
    monkeypatch.setattr(
        "getagrip.fitting.methods.paper.PAPER_ITERATIONS", 10
    )  # of 200: how good poses are is not looked at
    root, out = write_epic_paper(tmp_path / "root"), tmp_path / "out"
    call = ("reproduce", "epic-grasps", root, "--out", out, "--workers", 1)
    status, _, told = run(*call)
    assert status == 1
    assert "docs/estimators.md" in told
    assert not (out / "bench").exists()
    assert {path.name for path in (out / "clips").iterdir() if path.is_dir()} >= {*map(clip_name, CATEGORIES)}
    write_demos(root)
    assert run(*call)[0] == 0
    tables = read_json(out / "tables.json")["tables"]
    assert [*tables] == ["Table 3", "Table 4", "Table 5", "Table 6", "Table 7", "Table 9"]
    for number in ("Table 3", "Table 9"):
        measured = tables[number]["measured"]
        assert {*measured} >= {*published()[number]["groups"]}
        assert all({*rows} == {*CATEGORIES, ALL_ROW_LABEL} for rows in measured.values()), number
    for number in ("Table 4", "Table 5", "Table 6"):
        rows = published()[number]["groups"]["1-DoF"]
        assert {*tables[number]["measured"]["1-DoF"]} == {*rows}
        assert all(0.0 < row["IOU"] <= 100.0 for row in tables[number]["measured"]["1-DoF"].values())
    assert tables["Table 7"]["measured"]["grasps"]["mug"]["clips"] == 1
    page = (out / "tables.md").read_text()
    assert "(54.9)" in page  # HOMan's printed IOU
    assert r"\cellcolor{green!25}" in (out / "tables.tex").read_text()
    made = {path: path.stat().st_mtime_ns for path in out.glob("bench/results/*/*/result.json")}
    assert run(*call)[0] == 0
    assert {path: path.stat().st_mtime_ns for path in out.glob("bench/results/*/*/result.json")} == made
    assert (out / "tables.md").read_text() == page


@pytest.mark.slow
def test_arctic_grasps(tmp_path: Path, run: Run) -> None:
    mano = write_mano(tmp_path / "root" / "mano")
    write_arctic(tmp_path / "root", mano)
    out = tmp_path / "out"
    assert run("reproduce", "arctic-grasps", tmp_path / "root", "--out", out, "--workers", 1)[0] == 0
    tables = read_json(out / "tables.json")["tables"]
    ours = {"Single Frame, ours", "HOMan, ours", "1-DoF, ours", "soft hinge"}
    assert {*tables["Table 2"]["measured"]} == {*published()["Table 2"]["groups"]} | ours
    assert tables["Table 2"]["measured"]["1-DoF"][ALL_ROW_LABEL]["IOU"] > 50.0
    assert tables["Table 8"]["measured"]["grasps"]["ball"]["clips"] >= 1
    errors = tables["Sec. 3"]["measured"]["grasps"][ALL_ROW_LABEL]
    assert errors == pytest.approx({"1-DoF": 0.0, "static": 0.0}, abs=1e-6)  # the ball is held still


@pytest.mark.parametrize("needs", [epic_grasps.EPIC_REQUIREMENTS, arctic_grasps.ARCTIC_REQUIREMENTS])
def test_all_that_is_missing_is_named_first(
    tmp_path: Path, run: Run, needs: dict[str, epic_grasps.RequiredFile]
) -> None:
    name = "epic-grasps" if needs is epic_grasps.EPIC_REQUIREMENTS else "arctic-grasps"
    status, said, told = run("reproduce", name, tmp_path, "--out", tmp_path / "out")
    assert (status, said) == (2, "")
    assert all(need.source in told and need.what in told for need in needs.values())
    assert len(told.splitlines()) > len(needs)  # a line each
    assert " or " not in told, "one place for each"
    later = [need.what in told for need in epic_grasps.EPIC_HAND_SOURCES.values()]
    assert later == [needs is epic_grasps.EPIC_REQUIREMENTS] * 2, "before 100 GB are fetched"
    assert not (tmp_path / "out").exists()


def test_several_folders_hold_what_is_needed_together(tmp_path: Path, run: Run) -> None:
    root = write_epic_paper(tmp_path / "root")
    shutil.move(root / "mano", tmp_path / "elsewhere")
    told = run("reproduce", "epic-grasps", root, "--out", tmp_path / "out")[2]
    assert epic_grasps.EPIC_REQUIREMENTS["mano"].source in told
    assert epic_grasps.EPIC_REQUIREMENTS["visor"].source not in told
    assert (
        epic_grasps.find_required(epic_grasps.EPIC_REQUIREMENTS, [root, tmp_path / "elsewhere"])["mano"]
        == tmp_path / "elsewhere"
    )


def test_visor_is_found_as_it_is_downloaded(tmp_path: Path) -> None:
    folder = tmp_path / "2v6cgv1x04ol22qp9rm9x2j6a7" / "GroundTruth-SparseAnnotations" / "annotations" / "train"
    folder.mkdir(parents=True)
    assert epic_grasps.EPIC_REQUIREMENTS["visor"].find([tmp_path]) is None
    (folder / "P01_01.json").write_text("{}")
    assert epic_grasps.EPIC_REQUIREMENTS["visor"].find([tmp_path]) == tmp_path / "2v6cgv1x04ol22qp9rm9x2j6a7"


def test_clips_of_one_category_are_a_row_of_their_own(tmp_path: Path) -> None:
    row = {"row": "paper", "failed": 0, "values": {"IOU": {"mean": 0.5}}}
    page = {"tables": [{"table": "all", "clips": 1, "rows": [row]}], "clips": [{"category": "mug"}]}
    write_json(tmp_path / "bench.json", page)
    assert bench_values(tmp_path / "bench.json", "paper", {"IOU": "IOU"}) == {
        ALL_ROW_LABEL: {"IOU": 50.0},
        "mug": {"IOU": 50.0},
    }


@pytest.mark.parametrize("number", published())
def test_printed_numbers_are_whole_tables(number: str) -> None:
    """Each row has every column; the paper's mean over all is within the categories' range."""
    table = published()[number]
    for rows in table["groups"].values():
        assert all(len(row) == len(table["columns"]) for row in rows.values())
        for k, column in enumerate(table["columns"]):
            values = [row[k] for name, row in rows.items() if name != ALL_ROW_LABEL]
            if values and ALL_ROW_LABEL in rows and column not in ("clips", "std"):
                assert min(values) <= rows[ALL_ROW_LABEL][k] <= max(values)


def test_counts_of_categories_add_up() -> None:
    for number in ("Table 7", "Table 8"):
        rows = published()[number]["groups"]["grasps"]
        assert sum(row[-1] for name, row in rows.items() if name != ALL_ROW_LABEL) == rows[ALL_ROW_LABEL][-1]


def test_best_and_second_are_marked_and_the_printed_number_stands_beside() -> None:
    def row(iou: float) -> dict[str, dict[str, float]]:
        return {"mug": {"IOU": iou, "SCA@0.8": math.nan, "SCA@0.6": 1.0}}

    table = PaperTable("Table 3", {"HOMan": row(50.0), "1-DoF": row(60.0), "soft hinge": row(70.0)})
    assert table.groups == ["HOMan", "Dynamic", "1-DoF", "soft hinge"]
    assert table.rows[-1] == ALL_ROW_LABEL
    assert table.cell("soft hinge", "mug", "IOU", latex=False) == "**70.0**"
    assert table.cell("1-DoF", "mug", "IOU", latex=False) == "<u>60.0</u> (62.6)"
    assert table.cell("HOMan", "mug", "IOU", latex=True) == "50.0 (59.4)"
    assert table.cell("Dynamic", "mug", "IOU", latex=False) == "– (63.8)"
    assert table.cell("1-DoF", "mug", "SCA@0.6", latex=False) == "1.0 (38.6)"  # all equal: none is best


@pytest.mark.parametrize("end", ["md", "tex", "json"])
def test_no_table_is_written_through_a_link(tmp_path: Path, end: str) -> None:
    other, out = tmp_path / "other", tmp_path / "out"
    other.write_text("a user's")
    out.mkdir()
    (out / f"tables.{end}").symlink_to(other)
    with suppress(InputError):
        write_paper_tables([], out, [])
    assert other.read_text() == "a user's"
