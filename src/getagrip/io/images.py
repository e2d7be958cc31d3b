"""Images as files, each written whole or with an error."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import files

QUALITY = 92
"""Of JPEG images, of 100."""


def read_image(path: Path, least: tuple[int, int] = (1, 1)) -> UInt8[ndarray, "H W 3"]:
    """An RGB image of at least some width and height [px]. Raises ``InputError``."""
    import cv2

    read = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if read is None:
        raise InputError(path, "", "a file that is no image", "an image")
    if read.shape[1] < least[0] or read.shape[0] < least[1]:
        raise InputError(path, "size", f"{read.shape[1]} x {read.shape[0]}", f"at least {least[0]} x {least[1]}")
    return np.asarray(read[..., ::-1], dtype=np.uint8)


def write_image(path: Path, image: UInt8[ndarray, "H W"] | UInt8[ndarray, "H W 3"]) -> None:
    """Write a grey or RGB image as PNG or JPEG, by the suffix. Raises ``OSError``, on a full disk for one.

    ``cv2.imwrite`` only returns False then.
    """
    import cv2

    bgr = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY] if path.suffix == ".jpg" else []
    done, content = cv2.imencode(path.suffix, bgr, options)
    if not done:
        raise OSError(errno.EINVAL, "an image that cannot be encoded", str(path))
    files.write_bytes(path, content.tobytes())


def write_mask(path: Path, mask: Bool[ndarray, "H W"]) -> None:
    """Write a mask as a grey image, 255 where it is set. Raises ``OSError``."""
    write_image(path, mask.astype(np.uint8) * 255)
