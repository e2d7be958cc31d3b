"""The input and output of every method: a clip prepared for fitting, and the poses found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.checks.evidence import TextureVote
from getagrip.clip import (
    Clip,
    Masks,
    masks_in_memory,
    modalities,
    observed_frames,
    read_masks,
    read_observed,
    with_evidence,
    with_masks,
)
from getagrip.clip.masks import occluded_by_hand
from getagrip.clip.views import View, rows_in_view, views_of, without_views
from getagrip.fitting.energy import Energy, Terms
from getagrip.fitting.energy.contact import CONTACT_GRID_MARGIN_M, HandContacts, build_contact_grid, rms_distances
from getagrip.fitting.energy.mask import GAP_SHARE, Observation, SilhouetteMesh, masks_leave_gaps, observe_masks
from getagrip.fitting.evidence.epipolar import contradicting_views
from getagrip.fitting.hand.hand_error_model import SolvedHand, interpolate_solved_hand
from getagrip.fitting.hand.refine_hand import HandRefinement, refine_hand
from getagrip.fitting.motion import Motion, PosesInHand
from getagrip.fitting.options import FREE_SCALE_START_FACTOR, Options
from getagrip.fitting.solver import initial_poses
from getagrip.geometry import se3
from getagrip.geometry.handles import find_handle, spread_along
from getagrip.geometry.kernels.closest import FaceGrid
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.geometry.warp import Warp
from getagrip.io.terminal import format_count
from getagrip.provenance import assumptions, is_assumed, kind_of_hands
from getagrip.result import Axis, Status

MAX_COARSE_FACES, MAX_FINE_FACES = 1000, 4000
"""Maximum number of faces for contact and silhouettes of 64 and 128 pixels, and of 256; larger meshes are decimated."""
N_REGION_CONTACTS = {64: 8, 128: None, 256: None}
"""Number of vertices of each contact region in use at each level; None: all."""
N_SURFACE_POINTS = 48
"""Number of surface points that distances between poses are averaged over."""
HALF_TURN_DISTANCE_RANGE = (0.003, 0.06)
"""Distance that a half turn about a principal axis moves a nearly symmetric surface [diameters]: less is not visible,
and after more the turned fit is no copy (``search.DUPLICATE_DISTANCE_DIAMETERS``)."""
REVOLVED_BY_RAD, MAX_REVOLVED_DISTANCE = 1.0, 0.025
"""Turn about the axis of a body of revolution, and how far it may move the surface at most [diameters]: three of YCB's
cans 0.007 to 0.020, a bottle 0.037."""
HALF_TURN_TOLERANCE_RAD = np.radians(30.0)
"""Maximum deviation from half a turn between fits of an object both ways round."""
FITTED_MESH_CONTACT_FACTOR = 4.0
"""Factor on the weight of contact where the mesh is fitted. The masks then tell size and distance less well, and the
hand determines them better."""
MAX_PULL_DISTANCE_M, FITTED_PULL_DISTANCE_M = 0.01, CONTACT_GRID_MARGIN_M
"""Maximum distance at which a finger is pulled to the object, and the same for a fitted mesh, which may be that much
nearer or farther than the object [m]; a finger beyond is taken to hold nothing."""
LIFTED_HAND_COUPLING_FACTOR = 0.2
"""Factor on the terms that couple the object to the hand's motion where the hand's size is assumed: hands lifted from
2D turn and move by ten degrees and a centimetre where the true ones rest. Chosen on the phone videos of docs/draft.md.
"""


@dataclass(frozen=True)
class ObjectSurface:
    """The surface of a rigid object, by which the search measures distances between poses.

    Attributes:
        mesh: the mesh.
        coarse: the mesh, decimated for contact and the coarser levels.
        solid: its surface about the centre of the input mesh.
        points: (P, 3) points of the surface, about that centre.
        axes: (3, 3) principal axes of the vertices, one a row.
        diameter: of the mesh [m].
    """

    mesh: Mesh
    coarse: Mesh
    solid: FaceGrid
    points: Float[ndarray, "P 3"]
    axes: Float[ndarray, "3 3"]
    diameter: float

    @staticmethod
    def of(mesh: Mesh) -> ObjectSurface:
        """Sample the surface of a mesh, about ``mesh.centre``."""
        coarse = decimate(mesh, MAX_COARSE_FACES)
        about = mesh.vertices - mesh.centre
        _, axes = np.linalg.eigh(np.cov(about.T))
        spread = np.linspace(0, len(about) - 1, min(N_SURFACE_POINTS, len(about))).round().astype(int)
        return ObjectSurface(
            mesh, coarse, build_contact_grid(coarse, mesh.centre), about[spread], axes.T, mesh.diameter
        )

    @cached_property
    def silhouettes(self) -> dict[int, SilhouetteMesh]:
        """Tables of the mesh for silhouettes, at each level of pixels."""
        coarse = SilhouetteMesh.of(self.coarse, self.mesh.centre)
        return {64: coarse, 128: coarse, 256: SilhouetteMesh.of(decimate(self.mesh, MAX_FINE_FACES), self.mesh.centre)}

    @cached_property
    def handle(self) -> Float[ndarray, "P 3"] | None:
        """Points of the handle's middle line about the centre of the input mesh [m]; None without a handle."""
        line = find_handle(self.coarse)
        return None if line is None else line - self.mesh.centre

    @cached_property
    def half_turns(self) -> Float[ndarray, "T 3 3"]:
        """Half turns about the principal axes that map the surface nearly onto itself: T from 0 to 3."""
        turns = se3.exp_so3(np.pi * self.axes)
        moved = self.moved_by(turns)
        return turns[(moved > HALF_TURN_DISTANCE_RANGE[0]) & (moved < HALF_TURN_DISTANCE_RANGE[1])]

    @cached_property
    def axis_of_revolution(self) -> Float[ndarray, "3"] | None:
        """The principal axis about which turns hardly move the surface; None without one."""
        moved = self.moved_by(se3.exp_so3(REVOLVED_BY_RAD * self.axes))
        return self.axes[int(np.argmin(moved))] if moved.min() < MAX_REVOLVED_DISTANCE else None

    def moved_by(self, turns: Float[ndarray, "T 3 3"]) -> Float[ndarray, "T"]:
        """Measure how far turns move the surface, root mean square [diameters]."""
        middle = np.zeros((len(turns), 1, 3))
        return self.rms_distance(np.eye(3)[None], np.zeros((1, 3)), 1.0, turns[:, None], middle, np.ones(len(turns)))

    def half_turned(self, R: Float[ndarray, "N 3 3"], others: Float[ndarray, "C N 3 3"]) -> Bool[ndarray, "C"]:
        """Mark the rotations, of C over N frames, that differ from R by one of the half turns."""
        between = np.swapaxes(R, -1, -2) @ others
        off = [se3.angle_between(between, turn).max(axis=-1) for turn in self.half_turns]
        return np.any(np.array(off).reshape(-1, len(others)) < HALF_TURN_TOLERANCE_RAD, axis=0)

    def rms_distance(
        self,
        R: Float[ndarray, "N 3 3"],
        centre: Float[ndarray, "N 3"],
        scale: float,
        others_R: Float[ndarray, "C N 3 3"],
        others_centre: Float[ndarray, "C N 3"],
        others_scale: Float[ndarray, "C"],
        within: float = np.inf,
    ) -> Float[ndarray, "C"]:
        """Compute the root mean square distance of the posed surface from C other poses of it [diameters].

        A bottle that is rotated about its axis has not moved. Of distant poses the result is a lower bound, and beyond
        ``within`` infinite.
        """
        arrays = map(np.ascontiguousarray, (R, centre, others_R, others_centre, others_scale))
        at_R, at_centre, *others = arrays
        found = rms_distances(self.points, at_R, at_centre, scale, *others, within * self.diameter, *self.solid.tables)
        return np.asarray(found / self.diameter)


