"""Further cameras of a draft: the hand is found in each video, the object's mask is carried through it from a box.

What they see is added to the clip of the draft before it is reconstructed. The hand, lifted from one video at an
assumed size, gets its size and place from joints that two cameras see or more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.cli.draft_inputs import VideoInterval
from getagrip.cli.import_files import write_reader_masks
from getagrip.cli.view_options import write_undistorted
from getagrip.clip import Clip, read_clip
from getagrip.clip.read import read_header
from getagrip.clip.views import JOINTS_FILE, VIEWS_KEY, write_view_header, write_view_joints
from getagrip.clip.write import write_hand_at
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.geometry.lens import Lens
from getagrip.hands.from_2d.landmarks import LIFTED_HANDS_NOTE
from getagrip.hands.from_2d.triangulation import (
    AlignedHand,
    SeenJoints,
    align_hand,
    refit_fingers,
    triangulate_joints,
)
from getagrip.io import files
from getagrip.io.images import write_image
from getagrip.io.terminal import format_count, print_note, progress_bar
from getagrip.provenance import Source, estimated
from getagrip.readers.footage import Footage
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from getagrip.readers.matched_footage import describe_match, match_footage
from getagrip.readers.video import footage_interval
from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, DetectedHands, HandDetectionFiles
from getagrip.studio.store.export_clip import write_labelled_clip_files
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, Labels
from getagrip.studio.store.tasks import open_footage

if TYPE_CHECKING:
    from getagrip.cli.draft import Draft

MASK_LABELS = (str(OBJECT_LABEL),), (str(OCCLUDER_LABEL),), (str(HAND_LABEL),)
"""Labels of the object, of what hides it and of the hand in the masks of a draft."""
HAND_SCALE_KEY, HAND_DISTANCE_KEY = "hands_scale", "hands_focal"
"""Topics of a lifted hand's provenance: its size, and its distance."""


@dataclass(frozen=True, eq=False)
class DraftedView:
    """A further camera's footage, with the hand and the object's masks in it.

    Attributes:
        name: name of the view.
        footage: its footage, without distortion.
        at: index of the image of each frame of the clip's footage, by the frame's name.
        K: (3, 3) intrinsics [px].
        T_cam_view: (4, 4) pose of the camera in the clip's camera frame [m].
        camera: source of these.
        time_offset: time of its images after the clip's [s].
        hand: the hand in its images; None where none was found.
        masks: folder of masks, named as the footage's frames; None without any.
    """

    name: str
    footage: Footage
    at: Mapping[str, int]
    K: Float[ndarray, "3 3"]
    T_cam_view: Float[ndarray, "4 4"]
    camera: Source
    time_offset: float
    hand: DetectedHands | None
    masks: Path | None

    def write(self, clip: Path, frames: tuple[str, ...]) -> str:
        """Write the view into a clip, for some of its frames; return what it lacks. Raises ``InputError``."""
        known = tuple(name for name in frames if name in self.at)
        if len(known) < 2:
            return f"view {self.name}: images of {format_count(len(known), 'frame')} of {clip.name}: left out"
        to, size, n = files.folder_inside(clip, VIEWS_KEY, self.name), self.footage.size, len(known)
        of = np.tile(self.K, (n, 1, 1)), np.tile(self.T_cam_view, (n, 1, 1))
        sources: dict[str, object] = {"camera": self.camera}
        if self.hand is not None:
            write_view_joints(to / JOINTS_FILE, *self._joints(known))
            sources["joints"] = self.hand.provenance["hands"]
        lacks = "" if self.masks is not None else f"view {self.name}: no masks"
        if self.masks is not None:
            sources["masks"] = estimated("carried through the video from a box")
            request = MaskRequest(tuple(self.footage.name(self.at[name]) for name in known), size, *MASK_LABELS)
            try:
                write_reader_masks(open_masks(self.masks, request), known, to / "masks")
            except InputError as error:
                lacks = f"view {self.name}: {error}"
        write_view_header(to, known, size, *of, self.time_offset, sources)
        (to / "frames").mkdir(exist_ok=True)
        for name in known:
            write_image(to / "frames" / f"{name}.jpg", self.footage.image(self.at[name]))
        return lacks

    def _joints(self, frames: tuple[str, ...]) -> tuple[Float[ndarray, "n 21 2"], Float[ndarray, "n 21"]]:
        points, confidence = np.zeros((len(frames), 21, 2)), np.zeros((len(frames), 21))
        assert self.hand is not None
        seen, sure = self.hand.hand.joints_2d, self.hand.hand.joints_2d_confidence
        assert seen is not None
        assert sure is not None
        place = {n: row for row, n in enumerate(self.hand.frames)}
        for row, name in enumerate(frames):
            if (found := place.get(self.at[name])) is not None:
                points[row], confidence[row] = seen[found], sure[found]
        return points, confidence

    def seen(self, clip: Clip) -> SeenJoints | None:
        """Return the joints in its images, at the clip's frames; None without any."""
        if self.hand is None:
            return None
        known = [n for n, name in enumerate(clip.frames) if name in self.at]
        points, confidence = np.zeros((len(clip), 21, 2)), np.zeros((len(clip), 21))
        points[known], confidence[known] = self._joints(tuple(clip.frames[n] for n in known))
        every = np.tile(self.K, (len(clip), 1, 1)), np.tile(self.T_cam_view, (len(clip), 1, 1))
        return SeenJoints(points, confidence, *every)


