"""The pages in a real browser, from disk: no request, an object that moves, names that stay text, segments as a bar."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from getagrip.cli.report import Report
from getagrip.clip import OtherHand, input_sha256, write_clip
from getagrip.geometry import se3
from getagrip.metrics.evaluate import evaluate
from getagrip.report.pages import IndexRow, index_row_without_clip, write_index, write_page
from getagrip.report.pictures.result_view import View
from getagrip.result import Axis, Candidates, SegmentResult, write_result
from getagrip.result.findings import Finding, Probability
from helpers.annotation import IN_BROWSER, READS_BACK, until
from helpers.scenes import COMES, LIES, egg_and_mug, perfect, timeline

pytestmark = IN_BROWSER
EVIL = "<img src=x onerror=hacked=1><script>hacked=1<"
"""As a clip's name; with a slash it could not name a folder."""
FRAMES_SEEN = """() => {
  window.seen = new Set();
  const look = () => window.seen.add(document.getElementById("frame").textContent);
  new MutationObserver(look).observe(document.getElementById("frame"), { childList: true });
}"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: Any) -> Path:
    """Two results of one clip, one of them moved, one of changed input, and one that cannot be read; with an index."""
    root: Path = tmp_path_factory.mktemp("pages")
    clip, masks = egg_and_mug()
    aside = se3.rigid(t=np.array([-0.2, 0.0, 0.0])) @ clip.hand.T_cam_hand[:2]
    other = OtherHand.at(replace(clip.hand.take(np.arange(2)), T_cam_hand=aside), np.arange(2), len(clip))
    clip = replace(clip, name=EVIL, category="</script><script>hacked=1</script>", other_hand=other)
    written = write_clip(clip, masks, root / "clips" / "evil")
    good = perfect(clip, EVIL)
    T = good.T_hand_obj @ se3.rigid(t=np.array([0.0, 0.03, 0.0]))
    finding = Finding("mask-fit", True, 0.1, 0.7, f"</script>{EVIL}")
    axis = Axis(np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), np.linspace(0.0, 0.4, len(clip)))
    pair = Candidates(np.stack([T, good.T_hand_obj]), np.ones(2), np.array([1.0, 2.0]))
    moved = replace(
        good, method="one-dof", T_hand_obj=T, iou=np.linspace(0.9, 0.4, len(clip)), findings=(finding,), axis=axis,
        notes=(f"a guess: {EVIL}",), candidates=pair, ambiguous=True,
        probability_right=Probability(0.995, f"long {EVIL}"),
    )  # fmt: skip
    checksum = input_sha256(written)
    for name, result in (("good", good), ("moved", moved)):
        write_result(result, root / name / "one", checksum, clip_folder=written)
    changed = write_result(moved, root / "other" / "one", "0" * 64, {"iou": 0.6, "sca_object_10mm": None}, written)
    assert changed.is_dir()
    (root / "bad").mkdir()
    (root / "bad" / "result.json").write_text('{"version": 1}')
    assert Report(paths=(root,), workers=1).run() == 1
    assert (root / "moved" / "one" / "report.html").stat().st_size < 1_000_000
    return root


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A tab in which anything that is asked for but the files themselves, and any word in the console, is a failure."""
    tab = browser.new_page(viewport={"width": 900, "height": 1100})
    asked, said = [], []
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    yield tab
    assert [text for text in said if READS_BACK not in text] == []
    assert all(url.startswith(("file:", "data:image/jpeg;base64,")) for url in asked)
    assert sum(url.startswith("file:") for url in asked) == 1 + tab.evaluate("window.links || 0")
    assert tab.evaluate("typeof hacked") == "undefined"
    tab.close()


def opened(page: Any, path: Path) -> Any:
    page.goto(path.as_uri())
    page.locator("body[data-ready]").wait_for()
    return page


def canvas(page: Any) -> np.ndarray:
    """What the 3D view shows, once it has drawn: (H, W, 3) RGB between 0 and 1."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    encoded = np.frombuffer(page.locator(".scene").screenshot(), dtype=np.uint8)
    picture = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    assert picture is not None
    return picture[..., ::-1] / 255.0


def bluish(picture: np.ndarray) -> np.ndarray:
    """The object's pixels, in whatever light."""
    return np.asarray((picture[..., 2] > 1.25 * picture[..., 0]) & (picture[..., 2] > picture[..., 1]))


def skin(picture: np.ndarray) -> float:
    """The share of the hands' pixels."""
    return float(((picture[..., 0] > 1.2 * picture[..., 2]) & (picture[..., 0] > 0.2)).mean())


