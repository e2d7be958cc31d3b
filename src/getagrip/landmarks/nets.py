"""The two networks, run by LiteRT, or by OpenCV if its outputs for a fixed input are the known ones.

OpenCV 4.11 computes wrong 3D points with the landmark network, without an error; hence this test.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.io.extras import install_command
from getagrip.landmarks import crops, palms
from getagrip.landmarks.crops import HandCrop
from getagrip.landmarks.palms import Letterbox, Palm

Net = Callable[[Float32[ndarray, "n n 3"]], list[Float32[ndarray, "..."]]]
"""A function from an image to the network's outputs, flat, in the order of their names."""
REFERENCE_OUTPUTS = (
    (0, (111.95727, 178.81602, 0.00016, 113.31991, 156.71335, 1.38071)),
    (2, (0.28077,)),
    (3, (0.00152, 0.09113, 0.03884, 0.00879, 0.07205, 0.0477)),
)
"""Outputs of the landmark network for ``reference_input``: index of the output, and its first numbers."""
REFERENCE_TOLERANCE = 2e-3
"""Tolerance, relative to the size of the known numbers."""


class HandNetOutput(NamedTuple):
    """The output of the landmark network for a square."""

    points: Float[ndarray, "21 2"]
    """Wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip [px of the image]."""
    world: Float[ndarray, "21 3"]
    """Landmarks about the hand's middle, in the camera's axes and at a mean hand's size [m]."""
    confidence: float
    """Probability of a hand."""
    right: float
    """Probability that it is a right one."""


@dataclass(frozen=True)
class Nets:
    """Palm detector and hand landmarks."""

    palm: Net
    hand: Net
    runtime: str

    def palms(self, image: UInt8[ndarray, "H W 3"], fill: float = 1.0) -> list[Palm]:
        """Detect the palms in an image, whose longer side is ``fill`` of what the network sees."""
        frame = Letterbox.of((image.shape[1], image.shape[0]), fill)
        boxes, logits = self.palm(frame.image(image))
        return palms.decode_palms(boxes.reshape(-1, 18), logits.ravel(), frame)

    def landmarks(self, image: UInt8[ndarray, "H W 3"], crop: HandCrop) -> HandNetOutput:
        """Detect the hand in a square of an image, if there is one."""
        return decode_hand_output(self.hand(crop.image(image)), crop)

    def mirrored(self, image: UInt8[ndarray, "H W 3"], crop: HandCrop) -> HandNetOutput:
        """Detect the hand in the mirror image of a square; it is found mirrored about the square's middle."""
        return decode_hand_output(
            self.hand(np.ascontiguousarray(crop.image(image)[:, ::-1])), crop._replace(angle=-crop.angle)
        )


def decode_hand_output(outputs: list[Float32[ndarray, "..."]], crop: HandCrop) -> HandNetOutput:
    """Convert the landmark network's outputs to the image."""
    points, confidence, right, world = (each.astype(float).ravel() for each in outputs)
    in_space = world.reshape(21, 3).copy()
    in_space[:, :2] = in_space[:, :2] @ crop.axes.T
    xy = crop.to_image(points.reshape(21, 3)[:, :2])
    return HandNetOutput(xy, in_space, float(confidence[0]), float(right[0]))


def reference_input(side: int = crops.HAND_INPUT_PX) -> Float32[ndarray, "n n 3"]:
    """Make a smooth image that is the same on every machine."""
    v, u = np.mgrid[:side, :side] / side
    return np.stack([u, v, 0.5 + 0.5 * np.sin(9.0 * u) * np.cos(7.0 * v)], axis=-1).astype(np.float32)


def matches_reference(net: Net) -> bool:
    """Return whether the landmark network's outputs for the fixed input are the known ones."""
    outputs = net(reference_input())
    return all(
        np.allclose(
            outputs[n].ravel()[: len(numbers)],
            numbers,
            rtol=REFERENCE_TOLERANCE,
            atol=REFERENCE_TOLERANCE * max(map(abs, numbers)),
        )
        for n, numbers in REFERENCE_OUTPUTS
    )


def open_nets(palm: bytes, hand: bytes) -> Nets:
    """Open the networks from the contents of their files. Raises ``UsageError`` where nothing here can run them."""
    for runtime, opened in (("LiteRT", _open_litert), ("OpenCV", _open_opencv)):
        try:
            nets = Nets(opened(palm, 2), opened(hand, 4), runtime)
            right = matches_reference(nets.hand)
        except Exception:  # absent, too old, or a model that it cannot read: another one may
            continue
        if right:
            return nets
    raise UsageError(f"nothing here runs the hand models as they should: {install_command('hands')}")


def _open_litert(content: bytes, outputs: int) -> Net:
    """Run a network by LiteRT, on one core."""
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
    """Run a network by OpenCV, and ask for each output by name, since it returns only one by default."""
    import cv2

    net = cv2.dnn.readNetFromTFLite(np.frombuffer(content, np.uint8))

    def run(image: Float32[ndarray, "n n 3"]) -> list[Float32[ndarray, "..."]]:
        net.setInput(np.ascontiguousarray(image.transpose(2, 0, 1))[None])
        return [np.array(net.forward(name), np.float32) for name in _output_names(outputs)]

    return run


def _output_names(outputs: int) -> list[str]:
    return ["Identity", *(f"Identity_{n}" for n in range(1, outputs))]
