"""USD: one binary file with time-sampled transforms of object and hands, and time-sampled points of the hands.

The stage is in metres (``metersPerUnit`` 1) with ``upAxis`` Z. Time codes are seconds times ``timeCodesPerSecond``, the
first frame at 0. USD multiplies row vectors with matrices: its matrices are the transposes of ``T_a_b``. Its cameras
look along -z with y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.export.scene import (
    HAND_COLOUR,
    OBJECT_COLOUR,
    ExportedHand,
    ExportedView,
    Scene,
    StageFrame,
    linear_colours,
)
from getagrip.io import plugins

if TYPE_CHECKING:
    from pxr import Gf, Usd, UsdGeom, Vt

USD_FILE = "scene.usdc"
USD_CAMERA_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""From USD's camera axes to this package's."""
CAMERA_APERTURE = 20.955
"""Width of a camera's image in tenths of a unit: USD's default, since any width will do."""


def _pxr(module: str) -> ModuleType:
    return plugins.import_extra(f"pxr.{module}", "usd")


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.usdc``. Raises ``UsageError`` without usd-core."""
    Usd, UsdGeom = _pxr("Usd"), _pxr("UsdGeom")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(scene.fps)
    stage.SetFramesPerSecond(scene.fps)
    codes = [float(code) for code in (scene.time - scene.time[0]) * scene.fps]
    stage.SetStartTimeCode(codes[0])
    stage.SetEndTimeCode(codes[-1])
    on_stage = StageFrame.of(scene)
    root = UsdGeom.Xform.Define(stage, "/clip").GetPrim()
    stage.SetDefaultPrim(root)
    _write_metadata(root, scene, on_stage, codes)
    T_stage_obj, _ = on_stage.poses(scene)
    _add_animated_transform(stage, "/clip/object", T_stage_obj, codes)
    mesh, colours, always = scene.object, linear_colours(scene.object), [Usd.TimeCode.Default()]
    shown = _add_mesh(stage, "/clip/object/mesh", mesh.faces, OBJECT_COLOUR, mesh.vertices[None], always)
    if colours is not None:
        shown.CreateDisplayColorAttr(_usd_points(colours))
        shown.GetDisplayColorPrimvar().SetInterpolation(UsdGeom.Tokens.vertex)
    for hand in scene.hands:
        _add_usd_hand(stage, hand, np.asarray(on_stage.T_stage_cam @ hand.T_cam_hand), codes)
    if scene.views:
        UsdGeom.Scope.Define(stage, "/clip/views")
    for k, camera in enumerate(scene.cameras):
        path = "/clip/camera" if k == 0 else f"/clip/views/{_pxr('Tf').MakeValidIdentifier(camera.name)}"
        path += f"_{k}" * bool(stage.GetPrimAtPath(path))  # names that differ in what no identifier has
        _add_camera(stage, path, camera, np.asarray(on_stage.T_stage_cam @ camera.T_cam_view), codes)
    if not stage.GetRootLayer().Export(str(folder / USD_FILE)):
        raise OSError(f"{folder / USD_FILE}: USD could not write it")
    hands = " and ".join(f"/clip/{hand.name}" for hand in scene.hands)
    cameras = "/clip/camera" + " and those of /clip/views" * bool(scene.views)
    return {
        USD_FILE: f"USD: {on_stage.words}; /clip/object and {hands} with time-sampled transforms, a hand's points and "
        f"joints in its own frame, {cameras}; /clip has T_cam_obj and the like (transposed, as in USD)"
    }


def _write_metadata(root: Usd.Prim, scene: Scene, on_stage: StageFrame, codes: list[float]) -> None:
    """Write notes and, sampled in time, names and kinds of frames, times and all poses."""
    Sdf = _pxr("Sdf")
    notes = {"clip": scene.name, "method": scene.method, "frame": on_stage.words, "notes": "\n".join(scene.notes)}
    root.SetCustomData({"getagrip": {key: text.replace("\0", " ") for key, text in notes.items()}})
    for name, values in {"frame": scene.frames, "frame_kind": scene.frame_kind}.items():
        attribute = root.CreateAttribute(name, Sdf.ValueTypeNames.String)
        for code, value in zip(codes, values, strict=True):
            attribute.Set(value.replace("\0", " "), code)
    seconds = root.CreateAttribute("time_s", Sdf.ValueTypeNames.Double)
    for code, time in zip(codes, scene.time, strict=True):
        seconds.Set(float(time), code)
    for name, T in scene.poses.items():
        attribute = root.CreateAttribute(name, Sdf.ValueTypeNames.Matrix4d)
        for code, matrix in zip(codes, T, strict=True):
            attribute.Set(_usd_matrix(matrix), code)


def _add_animated_transform(stage: Usd.Stage, path: str, T: Float[ndarray, "T 4 4"], codes: list[float]) -> None:
    op = _pxr("UsdGeom").Xform.Define(stage, path).AddTransformOp()
    for code, matrix in zip(codes, T, strict=True):
        op.Set(_usd_matrix(matrix), code)


def _add_usd_hand(
    stage: Usd.Stage, hand: ExportedHand, T_stage_hand: Float[ndarray, "T 4 4"], codes: list[float]
) -> None:
    """Add a hand's transform, mesh and joints; invisible in frames without the hand."""
    UsdGeom, path = _pxr("UsdGeom"), f"/clip/{hand.name}"
    _add_animated_transform(stage, path, T_stage_hand, codes)
    _add_mesh(stage, f"{path}/mesh", hand.faces, HAND_COLOUR, hand.vertices, codes)
    if hand.joints is not None:
        joints = UsdGeom.Points.Define(stage, f"{path}/joints")
        joints.CreateWidthsAttr([0.006] * hand.joints.shape[1])
        joints.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        for code, points in zip(codes, hand.joints, strict=True):
            joints.CreatePointsAttr().Set(_usd_points(points), code)
    if not hand.known.all():
        seen = UsdGeom.Imageable(stage.GetPrimAtPath(path)).CreateVisibilityAttr()
        for code, known in zip(codes, hand.known, strict=True):
            seen.Set(UsdGeom.Tokens.inherited if known else UsdGeom.Tokens.invisible, code)


