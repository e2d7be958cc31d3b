"""The served pages: their entries in order, the answers to a page, and who gets them."""

from __future__ import annotations

import base64
import http.client
import json
import socket
import threading
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.cli.report import find_results_and_clips
from getagrip.clip import input_sha256, write_clip
from getagrip.errors import UsageError
from getagrip.metrics.evaluate.results import Evaluation
from getagrip.report.pages import viewer
from getagrip.report.pages.result_page import write_page
from getagrip.report.pages.viewer import (
    GROUND_TRUTH_LABEL,
    ViewerLibrary,
    ViewerServer,
    entry_severity_key,
    group_entries,
    label_views,
)
from getagrip.report.pictures.result_view import View
from getagrip.report.serving import LOOPBACK
from getagrip.result import Reconstruction, read_result_record, write_result
from getagrip.result.findings import Finding
from helpers.environment import Run
from helpers.results import two_candidates, view

SERIOUS = Finding("contact-gap", True, 40.0, 15.0, "they are far apart")


def never(error: Exception) -> None:
    raise error


def result(iou: float, *findings: Finding) -> Reconstruction:
    made = two_candidates()[0]
    return replace(made, iou=np.full(len(made.frames), iou), findings=findings)


@pytest.fixture(scope="module")
def root(tmp_path_factory: Any) -> Path:
    """Two clips; results of two methods for the one, of one method for the other; nothing is changed by tests."""
    made: Path = tmp_path_factory.mktemp("entries")
    _, clip, masks = two_candidates()
    for name, iou, methods in (("good", 0.9, ("one-dof", "static")), ("bad", 0.4, ("one-dof",))):
        folder = write_clip(replace(clip, name=name), masks, made / "clips" / name)
        for method in methods:
            one = replace(result(iou), clip=name, method=method)
            write_result(one, made / "results" / method / name, input_sha256(folder), clip_folder=folder)
    return made


def test_serious_findings_come_first_and_then_the_lowest_iou() -> None:
    given = {"fine": result(0.9), "poor": result(0.3), "flagged": result(0.95, SERIOUS)}
    assert sorted(given, key=lambda name: entry_severity_key([given[name]])) == ["flagged", "poor", "fine"]


@pytest.mark.slow
def test_a_folder_of_methods_is_listed_by_clip_the_worst_first(root: Path) -> None:
    problems: list[Exception] = []
    results, clips = find_results_and_clips([root / "results"], problems)
    assert (len(results), clips, problems) == (3, [], [])
    bad, good = group_entries(results, clips, None, never)
    assert bad.label == "bad, IOU 40 %"
    assert good.label == "good, IOU 90 %, 2 results"
    assert [column.label for column in good.read()] == ["1-DoF, ours", "Static"]
    assert good.read()[0].view.clip.name == "good"


def test_results_and_clips_may_be_named_in_any_way(root: Path) -> None:
    problems: list[Exception] = []
    results, clips = find_results_and_clips(
        [root / "results" / "one-dof", root / "results" / "static" / "good"], problems
    )
    assert [entry.label for entry in group_entries(results, clips, None, never)] == [
        "bad, IOU 40 %",
        "good, IOU 90 %, 2 results",
    ]
    results, clips = find_results_and_clips([root / "clips"], problems)
    assert results == []
    assert [entry.read()[0].label for entry in group_entries(results, clips, None, never)] == [
        GROUND_TRUTH_LABEL,
        GROUND_TRUTH_LABEL,
    ]
    assert find_results_and_clips([root / "clips" / "bad"], problems)[1] == [root / "clips" / "bad"]
    assert problems == []
    find_results_and_clips([root / "clips" / "bad" / "masks", root / "nowhere"], problems)
    assert ["no such folder" in str(problem) for problem in problems] == [False, True]


def test_results_of_one_method_are_told_apart_by_their_folders() -> None:
    one = view()
    static = replace(one, result=replace(one.result, method="static"))
    method = "1-DoF, ours"
    assert label_views([one, one, static], ["a", "b", "c"]) == [f"{method} (a)", f"{method} (b)", "Static"]


def test_entries_of_the_same_words_are_numbered(root: Path) -> None:
    again = group_entries([], [root / "clips" / "bad", root / "results" / ".." / "clips" / "bad"], None, never)
    assert [entry.label for entry in again] == ["1. bad", "2. bad"]


def test_a_broken_result_does_not_hide_the_others(root: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "result.json").write_text("{", "utf-8")
    errors: list[Exception] = []
    listed = group_entries([broken, root / "results" / "one-dof" / "bad"], [], None, errors.append)
    assert [entry.label for entry in listed] == ["bad, IOU 40 %"]
    assert str(broken) in str(errors[0])


def test_the_command_refuses_what_it_cannot_show(run: Run, tmp_path: Path) -> None:
    assert run("view")[0] == 2
    status, out, err = run("view", tmp_path / "nowhere")
    assert out == f"reading {tmp_path / 'nowhere'} ...\n"
    assert status == 1
    assert "nowhere: no such folder; must be a result, a clip" in err


