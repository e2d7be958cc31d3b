"""The film of docs/draft.md, docs/images/draft.webp: from a phone's video to hand and mug in 3D, with the seconds.

    python -m benchmarks.draft_film

runs the commands of the steps and draws what they make; no pixel of the footage is shown. A person's strokes are in
``benchmarks/polygons``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from PIL import Image, ImageDraw

from benchmarks.drafts import DATA, Example, made_by
from benchmarks.store import ROOT
from getagrip.annotate import labels
from getagrip.annotate.found_hands import FOLDER, FoundHands
from getagrip.annotate.labels import FrameLabels
from getagrip.clip import read_clip, read_masks
from getagrip.film import font
from getagrip.geometry.render import render_rgb
from getagrip.landmarks.masks import BONES
from getagrip.pictures.shown import View
from getagrip.pictures.stills import steady_windows
from getagrip.pictures.style import (
    BLANK,
    FAINT,
    FOUND,
    HAND,
    HAND_LINE,
    IGNORED,
    INK,
    OBJECT,
    OBSERVED,
    PAPER,
    PAPER_RGB,
)
from getagrip.pictures.tiles import mask_lines, posed
from getagrip.result import read_result

MUG = Example("mug", "mug", 90)
ASKED = (0, 89, 58)
"""Frames from 0, in the order in which the page asks for them."""
PICTURE = ROOT / "docs" / "images" / "draft.webp"
ZOOM, ROWS, SIDE, TOP = 0.5, slice(40, 560), 360, 160
"""Of the footage's size, and its rows that are shown; side of the turned view, height of the words above it [px]."""
EVERY, PAUSE, QUALITY = 3, 12, 62
"""Frames of which one is shown, pictures that stand still at the end, and WebP's quality."""
SEEN = (216, 219, 222)
"""Colour of what the video shows, before anything is known of it."""
STEPS = {
    "the hand is found in all frames": ("the hand",),
    "a person draws on three frames": ("the outlines",),
    "the object's masks in all frames": ("all masks",),
    "hand and mug in 3D": ("the clip", "the reconstruction"),
}
"""What is shown, and which of the timed steps it takes."""