@dataclass(frozen=True)
class Trust:
    """The trust in the inputs of a problem.

    Attributes:
        hand_refined: whether the hand was refined by its own pixels.
        hand_differing: fraction of the hand's visible pixels that differ from its silhouette; NaN where unknown.
        hand_drawn: whether the rendered hand replaces missing ignore masks.
        hand_lifted: whether the hand was lifted from 2D points, at an assumed size or a size from depth.
        joints_left_out: whether the hand was refined without its 2D joints.
        mesh_fitted: whether the mesh was warped to the masks.
        outliers: names of frames with outlier masks, which are left out (``stages.robust_masks``).
        outlier_threshold: maximum number of pixels in which a mask may differ from the predicted silhouette.
        views_left_out: names of further views that contradict the clip (``stages.view_agreement``).
        view_outliers: outlier masks of further views, each by the names of view and frame.
        view_thresholds: maximum number of pixels in which a mask of each view may differ.
    """

    hand_refined: bool = False
    hand_differing: float = np.nan
    hand_drawn: bool = False
    hand_lifted: bool = False
    joints_left_out: bool = False
    mesh_fitted: bool = False
    outliers: tuple[str, ...] = ()
    outlier_threshold: float = np.inf
    views_left_out: tuple[str, ...] = ()
    view_outliers: frozenset[tuple[str, str]] = frozenset()
    view_thresholds: Mapping[str, float] = field(default_factory=dict)

    @property
    def contact(self) -> float:
        """Factor on the weight of contact."""
        return FITTED_MESH_CONTACT_FACTOR if self.mesh_fitted else 1.0

    @property
    def firmness(self) -> float:
        """Factor on the stiffness of deviations, and on the weight of contact consistency."""
        return LIFTED_HAND_COUPLING_FACTOR if self.hand_lifted else 1.0

    @property
    def reach(self) -> float:
        """Maximum distance at which a finger is pulled to the object [m]."""
        return FITTED_PULL_DISTANCE_M if self.mesh_fitted else MAX_PULL_DISTANCE_M


