"""The tables of checks: the measure, usual range, fault and advice of each."""

from __future__ import annotations

import numpy as np

from getagrip.checks import inputs, intrinsics, results
from getagrip.checks.check import Check, format_diameter_share, format_millimetres, format_percent
from getagrip.checks.evidence import Evidence
from getagrip.clip import modalities
from getagrip.io.plugins import PluginTable

MIN_MEAN_IOU = 0.5
"""Mean IOU below which a result has failed, whatever the status of the minimisation."""
CAMERA_ADVICE = "give the camera of these images: K is scaled and cropped with them"
CONTOUR_MISFIT_MESSAGE = "contours are {value} times as far from the masks' as they would be with the object's own mesh"
MISFIT_ADVICE = (
    "compare the contours in the report: mend masks that show a box, a shadow, the hand or only a part of the object; "
    "where the masks are right, the mesh or the hand's pose is wrong"
)


def describe_outlier_masks(it: Evidence) -> str:
    """List the outlier masks."""
    assert it.outliers
    masks, names = f"{len(it.outliers)} of {len(it.overlaps)} masks", ", ".join(it.outliers)
    if len(it.outliers) == 1:
        return f"{masks} contradicts the others and was left out: frame {names}"
    return f"{masks} contradict the others and were left out: frames {names}"


def preferred_scale(it: Evidence) -> str:
    """Name the scale that the energy prefers."""
    factor, gain = it.scale_check
    better = f"{factor:.2f} times its size would explain the masks and the hand better"
    return f"{better}, by {format_percent(gain)} of the energy"


def describe_regrasp(it: Evidence) -> str:
    """Name the frames of a regrasp."""
    excess = format_diameter_share(results.regrasp_jump(it))
    return f"the object jumps in the hand {results.describe_largest_step(it)}, by {excess} more than elsewhere"


def describe_deformation(it: Evidence) -> str:
    """Name the size of the mesh's deformation."""
    return f"to meet the masks the mesh was deformed by {it.deformed_mm:.1f} mm, so its shape is an assumption"


def camera_mismatch(it: Evidence) -> str:
    """Name the images to which the camera seems to belong."""
    return intrinsics.camera_warning(it.clip.K, it.clip.size)


_OWN_INPUT_CHECKS: tuple[Check, ...] = (
    Check(
        "mesh-holes", inputs.hole_share, high=0.15, shown=format_percent,
        fault="holes are {value} of the mesh's surface",
        advice="close the mesh where faces are missing, or give a thin shell its two sides",
    ),
    Check(
        "mesh-open", inputs.hole_share, high=0.01, serious=False, shown=format_percent,
        fault="the mesh is open, by {value} of its surface", advice="its inside is uncertain: close it",
    ),
    Check(
        "mesh-flat", lambda it: inputs.extents(it)[0], low=0.005, shown=format_percent,
        fault="the mesh's thickness is {value} of its length", advice="the mesh has no volume: add its thickness",
    ),
    Check(
        "mesh-needle", lambda it: inputs.extents(it)[1], low=0.015, shown=format_percent,
        fault="the mesh's width is {value} of its length",
        advice="check that the mesh is this object's, and not stretched along one axis",
    ),
    Check(
        "object-size", lambda it: inputs.size_at_scale(it, "known", it.clip.mesh.diameter / it.hand_size),
        low=0.1, high=6.0, fault="the mesh is {value} times as large as the hand",
        advice="check the units of mesh and hand; an unknown size is \"scale\": \"free\"",
    ),
    Check(
        "mask-size", lambda it: inputs.size_at_scale(it, "known", it.apparent_size / it.clip.mesh.diameter),
        low=0.15, high=2.5,
        fault="the masks show something {value} times as large as the mesh, at the hand's distance",
        advice="check the masks' label, the mesh's size, the focal length and the hand's distance",
    ),
    Check(
        "visible-size", lambda it: inputs.size_at_scale(it, "free", it.apparent_size / it.hand_size),
        low=0.1, high=8.0,
        fault="the masks show something {value} times as large as the hand, at the hand's distance",
        advice="check the masks' label, the focal length and the hand's distance",
    ),
    Check(
        "mask-at-edges", inputs.edge_share, high=0.7, shown=format_percent,
        fault="the masks cover {value} of the image's edge",
        advice="the masks seem to be of the background or the whole image: check their label",
    ),
    Check(
        "principal-point", lambda it: intrinsics.principal_point_offset(it.clip.K, it.clip.size),
        high=intrinsics.MAX_PRINCIPAL_POINT_OFFSET, shown=format_percent, fault=camera_mismatch, advice=CAMERA_ADVICE,
    ),
    Check(
        "pixel-stretch", lambda it: intrinsics.focal_ratio(it.clip.K), high=intrinsics.MAX_FOCAL_RATIO,
        fault=camera_mismatch, advice=CAMERA_ADVICE,
    ),
    Check(
        "field-of-view", lambda it: intrinsics.field_of_view(it.clip.K, it.clip.size),
        low=intrinsics.MIN_FOV_DEG, high=intrinsics.MAX_FOV_DEG, shown="{:.3g} degrees".format,
        fault=camera_mismatch, advice=CAMERA_ADVICE,
    ),
    Check(
        "focal-jumps", inputs.focal_jump, high=1.1,
        fault="from one frame to the next the focal length changes by a factor of {value}",
        advice="give one camera for all frames, unless the lens zooms",
    ),
    Check(
        "hand-side", inputs.finger_bend, low=-5.0, shown="{:.3g} degrees".format,
        fault="the fingers bend by {value} towards the palm of a hand of this side",
        advice="the hand is the other one, or mirrored: correct \"side\" in clip.json, or the hand",
    ),
    Check(
        "many-tracker-glitches", lambda it: it.glitch_share, high=0.3, shown=format_percent,
        fault=lambda it: str(it.glitches),
        advice="check that all frames have the same hand; --given-hands uses the input hand unchanged",
    ),
    Check(
        "tracker-glitches", lambda it: it.glitch_share, high=0.0, serious=False,
        fault=lambda it: str(it.glitches), advice="--given-hands uses the input hand unchanged",
    ),
    Check(
        "frame-order", inputs.reordering_gain, high=2.5,
        fault="in reverse, or shifted, the masks would fit the hands {value} times better",
        advice="check that hands and masks have the same frames in the same order, counted from the same number",
    ),
    Check(
        "frames-late", lambda it: inputs.mask_delay(it).times, high=1.08, serious=False,
        fault=lambda it: str(inputs.mask_delay(it)),
        advice="check that hands and masks count frames from the same number",
    ),
    Check(
        "masks-follow-hand", inputs.centroid_error, high=1.0, serious=False, shown=format_percent,
        fault="the masks' middles stray from the hand's motion by {value} of their size",
        advice="check that hands and masks are of the same frames, and that the grasp is stable throughout",
    ),
)  # fmt: skip