def slide(page: Any, place: int) -> None:
    page.locator("#slider").fill(str(place))


def test_the_object_is_there_and_moves_with_the_slider(page: Any, folder: Path) -> None:
    opened(page, folder / "moved" / "one" / "report.html")
    assert page.evaluate("document.body.dataset.ready") == "3d"
    first = bluish(canvas(page))
    assert first.mean() > 0.01
    slide(page, 4)
    assert "frame 000004" in page.inner_text("#frame")
    last = bluish(canvas(page))
    assert (first != last).mean() > 0.01
    outline = page.locator(".outlines .object .line")
    moved = outline.get_attribute("d")
    page.get_by_label("pose").select_option("1")
    assert (bluish(canvas(page)) != last).mean() > 0.005
    assert outline.get_attribute("d") != moved
    page.get_by_label("object", exact=True).first.uncheck()
    assert bluish(canvas(page)).mean() < 0.001
    page.get_by_label("seen from").select_option("hand")
    page.get_by_label("pose").select_option("0")
    page.get_by_label("object", exact=True).first.check()
    still = bluish(canvas(page))
    page.mouse.move(300, 400)
    page.mouse.down()
    page.mouse.move(380, 420)
    page.mouse.up()
    assert (bluish(canvas(page)) != still).mean() > 0.005
    page.get_by_role("button", name="reset view").click()
    assert (bluish(canvas(page)) != still).mean() < 0.001
    small = page.locator(".scene").bounding_box()["height"]
    page.get_by_role("button", name="full screen").click()
    until(page, "document.fullscreenElement !== null")
    large = page.locator(".scene").bounding_box()["height"]
    assert large > small
    page.get_by_role("button", name="full screen").click()
    until(page, "document.fullscreenElement === null")


def test_the_other_hand_is_there_in_its_own_frames(page: Any, folder: Path) -> None:
    opened(page, folder / "moved" / "one" / "report.html")
    seen = []
    for place in range(3):
        slide(page, place)
        seen.append(skin(canvas(page)))
    assert min(seen[:2]) > 1.5 * seen[2] > 0.0
    page.get_by_label("hands", exact=True).first.uncheck()
    assert skin(canvas(page)) == 0.0


def test_playing_goes_on_and_a_click_on_a_plot_jumps(page: Any, folder: Path) -> None:
    opened(page, folder / "moved" / "one" / "report.html")
    page.evaluate(FRAMES_SEEN)
    page.click("#play")
    until(page, "window.seen.size === 5")
    page.click("#play")
    plot = page.locator(".plot svg").nth(1)
    plot.click(position={"x": 0.5 * plot.bounding_box()["width"], "y": 40})
    assert "3 of 5" in page.inner_text("#frame")
    assert page.inner_text(".plot:nth-child(2) b") == "65.0 %"
    for key, place in (("ArrowRight", 4), ("ArrowLeft", 3)):
        page.keyboard.press(key)
        assert f"{place} of 5" in page.inner_text("#frame")


def test_words_of_strangers_stay_words(page: Any, folder: Path) -> None:
    opened(page, folder / "moved" / "one" / "report.html")
    assert page.inner_text("#name") == EVIL
    assert page.title() == f"{EVIL}, 1-DoF, ours"
    assert page.locator("img").count() == 0
    assert f"mask-fit </script>{EVIL}" in page.locator(".warnings li").all_inner_texts()
    assert page.locator(".notes li").all_inner_texts() == [f"a guess: {EVIL}"]


def test_findings_are_folded_the_serious_ones_first_and_open(page: Any, folder: Path) -> None:
    opened(page, folder / "moved" / "one" / "report.html")
    summaries, messages = (page.locator(f".warnings {part}") for part in ("summary", "li"))
    assert summaries.all_inner_texts() == ["1 serious finding mask-fit", "1 note ambiguous"]
    assert [messages.nth(n).is_visible() for n in range(2)] == [True, False]
    summaries.nth(1).click()
    assert messages.nth(1).inner_text() == (
        "ambiguous another pose explains the masks almost as well; the candidates below show it"
    )


def test_what_a_probability_means_is_said_once_and_folded(page: Any, folder: Path) -> None:
    opened(page, folder / "moved" / "one" / "report.html")
    assert "65.0 %\nIOU" in page.locator(".main div").all_inner_texts()  # the mean of the curve
    shown = page.locator(".main div").first
    assert shown.inner_text() == "> 99 %\nprobability right: hand"
    assert f"long {EVIL}" in shown.get_attribute("title")
    assert "long" not in page.inner_text("body")
    page.get_by_text("What the probabilities mean").click()
    assert page.inner_text("body").count("long") == 1