@dataclass(frozen=True)
class ObservedView:
    """A further view of a problem's frames.

    Attributes:
        view: the view, at the problem's frames.
        rows: (n,) indices of the frames in which its mask shows the object.
        masks: its masks in these frames; they may also ignore pixels that the rendered hand covers.
        observation: its masks as crops, with contours.
        refinement: the refinement of an estimated hand, as this view sees it; None of a measured or unrefined hand.
    """

    view: View
    rows: Int[ndarray, "n"]
    masks: Masks
    observation: Observation
    refinement: HandRefinement | None = None

    @property
    def name(self) -> str:
        """Name of the view."""
        return self.view.name

    @property
    def T_view_cam(self) -> Float[ndarray, "n 4 4"]:
        """Poses of the clip's camera in the view's camera frame, in the frames ``rows``."""
        return self.view.T_view_cam[self.rows]

    def clip(self, clip: Clip) -> Clip:
        """Return the problem's clip as the view sees it, in the frames ``rows``."""
        return rows_in_view(clip, self.view, self.rows)


def observe_views(
    clip: Clip,
    options: Options,
    gap_share: float,
    refinement: HandRefinement | None = None,
    outliers: frozenset[tuple[str, str]] = frozenset(),
) -> tuple[ObservedView, ...]:
    """Crop the masks of the further views of a clip at a problem's frames, where they show the object.

    ``outliers`` are left out, each by the names of view and frame.
    """
    found = []
    for view in views_of(clip):
        inlier = [(view.name, frame) not in outliers for frame in clip.frames]
        rows = np.flatnonzero(view.masks.observed & inlier)
        if not len(rows):
            continue
        seen, masks = rows_in_view(clip, view, rows), view.masks.take(rows)
        if options.occlusion and not masks.say_what_hides:
            masks = occluded_by_hand(seen, masks)
        observation = observe_masks(masks, view.K[rows], options.occlusion, gap_share)
        of_hand = refinement and refinement.in_view(view, rows)
        found.append(ObservedView(view, rows, masks, observation, of_hand))
    return tuple(found)


