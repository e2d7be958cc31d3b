"""E_mask on the silhouettes of DEODR (de La Gorce, Paragios and Fleet, PAMI 2011), as a term of the energy.

Used as leanly as its interface allows: one colour channel, no light, no texture, arguments unchecked, and what does not
change made once.
"""

from __future__ import annotations

import numpy as np
from deodr import Scene2D, TriMesh  # type: ignore[import-untyped]
from deodr.differentiable_renderer import renderScene, renderSceneB  # type: ignore[import-untyped]
from jaxtyping import Float
from numpy import ndarray

from benchmarks.problem import Problem
from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.fitting.observation import CROP
from getagrip.geometry import se3
from getagrip.kernels.silhouette import unpack

SOFT = 1.0
"""Width of the antialiased silhouette edges [px]: what makes DEODR's pixels differentiable."""


class DeodrTerm:
    """Squared difference of DEODR's antialiased mask and the observed one over pixels that count, at 256 pixels."""

    name = "deodr"

    def __init__(self, problem: Problem) -> None:
        mesh, observation = problem.clip.mesh, problem.observation
        self.vertices = mesh.vertices - problem.centre
        self.K = observation.K
        self.observed = unpack(observation.observed[CROP], CROP).astype(float)
        self.valid = unpack(observation.valid[CROP], CROP).astype(float)
        self.topology = TriMesh(mesh.faces, self.vertices)  # outward faces, in an image whose y points down
        V, F = len(mesh.vertices), len(mesh.faces)
        faces = mesh.faces.astype(np.uint32)
        self.scene = Scene2D(
            faces=faces, faces_uv=faces, ij=np.zeros((V, 2)), depths=np.zeros(V), textured=np.zeros(F, bool),
            uv=np.zeros((V, 2)), shade=np.zeros(V), colors=np.ones((V, 1)), shaded=np.zeros(F, bool),
            edgeflags=np.zeros((F, 3), bool), height=CROP, width=CROP, nb_colors=1, texture=np.zeros((0, 0)),
            background_color=np.zeros(1), backface_culling=True, integer_pixel_centers=False,
        )  # fmt: skip

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        B, N = poses.centre.shape[:2]
        value, g = np.zeros((B, N)), np.zeros((B, N, 7))
        for b in range(B):
            for n in range(N):
                arm = poses.scale[b] * self.vertices @ poses.R[b, n].T
                value[b, n], g[b, n] = self._frame(n, arm, poses.centre[b, n])
        return Quadratic(value, g, np.zeros((B, N, 7, 7)))

    def _frame(
        self, n: int, arm: Float[ndarray, "V 3"], centre: Float[ndarray, "3"]
    ) -> tuple[float, Float[ndarray, "7"]]:
        """Energy of a frame and its gradient by the local 7-vector; ``arm`` leads from the centre to vertices."""
        x, y, z = (arm + centre).T
        fx, fy, cx, cy = self.K[n]
        scene, image, depth = self.scene, np.empty((CROP, CROP, 1)), np.empty((CROP, CROP))
        scene.ij, scene.depths = np.stack([fx * x / z + cx, fy * y / z + cy], axis=1), z.copy()
        scene.edgeflags = np.asarray(self.topology.edge_on_silhouette(scene.ij))
        scene.clear_gradients()
        renderScene(scene, SOFT, image, depth, check_valid=False)
        wrong = self.valid[n] * (image[..., 0] - self.observed[n])
        value = float(np.vdot(wrong, wrong))
        renderSceneB(scene, SOFT, image, depth, 2.0 * wrong[..., None], check_valid=False)
        u, v = scene.ij_b.T
        by_vertex = np.stack([u * fx / z, v * fy / z, -(u * fx * x + v * fy * y) / z**2], axis=1)
        turn = np.cross(arm, by_vertex).sum(axis=0)
        return value, np.concatenate([by_vertex.sum(axis=0), turn, [np.vdot(arm, by_vertex)]])


def agreement(term: DeodrTerm, poses: PosesInCamera) -> float:
    """Cosine between the term's gradient and central differences of its own value, all frames together.

    Edge flags of the wrong orientation silently leave a gradient near zero; this check finds them.
    """
    unit = np.array([1e-4] * 3 + [1e-3] * 4)  # the 7-vector's steps: 0.1 mm, 1 mrad, 0.1 %
    bound = np.full(1, np.inf)
    differences = np.zeros((poses.centre.shape[1], 7))
    for k in range(7):
        d = unit[k] * np.eye(7)[k]
        ahead, behind = (
            PosesInCamera(se3.exp_so3(s * d[3:6]) @ poses.R, poses.centre + s * d[:3], poses.scale * np.exp(s * d[6]))
            for s in (1.0, -1.0)
        )
        differences[:, k] = (term(ahead, bound).value - term(behind, bound).value)[0] / 2.0
    given = term(poses, bound).g[0] * unit
    return float(np.vdot(given, differences) / (np.linalg.norm(given) * np.linalg.norm(differences)))
