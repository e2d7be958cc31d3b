"""Results are data: tables in ``results/``, cited by pages, made from the output of a bench."""

from __future__ import annotations

import math
import re
import subprocess
from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest
import tyro
from tyro.conf import OmitArgPrefixes

from benchmarks import again, cite, release, results, store, test_runs
from benchmarks.release import BENCHES
from benchmarks.store import Column, Table
from getagrip.bench.ablations import ablation_variants, method_variants
from getagrip.bench.comparison import GraspClipScores, compare_variants
from getagrip.bench.tables import clips_csv_rows, comparison_csv_rows, comparison_markdown
from getagrip.cli.bench import Bench, Benches
from getagrip.fitting.options import Options
from getagrip.io import files
from helpers.measures import score
from helpers.pages import PAGES

TABLE = Table(
    "Two methods",
    {"date": "2026-11-25", "commit": "abc", "command": "getagrip bench"},
    [Column("add_sym", "ADD sym.", "%", 1, "highest"), Column("seconds", "s", "s", 2), Column("notes", "notes")],
    [
        {"label": "one-dof, 2.5 px", "add_sym": [87.14, 81, 93.26], "seconds": 0.5},
        {"label": "soft-hinge, 2.5 px", "add_sym": [98.6, 96.04, 100], "notes": {"regrasp": 2}},
    ],
    [{"label": "soft-hinge, 2.5 px", "against": "one-dof, 2.5 px", "add_sym": [11.46, -4.3, 20]}],
    ["70 clips"],
)


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of results with the table "two"."""
    read, made = store.read, store.write("two", TABLE, tmp_path)
    monkeypatch.setattr(store, "read", lambda name: read(name, tmp_path))
    return made.parent


@pytest.mark.parametrize("name", store.names())
def test_a_table_says_how_it_was_made_and_declares_its_columns(name: str, tmp_path: Path) -> None:
    table = store.read(name)
    keys = [column.key for column in table.columns]
    assert {"date", "command", "commit"} <= set(table.made)
    assert len(set(keys)) == len(keys)
    for row in (*table.rows, *table.differences):
        assert set(row) - {"label", "against"} <= set(keys)
    text = (store.RESULTS / f"{name}.json").read_text(encoding="utf-8")
    assert store.write(name, table, tmp_path).read_text(encoding="utf-8") == text


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_say_what_was_measured(page: Path) -> None:
    """Complete where they lie: each place is followed by what ``results/`` has now."""
    text = page.read_text(encoding="utf-8")
    assert cite.fill_written(text) == text, "run python -m benchmarks.results"
    assert text.count("{{") == len(cite.WRITTEN.findall(text))
    assert not re.findall(r"\S\n *<!-- \{\{", text), "a comment at the beginning of a line ends the paragraph"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_line_begins_with_per_cent_which_makes_it_a_comment(page: Path) -> None:
    assert not re.findall(r"^\s*%.*", page.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize(
    "place",
    ["no-such.row.add_sym", "dexycb-methods.no-such.add_sym", "dexycb-methods.soft-hinge.no-such",
     "dexycb-methods.soft-hinge", "table dexycb-methods rows=no-such", "made no-such"],
)  # fmt: skip
def test_an_unknown_key_is_an_error(place: str) -> None:
    with pytest.raises(KeyError, match="choose from"):
        cite.fill(f"a {{{{ {place} }}}} b")


def test_a_number_is_cited_as_it_is_asked_for(two: Path) -> None:
    place = "two.soft-hinge-2-5-px.add_sym"
    assert cite.fill(f"{{{{ {place} }}}}") == "98.6"
    assert cite.fill(f"{{{{ {place} 0 unit interval }}}}") == "99 % [96, 100]"
    assert cite.fill(f"{{{{ {place} difference interval }}}}") == "+11.5 [−4.3, +20.0]"
    assert cite.fill(f"{{{{ {place} difference absolute 0 }}}} points") == "11 points"
    assert cite.fill(f"{{{{ {place} minus=one-dof-2-5-px }}}}") == "+11.5"
    assert cite.fill("{{ two.one-dof-2-5-px.notes }}, {{ two.soft-hinge-2-5-px.notes }}") == "–, regrasp 2"


def test_a_table_shows_some_columns_and_rows_and_how_it_was_made(two: Path) -> None:
    grid, made = cite.fill("{{ table two columns=add_sym rows=* }}").split("\n\n")
    assert grid.splitlines()[2:] == ["| one-dof, 2.5 px | 87.1 |", "| soft-hinge, 2.5 px | **98.6** |"]
    assert made == "*Commit abc, 2026-11-25: `getagrip bench`*"
    assert "| soft-hinge, 2.5 px − one-dof, 2.5 px | +11.5 |" in cite.fill("{{ table two columns=add_sym difference }}")
    page = "<!-- {{ two.one-dof-2-5-px.seconds }} -->old<!-- end -->"
    assert cite.fill_written(page) == page.replace("old", "0.50")


def test_a_row_is_a_line_and_two_of_a_key_are_refused(two: Path) -> None:
    lines = (two / "two.json").read_text(encoding="utf-8").splitlines()
    assert sum('"label": "soft-hinge, 2.5 px"' in line and line.endswith(("}", "},")) for line in lines) == 2
    assert store.read("two") == TABLE
    with pytest.raises(ValueError, match="same key"):
        store.write("two", Table("", {}, [], [{"label": "a b"}, {"label": "a, b"}]), two)


def test_the_output_of_a_bench_becomes_a_table(tmp_path: Path) -> None:
    variants = method_variants(["one-dof", "soft-hinge"], Options())
    scores = [
        GraspClipScores(f"c{n}", "can", "", True, (score("one-dof", n % 2), score("soft-hinge", 1.0))) for n in range(6)
    ]
    tables, folder = compare_variants(scores, variants), tmp_path / "dexycb"
    folder.mkdir()
    files.write_csv(folder / "methods.csv", comparison_csv_rows(tables))
    files.write_csv(folder / "methods-clips.csv", clips_csv_rows(scores, variants))
    about, settings = ["dexycb: 6 clips; made 2026-11-25, commit abc"], ["seed 0", "python 3.11"]
    (folder / "methods.md").write_text(comparison_markdown(tables, "Methods", about, settings))
    (name, table) = next(iter(results.found(folder).items()))
    assert name == "dexycb-methods"
    one, soft = table.rows
    assert soft["add_sym"] == 100.0 or soft["add_sym"] == [100.0, 100.0, 100.0]
    assert one["add_sym"][0] == 50.0
    assert (one["clips"], one["wrong"], soft["wrong"]) == (6, 3, 0)
    assert table.differences[0]["against"] == "one-dof"
    assert table.differences[0]["add_sym"][0] == 50.0
    assert table.made["commit"] == "abc"
    assert table.made["versions"] == "python 3.11"
    assert table.made["command"] == BENCHES["dexycb-methods"]
    assert [*table.notes] == ["dexycb: 6 clips", "seed 0"]


def test_counts_are_found_where_the_method_differs_from_row_to_row(tmp_path: Path) -> None:
    variants = ablation_variants("departures", [], Options())
    scores = [
        GraspClipScores(f"c{n}", "can", "", True, tuple(score(v.folder, n % 2) for v in variants)) for n in range(4)
    ]
    tables, folder = compare_variants(scores, variants), tmp_path / "dexycb"
    folder.mkdir()
    files.write_csv(folder / "departures.csv", comparison_csv_rows(tables))
    files.write_csv(folder / "departures-clips.csv", clips_csv_rows(scores, variants))
    (folder / "departures.md").write_text(comparison_markdown(tables, "Departures", [], []))
    table = results.found(folder)["dexycb-departures"]
    assert [row["label"] for row in table.rows][1::8] == ["paper, as it is", "paper, + soft hinge"]
    assert all((row["failed"], row["wrong"]) == (0, 2) for row in table.rows)
    assert table.title == store.read("dexycb-departures").title


def test_a_printed_table_becomes_data(tmp_path: Path) -> None:
    page = tmp_path / "exact.md"
    page.write_text(
        "# Timelines\n\n| hands |  | grasp | jump, mm |\n|---|---|---:|---:|\n| exact | joint | 98.6 [96, 100] (n = 71)"
        " | 1.4 |\n| exact | alone | – | 1,400 |\n\n- 50 initial poses; made 2026-11-24, commit abc\n"
    )
    table = results.printed("made-up", page)
    assert [*table.rows] == [
        {"label": "exact, joint", "grasp": [98.6, 96, 100, 71], "jump_mm": 1.4},
        {"label": "exact, alone", "jump_mm": 1400},
    ]
    assert table.column("jump_mm").unit == "mm"
    assert table.made == {"date": "2026-11-24", "commit": "abc"}


def test_a_table_names_the_machine_that_measured_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Output of today was made here; older output that is converted again keeps the machine that its table named."""
    page, how = tmp_path / "methods.md", {"date": "2026-11-24", "commit": "abc", "command": BENCHES["dexycb-methods"]}

    def machine(made: str) -> str | None:
        page.write_text(f"# Methods\n\n|  | s |\n|---|---:|\n| one-dof | 1 |\n\n- 6 clips; made {made}, commit abc\n")
        return results.printed("dexycb-methods", page).made.get("machine")

    monkeypatch.setattr(results, "machine", lambda: "this one")
    assert machine(date.today().isoformat()) == "this one"
    assert machine("2026-11-24") is None
    monkeypatch.setattr(store, "read", lambda name: replace(TABLE, made={**how, "machine": "another"}))
    assert machine("2026-11-24") == "another"
    assert machine("2026-11-23") is None
    assert machine(date.today().isoformat()) == "this one"


