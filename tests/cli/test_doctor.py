"""Doctor says of each thing how it is, and what to do about what is missing."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from getagrip.cli import doctor
from getagrip.io.plugins import install_command
from helpers.environment import Run
from helpers.hand_files import fake_mano, python2


@pytest.fixture(autouse=True)
def _without_the_clip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_smoke_test", lambda: None)


def test_every_line_says_how_it_is_and_what_to_do(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.shutil, "which", lambda _: None)
    versions = {"usd-core": None, "torch": None}
    needs = [
        "numpy>=2.0",
        "usd-core>=25.5; extra == 'usd'",
        "torch==2.13.0; extra == 'torch'",
        "mujoco>=3; extra == 'mujoco'",
    ]
    monkeypatch.setattr(doctor.metadata, "requires", lambda _: needs)
    monkeypatch.setattr(doctor, "_installed_version", lambda name: versions.get(name, "99.0"))
    status, out, _ = run("doctor")
    assert status == 0
    lines = out.splitlines()[1:]
    assert {line.split()[0] for line in lines} == {"ok", "without"}
    for words in (install_command("usd"), install_command("torch"), "without  browser; ", "--mano DIR"):
        assert words in out
    for words in ("BLAS openblas", "cores to use", "GB free for this folder", "ok       mujoco 99.0"):
        assert words in out


def test_a_cluster_is_tried(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    assert "without  Ray cluster; name one by --address HOST:PORT or RAY_ADDRESS" in run("doctor")[1]
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{there.getsockname()[1]}"
        monkeypatch.setenv("RAY_ADDRESS", address)
        status, out, _ = run("doctor")
        assert status == 1
        assert f"BROKEN   Ray cluster {address} does not answer (" in out
        there.listen()
        monkeypatch.delenv("RAY_ADDRESS")
        status, out, _ = run("doctor", "--address", address)
        assert status == 0
        assert f"ok       Ray cluster {address} answers" in out


def test_what_is_needed_and_missing_is_wrong(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_installed_version", lambda name: "1.0" if name == "numpy" else "99.0")
    monkeypatch.setattr(doctor, "MIN_DISK_GB", 1e9)
    status, out, _ = run("doctor")
    assert status == 1
    assert 'MISSING  numpy 2.0 or later, here is 1.0; pip install "numpy>=2.0"' in out
    assert "; make room" in out


@pytest.mark.slow
def test_mano_files_are_tried(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "MANO_RIGHT.pkl").write_bytes(python2(fake_mano(monkeypatch)))
    status, out, _ = run("doctor", "--mano", tmp_path)
    assert status == 1
    assert "ok       MANO, right hand" in out
    assert "BROKEN   MANO: " in out
    assert "MANO_LEFT.pkl" in out


def test_hand_models_are_tried(run: Run, tmp_path: Path) -> None:
    assert "without  hand models in" in run("doctor", "--models", str(tmp_path))[1]
    for name in ("palm_detection_full.tflite", "hand_landmark_full.tflite"):
        (tmp_path / name).write_bytes(b"other")
    status, out, _ = run("doctor", "--models", str(tmp_path))
    assert status == 1
    assert "BROKEN   hand models: " in out
    assert "another file" in out
