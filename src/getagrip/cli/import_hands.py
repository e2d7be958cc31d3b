"""``getagrip import hands``: an estimator's hands into clips, or into a hand file for a clip that is made later.

``import hands --out`` writes a hand file; ``clip new --hands`` reads it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, make_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.checks.intrinsics import camera_warning, compute_intrinsics
from getagrip.cli.command import WARNING_EXIT_STATUS, Command, FirstNumber, OptionalSide, refuse_existing
from getagrip.cli.import_files import NumberedFrames, ViewName, import_many
from getagrip.clip.match_frames import check_frame_numbers, number_of
from getagrip.clip.read import ClipHeader, read_header
from getagrip.clip.read_arrays import OTHER_HAND_FILE, check_in_view, check_intrinsics, frames_with_hand, read_hand
from getagrip.clip.timeline import opposite_side
from getagrip.clip.views import find_view
from getagrip.clip.write import FRAMES_WITHOUT_HAND, missing_hand_provenance, write_hand, write_hand_at
from getagrip.errors import InputError, UsageError
from getagrip.geometry.lens import Lens
from getagrip.hands.model import Side
from getagrip.io import arrays, files
from getagrip.io.options import Flag, OptionalFile, one_of
from getagrip.io.terminal import print_note, print_result, warn
from getagrip.provenance import (
    EXTRAPOLATED_HANDS_KEY,
    Source,
    is_provenance_key,
    measured,
    provenance_from_arrays,
    provenance_to_arrays,
    report_source,
)
from getagrip.readers.trackers import (
    CHOSEN_HANDS_KEY,
    Request,
    TrackedHands,
    Tracker,
    choose_tracker,
    read_tracked_hands,
    recognise,
    usable,
)

OTHER_HAND_PREFIX = "other_"
"""Prefix of the other hand's topics in a clip's provenance."""
MAX_HAND_FILE_FRAMES = 20_000
"""Maximum number of frames in a hand file."""
if TYPE_CHECKING:
    HandSource: TypeAlias = str | None
    Trackers: TypeAlias = object


@dataclass(frozen=True)
class HandFile:
    """A ``hand.npz`` that may also hold frame numbers, a side and a camera."""

    path: Path
    numbers: tuple[int, ...] | None
    K: Float[ndarray, "3 3"] | None
    side: str | None
    provenance: dict[str, Source]
    """Sources of the hands."""

    @staticmethod
    def of(path: Path) -> HandFile:
        """Read a hand file. Raises ``InputError`` for a malformed one."""
        stored = arrays.read(path, lambda key: key in {"frames", "K", "side"} or is_provenance_key(key))
        side = str(stored["side"]) if "side" in stored and stored["side"].dtype.kind == "U" else None
        K = arrays.floats(path, stored, "K", (3, 3)) if "K" in stored else None
        return HandFile(path, arrays.frame_numbers(path, stored), K, side, provenance_from_arrays(path, stored))

    def at(self, frames: tuple[str, ...], side: Side, first: int | None) -> TrackedHands:
        """Return the hands of the frames that have one.

        ``first`` is the number that the file gives to the first frame; None: the frame's own number. Raises
        ``InputError``, and ``UsageError`` for a file whose numbers seem to begin elsewhere.
        """
        with arrays.convert_to_input_errors(self.path):
            return self._at(frames, side, first)

    def _at(self, frames: tuple[str, ...], side: Side, first: int | None) -> TrackedHands:
        if self.side not in (None, side):
            raise InputError(self.path, "side", f"a {self.side} hand", f"a {side} hand, as --side says")
        sources = {"hands": f"from {self.path.name}", **self.provenance}
        sources.pop("camera", None)
        if self.numbers is None:
            return TrackedHands(read_hand(self.path, len(frames)), tuple(range(len(frames))), sources)
        track = read_hand(self.path, len(self.numbers))
        names, ask_first, _ = NumberedFrames.of(frames, first, "--hand-first")
        check_frame_numbers(names, map(str, self.numbers), self.path, "hand", ask_first)
        place = {number: row for row, number in enumerate(self.numbers)}
        at = [None if number is None else place.get(number) for number in map(number_of, names)]
        rows = tuple(row for row, entry in enumerate(at) if entry is not None)
        if len(rows) < 2:
            got = f"hands in {len(rows)} frames of the interval"
            expected = f"hands in frames {number_of(names[0])} to {number_of(names[-1])}"
            raise InputError(self.path, "frames", got, expected)
        picked = track.take(np.array([entry for entry in at if entry is not None]))
        return TrackedHands(picked, rows, sources)


def camera_of(lens: Lens, hands: HandFile | None, size: tuple[int, int]) -> tuple[Float[ndarray, "3 3"], Source]:
    """Return the intrinsics that the user states, else the hand file's. Raises ``UsageError`` and ``InputError``."""
    if lens.is_set or hands is None or hands.K is None:
        return compute_intrinsics(lens, size)
    check_intrinsics(hands.path, hands.K[None], size)
    known = hands.provenance.get("camera", measured("it does not say from where"))
    return hands.K, replace(known, text=f"the hand file's: {known}")


