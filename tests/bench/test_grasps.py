"""``getagrip bench`` on clips of grasps: tables, results that are kept, hands and other systems."""

from __future__ import annotations

import csv
import importlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.batch.ledger import Ledger
from getagrip.bench import grasps
from getagrip.bench.comparison import GraspClipScores
from getagrip.bench.inputs.hand_sources import HandSource
from getagrip.clip import Clip, read_clip, write_clip
from getagrip.clip.write import write_hand
from getagrip.errors import GetagripError
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.metrics.evaluate import evaluate_result
from getagrip.metrics.evaluate.results import read_result_clip_masks
from getagrip.result import read_result
from helpers.environment import Run


@pytest.fixture
def unplotted(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures: they take longer than small runs."""
    monkeypatch.setattr("getagrip.bench.comparison.plot_ablation", lambda *_: None)


@pytest.mark.slow
def test_a_run_writes_tables_and_goes_on_where_it_stopped(
    can_and_box: Path, tmp_path: Path, run: Run, monkeypatch
) -> None:
    out, written = tmp_path / "out", tmp_path / "all.json"
    call = ("bench", can_and_box, "--out", out, "--workers", "1", "--inits", "4", "--json", written)
    status, text, err = run(*call, "--methods", "static")
    assert (status, err) == (0, "")
    assert "1 done, 0 already done" in text
    status, text, _ = run(*call, "--methods", "one-dof", "static")
    assert status == 0
    assert text.count("1 done, 1 already done") == 2
    with monkeypatch.context() as patch:  # all is there: nothing is reconstructed, no mask is read
        patch.setattr(grasps, "read_masks", lambda _: pytest.fail("masks were read"))
        status, text, _ = run(*call, "--methods", "one-dof", "static", "--keep", "0.9")
    assert text.count("0 done, 2 already done") == 2
    assert text.count("of 2 kept for 90 % right in the hand") == 2

    rows = list(csv.DictReader((out / "methods-clips.csv").read_text().splitlines()))
    names = ["box-right-0000", "can-right-0000"]
    assert [(row["clip"], row["method"]) for row in rows] == [(n, m) for n in names for m in ("one-dof", "static")]
    result, record = read_result(out / "results" / "one-dof" / names[0])
    assert float(rows[0]["iou"]) == record["metrics"]["iou"]
    assert float(rows[0]["energy"]) == result.energy["total"]
    content = json.loads(written.read_text())
    mean = content["tables"][0]["rows"][0]["values"]["IOU"]["mean"]
    assert mean == pytest.approx(np.mean([float(row["iou"]) for row in rows if row["method"] == "one-dof"]))
    page = (out / "methods.md").read_text()
    assert f"{100 * mean:.1f}" in page
    assert "Box: 1 clip" in page
    assert run("evaluate", out / "results" / "static")[0] == 0  # they are results like any other


@pytest.mark.slow
def test_a_run_has_a_ledger_shards_and_an_end_at_the_first_failure(
    can_and_box: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []

    def unreadable(trial: grasps.GraspTrial) -> GraspClipScores:
        tried.append(trial.name)
        raise GetagripError("no masks")

    monkeypatch.setattr(grasps.GraspTrial, "scores", unreadable)
    call = ("bench", can_and_box, "--out", tmp_path, "--workers", "1")
    assert run(*call, "--fail-fast")[0] == 1
    assert tried == ["box-right-0000"]
    with Ledger(tmp_path) as ledger:
        assert [(entry.name, entry.state, entry.why) for entry in ledger.entries()] == [
            ("box-right-0000", "failed", "no masks")
        ]
    for shard in ("1/2", "2/2"):
        run(*call, "--shard", shard)
    assert sorted(tried[1:]) == ["box-right-0000", "can-right-0000"]


@pytest.mark.slow
def test_results_of_other_systems_are_rows(can_and_box: Path, tmp_path: Path, run: Run) -> None:
    """Poses by clip, evaluated in the frames of ours; again where they change, and failed where they are missing."""
    theirs, out = tmp_path / "theirs", tmp_path / "out"
    theirs.mkdir()
    truths = {}
    for folder in sorted(can_and_box.iterdir()):
        clip = read_clip(folder)
        assert clip.truth is not None
        truths[clip.name] = clip.truth.T_cam_obj
        np.save(theirs / f"{clip.name}.npy", clip.truth.T_cam_obj)
    call = ("bench", can_and_box, "--out", out, "--workers", "1", "--inits", "4", "--methods", "static")
    status, text, err = run(*call, "--with", f"theirs={theirs}")
    assert (status, err) == (0, "")
    assert text.count("2 done, 0 already done") == 2
    rows = {(r["clip"], r["method"]): r for r in csv.DictReader((out / "methods-clips.csv").read_text().splitlines())}
    assert {method for _, method in rows} == {"static", "theirs"}
    assert all(float(rows[name, "theirs"]["add_mm"]) < 1e-3 for name in truths)
    assert "theirs" in (out / "methods.md").read_text()
    assert run("evaluate", out / "results" / "theirs")[0] == 0  # results like any other
    first, second = truths
    np.save(theirs / f"{first}.npy", truths[first] @ se3.rigid(None, np.array([0.01, 0.0, 0.0])))
    (theirs / f"{second}.npy").unlink()
    status, text, err = run(*call, "--with", f"theirs={theirs}")
    assert status == 1
    assert f"{second}: theirs" in text + err
    assert "no poses of the clip" in text + err
    rows = {(r["clip"], r["method"]): r for r in csv.DictReader((out / "methods-clips.csv").read_text().splitlines())}
    assert float(rows[first, "theirs"]["add_mm"]) == pytest.approx(10.0, abs=1e-3)


@pytest.mark.slow
def test_other_systems_poses_are_refined_and_result_folders_keep_their_columns(
    can_and_box: Path, tmp_path: Path, run: Run
) -> None:
    out, theirs = tmp_path / "out", tmp_path / "theirs"
    theirs.mkdir()
    for folder in sorted(can_and_box.iterdir()):
        clip = read_clip(folder)
        assert clip.truth is not None
        T = clip.truth.T_cam_obj.copy()
        T[:, :3, 3] *= 1.03  # a tracker with a mesh of another size
        np.save(theirs / f"{clip.name}.npy", T)
    call = ("bench", can_and_box, "--workers", "1", "--inits", "4", "--methods", "soft-hinge")
    assert run(*call, "--out", out, "--with", f"theirs={theirs}", "--refine")[0] == 0

    def rows(of: Path) -> dict[tuple[str, str], dict[str, str]]:
        lines = csv.DictReader((of / "methods-clips.csv").read_text().splitlines())
        return {(row["clip"], row["setting"]): row for row in lines}

    first = rows(out)
    for clip in ("box-right-0000", "can-right-0000"):
        before, after = (float(first[clip, s]["add_sym_mm"]) for s in ("theirs", "theirs, refined"))
        assert after < before
    again = tmp_path / "again"
    assert run(*call, "--out", again, "--with", f"kept={out / 'results' / 'theirs+refined'}")[0] == 0
    for (clip, setting), row in rows(again).items():
        if setting == "kept":
            assert {**row, "method": "", "setting": ""} == {
                **first[clip, "theirs, refined"],
                "method": "",
                "setting": "",
            }


@pytest.mark.slow
def test_an_ablation_changes_clips_and_draws_a_plot(can_and_box: Path, tmp_path: Path, run: Run) -> None:
    call = ("bench", can_and_box, "--out", tmp_path, "--workers", "1", "--inits", "4", "--clips", "1")
    status, _, _ = run(*call, "--ablation", "mask-noise", "--methods", "static")
    assert status == 0
    assert (tmp_path / "mask-noise.png").stat().st_size > 10_000
    rows = list(csv.DictReader((tmp_path / "mask-noise-clips.csv").read_text().splitlines()))
    assert [row["setting"] for row in rows] == ["none", "0.5 px", "1 px", "2 px", "4 px"]
    assert len({row["add_mm"] for row in rows}) == 5
    noisy = tmp_path / "results" / "static+mask-noise-4-px"
    status, _, err = run("evaluate", noisy)  # its clip is no longer the one in the folder
    assert status == 1
    assert "input_sha256" in err


def hand_file(folder: Path, clip: Clip, frames: list[int], mm: float = 0.0, **extra: Any) -> None:
    """A clip's hands in some frames, so far displaced, as `import hands --out` writes them."""
    folder.mkdir(exist_ok=True)
    hand = clip.take(np.array(frames)).hand
    T = hand.T_cam_hand.copy()
    T[:, 0, 3] += mm / 1e3
    numbers = np.array([int(clip.frames[n]) for n in frames])
    write_hand(replace(hand, T_cam_hand=T), folder / f"{clip.name}.npz", {"frames": numbers, **extra})


@pytest.mark.slow
@pytest.mark.usefixtures("unplotted")
def test_hands_are_compared_on_the_frames_that_all_have(can_and_box: Path, tmp_path: Path, run: Run) -> None:
    clip = read_clip(can_and_box / "box")
    hand_file(tmp_path / "exact", clip, [0, 1, 2, 3], K=clip.K[0])
    hand_file(tmp_path / "off", clip, [1, 2, 3], mm=6.0, side=np.array(clip.side))
    out, written = tmp_path / "out", tmp_path / "all.json"
    sources = (f"exact={tmp_path / 'exact'}", f"off={tmp_path / 'off'}")
    call = (
        "bench",
        can_and_box / "box",
        "--out",
        out,
        "--workers",
        "1",
        "--inits",
        "4",
        "--methods",
        "static",
        "--json",
        written,
    )
    status, printed, err = run(*call, "--hands", *sources)
    assert (status, err) == (0, "")
    assert printed.count("2 done, 0 already done") == 1
    (table, *_) = json.loads(written.read_text())["tables"]
    assert [(row["row"], row["against"]) for row in table["rows"]] == [
        ("static, exact", None), ("static, off", "static, exact"),
    ]  # fmt: skip
    assert (out / "hands.md").read_text().startswith("# Hands, on the frames that all of them have")
    for variant in ("static+hands-exact", "static+hands-off"):
        assert read_result(out / "results" / variant / clip.name)[0].frames == clip.frames[1:]
    assert run(*call, "--hands", *sources)[1].count("0 done, 2 already done") == 1
    # The hands are kept beside the results, so that these can be evaluated and drawn.
    results = [out / "results" / f"static+hands-{name}" / clip.name for name in ("exact", "off")]
    exact, off = (read_result_clip_masks(folder)[1].hand for folder in results)
    np.testing.assert_array_equal(exact.T_cam_hand, clip.hand.T_cam_hand[1:])
    assert np.abs(off.T_cam_hand - exact.T_cam_hand).max() > 1e-3
    assert run("figure", "hands", *results, "--out", tmp_path / "hands.png", "--dpi", 40, "--frames", 1)[0] == 0
    hand_file(tmp_path / "off", clip, [1, 2], mm=6.0)  # its hands are others now
    assert run(*call, "--hands", *sources)[1].count("2 done, 0 already done") == 1
    assert read_result(out / "results" / "static+hands-exact" / clip.name)[0].frames == clip.frames[1:3]
    # Clips are hands, too; what does not fit is named.
    write_clip(replace(clip, hand=clip.hand), grasps.read_masks(clip), tmp_path / "clips" / clip.name)
    assert HandSource.of(f"c={tmp_path / 'clips'}").read(clip).track == clip.hand
    for bad, words in (
        ({"frames": [1]}, "1 of the 4 frames"), ({"frames": [1, 2], "side": np.array("left")}, "got 'left'"),
    ):  # fmt: skip
        hand_file(tmp_path / "off", clip, **bad)
        status, _, err = run(*call, "--hands", *sources)
        assert (status, f"failed: {clip.name}" in err, words in err) == (1, True, True)
    (tmp_path / "off" / f"{clip.name}.npz").unlink()
    assert "must be off's hands of the clip" in run(*call, "--hands", *sources)[2]
    for wrong in (("exact",), ("exact=nowhere",), (sources[0], sources[0])):
        assert run(*call, "--hands", *wrong)[0] == 2
    assert run(*call, "--hands", *sources, "--ablation", "scale")[0] == 2


@pytest.mark.slow
def test_contact_is_measured_within_any_distance(can_and_box: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    """Of results that are there, by evaluating them again; wider contact has more points in it."""
    module = importlib.import_module("getagrip.reconstruct")

    out = tmp_path / "out"
    call = ("bench", can_and_box, "--out", out, "--workers", "1", "--methods", "static", "--clips", "1", "--inits", "4")
    assert run(*call)[0] == 0
    assert "contact: object vertices within 10 mm" in (out / "methods.md").read_text()
    monkeypatch.setattr(module, "reconstruct", lambda *_: pytest.fail("reconstructed again"))
    written = tmp_path / "all.json"
    assert run(*call, "--contact", "0", "2.5", "20", "--json", written)[0] == 0
    rows = json.loads(written.read_text())["tables"][0]["rows"]
    assert [row["row"] for row in rows] == ["static, 0 mm", "static, 2.5 mm", "static, 20 mm"]
    assert [row["contact"] for row in rows] == ["object_0mm", "object_2.5mm", "object_20mm"]
    (result,) = out.glob("results/static/*")
    metrics = read_result(result)[1]["metrics"]
    for row, mm in zip(rows, ("0", "2.5", "20"), strict=True):
        assert row["values"]["SCA"]["mean"] == metrics[f"sca_object_{mm}mm"]
    shares = evaluate_result(result).per_frame
    assert np.mean(shares["contact_share_object_0mm"]) <= np.mean(shares["contact_share_object_10mm"])
    assert "0 done, 1 already" in run(*call, "--contact", "2.5")[1]
    assert "contact: object vertices within 2.5 mm" in (out / "methods.tex").read_text()
    assert run(*call, "--contact", "51")[0] == 2


@pytest.mark.slow
def test_results_of_other_options_are_made_again(can_and_box: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    call = ("bench", can_and_box, "--out", tmp_path, "--workers", "1", "--methods", "static", "--clips", "1")
    assert "1 done" in run(*call, "--inits", "4")[1]
    assert "1 done" in run(*call, "--inits", "5")[1]
    assert "0 done, 1 already done\n" in run(*call, "--inits", "5")[1]
    assert "1 done" in run(*call, "--inits", "5", "--overwrite")[1]


@pytest.mark.slow
def test_what_is_done_again_is_said(can_and_box: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    """Results of other code and damaged ones; those that other code has measured are only measured again."""
    module = importlib.import_module("getagrip.reconstruct")

    exact, made = module.reconstruct, list[str]()

    def counted(clip: Any, masks: Any, options: Options) -> Any:
        made.append(options.method)
        return exact(clip, masks, options)

    monkeypatch.setattr(module, "reconstruct", counted)
    call = ("bench", can_and_box, "--out", tmp_path, "--workers", "1", "--methods", "static", "--clips", "1")
    call += ("--inits", "4")
    said = run(*call)[1]
    assert "1 done, 0 already done\n" in said
    (folder,) = tmp_path.glob("results/static/*")

    def edited(**software: str) -> None:
        record = json.loads((folder / "result.json").read_text())
        record["software"] |= software
        (folder / "result.json").write_text(json.dumps(record))

    for damage in ("result.npz", "result.json"):
        content = (folder / damage).read_bytes()
        (folder / damage).write_bytes(content[: len(content) // 2])
        status, said, err = run(*call)
        assert (status, err) == (0, "")
        assert "1 done, 0 already done; 1 done again, since the earlier result is damaged (" in said
        assert read_result(folder)[1]["metrics"]
    edited(code="0123456789abcdef")
    assert "1 done again, since the earlier result is of other code\n" in run(*call)[1]
    edited(getagrip="0.0.1")
    assert "1 done again, since the earlier result is of version '0.0.1'\n" in run(*call)[1]
    assert len(made) == 5
    edited(evaluation="0123456789abcdef")
    assert "1 done, 0 already done\n" in run(*call)[1]
    assert "0 done, 1 already done\n" in run(*call)[1]
    assert len(made) == 5


@pytest.mark.slow
def test_what_fails_is_named_and_the_rest_done(can_and_box: Path, tmp_path: Path, run: Run, monkeypatch) -> None:
    folder = tmp_path / "clips"
    for name in ("can", "box"):
        clip = read_clip(can_and_box / name)
        write_clip(clip, grasps.read_masks(clip), folder / name)
    for mask in (folder / "can" / "masks" / "object").iterdir():
        mask.write_bytes(b"")
    module = importlib.import_module("getagrip.reconstruct")

    exact = module.reconstruct

    def sometimes(clip: Any, masks: Any, options: Options) -> Any:
        if options.method == "static":
            raise GetagripError("nothing is seen")
        return exact(clip, masks, options)

    monkeypatch.setattr(module, "reconstruct", sometimes)
    call = ("bench", folder, "--out", tmp_path / "out", "--workers", "1", "--inits", "4")
    status, out, err = run(*call, "--methods", "one-dof", "static")
    assert status == 1
    assert "failed: can-right-0000" in err
    assert "failed: box-right-0000: static: nothing is seen" in err
    assert "1 done, 0 already done, 1 failed" in out
    rows = list(csv.DictReader((tmp_path / "out" / "methods-clips.csv").read_text().splitlines()))
    assert [row["status"].startswith("failed") for row in rows] == [False, True, True]


METHOD = """
from dataclasses import replace
from getagrip.fitting.methods import METHODS, Method
from getagrip.fitting.methods.all_frames import static

def fit(problem, on_stage):
    found = static(problem, on_stage)
    return replace(found, terms=found.terms | {"mine": 1.0})

METHODS["static"] = Method("mine", fit)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "why"),
    [(None, ""), (("1.0", "2.0"), "another source of its method"), (("<file>", "<stdin>"), "is in no file")],
)
def test_results_of_a_method_from_outside_are_kept_while_its_source_is_the_same(
    can_and_box: Path, tmp_path: Path, run: Run, monkeypatch, unplotted: None, change: tuple[str, str] | None, why: str
) -> None:
    source, out = tmp_path / "mine.py", tmp_path / "out"
    call = ("bench", can_and_box, "--out", out, "--workers", "1", "--inits", "2", "--methods", "static")

    def load(text: str, name: str) -> None:
        source.write_text(text)
        exec(compile(text, name, "exec"), {"__name__": "mine"})

    monkeypatch.setitem(METHODS, "static", METHODS["static"])  # put back in the end
    load(METHOD, str(source))
    assert "1 done, 0 already done" in run(*call)[1]
    load(METHOD.replace(*change) if change else METHOD, "<stdin>" if "no file" in why else str(source))
    status, text, _ = run(*call)
    assert status == 0
    assert ("0 done, 1 already done" in text) == (change is None)
    assert why in text
    if change == ("1.0", "2.0"):
        assert read_result(out / "results" / "static" / "can-right-0000")[0].energy["mine"] == 2.0
