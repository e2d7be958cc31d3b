"""All that can be wrong with a clip. Each case: how to break it, the file that is named, and words of the message.

Ways to break the small clip in its folder, one at a time.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

Break = Callable[[Path], None]


def edit_json(**changes: object) -> Break:
    """Set keys of clip.json; None removes one."""

    def apply(folder: Path) -> None:
        fields = json.loads((folder / "clip.json").read_text()) | changes
        fields = {key: value for key, value in fields.items() if value is not None}
        (folder / "clip.json").write_text(json.dumps(fields))

    return apply


def replaced(old: str, new: str) -> Break:
    """Replace text in clip.json."""

    def apply(folder: Path) -> None:
        text = (folder / "clip.json").read_text()
        assert old in text
        (folder / "clip.json").write_text(text.replace(old, new))

    return apply


def edit_npz(file: str, **changes: object) -> Break:
    """Set arrays of an .npz; functions are applied to the array that is there; None removes one."""

    def apply(folder: Path) -> None:
        with np.load(folder / file) as loaded:
            arrays = dict(loaded)
        for key, value in changes.items():
            arrays[key] = value(arrays[key].copy()) if callable(value) else value
        np.savez(folder / file, **{key: value for key, value in arrays.items() if value is not None})

    return apply


def edit_png(path: Path, edit: Callable[[np.ndarray], np.ndarray]) -> None:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    cv2.imwrite(str(path), edit(image))


def mask(edit: Callable[[np.ndarray], np.ndarray], kind: str = "object") -> Break:
    """Change the mask of frame 0001."""
    return lambda folder: edit_png(folder / "masks" / kind / "0001.png", edit)


def content(file: str, data: bytes | str) -> Break:
    """Replace a file's content."""
    return lambda folder: (folder / file).write_bytes(data if isinstance(data, bytes) else data.encode()) and None


def removed(file: str) -> Break:
    return lambda folder: (folder / file).unlink()


def renamed(old: str, new: str) -> Break:
    return lambda folder: (folder / old).rename(folder / new) and None


def linked_out(file: str) -> Break:
    """Move a file out of the clip and leave a link to it."""

    def apply(folder: Path) -> None:
        (folder / file).rename(folder.parent / "outside")
        os.symlink(folder.parent / "outside", folder / file)

    return apply


def no_object(folder: Path) -> None:
    for path in (folder / "masks" / "object").iterdir():
        edit_png(path, np.zeros_like)


def at(index: tuple[int, ...], value: float) -> Callable[[np.ndarray], np.ndarray]:
    """Set one element of an array."""

    def apply(array: np.ndarray) -> np.ndarray:
        array[index] = value
        return array

    return apply


def header_lies(folder: Path) -> None:
    """A hand.npz whose vertices' header promises 10^12 numbers."""
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6, 3)}
    np.lib.format.write_array_header_1_0(stream, header)
    with zipfile.ZipFile(folder / "hand.npz", "w") as archive:
        archive.writestr("vertices.npy", stream.getvalue() + b"\0" * 64)


