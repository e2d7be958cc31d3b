"""The generic hand fitted to the true joints of a recording, for datasets that hold joints and no free hand surface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.fit import fit_joints
from getagrip.hands.model import HandModel, Side, hand_track


@dataclass(frozen=True)
class FittedHand:
    """The generic hand in every frame, of one shape."""

    track: HandTrack
    """Its poses are in the frame that the joints were in."""
    residuals: Float[ndarray, "T 21"]
    """Distances of its joints from the true ones [m]."""


def fit_hand(file: Path, key: str, side: Side, joints: Float[ndarray, "T 21 3"]) -> FittedHand:
    """The generic hand fitted to joints [m] in this package's order, those of ``key`` in a file.

    Raises ``InputError`` where they are no hand's.
    """
    model = generic.load(side)
    try:
        fit = fit_joints(model, joints, "openpose")
    except UsageError as error:
        raise InputError(file, key, str(error), "the 21 joints of a hand") from error
    posed = model.with_shape(_with_girth(model, fit.shape, joints)).with_pose(fit.pose)
    track = hand_track(posed, fit.hand.T_cam_hand)
    return FittedHand(track, np.linalg.norm(se3.transform(track.T_cam_hand, posed.joints) - joints, axis=-1))


def describe_fit(residuals: Float[ndarray, "T 21"]) -> str:
    """How well a hand fits, in words, by distances of joints [m]."""
    off = 1e3 * residuals
    rms = np.sqrt(np.mean(off**2))
    return f"joints {rms:.1f} mm off (root mean square; median {np.median(off):.1f}, worst {off.max():.1f})"


def _with_girth(model: HandModel, shape: Float[ndarray, "S"], joints: Float[ndarray, "T 21 3"]) -> Float[ndarray, "S"]:
    """The shape with fingers as thick as the hand is long: joints say nothing about girth, but enlarge it by chance."""
    length = np.median(_length(joints)) / _length(model.with_shape().with_pose().joints)
    shape = shape.copy()
    shape[model.shape_names.index("thickness")] = length - 1.0 - shape[model.shape_names.index("size")]
    return shape


def _length(joints: Float[ndarray, "*batch 21 3"]) -> Float[ndarray, "*batch"]:
    """Mean over the four fingers of the length along the bones from the wrist to the tip [m]."""
    wrist = np.broadcast_to(joints[..., None, :1, :], (*joints.shape[:-2], 4, 1, 3))
    chains = np.concatenate([wrist, joints[..., 5:, :].reshape(*joints.shape[:-2], 4, 4, 3)], axis=-2)
    return np.asarray(np.linalg.norm(np.diff(chains, axis=-2), axis=-1).sum(axis=-1).mean(axis=-1))
