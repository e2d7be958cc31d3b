"""HOI4D (Liu et al., CVPR 2022): a hand and a rigid object before a head-worn camera, poses by annotation and fitting.

The files are read as HOI4D's own instructions (https://github.com/leolyliu/HOI4D-Instructions) describe them, with
<index> = ZY*/H*/C*/N*/S*/s*/T* (camera, person, category, object, room, layout, task):

    HOI4D_annotations/<index>/objpose/<frame>.json              pose of the object: center [m], rotation (Euler XYZ)
    HOI4D_annotations/<index>/2Dseg/mask|shift_mask/*.png       labels by colour: 1 the object, 2 the right hand, ...
    handpose/refinehandpose_right|left/<index>/<frame>.pickle   MANO: poseCoeff (48,), beta (10,), trans [m]
    camera_params/<camera>/intrin.npy                           (3, 3)
    HOI4D_CAD_Model_for_release/rigid/<Category>/<object>.obj   CAD [m]

Objects with joints have no CAD in ``rigid``: they are skipped.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import FrameMasks, HandTrack
from getagrip.clip.timeline import SIDES
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import MAX_MESH_BYTES, checked_mesh, drop_degenerate_faces
from getagrip.geometry.mesh_files.obj import parse_obj
from getagrip.hands.model import Side
from getagrip.io import arrays, pickles
from getagrip.io.files import read_bytes, read_json, shorten_value
from getagrip.io.images import read_colour_png
from getagrip.io.options import OptionalFolder
from getagrip.readers.datasets import mano_tracks
from getagrip.readers.datasets.cutting import TrackedDataset
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.mano_tracks import check_mano_numbers
from getagrip.readers.datasets.tracks import (
    SequenceSource,
    Track,
    check_length,
    check_pinhole,
    intrinsics_from_opencv,
)
from getagrip.stable_grasps.definition import MIN_GRASP_FRAMES, GraspOptions

HOI4D_GRASP_OPTIONS = GraspOptions(tau=0.3, contact_mm=10.0, shortest=MIN_GRASP_FRAMES)
"""The paper's stable grasps of HOI4D; it states no minimum length."""
HOI4D_IMAGE_SIZE_PX = (1920, 1080)
"""Width and height of HOI4D's images [px]."""
HOI4D_IMAGE_SCALE = 0.5
"""Size of masks over the size of images."""
HOI4D_FPS = 15.0
HOI4D_CATEGORIES = {
    "C1": "ToyCar", "C2": "Mug", "C3": "Laptop", "C4": "StorageFurniture", "C5": "Bottle", "C6": "Safe", "C7": "Bowl",
    "C8": "Bucket", "C9": "Scissors", "C11": "Pliers", "C12": "Kettle", "C13": "Knife", "C14": "TrashCan",
    "C17": "Lamp", "C18": "Stapler", "C20": "Chair",
}  # fmt: skip
"""HOI4D's names of categories, by number."""
Colour = tuple[int, int, int]
HOI4D_OBJECT_COLOUR: Colour = (128, 0, 0)
"""Red, green and blue of label 1, the object, in PASCAL VOC's colours; other labels are hands or other objects."""
HOI4D_HAND_COLOURS: dict[tuple[str, Side], Colour] = {
    **{(kind, "right"): (0, 128, 0) for kind in HOI4D_CATEGORIES},
    ("C8", "left"): (0, 128, 128),
    ("C17", "left"): (0, 128, 128),
    ("C20", "left"): (128, 128, 0),
}
"""Colours of hands: label 2, and 6 or 3. HOI4D lists no label for other left hands."""


