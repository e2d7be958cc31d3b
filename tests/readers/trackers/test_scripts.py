"""The scripts for the trackers' own environments, with stand-ins for networks, write files that the importer reads."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from getagrip.clip import FINGERS
from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.model import PALM_REGIONS, Side
from getagrip.io import arrays
from getagrip.io.images import read_mask
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.hamer import HaMeR
from helpers.environment import ROOT
from helpers.hand_files import FRAMES, SIDES, K, Known, hamer_record, request, write_npz

SCRIPTS = ROOT / "scripts" / "estimators"


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_scripts_write_what_the_importer_makes(tmp_path: Path, mano_folder: Path, side: Side) -> None:
    """The hand file that the estimators' scripts write, in plain numpy, is that of ``import hands``."""
    known = Known(side, mano_folder)
    spec = importlib.util.spec_from_file_location("hand_file", SCRIPTS / "hand_file.py")
    assert spec is not None
    assert spec.loader is not None
    hand_file = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hand_file)
    records = [hamer_record(known, n, "crop") for n in range(3)]
    paths = [write_npz(tmp_path / f"{name}.npz", r) for name, r in zip(FRAMES, records, strict=True)]
    expected = read_tracked_hands(paths, HaMeR(), request(side, mano_folder)).track
    right = mano.load(mano_folder / "MANO_RIGHT.pkl", "right").model
    vertices, joints, poses = [], [], []
    for n, record in enumerate(records):
        R, fingers = known.raw(n)
        shaped = right.with_shape(known.betas[n])
        posed = shaped.with_pose(se3.log_so3(fingers).reshape(45))
        root = shaped.joints[0]
        t = hand_file.translation(record["pred_cam"], record["box_center"], record["box_size"], K)
        seen = [(x - root) @ R.T + root for x in (posed.vertices, posed.joints)]
        flat, T = hand_file.hand_frame(seen[0], root, R, t, side)
        vertices.append(flat)
        joints.append(hand_file.hand_frame(seen[1], root, R, t, side)[0])
        poses.append(T)
    regions = hand_file.contact_regions(right.template, right.joints, right.faces, right.weights)
    path = tmp_path / "hand.npz"
    hand_file.write(path, vertices, joints, poses, right.faces, regions, side, [7, 8, 9], K, "known")
    written = arrays.read(path, lambda _: True)  # the synthetic faces are no surface's, so not by read_hand
    for field in ("vertices", "T_cam_hand", "joints", "faces"):
        np.testing.assert_allclose(written[field], getattr(expected, field), atol=1e-6)
    hand = generic.load("right")  # a surface, on which normals weighted by area and by angle agree
    regions = mano.mano_contact_regions(hand.template, hand.faces, hand.joints, hand.weights)
    by_script = hand_file.contact_regions(hand.template, hand.joints, hand.faces, hand.weights)
    assert set(by_script) == set(regions) == {*FINGERS, *PALM_REGIONS} == {*expected.regions}
    for name, ids in regions.items():
        assert f"region_{name}" in written
        both = np.intersect1d(by_script[name], ids)
        assert len(both) > 0.9 * max(len(by_script[name]), len(ids)) > 0


SIZE = (160, 120)
IMAGE_NAMES = ("000007", "000008", "000009")
OBJECT = (100.0, 40.0, 40.0, 40.0)
"""Left, top, width and height."""
CAMERA = ("--K", "200", "200", "80", "60")
AT, FAR = [90.0, 30.0, 130.0, 70.0], [5.0, 5.0, 75.0, 95.0]
"""Hands: at the object, and a larger one beside it."""


class Tensor(np.ndarray):
    """An array with the methods of tensors that the scripts use."""

    def cpu(self) -> Tensor:
        return self

    detach = cpu

    def numpy(self) -> np.ndarray:
        return np.asarray(self)


def tensor(value: object) -> Tensor:
    return np.asarray(value, dtype=float).view(Tensor)