def test_the_index_sorts_filters_and_links(page: Any, folder: Path) -> None:
    opened(page, folder / "index.html")

    def sets() -> list[str]:
        return [text.split("\n")[1] for text in page.locator("tbody .name").all_inner_texts()]

    assert sets()[1:3] == ["moved", "good"]  # what has failed first, then the worst
    assert "bad/result.json" in sets()[0]
    assert page.locator(".summary tbody th").all_inner_texts() == ["moved", "good", "other"]
    page.locator("#order").select_option("best")
    assert sets()[:2] == ["good", "moved"]
    page.get_by_role("button", name="worst frame").click()
    assert sets()[1::2] == ["moved", "good"]
    assert sets()[2].startswith("other: ")
    assert "reconstruct it again" in sets()[2]
    assert page.inner_text("#facts") == "3 of 4 results, 1 failed. Pictures show the frame of the lowest IOU."
    assert page.inner_text("tbody .badge.failed") == "failed"
    assert page.locator("tbody .value.by").nth(1).inner_text() == "40.0"
    page.locator("thead").get_by_role("button", name="probability right in the hand").click()
    assert page.locator("tbody .value.by").nth(1).inner_text() == "> 99"
    page.get_by_role("button", name="worst frame").click()
    page.locator("#flags").select_option("serious")
    assert sets()[0] == "moved"
    assert len(sets()) == 2
    page.locator("#flags").select_option("any")
    page.fill("#words", "mask-fit onerror moved")
    assert sets() == ["moved"]
    page.locator("#form").select_option("gallery")
    assert page.locator(".gallery figure").count() == 1
    page.evaluate("window.links = 1")
    page.click(".gallery a >> nth=0")
    page.locator("body[data-ready='3d']").wait_for()
    page.evaluate("window.links = 1")


def test_an_index_says_no_more_than_there_is(page: Any, tmp_path: Path) -> None:
    """Of clips that have failed or are left, and without pictures."""
    clip, _ = egg_and_mug()
    done = index_row_without_clip("done", perfect(clip), {}, "")
    rows = [IndexRow("z", "no hand", flags=("failed",)), done, IndexRow("left", "not done yet", flags=("left",))]
    opened(page, write_index(rows, "results", ["summary.csv"], tmp_path / "index.html"))
    assert page.inner_text("#facts") == "1 of 3 results, 1 failed, 1 not done."
    assert page.inner_text("#footer").endswith("Tables: summary.csv")
    names = [text.split("\n")[0] for text in page.locator("tbody .name").all_inner_texts()]
    assert names == ["z", "egg-and-mug", "left"]
    red = page.locator(".badge.failed")
    assert red.all_inner_texts() == ["failed"]
    assert red.evaluate("(one) => getComputedStyle(one).backgroundColor") != page.locator(".badge").last.evaluate(
        "(one) => getComputedStyle(one).backgroundColor"
    )
    page.locator("#flags").select_option("left")
    assert page.inner_text("#facts") == "1 of 3 results, 1 failed, 1 not done, 1 shown."


@pytest.mark.slow
def test_segments_are_a_bar_that_jumps_and_divide_the_curves(browser: Any, tmp_path: Path) -> None:
    clip, masks = timeline()
    records = tuple(
        SegmentResult(state=s.state, first=clip.frames[s.first], last=clip.frames[s.last]) for s in clip.segments
    )
    result = replace(perfect(clip), segments=records)
    path = write_page(View.of(result, clip, masks), evaluate(result, clip, masks), {}, tmp_path / "report.html")
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.goto(path.as_uri())
    page.locator("body[data-ready]").wait_for()
    bar = page.locator("#segments button")
    assert bar.all_inner_texts() == ["static", "contact, right hand", "grasp, right hand"]
    boxes = [bar.nth(k).bounding_box() for k in range(3)]
    frame = (boxes[2]["x"] + boxes[2]["width"] - boxes[0]["x"]) / (len(clip) - 1)
    for box, frames in zip(boxes, (LIES - 0.5, COMES, len(clip) - LIES - COMES - 0.5), strict=True):
        assert box["width"] == pytest.approx(frames * frame, abs=1.0)
    bar.nth(2).click()
    assert f"{LIES + COMES + 1} of {len(clip)}" in page.inner_text("#frame")
    plot = page.locator(".plot svg").first
    assert (plot.locator(".border").count(), plot.locator("rect").count()) == (2, 3)
    assert "SCA 10 mm, in grasps" in page.locator(".main dt").all_inner_texts()
    page.close()
