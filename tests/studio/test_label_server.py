"""Labels over HTTP, hostile ones too."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from getagrip.studio import jobs
from getagrip.studio.server import MAX_BODY_BYTES, StudioServer
from getagrip.studio.store import labels
from helpers.annotation import FIRST, LAST, TAB, VIDEO, Clicking, ask, new


@pytest.fixture
def server(clicking: Clicking) -> Iterator[StudioServer]:
    with StudioServer(clicking.project, 0) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def test_labels_over_http(server: StudioServer, clicking: Clicking) -> None:
    where = "&".join(f"{key}={value}" for key, value in clicking.about.items())
    status, _, answer = ask(server, "/api/label", clicking.change(4, {"joints": {"0": [10, 20]}}))
    assert (status, json.loads(answer)["keyframes"][0]["frame"]) == (200, 4)
    assert json.loads(ask(server, f"/api/labels?{where}")[2])["extent"] == [FIRST, LAST]
    assert json.loads(ask(server, f"/api/drafts?{where}&since=0")[2]) == {"drafts": []}
    status, head, text = ask(server, f"/labels.json?{where}")
    assert status == 200
    assert f"labels-ann-scene-{FIRST + 1}-{LAST + 1}-left.json" in head["Content-Disposition"]
    assert labels.parse_labels(json.loads(text), "labels.json").frames.keys() == {4}
    status, _, image = ask(server, f"/frame?task={VIDEO}&n=4&whole=1")
    assert (status, image[:2]) == (200, b"\xff\xd8")
    status, _, answer = ask(server, "/api/unlabel", clicking.about | {"change": new(), "tab": TAB})
    assert (json.loads(answer)["undone"], json.loads(answer)["frame"]) == (True, 4)


def test_a_report_is_one_that_was_drawn_here(
    server: StudioServer, clicking: Clicking, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project, drawn = clicking.project, list[Path]()
    result = project.labelling.out / "results" / project._grasp(clicking.about).name
    where = "&".join(f"{key}={value}" for key, value in clicking.about.items())

    def draw(folder: Path, job: object) -> str:
        drawn.append(folder)
        for name in jobs.REPORT_FILES:
            (folder / name).unlink(missing_ok=True)  # a link is replaced
            (folder / name).write_text("ours")
        return ""

    monkeypatch.setattr(jobs, "draw_report", draw)
    assert ask(server, f"/report.html?{where}")[0] == 409
    assert not result.exists()
    result.mkdir(parents=True)
    (result / "result.json").touch()
    (result / "report.html").write_text("<script>a stranger's</script>")
    (tmp_path / "secret").write_text("secret")
    (result / "report.png").symlink_to(tmp_path / "secret")
    for name in ("report.html", "report.png", "report.html"):
        status, head, content = ask(server, f"/{name}?{where}")
        assert (status, content) == (200, b"ours")
        assert "sandbox allow-scripts" in head["Content-Security-Policy"]
        assert "allow-same-origin" not in head["Content-Security-Policy"]
    assert drawn == [result]
    result.rename(tmp_path / "moved")
    result.symlink_to(tmp_path / "moved")
    assert ask(server, f"/report.html?{where}")[0] == 400


@pytest.mark.slow
def test_hostile_clicks_over_http_are_answered_in_words(server: StudioServer, clicking: Clicking) -> None:
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
    assert len(json.dumps(many)) > MAX_BODY_BYTES
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