@pytest.fixture
def frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of images; ``torch`` without a GPU is in reach."""
    cuda = SimpleNamespace(is_available=lambda: False)
    data = SimpleNamespace(DataLoader=lambda dataset, batch_size: [dataset.batch])
    torch = SimpleNamespace(
        cuda=cuda, device=str, float32="float32", bfloat16="bfloat16", no_grad=nullcontext,
        inference_mode=nullcontext, autocast=lambda device, dtype: nullcontext(), utils=SimpleNamespace(data=data),
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.syspath_prepend(str(SCRIPTS))
    (tmp_path / "images").mkdir()
    for n, name in enumerate(IMAGE_NAMES):
        cv2.imwrite(str(tmp_path / "images" / f"{name}.jpg"), np.full((*SIZE[::-1], 3), 10 * n, np.uint8))
    return tmp_path / "images"


def package(monkeypatch: pytest.MonkeyPatch, name: str, **content: object) -> None:
    """Put a module in reach, with the packages that it is in."""
    parts = name.split(".")
    for n in range(1, len(parts) + 1):
        whole = ".".join(parts[:n])
        module = sys.modules.get(whole) or ModuleType(whole)
        module.__dict__.setdefault("__path__", [])
        monkeypatch.setitem(sys.modules, whole, module)
    sys.modules[name].__dict__.update(content)


def run(monkeypatch: pytest.MonkeyPatch, script: str, *words: object) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"script_{script}", SCRIPTS / f"{script}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(sys, "argv", [script, *map(str, words)])
    module.main()
    return module


def disc(n: int) -> np.ndarray:
    return np.asarray(np.indices(SIZE[::-1])[1] > 60 + 10 * n)


def test_sam2_runs_without_a_gpu_and_keeps_frames_in_memory(frames: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class SAM2VideoPredictor:
        @classmethod
        def from_pretrained(cls, model_id: str, device: str = "cuda", **kwargs: object) -> SAM2VideoPredictor:
            assert (model_id, device) == ("facebook/sam2.1-hiera-large", "cpu")
            return cls()

        def init_state(
            self, video_path: str, offload_video_to_cpu: bool = False, offload_state_to_cpu: bool = False
        ) -> str:
            assert offload_video_to_cpu
            return video_path

        def add_new_points_or_box(self, inference_state: str, frame_idx: int, obj_id: int, box: np.ndarray) -> None:
            assert frame_idx == 0
            assert box.tolist() == [100.0, 40.0, 140.0, 80.0]

        def propagate_in_video(self, inference_state: str) -> Iterator[tuple[int, list[int], Tensor]]:
            for n in range(len(IMAGE_NAMES)):
                yield n, [1], tensor(np.where(disc(n), 3.0, -3.0)[None, None])

    package(monkeypatch, "sam2.sam2_video_predictor", SAM2VideoPredictor=SAM2VideoPredictor)
    run(monkeypatch, "sam_masks", "sam2", frames, "--box", *OBJECT, "--out", frames.parent / "out")
    for n, name in enumerate(IMAGE_NAMES):
        np.testing.assert_array_equal(read_mask(frames.parent / "out" / f"{name}.png", SIZE).unpacked, disc(n))


@pytest.mark.parametrize("text", [None, "mug", "unseen"])
def test_sam3_is_shown_the_box_beside_the_word(frames: Path, monkeypatch: pytest.MonkeyPatch, text: str | None) -> None:
    class Predictor:
        def __init__(self) -> None:
            self.prompts: list[dict[str, Any]] = []

        def handle_request(self, request: dict[str, Any]) -> dict[str, Any]:
            if request["type"] == "start_session":
                assert request["offload_video_to_cpu"]
                return {"session_id": "it"}
            self.prompts.append(request)
            assert (request["type"], request["frame_index"]) == ("add_prompt", 0)
            (box,), (label,) = request["bounding_boxes"], request["bounding_box_labels"]
            np.testing.assert_allclose(box, [0.625, 1 / 3, 0.25, 1 / 3])
            assert label == 1
            found = 0 if request.get("text") == "unseen" else 2
            masks = np.stack([disc(0), disc(5)])[:found]
            return {"frame_index": 0, "outputs": {"out_obj_ids": np.array([4, 9])[:found], "out_binary_masks": masks}}

        def handle_stream_request(self, request: dict[str, Any]) -> Iterator[dict[str, Any]]:
            for n in range(len(IMAGE_NAMES)):
                outputs = {"out_obj_ids": np.array([4, 9]), "out_binary_masks": np.stack([disc(9), disc(n)])}
                yield {"frame_index": n, "outputs": outputs}

    predictor = Predictor()
    package(monkeypatch, "sam3.model_builder", build_sam3_video_predictor=lambda: predictor)
    words = () if text is None else ("--text", text)
    run(monkeypatch, "sam_masks", "sam3", frames, "--box", *OBJECT, *words, "--out", frames.parent / "out")
    asked = [prompt.get("text") for prompt in predictor.prompts]
    assert asked == ([text, None] if text == "unseen" else [text])
    np.testing.assert_array_equal(read_mask(frames.parent / "out" / f"{IMAGE_NAMES[2]}.png", SIZE).unpacked, disc(2))


def test_sam3_needs_a_box_or_a_word(frames: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package(monkeypatch, "sam3.model_builder", build_sam3_video_predictor=lambda: None)
    with pytest.raises(SystemExit, match="needs --box or --text"):
        run(monkeypatch, "sam_masks", "sam3", frames, "--out", frames.parent / "out")


MANO = SimpleNamespace(
    v_template=tensor(np.random.default_rng(0).normal(0.0, 0.03, (778, 3))),
    J_regressor=tensor(np.random.default_rng(1).dirichlet(np.ones(778), 16)),
    lbs_weights=tensor(np.eye(16)[np.arange(778) % 16]),
    faces=np.arange(777).reshape(259, 3),
)


def near(frames: Path) -> Path:
    x, y, w, h = OBJECT
    path = frames.parent / "near.json"
    path.write_text(json.dumps({IMAGE_NAMES[0]: [x, y, x + w, y + h]}))
    return path


def output(right: float, x: float) -> dict[str, np.ndarray]:
    mirror = np.array([2.0 * right - 1.0, 1.0, 1.0])
    return {
        "pred_cam_t_full": np.array([[x / 100.0, 0.0, 5.0]]), "scaled_focal_length": np.array(1000.0),
        "global_orient": np.zeros((1, 1, 3)), "pred_keypoints_3d": np.ones((1, 21, 3)) * mirror,
        "pred_vertices": np.asarray(MANO.v_template)[None] * mirror,
    }  # fmt: skip


class WiLoR:
    """Two hands; the one at the object is seen as the other side's in one image."""

    wilor_model = SimpleNamespace(mano=MANO)

    def __init__(self, **kwargs: object) -> None:
        assert kwargs["device"] == "cpu"
        self.again: list[float] = []
        made.append(self)

    def predict(self, image: np.ndarray, **kwargs: object) -> list[dict[str, Any]]:
        n = round(float(image.mean()) / 10)
        sides = (1.0, 1.0 if n == 1 else 0.0)
        return [
            {"hand_bbox": [x + n for x in box], "is_right": right, "wilor_preds": output(right, box[0])}
            for box, right in zip((FAR, AT), sides, strict=True)
        ]

    def predict_with_bboxes(
        self, image: np.ndarray, bboxes: np.ndarray, is_rights: list[float], **kwargs: object
    ) -> list[dict[str, Any]]:
        assert bboxes.shape == (1, 4)
        self.again += is_rights
        predictions = output(is_rights[0], bboxes[0, 0])
        return [{"hand_bbox": bboxes[0].tolist(), "is_right": is_rights[0], "wilor_preds": predictions}]


