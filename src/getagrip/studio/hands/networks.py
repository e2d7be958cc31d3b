"""MediaPipe's palm detector and landmark network: their files, and how they are run.

LiteRT runs them, or OpenCV if its outputs for a reference input are the known ones: OpenCV 4.11 computes wrong 3D
points without an error. The files (Apache-2.0, Google) are downloaded once, by pip, from a release of MediaPipe on the
user's package index; their hashes are checked whenever they are loaded.

Inputs and outputs of MediaPipe's networks: palms of the palm detector, crops of hands for the landmark network.

V. Bazarevsky, F. Zhang, "On-Device, Real-Time Hand Tracking with MediaPipe", 2019; F. Zhang et al., "MediaPipe Hands",
2020. The palm detector, a single-shot detector with fixed anchors, takes the image fitted into a square, and returns
for each anchor the logit of a palm, and the palm's box and seven points relative to the anchor's middle. A crop is a
turned square of the image in which the fingers point up, with sizes and shifts of MediaPipe's published graphs.
"""

from __future__ import annotations

import os
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.io import files, processes, terminal
from getagrip.io.plugins import install_command

PALM_INPUT_PX = 192
"""Side of the palm detector's input [px]."""
ANCHOR_GRIDS = ((24, 2), (12, 6))
"""Cells along a side of each grid of anchors, and anchors in each cell."""
MIN_PALM_PROBABILITY = 0.5
PALM_IOU_THRESHOLD = 0.3
"""Intersection over union above which two boxes are of one palm."""
BRIGHTNESS_QUANTILE, DARK_IMAGE_THRESHOLD, TARGET_BRIGHTNESS, MAX_BRIGHTNESS_GAIN = 0.98, 0.4, 0.8, 20.0
"""Quantile of an image's values; value of it below which the image is dark; value to which it is then scaled, and the
largest factor."""
PALM_WRIST_INDEX, PALM_KNUCKLE_INDEX = 0, 2
"""Indices in ``Palm.points``."""
HAND_INPUT_PX = 224
"""Side of the landmark network's input [px]."""
PALM_CROP_SCALE_SHIFT = (2.6, 0.5)
"""Side of a palm's crop in sides of the palm's box, and its shift towards the fingers in heights of the box."""
LANDMARK_CROP_SCALE_SHIFT = (2.0, 0.1)
"""Side and shift of a hand's crop, in sizes of the box of ``RIGID_LANDMARKS``."""
RIGID_LANDMARKS = np.array([0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18])
"""Landmarks up to the middle joints of the fingers, which bent fingers hardly move."""


class Palm(NamedTuple):
    """A palm in the image."""

    box: Float[ndarray, "4"]
    """Left, top, right, bottom [px]."""
    points: Float[ndarray, "7 2"]
    """Wrist, knuckles of index, middle, ring and pinky, and two of the thumb [px]."""
    score: float


@cache
def anchors() -> Float[ndarray, "2016 2"]:
    """Return the middle of each anchor, in units of the input's side."""
    grids = []
    for cells, each in ANCHOR_GRIDS:
        v, u = np.mgrid[:cells, :cells]
        grids.append(np.repeat((np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) / cells, each, axis=0))
    return np.concatenate(grids)


