"""Write clips into folders, completely or not at all (docs/formats.md)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped, UInt8
from numpy import ndarray

from getagrip.clip.clip import Clip, HandTrack, Masks, Truth
from getagrip.clip.masks import with_masks
from getagrip.clip.modality import modalities, with_evidence
from getagrip.clip.read import CLIP_FORMAT_VERSION
from getagrip.clip.read_arrays import OTHER_HAND_FILE
from getagrip.clip.timeline import segment_fields
from getagrip.errors import check_arguments
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import arrays, files
from getagrip.io.images import write_image

FRAMES_WITHOUT_HAND = "frames_without_hand"
"""Key of a clip's provenance."""


@check_arguments
def write_clip(
    clip: Clip,
    masks: Masks | None,
    folder: str | Path,
    images: Iterable[UInt8[ndarray, "H W 3"]] | None = None,
    replace: bool = False,
    hand: tuple[HandTrack, Sequence[int]] | None = None,
) -> Path:
    """Write a clip as a new folder (docs/formats.md), completely or not at all.

    Args:
        clip: the clip. A hand without vertices is not written; ``hand.npz`` can be added later.
        masks: masks of all frames; None to write none.
        folder: the folder to make.
        images: RGB images, one for each frame, written as JPEG; None to write none.
        replace: replace a clip that is in ``folder`` already.
        hand: a hand known in some frames only, and the indices of these frames, instead of ``clip.hand``.

    Returns:
        The folder.

    Raises:
        UsageError: the folder exists, and ``replace`` is False or it holds something other than a clip.
    """
    folder = Path(folder)
    with files.new_folder(folder, ("clip.json",) if replace else ()) as new:
        write_clip_contents(new, clip, masks, images)
        if hand is not None:
            write_hand_at(hand[0], clip.frames, hand[1], new / "hand.npz")
    return folder


def write_clip_contents(
    folder: Path, clip: Clip, masks: Masks | None, images: Iterable[UInt8[ndarray, "H W 3"]] | None
) -> None:
    """Write the files of a clip into an empty folder, as ``write_clip`` does."""
    files.write_json(folder / "clip.json", _clip_json_fields(clip))
    write_mesh(clip.mesh, folder / _mesh_file(clip))
    if clip.hand.vertices.size:
        write_hand(clip.hand, folder / "hand.npz")
    if clip.other_hand is not None:
        rows = np.flatnonzero(clip.other_hand.known)
        write_hand_at(clip.other_hand.track.take(rows), clip.frames, rows.tolist(), folder / OTHER_HAND_FILE)
    if clip.truth is not None:
        arrays.write(folder / "truth.npz", _truth_arrays(clip, clip.truth))
    complete = with_evidence(with_masks(clip, masks))
    for modality in modalities():
        modality.write(complete, folder)
    if images is not None:
        (folder / "frames").mkdir()
        for name, image in zip(clip.frames, images, strict=True):
            write_image(folder / "frames" / f"{name}.jpg", image)


def write_hand(hand: HandTrack, path: Path, extra: Mapping[str, Shaped[ndarray, "..."]] | None = None) -> None:
    """Write the hands of a clip, and ``extra`` arrays, which a clip's reader ignores."""
    regions = {f"region_{name}": ids for name, ids in hand.regions.items()}
    joints = {} if hand.joints is None else {"joints": hand.joints}
    if hand.joints_2d is not None and hand.joints_2d_confidence is not None:
        joints |= {"joints_2d": hand.joints_2d, "joints_2d_confidence": hand.joints_2d_confidence}
    surface = {"vertices": hand.vertices, "faces": hand.faces, "T_cam_hand": hand.T_cam_hand}
    arrays.write(path, surface | joints | regions | dict(extra or {}))


def write_hand_at(hand: HandTrack, frames: Sequence[str], rows: Sequence[int], path: Path) -> None:
    """Write the hands of a clip's frames ``rows``; the file names the frames unless these are all."""
    partial = {"frames": np.array([frames[row] for row in rows])} if len(rows) < len(frames) else None
    write_hand(hand, path, partial)


def missing_hand_provenance(frames: Sequence[str], rows: Sequence[int]) -> dict[str, str]:
    """Return the provenance of frames without a hand, given the frames ``rows`` with one; empty if all have one."""
    missing = [name for row, name in enumerate(frames) if row not in {*rows}]
    return {FRAMES_WITHOUT_HAND: f"left out until they have one: {', '.join(missing)}"} if missing else {}


def _clip_json_fields(clip: Clip) -> dict[str, object]:
    camera: dict[str, object] = {"K": collapse_constant(clip.K)}
    if clip.world is not None:
        camera["T_world_cam"] = collapse_constant(clip.world.T_world_cam)
        camera |= {} if clip.world.up is None else {"world_up": clip.world.up}
        camera |= {} if clip.world.support is None else {"world_support": clip.world.support}
    return {
        "version": CLIP_FORMAT_VERSION,
        "name": clip.name,
        "category": clip.category,
        "side": clip.side,
        "fps": clip.fps,
        "frames": clip.frames,
        **({} if clip.times is None else {"times": clip.times}),
        "size": clip.size,
        "camera": camera,
        "mesh": _mesh_file(clip),
        "scale": clip.scale,
        **({} if clip.handle is None else {"handle": clip.handle}),
        **({"segments": segment_fields(clip.segments, clip.frames)} if clip.segments else {}),
        "provenance": clip.provenance,
    }


def _mesh_file(clip: Clip) -> str:
    """Return the name of the mesh's file; .obj has no place for colours that all programs read."""
    return "object.obj" if clip.mesh.colours is None else "object.ply"


def collapse_constant(matrices: Float[ndarray, "T n n"]) -> Float[ndarray, "..."]:
    """Return one matrix if those of all frames are equal; else all."""
    return matrices[0] if np.array_equal(matrices, np.broadcast_to(matrices[:1], matrices.shape)) else matrices


def _truth_arrays(clip: Clip, truth: Truth) -> dict[str, Shaped[ndarray, "..."]]:
    """Return the arrays of the ground truth; the hand's only if they differ from the clip's."""
    out: dict[str, ndarray] = {"T_cam_obj": truth.T_cam_obj, "scale": np.array(truth.scale)}
    if not np.array_equal(truth.T_cam_hand, clip.hand.T_cam_hand):
        out["T_cam_hand"] = truth.T_cam_hand
    if not np.array_equal(truth.hand_vertices, clip.hand.vertices):
        out["hand_vertices"] = truth.hand_vertices
    if truth.articulation is not None:
        out["articulation"] = truth.articulation
    if truth.joint is not None:
        joint = truth.joint
        axis = {"joint_point": joint.point, "joint_direction": joint.direction, "joint_angle": np.array(joint.angle)}
        out |= {"joint_moves": joint.moves, **axis}
    return out
