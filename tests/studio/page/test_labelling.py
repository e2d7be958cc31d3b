"""Labelling in a real browser: from clicks to files and a reconstruction, reloaded, nothing lost; two tabs at once."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.cli import main
from getagrip.clip import input_sha256, read_clip, write_clip
from getagrip.errors import GetagripError
from getagrip.io.images import write_image
from getagrip.result import write_result
from getagrip.result.findings import Finding, Probability
from getagrip.studio import jobs
from getagrip.studio.jobs import BackgroundJob
from getagrip.studio.store.history import Change
from helpers.annotation import (
    BETWEEN,
    FIRST_FRAME,
    IN_BROWSER,
    LAST_FRAME,
    MARK,
    Served,
    click,
    click_joints,
    close,
    drag,
    draw,
    draw_disc,
    expect,
    goto,
    kept,
    near,
    on_screen,
    opened,
    saved,
    shows,
    until,
)
from helpers.clips import small_clip
from helpers.labelled_scene import circle, joints, middle
from helpers.results import true_result, two_candidates

pytestmark = IN_BROWSER


def write_report(words: Sequence[str]) -> str:
    folder = Path(words[1])
    write_image(folder / "report.png", np.zeros((40, 200, 3), np.uint8))
    (folder / "report.html").write_text("<p>the report of a plate</p>")
    return "report: done"


def folder_of(words: Sequence[str]) -> Path:
    """The folder of the result that a call of ``reconstruct`` makes."""
    return Path(words[words.index("--out") + 1]) / Path(words[1]).name


def write_empty_report(words: Sequence[str]) -> str:
    """What the commands write, without a fit."""
    if words[0] == "reconstruct":
        folder_of(words).mkdir(parents=True, exist_ok=True)
        (folder_of(words) / "result.json").touch()
    if words[0] == "report":
        write_report(words)
    return f"{words[0]}: done"


def label_frame(served: Served) -> None:
    """All joints of the first frame."""
    about = {"grasp": MARK, "task": "scene", "annotator": "ann", "tab": "a-tab-of-old"}
    clicked = {str(n): point for n, point in enumerate(joints(FIRST_FRAME))}
    served.project.label(about | {"change": "all-joints", "frame": FIRST_FRAME, "set": {"joints": clicked}})


def test_two_tabs_that_label_lose_nothing(context: Any, served: Served) -> None:
    one = opened(context, served)
    two = opened(context, served, None)
    click(one, [100, 100])
    expect(two.locator("#joint")).to_have_text("Next: Thumb root, at the wrist")  # without a reload
    click(two, [120, 100])
    two.keyboard.press("o")
    draw(two, circle(FIRST_FRAME, 6))
    drag(one, [100, 100], [90, 80])
    saved(one)
    saved(two)
    for page in (one, two):
        expect(page.locator("#keyframes li")).to_contain_text("2 joints · 1 polygon")
    state = kept(served)[FIRST_FRAME]
    assert near(state.joints["0"], [90, 80])
    assert near(state.joints["1"], [120, 100])
    assert near(state.polygons("object")[0], circle(FIRST_FRAME, 6))


def test_clicks_made_while_the_server_is_away_are_kept(context: Any, served: Served) -> None:
    page = opened(context, served)
    served.stop()
    click(page, [100, 100])
    expect(page.locator("#saved")).to_contain_text("Not saved")
    page.close()
    served.start()
    again = context.new_page()
    again.goto(served.server.url)
    saved(again)
    until(again, "localStorage.length < 2")
    assert near(kept(served)[FIRST_FRAME].joints["0"], [100, 100])


def test_an_address_opens_the_grasp_to_be_labelled(context: Any, served: Served) -> None:
    page = context.new_page()
    page.goto(f"{served.server.url}#annotator=ann&mesh=my+mug.obj&size-mm=95")
    expect(page.locator("#annotator")).to_have_text("ann")
    expect(page.locator("#mesh")).to_have_value("my mug.obj")
    expect(page.locator("#size-mm")).to_have_value("95")
    expect(page.locator("#back")).to_be_visible()


def test_from_clicks_to_files(context: Any, served: Served, tmp_path: Path) -> None:
    page = opened(context, served)
    for frame in (FIRST_FRAME, LAST_FRAME):
        goto(page, frame)
        click_joints(page, frame)
        draw_disc(page, frame)
    saved(page)
    assert near(list(kept(served)[LAST_FRAME].joints.values()), joints(LAST_FRAME), 0.8)
    page.keyboard.press("b")
    expect(page.locator("#fill-state")).to_have_text(
        f"All {LAST_FRAME - FIRST_FRAME + 1} frames filled in.", timeout=30_000
    )
    goto(page, BETWEEN)
    expect(page.locator("#layer path.draft.object")).to_have_count(1)
    expect(page.locator("#layer path.draft.hand")).to_have_count(1)
    box = page.locator("#layer path.draft.object").bounding_box()
    seen = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    assert near(seen, on_screen(page, middle(BETWEEN).tolist()), 12.0)
    page.keyboard.press("v")
    expect(page.locator("#layer path.draft")).to_have_count(0)
    page.keyboard.press("v")
    page.reload()
    shows(page, BETWEEN)  # where one was; what was filled in is still there
    expect(page.locator("#fill-state")).to_have_text(f"All {LAST_FRAME - FIRST_FRAME + 1} frames filled in.")
    goto(page, BETWEEN)
    page.keyboard.press("o")
    page.keyboard.press("k")
    saved(page)
    (taken,) = kept(served)[BETWEEN].polygons("object")
    drag(page, taken[0].tolist(), (taken[0] + [9, 9]).tolist())
    expect(page.locator("#fill-state")).to_contain_text("to be filled in")
    saved(page)
    page.click("#write")
    expect(page.locator("#command")).to_contain_text("getagrip clip new", timeout=30_000)
    (folder,) = [path for path in tmp_path.iterdir() if path.is_dir()]
    assert (folder / "hand.npz").is_file()
    assert len(list((folder / "masks").glob("*.png"))) == LAST_FRAME - FIRST_FRAME + 1
    with page.expect_download() as download:
        page.click("#labels-json")
    labels = json.loads(Path(download.value.path()).read_text())
    assert labels["frames"].keys() == {str(n) for n in (FIRST_FRAME, BETWEEN, LAST_FRAME)}


def test_it_ends_in_a_reconstruction(
    context: Any, served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clip is made as the commands make it; the fit, which takes its time, is left out here."""

    def ran(words: Sequence[str], job: BackgroundJob) -> str:
        if words[0] == "clip" and main([*words]):
            raise GetagripError(f"{words[words.index('--mesh') + 1]} is refused")
        return write_empty_report(words)

    monkeypatch.setattr(jobs, "run_command", ran)
    label_frame(served)
    page = opened(context, served)
    expect(page.locator("#reconstruct")).to_be_disabled()
    draw_disc(page, FIRST_FRAME)
    saved(page)
    assert page.input_value("#mesh") == "disc"  # what the grasp is of: there is no such shape
    expect(page.locator("#mesh-said")).to_contain_text("no such file")
    page.click("#reconstruct")
    expect(page.locator("#problem")).to_contain_text("disc: no such file")
    assert not (tmp_path / "clips").exists()
    page.click("#kind-pictures summary")
    page.get_by_role("button", name="plate", exact=True).click()
    expect(page.locator("#mesh-said")).to_be_hidden()
    page.fill("#size-mm", "18")
    page.locator("#size-mm").blur()
    expect(page.locator("#size-said")).to_contain_text("is 18 in millimetres?")
    page.fill("#size-mm", "180")
    page.locator("#size-mm").blur()
    expect(page.locator("#size-said")).to_be_hidden()
    page.click("#reconstruct")
    expect(page.locator("#outcome")).to_have_text("clip: done\nreconstruct: done", timeout=30_000)
    (clip,) = (tmp_path / "clips").iterdir()
    assert np.ptp(read_clip(clip).mesh.vertices, axis=0).max() == pytest.approx(0.18)
    with context.expect_page() as opens:
        page.click("#verdict-report")
    expect(opens.value.locator("body")).to_contain_text("the report of a plate")