@dataclass(frozen=True)
class NewFrames:
    """The frames of a clip that is made later; None and defaults for unstated fields."""

    side: OptionalSide = None
    """With --out: side of the hand."""
    frames: Annotated[tuple[int, int] | None, arg(metavar="FIRST LAST", help_behavior_hint="")] = None
    """With --out: numbers of the first and the last frame."""
    size: Annotated[tuple[int, int] | None, arg(metavar="WIDTH HEIGHT", help_behavior_hint="")] = None
    """With --out: width and height of the images [px]."""
    lens: Annotated[Lens, arg(name="")] = field(default_factory=Lens)
    """With --out: the camera."""

    @property
    def stated(self) -> bool:
        """True if any field is stated."""
        return bool(self.side or self.frames or self.size or self.lens.is_set)


@dataclass(frozen=True, kw_only=True)
class ImportHands(Command):
    """Import hands from an estimator's files, into a clip that lacks them or into a file for a later clip."""

    paths: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE...", help_behavior_hint="")]
    """.npz, .json, .pkl, .pt, .npy, .obj, or folders of them: one file per image, named like it, or one file for all
    images (docs/estimators.md)."""
    source: HandSource = None
    trackers: Trackers
    clip: Annotated[Path | None, arg(metavar="CLIP", help_behavior_hint="")] = None
    """The clip's folder. Side, frames and camera are taken from the clip."""
    clips: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """A folder of clips: into each what FILE, a folder, has under the clip's name. Clips with hands are done."""
    out: OptionalFile = None
    """Write a file for clip new --hands instead. This needs --side, --frames, --size and a camera."""
    mano: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: the generic hand)")] = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl."""
    new: Annotated[NewFrames, arg(name="")] = field(default_factory=NewFrames)
    first: FirstNumber = None
    """The number that the files give to the first frame, if they count from another start."""
    hold_ends: Flag = False
    """For a whole interaction: extrapolate the hand before the first and after the last frame in which it was found; it
    is assumed to stand still. By default these frames are left out."""
    other_hand: Flag = False
    """With --clip: import the hand of the other side, which holds the object in some of a timeline's grasps. Frames may
    lack it."""
    view: ViewName = None
    overwrite: Flag = False
    """Replace hands that are there already."""

    def check(self) -> None:
        if self.out is not None:
            files.check_file("--out", self.out)

    @cached_property
    def tracker(self) -> Tracker:
        """The tracker that made the files, with its options; recognised by the files without ``--from``."""
        trackers = vars(self.trackers)
        if self.source is not None:
            return choose_tracker(self.source, trackers)
        name, words = recognise(self.paths, trackers)
        print_note(f"{self.paths[0]}: taken for {words}, as by --from {name}")
        return choose_tracker(name, trackers)

    def run(self) -> int:
        """Add hands to clips, or write a hand file. Raises ``UsageError`` for options that do not fit."""
        if self.other_hand and self.hold_ends:
            raise UsageError("--other-hand cannot be used with --hold-ends: that hand is in the frames that have it")
        if self.other_hand and self.clip is None and self.clips is None:
            raise UsageError("missing --clip: --other-hand is the hand of the other side than the clip's")
        if not self.paths:
            raise UsageError("missing FILE: name the estimator's files")
        if self.view is not None and (self.clip is None or self.other_hand or self.hold_ends):
            raise UsageError("--view takes 2D joints of the clip's hand into a view of --clip, and no other option")
        given = [f"--{name}" for name in ("clip", "clips", "out") if getattr(self, name) is not None]
        if len(given) > 1:
            raise UsageError(f"{given[0]} cannot be used with {given[1]}")
        if self.clips is not None:
            return self._into_clips(self.clips)
        if self.out is not None:
            return self._into_file(self.new, self.out)
        if self.clip is None:
            raise UsageError("missing --clip or --out")
        if self.new.stated:
            raise UsageError("--side, --frames, --size, --K cannot be used with --clip, which has them")
        if self.view is not None:
            return self._into_view(self.clip, self.view)
        return self._other_into_clip(self.clip) if self.other_hand else self._into_clip(self.clip)

    def _into_clips(self, clips: Path) -> int:
        if len(self.paths) != 1 or self.new.stated:
            raise UsageError("--clips takes one FILE, a folder, and no --side, --frames, --size or --K")
        target = OTHER_HAND_FILE if self.other_hand else "hand.npz"

        def of_clip(source: Path, clip: Path) -> ImportHands:
            return replace(self, paths=(source,), clip=clip, clips=None)

        return import_many(self.paths[0], clips, target, self.overwrite, of_clip, self.debug)

    def _into_clip(self, folder: Path) -> int:
        """Add ``hand.npz`` to a clip's folder, with the names of the frames that have a hand if some lack it.

        The clip keeps frames without a hand, which may be added later. Raises ``UsageError`` for a clip with hands.
        """
        header = read_header(folder)
        target = header.folder / "hand.npz"
        refuse_existing(target, self.overwrite)
        side: Side = header.fields["side"]
        request = replace(self._request(side, header.frames, header.K, header.size), times=header.times)
        request = replace(request, hand_masks=_hand_mask_paths(header))
        hands = read_tracked_hands(self.paths, self.tracker, request)
        check_in_view(self.paths[0], hands.track, header.K[list(hands.found)], header.size)
        hands = hands.extrapolate_to_ends(header.frames) if self.hold_ends else hands
        if len(hands.found) < len(header.frames) and (header.folder / "truth.npz").exists():
            missing = len(header.frames) - len(hands.found)
            raise UsageError(f"missing hand in {missing} frames: {folder} has a truth.npz, which needs one in each")
        with files.new_file(target) as hand, files.new_file(header.folder / "clip.json") as fields:
            write_hand_at(hands.track, header.frames, hands.found, hand)
            files.write_json(fields, _changed_clip_fields(header, hands))
        _print_hand_sources(hands, header.frames)
        print_result(str(target))
        return _exit_status(header.K, header.size, _hand_warnings(hands, len(header.frames)))

    def _into_view(self, folder: Path, name: str) -> int:
        """Add the joints of the hand in a view's images. Raises ``InputError`` for files without any."""
        from getagrip.cli.import_views import write_imported_joints

        header = read_header(folder)
        view = find_view(header.folder, name)
        hands = read_tracked_hands(
            self.paths, self.tracker, self._request(header.fields["side"], view.frames, view.K, view.size)
        )
        return write_imported_joints(self.paths[0], hands, view, self.overwrite)

    def _other_into_clip(self, folder: Path) -> int:
        """Add ``other_hand.npz`` to a clip's folder, in the frames in which the other hand was found.

        Raises ``UsageError`` for a clip that has the file, ``InputError`` if these frames all lack the clip's own hand.
        """
        header = read_header(folder)
        target = header.folder / OTHER_HAND_FILE
        refuse_existing(target, self.overwrite)
        own = frames_with_hand(files.inside(header.folder, "hand.npz", "", "the clip's own hand first"), header.frames)
        side = opposite_side(header.fields["side"])
        request = replace(self._request(side, header.frames, header.K, header.size), times=header.times)
        hands = read_tracked_hands(self.paths, self.tracker, request)
        check_in_view(self.paths[0], hands.track, header.K[list(hands.found)], header.size)
        alone = sorted({*hands.found} - {*own.tolist()})
        if len(alone) == len(hands.found):
            got = f"the {side} hand in {len(alone)} frames, in none of which the clip has its own"
            expected = "some in which it has: frames without it are left out (--hold-ends)"
            raise InputError(self.paths[0], "", got, expected)
        own_sources = header.fields["provenance"].items()
        known = {key: text for key, text in own_sources if not key.startswith(OTHER_HAND_PREFIX)}
        provenance = {OTHER_HAND_PREFIX + key: text for key, text in hands.provenance.items()}
        with files.new_file(target) as hand, files.new_file(header.folder / "clip.json") as fields:
            write_hand_at(hands.track, header.frames, hands.found, hand)
            files.write_json(fields, header.changed({"provenance": known | provenance}))
        for key, text in provenance.items():
            report_source(key, text)
        print_result(f"{target}: the {side} hand in {len(hands.found)} of {len(header.frames)} frames")
        if alone:
            some = _join_first_names(header.frames[row] for row in alone)
            left_out = f"{len(alone)} frames have the {side} hand only and are left out, as all without the clip's own"
            warn(f"{left_out}: {some}")
        return _exit_status(header.K, header.size, hands.warnings)

    def _into_file(self, new: NewFrames, out: Path) -> int:
        """Write a hand file: a ``hand.npz`` with ``frames`` (T,), ``K`` (3, 3), ``side`` and provenance."""
        if new.side is None or new.frames is None or new.size is None:
            asked = (("side", new.side), ("frames", new.frames), ("size", new.size))
            missing = next(name for name, value in asked if value is None)
            raise UsageError(f"missing --{missing}: --out needs it")
        if out.suffix != ".npz":
            raise UsageError(f"--out must be a file *.npz (got {out})")
        refuse_existing(out, self.overwrite)
        first, last = new.frames
        if not 0 <= first <= last < first + MAX_HAND_FILE_FRAMES or min(new.size) < 1:
            got = f"{first} {last}, {new.size[0]} {new.size[1]}"
            allowed = f"numbers of the first and the last frame, at most {MAX_HAND_FILE_FRAMES}, and a size in pixels"
            raise UsageError(f"--frames, --size must be {allowed} (got {got})")
        K, camera = compute_intrinsics(new.lens, new.size)
        numbers = np.arange(first, last + 1)
        names = tuple(f"{n:06d}" for n in numbers)
        many = np.tile(K, (len(names), 1, 1))
        hands = read_tracked_hands(self.paths, self.tracker, self._request(new.side, names, many, new.size))
        check_in_view(self.paths[0], hands.track, many[list(hands.found)], new.size)
        hands = hands.extrapolate_to_ends(names) if self.hold_ends else hands
        provenance = hands.provenance | {"camera": camera}
        extra = {"frames": numbers[list(hands.found)], "K": K, "side": np.array(new.side)}
        extra |= provenance_to_arrays(provenance)
        with files.new_file(out) as part:
            write_hand(hands.track, part, extra)
        _print_hand_sources(replace(hands, provenance=provenance), names)
        print(out)
        return _exit_status(many, new.size, _hand_warnings(hands, len(names)))

    def _request(
        self, side: Side, frames: tuple[str, ...], K: Float[ndarray, "T 3 3"], size: tuple[int, int]
    ) -> Request:
        names, ask_first, counted = NumberedFrames.of(frames, self.first)
        return Request(side, names, K, size, self.mano, ask_first=ask_first, counted=counted)


