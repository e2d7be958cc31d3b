"""Palm decoding, squares about hands, and the files of the networks: known answers and round trips, no model needed."""

from __future__ import annotations

import zipfile
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.studio.hands import networks
from getagrip.studio.hands.networks import HandCrop, Letterbox, Palm, anchors


def output(*hits: tuple[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """A detector's output: a palm of 60 pixels about each of some anchors, with its logit."""
    boxes, logits = np.zeros((2016, 18), np.float32), np.full(2016, -50.0, np.float32)
    for anchor, logit in hits:
        boxes[anchor, 2:4] = 60.0
        boxes[anchor, 4:6] = 0.0, 30.0  # the wrist below the middle
        logits[anchor] = logit
    return boxes, logits


def test_anchors_are_the_middles_of_cells() -> None:
    found = anchors()
    assert found.shape == (2016, 2)
    np.testing.assert_allclose(found[[0, 1, 2]], np.array([[0.5, 0.5], [0.5, 0.5], [1.5, 0.5]]) / 24)
    np.testing.assert_allclose(found[[-1, -6]], np.full((2, 2), 11.5 / 12))


@pytest.mark.parametrize("size", [(720, 1280), (1920, 1080), (640, 640)])
@pytest.mark.parametrize("fill", [1.0, 0.5])
def test_a_palm_is_where_its_anchor_is(size: tuple[int, int], fill: float) -> None:
    anchor, frame = 24 * 24 * 2 + (5 * 12 + 6) * 6, Letterbox.of(size, fill)
    (palm,) = networks.decode_palms(*output((anchor, 3.0)), frame)
    middle = np.array([6.5, 5.5]) / 12 * 192
    np.testing.assert_allclose((palm.box[:2] + palm.box[2:]) / 2, frame.back(middle), atol=1e-6)
    np.testing.assert_allclose(palm.box[2:] - palm.box[:2], 60.0 / frame.scale, rtol=1e-6)
    np.testing.assert_allclose(
        palm.points[networks.PALM_WRIST_INDEX], frame.back(middle + np.array([0.0, 30.0])), atol=1e-6
    )
    assert palm.score == pytest.approx(1.0 / (1.0 + np.exp(-3.0)))


def test_overlapping_palms_are_one_and_distant_ones_two() -> None:
    grid = 24 * 24 * 2
    near, far = grid + (5 * 12 + 6) * 6, grid + (5 * 12 + 11) * 6
    found = networks.decode_palms(
        *output((near, 2.0), (near + 1, 1.0), (far, 1.5), (far + 6, -2.0)), Letterbox.of((192, 192))
    )
    assert [round(palm.score, 3) for palm in found] == [0.881, 0.818]
    assert networks.decode_palms(*output(), Letterbox.of((192, 192))) == []


@pytest.mark.parametrize("fill", [1.0, 0.5])
def test_the_letterbox_keeps_places(fill: float) -> None:
    image = np.zeros((1280, 720, 3), np.uint8)
    image[630:650, 350:370] = 255
    frame = Letterbox.of((720, 1280), fill)
    v, u = np.nonzero(frame.image(image)[..., 0] > 0.5)
    np.testing.assert_allclose(frame.back(np.array([u.mean() + 0.5, v.mean() + 0.5])), [360.0, 640.0], atol=4.0)


def test_squares_map_there_and_back() -> None:
    crop = HandCrop(np.array([310.0, 620.0]), 400.0, 0.7)
    points = np.random.default_rng(0).uniform(0.0, 224.0, (9, 2))
    np.testing.assert_allclose(crop.from_image(crop.to_image(points)), points, atol=1e-9)
    image = np.zeros((1280, 720, 3), np.uint8)
    u, v = np.floor(crop.to_image(np.array([60.0, 150.0]))).astype(int)
    image[v - 6 : v + 7, u - 6 : u + 7] = 255
    rows, columns = np.nonzero(crop.image(image)[..., 0] > 0.5)
    np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], [60.0, 150.0], atol=1.0)