@dataclass(frozen=True)
class DraftedViews:
    """The further cameras of a draft."""

    each: tuple[DraftedView, ...]

    def add_to(self, clip: Path) -> str:
        """Write the views into a clip, and correct its hand; return what is to be known. Raises ``InputError``."""
        header = read_header(clip)
        said = [view.write(header.folder, header.frames) for view in self.each]
        return "\n".join(filter(None, (*said, self._correct_hand(header.folder))))

    def _correct_hand(self, folder: Path) -> str:
        """Move and scale the clip's lifted hand to triangulated joints; return what is to be known of it."""
        header, clip = read_header(folder), read_clip(folder)
        points, sure = clip.hand.joints_2d, clip.hand.joints_2d_confidence
        others = [seen for view in self.each if (seen := view.seen(clip)) is not None]
        if points is None or sure is None or not others:
            return "the hand's size is assumed: no other view shows its joints" if not others else ""
        own = SeenJoints(points, sure, clip.K, np.tile(np.eye(4), (len(clip), 1, 1)))
        joints = triangulate_joints([own, *others])
        found = align_hand(clip.hand, joints)
        if found is None:
            return "the hand's size is assumed: the joints of the views do not meet; is the calibration theirs?"
        rows, corrected = [header.frames.index(name) for name in clip.frames], found.hand
        if LIFTED_HANDS_NOTE in str(clip.provenance.get("hands")):
            corrected = refit_fingers(found.hand, joints, clip.side)
        words = _describe_alignment(found, 1 + len(others))
        sources = {HAND_SCALE_KEY: estimated(words), HAND_DISTANCE_KEY: estimated(words)}
        with files.new_file(header.folder / "hand.npz") as hand, files.new_file(header.path) as fields:
            write_hand_at(corrected, header.frames, rows, hand)
            files.write_json(fields, header.changed({"provenance": header.fields["provenance"] | sources}))
        return f"hands_scale: {words}"


def _describe_alignment(found: AlignedHand, views: int) -> str:
    frames = f"{int(found.aligned.sum())} of {format_count(len(found.aligned), 'frame')}"
    moved = f"moved by {1e3 * float(np.median(found.moved[found.aligned])):.0f} mm"
    return (
        f"joints triangulated from {views} views in {frames}: the hand is {found.scale:.2f} times as large, and {moved}"
    )


def draft_views(draft: Draft, stretch: VideoInterval, found: DetectedHands) -> DraftedViews:
    """Find hands and masks in the footage of all further cameras. Raises ``InputError`` and ``UsageError``."""
    rig = draft.views.rig
    assert rig is not None
    boxes, starts = dict(draft.box_view), dict(draft.views.view_start)
    numbers = np.arange(stretch.first + 1, stretch.last + 2)
    clip = footage_interval(draft.video, numbers, stretch.footage.size, stretch.footage.fps, True)
    out = []
    for name, path in draft.views.view:
        match = match_footage(clip, path, starts.get(name))
        print_note(describe_match(name, match, len(clip.names)))
        at = {clip.names[row]: n for row, n in zip(match.known.tolist(), match.at.tolist(), strict=True)}
        K, removal, words = rig.undistortion(rig.views[name], match.footage.size)
        folder = files.folder_inside(draft.folder, VIEWS_KEY, name)
        video = path if removal is None else write_undistorted(path, removal, folder)
        camera = rig.source(rig.views[name])
        one = DraftedView(
            name, open_footage(video), at, K, rig.T_cam_view(name), replace(camera, text=camera.text + words),
            match.time_offset, None, None,
        )  # fmt: skip
        sub = replace(
            draft, video=video, out=folder, side=found.side, object_box=boxes.get(name), hands=None, masks=None,
            depth=None, depth_from=None, views=type(draft.views)(), box_view=(), find_grasps=False,
            interval=(min(at.values()) + 1, max(at.values()) + 1), lens=lens_of_K(K),
        )  # fmt: skip
        try:
            out.append(_draft_view(sub, one))
        except UsageError as error:
            print_note(f"view {name} is left out: {error}")
    return DraftedViews(tuple(out))


def lens_of_K(K: Float[ndarray, "3 3"]) -> Lens:
    """Return the lens as options state it."""
    fx, fy, cx, cy = K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    return Lens(K=(fx, fy, cx, cy))


def _draft_view(sub: Draft, view: DraftedView) -> DraftedView:
    """Find the hand and, with a box, the object's masks in the footage of a view. Raises ``UsageError``."""
    stretch = sub.stretch(view.footage)
    found = sub.write_hands(stretch, sub.inputs(stretch, sub.video))
    view = replace(view, hand=found)
    if sub.object_box is None:
        return view
    try:
        drawn = sub.drawn(stretch, found)
    except UsageError as error:
        print_note(f"view {view.name} has no masks: {error}")
        return view
    labels = Labels(
        sub.video.name, view.footage.size, found.side, view.footage.fps, found.frames[0], found.frames[-1],
        {n: one for n, one in drawn.items() if found.frames[0] <= n <= found.frames[-1]},
    )  # fmt: skip
    files_of_hand = HandDetectionFiles(sub.folder / DETECTED_HANDS_FOLDER)
    with progress_bar() as bar:
        job = bar.add_task(f"masks of view {view.name}", total=labels.last - labels.first + 1)
        update = lambda n: bar.update(job, completed=n)  # noqa: E731
        try:
            write_labelled_clip_files(
                labels, view.footage.image, sub.lens_stated, sub.folder / "files", True, update, files_of_hand,
                view.footage.name,
            )  # fmt: skip
        except GetagripError as error:
            print_note(f"view {view.name} has no masks: {error}")
            return view
    return replace(view, masks=sub.folder / "files" / "masks")
