"""One clip, here or in an object store: results that are kept, and errors as messages."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from shutil import make_archive
from typing import Any

import numpy as np
import pytest

from getagrip.batch.job import Job, existing_outcome, failed_outcome, reconstruct_one
from getagrip.clip import Clip, input_sha256, write_clip
from getagrip.errors import GetagripError
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.io.files import to_json
from getagrip.io.plugins import install_command
from getagrip.io.storage import RemotePath
from getagrip.result import Reconstruction, read_result, write_result
from getagrip.result.findings import ASSUMED_MESH, Finding, Probability
from helpers.clips import small_clip
from helpers.clusters import BUCKET, s3_server
from helpers.environment import Run
from helpers.folders import contents
from helpers.scenes import SHORT, egg_and_mug, perfect, scene
from helpers.views import NAMES, write_viewed_clip

SERIOUS_FINDING = Finding("contact-gap", True, 240.0, 15.0, "nothing is held")


def test_a_result_that_another_run_made_meanwhile_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    job = Job("egg-and-mug", folder, tmp_path / "out", Options(method="static"), overwrite=False)
    options = json.loads(to_json(asdict(job.options)))
    found = replace(perfect(scene[0]), options=options, findings=(SERIOUS_FINDING,))

    def slow(*_: Any) -> Reconstruction:
        write_result(found, job.out, input_sha256(folder))  # the other run ends first
        return found

    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", slow)
    outcome = reconstruct_one(job)
    assert outcome.state == "kept"
    assert outcome.findings == (SERIOUS_FINDING,)
    other = replace(job, options=Options(method="static", seed=1))
    assert existing_outcome(other, input_sha256(folder)) == (None, "the earlier result is of another seed")


def test_the_iou_in_further_views_is_kept_and_the_worst_one_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, clip, _ = write_viewed_clip(tmp_path / "clip")
    off = found.T_hand_obj @ se3.rigid(None, np.array([0.03, 0.0, 0.0]))
    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", lambda *_: replace(found, T_hand_obj=off))
    outcome = reconstruct_one(Job(clip.name, clip.origin, tmp_path / "out", Options(), overwrite=False))
    kept = json.loads((tmp_path / "out" / "result.json").read_text())["metrics"]
    assert [*kept] == ["iou_full", "iou_full:view2", "iou_full:view3"]
    worst = min(NAMES, key=lambda name: kept[f"iou_full:{name}"])
    words = f"({kept[f'iou_full:{worst}']:.2f} in {worst}, the worst of 2 further views)"
    assert words in outcome.message


@pytest.mark.parametrize(
    ("options", "said"),
    [(Options(mesh="as-given"), "none is calibrated with mesh as-given"), (Options(method="static"), "for static")],
)
def test_why_there_is_no_probability_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: Options, said: str
) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", lambda *_: perfect(scene[0]))
    outcome = reconstruct_one(Job("egg-and-mug", folder, tmp_path / "out", options, overwrite=False))
    assert (outcome.state, f"{said}), " in outcome.message) == ("done", True)
    assert outcome.message.startswith("IOU ")
    assert ", no probability that it is right (none is calibrated " in outcome.message


def test_how_a_result_of_an_assumed_mesh_looks_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = egg_and_mug()
    folder = write_clip(*scene, tmp_path / "clip")
    found = replace(perfect(scene[0]), probability_right=Probability(0.12, "", (ASSUMED_MESH,)), ambiguous=True)
    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", lambda *_: found)
    outcome = reconstruct_one(Job("egg-and-mug", folder, tmp_path / "out", Options(), overwrite=False))
    assert " 12 % (extrapolated: assumed mesh) in the hand, probably looks right, ambiguous, " in outcome.message


OWN = """
import numpy as np

def fit(poses):
    return poses.t

def library():
    return np.zeros(2) @ np.zeros(3)

def deep():
    return library()