def test_nothing_is_forgotten(context: Any, browser: Any, served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mesh, size, frame, tool and result are as they were after a reload, a restart, and in another browser."""
    monkeypatch.setattr(jobs, "run_command", lambda words, job: write_empty_report(words))
    label_frame(served)
    page = opened(context, served)
    draw_disc(page, FIRST_FRAME)
    page.fill("#mesh", "plate")
    page.fill("#size-mm", "180")
    page.click("#reconstruct")
    expect(page.locator("#outcome")).to_have_text("clip: done\nreconstruct: done", timeout=30_000)
    page.keyboard.press("i")
    goto(page, BETWEEN)
    page.wait_for_timeout(800)

    def is_as_it_was(page: Any) -> None:
        shows(page, BETWEEN)
        assert page.input_value("#mesh") == "plate"
        assert page.input_value("#size-mm") == "180"
        expect(page.locator("#tools [data-tool=front]")).to_have_attribute("aria-checked", "true")
        expect(page.locator("#outcome")).to_have_text("clip: done\nreconstruct: done")
        expect(page.locator("#outdated")).to_be_hidden()

    page.reload()
    is_as_it_was(page)
    served.stop()
    expect(page.locator("#saved")).to_contain_text("the server is not reached")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("b")
    page.wait_for_timeout(300)
    expect(page.locator("#problem")).to_be_hidden()  # it is said once
    served.start()
    saved(page)
    shows(page, BETWEEN + 1)
    expect(page.locator("#fill-state")).to_contain_text("frames filled in", timeout=30_000)
    goto(page, BETWEEN)
    page.wait_for_timeout(800)
    page.reload()
    is_as_it_was(page)
    other = browser.new_context()
    another = other.new_page()
    another.goto(served.server.url)
    another.fill("#name-field", "ann")
    another.keyboard.press("Enter")
    is_as_it_was(another)
    close(other)
    page.keyboard.press("o")
    goto(page, FIRST_FRAME)
    page.click("#outline-list button")
    expect(page.locator("#outdated")).to_be_visible()


def test_one_verdict_says_what_the_result_is(
    context: Any, served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Coloured, with its probability; the serious finding first; what the commands said is folded."""
    serious, note = (Finding("hand-size", worse, 1.0, 0.5, f"it is {worse}") for worse in (True, False))
    results = iter([
        {"findings": (note, serious)},
        {"findings": (note,), "probability_right": Probability(0.93, "within a tenth")},
    ])  # fmt: skip

    def ran(words: Sequence[str], job: BackgroundJob) -> str:
        if words[0] == "reconstruct":
            shutil.rmtree(folder_of(words), ignore_errors=True)
            one = replace(true_result(small_clip()[0], None), **next(results))
            write_result(one, folder_of(words), "", {}, tmp_path)
        return write_report(words) if words[0] == "report" else ""

    monkeypatch.setattr(jobs, "run_command", ran)
    label_frame(served)
    page = opened(context, served)
    expect(page.locator("#verdict")).to_be_hidden()
    draw_disc(page, FIRST_FRAME)
    page.fill("#mesh", "plate")
    page.click("#reconstruct")
    expect(page.locator("#verdict-word")).to_have_text("Looks wrong", timeout=30_000)
    expect(page.locator("#findings summary")).to_have_text("2 findings, 1 serious")
    expect(page.locator("#findings li")).to_have_text(["it is TrueState the size", "it is FalseState the size"])
    expect(page.locator("#outcome")).to_be_hidden()
    page.click("#steps button")
    expect(page.locator("#size-mm")).to_be_focused()
    page.click("#reconstruct")
    expect(page.locator("#verdict-word")).to_have_text("Looks right", timeout=30_000)
    expect(page.locator("#verdict-probability")).to_have_text("93 % that it is right")
    expect(page.locator("#findings summary")).to_have_text("1 finding")


def write_result_of_footage(folder: Path, tmp_path: Path) -> None:
    """A result of two candidates, the better one first, in the frames of the grasp."""
    result, clip, masks = two_candidates()
    names = tuple(f"{n + 1:06d}" for n in range(FIRST_FRAME, LAST_FRAME + 1))
    clip, found = replace(clip, frames=names), Finding("regrasp", False, 1.0, 0.5, "it jumps")
    if not (tmp_path / "a-clip").is_dir():
        write_clip(clip, masks, tmp_path / "a-clip")
    moved = result.T_hand_obj.copy()
    moved[4:, 0, 3] += 0.1
    result = replace(
        result, frames=names, T_hand_obj=moved, findings=(found,), assumptions={"scale": "by the hand"},
        candidates=replace(result.candidates, T_hand_obj=np.stack([moved, result.candidates.T_hand_obj[1]])),
    )  # fmt: skip
    shutil.rmtree(folder, ignore_errors=True)
    write_result(result, folder, input_sha256(tmp_path / "a-clip"), {}, tmp_path / "a-clip")


def test_the_result_is_in_the_picture(
    context: Any, served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As outlines in each frame, of each candidate; a step cuts the grasp, and another candidate becomes the result."""

    def ran(words: Sequence[str], job: BackgroundJob) -> str:
        if words[0] == "reconstruct":
            write_result_of_footage(folder_of(words), tmp_path)
            return "reconstruct: done"
        return write_report(words) if words[0] == "report" else "clip: done"

    def place(page: Any) -> tuple[float, float]:
        lines = page.locator("#layer path.result.object.above")
        expect(lines).to_have_count(1)
        box = lines.bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    monkeypatch.setattr(jobs, "run_command", ran)
    label_frame(served)
    page = opened(context, served)
    draw_disc(page, FIRST_FRAME)
    page.fill("#mesh", "plate")
    page.click("#reconstruct")
    expect(page.locator("#guessed")).to_have_text("Guessed: the object's size.", timeout=30_000)
    first = place(page)
    expect(page.locator("#layer path.result.hand")).to_have_count(2)
    goto(page, LAST_FRAME)
    page.wait_for_timeout(300)
    last = place(page)
    assert np.hypot(first[0] - last[0], first[1] - last[1]) > 10
    page.keyboard.press("r")
    expect(page.locator("#layer path.result")).to_have_count(0)
    expect(page.locator("#show-result")).not_to_be_checked()
    expect(page.locator("#steps button")).to_have_text(["Try candidate 2", "Draw frame 7", "State the size"])
    page.click("#steps button:has-text('Try candidate 2')")
    expect(page.locator("#candidate-said")).to_contain_text("Candidate 2 is in the picture")
    page.wait_for_timeout(300)
    other = place(page)
    assert np.hypot(other[0] - last[0], other[1] - last[1]) > 10
    page.click("#take")
    expect(page.locator("#candidate-said")).to_contain_text("Candidate 2 is the result now", timeout=30_000)
    page.wait_for_timeout(300)
    assert place(page) == pytest.approx(other, abs=1.0)
    page.click("#reconstruct")
    expect(page.locator("#findings")).to_be_visible(timeout=30_000)
    page.click("#findings summary")
    page.click("#findings button:has-text('Cut to 3–6')")
    expect(page.locator("#label-title")).to_have_text("Frames 3 – 6")
    expect(page.locator("#verdict")).to_be_hidden()  # it was of another interval
    assert served.project.marks("scene", "ann")["marks"][0]["end"] == LAST_FRAME - 1  # type: ignore[index]


def test_the_picture_is_the_page(context: Any, served: Served) -> None:
    """Most of a laptop's height; keys behind ?; on a phone what stays in sight leaves room for it."""
    page = opened(context, served)
    page.set_viewport_size({"width": 1280, "height": 720})
    until(page, "document.getElementById('screen').getBoundingClientRect().height >= 0.8 * innerHeight")
    lists = page.locator(".keys[data-in=labels] ul")
    expect(lists).to_be_hidden()
    page.keyboard.press("?")
    expect(lists).to_be_visible()
    page.keyboard.press("Escape")
    expect(lists).to_be_hidden()
    draw_disc(page, FIRST_FRAME)
    expect(page.locator("#reconstruct")).to_be_in_viewport()
    page.locator("#labels-json").scroll_into_view_if_needed()
    expect(page.locator("#reconstruct")).to_be_in_viewport()
    page.set_viewport_size({"width": 390, "height": 844})
    for place in ("#labels-json", "#screen"):
        page.locator(place).scroll_into_view_if_needed()
        expect(page.locator("#reconstruct")).to_be_in_viewport()
        heights = "['header', '.bar'].map((name) => document.querySelector(name).offsetHeight)"
        assert page.evaluate(f"{heights}.reduce((a, b) => a + b) <= innerHeight / 4")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.locator("#screen").bounding_box()["height"] > 844 / 2


def test_a_clip_is_done_when_it_has_a_result(context: Any, served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not before a stroke, though the grasp is marked, as ``label`` does."""
    monkeypatch.setattr(jobs, "run_command", lambda words, job: write_empty_report(words))
    about = {"task": "scene", "annotator": "ann", "grasp": MARK}
    served.project.set(about | {"set": {"mesh": "plate"}})
    page = opened(context, served)
    listed = page.locator("#task-list li").first
    expect(page.locator("#progress")).to_have_text("0 of 2 done")
    expect(listed).to_contain_text("not begun")
    label_frame(served)
    draw_disc(page, FIRST_FRAME)
    expect(listed).to_contain_text("drawn, no result")
    page.click("#reconstruct")
    expect(page.locator("#progress")).to_have_text("1 of 2 done", timeout=30_000)
    expect(listed).to_contain_text("uncertain")  # what was written does not read
    page.reload()
    expect(page.locator("#progress")).to_have_text("1 of 2 done")
    page.select_option("#filter", "amiss")
    expect(page.locator("#task-list li")).to_have_count(1)
    page.select_option("#filter", "open")
    expect(page.locator("#task-list li")).to_contain_text("another")
    page.keyboard.press("n")  # to the next of those listed
    expect(page.locator("#where")).to_have_text("another")
    page.keyboard.press("p")
    expect(page.locator("#where")).to_have_text("another")
    page.select_option("#filter", "all")
    page.keyboard.press("p")
    expect(page.locator("#where")).to_have_text("scene")


def test_the_next_step_is_shown_and_the_grasp_can_be_left(context: Any, served: Served) -> None:
    page = opened(context, served)
    expect(page.locator("#label-next")).to_contain_text("click the joints")
    before = page.locator("#screen").bounding_box()
    page.keyboard.press("b")
    expect(page.locator("#problem")).to_contain_text("nothing to fill in yet")
    assert page.locator("#screen").bounding_box() == before  # nothing moves when something is refused
    click(page, joints(FIRST_FRAME)[0])
    expect(page.locator("#problem")).to_be_hidden()
    page.keyboard.press("o")
    expect(page.locator("#label-next")).to_contain_text("6 joints at least")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#label-next")).to_contain_text("not part of the grasp")
    click(page, [50, 50])
    page.keyboard.press("l")
    expect(page.locator("#definition")).to_be_visible()
    expect(page.locator("#layer *")).to_have_count(0)
    page.reload()
    expect(page.locator("#definition")).to_be_visible()
    expect(page.locator("#marks li")).to_have_count(1)
    assert kept(served).keys() == {FIRST_FRAME}
    page.keyboard.press("l")
    expect(page.locator("#keyframes li")).to_have_count(1)


def test_what_was_just_moved_is_kept_when_another_clip_is_opened(context: Any, served: Served) -> None:
    page = opened(context, served)
    click(page, [100, 100])
    saved(page)
    before = kept(served)[FIRST_FRAME].joints["0"]
    page.keyboard.press("Shift+d")
    page.keyboard.press("n")
    expect(page.locator("#where")).to_have_text("another")
    expect(page.locator("#definition")).to_be_visible()
    saved(page)
    assert kept(served)[FIRST_FRAME].joints["0"][0] > before[0]
    expect(page.locator("#problem")).to_be_hidden()


def test_what_was_changed_elsewhere_is_not_undone(context: Any, served: Served) -> None:
    page = opened(context, served)
    click(page, [100, 100])
    saved(page)
    store, state = served.project.store.keyframes, kept(served)[FIRST_FRAME]
    store.apply(Change("elsewhere", "another-tab", {}), state, lambda old, _: replace(old, hidden=True))
    page.keyboard.press("u")
    expect(page.locator("#problem")).to_contain_text("another tab")
    assert kept(served)[FIRST_FRAME].joints


def test_the_title_says_what_the_page_is_for(context: Any, served: Served) -> None:
    page = opened(context, served)
    expect(page.locator("#title")).to_have_text("Labels")
    assert page.title() == "Labels, scene"
    page.click("#back")
    expect(page.locator("#title")).to_have_text("Grasps and segments")
    draft = context.new_page()
    draft.goto(f"{served.server.url}#annotator=ann")
    shows(draft, FIRST_FRAME)
    expect(draft.locator("#title")).to_have_text("Draft")
