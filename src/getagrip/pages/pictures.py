"""Pictures in pages: JPEG, and contours as SVG draws them."""

from __future__ import annotations

import base64
from collections.abc import Iterable

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.geometry.camera import Crops
from getagrip.view.tiles import mask_lines


def jpeg(picture: UInt8[ndarray, "H W 3"], quality: int) -> str:
    """An RGB picture as JPEG, in base64."""
    done, content = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise GetagripError(f"a picture of {picture.shape[1]}x{picture.shape[0]} px could not be written as JPEG")
    return base64.b64encode(content.tobytes()).decode("ascii")


def paths(lines: Iterable[Float[ndarray, "_n 2"]]) -> str:
    """Closed lines as SVG draws them, without points that hardly change them."""
    out = []
    for line in lines:
        kept = cv2.approxPolyDP(line.astype(np.float32)[:, None], 0.3, closed=True)[:, 0]
        out.append("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in kept) + "Z")
    return "".join(out)


def mask_path(mask: Bool[ndarray, "H W"], crops: Crops, k: int) -> str:
    """The boundary of a mask of the image in window ``k``."""
    return paths((line - crops.corner[k]) * crops.zoom for line in mask_lines(mask))