@dataclass(frozen=True, kw_only=True)
class Hoi4d(TrackedDataset):
    """HOI4D's rigid objects: every visible stable grasp."""

    grasps: Annotated[GraspOptions, arg(name="")] = HOI4D_GRASP_OPTIONS
    """Definition of a stable grasp."""

    mano: OptionalFolder = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl."""

    def sources(self) -> list[SequenceSource]:
        """List the sequences of HOI4D."""
        mano = mano_tracks.mano_folder(self.mano, "HOI4D")
        found = sorted(file.parent for file in self.root.glob("HOI4D_annotations/ZY*/H*/C*/N*/S*/s*/T*/objpose"))
        if not found:
            raise InputError(self.root, "", "no HOI4D_annotations/ZY*/H*/C*/N*/S*/s*/T*/objpose", "HOI4D's folder")
        return [SequenceSource("-".join(f.parts[-7:]), partial(_read_sequence, self.root, f, mano)) for f in found]


def _read_sequence(root: Path, folder: Path, mano: Path, note: Note) -> Iterator[Track]:
    """Yield the object in each hand with poses."""
    index = folder.parts[-7:]
    camera, person, kind, item = index[:4]
    name = "-".join(index)
    category = HOI4D_CATEGORIES.get(kind)
    number = re.fullmatch(r"N(\d{1,6})", item)
    if category is None or number is None:
        expected = f"a category, one of {', '.join(HOI4D_CATEGORIES)}, and N<number>"
        raise InputError(folder, "", f"{kind}/{item}", expected)
    cad = root / "HOI4D_CAD_Model_for_release" / "rigid" / category / f"{int(number[1]):03d}.obj"
    if not cad.is_file():
        note(f"{name}: no {category}/{cad.name} among the rigid CADs (objects with joints are not read): skipped")
        return
    vertices, faces = parse_obj(cad, read_bytes(cad, MAX_MESH_BYTES))
    mesh = checked_mesh(cad, vertices, drop_degenerate_faces(vertices, faces))
    K = _read_intrinsics(root / "camera_params" / camera / "intrin.npy")
    T_cam_obj = {n: _read_object_pose(file) for n, file in _list_numbered_files(folder / "objpose", ".json").items()}
    masks = next((m for m in (folder / "2Dseg" / "mask", folder / "2Dseg" / "shift_mask") if m.is_dir()), None)
    hands = 0
    for side in SIDES:
        files = _list_numbered_files(root.joinpath("handpose", f"refinehandpose_{side}", *index), ".pickle")
        frames = sorted(set(files) & set(T_cam_obj))
        if not frames:
            continue
        hands += 1
        check_length(folder, "", len(frames))
        yield Track(
            file=folder,
            subject=person,
            sequence=name,
            category=category,
            side=side,
            fps=HOI4D_FPS,
            numbers=np.array(frames),
            digits=5,
            size=(round(HOI4D_IMAGE_SCALE * HOI4D_IMAGE_SIZE_PX[0]), round(HOI4D_IMAGE_SCALE * HOI4D_IMAGE_SIZE_PX[1])),
            K=intrinsics_from_opencv(K, HOI4D_IMAGE_SCALE),
            hand=_read_hand([files[n] for n in frames], mano, side),
            T_cam_obj=np.stack([T_cam_obj[n] for n in frames]),
            mesh=mesh,
            read_masks=None if masks is None else partial(_read_masks, masks, HOI4D_HAND_COLOURS.get((kind, side))),
            provenance={
                "source": f"HOI4D, {'/'.join(index)}",
                "licence": "made from HOI4D, CC BY-NC 4.0",
                "hands": "HOI4D's refined MANO parameters, by the user's MANO files",
                "masks": "HOI4D's 2D segmentation, drawn by people; hands and other objects are ignored",
                "camera": f"HOI4D's {camera}",
                "image": f"masks are {HOI4D_IMAGE_SCALE:g} times as large as the images",
                "scale": "HOI4D's CAD, true size",
            },
        )
    if not hands:
        note(f"{name}: no pose of a hand: skipped")


def _list_numbered_files(folder: Path, suffix: str) -> dict[int, Path]:
    """List the files ``<number><suffix>`` in a folder, by number; none without the folder."""
    return {int(file.stem): file for file in folder.glob(f"*{suffix}") if re.fullmatch(r"\d{1,6}", file.stem)}


def _read_intrinsics(file: Path) -> Float[ndarray, "3 3"]:
    return check_pinhole(file, "", arrays.floats(file, {"": arrays.parse_npy(file, "", read_bytes(file))}, "", (3, 3)))


def _read_object_pose(file: Path) -> Float[ndarray, "4 4"]:
    """Read ``T_cam_obj`` of the first object. Euler angles are about the object's own axes: R = Rx Ry Rz."""
    content = read_json(file)
    key = "dataList" if "dataList" in content else "objects"
    entries = content.get(key)
    if not isinstance(entries, list) or not entries or not isinstance(entries[0], dict):
        raise InputError(file, key, shorten_value(entries), "a list with the object")
    values = []
    for part in ("rotation", "center"):
        value = entries[0].get(part)
        xyz = [value.get(axis) for axis in "xyz"] if isinstance(value, dict) else [None]
        if not all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e3 for v in xyz):
            raise InputError(file, f"{key}[0].{part}", shorten_value(value), "numbers x, y and z")
        values.append(np.array(xyz, dtype=float))
    Rx, Ry, Rz = se3.exp_so3(np.diag(values[0]))
    return se3.rigid(Rx @ Ry @ Rz, values[1])


def _read_hand(files: list[Path], mano: Path, side: Side) -> HandTrack:
    """Read the hand in each frame, of the person's shape, with the published MANO, faults included, as HOI4D does."""
    labels = {file: pickles.read_pickle_file(file, "a hand's pose of HOI4D") for file in files}
    pose = np.stack([check_mano_numbers(file, label, "poseCoeff", (48,)) for file, label in labels.items()])
    trans = np.stack([check_mano_numbers(file, label, "trans", (3,)) for file, label in labels.items()])
    shape = check_mano_numbers(files[0], labels[files[0]], "beta", (10,))
    model = mano_tracks.load_mano_hand(mano, side, repaired=False)
    return mano_tracks.mano_hand_track(model, pose[:, :3], pose[:, 3:], trans, shape, True, np.eye(4))


def _read_masks(folder: Path, hand: Colour | None, number: int) -> FrameMasks:
    """Read the masks of the object, the ignored pixels and the hand, at half the size: two of four pixels decide."""
    colours = read_colour_png(folder / f"{number:05d}.png", HOI4D_IMAGE_SIZE_PX)
    red, green, blue = np.ascontiguousarray(np.moveaxis(colours, 2, 0))

    def of(colour: Colour) -> Bool[ndarray, "H W"]:
        return np.asarray((red == colour[0]) & (green == colour[1]) & (blue == colour[2]))

    observed, labelled = of(HOI4D_OBJECT_COLOUR), (red | green | blue) > 0
    seen = _halve_mask(observed, 2)
    holding = None if hand is None else _halve_mask(of(hand), 2) & ~seen
    return FrameMasks(seen, _halve_mask(labelled & ~observed, 2) & ~seen, holding)


def _halve_mask(mask: Bool[ndarray, "H W"], least: int) -> Bool[ndarray, "h w"]:
    """Halve a mask's size: a pixel is set where at least ``least`` of its four pixels are."""
    set_ = mask.view(np.uint8)
    return np.asarray(set_[::2, ::2] + set_[::2, 1::2] + set_[1::2, ::2] + set_[1::2, 1::2] >= least)
