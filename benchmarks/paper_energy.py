"""Compare interpretations of the paper's push and pull with its Table 5: ``python -m benchmarks.paper_energy``.

Push and pull are printed in millimetres, as a sum over the object's vertices. Each reading is fitted by the paper's
1-DoF at the weights of Table 5, on training clips made for it: a mean shape of unknown size, hands as an estimator has
them, at HaMeR's focal length, from six grasps of the category: ``results/paper-energy.json``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

from benchmarks import store
from benchmarks.timing import circumstances
from getagrip.cli.reproduce.epic_grasps import VISOR_FOCAL_PX
from getagrip.cli.reproduce.paper_tables import published
from getagrip.clip import Clip, with_masks
from getagrip.fitting.energy.paper_contact import TangentPlanes
from getagrip.fitting.methods import paper
from getagrip.fitting.objective import mask_energy, sum_energies
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.solver.solve import poses_in_camera
from getagrip.geometry import se3
from getagrip.synthetic.categories import SPLIT_SEEDS, clips_of_split
from getagrip.synthetic.noise import NOISE_PRESETS
from getagrip.synthetic.scene import make_scene, synthesise
from getagrip.synthetic.scene_options import SceneOptions

STARTS = 6
"""Number of initial poses, about as in the authors' files for a category and side."""
EACH = 2
"""Number of clips of each category."""
PAPER = {0.0: "0", 0.1: "0.1", 1.0: "1"}
"""Labels of rows of Table 5, by weight."""
COLUMNS = (
    store.Column("iou", "IOU", "%", 1),
    store.Column("lost", "less than without push and pull", "points", 1),
    store.Column("scale", "median scale / true scale", "", 2),
    store.Column("push_of_three", "push of three nearest / of one", "", 2),
)


@dataclass(frozen=True)
class Reading:
    """An interpretation: factors on the printed weights of push and pull."""

    unit: float = 1.0
    """1 for metres, 1000 for millimetres."""
    mean: bool = False
    """True where push is a mean over the object's vertices."""
    by_area: bool = False
    """True where E_mask is divided by the mask's area, as in the authors' later code."""

    def weights(self, problem: Problem, weight: float) -> tuple[Float[ndarray, "N"], Float[ndarray, "N"]]:
        """Return the weight of push and of pull in each frame [px^2 / m]."""
        pull = weight * self.unit * problem.observation.K[:, 0]
        pull = pull * problem.observation.area if self.by_area else pull
        return pull / (len(problem.surface.coarse.vertices) if self.mean else 1), pull


READINGS = {
    "metres, sum": Reading(),
    "metres, mean": Reading(mean=True),
    "metres, mean, E_mask divided by the area": Reading(mean=True, by_area=True),
    "millimetres, sum": Reading(unit=1e3),
}


def problems() -> Iterator[Problem]:
    """Make the clips."""
    epic = published()["Table 3"]["groups"]["1-DoF"]
    for category, seed, options in clips_of_split("train", "measured"):
        if category in epic and seed in SPLIT_SEEDS["train"][:EACH]:
            clip, masks = synthesise(category, seed, replace(options, **asdict(NOISE_PRESETS["estimated"])))
            starts = grasps(category, options)
            problem = prepare_problem(
                with_masks(seen_from_afar(clip), masks), Options(method="paper", inits=len(starts))
            )
            yield replace(problem, prior_poses=starts)


def grasps(category: str, options: SceneOptions) -> Float[ndarray, "k 4 4"]:
    """Return poses of the object in the hand, from the middle frames of other clips of the category."""
    found = []
    for seed in range(STARTS):
        truth = make_scene(category, SPLIT_SEEDS["train"].stop + seed, replace(options, grip_deg=12.0)).clip.truth
        assert truth is not None
        found.append((se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj)[len(truth.T_cam_obj) // 2])
    return np.stack(found)


def seen_from_afar(clip: Clip) -> Clip:
    """Move the hand to the distance of an estimator with HaMeR's focal length; its image keeps its size."""
    T, K = clip.hand.T_cam_hand.copy(), clip.K.copy()
    T[:, 2, 3] *= VISOR_FOCAL_PX / K[:, 0, 0]
    K[:, [0, 1], [0, 1]] = VISOR_FOCAL_PX
    return replace(clip.with_hand_at(T), K=K)


def fitted(problem: Problem, reading: Reading, weight: float) -> MethodResult:
    """Fit the paper's 1-DoF by a reading of its energy."""
    energy = mask_energy(problem)
    if weight:
        push, pull = reading.weights(problem, weight)
        energy = sum_energies(energy, paper.paper_push_of(problem, push), paper.paper_pull_of(problem, pull))
    return paper.hinge(problem, lambda _: None, energy)


def measured(problem: Problem, found: MethodResult) -> Mapping[str, float]:
    """Measure a result: IOU in the crops, scale, and push by the three nearest contact vertices."""
    assert found.motion is not None
    assert problem.clip.truth is not None
    poses = poses_in_camera(found.motion, problem.clip.hand.T_cam_hand)
    mesh, planes = problem.surface.coarse, TangentPlanes.of(problem.clip.hand)
    push = np.zeros(2)
    for n, (R, centre) in enumerate(zip(poses.R[0], poses.centre[0], strict=True)):
        x = poses.scale[0] * (mesh.vertices - problem.clip.mesh.centre) @ R.T + centre
        nearest = cKDTree(planes.point[n].T).query(x, k=3)[1]
        heights = np.sum((x[:, None] - planes.point[n].T[nearest]) * planes.normal[n].T[nearest], axis=-1)
        push -= np.minimum([heights[:, 0], heights.mean(axis=1)], 0.0).sum(axis=1)
    return {
        "iou": 100.0 * paper.crop_iou(problem, poses)[0],
        "scale": poses.scale[0] / problem.clip.truth.scale,
        "push": push[0],
        "push of three": push[1],
    }


def main() -> None:
    """Fit all readings, and write the table."""
    found: dict[tuple[str, float], list[Mapping[str, float]]] = {}
    for problem in problems():
        for name, reading in READINGS.items():
            for weight in PAPER:
                if weight or name == next(iter(READINGS)):  # without push and pull, all readings are equal
                    found.setdefault((name, weight), []).append(measured(problem, fitted(problem, reading, weight)))
        print(problem.clip.name, flush=True)
    printed = published()["Table 5"]["groups"]["1-DoF"]
    rows: list[store.Row] = [
        {"label": f"the paper's Table 5, weight {text}", "iou": printed[text][0],
         "lost": round(printed["0"][0] - printed[text][0], 1)}
        for text in PAPER.values()
    ]  # fmt: skip
    (nothing,) = (np.mean([one["iou"] for one in of]) for (_, weight), of in found.items() if not weight)
    for (name, weight), of in found.items():
        iou, push, three = (float(np.mean([one[key] for one in of])) for key in ("iou", "push", "push of three"))
        rows.append(
            {"label": f"{name}, weight {PAPER[weight]}", "iou": round(iou, 1), "lost": round(nothing - iou, 1),
             "scale": round(float(np.median([one["scale"] for one in of])), 2), "push_of_three": round(three / push, 2)}
        )  # fmt: skip
    clips = f"{len(of)} synthetic training clips of {len(of) // EACH} categories"
    about = f"{clips}; {paper.PAPER_ITERATIONS} iterations of Adam"
    title = "Readings of the paper's push and pull beside its Table 5"
    made = circumstances("python -m benchmarks.paper_energy")
    print(store.write("paper-energy", store.Table(title, made, COLUMNS, rows, notes=(about,))))


if __name__ == "__main__":
    main()