@pytest.fixture(scope="module")
def folder(tmp_path_factory: Any) -> Path:
    """A clip and two results of it, of which the second lacks a frame."""
    made: Path = tmp_path_factory.mktemp("served")
    result, clip, masks = two_candidates()
    where = write_clip(clip, masks, made / "clip")
    short = View.of(result, clip, masks).at(clip.frames[:4]).result
    for one in (result, replace(short, method="static", axis=None)):
        write_result(one, made / one.method, input_sha256(where), clip_folder=where)
    return made


@pytest.fixture(scope="module")
def library(folder: Path) -> ViewerLibrary:
    one = [folder / "one-dof"]
    both = [*one, folder / "static"]
    return ViewerLibrary(
        [*group_entries(one, [folder / "clip"], None, never), *group_entries(both, [], None, never)], never
    )


@pytest.fixture(scope="module")
def server(library: ViewerLibrary) -> Iterator[ViewerServer]:
    with ViewerServer(library, 0) as made:
        thread = threading.Thread(target=made.serve_forever)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def unpacked(content: dict[str, Any]) -> dict[str, np.ndarray]:
    data = zlib.decompress(base64.b64decode(content["packed"]))
    return {
        name: np.frombuffer(data, one["type"], int(np.prod(one["shape"])), one["offset"]).reshape(one["shape"])
        for name, one in content["arrays"].items()
    }


@pytest.mark.slow
def test_frames_are_those_of_the_page_that_holds_all(folder: Path, library: ViewerLibrary, tmp_path: Path) -> None:
    view = View.of(*two_candidates())
    known = Evaluation.recorded(view.clip, "one-dof", {})
    page = write_page(view, known, read_result_record(folder / "one-dof"), tmp_path / "a.html")
    text = page.read_text("utf-8")
    held = json.loads(text.partition('id="data">')[2].partition("</script>")[0])["shown"]["columns"][0]
    whole, fixed = unpacked(held), unpacked(library.entry(0)["columns"][0])
    for name, values in fixed.items():
        np.testing.assert_allclose(values, whole[name], atol=1e-6)
    for n in (0, 3):
        frame = library.frame(0, 0, 0, n)
        assert {*unpacked(frame), *fixed} == {*whole}
        for name, values in unpacked(frame).items():
            np.testing.assert_allclose(
                values[0].astype(float), whole[name][n], atol=1.0 if values.dtype == np.uint8 else 1e-6
            )
        assert frame["outlines"].keys() == held["pictures"][n]["outlines"].keys()