class Film:
    """What the commands have made, and pictures of it."""

    def __init__(self, folder: Path, seconds: dict[str, float]) -> None:
        given, (result, _) = read_clip(folder / "clips" / MUG.name), read_result(folder / "results" / MUG.name)
        given = given.take(np.array([given.frames.index(name) for name in result.frames]))
        self.view = View.of(result, given, read_masks(given))
        self.found = FoundHands(folder / "draft" / FOLDER)
        self.drawn = labels.read(MUG.shown).frames
        self.seconds = [sum(seconds[part] for part in parts) for parts in STEPS.values()]
        self.size = tuple(round(ZOOM * n) for n in given.size)
        self.crops = steady_windows(self.view, SIDE)

    def pictures(self) -> Iterator[UInt8[ndarray, "H W 3"]]:
        """Yield all pictures, step by step."""
        frames = range(0, len(self.view.clip), EVERY)
        for n in frames:
            yield self._page(0, n, self._with_joints(self._silhouettes(n), n))
        for n in ASKED:
            strokes = _strokes(self.drawn[n])
            for count in range(len(strokes) + 1):
                yield self._page(1, n, self._with_strokes(self._silhouettes(n), strokes[:count]))
            for _ in range(PAUSE // 3):
                yield self._page(1, n, self._with_strokes(self._silhouettes(n, OBSERVED), strokes))
        for n in frames:
            yield self._page(2, n, self._silhouettes(n, OBSERVED, IGNORED))
        for n in (*frames, *[frames[-1]] * PAUSE):
            yield self._page(3, n, self._reconstructed(n), posed(self.view, n, self.crops, n, from_side=True)[0])

    def _silhouettes(self, n: int, thing: Sequence[int] = SEEN, hand: Sequence[int] = SEEN) -> UInt8[ndarray, "h w 3"]:
        """Draw the masks of a frame, which stand for the footage."""
        assert self.view.masks is not None
        seen = self.found.mask(n)
        out = np.full((*self.size[::-1], 3), BLANK, np.uint8)
        for mask, colour in ((seen, hand), (self.view.masks.object[n], thing)):
            if mask is not None:
                share = cv2.resize(mask.astype(np.float32), self.size, interpolation=cv2.INTER_AREA)[..., None]
                out = (out + share * (np.array(colour) - out)).astype(np.uint8)
        return out

    def _with_joints(self, picture: UInt8[ndarray, "h w 3"], n: int) -> UInt8[ndarray, "h w 3"]:
        if (joints := self.found.joints.get(n)) is not None:
            for a, b in BONES:
                _line(picture, joints[[a, b]], HAND_LINE, 3)
            for joint in joints:
                _line(picture, joint[None], INK, 6)
        return picture

    def _with_strokes(
        self, picture: UInt8[ndarray, "h w 3"], strokes: Sequence[tuple[Float[ndarray, "n 2"], str]]
    ) -> UInt8[ndarray, "h w 3"]:
        for stroke, colour in strokes:
            _line(picture, stroke, colour, 4)
        return picture

    def _reconstructed(self, n: int) -> UInt8[ndarray, "h w 3"]:
        """Draw hand and object from the camera, with the contour of the object's mask."""
        view = self.view
        K = np.diag([ZOOM, ZOOM, 1.0]) @ view.clip.K[n]
        shown = [(view.hand(n), view.clip.hand.faces, HAND), (view.object(n), view.clip.mesh.faces, OBJECT)]
        picture = np.asarray(render_rgb(shown, K, self.size, PAPER_RGB)).copy()
        assert view.masks is not None
        for line in mask_lines(view.masks.object[n]):
            _line(picture, line, FOUND, 2)
        return picture

    def _page(
        self, step: int, n: int, left: UInt8[ndarray, "h w 3"], turned: UInt8[ndarray, "n n 3"] | None = None
    ) -> UInt8[ndarray, "H W 3"]:
        """Set a picture beside the words of the steps, and the turned view below them."""
        left = left[ROWS]
        page = Image.new("RGB", (left.shape[1] + SIDE, len(left)), PAPER)
        page.paste(Image.fromarray(left), (0, 0))
        if turned is not None:
            page.paste(Image.fromarray(turned), (left.shape[1], TOP))
        draw = ImageDraw.Draw(page)
        draw.text((10, 10), f"frame {n + 1} of {len(self.view.clip)}", fill=FAINT, font=font(15))
        x = left.shape[1] + 14
        took = [f"{seconds:.0f} s" for seconds in self.seconds]
        took[1] = "by hand"
        for k, words in enumerate(STEPS):
            colour = INK if k == step else FAINT
            draw.text((x, 12 + 28 * k), f"{k + 1}  {words}", fill=colour, font=font(14))
            draw.text(
                (page.width - 10, 12 + 28 * k), took[k] if k <= step else "", fill=colour, font=font(14), anchor="ra"
            )
        if turned is not None:
            draw.text(
                (x, 12 + 28 * len(STEPS)), "left: from the camera; below: from the side", fill=FAINT, font=font(13)
            )
        return np.asarray(page)


def _strokes(frame: FrameLabels) -> list[tuple[Float[ndarray, "n 2"], str]]:
    """Return a frame's strokes and their colours: on the object, then beside it."""
    return [*((each, FOUND) for each in frame.on or ()), *((each, INK) for each in frame.off or ())]


def _line(picture: UInt8[ndarray, "h w 3"], points: Float[ndarray, "n 2"], colour: str, width: int) -> None:
    """Draw a line through points of the footage; a single one is a dot."""
    at = np.round(8.0 * (ZOOM * np.concatenate([points, points[-1:]]) - 0.5)).astype(np.int32)[:, None]
    cv2.polylines(picture, [at], False, tuple(bytes.fromhex(colour[1:])), width, cv2.LINE_AA, 3)


def main() -> None:
    """Make the film."""
    with TemporaryDirectory() as temporary:
        rows = made_by(MUG, DATA / "videos" / f"{MUG.name}.mp4", Path(temporary))
        film = Film(Path(temporary), {step: float(seconds) for step, seconds, _ in rows})
        first, *rest = (Image.fromarray(each) for each in film.pictures())
    first.save(PICTURE, save_all=True, append_images=rest, duration=EVERY * 33, loop=0, quality=QUALITY, method=6)
    print(PICTURE, PICTURE.stat().st_size)


if __name__ == "__main__":
    main()
