"""HOT3D (Banerjee et al., CVPR 2025): a hand and an object, true hands and poses, masks rendered from them.

Images are not read (HOT3D's are in VRS recordings): masks are rendered from the true poses of the objects and of both
hands, in a pinhole in place of the fisheye camera.

Each hand and object of a recording is a track. It becomes a clip for every hold, one clip of all frames (``whole``) if
it has a hold, or one clip for each grasp of a list, as the authors' ``hot3d_hit.json``. With ``timelines``, an object
and both hands become a clip for each interaction between two long static segments: a clip of the hand that touches the
object in more frames, with the segments of both hands, by the true poses or from the authors' list.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import HandTrack, Segment, World
from getagrip.clip.timeline import at_frames
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MESH_SUFFIXES, read_mesh
from getagrip.hands.model import Side
from getagrip.io.files import is_portable_name, printable, read_json, shorten_value
from getagrip.io.options import Flag
from getagrip.readers.datasets.cutting import (
    CutSource,
    Pieces,
    SeveralCameras,
    clip_of_track,
    cut_into_grasps,
    in_front_of_camera,
)
from getagrip.readers.datasets.dataset import Note, Part
from getagrip.readers.datasets.hot3d.hot3d_files import Hot3dRecording, find_hot3d_recordings, read_recording
from getagrip.readers.datasets.tracks import SequenceSource, Track, TrackPiece, is_clip_of_sequence
from getagrip.readers.datasets.views import TrackView, with_further_views
from getagrip.stable_grasps.definition import GraspOptions
from getagrip.stable_grasps.find import CutRules, contact_sets
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR, ListedTimeline
from getagrip.stable_grasps.segment_states import interactions, resolve_overlaps, segment_by_contact

if TYPE_CHECKING:
    from getagrip.geometry.rasterize import Surface

DERIVED_TIMELINE_SOURCE = "a timeline: static, contact and grasp by the true poses; {}"


def hot3d_timeline_pieces(tracks: Iterable[Track], note: Note, cut: CutRules) -> Iterator[TrackPiece]:
    """Yield the timelines of a recording; its tracks are ordered by object."""
    for _, of_object in groupby(tracks, key=lambda track: track.category):
        hands = [track.take(np.flatnonzero(in_front_of_camera(track))) for track in of_object]
        if cut.listed is None:
            found = list(_derived_timelines(hands, cut))
        else:
            sides = [track.side for track in hands]
            listed, source = cut.listed.timelines, cut.description
            found = [piece for track in hands for piece in _listed_timelines(track, sides, listed, source)]
        for piece in (replace(piece, other=_other_hand_track(piece.track, hands)) for piece in found):
            if not any(segment.state == "static" for segment in piece.segments):
                note(f"{piece.name}: the object is never static")
            yield piece


def _derived_timelines(hands: Sequence[Track], cut: CutRules) -> Iterator[TrackPiece]:
    definition = cut.definition
    known = [track for track in hands if len(track)]
    contact = {t.side: contact_sets(clip_of_track(t), definition.contact, definition.points) for t in known}
    if not any(sets.any() for sets in contact.values()):
        return
    numbers = {track.side: track.numbers for track in hands}
    for track in hands:
        if track.side not in contact:
            continue
        sets = {side: _resample_contacts(numbers[side], of_hand, track.numbers) for side, of_hand in contact.items()}
        touched = {side: np.asarray(of_hand.any(axis=1)) for side, of_hand in sets.items()}
        segments = segment_by_contact(clip_of_track(track), sets, definition)
        for rows in interactions(segments):
            if _main_hand_side({side: int(in_frames[rows].sum()) for side, in_frames in touched.items()}) == track.side:
                made_of = DERIVED_TIMELINE_SOURCE.format(definition.description)
                yield _piece(track.take(rows), at_frames(segments, rows), made_of)


def _resample_contacts(
    numbers: Int[ndarray, "S"], sets: Bool[ndarray, "S P"], wanted: Int[ndarray, "T"]
) -> Bool[ndarray, "T P"]:
    """Return the contact sets of the frames ``numbers`` in the frames ``wanted``; empty in unknown frames."""
    out = np.zeros((len(wanted), sets.shape[1]), dtype=bool)
    _, rows, source = np.intersect1d(wanted, numbers, return_indices=True)
    out[rows] = sets[source]
    return out


def _listed_timelines(
    track: Track, sides: Sequence[Side], timelines: Sequence[ListedTimeline], source: str
) -> Iterator[TrackPiece]:
    """Yield the timelines of a list for a track's object in which the track's hand is the main hand."""
    name = f"{track.subject}_{track.sequence}"
    for timeline in timelines:
        if (timeline.sequence, timeline.category) != (name, track.category):
            continue
        if not timeline.segments:
            continue
        numbers = track.numbers - track.origin
        first, last = min(s.first for s in timeline.segments), max(s.last for s in timeline.segments)
        of_list = np.flatnonzero((numbers >= first) & (numbers <= last))
        known = track.take(of_list)
        spans = [span for s in timeline.segments for span in at_frames([s], numbers[of_list])]
        segments = resolve_overlaps(spans, len(known), track.side)
        for rows in interactions(segments):
            cut = at_frames(segments, rows)
            grasped = {side: sum(len(s) for s in cut if s.state == "grasp" and s.side == side) for side in sides}
            if _main_hand_side(grasped) == track.side:
                yield _piece(known.take(rows), cut, f"a timeline of {source}")


def _other_hand_track(track: Track, hands: Sequence[Track]) -> Track | None:
    return next((other for other in hands if other.side != track.side and len(other)), None)


def _main_hand_side(frames: Mapping[Side, int]) -> Side | None:
    """Return the hand with the most frames, the left one of equals; None without frames."""
    best = max(sorted(frames), key=lambda side: frames[side])
    return best if frames[best] else None


def _piece(track: Track, segments: tuple[Segment, ...], made_of: str) -> TrackPiece:
    name = f"{track.name}{CLIP_NAME_SEPARATOR}{track.frames[0]}-{track.frames[-1]}"
    return TrackPiece(track, name, made_of, segments=segments)


HOT3D_GRASP_OPTIONS = GraspOptions(contact_mm=5.0, points="area", rule="touch", shortest=10)
"""Holds: uninterrupted contact."""
FRAME_NUMBER_DIGITS = 6
HOT3D_WORLD_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Hot3d(SeveralCameras):
    """Raw HOT3D recordings: every hold of an object by a hand."""

    grasps: Annotated[GraspOptions, arg(name="")] = HOT3D_GRASP_OPTIONS
    """Definition of a hold."""
    timelines: Flag = False
    """Import whole interactions instead of holds, with masks and segments (docs/timelines.md); with --list, those of a
    list. --rule touch then means all-pairs."""
    first_frame: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 0)")] = None
    """Number that the list gives to a recording's first frame; without it, the recording must be as long as in the
    list."""

    def parts(self, note: Note) -> Sequence[Part]:
        """List the recordings, cut to holds, to the grasps of a list or, if ``whole``, at gaps only."""
        cut = self.cut(note)
        listed = cut.listed
        if listed is None and self.first_frame is not None:
            raise UsageError("--first-frame cannot be used without --list")
        lengths = {} if listed is None else listed.lengths
        if self.timelines:
            cut = self._of_timelines(cut)
        found = [source for source in self.sources(lengths) if not lengths or source.name in lengths]
        if listed is not None and not found:
            got = f"none of the {len(lengths)} recordings of {listed.file}"
            raise InputError(self.root, "", got, "one of them at least")
        if listed is not None and (missing := max(0, len(lengths) - len(found))):
            note(f"{missing} of {len(lengths)} recordings of {listed.file} are not there: skipped")
        whole = cut_into_holds if self.whole else cut_into_grasps
        how: Pieces = partial(hot3d_timeline_pieces if self.timelines else whole, cut=cut)
        return [CutSource(source, how, cut.shortest) for source in found]

    def _of_timelines(self, cut: CutRules) -> CutRules:
        """Return the cutting rules of timelines. Raises ``UsageError`` and ``InputError``."""
        if self.whole:
            raise UsageError("--timelines cannot be used with --whole")
        if cut.listed is not None and not cut.listed.timelines:
            assert self.grasps.listed is not None
            raise InputError(self.grasps.listed, "", "a list of grasps", "one of timelines, as hot3d_hit.json")
        definition = cut.definition
        rule = "all-pairs" if definition.rule == "touch" else definition.rule
        return replace(cut, definition=replace(definition, rule=rule))

    def may_make(self, part: Part, names: Set[str]) -> bool:
        """Return whether one of the names is of the recording, which is named <subject>_<sequence>."""
        subject, _, sequence = part.name.partition("_")
        return any(is_clip_of_sequence(name, subject, sequence) for name in names)

    def cut_record(self) -> dict[str, object] | None:
        """Return the record of how clips are cut; None for timelines and whole tracks."""
        return None if self.timelines else super().cut_record()

    def sources(self, lengths: Mapping[str, int] | None = None) -> list[SequenceSource]:
        """List the recordings below ``root``; ``lengths`` are the required numbers of frames, by recording."""
        root = self.root.resolve()
        found = find_hot3d_recordings(root)
        objects = Hot3dObjects.below(root)
        expected = (lengths or {}) if self.first_frame is None else {}
        first = self.first_frame or 0
        return [
            SequenceSource(
                name, partial(_recording_tracks, name, files, objects, expected.get(name), first, self.views)
            )
            for name, files in found.items()
        ]


def cut_into_holds(tracks: Iterable[Track], note: Note, cut: CutRules) -> Iterator[TrackPiece]:
    """Yield the whole tracks that contain a hold."""
    for track in tracks:
        if next(cut_into_grasps([track], lambda _: None, cut), None) is not None:
            yield from cut_into_grasps([track], note, cut, whole=True)


@dataclass(frozen=True)
class Hot3dObjects:
    """Names and mesh files of HOT3D's objects, by uid; some meshes may be missing."""

    names: dict[str, str]
    meshes: dict[str, Path]

    @staticmethod
    def below(root: Path) -> Hot3dObjects:
        """Find the meshes, named by uid or name, of the objects in ``instance.json``. Raises ``InputError``."""
        instances = next(iter(sorted(root.rglob("instance.json"))), None)
        if instances is None:
            raise InputError(root, "", "no instance.json below it", "HOT3D's list of objects")
        names = {}
        for uid, entry in read_json(instances).items():
            name = entry.get("instance_name") if isinstance(entry, dict) else None
            if not isinstance(name, str) or not name.replace("_", "").isalnum():
                expected = "an instance_name of letters, digits and _"
                raise InputError(instances, printable(uid), shorten_value(name), expected)
            names[uid] = name
        files: dict[str, Path] = {}
        for path in sorted(root.rglob("*")):
            if path.suffix.lower() in MESH_SUFFIXES and path.is_file():
                files.setdefault(path.stem, path)
        found = {uid: files.get(uid) or files.get(name) for uid, name in names.items()}
        return Hot3dObjects(names, {uid: path for uid, path in found.items() if path is not None})

    def read(self, recording: Hot3dRecording, note: Note) -> dict[str, Mesh]:
        """Read the meshes of a recording's objects, with a note on each missing mesh."""
        meshes = {}
        for uid in sorted(recording.objects):
            name = self.names.get(uid, uid)
            try:
                if uid in self.meshes:
                    meshes[uid] = read_mesh(self.meshes[uid])
                else:
                    note(f"{recording.name}: no mesh of {name}: its holds are skipped and it hides nothing")
            except InputError as error:
                note(f"{recording.name}: {name} is skipped and hides nothing: {error}")
        return meshes


