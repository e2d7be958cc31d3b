"""Options of a synthetic clip, and presets of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

from getagrip.io.options import check_values
from getagrip.synthetic.noise import NOISE_PRESETS, Noise


@dataclass(frozen=True)
class SceneOptions(Noise):
    """The options of a synthetic clip, besides the errors of hands and masks (``Noise``).

    Attributes:
        frames: number of frames, at least 2.
        fps: frames per second; with measured motion, the duration is drawn instead.
        size: width and height of the images [px].
        focal: focal length [px].
        side: ``left`` or ``right`` hand.
        scale: ``known``: the clip's mesh has the object's size. ``free``: it is divided by an unknown scale between 0.8
            and 1.25.
        vary: maximum relative stretch of the object along each axis.
        deform: root mean square displacement of the object's surface by an additional smooth deformation [diameters].
        cad: ``exact``: the clip's mesh has the object's shape. ``mean``: it has the category's mean shape.
        grip_deg: root mean square rotation of the object in the hand away from a usual grip [degrees]; above zero,
            rarer grips occur as well.
        motion: motion of the object in the hand. ``hinge``: nearly about one axis, within the next three limits.
            ``measured``: drawn from the statistics of real grasps.
        turn_deg: minimum and maximum range of the angle about the axis over the clip [degrees].
        residual_deg: maximum rotation of the object in the hand besides that about the axis [degrees].
        residual_mm: maximum translation of the object in the hand besides that by the axis [mm].
        other_hand: True if the other hand comes in front of the object.
    """

    frames: int = 30
    fps: float = 30.0
    size: tuple[int, int] = (640, 480)
    focal: float = 600.0
    side: Literal["left", "right"] = "right"
    scale: Literal["known", "free"] = "known"
    vary: float = 0.08
    deform: float = 0.0
    cad: Literal["exact", "mean"] = "exact"
    grip_deg: float = 0.0
    motion: Literal["hinge", "measured"] = "hinge"
    turn_deg: tuple[float, float] = (10.0, 60.0)
    residual_deg: float = 1.0
    residual_mm: float = 1.0
    other_hand: bool = False

    def __post_init__(self) -> None:
        check_values(self)


DEMO_SCENE_OPTIONS = SceneOptions(hand_jitter_deg=0.5, hand_jitter_mm=0.5, mask_ragged_px=0.7)
"""Options of ``getagrip demo``: small noise on hands and masks; 30 frames of 1-DoF motion with a small residual."""
SYNTHETIC_PRESETS: dict[str, SceneOptions] = {
    "clean": SceneOptions(),
    "moderate": SceneOptions(**asdict(NOISE_PRESETS["moderate"])),
    "strong": SceneOptions(**asdict(NOISE_PRESETS["strong"])),
    "estimated": SceneOptions(**asdict(NOISE_PRESETS["estimated"])),
    "wild": SceneOptions(**asdict(NOISE_PRESETS["moderate"]), cad="mean", vary=0.15, scale="free"),
    "measured": SceneOptions(
        **asdict(NOISE_PRESETS["moderate"]), cad="mean", vary=0.15, deform=0.03, scale="free", motion="measured"
    ),
}
"""Options by name: exact inputs; noisy hands and masks; only the mean shape, without its size, as for videos."""
