"""Mesh fit: the shape of an object that has only a template mesh, from the silhouettes of all frames.

A template mesh leaves contours that no pose explains, and the search ends at a pose whose wrong contours are a little
better. So after the coarse stages the mesh may be warped: stretched, sheared, tapered and bent (``Warp``), by the same
E_mask as the poses, under a prior. The masks tell whether the mesh is the object's own: if so, they are explained
already, or, where masks or hands are off, another shape explains them hardly better.

Where the mesh is not fitted, the motion gets stiffer with the misfit: how much worse the masks are explained than by
the object's own mesh. Else deviations would bend the motion to fit contours that no pose explains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip import least_squares
from getagrip.fitting.energy import PosesInCamera
from getagrip.fitting.energy.in_view import jacobian_in_view, poses_in_view
from getagrip.fitting.energy.mask import Observation
from getagrip.fitting.energy.mesh_mask import N_SHAPE_PARAMETERS, MaskByShape
from getagrip.fitting.motion import Fixed, Soft
from getagrip.fitting.objective import MASK_STEP_PX, MIN_CURVATURE_DISTANCE_PX, all_masks_energy
from getagrip.fitting.problem import Problem
from getagrip.fitting.solver.category_prior import unmeasured_kind
from getagrip.fitting.solver.solve import CURVATURE_FLOOR, jacobian_in_camera, minimise, poses_in_camera
from getagrip.geometry.profile import Profile
from getagrip.geometry.warp import Warp, remove_similarity
from getagrip.least_squares import BlockArrow

IMAGE_CONTOUR_ERROR_PX, CROP_CONTOUR_ERROR_PX = 0.4, 0.15
"""Mean distance between the contours of the object's own mesh and of a mask: pixels of the image, plus pixels of the
crop. Right grasps of DexYCB's training subjects have 0.4 to 0.75 times as much (docs/trials.md)."""
STIFFNESS_EXPONENT = 3.0
"""Power of the misfit that stiffness is multiplied by; 4 was too stiff for measured motions."""
MIN_MESH_MISFIT = 1.2
"""Misfit (``relative_contour_error``) from which on a mesh is fitted."""
MAX_SHAPE_ENERGY_RATIO = 0.85
"""Maximum energy of a fitted shape, in that of the input mesh, which else stays. On 26 training clips of DexYCB, under
each of four errors of hands, masks and size, at most one own mesh met this condition and the one on the misfit."""
MIN_DEFORMATION_DIAMETERS = 0.008
"""Minimum displacement of a fitted shape [diameters]: below it a better pose explains the masks, and not the shape. Of
111 other objects on training clips the fitted shape of 5 was below it."""
SHAPE_FIT_LEVEL_PX, MAX_SHAPE_ITERATIONS = 128, 12
"""Resolution [px] and maximum number of iterations of the fit."""
STRETCH_SIGMA, BEND_SIGMA = 0.1, 0.05
"""Standard deviations of the prior, of stretches and of all other modes, as displacements at half a diameter from the
middle [half diameters]."""
WIDTH_SIGMA, WIDTH_BEND_SIGMA = 0.15, 0.15
"""Standard deviations of the prior on a profile: of the logarithm of each radius over the built-in shape's, and of that
logarithm's second difference along the axis."""
SHAPE_PRIOR_WEIGHT = 5.0
"""Energy of one standard deviation in each frame, times 1/2 [px^2]. Between 2 and 20 little changes; 200 is too stiff.
"""
MIN_WARP_EXPANSION = 0.1
"""Minimum factor on volumes: a warp that shrinks a part of space further, or turns it inside out, is no shape."""
KNOWN_SIZE_STIFFNESS = 100.0
"""Factor on the prior's stiffness of the object's size, the mean of the three stretches, where the size is known."""


M = TypeVar("M", float, Float[ndarray, "B"])


def relative_contour_error(observation: Observation, mask: M) -> M:
    """Compute the misfit: mean distance of contours from the masks', as a multiple of the object's own mesh's.

    ``mask`` is the mean E_mask of a frame [px^2 of the crop], of one hypothesis or of each: the mean distance times the
    visible length.
    """
    length = float(observation.targets[..., 4].sum(axis=1).mean())
    expected = IMAGE_CONTOUR_ERROR_PX * observation.crops.zoom + CROP_CONTOUR_ERROR_PX
    return mask / (length * expected) if length > 0.0 else mask * 0.0 + 1.0


def stiffen_ridge(ridge: tuple[float, float], times: float) -> tuple[float, float]:
    """Return the stiffness of deviations at a misfit of ``times``; unchanged up to 1."""
    factor = float(np.maximum(times, 1.0) ** STIFFNESS_EXPONENT)
    return ridge[0] * factor, ridge[1] * factor


