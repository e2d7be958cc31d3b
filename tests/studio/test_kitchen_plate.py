"""A real egocentric clip labelled by hand: a plate is carried from a table. The labels are here, the video is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip.intrinsics import compute_intrinsics
from getagrip.geometry import se3
from getagrip.geometry.camera import Lens, project
from getagrip.geometry.mesh_files import write_mesh
from getagrip.hands.from_2d.clicks import hands_from_clicks
from getagrip.readers.footage import VideoFootage
from getagrip.studio.store import labels
from getagrip.studio.store.export_clip import write_labelled_clip_files
from getagrip.studio.store.labels import OBJECT_LABEL
from getagrip.synthetic.objects import plate
from helpers.environment import DATA, ROOT, Run, needs

LABELS = ROOT / "tests" / "helpers" / "kitchen_plate_labels.json"
VIDEO = DATA / "egocentric" / "kitchen_plate.mp4"


@pytest.mark.slow
def test_the_labels_are_of_one_hand_and_one_plate() -> None:
    given = labels.read_label_file(LABELS)
    K, _ = compute_intrinsics(Lens(guess_focal=True), given.size)
    found = hands_from_clicks(given.clicks, K, given.side, given.first, given.last)
    assert np.sqrt(np.nanmean(found.residuals**2)) < 4.0
    assert not found.outliers.any()
    assert np.abs(found.shape).max() < 0.25
    assert found.hand.joints is not None
    tips = project(K, se3.transform(found.hand.T_cam_hand, found.hand.joints))[:, 4]
    outlines = given.label_maps()
    assert sorted(outlines) == sorted(given.frames)
    for n, drawn in outlines.items():  # the thumb lies on the rim
        v, u = np.nonzero(drawn == OBJECT_LABEL)
        to_plate = np.hypot(u + 0.5 - tips[n - given.first, 0], v + 0.5 - tips[n - given.first, 1]).min()
        assert to_plate < 0.1 * np.ptp(u)


@needs(VIDEO)
@pytest.mark.slow
@pytest.mark.long
def test_from_video_to_reconstruction(tmp_path: Path, run: Run) -> None:
    whole = labels.read_label_file(LABELS)
    first, last = 51, 57  # a part of it, for the sake of time
    frames = {n: frame for n, frame in whole.frames.items() if first <= n <= last}
    given = replace(whole, first=first, last=last, frames=frames)
    video = VideoFootage(VIDEO)
    try:
        made = write_labelled_clip_files(given, video.image, Lens(), tmp_path / "made")
    finally:
        video.close()
    assert min(made.confidence.values()) > 0.85
    write_mesh(plate(), tmp_path / "plate.obj")
    words = made.command.split()[1:]
    words[words.index(given.video)] = str(VIDEO)
    words[words.index("MESH")], words[words.index("CLIP")] = str(tmp_path / "plate.obj"), str(tmp_path / "carried")
    status, _, err = run(*words)
    assert status == 0
    assert err.count("a guess") == 2
    assert run("reconstruct", tmp_path / "carried", "--out", tmp_path / "results", "--inits", 8)[0] == 0
    result = json.loads((tmp_path / "results" / "carried" / "result.json").read_text())
    with np.load(tmp_path / "results" / "carried" / "result.npz") as file:
        assert file["iou"].mean() > 0.93
        assert file["iou"].min() > 0.85
        diameter = 2.0 * 0.11 * float(file["scale"])
    assert 0.17 < diameter < 0.32  # plates are; the hand's size and the camera are guesses
    assert len(result["assumptions"]) >= 3  # camera, hands, size