def test_a_release_measures_tables_that_are_kept() -> None:
    for name, command in BENCHES.items():
        out = Path(re.findall(r"--out (\S+)", command)[0]).name
        assert name.startswith(f"{out}-")


def test_the_leaderboard_has_every_method_and_the_paper_s_numbers() -> None:
    board = cite.said("leaderboard")
    rows = [line for line in board.splitlines() if line.startswith("| ")][2:]
    methods = {
        store.key_of(row) for name in ("dexycb-methods", "dexycb-paper-methods") for row in store.read(name).rows
    }
    assert len(rows) == len(methods) + 5
    row = store.read("dexycb-methods").row("soft-hinge")
    (ours,) = (line for line in rows if line.startswith("| `soft-hinge` |"))
    assert f"{row['add'][0]:.1f} / {row['sca_add'][0]:.1f}" in ours


def test_a_release_is_measured_in_order_and_summed_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls = list[list[str]]()

    def run(call: list[str], check: bool) -> subprocess.CompletedProcess[bytes]:
        calls.append(call[3:])
        bench: Bench = tyro.cli(Benches, args=call[4:], config=(OmitArgPrefixes,))  # all its options are known
        assert bench.benchmark()
        return subprocess.CompletedProcess(call, 1)

    monkeypatch.setattr(subprocess, "run", run)
    assert release.main(["DEXYCB", "YCB", "--out", str(tmp_path), "--clips", "2"]) == 1
    assert len(calls) == sum("OTHER" not in words for words in BENCHES.values())  # test objects only where given
    assert calls[0] == [
        *("bench", "dexycb", "--root", "DEXYCB", "--meshes", "YCB", "--out", str(tmp_path / "dexycb")),
        *("--ablation", "inputs", "--clips", "2"),
    ]
    assert "dexycb-inputs: 0.0 min, no table; failures: exit status 1" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        release.main(["DEXYCB", "YCB", "--only", "dexycb-other-final"])