@dataclass(frozen=True)
class Problem:
    """A clip at the frames that are used.

    Attributes:
        clip: the clip at the sampled frames, its evidence in memory, its hand refined by the hand's pixels, and its
            fingers by 2D joints.
        masks: its masks, in the same frames; they may also ignore pixels that the rendered hand covers.
        observation: its masks as crops, with contours.
        surface: surface of the object.
        options: options of the reconstruction, with the number of initial poses that this clip's scale asks for.
        prior_poses: (k, 4, 4) initial poses ``T_hand_obj``, tried before uniform rotations, or alone.
        notes: dropped frames, assumptions, initial poses, replacements of missing masks.
        threads: number of threads that share the hypotheses of a fit.
        trust: the trust in these inputs.
        refinement: the refinement of an estimated hand, in the problem's frames, which is then solved with the object;
            None of a measured or unrefined hand.
        views: what further cameras show.
    """

    clip: Clip
    masks: Masks
    observation: Observation
    surface: ObjectSurface
    options: Options
    prior_poses: Float[ndarray, "k 4 4"]
    notes: tuple[str, ...]
    threads: int = 1
    trust: Trust = Trust()
    refinement: HandRefinement | None = None
    views: tuple[ObservedView, ...] = ()

    @property
    def inits(self) -> int:
        """Number of initial poses of the object in the hand: the prior poses alone, if the options say so."""
        return len(self.prior_poses) if self.options.priors_only else self.options.inits

    @cached_property
    def evidence(self) -> tuple[Terms, ...]:
        """Terms of each modality that has data."""
        return tuple(terms for modality in modalities() if (terms := modality.terms(self)) is not None)

    @cached_property
    def contacts(self) -> dict[int, HandContacts]:
        """The hand's contacts, at each level."""
        return {level: HandContacts.of(self.clip.hand, count) for level, count in N_REGION_CONTACTS.items()}

    def in_view(self, view: ObservedView) -> Problem:
        """Return the problem as one of its further views shows it, in that view's frames."""
        return replace(
            self, clip=view.clip(self.clip), masks=view.masks, observation=view.observation,
            refinement=view.refinement, views=(),
        )  # fmt: skip

    @property
    def handle(self) -> Float[ndarray, "P 3"] | None:
        """Points of the handle's middle line about the centre of the mesh [m], as the clip marks it or as it is found.

        None without a handle, and where the options leave it out.
        """
        marked, mesh = self.clip.handle, self.clip.mesh
        if "handle" in self.options.without or (marked is not None and not len(marked)):
            return None
        return self.surface.handle if marked is None else spread_along(marked, mesh.diameter) - mesh.centre

    @property
    def input_masks(self) -> Masks:
        """The clip's masks as they were read."""
        masks = masks_in_memory(self.clip)
        assert masks is not None
        return masks

    def at(self, clip: Clip) -> Problem:
        """Return the problem in other frames of its clip, with their evidence in memory or in the clip's folder.

        Whether the masks leave gaps stays as in this problem. In frames beyond this problem's the hand's refinement is
        unknown.
        """
        clip = without_views(with_evidence(clip), self.trust.views_left_out)
        masks = read_masks(clip)
        if self.trust.hand_drawn and not masks.say_what_hides:
            masks = occluded_by_hand(clip, masks)
        gap_share = 0.0 if self.observation.has_gaps else 1.0
        observation = observe_masks(masks, clip.K, self.options.occlusion, gap_share)
        refinement = None
        if self.refinement is not None and {*clip.frames} <= {*self.clip.frames}:
            refinement = self.refinement.take(self.clip.index_of(clip.frames))
        views = observe_views(clip, self.options, gap_share, refinement, self.trust.view_outliers)
        return replace(self, clip=clip, masks=masks, observation=observation, refinement=refinement, views=views)

    def with_hand_found(self, clip: Clip) -> Clip:
        """Return a clip with the problem's hand in the problem's frames, and an interpolated hand in all others."""
        if not self.trust.hand_refined:
            return clip
        at = clip.index_of(self.clip.frames)
        if self.refinement is not None:
            clip = replace(clip, hand=self.refinement.with_fingers(clip.hand, at))
        return clip.with_hand_at(interpolate_solved_hand(clip.hand.T_cam_hand, self.clip.hand.T_cam_hand, at))

    def warped(self, warp: Warp | None) -> Problem:
        """Return the problem with its mesh deformed by a warp, if any, and contact of more weight."""
        if warp is None:
            return self
        clip, trust = self.clip.warped(warp), replace(self.trust, mesh_fitted=True)
        return replace(self, clip=clip, surface=ObjectSurface.of(clip.mesh), trust=trust)

    def with_hand(self, hand: SolvedHand) -> Problem:
        """Return the problem with the solved hand."""
        trust = replace(self.trust, hand_refined=True, hand_differing=hand.differing)
        clip = self.clip.with_hand_at(hand.T_cam_hand)
        return replace(self, clip=clip, notes=(*self.notes, str(hand)), trust=trust)

    def as_found(self, found: MethodResult) -> Problem:
        """Return the problem with the mesh and the hand of a method's result."""
        problem = self.warped(found.warp)
        return problem if found.hand is None else problem.with_hand(found.hand)


EnergyOf = Callable[[Problem], Energy]
"""The energy of a problem: the same terms, at its frames."""


@dataclass(frozen=True)
class MethodResult:
    """Distinct solutions of a method, best first: K of them, in T frames.

    Attributes:
        poses: poses of the object about the mesh's centre, in the hand frame.
        energy: (K,) energy of each solution [px^2 of the 256-pixel crop].
        terms: energy of the best one, per term.
        status: how the minimisation ended.
        axis: axis of the best one, where the method has one.
        motion: the motions of the solutions, whose per-frame parameters are fitted in the frames that were not sampled;
            None where poses are interpolated in these frames.
        energy_of: the energy of that fit.
        warp: the mesh fit (``stages.mesh_deformation``), whose mesh poses and energies are of; None: the input mesh.
        hand: the hand solved together with the object, to which poses are relative; None: the problem's.
        texture: the vote of the mesh's texture.
    """

    poses: PosesInHand
    energy: Float[ndarray, "K"]
    terms: dict[str, float]
    status: Status
    axis: Axis | None = None
    motion: Motion | None = None
    energy_of: EnergyOf | None = None
    warp: Warp | None = None
    hand: SolvedHand | None = None
    texture: TextureVote = field(default_factory=TextureVote)


