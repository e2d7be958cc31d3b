"""Key frames: nothing that was clicked is lost, what no person can click is refused, drafts and files come of them."""

from __future__ import annotations

import json
import sqlite3
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.annotate import labels, marks, propagated_masks
from getagrip.annotate.background import Background, BackgroundJob
from getagrip.annotate.labels import MOST_CORNERS
from getagrip.annotate.project import Project
from getagrip.annotate.server import LARGEST_BODY, Server
from getagrip.annotate.store import APPLICATION, Store
from getagrip.annotate.tasks import Task
from getagrip.annotate.tracing import traced
from getagrip.annotate.versions import RefusedError
from getagrip.clip import read_clip, read_masks
from getagrip.clip.segments import polygons
from getagrip.commands.annotate import DATABASE, write_labels
from getagrip.errors import GetagripError
from helpers.annotation_page import ask
from helpers.clips import box
from helpers.command_line import Run
from helpers.labelled_scene import FRAMES, HEIGHT, WIDTH, circle, joints, write_scene

VIDEO = "scene"
FIRST, LAST = 2, 9
TAB = "tab-one-"


@pytest.fixture(scope="module")
def video(tmp_path_factory: Any) -> Path:
    return write_scene(tmp_path_factory.mktemp("video") / f"{VIDEO}.mp4")


def new() -> str:
    return str(uuid.uuid4())


class Clicking:
    """A project, and a grasp that somebody labels in it."""

    def __init__(self, video: Path, folder: Path, who: str = "ann") -> None:
        self.project = Project([Task(VIDEO, VIDEO, video)], Store(folder / DATABASE))
        self.about = {"task": VIDEO, "annotator": who, "grasp": new()}
        start = {"start": FIRST, "side": "left", "category": "disc"}
        for sets in (start, {"end": LAST}):
            self.project.change(self.about | {"change": new(), "mark": self.about["grasp"], "tab": TAB, "set": sets})

    def change(self, frame: int, sets: object, tab: str = TAB) -> dict[str, Any]:
        return self.about | {"change": new(), "tab": tab, "frame": frame, "set": sets}

    def click(self, frame: int, tab: str = TAB, **sets: Any) -> dict[str, Any]:
        return self.project.label(self.change(frame, sets, tab))

    def undo(self, tab: str = TAB) -> dict[str, Any]:
        return self.project.unlabel(self.about | {"change": new(), "tab": tab})

    def state(self) -> dict[str, Any]:
        return self.project.labels(self.about)

    def labels(self) -> list[dict[str, Any]]:
        return self.state()["keyframes"]

    def label(self, frame: int) -> None:
        """All that there is to be clicked on a frame."""
        self.click(frame, joints={str(n): point for n, point in enumerate(joints(frame))}, outlines=disc(frame))

    def work(self, what: str) -> dict[str, Any]:
        """Have something done; the job once it is over."""
        self.project.work(self.about | {"work": what})
        job = self.project.labelling.background.job(self.about["grasp"])
        assert job is not None
        for _ in range(3000):
            if job.state not in ("waiting", "running"):
                break
            time.sleep(0.02)
        return dict(self.state()["job"])


def disc(frame: int, closed: bool = True) -> dict[str, Any]:
    return {"the-disc": {"of": "object", "closed": closed, "points": circle(frame)}}


@pytest.fixture
def clicking(video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Clicking]:
    """Masks are carried at a quarter of the size, which is quicker."""
    monkeypatch.setattr(propagated_masks, "SIDE", 50.0)
    made = Clicking(video, tmp_path)
    yield made
    made.project.close()


@pytest.mark.slow
def test_what_was_clicked_is_there_when_the_file_is_opened_again(clicking: Clicking) -> None:
    clicking.click(4, joints={"0": [10, 20.126], "1": "unseen"}, outlines=disc(4))
    clicking.click(9, hidden=True)
    before = clicking.labels()
    assert [one["frame"] for one in before] == [4, 9]
    assert before[0]["joints"] == {"0": [10.0, 20.13], "1": "unseen"}
    assert before[0]["number"] == 5
    again = Project(list(clicking.project.tasks.values()), Store(clicking.project.store.path))
    assert again.labels(clicking.about)["keyframes"] == before
    again.close()


