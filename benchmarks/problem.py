"""What is reconstructed: synthetic clips, and how good an answer is."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.mask import MaskTerm, SilhouetteMesh
from getagrip.fitting.observation import Observation, observe
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries
from getagrip.result import Reconstruction
from getagrip.timelines.reconstruct import reconstruct

CLIPS = (("mug", 0), ("pan", 0), ("kettle", 0), ("scissors", 0))
"""Category and seed: a hollow object with a handle, a large one, one of several parts, a thin one."""


DEFAULT = Options()


@dataclass(frozen=True)
class Problem:
    """A clip of known scale, its masks, and what the mask term reads of them."""

    clip: Clip
    masks: Masks
    observation: Observation

    @property
    def centre(self) -> Float[ndarray, "3"]:
        return self.clip.mesh.centre

    def mask_term(self, level: int, step: float = 2.0) -> MaskTerm:
        """E_mask of the whole mesh, not decimated."""
        return MaskTerm(SilhouetteMesh.of(self.clip.mesh, self.centre), self.observation, level, step=step)

    def in_camera(self, T_hand_obj: Float[ndarray, "T 4 4"]) -> PosesInCamera:
        """A sequence of poses as the terms read it."""
        T = self.clip.hand.T_cam_hand @ T_hand_obj
        return PosesInCamera(T[None, :, :3, :3], se3.transform(T, self.centre[None])[None, :, 0], np.ones(1))

    def energy(self, T_hand_obj: Float[ndarray, "T 4 4"]) -> float:
        """Exact E_mask at 256 pixels [px per frame]."""
        poses = self.in_camera(T_hand_obj)
        return float(self.mask_term(256)(poses, no_bound(poses)).value.mean())

    def add(self, T_hand_obj: Float[ndarray, "T 4 4"]) -> float:
        """ADD up to the object's symmetries, as a share of its diameter."""
        clip, truth = self.clip, self.clip.truth
        assert truth is not None
        true = ObjectTrack(se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj, truth.scale)
        found = ObjectTrack(T_hand_obj, 1.0)
        symmetry = best_symmetry(clip.mesh, found, true, find_symmetries(clip.mesh))
        return float(pose_errors(clip.mesh, found, true, symmetry).add.mean()) / clip.mesh.diameter


def make(category: str, seed: int) -> Problem:
    """A synthetic clip of 30 frames."""
    clip, masks = synthesise(category, seed)
    return Problem(clip, masks, observe(masks, clip.K))


def reconstruction(clip: Clip, masks: Masks, options: Options = DEFAULT) -> Callable[[], Reconstruction]:
    """A call that reconstructs the clip as if it had just been read: meshes keep their tables, a new one has none.

    The ``seconds`` of its results are processor time.
    """

    def call() -> Reconstruction:
        marks = [("start", time.process_time())]
        new = replace(clip, mesh=Mesh(clip.mesh.vertices, clip.mesh.faces))
        result = reconstruct(new, masks, options, lambda stage, _: marks.append((stage, time.process_time())))
        return replace(result, seconds={stage: now - before for (_, before), (stage, now) in pairwise(marks)})

    return call
