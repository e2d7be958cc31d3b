"""``getagrip annotate``: serve the page of annotations until it is interrupted, or import or export annotations."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.cli.command import Command
from getagrip.errors import InputError, UsageError
from getagrip.geometry.lens import Lens
from getagrip.io import files
from getagrip.io.options import Flag, Folder, OptionalFile
from getagrip.io.terminal import format_count, print_note

if TYPE_CHECKING:
    from getagrip.studio.project import Project
    from getagrip.studio.store.labels import Labels
    from getagrip.studio.store.tasks import Task

DATABASE = "marks.sqlite"
"""The database of marks, in the folder of the annotations."""
UNKNOWN_SHAPE: Mapping[str, object] = {}
TOKENS_FOLDER = "tokens"
"""Folder of the secrets in the addresses of pages, in the user's state folder."""


@dataclass(frozen=True, kw_only=True)
class Annotate(Command):
    """Mark stable grasps or whole interactions, and label frames, on a local page."""

    source: Annotated[Positional[Path], arg(metavar="VIDEO|CANDIDATES")]
    """A video, a folder of images, or a list (.csv, .json) of videos with rough start and end, hand and category, as
    epic candidates writes it."""
    out: Folder
    """Folder of the marks, which are saved as they are made. Called again with the same folder, it goes on where it
    stopped."""
    videos: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: where the list is)")] = None
    """For a list: where its videos are, or folders of their images."""
    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 8765, or the next free one)")] = None
    """Port of the page on 127.0.0.1."""
    lens: Annotated[Lens, arg(name="")] = field(default_factory=Lens)
    """The camera, for the hands that are fitted to clicked joints. Without it their depth and size are guesses."""
    export: Flag = False
    """Write files instead of serving the page: each annotator's grasps as a table and as JSON, the agreement of the
    annotators, the segments of whole interactions, and for labelled grasps the labels, hand.npz and masks."""
    import_labels: OptionalFile = None
    """Import a labels file, which replaces existing labels of its frames, and exit."""
    import_segments: OptionalFile = None
    """Import segments, found by segment --from-masks or marked by somebody, as a first draft, and exit."""
    annotator: Annotated[str, arg(metavar="NAME")] = "imported"
    """With --import-labels and --import-segments: the annotator to whom they are attributed."""

    def run(self) -> int:
        """Serve the page for a source; or import labels or segments, or export marks and labels to ``out``.

        Returns 1 if the files of a grasp could not be made, else 0. Raises ``InputError`` for a malformed source or
        database, ``UsageError`` for a ``port`` in use; the default is a free one.
        """
        from getagrip.checks.intrinsics import compute_intrinsics
        from getagrip.studio.project import Project
        from getagrip.studio.store.export_all import write_labelled_grasps, write_mark_files
        from getagrip.studio.store.history import RefusedError
        from getagrip.studio.store.mark_store import Store
        from getagrip.studio.store.tasks import read_tasks

        tasks = read_tasks(self.source, self.videos)
        if absent := [task for task in tasks if task.path is None]:
            missing = f"no footage of {len(absent)} of them, as {files.printable(absent[0].video)}"
            print_note(f"{len(tasks)} candidates, {missing}")
        out, imported = self.out, self.import_labels is not None or self.import_segments is not None
        if self.export and not imported and not (out / DATABASE).is_file():
            raise UsageError(f"missing {out / DATABASE}: --export writes what has been marked")
        labels = None if self.import_labels is None else read_labels(self.import_labels, tasks)
        out.mkdir(parents=True, exist_ok=True)
        project = Project(tasks, Store(out / DATABASE), self.lens)
        try:
            if self.lens.is_set and (task := next((task for task in tasks if task.path is not None), None)):
                compute_intrinsics(self.lens, project.footage(task).size)  # which refuses a wrong lens before any click
            if labels is not None and self.import_labels is not None:
                try:
                    grasp = project.import_labels(labels, self.annotator)
                except RefusedError as error:
                    got = f"labels that do not fit ({error})"
                    raise InputError(self.import_labels, "", got, "labels of the footage") from error
                frames = f"{grasp.mark.start_number} to {grasp.mark.end_number}"
                keys = format_count(len(labels.frames), "key frame")
                print(f"{self.annotator}: {keys} of {grasp.task.key}, {frames}")
            if self.import_segments is not None:
                try:
                    count = project.import_segments(self.import_segments, self.annotator)
                except RefusedError as error:
                    raise UsageError(str(error)) from error
                print(f"{self.annotator}: {format_count(count, 'segment')}; give the page this name to correct them")
            if self.export:
                return max(write_mark_files(project, out), write_labelled_grasps(project))
            if not imported:
                serve(project, self.port)
            return 0
        finally:
            project.close()


def read_labels(path: Path, tasks: list[Task]) -> Labels:
    """Read a file of labels. Raises ``InputError`` for a malformed file, and for labels of other footage."""
    from getagrip.studio.store import labels
    from getagrip.studio.store.export_clip import tasks_of_labels
    from getagrip.studio.store.history import RefusedError

    value = labels.read_label_file(path)
    try:
        tasks_of_labels(value, tasks)
    except RefusedError as error:
        raise InputError(path, "", f"labels of other footage ({error})", "labels of the footage given") from error
    return value


def serve(project: Project, port: int | None, annotator: str = "", shape: Mapping[str, object] = UNKNOWN_SHAPE) -> None:
    """Serve the page until it is interrupted. Raises ``UsageError`` for a port in use.

    With an ``annotator`` the page opens on the annotator's first grasp, to be labelled; ``shape`` fills in the fields
    ``mesh`` and ``size-mm``.
    """
    from urllib.parse import urlencode

    from getagrip.io.terminal import state_folder
    from getagrip.studio.server import Server, persistent_token, serve_on_free_port

    marks = sha256(os.fsencode(project.store.path.resolve())).hexdigest()[:16]
    token = persistent_token(state_folder() / TOKENS_FOLDER / marks)  # beside the marks, others might read it
    with serve_on_free_port(project, token) if port is None else Server(project, port, token) as server:
        address = f"{server.url}#{urlencode({'annotator': annotator, **shape})}" if annotator else server.url
        print(f"open {address} in a browser; marks are kept in {project.store.path}; Ctrl-C ends", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