"""


@pytest.mark.parametrize(
    ("name", "line"), [("fit", "mine.py:5: AttributeError: 'int' object"), ("deep", "mine.py:8: ValueError: matmul")]
)
def test_an_error_of_own_code_says_where(tmp_path: Path, name: str, line: str) -> None:
    source = tmp_path / "mine.py"
    source.write_text(OWN)
    there: dict[str, Any] = {}
    exec(compile(OWN, str(source), "exec"), there)
    with pytest.raises(Exception) as caught:  # noqa: PT011
        there[name](*[1] * (name == "fit"))
    error = caught.value.with_traceback(caught.value.__traceback__.tb_next)  # without the line of this test
    assert failed_outcome("cup", error).message.startswith(line)
    assert failed_outcome("cup", KeyError("a")).message == "unexpected KeyError: 'a'"


needs_s3 = pytest.mark.skipif(
    not (find_spec("s3fs") and find_spec("moto")), reason="needs s3fs and a server: pip install s3fs 'moto[server]'"
)


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The address of an empty store in this process."""
    memory = pytest.importorskip("fsspec", reason="needs fsspec: pip install -e '.[s3]'").filesystem("memory")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]
    yield "memory://bucket"
    memory.store.clear()


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Instead of the method, the truth, or what stands for it; the names of the clips that were fitted."""
    names: list[str] = []

    def fit(clip: Clip, masks: object, options: Any, progress: object, threads: int) -> Reconstruction:
        names.append(clip.name)
        assert clip.truth is None  # it is not copied
        assert clip.folder is not None
        assert not (clip.folder / "frames").exists()  # nor are images
        given = json.loads(to_json(asdict(options)))
        whole = replace(clip, truth=small_clip()[0].truth)
        return replace(perfect(whole), clip=clip.name, options=given, method=options.method, seed=options.seed)

    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", fit)
    return names


def put(folder: Path, there: RemotePath) -> None:
    """Copy a folder into a store."""
    for name, content in contents(folder).items():
        (there / name).write(content)


def put_clips(store: str, tmp_path: Path, names: tuple[str, ...] = ("a", "b")) -> str:
    """Put small clips into a store; the address of their folder."""
    clip, masks = small_clip()
    for name in names:
        folder = write_clip(replace(clip, name=name), masks, tmp_path / "clips" / name)
        (folder / "frames").mkdir()
        (folder / "frames" / f"{clip.frames[0]}.jpg").write_bytes(b"an image, which nobody reads")
        put(folder, RemotePath(f"{store}/clips/{name}"))
    return f"{store}/clips"


@pytest.mark.slow
def test_clips_and_results_in_a_store(store: str, tmp_path: Path, run: Run, fitted: list[str]) -> None:
    clips = put_clips(store, tmp_path)
    call = ("reconstruct", clips, "--out", f"{store}/out")
    status, printed, err = run(*call)
    assert status == 0, err
    assert f"a: IOU 1.00, 0.0 s, {store}/out/a; " in printed
    assert f"{store}/out: its ledger is {tmp_path / 'state' / 'getagrip' / 'out-'}" in err
    out = RemotePath(f"{store}/out")
    assert [name for name, _ in out.children()] == ["a", "b", "index.html", "summary.csv"]
    out.copy_to(tmp_path / "copy")
    record = read_result(tmp_path / "copy" / "a")[1]
    assert record["clip_folder"] == f"{clips}/a"
    assert (tmp_path / "copy" / "summary.csv").read_text().count(",done,") == 2
    assert '"folder":"a"' in (tmp_path / "copy" / "index.html").read_text()
    assert "0 done, 2 already done, 0 failed" in run(*call)[1]
    assert "0 done, 1 already done, 0 failed" not in run(*call, "--shard", "1/2")[1]
    assert fitted == ["a", "b"]
    assert "a: done again, since the earlier result is of another seed" in run(*call, "--seed", 1)[1]


@pytest.mark.parametrize("clips_there", [True, False])
def test_either_may_be_on_a_disk(
    store: str, tmp_path: Path, run: Run, fitted: list[str], clips_there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = put_clips(store, tmp_path, ("a",))
    if clips_there:
        assert run("reconstruct", f"{clips}/a", "--out", tmp_path / "out")[0] == 0
        assert read_result(tmp_path / "out" / "a")[1]["clip_folder"] == f"{clips}/a"
    else:
        monkeypatch.setattr(
            import_module("getagrip.reconstruct"), "reconstruct", lambda clip, *_: perfect(clip, clip.name)
        )
        assert run("reconstruct", f"file://{tmp_path}/clips/a", "--out", f"{store}/out")[0] == 0
        assert (RemotePath(f"{store}/out/a") / "result.json").read(10_000) is not None


@pytest.mark.parametrize("given", ["clips", "clips/*.zip", "clips/a.zip"])
def test_a_clip_may_be_one_archive(store: str, tmp_path: Path, run: Run, fitted: list[str], given: str) -> None:
    clip, masks = small_clip()
    folder = write_clip(replace(clip, name="a"), masks, tmp_path / "clips" / "a")
    packed = Path(make_archive(str(tmp_path / "a"), "zip", folder))
    RemotePath(f"{store}/clips/a.zip").write(packed.read_bytes())
    status, _, err = run("reconstruct", f"{store}/{given}", "--out", tmp_path / "out")
    assert (status, fitted) == (0, ["a"]), err
    assert read_result(tmp_path / "out" / "a")[1]["clip_folder"].endswith("/bucket/clips/a.zip")
    assert "a: already done" in run("reconstruct", f"{store}/clips/a.zip", "--out", tmp_path / "out")[1]


@pytest.mark.parametrize("which", ["result.npz", "result.json"])
@pytest.mark.parametrize("replaces", [False, True])
@pytest.mark.slow
def test_half_a_result_is_none(
    store: str, tmp_path: Path, run: Run, fitted: list[str], monkeypatch: pytest.MonkeyPatch, which: str, replaces: bool
) -> None:
    clips = put_clips(store, tmp_path, ("a",))
    call = ("reconstruct", f"{clips}/a", "--out", f"{store}/out")
    if replaces:
        assert run(*call, "--seed", 1)[0] == 0
    write = RemotePath.write

    def torn(self: RemotePath, content: bytes) -> None:
        if self.name == which:
            raise GetagripError(f"{self}: the network is gone")
        write(self, content)

    with monkeypatch.context() as gone:
        gone.setattr(RemotePath, "write", torn)
        status, _, err = run(*call)
    assert status == 1
    assert f"{which}: the network is gone" in err
    assert (RemotePath(f"{store}/out/a") / "result.json").read(10_000) is None
    status, printed, _ = run(*call)
    assert status == 0
    assert "a: IOU 1.00" in printed
    assert len(fitted) == 2 + replaces


@pytest.mark.slow
def test_a_damaged_result_is_made_again(store: str, tmp_path: Path, run: Run, fitted: list[str]) -> None:
    clips = put_clips(store, tmp_path, ("a",))
    call = ("reconstruct", f"{clips}/a", "--out", f"{store}/out")
    run(*call)
    (RemotePath(f"{store}/out/a") / "result.npz").remove()
    assert "a: done again, since the earlier result is damaged (" in run(*call)[1]


def test_what_is_no_clip_is_named_and_the_others_are_done(
    store: str, tmp_path: Path, run: Run, fitted: list[str]
) -> None:
    clips = put_clips(store, tmp_path)
    (RemotePath(clips) / "notes" / "hello.txt").write(b"hello")
    (RemotePath(clips) / "wrong" / "clip.json").write((tmp_path / "clips" / "a" / "clip.json").read_bytes())
    status, printed, err = run("reconstruct", clips, "--out", f"{store}/out", "--workers", 1)
    assert status == 1
    assert "2 done, 0 already done, 2 failed" in printed
    assert f"failed: notes: {clips}/notes/clip.json: no such file" in err
    assert f"failed: wrong: {clips}/wrong/clip.json: name must be wrong, as its folder" in err


def test_a_pattern_stands_for_the_clips_that_it_matches(
    store: str, tmp_path: Path, run: Run, fitted: list[str]
) -> None:
    clips = put_clips(store, tmp_path, ("a1", "a2", "b"))
    assert run("reconstruct", f"{clips}/a*", "--out", f"{store}/out")[0] == 0
    assert fitted == ["a1", "a2"]


def test_grasps_are_found_on_a_disk_only(store: str, clip_folder: Path, run: Run) -> None:
    status, _, err = run("reconstruct", clip_folder, "--out", f"{store}/out", "--find-grasps")
    assert status == 2
    assert err == f"getagrip: --find-grasps cannot be used with {store}/out, only with folders on a disk\n"


@pytest.mark.parametrize("missing", ["s3fs", "fsspec.core"])
def test_a_missing_library_is_named(clip_folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    if missing == "s3fs":
        pytest.importorskip("fsspec")
    monkeypatch.setitem(__import__("sys").modules, missing, None)
    status, _, err = run("reconstruct", clip_folder, "--out", "s3a://bucket/out")
    assert status == 2
    assert err.endswith(f"{install_command('s3')}\n")
    assert err.count("\n") == 1


@needs_s3
@pytest.mark.slow
@pytest.mark.long
def test_a_server_of_s3_serves_as_well(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bits as on a disk; a bucket that is not there is named."""
    import s3fs

    clip, masks = scene("can", 0, SHORT)
    write_clip(replace(clip, name="can"), masks, tmp_path / "clips" / "can")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with s3_server() as env:
        for name, value in env.items():
            monkeypatch.setitem(os.environ, name, value)
        s3fs.S3FileSystem().mkdir(BUCKET)
        put(tmp_path / "clips" / "can", RemotePath(f"s3://{BUCKET}/clips/can"))
        clips, out = f"s3://{BUCKET}/clips", f"s3://{BUCKET}/out"
        status, _, err = run("reconstruct", clips, "--out", out, "--inits", 6)
        assert status == 0, err
        assert run("reconstruct", tmp_path / "clips", "--out", tmp_path / "out", "--inits", 6)[0] == 0
        RemotePath(out).copy_to(tmp_path / "copy")
        assert (tmp_path / "copy/can/result.npz").read_bytes() == (tmp_path / "out/can/result.npz").read_bytes()
        assert "already done" in run("reconstruct", clips, "--out", out, "--inits", 6)[1]
        for call in ((clips, "--out", "s3://nowhere/out"), ("s3://nowhere/clips", "--out", out)):
            status, _, err = run("reconstruct", *call)
            assert status == 2
            assert "s3://nowhere" in err
            assert err.count("\n") == 1