def test_two_tabs_that_click_on_one_frame_lose_nothing(clicking: Clicking) -> None:
    clicking.click(4, "tab-one-", joints={"0": [10, 20], "1": [30, 40]})
    clicking.click(4, "tab-two-", joints={"2": [50, 60]}, outlines=disc(4, closed=False))
    clicking.click(4, "tab-one-", joints={"1": [31, 41]}, outlines={"another-": disc(5)["the-disc"]})
    (frame,) = clicking.labels()
    assert frame["joints"] == {"0": [10.0, 20.0], "1": [31.0, 41.0], "2": [50.0, 60.0]}
    assert frame["outlines"].keys() == {"the-disc", "another-"}
    with pytest.raises(RefusedError, match="another tab"):
        clicking.undo("tab-two-")
    assert clicking.undo("tab-one-")["frame"] == 4
    (frame,) = clicking.labels()
    assert frame["joints"]["1"] == [30.0, 40.0]


steps = st.lists(
    st.tuples(
        st.integers(FIRST, FIRST + 2),
        st.one_of(
            st.builds(
                lambda n, x: {"joints": {str(n): x}}, st.integers(0, 3), st.sampled_from([[1, 2], "unseen", None])
            ),
            st.builds(lambda c: {"outlines": {"the-disc": c}}, st.sampled_from([disc(3)["the-disc"], None])),
            st.builds(lambda b: {"hidden": b}, st.booleans()),
            st.just({"deleted": True}),
        ),
    ),
    max_size=8,
)


@settings(max_examples=10)
@given(steps)
@pytest.mark.slow
def test_undo_goes_back_through_every_state(
    tmp_path_factory: Any, video: Path, steps: list[tuple[int, dict[str, Any]]]
) -> None:
    made = Clicking(video, tmp_path_factory.mktemp("undo"))
    states = [made.labels()]
    for frame, sets in steps:
        made.click(frame, **sets)
        states.append(made.labels())
    for state in reversed(states[:-1]):
        assert made.undo()["undone"]
        assert made.labels() == state
    assert not made.undo()["undone"]
    assert len(made.project.marks(VIDEO, "ann")["marks"]) == 1  # of clicks, not of the grasp
    made.project.close()


def test_a_frame_without_anything_is_no_key_frame_and_can_be_begun_again(clicking: Clicking) -> None:
    clicking.click(4, joints={"0": [10, 20], "1": [1, 1]}, outlines=disc(4))
    clicking.click(4, deleted=True)
    assert clicking.labels() == []
    clicking.click(4, joints={"2": [10, 20]})
    assert clicking.labels()[0]["joints"] == {"2": [10.0, 20.0]}
    clicking.click(4, joints={"2": None})
    assert clicking.labels() == []


def test_a_click_that_is_sent_twice_is_made_once(clicking: Clicking) -> None:
    sent = clicking.change(4, {"joints": {"0": [10, 20]}})
    clicking.project.label(sent)
    clicking.project.label(sent)
    assert len(clicking.project.store.keyframes.history(f"{clicking.about['grasp']}:4")) == 1


def test_databases_of_marks_alone_are_completed(video: Path, tmp_path: Path) -> None:
    path, mark = tmp_path / DATABASE, new()
    with sqlite3.connect(path) as old:
        old.executescript(marks.SCHEMA)
        old.execute("PRAGMA user_version = 1")
        old.execute(f"PRAGMA application_id = {APPLICATION}")
        old.execute(
            "INSERT INTO versions (change, tab, at, mark, task, annotator, start, end, side, deleted) "
            f"VALUES ('{new()}', '{TAB}', '', '{mark}', '{VIDEO}', 'ann', {FIRST}, {LAST}, 'left', 0)"
        )
    project = Project([Task(VIDEO, VIDEO, video)], Store(path))
    about = {"task": VIDEO, "annotator": "ann", "grasp": mark}
    project.label(about | {"change": new(), "tab": TAB, "frame": 4, "set": {"joints": {"0": [1, 2]}}})
    assert len(project.labels(about)["keyframes"]) == 1
    project.close()