if not TYPE_CHECKING:  # the table of trackers states the choices of --from and each tracker's options
    TAKEN = [field.name for command in (ImportHands, NewFrames, Lens) for field in fields(command)]
    USABLE = usable(["from", *TAKEN])
    TAKES = "; ".join(f"{name}: {tracker.takes}" for name, tracker in USABLE.items())
    HELP = f"Program or format of the files; by default by their names and keys. {TAKES}."
    HandSource = Annotated[str | None, one_of(*USABLE), arg(name="from", help=HELP, help_behavior_hint="")]
    OPTIONS = [(name, type(tracker), field(default=tracker)) for name, tracker in USABLE.items()]
    Trackers = Annotated[make_dataclass("Trackers", OPTIONS, frozen=True), arg(name="")]


def _changed_clip_fields(header: ClipHeader, hands: TrackedHands) -> dict[str, object]:
    old = (FRAMES_WITHOUT_HAND, EXTRAPOLATED_HANDS_KEY, CHOSEN_HANDS_KEY)
    known = {key: text for key, text in header.fields["provenance"].items() if key not in old}
    missing = missing_hand_provenance(header.frames, hands.found)
    return header.changed({"provenance": known | hands.provenance | missing})


def _print_hand_sources(hands: TrackedHands, frames: Sequence[str]) -> None:
    """Print the sources of hands, with warnings about guesses and frames without a hand."""
    for key, text in hands.provenance.items():
        report_source(key, text)
    missing = [name for n, name in enumerate(frames) if n not in hands.found]
    if missing:
        warn(f"no hand in {len(missing)} of {len(frames)} frames, skipped: {_join_first_names(missing)}")