made: list[WiLoR] = []


def test_wilor_takes_the_hand_at_the_box(frames: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = "wilor_mini.pipelines.wilor_hand_pose3d_estimation_pipeline"
    package(monkeypatch, module, WiLorHandPose3dEstimationPipeline=WiLoR)
    hand = frames.parent / "hand.npz"
    run(monkeypatch, "wilor", frames, *CAMERA, "--near", near(frames), "--out", hand)
    found = arrays.read(hand, lambda _: True)
    assert found["side"] == "left"
    assert found["frames"].tolist() == [7, 8, 9]
    assert made[-1].again == [0.0]
    assert (found["T_cam_hand"][:, 0, 3] > 0.0).all()
    run(monkeypatch, "wilor", frames, *CAMERA, "--out", hand)  # without a box the largest
    assert arrays.read(hand, lambda _: True)["side"] == "right"


def hamer_modules(monkeypatch: pytest.MonkeyPatch, detects: bool) -> list[tuple[list[float], float]]:
    asked: list[tuple[list[float], float]] = []

    class ViTDetDataset:
        def __init__(
            self, cfg: object, img_cv2: np.ndarray, boxes: np.ndarray, right: np.ndarray, rescale_factor: float = 2.5
        ) -> None:
            asked.append((boxes[0].tolist(), float(right[0])))
            middle, size = tensor((boxes[:, :2] + boxes[:, 2:]) / 2.0), tensor(np.ptp(boxes.reshape(1, 2, 2), axis=1))
            self.batch = {"box_center": middle, "box_size": tensor(size.max(axis=1))}

    class Model:
        mano = MANO

        def to(self, device: str) -> Model:
            return self

        def eval(self) -> Model:
            return self

        def __call__(self, batch: object) -> dict[str, Any]:
            return {
                "pred_cam": tensor([[1.0, 0.0, 0.0]]), "pred_keypoints_3d": tensor(np.ones((1, 21, 3))),
                "pred_vertices": MANO.v_template[None], "pred_mano_params": {"global_orient": tensor(np.eye(3)[None])},
            }  # fmt: skip

    package(monkeypatch, "hamer", __file__=__file__)
    package(monkeypatch, "hamer.configs", CACHE_DIR_HAMER="cache")
    package(monkeypatch, "hamer.datasets.vitdet_dataset", ViTDetDataset=ViTDetDataset)
    loaders = {"download_models": lambda folder: None, "load_hamer": lambda path: (Model(), None)}
    package(monkeypatch, "hamer.models", DEFAULT_CHECKPOINT="checkpoint", **loaders)
    package(monkeypatch, "hamer.utils", recursive_to=lambda batch, device: batch)
    if not detects:
        return asked

    def people(image: np.ndarray) -> dict[str, Any]:
        boxes = SimpleNamespace(tensor=tensor([[0.0, 0.0, 160.0, 120.0], [0.0, 0.0, 9.0, 9.0]]))
        found = SimpleNamespace(pred_classes=tensor([0, 3]), scores=tensor([0.9, 0.9]), pred_boxes=boxes)
        return {"instances": found}

    class ViTPoseModel:
        def __init__(self, device: str) -> None: ...

        def predict_pose(self, image: np.ndarray, people: list[np.ndarray]) -> list[dict[str, np.ndarray]]:
            assert people[0].shape == (1, 5)
            points = np.zeros((133, 3))
            if image.mean() < 15.0:  # nobody in the last image
                for part, (x0, y0, x1, y1) in ((slice(-42, -21), FAR), (slice(-21, None), AT)):
                    points[part] = [x0, y0, 0.9]
                    points[part][0, :2] = x1, y1
            return [{"keypoints": points}]

    head = SimpleNamespace(box_predictors=[SimpleNamespace(test_score_thresh=0.0) for _ in range(3)])
    config = SimpleNamespace(train=SimpleNamespace(), model=SimpleNamespace(roi_heads=head))
    package(monkeypatch, "detectron2.config", LazyConfig=SimpleNamespace(load=lambda path: config))
    package(monkeypatch, "hamer.utils.utils_detectron2", DefaultPredictor_Lazy=lambda config: people)
    package(monkeypatch, "vitpose_model", ViTPoseModel=ViTPoseModel)
    return asked


def test_hamer_finds_hands_by_its_own_detector(frames: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a box is given that is taken; where there is nobody, the image is left out."""
    asked = hamer_modules(monkeypatch, detects=True)
    boxes, hand = frames.parent / "boxes.json", frames.parent / "hand.npz"
    boxes.write_text(json.dumps({IMAGE_NAMES[1]: [1.0, 2.0, 30.0, 40.0]}))
    words = (frames, *CAMERA, "--boxes", boxes, "--near", near(frames), "--out", hand)
    run(monkeypatch, "hamer", *words)
    assert asked == [(AT, 1.0), ([1.0, 2.0, 30.0, 40.0], 1.0)]
    found = arrays.read(hand, lambda _: True)
    assert found["side"] == "right"
    assert found["frames"].tolist() == [7, 8]


def test_hamer_looks_about_the_objects_box_where_no_detector_is(frames: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = hamer_modules(monkeypatch, detects=False)
    words = (frames, *CAMERA, "--near", near(frames), "--out", frames.parent / "hand.npz")
    with pytest.raises(SystemExit, match="give --side"):
        run(monkeypatch, "hamer", *words)
    run(monkeypatch, "hamer", *words, "--side", "left")
    assert asked == [([90.0, 30.0, 150.0, 90.0], 0.0)]