def prepare_problem(clip: Clip, options: Options, threads: int = 1, views_left_out: tuple[str, ...] = ()) -> Problem:
    """Leave out frames without an object, sample the rest linearly, crop the masks, refine the hand.

    Masks that the clip does not have in memory are read from its folder, in the sampled frames. A free scale multiplies
    the initial poses by ``FREE_SCALE_START_FACTOR``. Further views that contradict the clip are left out besides
    ``views_left_out``. Raises ``InputError`` for fewer than 2 frames, and for initial poses as ``read_initial_poses``
    does.
    """
    if clip.scale == "free" and not options.as_published:
        options = replace(options, inits=FREE_SCALE_START_FACTOR * options.inits)
    initial = initial_poses.read_initial_poses(clip, options)
    clip = sample_clip_frames(clip, options.frames)
    wrong = (*views_left_out, *contradicting_views(without_views(clip, views_left_out), read_masks(clip)))
    clip = without_views(clip, wrong)
    with ThreadPoolExecutor(1) as pool:
        surface = pool.submit(ObjectSurface.of, clip.mesh)  # depends on no hands and masks
        if threads == 1:
            wait([surface])
        problem = _prepare_sampled(clip, options, surface, threads, initial)
    return replace(problem, trust=replace(problem.trust, views_left_out=wrong)) if wrong else problem


def _prepare_sampled(
    clip: Clip,
    options: Options,
    surface: Future[ObjectSurface],
    threads: int,
    initial: tuple[Float[ndarray, "k 4 4"], tuple[str, ...]],
) -> Problem:
    masks, notes = read_masks(clip), []
    if clip.left_out:
        one, more = "frame without a mask that shows the object was", "frames without masks that show the object were"
        notes.append(f"{format_count(len(clip.left_out), one, more)} left out of the fit: {', '.join(clip.left_out)}")
    # For the paper's method gaps between the masks are background.
    gap_share = 1.0 if options.as_published else GAP_SHARE
    hand_drawn = options.occlusion and not masks.say_what_hides
    if hand_drawn:  # observed below, once the hand is refined
        have_gaps = masks_leave_gaps(masks, gap_share)
    else:
        observation = observe_masks(masks, clip.K, options.occlusion, gap_share)
        have_gaps = observation.has_gaps
    refinement, differing = None, float("nan")
    if options.hands == "corrected" and not options.as_published:
        refinement, differing = refine_hand(clip, masks, have_gaps)
    if refinement is not None:
        hand = refinement.with_fingers(clip.hand, np.arange(len(clip)))
        clip = replace(clip, hand=hand).with_hand_at(refinement.T_cam_hand)
        notes.append(str(refinement))
        if refinement.kind != kind_of_hands(clip.provenance):
            notes.append("the hand counts as estimated: it was turned farther than the errors of measured hands allow")
    if hand_drawn:
        masks = occluded_by_hand(clip, masks)
        observation = observe_masks(masks, clip.K, options.occlusion, gap_share)
        notes.append("no ignore masks: pixels that the rendered hand covers outside the object's mask count as hidden")
    notes += initial[1]
    notes += [f"{topic}: {text}" for topic, text in assumptions(clip.provenance).items()]
    if observation.has_gaps:
        notes.append("masks leave gaps between the object and its occluders: pixels in gaps do not count")
    lifted = is_assumed(clip.provenance.get("hands_scale")) or clip.hand_scale != 1.0
    estimated = refinement if refinement is not None and refinement.kind == "estimated" else None
    return Problem(
        clip=clip, masks=masks, observation=observation, surface=surface.result(),
        options=options, prior_poses=initial[0], notes=tuple(notes), threads=threads,
        trust=Trust(
            refinement is not None, differing, hand_drawn, hand_lifted=lifted,
            joints_left_out=refinement is not None and refinement.joints is None and clip.hand.joints_2d is not None,
        ),
        refinement=estimated,
        views=observe_views(clip, options, gap_share, estimated),
    )  # fmt: skip


def sample_clip_frames(clip: Clip, frames: int) -> Clip:
    """Sample the clip's frames, with their evidence; other frames' masks are read one by one, and not kept.

    Raises ``InputError`` as reading evidence does, and for fewer than two frames that show the object.
    """
    if masks_in_memory(clip) is None and len(clip) <= frames:
        clip = with_masks(clip, read_masks(clip))
    masks = masks_in_memory(clip)
    observed = read_observed(clip) if masks is None else masks.observed
    return with_evidence(observed_frames(clip, observed, frames))