def _hand_warnings(hands: TrackedHands, frames: int) -> tuple[str, ...]:
    """Return the warnings about hands, and one if most frames lack a hand."""
    most = 2 * len(hands.found) < frames
    return (*hands.warnings, f"only {len(hands.found)} of {frames} frames have a hand") if most else hands.warnings


def _exit_status(K: Float[ndarray, "T 3 3"], size: tuple[int, int], warnings: tuple[str, ...]) -> int:
    """Print warnings about hands and camera; return ``WARNING_EXIT_STATUS`` with any, else 0."""
    camera = camera_warning(K, size)
    texts = [*(f"hands: {text}" for text in warnings), *([f"camera: {camera}"] if camera else [])]
    for text in texts:
        warn(text)
    return WARNING_EXIT_STATUS if texts else 0


def _hand_mask_paths(header: ClipHeader) -> tuple[Path | None, ...]:
    """Return the clip's hand masks; None for frames without one."""
    images = (f"masks/hand/{frame}.png" for frame in header.frames)
    return tuple(
        files.inside(header.folder, image, "", "a mask of the hand") if (header.folder / image).is_file() else None
        for image in images
    )


def _join_first_names(names: Iterable[str]) -> str:
    stated = list(names)
    return ", ".join(stated[:5]) + (", ..." if len(stated) > 5 else "")
