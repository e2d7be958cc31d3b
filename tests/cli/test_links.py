"""Every command in folders in which the names that it writes are links to a user's other files: these stay."""

from __future__ import annotations

import runpy
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.environment import ROOT, Run
from helpers.folders import Linked, Written
from helpers.link_calls import CALLS, COMPOSED, quicken, write_link_inputs


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_link_inputs(tmp_path_factory.mktemp("inputs"))


def test_every_command_is_tried() -> None:
    names = set(runpy.run_path(str(ROOT / "scripts" / "reference.py"))["commands"]())
    groups = {name.split()[0] for name in names if " " in name} & names
    assert {*CALLS, *COMPOSED} == names - groups


@pytest.mark.usefixtures("users_hints")
@pytest.mark.parametrize("call", [f"{name} {words}".strip() for name, calls in CALLS.items() for words in calls])
@pytest.mark.slow
def test_nothing_is_written_through_a_link(
    call: str, inputs: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    quicken(monkeypatch)
    for name in ("STATE", "CACHE"):
        monkeypatch.setenv(f"XDG_{name}_HOME", str(tmp_path / name))
    shutil.copytree(inputs, tmp_path / "clean")
    monkeypatch.chdir(tmp_path / "clean")
    status, out, err = run(*call.split())
    assert status in (0, 3), out + err
    written = Written.of(inputs, tmp_path / "clean", call.split())
    assert written.files or call.split(maxsplit=1)[0] in ("doctor", "view")
    for n, (names, dangling) in enumerate(_links(written)):
        place = tmp_path / str(n)
        linked = Linked(written, place)
        linked.link(names, dangling)
        monkeypatch.chdir(linked.folder)
        _, out, err = run(*call.split())
        assert not linked.leaks(), (names, out, err)
        assert "unexpected" not in out + err
        shutil.rmtree(place)


def _links(written: Written) -> Iterator[tuple[list[str], bool]]:
    """Names that are links together, and whether to nothing: all but those where a link is refused, which hides the
    others."""
    if written.others:
        yield written.others, False
        yield written.others, True
    for name in written.folders:
        yield [name], False
    for name in written.databases:
        yield [name], False
        yield [name], True
