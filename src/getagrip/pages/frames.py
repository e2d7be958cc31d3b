"""Pictures in pages: JPEG, and contours over them as SVG draws them."""

from __future__ import annotations

import base64
from collections.abc import Iterable

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.geometry.camera import Crops
from getagrip.geometry.render import Surface
from getagrip.pictures.shown import View
from getagrip.pictures.tiles import crop_image, mask_contours, silhouette_lines, window_intrinsics

FRAME_PICTURE_PX, FRAME_JPEG_QUALITY = 480, 78
"""Side [px] and JPEG quality of the images."""


def draw_page_frame(view: View, n: int, crops: Crops, k: int) -> dict[str, object]:
    """Draw frame ``n`` in window ``k``.

    The image, and the contours of the object, the hands, the truth and the mask.
    """
    outlines = {"hand": _surfaces_outline(view.hands(n), view, n, crops, k)}
    if view.posed:
        outlines["object"] = object_outline(view, n, crops, k)
    if not view.of_truth and (true := view.true()) is not None:
        outlines["true"] = object_outline(true, n, crops, k)
    if view.masks is not None:
        lines = mask_contours(view.masks.object[n])
        outlines["observed"] = svg_paths((line - crops.corner[k]) * crops.zoom for line in lines)
    return {"picture": jpeg_base64(crop_image(view, n, crops, k), FRAME_JPEG_QUALITY), "outlines": outlines}


def object_outline(view: View, n: int, crops: Crops, k: int) -> str:
    """Return the contour of the posed object."""
    return _surfaces_outline([(view.object(n), view.clip.mesh.faces)], view, n, crops, k)


def _surfaces_outline(surfaces: Iterable[Surface], view: View, n: int, crops: Crops, k: int) -> str:
    K = window_intrinsics(view, n, crops, k)
    return "".join(svg_paths(silhouette_lines(*surface, K, crops.size)) for surface in surfaces)


def jpeg_base64(picture: UInt8[ndarray, "H W 3"], quality: int) -> str:
    """Encode an RGB picture as JPEG, in base64."""
    done, content = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise GetagripError(f"a picture of {picture.shape[1]}x{picture.shape[0]} px could not be written as JPEG")
    return base64.b64encode(content.tobytes()).decode("ascii")


def svg_paths(lines: Iterable[Float[ndarray, "_n 2"]]) -> str:
    """Write closed lines as SVG paths, without points that hardly change them."""
    out = []
    for line in lines:
        kept = cv2.approxPolyDP(line.astype(np.float32)[:, None], 0.3, closed=True)[:, 0]
        out.append("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in kept) + "Z")
    return "".join(out)