# ---- what no person can click --------------------------------------------------------------------------------------

NAN, INFINITE = float("nan"), float("inf")
POINTS: list[Any] = [
    [NAN, 1], [1, INFINITE], [1], [1, 2, 3], "12", [True, 1], ["1", 2], {}, [[1, 2]], 7, [-WIDTH - 1, 0], [0, 1e300],
    [10**400, 0],
]  # fmt: skip
POLYGONS: list[Any] = [
    [], "x", 3, {"of": "object", "closed": True}, {"of": "hand", "closed": True, "points": circle(3)},
    {"of": "object", "closed": 1, "points": circle(3)}, {"of": "object", "closed": True, "points": circle(3)[:2]},
    {"of": "object", "closed": False, "points": []}, {"of": "object", "closed": True, "points": "abc"},
    {"of": "object", "closed": True, "points": [[1, 1]] * (MOST_CORNERS + 1)},
    {"of": ["object"], "closed": True, "points": circle(3)},
    {"of": "object", "closed": True, "points": [*circle(3), [NAN, 0]]},
    {"of": "object", "closed": True, "points": [*circle(3), [0, 2 * HEIGHT + 1]]},
    {"of": "object", "closed": True, "points": circle(3), "more": 1},
]  # fmt: skip
SETS: list[Any] = [
    {}, [], None, "joints", {"colour": 1}, {"joints": []}, {"joints": {"21": [1, 2]}}, {"joints": {"-1": [1, 2]}},
    {"joints": {"0.0": [1, 2]}}, {"joints": {"": [1, 2]}}, {"outlines": [1]}, {"outlines": {"../../x": None}},
    {"outlines": {"a": disc(3)["the-disc"]}}, {"hidden": 1}, {"hidden": None}, {"deleted": "yes"},
    {"outlines": {f"outline-{n}": disc(3)["the-disc"] for n in range(101)}},
    *({"joints": {"0": point}} for point in POINTS), *({"outlines": {"the-disc": one}} for one in POLYGONS),
]  # fmt: skip


@pytest.mark.parametrize("sets", SETS, ids=range(len(SETS)))
def test_impossible_clicks_are_refused_and_change_nothing(clicking: Clicking, sets: Any) -> None:
    with pytest.raises(RefusedError):
        clicking.project.label(clicking.change(4, sets))
    assert clicking.state()["newest"] == 0


@pytest.mark.parametrize("frame", [-1, FRAMES, 10**30, "4", 4.0, True, None, [4]])
def test_frames_that_are_not_there_are_refused(clicking: Clicking, frame: Any) -> None:
    with pytest.raises(RefusedError):
        clicking.project.label(clicking.change(frame, {"joints": {"0": [1, 2]}}))


json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


@given(json_values, st.sampled_from(["joints", "outlines", "hidden", "deleted", "points", "point"]))
@pytest.mark.slow
def test_any_json_is_kept_or_refused(video: Path, tmp_path_factory: Any, value: Any, where: str) -> None:
    made = Clicking(video, tmp_path_factory.mktemp("any"))
    whole = {"of": "object", "closed": True, "points": value}
    sets = {"points": {"outlines": {"the-disc": whole}}, "point": {"joints": {"3": value}}}.get(where, {where: value})
    try:
        made.click(4, **sets)
    except RefusedError:
        assert made.state()["newest"] == 0
    json.dumps(made.state(), allow_nan=False)
    made.project.labelling.labels(made.project._grasp(made.about))
    made.project.close()