def _recording_tracks(
    name: str, files: dict[str, Path], objects: Hot3dObjects, frames: int | None, first: int,
    views: int | Literal["all"], note: Note,
) -> Iterator[Track]:  # fmt: skip
    """Yield every hand with every object of a recording. Raises ``InputError``.

    ``frames`` is the required number of frames, ``first`` a list's number of the first frame.
    """
    folder = next(iter(files.values())).parent
    if not is_portable_name(name):
        raise InputError(folder, "", f"the name {shorten_value(name)}", "P<person>_<id>")
    recording = read_recording(name, files, views != 1)
    if frames not in (None, len(recording.times)):
        expected = f"{frames}, as the list counts them: say with --first-frame what number the first has"
        raise InputError(folder, "headset_trajectory.csv", f"{len(recording.times)} frames", expected)
    for track in hand_object_tracks(folder, recording, objects, note):
        of_track = partial(_further_views, recording, track.numbers)
        yield with_further_views(replace(track, origin=-first), views, of_track, note)


def _further_views(recording: Hot3dRecording, frames: Int[ndarray, "T"]) -> list[TrackView]:
    own, *others = recording.cameras
    return [
        TrackView(
            name=camera.label,
            K=camera.pinhole.K,
            size=camera.pinhole.size,
            T_cam_view=se3.inverse(own.T_world_cam[frames]) @ camera.T_world_cam[frames],
            camera=camera.description,
            covered=camera.pinhole.covered(camera.fisheye),
        )
        for camera in others
    ]