@pytest.mark.slow
def test_the_gap_is_measured_in_parts(library: ViewerLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = library.gap(0, 0)
    monkeypatch.setattr(viewer, "GAP_BATCH_FRAMES", 2)
    assert library.gap(0, 0)["lines"][0]["values"].tolist() == pytest.approx(whole["lines"][0]["values"].tolist())


@pytest.mark.slow
def test_another_candidate_has_contours_and_contact_of_its_own(library: ViewerLibrary) -> None:
    result, other = (library.frame(0, 0, rank, 2) for rank in (0, 1))
    assert result["outlines"]["object"] != other["outlines"]["object"]
    assert result["outlines"]["hand"] == other["outlines"]["hand"]
    near = [unpacked(frame)["object_near"] for frame in (result, other)]
    assert near[0].shape == near[1].shape
    assert not np.array_equal(*near)


@pytest.mark.slow
def test_results_stand_side_by_side_at_the_frames_that_all_have(library: ViewerLibrary) -> None:
    shown = library.entry(2)
    assert [column["label"] for column in shown["columns"]] == ["1-DoF, ours", "Static"]
    assert len(shown["frames"]) == len(shown["times"]) == 4
    assert ["axis" in column["arrays"] for column in shown["columns"]] == [True, False]


@pytest.mark.slow
def test_a_clip_shows_its_ground_truth_or_its_hand_alone(library: ViewerLibrary, tmp_path: Path) -> None:
    (true,) = library.entry(1)["columns"]
    assert (true["label"], true["result"], true["masked"]) == (GROUND_TRUTH_LABEL, False, True)
    assert [plot["title"] for plot in true["plots"]] == ["angle of the object about the axis"]
    assert true["main"] == []
    assert "true" not in library.frame(1, 0, 0, 0)["outlines"]
    _, clip, masks = two_candidates()
    where = write_clip(replace(clip, truth=None), masks, tmp_path / "clip")
    alone = ViewerLibrary(group_entries([], [where], None, never), never)
    (column,) = alone.entry(0)["columns"]
    assert "object_faces" not in column["arrays"]
    assert alone.frame(0, 0, 0, 0)["outlines"].keys() == {"hand", "observed"}
    assert alone.gap(0, 0) == {}


@pytest.mark.slow
def test_what_cannot_be_read_is_told_and_the_next_is_opened(folder: Path, tmp_path: Path) -> None:
    problems: list[Exception] = []
    listed = [
        *group_entries([folder / "one-dof"], [], tmp_path / "nowhere", never),
        *group_entries([folder / "static"], [], None, never),
    ]
    assert ViewerLibrary(listed, problems.append).first == 1
    assert len(problems) == 1
    assert ViewerLibrary(listed[:1], problems.append).first is None


def answer(
    server: ViewerServer, path: str, method: str = "GET", **head: str
) -> tuple[int, bytes, http.client.HTTPMessage]:
    connection = http.client.HTTPConnection(server.host, server.server_port, timeout=60)
    connection.request(method, path, headers=head)
    got = connection.getresponse()
    content, headers = got.read(), got.headers
    connection.close()
    return got.status, content, headers


@pytest.mark.slow
def test_only_who_knows_the_whole_address_gets_an_answer(server: ViewerServer) -> None:
    own = f"/{server.secret}/"
    assert len(server.secret) >= 20
    assert answer(server, own)[0] == answer(server, f"{own}?dark")[0] == answer(server, f"{own}entry/0")[0] == 200
    wrong = ["/", "/index.html", f"{own[:-2]}/", f"/{server.secret}x/", "/%00", f"/x/..{own}", f"/?{own}"]
    wrong += [own.swapcase(), "/entry/0", "/%C3%BC/"]
    for path in wrong:
        status, content, _ = answer(server, path)
        assert status == 403, path
        assert server.secret.encode() not in content


@pytest.mark.slow
def test_paths_name_nothing_but_what_is_shown(server: ViewerServer) -> None:
    asked = [
        "entry",
        "entry/",
        "entry/3",
        "entry/-1",
        "entry/0/0",
        "entry/1e0",
        "entry/٠",
        "entry/9999999",
        "frame/0/0/0",
    ]
    asked += [
        "frame/0/0/0/5",
        "frame/0/0/2/0",
        "frame/0/1/0/0",
        "frame/0/0/-1/0",
        "page",
        "_open/0",
        "../clip/clip.json",
    ]
    asked += ["%2e%2e/clip.json", "entry/../../../etc/passwd", "gap/0", "first/0", "/etc/passwd"]
    for path in asked:
        quoted = "".join(letter if letter.isascii() else "%D9%A0" for letter in path)
        assert answer(server, f"/{server.secret}/{quoted}")[0] == 404, path
    for method in ("POST", "PUT", "DELETE", "HEAD"):
        assert answer(server, f"/{server.secret}/entry/0", method)[0] == 501


@pytest.mark.slow
def test_other_names_of_this_machine_and_other_sites_are_refused(server: ViewerServer) -> None:
    own = f"/{server.secret}/entry/0"
    for host in ("evil.example", "evil.example:8770", "127.0.0.1.evil.example", "", "127.0.0.1:80:80", "[evil]"):
        assert answer(server, own, Host=host)[0] == 403, host
    for host in ("127.0.0.1:1", "localhost", "localhost:9999", "[::1]:8770"):  # through a tunnel, from any port
        assert answer(server, own, Host=host)[0] == 200, host
    for site in ("cross-site", "same-site"):
        assert answer(server, own, **{"Sec-Fetch-Site": site})[0] == 403


@pytest.mark.slow
def test_answers_are_kept_by_nobody_and_framed_by_nobody(server: ViewerServer) -> None:
    for path in ("", "entry/0", "nothing"):
        head = answer(server, f"/{server.secret}/{path}")[2]
        assert head["Cache-Control"] == "no-store"
        assert "frame-ancestors 'none'; base-uri 'none'" in head["Content-Security-Policy"]
        assert head["Cross-Origin-Resource-Policy"] == "same-origin"
        assert "Access-Control-Allow-Origin" not in head
    page = answer(server, f"/{server.secret}/")[1].decode()
    assert "default-src 'none'" in page
    assert "connect-src 'self'" in page


@pytest.mark.slow
def test_a_frame_that_cannot_be_read_is_one_line_of_json(folder: Path, server: ViewerServer) -> None:
    mask = folder / "clip" / "masks" / "object" / "000001.png"
    content = mask.read_bytes()
    mask.write_bytes(b"no image")
    status, text, _ = answer(server, f"/{server.secret}/frame/0/0/0/1")
    mask.write_bytes(content)
    assert status == 422
    assert "000001.png" in json.loads(text)["error"]
    assert answer(server, f"/{server.secret}/frame/0/0/0/1")[0] == 200


@pytest.mark.slow
def test_it_listens_to_this_machine_alone(server: ViewerServer) -> None:
    assert server.host == LOOPBACK
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {LOOPBACK}
    for address in others:
        with pytest.raises(OSError):  # noqa: PT011
            socket.create_connection((address, server.server_port), timeout=2)


@pytest.mark.slow
def test_ports_and_addresses_that_cannot_be_had_are_named(library: ViewerLibrary, server: ViewerServer) -> None:
    for port in (server.server_port, 70000, -1):
        with pytest.raises(UsageError, match="--port") as caught:
            ViewerServer(library, port)
        assert str(port) in str(caught.value)
    with pytest.raises(UsageError, match=r"203\.0\.113\.1"):
        ViewerServer(library, 0, "203.0.113.1")
    with ViewerServer(library) as one, ViewerServer(library) as two:
        assert one.server_port != two.server_port
        assert one.secret != two.secret
