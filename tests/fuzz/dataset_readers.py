"""Datasets' files, and footage."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from fuzz.child import Reader, mano_folder
from getagrip.geometry import se3
from getagrip.io import arrays
from getagrip.readers.datasets.arctic import Arctic
from getagrip.readers.datasets.cutting import TrackedDataset
from getagrip.readers.datasets.dataset import Dataset
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb
from getagrip.readers.datasets.epic import visor
from getagrip.readers.datasets.epic.epic_grasps import EpicGrasps
from getagrip.readers.datasets.epic.epic_images import Frames
from getagrip.readers.datasets.epic.epic_tables import read_actions
from getagrip.readers.datasets.ho3d import Ho3d
from getagrip.readers.datasets.hocap import HoCap
from getagrip.readers.datasets.hoi4d import Hoi4d
from getagrip.readers.datasets.hot3d.hot3d_clips import Hot3d
from getagrip.readers.datasets.hrdexdb import HrDexDb
from getagrip.readers.datasets.track_files import Tracks
from getagrip.readers.video import video_frames, video_info
from getagrip.studio.store import tasks
from helpers import dexycb_files, epic_files, motion_capture_files
from helpers.hand_object_files import (
    write_ho3d,
    write_ho3d_calibration,
    write_hocap,
    write_hoi4d,
    write_hot3d,
    write_hrdexdb,
    write_labels,
)
from helpers.motion_capture_files import write_arctic


def tracks(dataset: Callable[[Path], TrackedDataset], write: Callable[[Path], object]) -> Reader:
    """A dataset of tracks, all of them read; no clip is cut."""

    def read(folder: Path) -> None:
        for source in dataset(folder).sources():
            for _ in source.read(lambda _: None):
                pass

    return Reader(write, read)


def epic(folder: Path) -> None:
    """One grasp, with a hand file and a camera."""
    epic_files.write_epic(folder)
    (folder / "hands").mkdir()
    arrays.write(
        folder / "hands" / f"{epic_files.NAME}.npz", epic_files.hand_arrays(100) | {"frames": np.arange(1000, 1100)}
    )
    (folder / "cameras").mkdir()
    camera = {"model": "OPENCV", "width": 456, "height": 256, "params": [220.0, 221.0, 228.0, 128.0, 0, 0, 0, 0]}
    (folder / "cameras" / f"{epic_files.V}.json").write_text(json.dumps({"camera": camera, "images": {}}))


def read_epic(folder: Path) -> None:
    dataset: Dataset = EpicGrasps(
        csv=folder / "grasps.csv", visor=folder / "visor", frames=folder / "images", hands=folder / "hands",
        cameras=folder / "cameras",
    )  # fmt: skip
    for part in dataset.parts(lambda _: None):
        for draft in part.drafts(lambda *_, **__: True, lambda _: None):
            made = draft.make()
            if made is not None and draft.images is not None and draft.hand is not None:
                draft.hand(made[0])
                draft.images(made[0])


def epic_timelines(folder: Path) -> None:
    epic_files.write_timeline(epic_files.write_epic(folder), np.tile(np.eye(4), (90, 1, 1)))


def read_epic_timelines(folder: Path) -> None:
    dataset: Dataset = EpicGrasps(
        csv=folder / "grasps.csv", visor=folder / "visor", frames=folder / "images", timelines=folder / "hit.json",
        cameras=folder / "cameras", metric=folder / "metric",
    )  # fmt: skip
    for part in dataset.parts(lambda _: None):
        for draft in part.drafts(lambda *_, **__: True, lambda _: None):
            draft.make()


def visor_zip(folder: Path) -> None:
    things = epic_files.scene()
    path = epic_files.write(folder / "P01_101.json", [epic_files.dense("P01_101", 7, (7, 9), *things)])
    with zipfile.ZipFile(folder / "P01_101_interpolations.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(path, "P01_101_interpolations.json")
    path.unlink()


def actions(folder: Path) -> None:
    (folder / "a.csv").write_text(
        "narration_id,participant_id,video_id,narration_timestamp,start_timestamp,stop_timestamp,start_frame,"
        "stop_frame,narration,verb,verb_class,noun,noun_class,all_nouns,all_noun_classes\n"
        "P01_01_0,P01,P01_01,00:00:01.089,00:00:00.14,00:00:03.37,8,202,take cup,take,0,cup,13,['cup'],[13]\n"
    )


def archive_of_images(folder: Path) -> None:
    import io
    import tarfile

    with tarfile.open(folder / "P01_101.tar", "w") as archive:
        for n in range(1, 4):
            content = cv2.imencode(".jpg", np.full((16, 16, 3), n, np.uint8))[1].tobytes()
            member = tarfile.TarInfo(f"./frame_{n:010d}.jpg")
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))


def read_archive(folder: Path) -> None:
    Frames(folder, "P01_101")([1, 2, 3])


def images(folder: Path) -> None:
    for n, suffix in enumerate((".jpg", ".png")):
        cv2.imwrite(str(folder / f"{n}{suffix}"), np.full((16, 24, 3), n, np.uint8))


def read_footage(folder: Path) -> None:
    footage = tasks.open_footage(folder)
    assert footage.size
    for n in range(footage.frames):
        footage.jpeg(n)
        footage.image(n)
    footage.close()


def a_video(folder: Path) -> None:
    with av.open(str(folder / "a.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for n in range(6):
            image = np.full((48, 64, 3), 40 * n, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))


def read_video(folder: Path) -> None:
    video_info(folder / "a.mp4")
    list(video_frames(folder / "a.mp4", 1, 6))


def packed_dexycb(folder: Path) -> None:
    dexycb_files.write_models(folder / "ycb")
    (folder / "packed").mkdir()
    np.savez(folder / "packed" / "sequences.npz", **dexycb_files.packed())


def in_mano(write: Callable[[Path, Path], Any]) -> Callable[[Path], Any]:
    """A writer that needs MANO's files."""
    return lambda folder: write(folder, mano_folder())


