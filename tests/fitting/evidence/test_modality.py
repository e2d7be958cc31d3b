"""A third modality is one class and one line, from a clip's folder to the terms and checks of its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.checks import Check, Evidence
from getagrip.clip import MODALITIES, Clip, Modality, input_sha256, read_clip, with_evidence, write_clip
from getagrip.errors import InputError
from getagrip.fitting.energy import Terms
from getagrip.fitting.energy.homan_terms import ReprojectionTerm
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem
from getagrip.fitting.stages.confidence import uncalibrated_reason
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.io import arrays, files
from getagrip.io.array_data import ArrayData
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from helpers.clips import small_clip
from helpers.scenes import SMALL, scene

SHIFT = 12.0
"""By which points lie beside the object [px]."""
QUICK = Options(inits=4, frames=4)


@dataclass(frozen=True, eq=False)
class Points(ArrayData):
    """Where a detector has seen the object's centre in each frame [px]."""

    uv: Float[ndarray, "T 2"]

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, index: Int[ndarray, "n"]) -> Points:
        return Points(self.uv[index])


def beyond_image(it: Evidence) -> float:
    points = it.clip.evidence.get("centres")
    return float(np.mean((points.uv < 0.0).any(axis=1))) if isinstance(points, Points) else float("nan")


class Centres(Modality[Points]):
    """The object's centre, in ``centres.npz``."""

    name = "centres"
    input_checks = (
        Check("centres-beyond", beyond_image, high=0.0, serious=False, fault="{value} are beyond", advice="look at it"),
    )

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return ["centres.npz"] if (folder / "centres.npz").exists() else []

    def read(self, clip: Clip) -> Points | None:
        assert clip.folder is not None
        if not self.files(clip.folder, clip.frames):
            return None
        path = files.inside(clip.folder, "centres.npz", "", "the object's centres")
        given = arrays.read(path, {"frames", "uv"}.__contains__)
        row = {name: n for n, name in enumerate(given["frames"].tolist())}
        lacking = next((name for name in clip.frames if name not in row), None)
        if lacking is not None:
            raise InputError(path, "frames", f"no {lacking}", "every frame of the clip")
        uv = arrays.floats(path, given, "uv", (len(row), 2))
        return Points(uv[[row[name] for name in clip.frames]])

    def write(self, clip: Clip, folder: Path) -> None:
        if (points := self.of(clip)) is not None:
            arrays.write(folder / "centres.npz", {"frames": np.array(clip.frames), "uv": points.uv})

    def terms(self, problem: Problem) -> Terms | None:
        points, crops = self.of(problem.clip), problem.observation.crops
        if points is None:
            return None
        target, centre = (points.uv - crops.corner) * crops.zoom, np.zeros((len(points), 1, 3))
        K = problem.observation.K
        return Terms(object=lambda level, at: [ReprojectionTerm(centre[at], K[at], target[at, None], 20.0, "centres")])


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(MODALITIES, "centres", Centres())  # the one line


def true_centres(clip: Clip) -> ndarray:
    assert clip.truth is not None
    return project(clip.K, se3.transform(clip.truth.T_cam_obj, clip.mesh.centre[None]))[:, 0]


def with_points(clip: Clip, uv: ndarray) -> Clip:
    return replace(clip, evidence={"centres": Points(uv)})


def test_its_data_goes_with_the_clip_into_folders_and_out_of_them(tmp_path: Path) -> None:
    clip, masks = small_clip(6)
    uv = np.random.default_rng(0).uniform(0.0, 20.0, (6, 2))
    clip = with_points(clip, uv)
    whole = read_clip(write_clip(clip, masks, tmp_path / "whole"))
    assert not whole.evidence
    some = np.array([4, 1])
    for taken in (clip.take(some), with_evidence(whole).take(some), with_evidence(whole.take(some))):
        assert taken.evidence["centres"] == Points(uv[some])
    part = read_clip(write_clip(whole.take(some[::-1]), None, tmp_path / "part"))
    assert with_evidence(replace(part, evidence={"object-masks": None})).evidence["centres"] == Points(uv[[1, 4]])
    assert not (tmp_path / "part" / "masks").exists()


def test_results_depend_on_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = small_clip()
    without, folder = write_clip(clip, masks, tmp_path / "one"), tmp_path / "two"
    write_clip(with_points(clip, np.ones((len(clip), 2))), masks, folder)
    assert not (without / "centres.npz").exists()
    one, two = input_sha256(without), input_sha256(folder)
    assert one != two
    monkeypatch.delitem(MODALITIES, "centres")
    assert input_sha256(folder) == one


def test_data_of_other_frames_is_refused() -> None:
    clip, _ = small_clip(3)
    with pytest.raises(Exception, match=r"Clip.evidence\['centres'\] must be 3 frames"):
        with_points(clip, np.ones((4, 2)))


def beside(result: Reconstruction, clip: Clip) -> ndarray:
    """How far the object's centre is from where it truly is, in each frame [px]."""
    T_cam_obj = clip.with_hand_at(result.T_cam_hand).hand.T_cam_hand @ result.T_hand_obj
    found = project(clip.K, se3.transform(T_cam_obj, result.scale * clip.mesh.centre[None]))[:, 0]
    return np.asarray(found - true_centres(clip))


@pytest.mark.slow
def test_its_terms_and_checks_count_in_every_frame(tmp_path: Path) -> None:
    clip, masks = scene("mug", 2, SMALL)
    uv = true_centres(clip) + np.array([SHIFT, 0.0])
    uv[-1] = -1.0
    folder = write_clip(with_points(clip, uv), masks, tmp_path / "clip")
    uv[-1] = true_centres(clip)[-1] + np.array([SHIFT, 0.0])
    in_memory = reconstruct(with_points(clip, uv), masks, QUICK)
    assert "centres" in in_memory.energy
    assert uncalibrated_reason(Options(), (), in_memory.energy) == "none is calibrated with the evidence centres"
    assert set(in_memory.frame_kind) == {"sampled", "fitted"}
    assert beside(in_memory, clip)[:, 0].min() > 0.5 * SHIFT
    assert in_memory.checks["centres-beyond"] == 0.0
    from_folder = reconstruct(read_clip(folder), options=QUICK)
    assert from_folder.checks["centres-beyond"] == 0.25
    assert [one.check for one in from_folder.findings if one.check.startswith("centres")] == ["centres-beyond"]
    ignored = reconstruct(replace(read_clip(folder), evidence={"centres": None}), masks, QUICK)
    assert uncalibrated_reason(Options(), (), ignored.energy) == ""
    assert np.abs(beside(ignored, clip)).max() < 0.5 * SHIFT