_OWN_RESULT_CHECKS: tuple[Check, ...] = (
    Check(
        "mask-fit", lambda it: float(np.nanmean(it.overlaps)), low=0.7,
        fault="the masks are met with a mean IOU of {value}",
        advice="check that the mesh is this object's, and masks and camera; --inits 200 tries more initial poses",
        of_shape=True,
    ),
    Check(
        "poor-mask-fit", results.consistent_mean_iou, low=0.9,
        fault="masks that agree with each other are met with a mean IOU of {value}",
        advice="the masks are probably right: check the hand's poses, the mesh and the camera", of_shape=True,
        low_where_met_less=results.LOWER_MIN_IOU,
    ),
    Check(
        "worst-frame", lambda it: float(np.nanmin(it.overlaps)), low=0.4, serious=False,
        fault="in the worst frame the mask is met with an IOU of {value}",
        advice="check that frame's mask; the report shows the IOU over time",
    ),
    Check(
        "uneven-mask-fit", results.min_iou_ratio, low=results.UNEVEN_IOU_RATIO, serious=False, shown=format_percent,
        fault=results.describe_low_iou_frames,
        advice="look at these frames: draw the part of the object that their masks lack, or correct the hand in them",
    ),
    Check(
        "many-outlier-masks", lambda it: it.outlier_share, high=0.3, shown=format_percent,
        fault=describe_outlier_masks, advice="check that all masks show the same object; --given-masks uses all",
    ),
    Check(
        "outlier-masks", lambda it: it.outlier_share, high=0.0, serious=False,
        fault=describe_outlier_masks, advice="--given-masks uses all",
    ),
    Check(
        "mesh-much-deformed", lambda it: it.deformed, high=0.06, shown=format_diameter_share,
        fault=describe_deformation,
        advice="check that the mesh is of such an object; --given-mesh uses it undeformed",
        of_shape=True,
    ),
    Check(
        "mesh-deformed", lambda it: it.deformed, high=0.0, serious=False,
        fault=describe_deformation,
        advice="the mesh is not the object's own, or all masks have the same error; --given-mesh uses it undeformed",
        of_shape=True,
    ),
    Check(
        "wrong-size", lambda it: it.scale_check[1], high=0.3, shown=format_percent, fault=preferred_scale,
        advice="check that mesh and hand have their real sizes; an unknown size is \"scale\": \"free\"",
    ),
    Check(
        "other-size", lambda it: it.scale_check[1], high=0.15, serious=False, shown=format_percent,
        fault=preferred_scale,
        advice="check that mesh and hand have their real sizes, and the hand its real distance",
    ),
    Check(
        "regrasp", results.regrasp_jump, high=0.06, serious=False, shown=format_percent, fault=describe_regrasp,
        advice="unless the clip is one stable grasp, cut it at these frames",
    ),
    Check(
        "large-mask-misfit", results.consistent_contour_misfit, high=6.0,
        fault=CONTOUR_MISFIT_MESSAGE + ", and the masks agree with each other",
        advice=MISFIT_ADVICE, of_shape=True,
    ),
    Check(
        "mask-misfit", lambda it: it.misfit, high=3.0, serious=False, fault=CONTOUR_MISFIT_MESSAGE,
        advice=MISFIT_ADVICE, of_shape=True,
    ),
    Check(
        "hand-off-pixels", lambda it: it.hand_differing if it.masks.hand is not None else np.nan,
        high=0.4, shown=format_percent,
        fault="the hand's silhouette differs from its mask (masks/hand), by {value} of the mask; no correction helps",
        advice="check the hand's poses, size and side, the camera, and the label of its masks",
    ),
    Check(
        "hand-off-ignored", lambda it: it.hand_differing if it.masks.hand is None else np.nan,
        high=0.4, serious=False, shown=format_percent,
        fault="the hand's silhouette differs from the ignored pixels nearby, by {value} of these; no correction helps",
        advice="if only the hand is ignored, check its poses, size and side, and the camera",
    ),
    Check(
        "object-over-hand", lambda it: it.in_front[0], high=0.2, shown=format_percent,
        fault="the object is in front of the hand in {value} of the pixels that show the hand",
        advice="hand and object are at the wrong distance: check the sizes of hand and mesh, and the hand's distance "
        "and side", of_distance=True,
    ),
    Check(
        "hand-over-object", lambda it: it.in_front[1], high=0.25, serious=False, shown=format_percent,
        fault="the hand is in front of the object in {value} of the object's mask",
        advice="mend masks that include the hand or hidden parts; else hand or object is at the wrong distance",
    ),
    Check(
        "second-gap", inputs.second_contact_gap, high=12.0, serious=False, shown=format_millimetres,
        fault="only one part of the hand is near the object, the next is {value} away",
        advice="unless one part alone holds the object, sizes or distances of hand and object are inconsistent",
    ),
    Check(
        "contact-gap", inputs.median_hand_object_gap, high=15.0, shown=format_millimetres,
        fault="hand and object are {value} apart in half of the frames",
        advice="the hand does not hold the object: check the hands' distance from the camera, and try --method one-dof",
        of_distance=True,
    ),
    Check(
        "penetration", inputs.penetration_depth, high=35.0, serious=False, shown=format_millimetres,
        fault="the hand is {value} inside the object in half of the frames",
        advice="hands, mesh size or pose have errors of about this size",
    ),
    Check(
        "opening-away", lambda it: it.turned_away, high=15.0, serious=False,
        fault="the object's opening points away from the camera, by {value} degrees",
        advice="if the object is upside down, take another candidate: tilted towards the camera it looks similar",
    ),
    Check(
        "handle-decided", lambda it: it.handle_decided, high=0.0, serious=False, shown=format_percent,
        fault="the fingers about the object's handle decided: without them another candidate is better, by {value}",
        advice="if the hand does not hold the object by the handle, take another candidate",
    ),
    Check(
        "result-size", lambda it: inputs.size_at_scale(it, "free", it.scale * it.clip.mesh.diameter / it.hand_size),
        low=0.1, high=6.0,
        fault="the object was found to be {value} times as large as the hand",
        advice="a free scale needs masks and hands that agree; give the size if you know it",
    ),
    Check(
        "hand-size", inputs.lifted_hand_size, low=0.7, high=1.35,
        fault="by the object's size, or by depth, the hand would be {value} times as large as a mean one",
        advice="check the object's size, that the mesh is of such an object, and the hand's joints and depth",
    ),
)  # fmt: skip


def _check_table(kind: str, own: tuple[Check, ...]) -> PluginTable[Check]:
    named = {check.name: check for check in own}
    expected = "a Check of the same name"
    return PluginTable(kind, named, expected, lambda name, it: isinstance(it, Check) and it.name == name)


INPUT_CHECKS = _check_table("input_checks", _OWN_INPUT_CHECKS)
RESULT_CHECKS = _check_table("result_checks", _OWN_RESULT_CHECKS)


def input_checks() -> tuple[Check, ...]:
    """Return ``INPUT_CHECKS``, and the input checks of each modality."""
    return (*INPUT_CHECKS.working().values(), *(check for modality in modalities() for check in modality.input_checks))


def result_checks() -> tuple[Check, ...]:
    """Return ``RESULT_CHECKS``, and the result checks of each modality."""
    own = RESULT_CHECKS.working().values()
    return (*own, *(check for modality in modalities() for check in modality.result_checks))
