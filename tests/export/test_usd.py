"""USD: what Pixar's own library reads back is the scene that was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.export import Scene, export
from getagrip.export.scene import StageFrame
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.io import plugins
from helpers.environment import needs_library

pytestmark = needs_library("pxr", "usd")


@pytest.mark.slow
def test_usd_reads_back_every_pose_and_point(both: Scene, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    scene = both

    stage = Usd.Stage.Open(str(export(scene, tmp_path / "out", "usd") / "scene.usdc"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    codes = (scene.time - scene.time[0]) * scene.fps
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == pytest.approx((0.0, codes[-1]))
    assert stage.GetTimeCodesPerSecond() == scene.fps
    on_stage = StageFrame.of(scene)
    T_stage_obj, T_stage_hand = on_stage.poses(scene)
    root = stage.GetDefaultPrim()
    for n, code in enumerate(codes):
        cache = UsdGeom.XformCache(code)

        def posed(path: str, code: float = code, cache: object = cache) -> ndarray:
            prim = stage.GetPrimAtPath(path)
            points = np.array(UsdGeom.PointBased(prim).GetPointsAttr().Get(code), dtype=float)
            return se3.transform(np.array(cache.GetLocalToWorldTransform(prim)).T, points)

        held = se3.transform(T_stage_obj[n], scene.object.vertices)
        np.testing.assert_allclose(posed("/clip/object/mesh"), held, atol=1e-6)
        for hand in scene.hands:
            true = se3.transform(on_stage.T_stage_cam[n] @ hand.T_cam_hand[n], hand.vertices[n])
            np.testing.assert_allclose(posed(f"/clip/{hand.name}/mesh"), true, atol=1e-6)
            seen = UsdGeom.Imageable(stage.GetPrimAtPath(f"/clip/{hand.name}/mesh")).ComputeVisibility(code)
            assert seen == ("inherited" if hand.known[n] else "invisible")
        joints = se3.transform(T_stage_hand[n], scene.joints[n])
        np.testing.assert_allclose(posed("/clip/hand/joints"), joints, atol=1e-6)
        for name, T in scene.poses.items():
            np.testing.assert_allclose(np.array(root.GetAttribute(name).Get(code)).T, T[n], atol=1e-12)
        assert root.GetAttribute("frame_kind").Get(code) == scene.frame_kind[n]
        assert root.GetAttribute("time_s").Get(code) == scene.time[n]
        # Through USD's camera, points fall on the pixels that the clip's camera gives them.
        frustum = UsdGeom.Camera(stage.GetPrimAtPath("/clip/camera")).GetCamera(code).frustum
        M = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
        clip = np.c_[held, np.ones(len(held))] @ M
        ndc = clip[:, :2] / clip[:, 3:]
        width, height = scene.size
        uv = np.stack([(ndc[:, 0] + 1.0) / 2.0 * width, (1.0 - ndc[:, 1]) / 2.0 * height], axis=1)
        in_camera = se3.transform(scene.T_cam_obj[n], scene.object.vertices)
        np.testing.assert_allclose(uv, project(scene.K[n : n + 1], in_camera[None])[0], atol=1e-3)
    assert UsdGeom.Mesh(stage.GetPrimAtPath("/clip/object/mesh")).GetSubdivisionSchemeAttr().Get() == "none"
    assert "the scale is a guess" in root.GetCustomDataByKey("getagrip:notes")


def test_an_object_keeps_its_own_colours(scene: Scene, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    colours = np.tile(np.array([255, 188, 0], np.uint8), (len(scene.object.vertices), 1))
    painted = replace(scene, object=replace(scene.object, colours=colours))
    stage = Usd.Stage.Open(str(export(painted, tmp_path / "out", "usd") / "scene.usdc"))
    shown = UsdGeom.Mesh(stage.GetPrimAtPath("/clip/object/mesh")).GetDisplayColorPrimvar()
    assert shown.GetInterpolation() == "vertex"
    np.testing.assert_allclose(np.array(shown.Get()), np.tile([1.0, 0.5, 0.0], (len(colours), 1)), atol=5e-3)


def test_without_usd_it_says_what_to_install(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(plugins.importlib, "import_module", missing)
    with pytest.raises(UsageError, match=r"missing module 'pxr.Usd'.*--to usd needs it; pip install "):
        export(scene, tmp_path / "out", "usd")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_principal_point_off_the_middle_is_kept(scene: Scene, tmp_path: Path) -> None:
    K = scene.K.copy()
    K[:, :2, 2] += [3.0, -2.0]
    test_usd_reads_back_every_pose_and_point(replace(scene, K=K, world=None), tmp_path)
