"""Calls in this process: the options that the words spell, the output of a process, and its errors."""

from __future__ import annotations

import sys
from contextlib import redirect_stderr
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest

from getagrip.cli import _parse_command
from getagrip.cli.calls import command_of_call, run_call
from getagrip.cli.new_clip import NewClip
from getagrip.errors import GetagripError
from getagrip.io.terminal import print_note, progress_bar
from getagrip.studio.jobs import BackgroundJob, CommandCall, NewClipCall, ReconstructCall, ReportCall
from helpers.labelled_scene import write_scene

NEW_CLIP = NewClipCall(
    video="a b.mp4", interval=(3, 8), side="right", hands=Path("made/hand.npz"), masks=Path("made/masks"),
    mesh="cup", out=Path("out/clips/it"),
)  # fmt: skip


@pytest.fixture
def wrong(tmp_path: Path) -> NewClipCall:
    """A call whose hand file is missing, of a video that is there."""
    video = write_scene(tmp_path / "scene.mp4", 3)
    return replace(NEW_CLIP, video=str(video), interval=(1, 3), hands=tmp_path / "hand.npz", out=tmp_path / "clip")


@pytest.mark.parametrize(
    "call",
    [
        NEW_CLIP,
        replace(NEW_CLIP, segments=Path("s.json"), size_mm=90.0, overwrite=True),
        replace(NEW_CLIP, mesh="a mesh.obj", size_mm=90.123456789, quiet=True),
        ReconstructCall(Path("out/clips/it"), Path("out/results")),
        ReportCall(Path("out/results/it")),
    ],
)
def test_words_spell_the_options(call: CommandCall) -> None:
    assert _parse_command(call.words) == command_of_call(call)


@pytest.mark.slow
def test_a_process_reports_the_same_error(wrong: NewClipCall) -> None:
    with pytest.raises(GetagripError) as here:
        run_call(wrong)
    with pytest.raises(GetagripError) as there:
        BackgroundJob("files").run(wrong)
    assert str(here.value) == str(there.value)
    assert "hand.npz" in str(here.value)
    assert not wrong.out.exists()


@pytest.mark.parametrize("quiet", [True, False])
def test_output_is_returned_with_warnings_last(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    def run(_: NewClip) -> int:
        print_note("warning: mesh: a guess")
        print("out/clips/it: 6 frames")
        return 3

    monkeypatch.setattr(NewClip, "run", run)
    said = "warning: mesh: a guess" if quiet else "out/clips/it: 6 frames\nwarning: mesh: a guess"
    assert run_call(replace(NEW_CLIP, quiet=quiet)) == said
    assert capsys.readouterr() == ("", "")


def test_defects_are_errors_of_the_call_and_interrupts_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(error: BaseException) -> None:
        def fail(_: NewClip) -> int:
            raise error

        monkeypatch.setattr(NewClip, "run", fail)
        run_call(NEW_CLIP)

    with pytest.raises(GetagripError, match="ZeroDivisionError: no frames"):
        run(ZeroDivisionError("no frames"))
    with pytest.raises(GetagripError, match=r"^no such file$"):
        run(OSError("no such file"))
    with pytest.raises(KeyboardInterrupt):
        run(KeyboardInterrupt())


def test_a_bar_stays_on_its_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, output = StringIO(), StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress_bar() as bar, redirect_stderr(output):
        bar.add_task("it: reconstructing", total=1)
        bar.refresh()
        print_note("a note")
    assert "it: reconstructing" in terminal.getvalue()
    assert output.getvalue() == "a note\n"