@pytest.mark.parametrize("angle", [-2.5, -0.4, 0.0, 1.3, 3.0])
def test_squares_turn_with_the_hand(angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    hand = np.random.default_rng(1).normal(0.0, 40.0, (21, 2)) - np.array([0.0, 100.0])
    hand[0] = 0.0
    upright, turned = networks.crop_of_landmarks(hand), networks.crop_of_landmarks(hand @ turn.T)
    assert np.cos(turned.angle - upright.angle - angle) == pytest.approx(1.0)
    assert turned.side == pytest.approx(upright.side)
    np.testing.assert_allclose(turned.middle, turn @ upright.middle, atol=1e-9)
    own = turned.from_image(hand @ turn.T)
    assert own[networks.RIGID_LANDMARKS].min() > 0.0
    assert own[networks.RIGID_LANDMARKS].max() < 224.0


def test_a_palm_that_points_up_gives_an_upright_square_ahead_of_it() -> None:
    points = np.zeros((7, 2))
    points[networks.PALM_WRIST_INDEX], points[networks.PALM_KNUCKLE_INDEX] = [100.0, 140.0], [100.0, 60.0]
    crop = networks.crop_of_palm(Palm(np.array([60.0, 60.0, 140.0, 140.0]), points, 0.9))
    assert crop.angle == pytest.approx(0.0)
    assert crop.side == pytest.approx(208.0)
    np.testing.assert_allclose(crop.middle, [100.0, 60.0])


def test_landmarks_come_back_to_the_image() -> None:
    crop = HandCrop(np.array([310.0, 620.0]), 448.0, np.pi / 2)
    points = np.zeros((21, 3), np.float32)
    points[:, :2] = 112.0
    points[8, :2] = 112.0, 12.0
    world = np.tile(np.float32([0.0, -0.08, 0.01]), (21, 1))
    outputs = [points.ravel(), np.float32([0.97]), np.float32([0.2]), world.ravel()]
    found = networks.decode_hand_output(outputs, crop)
    np.testing.assert_allclose(found.points[0], [310.0, 620.0])
    np.testing.assert_allclose(found.points[8], [510.0, 620.0])  # up in the square is right in the image
    np.testing.assert_allclose(found.world[0], [0.08, 0.0, 0.01], atol=1e-7)
    assert (found.confidence, found.right) == (pytest.approx(0.97), pytest.approx(0.2))


def test_a_runtime_with_other_answers_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(factor: float) -> object:
        outputs = [np.zeros(63), np.zeros(1), np.zeros(1), np.zeros(63)]
        for n, numbers in networks.REFERENCE_OUTPUTS:
            outputs[n][: len(numbers)] = factor * np.array(numbers)
        return lambda content, count: lambda image: outputs[:count]

    monkeypatch.setattr(networks, "_open_litert", opened(1.1))
    monkeypatch.setattr(networks, "_open_opencv", opened(1.0))
    assert networks.open_nets(b"", b"").runtime == "OpenCV"
    monkeypatch.setattr(networks, "_open_opencv", opened(0.9))
    with pytest.raises(UsageError, match=r"pip install .*\[hands\]"):
        networks.open_nets(b"", b"")


def test_files_are_taken_from_the_wheel_by_their_hashes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = list(networks.MODEL_FILE_HASHES)
    monkeypatch.setattr(networks, "MODEL_FILE_HASHES", {name: sha256(name.encode()).hexdigest() for name in names})
    wheel = tmp_path / "some.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name in names:
            archive.writestr(f"deep/inside/{name}", name)
    networks.unpack_wheel(wheel, tmp_path)
    assert networks.missing_model_files(tmp_path) == []
    (tmp_path / names[0]).write_text("other")
    with pytest.raises(InputError, match="another file"):
        networks.load_models(tmp_path)
    with pytest.raises(InputError, match="--fetch hands"):
        networks.load_models(tmp_path / "nowhere")
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr(names[0], "other")
    with pytest.raises(InputError, match="another file"):
        networks.unpack_wheel(wheel, tmp_path / "new")
    assert not (tmp_path / "new" / names[0]).exists()


def test_pip_that_fails_is_quoted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GETAGRIP_MODELS", str(tmp_path))
    monkeypatch.setattr(networks, "MEDIAPIPE_RELEASE", "mediapipe==")
    with pytest.raises(UsageError, match="--models"):
        networks.download_models()


@pytest.mark.skipif(
    bool(networks.missing_model_files()), reason="the hand models are not here: getagrip doctor --fetch hands"
)
@pytest.mark.slow
def test_the_real_models_answer_as_known() -> None:
    loaded = networks.load_models()
    assert networks.matches_reference(loaded.hand)
    assert loaded.palms(np.zeros((480, 640, 3), np.uint8)) == []


def test_dark_images_are_lightened_and_others_stay_as_they_are() -> None:
    image = np.random.default_rng(0).uniform(0.0, 1.0, (64, 64, 3)).astype(np.float32)
    np.testing.assert_array_equal(networks.brighten(image), image)
    np.testing.assert_allclose(networks.brighten(0.2 * image), networks.brighten(0.1 * image), rtol=1e-5)
    assert networks.brighten(np.zeros_like(image)).max() == 0.0