def _deformation_modes() -> Float[ndarray, "24 27"]:
    """Build the displacements without rotations: by symmetric matrices, and by second-degree monomials per axis."""
    modes = []
    for i in range(3):
        for j in range(i, 3):
            linear = np.zeros((9, 3))
            linear[i, j] = linear[j, i] = 1.0
            modes.append(linear.ravel())
    return np.array([*modes, *np.eye(N_SHAPE_PARAMETERS)[9:]])


DEFORMATION_MODES = _deformation_modes()
STRETCH_MODES = np.flatnonzero(DEFORMATION_MODES[:, [0, 4, 8]].any(axis=1))
"""The modes that stretch along x, y and z."""


@dataclass(frozen=True)
class _ShapeInView:
    """E_mask of a further view by pose and shape, in the frames ``at``, by ``T_view_cam`` in these."""

    term: MaskByShape
    at: Int[ndarray, "n"]
    T: Float[ndarray, "n 4 4"]

    def __call__(
        self, poses: PosesInCamera, shape: Float[ndarray, "B 9 3"], widths: Float[ndarray, "B k"]
    ) -> tuple[Float[ndarray, "B n"], Float[ndarray, "B n P"], Float[ndarray, "B n P P"]]:
        value, g, H = self.term(poses_in_view(poses, self.at, self.T), shape, widths)
        J = jacobian_in_view(self.T, g.shape[-1])
        Jt = np.swapaxes(J, 1, 2)
        return value, (Jt @ g[..., None])[..., 0], Jt @ H @ J


@dataclass
class _ShapeState:
    """Hypotheses with a shape each (``least_squares.State``)."""

    motion: Soft[Fixed]
    weights: Float[ndarray, "B M"]
    """Weights of the modes of the warp; then, of a body of revolution, the logarithms of the factors on its radii."""
    term: MaskByShape
    views: tuple[_ShapeInView, ...]
    stiffness: Float[ndarray, "M M"]
    T_cam_hand: Float[ndarray, "N 4 4"]

    def __post_init__(self) -> None:
        warps, widths = np.split(self.weights, [len(DEFORMATION_MODES)], axis=1)
        shapes = (warps @ DEFORMATION_MODES).reshape(-1, 9, 3)
        poses = poses_in_camera(self.motion, self.T_cam_hand)
        value, g, H = self.term(poses, shapes, widths)
        for view in self.views:
            for total, part in zip((value, g, H), view(poses, shapes, widths), strict=True):
                total[:, view.at] += part
        by = _block_diagonal(np.eye(7), DEFORMATION_MODES, np.eye(self.term.radii))
        self.g, self.H = g @ by.T, by @ H @ by.T
        self.pull = self.weights @ self.stiffness
        prior = self.motion.prior().value + 0.5 * np.sum(self.pull * self.weights, axis=1)
        self._cost = value.sum(axis=1) + prior

    @property
    def cost(self) -> Float[ndarray, "B"]:
        return self._cost

    def trial(self, active: Int[ndarray, "n"], damping: Float[ndarray, "n"]) -> _ShapeState:
        motion, weights = self.motion.take(active), self.weights[active]
        J_shared, J_local = motion.jacobian()
        B, N, _, S = J_shared.shape
        M, L, prior = weights.shape[1], J_local.shape[-1], motion.prior()
        seen = jacobian_in_camera(J_shared, J_local, self.T_cam_hand)
        J = np.zeros((B, N, 7 + M, S + M + L))
        J[..., :7, :S], J[..., 7:, S : S + M], J[..., :7, S + M :] = seen[..., :S], np.eye(M), seen[..., S:]
        Jt = np.swapaxes(J, -1, -2)
        A, b = Jt @ self.H[active] @ J, (Jt @ self.g[active][..., None])[..., 0]
        of_shape = np.pad(self.stiffness, (S, 0)), np.pad(self.pull[active], ((0, 0), (S, 0)))
        arrow = BlockArrow.of(A, b, slice(S + M), slice(S + M, None)).plus(*of_shape, prior.H, prior.g)
        step, per_frame = arrow.step(damping, CURVATURE_FLOOR)
        return replace(self, motion=motion.retract(step[:, :S], per_frame), weights=weights + step[:, S:])

    def accept(self, trial: _ShapeState, active: Int[ndarray, "n"], better: Bool[ndarray, "n"]) -> _ShapeState:
        position, accepted = np.zeros(len(self.cost), int), np.zeros(len(self.cost), bool)
        position[active], accepted[active[better]] = np.arange(len(active)), True
        self.motion = trial.motion.take(position).where(accepted, self.motion)
        for mine, theirs in zip(self._arrays(), trial._arrays(), strict=True):
            mine[active[better]] = theirs[better]
        return self

    def _arrays(self) -> tuple[ndarray, ...]:
        return self.weights, self.g, self.H, self.pull, self._cost