def test_every_run_of_the_test_objects_is_noted_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = list[int]()

    def run(call: list[str], check: bool) -> subprocess.CompletedProcess[bytes]:
        noted.append(len(store.read("test-runs", tmp_path).rows))
        return subprocess.CompletedProcess(call, 1)  # nor does it matter that it fails

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(test_runs, "FOLDER", tmp_path)
    monkeypatch.setattr(test_runs, "date_and_commit", lambda: "2026-11-28, commit abc1234")
    asked = ["DEXYCB", "YCB", "--other", "OTHER", "--out", str(tmp_path), "--clips", "2", "--only", *test_runs.tables()]
    assert release.main(asked) == 1
    assert noted == [n for n, _ in enumerate(test_runs.tables(), start=1)]
    assert [row["table"] for row in store.read("test-runs", tmp_path).rows] == test_runs.tables()
    assert test_runs.noted("dexycb-other-final", "abc1234e")
    assert not test_runs.noted("dexycb-other-final", "def5678")


def test_a_table_of_the_test_objects_is_taken_from_a_noted_run_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder := tmp_path / "dexycb-other").mkdir()
    (folder / "final.md").write_text(
        "# Final\n\n|  | s |\n|---|---:|\n| one-dof | 1 |\n\n- made 2026-11-24, commit abc\n"
    )
    written = list[str]()
    monkeypatch.setattr(store, "write", lambda name, table: written.append(name))
    monkeypatch.setattr(test_runs, "noted", lambda name, commit: False)
    with pytest.raises(SystemExit, match="make results only"):
        results.main([folder])
    assert not written