def dexycb_views(folder: Path) -> None:
    beside = se3.rigid(se3.exp_so3(np.array([0.1, -1.2, 0.05])), np.array([0.65, 0.1, 0.4]))
    dexycb_files.write_extrinsics(dexycb_files.write_dexycb(folder), beside, np.eye(4))


def ho3d_views(folder: Path, mano_files: Path) -> None:
    root = write_ho3d(folder, mano_files)
    write_ho3d_calibration(root, "ABF1", {"2": np.eye(4), "0": se3.rigid(None, np.array([0.1, 0.0, 0.0]))})
    (root / "train" / "ABF10" / "meta").mkdir(parents=True)


def hoi4d(folder: Path, mano_files: Path) -> None:
    write_labels(write_hoi4d(folder, mano_files))


READERS: dict[str, Reader] = {
    "tracks": tracks(lambda folder: Tracks(root=folder / "one.npz"), motion_capture_files.write),
    "arctic": tracks(lambda folder: Arctic(root=folder / "data", mano=mano_folder()), in_mano(write_arctic)),
    "dexycb": tracks(lambda folder: DexYcb(root=folder), dexycb_files.write_dexycb),
    "dexycb views": tracks(lambda folder: DexYcb(root=folder, views="all"), dexycb_views),
    "dexycb packed": tracks(lambda folder: DexYcb(root=folder / "packed", meshes=folder / "ycb"), packed_dexycb),
    "ho3d": tracks(lambda folder: Ho3d(root=folder / "HO3D", mano=mano_folder()), in_mano(write_ho3d)),
    "ho3d views": tracks(lambda folder: Ho3d(root=folder / "HO3D", views=2), in_mano(ho3d_views)),
    "hocap": tracks(lambda folder: HoCap(root=folder / "HOCap", mano=mano_folder(), views="all"), in_mano(write_hocap)),
    "hrdexdb": tracks(lambda folder: HrDexDb(root=folder, mano=mano_folder(), views="all"), in_mano(write_hrdexdb)),
    "hoi4d": tracks(lambda folder: Hoi4d(root=folder / "HOI4D", mano=mano_folder()), in_mano(hoi4d)),
    "hot3d": tracks(lambda folder: Hot3d(root=folder), write_hot3d),
    "epic": Reader(epic, read_epic),
    "epic timelines": Reader(epic_timelines, read_epic_timelines),
    "visor": Reader(
        visor_zip, lambda folder: [list(visor.read_frames(path)) for path in visor.find_visor_files(folder)["P01_101"]]
    ),
    "actions": Reader(actions, lambda folder: read_actions([folder / "a.csv"])),
    "archive": Reader(archive_of_images, read_archive),
    "images": Reader(images, read_footage),
    "video": Reader(a_video, read_video),
    "footage": Reader(a_video, lambda folder: read_footage(folder / "a.mp4")),
}
"""By name."""