def test_grasps_of_others_are_out_of_reach(clicking: Clicking) -> None:
    for key, value in (("annotator", "bob"), ("grasp", new()), ("grasp", None), ("grasp", ["x"]), ("task", "other")):
        for act in (clicking.project.label, clicking.project.unlabel, clicking.project.work, clicking.project.labels):
            with pytest.raises(RefusedError):
                act(clicking.change(4, {"joints": {"0": [1, 2]}}) | {"work": "propagate", key: value})
    clicking.project.change(
        clicking.about | {"change": new(), "mark": clicking.about["grasp"], "tab": TAB, "set": {"end": None}}
    )
    with pytest.raises(RefusedError, match="end of the grasp"):
        clicking.state()


# ---- HTTP ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def server(clicking: Clicking) -> Iterator[Server]:
    with Server(clicking.project, 0) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def test_labels_over_http(server: Server, clicking: Clicking) -> None:
    where = "&".join(f"{key}={value}" for key, value in clicking.about.items())
    status, _, answer = ask(server, "/api/label", clicking.change(4, {"joints": {"0": [10, 20]}}))
    assert (status, json.loads(answer)["keyframes"][0]["frame"]) == (200, 4)
    assert json.loads(ask(server, f"/api/labels?{where}")[2])["extent"] == [FIRST, LAST]
    assert json.loads(ask(server, f"/api/drafts?{where}&since=0")[2]) == {"drafts": []}
    status, head, text = ask(server, f"/labels.json?{where}")
    assert status == 200
    assert f"labels-ann-scene-{FIRST + 1}-{LAST + 1}-left.json" in head["Content-Disposition"]
    assert labels.parse(json.loads(text), "labels.json").frames.keys() == {4}
    status, _, image = ask(server, f"/frame?task={VIDEO}&n=4&whole=1")
    assert (status, image[:2]) == (200, b"\xff\xd8")
    status, _, answer = ask(server, "/api/unlabel", clicking.about | {"change": new(), "tab": TAB})
    assert (json.loads(answer)["undone"], json.loads(answer)["frame"]) == (True, 4)


@pytest.mark.slow
def test_hostile_clicks_over_http_are_answered_in_words(server: Server, clicking: Clicking) -> None:
    many = {"outlines": {"the-disc": {"of": "object", "closed": True, "points": [[1, 1]] * 10**6}}}
    body = json.dumps(clicking.change(4, {"joints": {"0": [1, 2]}}))
    bodies = {
        json.dumps(clicking.change(4, many)): 400, body.replace("[1, 2]", "[NaN, 1e999]"): 409,
        body.replace("[1, 2]", "[" * 40_000 + "]" * 40_000): 400, body.replace("[1, 2]", '"' + "x" * 60_000 + '"'): 409,
        body.replace("[1, 2]", "[1" + "0" * 5000 + ", 2]"): 400, body[:-1]: 400,
    }  # fmt: skip
    for text, expected in bodies.items():
        status, head, answer = ask(server, "/api/label", text.encode())
        assert (status, head["Content-Type"]) == (expected, "application/json")
        assert len(answer) < 1000
    assert len(json.dumps(many)) > LARGEST_BODY
    for path, content in (
        ("/api/work", {"work": "rm"}),
        ("/api/work", {"work": {}}),
        ("/api/label", {}),
        ("/api/unlabel", {}),
    ):
        assert ask(server, path, clicking.about | content)[0] == 409
    for path in ("/api/labels", "/api/drafts", "/labels.json", "/api/drafts?since=-1"):
        assert ask(server, path)[0] in (400, 409)
    assert clicking.state()["newest"] == 0


# ---- drafts and files ----------------------------------------------------------------------------------------------


def filled(outlines: list[Any]) -> np.ndarray:
    flat = [np.ravel(shape).tolist() for shape in outlines]
    return polygons(Path(), "", flat, (WIDTH, HEIGHT))


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def word(basis: dict[str, Any], draft: dict[str, Any]) -> str:
    """What a draft's frame would be made of now."""
    (found,) = (word for first, last, word in basis[draft["kind"]] if first <= draft["frame"] <= last)
    return str(found)