def test_all_runs_that_git_knows_are_listed() -> None:
    listed = [(row["table"], row["commit"]) for row in store.read("test-runs").rows]
    names = "dexycb-other-final", "dexycb-other-final-evidence"
    for name in names:
        assert (name, store.read(name).made["commit"]) in listed
    main, evidence = (sum(table == name for table, _ in listed[:8]) for name in names)
    assert (main, evidence) == (2, 6)


def test_numbers_by_clip_are_kept_in_the_same_bytes_each_time(tmp_path: Path) -> None:
    text = "clip,iou\na,0.5\nb,0.25\n"
    first, second = (store.write_clips(name, text, tmp_path).read_bytes() for name in ("one", "two"))
    assert first == second
    assert store.read_clips("one", tmp_path) == [{"clip": "a", "iou": "0.5"}, {"clip": "b", "iou": "0.25"}]
    with pytest.raises(KeyError, match="not kept"):
        store.read_clips("three", tmp_path)


def test_a_slice_that_is_made_again_is_compared_number_by_number() -> None:
    lines = [
        {"clip": clip, "method": "one-dof", "setting": "", "seconds": "1", "iou": "0.5", "status": "ok"}
        for clip in "abcdefg"
    ]
    assert again.chosen(lines, 3) == ["a", "d", "g"]
    slower = [line | {"seconds": "9"} for line in lines]
    assert dict(again.differences(lines, slower)) == {}
    other = [lines[0] | {"iou": "0.4"}, lines[1] | {"status": "misfit"}, *lines[2:]]
    assert dict(again.differences(lines, other)) == {"iou": pytest.approx(0.2), "status": math.inf}
    assert "line" in dict(again.differences(lines, lines[1:]))


def test_a_slice_is_made_by_the_table_s_own_command(capsys: pytest.CaptureFixture[str]) -> None:
    words = again.command("dexycb-inputs", Path("f.txt"), Path("o"), {"DEXYCB": "/d", "YCB": "/y"})
    assert words == ["bench", "dexycb", "--root", "/d", "--meshes", "/y", "--ablation", "inputs", "--only", "f.txt",
                     "--out", "o"]  # fmt: skip
    with pytest.raises(KeyError, match="missing DEXYCB=DIR"):
        again.command("dexycb-inputs", Path("f.txt"), Path("o"), {})
    assert again.main(["dexycb-physical", "DEXYCB=d", "YCB=y"]) == 1
    assert "numbers by clip were not kept" in capsys.readouterr().err


def test_the_error_in_mm_stands_beside_the_share_that_is_right() -> None:
    heads = cite.said("table dexycb-methods columns=iou,add_sym,sca").splitlines()[0].split(" | ")
    assert heads[heads.index("ADD sym., %") + 1] == "median error, mm"
    assert "`one-dof`, same filters, mm" in cite.said("inputs dexycb-inputs soft-hinge one-dof").splitlines()[0]


def test_objects_are_summed_up_from_the_numbers_by_clip(monkeypatch: pytest.MonkeyPatch) -> None:
    one = {"method": "soft-hinge", "category": "007_tuna_can", "diameter_mm": "90", "add_sym_success": "1.0"}
    lines = [one | {"add_sym_mm": "4"}, one | {"add_sym_mm": "30", "add_sym_success": "0.0"}]
    lines += [
        one | {"category": "036_wood_block", "diameter_mm": "237", "add_sym_mm": "9"},
        one | {"method": "one-dof"},
    ]
    monkeypatch.setattr(store, "read_clips", lambda name: lines)
    table = cite.said("objects dexycb-methods soft-hinge").splitlines()
    assert table[2:4] == ["| tuna can | 90 | 2 | 1 | 17.0 | 30 | 1 |", "| wood block | 237 | 1 | 1 | 9.0 | 9 | 1 |"]
