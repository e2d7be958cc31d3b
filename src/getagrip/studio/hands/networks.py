"""MediaPipe's palm detector and landmark network: their files, and how they are run.

LiteRT runs them, or OpenCV if its outputs for a reference input are the known ones: OpenCV 4.11 computes wrong 3D
points without an error. The files (Apache-2.0, Google) are downloaded once, by pip, from a release of MediaPipe on the
user's package index; their hashes are checked whenever they are loaded.
"""

from __future__ import annotations

import os
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
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
from getagrip.studio.hands import palms
from getagrip.studio.hands.palms import HandCrop, Letterbox, Palm

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
        return palms.decode_palms(boxes.reshape(-1, 18), logits.ravel(), frame)

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


def reference_input(side: int = palms.HAND_INPUT_PX) -> Float32[ndarray, "n n 3"]:
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