def _add_mesh(
    stage: Usd.Stage,
    path: str,
    faces: Int[ndarray, "F 3"],
    colour: tuple[float, float, float],
    vertices: Float[ndarray, "T V 3"],
    codes: Sequence[float | Usd.TimeCode],
) -> UsdGeom.Mesh:
    UsdGeom, Vt = _pxr("UsdGeom"), _pxr("Vt")
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    mesh.CreateDisplayColorAttr([colour])
    for code, points in zip(codes, vertices, strict=True):
        mesh.CreatePointsAttr().Set(_usd_points(points), code)
        mesh.CreateExtentAttr().Set(_usd_points(np.stack([points.min(axis=0), points.max(axis=0)])), code)
    return mesh


def _add_camera(
    stage: Usd.Stage, path: str, seen: ExportedView, T_stage_cam: Float[ndarray, "T 4 4"], codes: list[float]
) -> None:
    """Add a camera: apertures in tenths of a unit for the image's width and height."""
    UsdGeom, Gf = _pxr("UsdGeom"), _pxr("Gf")
    camera = UsdGeom.Camera.Define(stage, path)
    move = camera.AddTransformOp()
    width, height = seen.size
    pixel = CAMERA_APERTURE / width  # square in USD: the image's height absorbs the ratio of the focal lengths
    camera.CreateHorizontalApertureAttr(CAMERA_APERTURE)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01, 100.0))
    for code, T, K in zip(codes, T_stage_cam @ USD_CAMERA_AXES, seen.K, strict=True):
        move.Set(_usd_matrix(T), code)
        camera.CreateFocalLengthAttr().Set(float(K[0, 0] * pixel), code)
        tall = pixel * K[0, 0] / K[1, 1]
        camera.CreateVerticalApertureAttr().Set(float(height * tall), code)
        camera.CreateHorizontalApertureOffsetAttr().Set(float((width / 2.0 - K[0, 2]) * pixel), code)
        camera.CreateVerticalApertureOffsetAttr().Set(float((K[1, 2] - height / 2.0) * tall), code)


def _usd_points(points: Float[ndarray, "V 3"]) -> Vt.Vec3fArray:
    return _pxr("Vt").Vec3fArray.FromNumpy(np.ascontiguousarray(points, dtype=np.float32))


def _usd_matrix(T: Float[ndarray, "4 4"]) -> Gf.Matrix4d:
    return _pxr("Gf").Matrix4d(np.ascontiguousarray(T.T))
