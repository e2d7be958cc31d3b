"""Kernels are compiled by one process of a machine, and by no other one then; and kept by what they depend on."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

import pytest

from getagrip import compiling
from getagrip.io import files, terminal
from helpers.environment import ROOT

CODE = """
from getagrip import compiling
compiling.compile_modules(["geometry.kernels.closest"])
from getagrip.geometry.kernels.closest import _spread
print(sum(_spread.stats.cache_hits.values()), _spread.stats.cache_path)
"""


@pytest.fixture
def marked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where the mark is, in a folder that is not there yet."""
    mark = tmp_path / "cache" / "mark"
    monkeypatch.setattr(compiling, "mark_file", lambda: mark)
    return mark


@pytest.fixture
def compiles(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], None]], None]:
    """Have something else done in place of the compiling."""
    return lambda instead: monkeypatch.setattr(compiling, "_compile_in_parallel", instead)


@pytest.mark.skipif(not files.HAS_FILE_LOCKS, reason="no locks here")
def test_of_several_at_once_one_compiles_and_the_others_wait(marked: Path, compiles: Callable[..., None]) -> None:
    ended: list[float] = []

    def slowly() -> None:
        time.sleep(0.05)
        ended.append(time.monotonic())

    compiles(slowly)
    with ThreadPoolExecutor(4) as threads:
        returned = [*threads.map(lambda _: (compiling.compile_once(), time.monotonic())[1], range(4))]
    assert len(ended) == 1
    assert min(returned) >= ended[0]
    compiling.compile_once()
    assert len(ended) == 1


def test_it_is_done_again_where_the_mark_is_gone_and_told_each_time(
    marked: Path, compiles: Callable[..., None]
) -> None:
    done: list[str] = []
    compiles(lambda: done.append("compiled"))
    for _ in range(2):
        compiling.compile_once(lambda: done.append("told"))
    assert done == ["told", "compiled"]
    marked.unlink()
    compiling.compile_once()
    assert done == ["told", "compiled", "compiled"]


def test_a_failure_is_left_to_the_clips(marked: Path, compiles: Callable[..., None]) -> None:
    tries: list[None] = []

    def fail() -> None:
        tries.append(None)
        raise OSError("no space left")

    compiles(fail)
    compiling.compile_once()
    compiling.compile_once()
    assert len(tries) == 2


def test_the_folder_depends_on_the_kernels_and_on_numba(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = compiling.folder.__wrapped__
    before = folder()
    assert before.parent == tmp_path
    monkeypatch.setattr("numba.__version__", "0.0.0")
    assert folder() != before
    monkeypatch.undo()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert folder() == before
    monkeypatch.setattr(
        compiling, "RARELY_USED_KERNEL_MODULES", compiling.RARELY_USED_KERNEL_MODULES[1:]
    )  # other sources
    assert folder() != before


def test_every_module_with_kernels_is_in_the_folders_name() -> None:
    source = ROOT / "src" / "getagrip"
    found = {
        path.relative_to(source).with_suffix("").as_posix().replace("/", ".")
        for path in source.rglob("*.py")
        if "\n@kernel(" in path.read_text("utf-8")
    }
    assert sorted(found) == sorted(
        [*(name for group in compiling.KERNEL_GROUPS for name in group), *compiling.RARELY_USED_KERNEL_MODULES]
    )


def test_kernels_declare_as_many_arguments_as_they_take() -> None:
    for name in (*(name for group in compiling.KERNEL_GROUPS for name in group), *compiling.RARELY_USED_KERNEL_MODULES):
        import_module(f"getagrip.{name}")
    assert len(compiling._declared_kernels) > 15
    for compiled, arguments in compiling._declared_kernels:
        assert len(compiling.numba_signature(arguments)) == compiled.py_func.__code__.co_argcount, compiled


@pytest.mark.slow
def test_a_kernel_is_compiled_once_and_again_where_its_file_is_damaged(tmp_path: Path) -> None:
    def hits() -> int:
        env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", CODE], env=env, capture_output=True, text=True, check=True)
        found, where = done.stdout.split()
        assert Path(where).parent == tmp_path
        return int(found)

    assert [hits(), hits()] == [0, 1]
    for path in tmp_path.rglob("closest._spread*.nb?"):
        path.write_bytes(b"no pickle")
    assert [hits(), hits()] == [0, 1]


@pytest.mark.skipif(os.name == "nt", reason="other users are told apart in another way")
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o700])
def test_kernels_are_not_read_where_others_can_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], mode: int
) -> None:
    monkeypatch.setattr(terminal, "_is_private_group", lambda group, owner: False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    folder = compiling.folder.__wrapped__
    mine = folder()
    mine.parent.chmod(mode)
    taken = folder()
    assert (taken == mine) == (mode == 0o700)
    assert taken.name == mine.name
    assert folder() == taken  # as the processes that are started now
    err = capsys.readouterr().err
    assert err.count("\n") == (mode != 0o700)
    assert err == "" or "other users can write there" in err
    if mode != 0o700:
        shutil.rmtree(taken.parent)


def test_a_folder_in_a_sticky_one_is_ours_and_a_link_of_others_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "link").symlink_to("a")
    (tmp_path / "a").chmod(0o1777)
    assert terminal.is_private_folder(tmp_path / "link" / "b")
    assert terminal.is_private_folder(tmp_path / "link" / "b" / "new")
    assert not terminal.is_private_folder(tmp_path / "a")
    (tmp_path / "a").chmod(0o777)
    assert not terminal.is_private_folder(tmp_path / "link" / "b")
    (tmp_path / "a").chmod(0o755)
    here = os.lstat
    owned = {tmp_path / "link": 65534}

    def lstat(path: Path) -> os.stat_result:
        about = here(path)
        return os.stat_result((*about[:4], owned.get(Path(path), about.st_uid), *about[5:]))

    monkeypatch.setattr(Path, "lstat", lstat)
    assert not terminal.is_private_folder(tmp_path / "link" / "b")
    assert terminal.is_private_folder(tmp_path / "a" / "b")


def test_numba_takes_no_options_from_a_folder_that_was_sent(tmp_path: Path) -> None:
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: stranger\nopt: 1\n")
    script = tmp_path.parent / "script.py"
    script.write_text("from numba import config; import getagrip.compiling; print([config.CACHE_DIR, int(config.OPT)])")
    env = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run([sys.executable, script], cwd=tmp_path, env=env, capture_output=True, text=True, check=True)
    assert done.stdout == "['', 3]\n"


@pytest.mark.compiles
@pytest.mark.slow
def test_a_reconstruction_compiles_nothing_for_types_that_no_kernel_declares() -> None:
    """In a process of its own, since other tests call kernels, too."""
    script = """
import getagrip
from getagrip import compiling
from getagrip.synthetic.scene_options import SceneOptions

getagrip.reconstruct(*getagrip.synthesise("can", seed=0, options=SceneOptions(frames=6)))
called = 0
for compiled, arguments in compiling._declared_kernels:
    assert set(compiled.signatures) <= {compiling.numba_signature(arguments)}, compiled
    called += bool(compiled.signatures)
assert called > 5, called
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
