"""From an estimator's numbers to surfaces: MANO's where the user has it, the generic hand's where not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.fit import JointsError, fit_joints
from getagrip.hands.model import (
    ORDER_21,
    HandModel,
    PosedHand,
    Side,
    hand_track,
    mirrored,
    mirrored_model,
    mirrored_pose,
    root_transform,
)
from getagrip.hands.trackers.estimates import Estimates

MANO_FILE_NAMES: dict[Side, str] = {"left": "MANO_LEFT.pkl", "right": "MANO_RIGHT.pkl"}
MAX_VERTEX_RMS_M = 0.03
"""Vertices so far from an estimator's own [m, root mean square] are another pose, not another shape."""


def load_mano(folder: Path | None, side: Side) -> mano.Mano | None:
    """Load the user's MANO hand of a side; None without a folder. Raises ``InputError``."""
    return None if folder is None else mano.load(folder / MANO_FILE_NAMES[side], side)


def estimates_to_track(estimates: Estimates, folder: Path | None) -> tuple[HandTrack, str]:
    """Return the hand in every frame, and a text that says which model it is.

    With a ``folder`` of MANO files and MANO's parameters it is MANO's hand. Else it is the generic hand: fitted to the
    joints where the estimator gives them, turned like the estimator's where not. Raises ``InputError``.
    """
    side, hands = estimates.side, estimates.hands
    joints = [hand.joints for hand in hands if hand.joints is not None]
    parameters = [hand.mano for hand in hands if hand.mano is not None]
    vertices = [hand.vertices for hand in hands if hand.vertices is not None]
    if folder is not None and not parameters and len(vertices) == len(hands):
        return make_mano_track(
            network_model(side, folder), np.array(vertices), np.array(joints)
        ), "MANO's vertices as saved"
    if len(joints) == len(hands) and (folder is None or not parameters):
        return fit_generic_hand(hands[0].path, side, np.array(joints))
    R, pose, betas, t = (np.array(values) for values in zip(*parameters, strict=True))
    if folder is None:
        shaped = generic.load(side).with_shape()
        posed, root = shaped.with_pose(pose), shaped.joints[0]
        what = "the generic hand of mean size, turned as the estimator's MANO hand: not its surface"
    elif side == "left" and estimates.left_model == "mirrored":
        posed, root = _mirror_right_hand(mano.load(folder / MANO_FILE_NAMES["right"], "right").model, betas, pose)
        what = "MANO's right hand mirrored, as the estimator has it"
    else:
        shaped = mano.load(folder / MANO_FILE_NAMES[side], side).model.with_shape(betas)
        posed, root = shaped.with_pose(pose), shaped.joints[:, 0]
        what = f"MANO's {side} hand"
    T_cam_hand = root_transform(R, t, root)
    if all(hand.vertices is not None for hand in hands):
        T_cam_hand = _align_to_vertices(estimates, posed, T_cam_hand)
    return hand_track(posed, T_cam_hand), what


def make_mano_track(model: HandModel, vertices: Float[ndarray, "T V 3"], joints: Float[ndarray, "T 21 3"]) -> HandTrack:
    """Make the hand of MANO's vertices and its joints before the camera [m]."""
    T_cam_hand = mano_motions(model, vertices)[:, 0]
    inside = se3.inverse(T_cam_hand)
    posed = PosedHand(
        model.side, se3.transform(inside, vertices), model.faces, se3.transform(inside, joints), model.regions
    )
    return hand_track(posed, T_cam_hand)


def network_model(side: Side, folder: Path) -> HandModel:
    """Return the hand of networks that know right hands only: MANO's right one, or its mirror image."""
    right = mano.load(folder / MANO_FILE_NAMES["right"], "right").model
    return right if side == "right" else mirrored_model(right)


def mano_motions(model: HandModel, vertices: Float[ndarray, "*n V 3"]) -> Float[ndarray, "*n 16 4 4"]:
    """Fit the rigid motion of each part of a hand from rest to its vertices (least squares).

    A part's vertices are those that follow its joint by more than half of their weight.
    """
    weights = np.where(model.weights > 0.5, model.weights, 0.0).T
    weights = weights / weights.sum(axis=1, keepdims=True)
    rest, moved = weights @ model.template, np.einsum("jv,...vc->...jc", weights, vertices)
    H = np.einsum("jv,...vc,vd->...jcd", weights, vertices, model.template)
    R = se3.nearest_rotation(H - moved[..., None] * rest[:, None, :])
    return se3.rigid(R, moved - (R @ rest[..., None])[..., 0])


def mano_joints(model: HandModel, vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "21 3"]:
    """Compute the 21 joints of a hand of which only the surface is known, each moved with its part."""
    at = se3.transform(mano_motions(model, vertices), model.joints[:, None])[:, 0]
    return np.concatenate([at, vertices[model.tips]])[ORDER_21]


def fit_generic_hand(path: Path, side: Side, joints: Float[ndarray, "T 21 3"]) -> tuple[HandTrack, str]:
    """Fit the generic hand to joints before the camera [m], in this package's order. Raises ``InputError``."""
    try:
        fit = fit_joints(generic.load(side), joints, "openpose")
    except JointsError as error:
        raise InputError(path, "joints", error.got, error.expected) from error
    off = 1e3 * np.sqrt(np.mean(fit.residuals**2))
    return fit.hand, f"the generic hand fitted to the estimator's joints ({off:.1f} mm off, root mean square)"


def generic_joints(side: Side, R: Float[ndarray, "3 3"], pose: Float[ndarray, "45"]) -> Float[ndarray, "21 3"]:
    """Compute the joints of the generic hand with a global rotation and a pose, in the camera's axes [m]."""
    return generic.load(side).with_shape().with_pose(pose).joints @ R.T


def _mirror_right_hand(
    model: HandModel, betas: Float[ndarray, "T 10"], pose: Float[ndarray, "T 45"]
) -> tuple[PosedHand, Float[ndarray, "T 3"]]:
    """Return a right hand's mirror image, and its root joint."""
    shaped = model.with_shape(betas)
    posed = shaped.with_pose(mirrored_pose(pose))
    left = replace(
        posed,
        side="left",
        vertices=mirrored(posed.vertices),
        faces=posed.faces[:, ::-1].copy(),
        joints=mirrored(posed.joints),
    )
    return left, mirrored(shaped.joints[:, 0])


def _align_to_vertices(
    estimates: Estimates, posed: PosedHand, T_cam_hand: Float[ndarray, "T 4 4"]
) -> Float[ndarray, "T 4 4"]:
    """MANO's hands moved such that the means of their vertices are where those of the estimator's are.

    Raises ``InputError`` where the vertices then still are far from the estimator's.
    """
    value = np.array([hand.vertices for hand in estimates.hands])
    ours = se3.transform(T_cam_hand, posed.vertices)
    shift = value.mean(axis=1) - ours.mean(axis=1)
    off = np.sqrt(np.mean(np.sum((ours + shift[:, None] - value) ** 2, axis=-1), axis=1))
    if off.max() > MAX_VERTEX_RMS_M:
        worst = estimates.hands[int(np.argmax(off))]
        input_words = f"vertices {1e3 * off.max():.0f} mm from MANO's in the same pose"
        raise InputError(worst.path, "pred_vertices_smpl", input_words, "the hand of pred_hand_pose")
    return se3.rigid(None, shift) @ T_cam_hand