def hand_object_tracks(folder: Path, recording: Hot3dRecording, objects: Hot3dObjects, note: Note) -> Iterator[Track]:
    """Yield every hand with every object of a recording that has a mesh, object by object. Raises ``InputError``."""
    meshes, camera = objects.read(recording, note), recording.camera
    covered = camera.pinhole.covered(camera.fisheye)
    subject, _, sequence = recording.name.partition("_")
    for uid, poses in recording.objects.items():  # timelines look at both hands of an object
        for side, hand in recording.hands.items():
            frames = np.flatnonzero(hand.known & poses.known)
            if uid not in meshes or not frames.size:
                continue
            T_cam_world = se3.inverse(camera.T_world_cam[frames])
            yield Track(
                file=folder,
                subject=subject,
                sequence=sequence,
                category=objects.names[uid],
                side=side,
                fps=round(1e9 / float(np.median(np.diff(recording.times))), 3),
                numbers=frames,
                digits=FRAME_NUMBER_DIGITS,
                size=camera.pinhole.size,
                K=camera.pinhole.K,
                hand=HandTrack(
                    vertices=hand.posed.vertices[frames],
                    faces=hand.posed.faces,
                    T_cam_hand=T_cam_world @ hand.T_world_hand[frames],
                    regions=hand.posed.regions,
                    joints=hand.posed.joints[frames],
                ),
                T_cam_obj=T_cam_world @ poses.T_world_obj[frames],
                mesh=meshes[uid],
                beside=partial(_other_surfaces, recording, side, uid, meshes),
                covered=covered,
                world=World(camera.T_world_cam[frames], HOT3D_WORLD_UP),
                stamps=1e-9 * (recording.times[frames] - recording.times[0]),
                provenance={
                    "source": f"HOT3D, recording {recording.name}",
                    "object_uid": uid,
                    "hands": "HOT3D's UmeTrack hands (true)",
                    "masks": "rendered from the true poses, hidden by both hands and by other objects with a mesh",
                    "camera": camera.description,
                    "bop": camera.bop,
                    "scale": "HOT3D's scanned mesh, true size",
                    "times": "poses are the nearest in time to the frame, at most 5 ms off",
                },
            )


def _other_surfaces(
    recording: Hot3dRecording, side: Side, uid: str, meshes: dict[str, Mesh], n: int
) -> tuple[list[Surface], list[Surface]]:
    """Pose the other hand, and the other objects that have a mesh, in the camera frame in frame n."""
    T_cam_world = se3.inverse(recording.camera.T_world_cam[n])
    hands: list[Surface] = [
        (se3.transform(T_cam_world @ hand.T_world_hand[n], hand.posed.vertices[n]), hand.posed.faces)
        for other, hand in recording.hands.items()
        if other != side and hand.known[n]
    ]
    objects: list[Surface] = [
        (se3.transform(T_cam_world @ poses.T_world_obj[n], meshes[other].vertices), meshes[other].faces)
        for other, poses in recording.objects.items()
        if other != uid and other in meshes and poses.known[n]
    ]
    return hands, objects