def fit_shape(problem: Problem, motion: Soft[Fixed], index: Int[ndarray, "n"], misfit: float) -> Warp | None:
    """Fit the mesh to the masks, from hypotheses in some frames of the problem, at the misfit of the best.

    None where the mesh stays unchanged.
    """
    if misfit < MIN_MESH_MISFIT:
        return None
    mesh, coarse, radius = problem.clip.mesh, problem.surface.coarse, problem.surface.diameter / 2.0
    level = SHAPE_FIT_LEVEL_PX
    kind = unmeasured_kind(problem.clip)
    stretch = STRETCH_SIGMA if kind is None or kind.stretch is None else kind.stretch
    bend = BEND_SIGMA if kind is None or kind.bend is None else kind.bend
    T_cam_hand = problem.clip.hand.T_cam_hand[index]
    stiffness = _shape_stiffness(stretch, bend, problem.clip.scale == "known")
    revolved = kind is not None and kind.revolved and "profile" not in problem.options.without
    body = Profile.of(mesh) if revolved else None
    if body is not None:
        stiffness = _block_diagonal(stiffness, profile_stiffness(len(body.before)))
    stiffness *= len(index)

    def by_shape(observation: Observation) -> MaskByShape:
        seen = observation, level, MASK_STEP_PX[level], MIN_CURVATURE_DISTANCE_PX[level]
        return MaskByShape(coarse, mesh.centre, radius, *seen, body)

    views = []
    for view in problem.views:
        at = np.flatnonzero(np.isin(index, view.rows))
        own = np.searchsorted(view.rows, index[at])
        views.append(_ShapeInView(by_shape(view.observation.take(own)), at, view.T_view_cam[own]))
    own_view = by_shape(problem.observation.take(index))
    undeformed = minimise(motion, all_masks_energy(problem)(level, index), T_cam_hand, MAX_SHAPE_ITERATIONS)
    start = np.zeros((len(undeformed.energy), len(stiffness)))
    begun = _ShapeState(undeformed.motion, start, own_view, tuple(views), stiffness, T_cam_hand)
    warped = least_squares.minimise(begun, MAX_SHAPE_ITERATIONS).state
    best = int(warped.cost.argmin())
    if not warped.cost[best] < MAX_SHAPE_ENERGY_RATIO * undeformed.energy.min():
        return None
    warps, widths = np.split(warped.weights[best], [len(DEFORMATION_MODES)])
    warp = own_view.warp((warps @ DEFORMATION_MODES).reshape(9, 3), widths)
    if warp.expansion(mesh.vertices).min() < MIN_WARP_EXPANSION:
        return None
    shape = remove_similarity(warp, mesh, resize=problem.clip.scale == "free")[0]
    return shape if shape.displacement(mesh) > MIN_DEFORMATION_DIAMETERS * mesh.diameter else None


def _block_diagonal(*blocks: Float[ndarray, "_ _"]) -> Float[ndarray, "m n"]:
    """Return the matrix with these blocks along its diagonal, and zeros outside them."""
    out = np.zeros(np.sum([block.shape for block in blocks], axis=0))
    row = column = 0
    for block in blocks:
        out[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return out


def profile_stiffness(radii: int) -> Float[ndarray, "k k"]:
    """Return the stiffness of the logarithms of a profile's radii in each frame [px^2]."""
    bend = np.diff(np.eye(radii), 2, axis=0)
    return SHAPE_PRIOR_WEIGHT * (np.eye(radii) / WIDTH_SIGMA**2 + bend.T @ bend / WIDTH_BEND_SIGMA**2)


def _shape_stiffness(stretch: float, bend: float, size_known: bool) -> Float[ndarray, "24 24"]:
    """Return the stiffness of the modes in each frame [px^2]."""
    deviation = np.full(len(DEFORMATION_MODES), bend)
    deviation[STRETCH_MODES] = stretch
    stiffness = np.diag(SHAPE_PRIOR_WEIGHT / deviation**2)
    if size_known:
        stiffness[np.ix_(STRETCH_MODES, STRETCH_MODES)] += KNOWN_SIZE_STIFFNESS * SHAPE_PRIOR_WEIGHT / stretch**2 / 9.0
    return stiffness