class Letterbox(NamedTuple):
    """An image fitted into the middle of a square: (u, v) of the image is at scale * (u, v) + shift."""

    scale: float
    shift: Float[ndarray, "2"]

    @staticmethod
    def of(size: tuple[int, int], fill: float = 1.0) -> Letterbox:
        """Fit images of a size (width, height) [px]; their longer side is the fraction ``fill`` of the square's."""
        scale = fill * PALM_INPUT_PX / max(size)
        return Letterbox(scale, (PALM_INPUT_PX - scale * np.array(size, dtype=float)) / 2.0)

    def image(self, image: UInt8[ndarray, "H W 3"]) -> Float32[ndarray, "192 192 3"]:
        """Return the palm detector's input: red, green, blue from 0 to 1, black outside the image."""
        import cv2

        size = max(1, round(image.shape[1] * self.scale)), max(1, round(image.shape[0] * self.scale))
        skip = max(1, int(0.5 / self.scale))  # two input pixels or more remain for each output pixel
        small = cv2.resize(np.ascontiguousarray(image[::skip, ::skip]), size, interpolation=cv2.INTER_AREA)
        out = np.zeros((PALM_INPUT_PX, PALM_INPUT_PX, 3), np.float32)
        left, top = (round(float(x)) for x in self.shift)
        inside = small[: PALM_INPUT_PX - top, : PALM_INPUT_PX - left]
        out[top : top + size[1], left : left + size[0]] = inside / np.float32(255.0)
        return brighten(out)

    def back(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert points of the square to the image [px]."""
        return np.asarray((points - self.shift) / self.scale)


def brighten(image: Float32[ndarray, "H W 3"]) -> Float32[ndarray, "H W 3"]:
    """Scale up the values (0 to 1) of a dark image, since the networks were not trained with dark ones."""
    high = float(np.quantile(image[::4, ::4], BRIGHTNESS_QUANTILE))
    if high >= DARK_IMAGE_THRESHOLD:
        return image
    gain = TARGET_BRIGHTNESS / max(high, TARGET_BRIGHTNESS / MAX_BRIGHTNESS_GAIN)
    return np.minimum(image * np.float32(gain), np.float32(1.0))


def decode_palms(
    boxes: Float32[ndarray, "2016 18"],
    logits: Float32[ndarray, "2016"],
    frame: Letterbox,
    least: float = MIN_PALM_PROBABILITY,
) -> list[Palm]:
    """Decode the palm detector's output; return palms by score, each the weighted mean of overlapping detections."""
    scores = 1.0 / (1.0 + np.exp(-np.clip(logits.astype(float), -100.0, 100.0)))
    there = np.flatnonzero(scores >= least)
    there = there[np.argsort(-scores[there], kind="stable")]
    raw = boxes[there].astype(float).reshape(-1, 9, 2)
    middle = PALM_INPUT_PX * anchors()[there]
    half = 0.5 * raw[:, 1:2]
    middles = raw[:, :1] + middle[:, None]
    corners = np.concatenate([middles - half, middles + half, raw[:, 2:] + middle[:, None]], axis=1)
    found, left = [], np.arange(len(there))
    while left.size:
        same = _box_iou(corners[left[0], :2], corners[left, :2]) > PALM_IOU_THRESHOLD
        same[0] = True
        weights = scores[there[left[same]]]
        mean = frame.back(np.average(corners[left[same]], axis=0, weights=weights))
        found.append(Palm(mean[:2].ravel(), mean[2:], float(weights[0])))
        left = left[~same]
    return found


def _box_iou(one: Float[ndarray, "2 2"], many: Float[ndarray, "n 2 2"]) -> Float[ndarray, "n"]:
    inner = np.prod(np.clip(np.minimum(one[1], many[:, 1]) - np.maximum(one[0], many[:, 0]), 0.0, None), axis=1)
    area = np.prod(many[:, 1] - many[:, 0], axis=1)
    return np.asarray(inner / np.maximum(np.prod(one[1] - one[0]) + area - inner, 1e-9))


class HandCrop(NamedTuple):
    """A turned square of an image."""

    middle: Float[ndarray, "2"]
    """[px]"""
    side: float
    """[px]"""
    angle: float
    """Rotation from x to y [rad]."""

    @property
    def axes(self) -> Float[ndarray, "2 2"]:
        """The crop's x and y axes in the image, as columns."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def to_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert pixels of the network's input to those of the image."""
        return np.asarray(self.middle + (points / HAND_INPUT_PX - 0.5) @ self.axes.T * self.side)

    def from_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert pixels of the image to those of the network's input."""
        return np.asarray(((points - self.middle) @ self.axes / self.side + 0.5) * HAND_INPUT_PX)

    def image(self, image: UInt8[ndarray, "H W 3"]) -> Float32[ndarray, "224 224 3"]:
        """Return the landmark network's input: red, green, blue from 0 to 1, black outside the image."""
        import cv2

        M = np.column_stack([self.axes * self.side / HAND_INPUT_PX, self.to_image(np.zeros(2))])
        M[:, 2] += M[:, :2] @ [0.5, 0.5] - 0.5  # OpenCV's pixels have their middle at whole numbers
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpAffine(image, M, (HAND_INPUT_PX, HAND_INPUT_PX), flags=flags)
        return brighten(np.asarray(warped, np.float32) / np.float32(255.0))

    def near(self, other: HandCrop) -> bool:
        """Return whether both crops show the network nearly the same pixels."""
        apart = float(np.linalg.norm(self.middle - other.middle)) / min(self.side, other.side)
        turned = abs(angle_difference(self.angle, other.angle))
        return apart < 0.25 and turned < 0.6 and 0.75 < self.side / other.side < 1.35


def angle_difference(one: float, other: float) -> float:
    """Return the difference of two angles, from -pi to pi [rad]."""
    return (one - other + np.pi) % (2.0 * np.pi) - np.pi


def crop_of_palm(palm: Palm) -> HandCrop:
    """Return the crop around the hand of a detected palm."""
    angle = _upright_angle(palm.points[PALM_WRIST_INDEX], palm.points[PALM_KNUCKLE_INDEX])
    low, high = palm.box[:2], palm.box[2:]
    scale, ahead = PALM_CROP_SCALE_SHIFT
    crop = HandCrop((low + high) / 2.0, scale * float(np.max(high - low)), angle)
    return crop._replace(middle=crop.middle - crop.axes[:, 1] * ahead * float(high[1] - low[1]))


def crop_of_box(box: Float[ndarray, "4"]) -> HandCrop:
    """Return the upright crop around the middle of a box (left, top, width, height) [px]."""
    return HandCrop(box[:2] + box[2:] / 2.0, float(box[2:].max()), 0.0)


def crop_of_landmarks(points: Float[ndarray, "21 2"]) -> HandCrop:
    """Return the crop around a hand with landmarks ``points`` [px], for the next frame."""
    ahead = 0.25 * (points[6] + points[14]) + 0.5 * points[10]
    crop = HandCrop(np.zeros(2), 1.0, _upright_angle(points[0], ahead))
    own = points[RIGID_LANDMARKS] @ crop.axes
    low, high = own.min(axis=0), own.max(axis=0)
    scale, shift = LANDMARK_CROP_SCALE_SHIFT
    middle = (low + high) / 2.0 - np.array([0.0, shift * (high[1] - low[1])])
    return HandCrop(crop.axes @ middle, max(scale * float(np.max(high - low)), 1.0), crop.angle)


def _upright_angle(wrist: Float[ndarray, "2"], ahead: Float[ndarray, "2"]) -> float:
    """Return the angle of a crop in which ``ahead`` is above the wrist [rad]."""
    x, y = ahead - wrist
    return float(np.arctan2(x, -y))


Net = Callable[[Float32[ndarray, "n n 3"]], list[Float32[ndarray, "..."]]]
"""A network: a function from an image to its outputs, in the order of their names."""
REFERENCE_OUTPUTS = (
    (0, (111.95727, 178.81602, 0.00016, 113.31991, 156.71335, 1.38071)),
    (2, (0.28077,)),
    (3, (0.00152, 0.09113, 0.03884, 0.00879, 0.07205, 0.0477)),
)
"""Known outputs of the landmark network for ``reference_input``: index of the output, and its first numbers."""
REFERENCE_TOLERANCE = 2e-3
"""Relative tolerance of the known numbers."""


class HandNetOutput(NamedTuple):
    """The output of the landmark network for a crop."""

    points: Float[ndarray, "21 2"]
    """Wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip [px of the image]."""
    world: Float[ndarray, "21 3"]
    """Landmarks relative to the hand's middle, in the camera's axes, for a hand of mean size [m]."""
    confidence: float
    """Probability of a hand."""
    right: float
    """Probability of a right hand."""


@dataclass(frozen=True)
class Nets:
    """Palm detector and hand landmarks."""

    palm: Net
    hand: Net
    runtime: str

    def palms(self, image: UInt8[ndarray, "H W 3"], fill: float = 1.0) -> list[Palm]:
        """Detect the palms in an image; its longer side fills the fraction ``fill`` of the network's input."""
        frame = Letterbox.of((image.shape[1], image.shape[0]), fill)
        boxes, logits = self.palm(frame.image(image))
        return decode_palms(boxes.reshape(-1, 18), logits.ravel(), frame)

    def landmarks(self, image: UInt8[ndarray, "H W 3"], crop: HandCrop) -> HandNetOutput:
        """Detect the hand in a crop of an image."""
        return decode_hand_output(self.hand(crop.image(image)), crop)

    def mirrored(self, image: UInt8[ndarray, "H W 3"], crop: HandCrop) -> HandNetOutput:
        """Detect the hand in the mirror image of a crop; the output is mirrored about the crop's middle."""
        mirror_image = np.ascontiguousarray(crop.image(image)[:, ::-1])
        return decode_hand_output(self.hand(mirror_image), crop._replace(angle=-crop.angle))


def decode_hand_output(outputs: list[Float32[ndarray, "..."]], crop: HandCrop) -> HandNetOutput:
    """Convert the landmark network's outputs for a crop to the image."""
    points, confidence, right, world = (each.astype(float).ravel() for each in outputs)
    in_space = world.reshape(21, 3).copy()
    in_space[:, :2] = in_space[:, :2] @ crop.axes.T
    xy = crop.to_image(points.reshape(21, 3)[:, :2])
    return HandNetOutput(xy, in_space, float(confidence[0]), float(right[0]))


def reference_input(side: int = HAND_INPUT_PX) -> Float32[ndarray, "n n 3"]:
    """Make a smooth image, the same on every machine."""
    v, u = np.mgrid[:side, :side] / side
    return np.stack([u, v, 0.5 + 0.5 * np.sin(9.0 * u) * np.cos(7.0 * v)], axis=-1).astype(np.float32)


def matches_reference(net: Net) -> bool:
    """Return whether the landmark network's outputs for the reference input are the known ones."""
    outputs, limit = net(reference_input()), REFERENCE_TOLERANCE
    return all(
        np.allclose(outputs[n].ravel()[: len(numbers)], numbers, rtol=limit, atol=limit * max(map(abs, numbers)))
        for n, numbers in REFERENCE_OUTPUTS
    )


def open_nets(palm: bytes, hand: bytes) -> Nets:
    """Open the networks from the contents of their files. Raises ``UsageError`` if no installed library runs them."""
    for runtime, opened in (("LiteRT", _open_litert), ("OpenCV", _open_opencv)):
        try:
            nets = Nets(opened(palm, 2), opened(hand, 4), runtime)
            right = matches_reference(nets.hand)
        except Exception:  # missing, too old, or unable to read the model
            continue
        if right:
            return nets
    raise UsageError(f"no installed library runs the hand models correctly: {install_command('hands')}")


def _open_litert(content: bytes, outputs: int) -> Net:
    """Open a network with LiteRT, on one core."""
    from ai_edge_litert.interpreter import Interpreter

    interpreter = Interpreter(model_content=content, num_threads=1)
    interpreter.allocate_tensors()
    index = interpreter.get_input_details()[0]["index"]
    named = {each["name"].split(":")[0]: each["index"] for each in interpreter.get_output_details()}
    wanted = [named[name] for name in _output_names(outputs)]

    def run(image: Float32[ndarray, "n n 3"]) -> list[Float32[ndarray, "..."]]:
        interpreter.set_tensor(index, image[None])
        interpreter.invoke()
        return [np.array(interpreter.get_tensor(index)) for index in wanted]

    return run


def _open_opencv(content: bytes, outputs: int) -> Net:
    """Open a network with OpenCV, whose outputs are requested by name, since it returns one by default."""
    import cv2

    net = cv2.dnn.readNetFromTFLite(np.frombuffer(content, np.uint8))

    def run(image: Float32[ndarray, "n n 3"]) -> list[Float32[ndarray, "..."]]:
        net.setInput(np.ascontiguousarray(image.transpose(2, 0, 1))[None])
        return [np.array(net.forward(name), np.float32) for name in _output_names(outputs)]

    return run


def _output_names(outputs: int) -> list[str]:
    return ["Identity", *(f"Identity_{n}" for n in range(1, outputs))]


MODEL_FILE_HASHES = {
    "palm_detection_full.tflite": "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54",
    "hand_landmark_full.tflite": "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
}
"""SHA-256 of the models, by file name."""
MEDIAPIPE_RELEASE = "mediapipe==0.10.21"
MEDIAPIPE_WHEEL = ("manylinux_2_28_x86_64", "3.11", "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3")
"""Platform, Python and SHA-256 of the wheel, which is unpacked rather than installed, so one serves every machine."""
MAX_MODEL_BYTES = 16 * 2**20
"""Maximum size of a model file."""
MODEL_INSTALL_HINT = "getagrip doctor --fetch hands, or --models FOLDER with these files"


def model_folder() -> Path:
    """Return the folder of the models: ``GETAGRIP_MODELS``, else in the user's cache."""
    own = os.environ.get("GETAGRIP_MODELS")
    return Path(own) if own else terminal.cache_folder() / "models"


def missing_model_files(folder: Path | None = None) -> list[str]:
    """List the model files missing in a folder, by default in ``model_folder()``."""
    return [name for name in MODEL_FILE_HASHES if not ((folder or model_folder()) / name).is_file()]


def load_models(folder: Path | None = None) -> Nets:
    """Load the networks from a folder, by default ``model_folder()``.

    Raises ``InputError`` for a missing file or one with another hash, ``UsageError`` if no installed library runs the
    networks.
    """
    return open_nets(*_read_models(folder or model_folder()))


def _read_models(folder: Path) -> list[bytes]:
    """Read and check the model files in a folder. Raises ``InputError``."""
    contents = []
    for name, expected in MODEL_FILE_HASHES.items():
        path = folder / name
        if not path.is_file():
            raise InputError(path, "", "no such file", f"MediaPipe's hand model; {MODEL_INSTALL_HINT}")
        contents.append(files.read_bytes(path, MAX_MODEL_BYTES))
        if (found := sha256(contents[-1]).hexdigest()) != expected:
            wanted = f"{name} of {MEDIAPIPE_RELEASE} ({MODEL_INSTALL_HINT})"
            raise InputError(path, "", f"another file (SHA-256 {found[:12]}...)", wanted)
    return contents


def download_models() -> list[Path]:
    """Download missing model files into ``model_folder()``; return the paths of all.

    pip downloads the wheel from the package index that it is configured for, and checks its hash. Raises ``UsageError``
    with pip's message if the download fails, ``InputError`` for another wheel.
    """
    folder = model_folder()
    if missing_model_files(folder):
        with TemporaryDirectory() as temporary:
            wheel = _download_wheel(Path(temporary))
            folder.mkdir(parents=True, exist_ok=True)
            unpack_wheel(wheel, folder)
    _read_models(folder)
    return [folder / name for name in MODEL_FILE_HASHES]


def _download_wheel(folder: Path) -> Path:
    platform, python, expected = MEDIAPIPE_WHEEL
    requirement = folder / "wheel.txt"
    requirement.write_text(f"{MEDIAPIPE_RELEASE} --hash=sha256:{expected}\n")
    options = ["--no-deps", "--only-binary", ":all:", "--platform", platform, "--python-version", python]
    words = processes.python_command("-m", "pip", "--disable-pip-version-check", "--quiet", "download", *options)
    words += ["--require-hashes", "-r", str(requirement), "--dest", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode or not wheels:
        said = (done.stderr.strip() or "it said nothing").splitlines()[-1]
        advice = "or copy the two files by hand and name their folder with --models"
        raise UsageError(f"pip could not download {MEDIAPIPE_RELEASE}: {said}; try again with a network, {advice}")
    return wheels[0]


def unpack_wheel(wheel: Path, folder: Path) -> None:
    """Extract the model files from a wheel, and check each one's hash before writing it. Raises ``InputError``."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            inside = {Path(member.filename).name: member for member in archive.infolist()}
            for name, expected in MODEL_FILE_HASHES.items():
                if name not in inside or inside[name].file_size > MAX_MODEL_BYTES:
                    raise InputError(wheel, name, "no such file in it", f"the wheel of {MEDIAPIPE_RELEASE}")
                content = archive.read(inside[name])
                if sha256(content).hexdigest() != expected:
                    raise InputError(wheel, name, "another file", f"the one of {MEDIAPIPE_RELEASE}")
                with files.new_file(folder / name) as path:
                    path.write_bytes(content)
    except zipfile.BadZipFile as error:
        raise InputError(wheel, "", "a damaged file", f"the wheel of {MEDIAPIPE_RELEASE}") from error