@pytest.mark.slow
def test_frames_between_are_filled_in_and_again_after_a_correction(clicking: Clicking) -> None:
    clicking.label(FIRST)
    clicking.label(LAST)
    assert clicking.work("propagate")["state"] == "done"
    basis, drafts = clicking.state()["basis"], clicking.project.drafts(clicking.about, 0)["drafts"]
    found = {(one["kind"], one["frame"]): one for one in drafts}
    assert found.keys() == {(kind, n) for kind in ("masks", "hand") for n in range(FIRST, LAST + 1)}
    assert all(one["basis"] == word(basis, one) for one in drafts)
    for n in range(FIRST, LAST + 1):
        assert iou(filled(found["masks", n]["content"]["object"]), filled([circle(n)])) > 0.9
        assert found["masks", n]["content"]["number"] == n + 1
        off = np.linalg.norm(np.array(found["hand", n]["content"]["joints"]) - joints(n), axis=1)
        assert np.median(off) < 4.0
    clicking.click(6, outlines=disc(6))
    assert clicking.state()["basis"]["masks"] != basis["masks"]
    assert clicking.state()["basis"]["hand"] == basis["hand"]
    newest = clicking.state()["drafts"]
    assert clicking.work("propagate")["state"] == "done"
    again = clicking.project.drafts(clicking.about, newest)["drafts"]
    assert {one["kind"] for one in again} == {"masks"}  # the hand is as it was
    assert {one["frame"] for one in again} == {*range(FIRST + 1, LAST)}  # the two ends, too
    assert all(one["basis"] == word(clicking.state()["basis"], one) for one in again)
    assert clicking.work("propagate")["state"] == "done"
    assert clicking.state()["drafts"] == again[-1]["seq"]  # nothing to be done
    clicking.click(8, outlines=disc(8))
    assert clicking.work("propagate")["state"] == "done"
    between = clicking.project.drafts(clicking.about, again[-1]["seq"])["drafts"]
    assert {one["frame"] for one in between} == {*range(7, LAST)}  # those before the neighbour are as they were


def test_too_few_labels_are_reported(clicking: Clicking) -> None:
    for what in ("propagate", "files"):
        with pytest.raises(RefusedError):
            clicking.project.work(clicking.about | {"work": what})
    clicking.click(4, joints={"0": [10, 20]}, outlines=disc(4))
    with pytest.raises(RefusedError, match="frame 5 has 1 joints"):
        clicking.project.work(clicking.about | {"work": "propagate"})


@pytest.mark.slow
def test_clicks_that_are_no_hand_are_reported_with_the_number_of_their_frame_and_masks_filled_in(
    clicking: Clicking,
) -> None:
    clicking.click(FIRST, joints={str(n): [150.0, 100.0] for n in range(21)}, outlines=disc(FIRST))
    job = clicking.work("propagate")
    assert job["state"] == "failed"
    assert f"frame {FIRST + 1}:" in job["message"]
    drafts = clicking.project.drafts(clicking.about, 0)["drafts"]
    assert [(one["kind"], one["frame"]) for one in drafts] == [("masks", n) for n in range(FIRST, LAST + 1)]