def bomb(folder: Path) -> None:
    """A hand.npz that says it unpacks to 4 GB: the sizes of a small one, changed in its directory."""
    with zipfile.ZipFile(folder / "hand.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("vertices.npy", b"\0" * 1000)
    data = bytearray((folder / "hand.npz").read_bytes())
    entry = data.index(b"PK\x01\x02")
    data[entry + 24 : entry + 28] = (0xFFFFFFF0).to_bytes(4, "little")
    (folder / "hand.npz").write_bytes(data)


def png_bomb(folder: Path) -> None:
    """A mask whose header says 60000 x 60000, with a right checksum."""
    from zlib import crc32

    path = folder / "masks/object/0001.png"
    data = bytearray(path.read_bytes())
    data[16:24] = (60000).to_bytes(4, "big") * 2
    data[29:33] = crc32(bytes(data[12:29])).to_bytes(4, "big")
    path.write_bytes(data)


K = [[40.0, 0.0, 16.0], [0.0, 41.0, 12.0], [0.0, 0.0, 1.0]]
EYE = np.tile(np.eye(4), (3, 1, 1))

CAMERA, POSE = K, np.eye(4).tolist()


def at_camera(T_world_cam: object) -> Break:
    """Set the camera's pose in the world."""
    return edit_json(camera={"K": CAMERA, "T_world_cam": T_world_cam})


BROKEN: dict[str, tuple[Break, str, tuple[str, ...]]] = {
    # clip.json
    "no clip.json": (removed("clip.json"), "clip.json", ("no such file",)),
    "misnamed clip.json": (renamed("clip.json", "Clip.JSON"), "clip.json", ("no such file",)),
    "empty json": (content("clip.json", ""), "clip.json", ("invalid JSON",)),
    "json list": (content("clip.json", "[1]"), "clip.json", ("a JSON list",)),
    "json no text": (content("clip.json", b"\xff\xfe\x00{"), "clip.json", ("invalid JSON",)),
    "deep json": (content("clip.json", "[" * 10**6), "clip.json", ("invalid JSON",)),
    "deep json object": (content("clip.json", '{"a":' * 10**5), "clip.json", ("invalid JSON",)),
    "endless digits": (replaced('"fps": 30.0', f'"fps": {"9" * 10**4}'), "clip.json", ("invalid JSON",)),
    "a frame in ages": (replaced('"fps": 30.0', '"fps": 1e-299'), "clip.json: fps", ("0.001 to 100000",)),
    "frames in no time": (replaced('"fps": 30.0', '"fps": 1e299'), "clip.json: fps", ("0.001 to 100000",)),
    "NaN in json": (replaced('"fps": 30.0', '"fps": NaN'), "clip.json", ("NaN",)),
    "infinite in json": (replaced('"fps": 30.0', '"fps": 1e999'), "clip.json", ("1e999",)),
    "duplicate key": (replaced('"fps": 30.0', '"fps": 30.0, "fps": 25.0'), "clip.json: fps", ("twice",)),
    "unknown key": (edit_json(colour="red"), "clip.json: colour", ("unknown key",)),
    "unknown key of many lines": (edit_json(**{"a\nb": 1}), "clip.json: a\\nb", ("unknown key",)),
    "missing key": (edit_json(fps=None), "clip.json: missing fps", ()),
    "other version": (edit_json(version=5), "clip.json: version", ("got 5", "must be 1 or 2 or 3 or 4")),
    "segments in version 2": (edit_json(version=2, segments=[]), "clip.json: segments", ("unknown", "version 2")),
    "support in version 2": (
        edit_json(version=2, camera={"K": CAMERA, "T_world_cam": POSE, "world_up": [0, 0, 1], "world_support": 0.0}),
        "clip.json: camera.world_support",
        ("unknown", "version 2"),
    ),
    "support without up": (
        edit_json(camera={"K": CAMERA, "T_world_cam": POSE, "world_support": 0.0}),
        "clip.json: camera.world_support",
        ("world_up",),
    ),
    "support a direction": (
        edit_json(camera={"K": CAMERA, "T_world_cam": POSE, "world_up": [0, 0, 1], "world_support": [0.0]}),
        "clip.json: camera.world_support",
        ("a height [m]",),
    ),
    "support in mm": (
        edit_json(camera={"K": CAMERA, "T_world_cam": POSE, "world_up": [0, 0, 1], "world_support": 1200}),
        "clip.json: camera.world_support",
        ("got 1200",),
    ),
    "times in version 1": (edit_json(version=1, times=[0.0, 0.1, 0.2]), "clip.json: times", ("unknown", "version 1")),
    "poses in version 1": (
        edit_json(version=1, camera={"K": CAMERA, "T_world_cam": POSE}),
        "clip.json: camera.T_world_cam",
        ("unknown", "version 1"),
    ),
    "handle in version 3": (edit_json(version=3, handle=[]), "clip.json: handle", ("unknown", "version 3")),
    "handle of pairs": (edit_json(handle=[[0.0, 0.0]]), "clip.json: handle", ("a list of points", "empty")),
    "handle of texts": (edit_json(handle=["grip"]), "clip.json: handle", ("a list of points",)),
    "handle in mm": (
        edit_json(handle=[[0, 0, 0], [0, 45.0, 60.0]]),
        "clip.json: handle",
        ("[0.0, 45.0, 60.0]", "m in"),
    ),
    "handle of many": (edit_json(handle=[[0.0, 0.0, 0.0]] * 51), "clip.json: handle", ("51 points", "at most 50")),
    "times a number": (edit_json(times=0.1), "clip.json: times", ("a list of numbers",)),
    "times of texts": (edit_json(times=["0", "1", "2"]), "clip.json: times", ("a list of numbers",)),
    "times ragged": (edit_json(times=[0.0, [1.0], 2.0]), "clip.json: times", ("a list of numbers",)),
    "too few times": (edit_json(times=[0.0, 0.1]), "clip.json: times", ("2 numbers", "3 frames")),
    "times stand": (edit_json(times=[0.0, 0.1, 0.1]), "clip.json: times", ("0.1 s in frame '0002'", "rise")),
    "times fall": (edit_json(times=[0.0, 0.1, 0.05]), "clip.json: times", ("0.05 s in frame '0002'", "rise")),
    "times NaN": (replaced('"fps": 30.0', '"fps": 30.0, "times": [0, NaN, 1]'), "clip.json", ("NaN",)),
    "times in ns": (edit_json(times=[0, 3e7, 6e7]), "clip.json: times", ("6e+07 s", "nanoseconds?")),
    "camera pose 3x4": (at_camera(POSE[:3]), "clip.json: camera.T_world_cam", ("4x4",)),
    "camera poses for two": (at_camera([POSE, POSE]), "clip.json: camera.T_world_cam", ("2 matrices", "3 frames")),
    "camera pose ragged": (at_camera([[1.0], [2.0, 3.0]]), "clip.json: camera.T_world_cam", ("4x4",)),
    "camera pose of texts": (at_camera([["a"] * 4] * 4), "clip.json: camera.T_world_cam", ("4x4",)),
    "camera pose vast": (at_camera([[1e300] * 4] * 4), "clip.json: camera.T_world_cam", ("no rigid motion",)),
    "camera pose scaled": (
        at_camera([POSE, POSE, [[1.1, 0, 0, 0], *POSE[1:]]]),
        "clip.json: camera.T_world_cam",
        ("no rigid motion in frame '0002'",),
    ),
    "camera pose transposed": (
        at_camera([POSE, POSE, [*POSE[:3], [1.0, 0.0, 0.0, 1.0]]]),
        "clip.json: camera.T_world_cam",
        ("no rigid motion in frame '0002'",),
    ),
    "camera moves in mm": (
        at_camera([POSE, [[1, 0, 0, 1500], *POSE[1:]], POSE]),
        "clip.json: camera.T_world_cam",
        ("1500 m from its first place in frame '0001'", "millimetres?"),
    ),
    "up without a world": (edit_json(camera={"K": CAMERA, "world_up": [0, 0, 1]}), "camera.world_up", ("T_world_cam",)),
    "up too long": (
        edit_json(camera={"K": CAMERA, "T_world_cam": POSE, "world_up": [0, 0, 2]}),
        "clip.json: camera.world_up",
        ("length 1",),
    ),
    "up a word": (
        edit_json(camera={"K": CAMERA, "T_world_cam": POSE, "world_up": "z"}),
        "clip.json: camera.world_up",
        ("length 1",),
    ),
    "version in words": (edit_json(version="1"), "clip.json: version", ("got '1'",)),
    "version true": (edit_json(version=True), "clip.json: version", ("got True",)),
    "name is a path": (edit_json(name="../small"), "clip.json: name", ("'../small'",)),
    "name unprintable": (edit_json(name="abc\u202egnp"), "clip.json: name", ("'abc\\u202egnp'",)),
    "name half a letter": (edit_json(name="a\ud800"), "clip.json", ("invalid JSON",)),
    "name of 201 bytes": (edit_json(name="\u00e9" * 100 + "a"), "clip.json: name", ()),
    "name empty": (edit_json(name=""), "clip.json: name", ()),
    "name no text": (edit_json(name=5), "clip.json: name", ("got 5",)),
    "category no text": (edit_json(category=["mug"]), "clip.json: category", ()),
    "other side": (edit_json(side="both"), "clip.json: side", ("'both'", "left")),
    "side a list": (edit_json(side=["left"]), "clip.json: side", ()),
    "other scale": (edit_json(scale=1.0), "clip.json: scale", ("known", "free")),
    "fps zero": (edit_json(fps=0), "clip.json: fps", ("got 0",)),
    "fps text": (edit_json(fps="30"), "clip.json: fps", ()),
    "fps huge": (edit_json(fps=10**400), "clip.json: fps", ()),
    "provenance text": (edit_json(provenance="me"), "clip.json: provenance", ()),
    "no frames": (edit_json(frames=[]), "clip.json: frames", ("a list of names",)),
    "frames numbers": (edit_json(frames=[0, 1, 2]), "clip.json: frames", ("a list of names",)),
    "frames a text": (edit_json(frames="012"), "clip.json: frames", ("a list of names",)),
    "frame twice": (edit_json(frames=["0000", "0001", "0000"]), "clip.json: frames", ("'0000' twice",)),
    "frame a path": (edit_json(frames=["0000", "../1", "0002"]), "clip.json: frames", ("'../1'",)),
    "frame with slash": (edit_json(frames=["0000", "a/b", "0002"]), "clip.json: frames", ("'a/b'",)),
    "frame with NUL": (edit_json(frames=["0000", "a\0", "0002"]), "clip.json: frames", ()),
    "too few frames": (edit_json(frames=["0000", "0001"]), "hand.npz: vertices", ("(3, 8, 3)", "(2, any, 3)")),
    "size of one": (edit_json(size=[32]), "clip.json: size", ("width, height",)),
    "size with fraction": (edit_json(size=[32.0, 24]), "clip.json: size", ()),
    "size negative": (edit_json(size=[32, -24]), "clip.json: size", ("-24",)),
    "size huge": (edit_json(size=[10**9, 24]), "clip.json: size", ()),
    "size swapped": (edit_json(size=[24, 32]), "masks/object/0000.png: size", ("32 x 24", "24 x 32")),
    "size of a continent": (edit_json(size=[16384, 16384]), "clip.json: size", ("million pixels",)),
    "frames many times": (edit_json(frames=["0000", *["0001"] * 10**5]), "clip.json: frames", ("'0001' twice",)),
    "camera a list": (edit_json(camera=[1]), "clip.json: camera", ("3x3",)),
    "camera with more": (edit_json(camera={"K": K, "k1": 0.1}), "clip.json: camera", ()),
    "K for two frames": (edit_json(camera={"K": [K, K]}), "clip.json: camera.K", ("2 matrices", "3 frames")),
    "K ragged": (edit_json(camera={"K": [[1, 2], [3]]}), "clip.json: camera.K", ("3x3",)),
    "K text": (edit_json(camera={"K": "pinhole"}), "clip.json: camera.K", ("3x3",)),
    "K of texts": (edit_json(camera={"K": [["a"] * 3] * 3}), "clip.json: camera.K", ("3x3",)),
    "K of booleans": (edit_json(camera={"K": [[True] * 3] * 3}), "clip.json: camera.K", ("3x3",)),
    "K too deep": (edit_json(camera={"K": [[K]]}), "clip.json: camera.K", ("3x3",)),
    "focal zero": (edit_json(camera={"K": [[0, 0, 16], *K[1:]]}), "clip.json: camera.K", ("focal", "got")),
    "focal negative": (edit_json(camera={"K": [[-40, 0, 16], *K[1:]]}), "clip.json: camera.K", ("-40",)),
    "focal of unit images": (
        edit_json(camera={"K": [[0.9, 0, 0.5], [0, 0.9, 0.5], K[2]]}),
        "camera.K",
        ("0.9", "1.6 to 3200 px"),
    ),
    "focal tiny": (edit_json(camera={"K": [[40, 0, 16], [0, 1, 12], K[2]]}), "clip.json: camera.K", ("32 x 24",)),
    "focal vast": (edit_json(camera={"K": [[1e5, 0, 16], *K[1:]]}), "clip.json: camera.K", ("100000", "3200")),
    "centre far": (edit_json(camera={"K": [[40, 0, 1e6], *K[1:]]}), "clip.json: camera.K", ("1e+06, 12", "-32 to 64")),
    "centre beyond": (edit_json(camera={"K": [[40, 0, -33], *K[1:]]}), "clip.json: camera.K", ("-33, 12",)),
    "centre of one": (
        edit_json(camera={"K": [K, K, [K[0], [0, 41, 49], K[2]]]}),
        "clip.json: camera.K",
        ("principal point 16, 49", "-24 to 48"),
    ),
    "K transposed": (edit_json(camera={"K": np.transpose(K).tolist()}), "clip.json: camera.K", ("[0, 0, 1]",)),
    "K with shear": (edit_json(camera={"K": [[40, 2, 16], *K[1:]]}), "clip.json: camera.K", ("without shear",)),
    # the mesh
    "mesh missing": (removed("object.obj"), "object.obj: mesh", ("no such file",)),
    "mesh misnamed": (edit_json(mesh="cup.obj"), "cup.obj: mesh", ("no such file",)),
    "mesh elsewhere": (edit_json(mesh="../object.obj"), "clip.json: mesh", ("'../object.obj'", "inside")),
    "mesh absolute": (edit_json(mesh="/etc/passwd"), "clip.json: mesh", ("'/etc/passwd'", "inside")),
    "mesh backslash": (edit_json(mesh="..\\object.obj"), "clip.json: mesh", ("inside",)),
    "mesh NUL": (edit_json(mesh="a\0.obj"), "clip.json: mesh", ("inside",)),
    "mesh endless": (edit_json(mesh="a" * 5000 + ".obj"), "clip.json: mesh", ()),
    "mesh a folder": (edit_json(mesh="masks"), "mesh", ("no such file",)),
    "mesh other suffix": (edit_json(mesh="clip.json"), "clip.json: mesh", (".obj",)),
    "mesh no text": (edit_json(mesh=7), "clip.json: mesh", ()),
    "mesh link": (linked_out("object.obj"), "clip.json: mesh", ("leads out",)),
    "mesh no faces": (content("object.obj", "v 0 0 0\nv 1 0 0\n"), "object.obj", ("faces",)),
    "mesh empty": (content("object.obj", ""), "object.obj", ()),
    "mesh flat face": (
        content("object.obj", "v 0 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 3\nf 1 2 2\n"),
        "object.obj: faces",
        ("1 faces without area",),
    ),
    "mesh NaN": (content("object.obj", "v nan 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 3\n"), "object.obj: vertices", ("NaN",)),
    "mesh in millimetres": (
        content("object.obj", "v 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 2 3\n"),
        "object.obj: vertices",
        ("are these millimetres?",),
    ),
    "mesh tiny": (
        content("object.obj", "v 0 0 0\nv .001 0 0\nv 0 .001 0\nf 1 2 3\n"),
        "object.obj: vertices",
        ("metre",),
    ),
    # hand.npz
    "hand missing": (removed("hand.npz"), "hand.npz", ("no such file",)),
    "hand no zip": (content("hand.npz", "hello"), "hand.npz", ("does not unpack",)),
    "hand link": (linked_out("hand.npz"), "hand.npz", ("leads out",)),
    "hand bomb": (bomb, "hand.npz", ("4294967280 bytes", "at most")),
    "hand header lies": (header_lies, "hand.npz: vertices", ("64 bytes for the shape",)),
    "hand of objects": (edit_npz("hand.npz", vertices=np.array([None])), "hand.npz: vertices", ("Python objects",)),
    "hand of texts": (edit_npz("hand.npz", vertices=np.array(["a"])), "hand.npz: vertices", ("<U1", "floating")),
    "hand complex": (edit_npz("hand.npz", vertices=lambda v: v + 1j), "hand.npz: vertices", ("complex128",)),
    "hand integers": (edit_npz("hand.npz", T_cam_hand=EYE.astype(int)), "hand.npz: T_cam_hand", ("int64",)),
    "no vertices": (edit_npz("hand.npz", vertices=None), "hand.npz: missing vertices", ()),
    "no faces": (edit_npz("hand.npz", faces=None), "hand.npz: missing faces", ()),
    "no poses": (edit_npz("hand.npz", T_cam_hand=None), "hand.npz: missing T_cam_hand", ()),
    "hand flat": (edit_npz("hand.npz", vertices=lambda v: v[0]), "hand.npz: vertices", ("(8, 3)",)),
    "hand of no vertices": (edit_npz("hand.npz", vertices=lambda v: v[:, :0]), "hand.npz: vertices", ("(3, 0, 3)",)),
    "hand NaN": (edit_npz("hand.npz", vertices=at((1, 2, 0), np.nan)), "hand.npz: vertices", ("NaN", "[1, 2, 0]")),
    "hand infinite": (edit_npz("hand.npz", vertices=at((1, 2, 0), np.inf)), "hand.npz: vertices", ("infinite",)),
    "hand in mm": (edit_npz("hand.npz", vertices=lambda v: 1e3 * v), "hand.npz: vertices", ("are these millimetres?",)),
    "hand tiny": (edit_npz("hand.npz", vertices=lambda v: 1e-3 * v), "hand.npz: vertices", ("metre",)),
    "faces of floats": (edit_npz("hand.npz", faces=lambda f: f.astype(float)), "hand.npz: faces", ("float64",)),
    "faces of four": (edit_npz("hand.npz", faces=lambda f: np.c_[f, f[:, :1]]), "hand.npz: faces", ("(12, 4)",)),
    "faces beyond": (edit_npz("hand.npz", faces=at((3, 1), 8)), "hand.npz: faces", ("vertex id 8", "0 to 7")),
    "faces negative": (edit_npz("hand.npz", faces=at((3, 1), -1)), "hand.npz: faces", ("vertex id -1",)),
    "faces of two": (edit_npz("hand.npz", faces=at((3, 1), 5)), "hand.npz: faces", ("1 faces with a vertex twice",)),
    "faces inward": (edit_npz("hand.npz", faces=lambda f: f[:, ::-1]), "hand.npz: faces", ("inward",)),
    "poses of 3x4": (edit_npz("hand.npz", T_cam_hand=lambda T: T[:, :3]), "hand.npz: T_cam_hand", ("(3, 3, 4)",)),
    "poses scaled": (edit_npz("hand.npz", T_cam_hand=at((1, 0, 0), 1.1)), "hand.npz: T_cam_hand", ("rigid", "frame 1")),
    "poses mirrored": (edit_npz("hand.npz", T_cam_hand=at((1, 0, 0), -1)), "hand.npz: T_cam_hand", ("rigid",)),
    "poses huge": (edit_npz("hand.npz", T_cam_hand=at((1, 0, 0), 1e300)), "hand.npz: T_cam_hand", ("rigid",)),
    "poses transposed": (
        edit_npz("hand.npz", T_cam_hand=lambda T: T.swapaxes(1, 2)),
        "hand.npz: T_cam_hand",
        ("rigid", "frame 0"),
    ),
    "hand behind": (
        edit_npz("hand.npz", T_cam_hand=at((2, 2, 3), -0.5)),
        "hand.npz: T_cam_hand",
        ("behind", "frame 2", "inverse"),
    ),
    "hand in the camera": (edit_npz("hand.npz", T_cam_hand=at((1, 2, 3), 0.02)), "T_cam_hand", ("at least 0.05 m",)),
    "hand in the camera's frame": (
        edit_npz("hand.npz", vertices=lambda v: v + np.array([0.0, 0.0, 0.5])),
        "hand.npz: vertices",
        ("0.5 m from the origin", "are these camera coordinates", "apply again"),
    ),
    "joints in the camera's frame": (
        edit_npz("hand.npz", joints=lambda j: j + np.array([0.0, 0.0, 0.5])),
        "hand.npz: joints",
        ("are these camera coordinates",),
    ),
    "hand never in view": (
        edit_npz("hand.npz", T_cam_hand=lambda T: T + 0.9 * at((slice(None), 0, 3), 1)(np.zeros_like(T))),
        "hand.npz: T_cam_hand",
        ("outside the image in every frame", "32 x 24", "camera"),
    ),
    "hand far away": (edit_npz("hand.npz", T_cam_hand=at((2, 2, 3), 500)), "hand.npz: T_cam_hand", ("millimetres?",)),
    "joints of 20": (edit_npz("hand.npz", joints=lambda j: j[:, :20]), "hand.npz: joints", ("(3, 20, 3)",)),
    "joints NaN": (edit_npz("hand.npz", joints=at((0, 0, 0), np.nan)), "hand.npz: joints", ("NaN",)),
    "region missing": (edit_npz("hand.npz", region_ring=None), "hand.npz: region_ring", ("vertex ids",)),
    "region beyond": (edit_npz("hand.npz", region_ring=np.array([8])), "hand.npz: region_ring", ("vertex id 8",)),
    "region empty": (edit_npz("hand.npz", region_ring=np.array([], int)), "hand.npz: region_ring", ("(0,)",)),
    "region of floats": (edit_npz("hand.npz", region_ring=np.array([1.0])), "hand.npz: region_ring", ("integers",)),
    "region flags": (edit_npz("hand.npz", region_ring=np.ones(8, bool)), "hand.npz: region_ring", ("bool",)),
    "region without end": (
        edit_npz("hand.npz", region_ring=np.zeros(100, np.uint8)),
        "hand.npz: region_ring",
        ("100 vertex ids", "at most 64 for 8 vertices"),
    ),
    "palms without end": (
        edit_npz("hand.npz", **{f"region_palm_{n}": np.zeros(1, int) for n in range(100)}),
        "hand.npz: region_palm_...",
        ("101 regions", "at most 100"),
    ),
    "palm beyond": (edit_npz("hand.npz", region_palm_edge=np.array([99])), "hand.npz: region_palm_edge", ("99",)),
    "bare mesh": (
        edit_npz(
            "hand.npz", **{f"region_{f}": None for f in ("thumb", "index", "middle", "ring", "pinky", "palm_edge")}
        ),
        "hand.npz: region_thumb",
        ("region_thumb", "region_pinky", "vertex ids"),
    ),
    # truth.npz
    "truth no zip": (content("truth.npz", "hello"), "truth.npz", ("does not unpack",)),
    "truth without object": (edit_npz("truth.npz", T_cam_obj=None), "truth.npz: missing T_cam_obj", ()),
    "truth not rigid": (edit_npz("truth.npz", T_cam_obj=at((0, 0, 0), 2)), "truth.npz: T_cam_obj", ("rigid",)),
    "truth in mm": (edit_npz("truth.npz", T_cam_obj=at((0, 2, 3), 500)), "truth.npz: T_cam_obj", ("millimetres?",)),
    "truth behind": (edit_npz("truth.npz", T_cam_obj=at((0, 2, 3), -1)), "truth.npz: T_cam_obj", ("behind",)),
    "truth short": (edit_npz("truth.npz", T_cam_obj=EYE[:2]), "truth.npz: T_cam_obj", ("(2, 4, 4)",)),
    "truth scale zero": (edit_npz("truth.npz", scale=np.array(0.0)), "truth.npz: scale", ("above 0",)),
    "truth scale many": (edit_npz("truth.npz", scale=np.ones(3)), "truth.npz: scale", ("(3,)",)),
    "truth scale huge": (edit_npz("truth.npz", scale=np.array(1e3)), "truth.npz: scale", ("millimetres?",)),
    "truth hand": (
        edit_npz("truth.npz", hand_vertices=np.zeros((3, 5, 3))),
        "truth.npz: hand_vertices",
        ("(3, 8, 3)",),
    ),
    "truth hand not rigid": (edit_npz("truth.npz", T_cam_hand=2 * EYE), "truth.npz: T_cam_hand", ("rigid",)),
    # masks
    "ignore mask missing": (removed("masks/ignore/0001.png"), "masks/ignore/0001.png", ("no such file",)),
    "mask link": (linked_out("masks/object/0001.png"), "masks/object/0001.png", ("leads out",)),
    "mask no image": (content("masks/object/0001.png", "hello"), "masks/object/0001.png", ("no PNG",)),
    "mask empty file": (content("masks/object/0001.png", ""), "masks/object/0001.png", ("no PNG",)),
    "mask of colours": (mask(lambda m: np.stack([m] * 3, -1)), "masks/object/0001.png: channels", ("8 bit RGB",)),
    "mask of 16 bit": (mask(lambda m: m.astype(np.uint16)), "masks/object/0001.png: channels", ("16 bit grey",)),
    "mask small": (mask(lambda m: m[::2]), "masks/object/0001.png: size", ("32 x 12", "32 x 24")),
    "mask bomb": (png_bomb, "masks/object/0001.png: size", ("60000 x 60000",)),
    "ignore missing": (removed("masks/ignore/0001.png"), "masks/ignore/0001.png", ("no such file",)),
    "ignore small": (mask(lambda m: m[::2], "ignore"), "masks/ignore/0001.png: size", ("32 x 12",)),
    "object never seen": (no_object, "masks/object", ("3 masks without a pixel",)),
}
