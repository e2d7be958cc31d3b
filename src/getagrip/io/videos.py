"""Videos as files (MP4, H.264), written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.io import files

H264_CRF = "20"
"""H.264's constant rate factor: lower is better."""


def write_video(
    path: Path, frames: Iterable[UInt8[ndarray, "H W 3"]], rate: Fraction, size: tuple[int, int], seek: bool = False
) -> None:
    """Write RGB frames of one size, an even width and height [px].

    With ``seek``, every other frame can be decoded without those before it. Raises ``GetagripError`` where PyAV has no
    encoder for H.264.
    """
    import av

    try:
        av.codec.Codec("libx264", "w")
    except av.codec.codec.UnknownCodecError as error:
        raise GetagripError("PyAV was built without libx264: no film can be written") from error
    options = {"crf": H264_CRF} | ({"g": "2", "bf": "0"} if seek else {})
    with files.new_file(path) as part, av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as film:
        stream = film.add_stream("libx264", rate=rate, options=options)
        (stream.width, stream.height), stream.pix_fmt = size, "yuv420p"
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            film.mux(stream.encode(picture))
        film.mux(stream.encode())