@pytest.mark.slow
def test_files_make_a_clip_and_labels_are_taken_back(clicking: Clicking, video: Path, run: Run, tmp_path: Path) -> None:
    for frame in (FIRST, LAST):
        clicking.label(frame)
    clicking.click(7, hidden=False, outlines={"in-front": {"of": "front", "closed": True, "points": circle(1)}})
    job = clicking.work("files")
    assert job["state"] == "done", job
    (tmp_path / "mesh.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in box(0.1, 0.1, 0.01).vertices)
        + "".join("f {} {} {}\n".format(*(face + 1)) for face in box(1, 1, 1).faces)
    )
    words = job["message"].replace("MESH", str(tmp_path / "mesh.obj")).replace("CLIP", str(tmp_path / "clip")).split()
    status, _, err = run(*words[1:])
    assert status == 0, err
    clip = read_clip(tmp_path / "clip")
    masks = read_masks(clip)
    assert (len(clip), clip.side) == (LAST - FIRST + 1, "left")
    seen, row = filled([circle(6)]), 6 - FIRST
    assert iou(masks.object[row], seen) > 0.9
    assert masks.ignore[row].any()  # the hand is in front
    (file,) = tmp_path.glob("labels-*.json")
    other = tmp_path / "other"
    assert run("annotate", video, "--out", other, "--import-labels", file, "--annotator", "bob")[0] == 0
    assert run("annotate", video, "--out", other, "--import-labels", file, "--annotator", "bob", "--export")[0] == 0
    (again,) = other.glob("labels-*.json")
    assert again.read_text() == file.read_text()
    assert len(json.loads((other / "grasps-bob.json").read_text())) <= 1  # the grasp was marked once
    assert run("annotate", video, "--out", other, "--import-labels", video)[0] == 1
    wrong = json.loads(file.read_text()) | {"video": "other.mp4", "sha256": 64 * "0"}
    (tmp_path / "wrong.json").write_text(json.dumps(wrong))
    status, _, err = run("annotate", video, "--out", other, "--import-labels", tmp_path / "wrong.json")
    assert status == 1
    assert "wrong.json" in err


def test_labels_that_do_not_suffice_are_exported_alone(clicking: Clicking, capsys: Any, tmp_path: Path) -> None:
    clicking.click(4, outlines=disc(4))
    assert write_labels(clicking.project) == 1
    assert "labels only" in capsys.readouterr().err
    assert len(list(tmp_path.glob("labels-*.json"))) == 1


shapes = st.lists(
    st.tuples(st.integers(40, 280), st.integers(40, 200), st.integers(8, 60), st.integers(8, 60), st.booleans()),
    min_size=1,
    max_size=4,
)


@given(shapes)
def test_traced_polygons_give_the_mask_again(shapes: list[tuple[int, int, int, int, bool]]) -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    mask = np.zeros((HEIGHT, WIDTH), bool)
    for x, y, a, b, adds in shapes:
        inside = ((u - x) / a) ** 2 + ((v - y) / b) ** 2 < 1
        mask = mask | inside if adds else mask & ~inside
    found = traced(mask)
    if mask.sum() > 400:
        assert iou(filled(found), mask) > 0.93
    assert all(len(one) >= 3 for one in found)


def test_a_ring_has_one_polygon_with_its_hole() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    distance = np.hypot(u - 150, v - 120)
    ring = (distance < 80) & (distance > 40)
    (outline,) = traced(ring)
    assert iou(filled([outline]), ring) > 0.97


# ---- work in the background ----------------------------------------------------------------------------------------


def test_new_work_on_a_grasp_ends_the_old_and_errors_are_reported() -> None:
    background, begun = Background(), threading.Event()

    def forever(job: BackgroundJob) -> str:
        begun.set()
        while True:
            job.report(1, 2)
            time.sleep(0.005)

    def wrong(job: BackgroundJob) -> str:
        raise GetagripError("no joints")

    def broken(job: BackgroundJob) -> str:
        raise ZeroDivisionError

    background.start("a", "propagate", forever)
    old = background.job("a")
    assert begun.wait(5)
    background.start("a", "propagate", wrong)
    background.start("b", "files", broken)
    background.start("c", "files", lambda job: "made")
    background.start("d", "files", forever)
    for _ in range(1000):
        if (job := background.job("d")) and job.state == "running":
            break
        time.sleep(0.005)
    assert old is not None
    assert old.state == "cancelled"
    jobs = {key: background.job(key) for key in "abc"}
    assert [job.state for job in jobs.values() if job] == ["failed", "failed", "done"]
    assert [job.message for job in jobs.values() if job][0::2] == ["no joints", "made"]
    background.close()  # ends what runs for ever
