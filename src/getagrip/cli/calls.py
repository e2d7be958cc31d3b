"""Calls of ``clip new``, ``reconstruct`` and ``report`` by other commands, in the same process.

``draft`` and ``label`` make clips, results and reports so: one start of Python instead of four. The page runs the same
calls as processes, which can be cancelled (``BackgroundJob.run``).
"""

from __future__ import annotations

from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.cli.command import Command, print_error
from getagrip.errors import GetagripError

if TYPE_CHECKING:
    from getagrip.bench.pixels.recording import DraftRequest
    from getagrip.studio.jobs import CommandCall


def run_call(call: CommandCall) -> str:
    """Run a command in this process; return its output, or raise ``GetagripError`` with it if the command failed.

    An interrupt is raised as such. Standard output and standard error are the command's meanwhile, of all threads: a
    server must not call this.
    """
    from getagrip.batch.job import failed_outcome
    from getagrip.studio.jobs import command_output

    command, out, err = command_of_call(call), StringIO(), StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(err):
            try:
                status = command.run_checked()
            except (GetagripError, OSError) as error:
                status = print_error(error, command.debug)
    except Exception as error:  # a defect of the program, which must not end the work on other grasps
        raise GetagripError(failed_outcome("", error).message) from error
    return command_output(status, out.getvalue(), err.getvalue())


def command_of_call(call: CommandCall) -> Command:
    """Return the command with the options that ``call.words`` spell."""
    from getagrip.batch.scheduling import BatchOptions
    from getagrip.cli.new_clip import MeshOptions, NewClip
    from getagrip.cli.reconstruct import Reconstruct
    from getagrip.cli.report import Report
    from getagrip.studio.jobs import THREADS_PER_CLIP, NewClipCall, ReconstructCall

    if isinstance(call, NewClipCall):
        mesh = MeshOptions(mesh=Path(call.mesh), size_mm=call.size_mm)
        return NewClip(
            video=Path(call.video), interval=call.interval, side=call.side, hands=call.hands, masks=call.masks,
            object=(call.object,), ignore=(call.ignore,), hand=(call.hand,), segments=call.segments, shape=mesh,
            out=call.out, overwrite=call.overwrite, quiet=call.quiet,
        )  # fmt: skip
    if isinstance(call, ReconstructCall):
        batch = BatchOptions(threads=THREADS_PER_CLIP, overwrite=True)
        return Reconstruct(clips=(call.clip,), out=call.out, batch=batch)
    return Report(paths=(call.result,))


def run_draft(request: DraftRequest) -> None:
    """Make a draft without its page in this process. Raises ``GetagripError`` with its output where it fails."""
    from getagrip.cli.draft import Draft
    from getagrip.cli.view_options import ViewOptions
    from getagrip.geometry.lens import Lens

    views = ViewOptions(view=request.views, cameras=request.cameras, camera=request.camera)
    command = Draft(
        video=request.video, object=str(request.object), size_mm=request.size_mm,
        lens=Lens() if request.views else Lens(K=request.K), views=views, box_view=request.box_view,
        object_box=request.object_box, masks=None if request.masks is None else str(request.masks),
        hands=None if request.hands is None else str(request.hands), depth=request.depth, depth_from=request.depth_from,
        models=request.models, out=request.out, no_page=True,
    )  # fmt: skip
    out = StringIO()
    with redirect_stdout(out), redirect_stderr(out):
        status = command.run_checked()
    if status:
        raise GetagripError(out.getvalue().strip().splitlines()[-1] if out.getvalue().strip() else "the draft failed")
