"""Rendered video with truth: a synthetic clip as a camera films it, with skin, forearm, texture, table and light.

Footage of people is somebody's; a rendered one belongs to nobody, can be made as often as one likes, and its hands,
masks and poses are known. It is made for eyes and for networks that find hands, and is no photograph: Lambert's law
with a highlight, one lamp with a soft shadow, procedural textures, a shutter that stays open, and a sensor's noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import vertex_normals
from getagrip.geometry.mesh_files import write_mesh
from getagrip.geometry.rasterize import depth_and_face, interpolate_vertex_values
from getagrip.io import files
from getagrip.io.images import write_video
from getagrip.synthetic.scene import Scene

SKIN_TONES = ((0.78, 0.55, 0.43), (0.88, 0.68, 0.56), (0.62, 0.42, 0.31), (0.42, 0.27, 0.19), (0.93, 0.76, 0.66))
CLOTH_TONES = ((0.20, 0.26, 0.36), (0.45, 0.18, 0.16), (0.24, 0.34, 0.26), (0.62, 0.60, 0.56))
OBJECT_TONES = ((0.16, 0.32, 0.52), (0.66, 0.22, 0.16), (0.85, 0.82, 0.74), (0.20, 0.44, 0.34), (0.86, 0.62, 0.18))
TABLE_TONES = ((0.55, 0.47, 0.38), (0.66, 0.66, 0.64), (0.36, 0.27, 0.20), (0.72, 0.69, 0.63))
"""Colours, red, green and blue in [0, 1], of which a video draws one each."""
FOREARM_LENGTH_M, SLEEVE_START_M = 0.45, 0.18
"""Length of the forearm behind the wrist, and where its sleeve begins."""
FOREARM_PROFILE_M = (-0.015, 0.01, 0.05, 0.22, 0.45), (0.012, 0.024, 0.028, 0.042, 0.05)
"""Radius of the forearm at distances behind the wrist; it grows out of the hand's wrist."""
TABLE_MARGIN_M, TABLE_DEPTH_M = 0.01, 2.5
"""Distance of the table's top below everything that moves, where the clip's world has no support, and from the camera
to its far edge."""
LAMP_DIRECTION, LAMP_SPREAD = np.array([-0.45, -0.35, 0.82]), 0.05
"""Direction to the lamp in the world (z up), and its angular radius [rad]: the softness of its shadow."""
SHADOW_MAP_PX, SHADOW_BIAS_M, SHADOW_BLUR_PX, N_LAMP_SPOTS = 512, 0.006, 2.0, 9
AMBIENT_LIGHT, LAMP_LIGHT = 0.5, 0.85
SHUTTER_FRACTION, N_SUBFRAMES = 0.4, 4
"""Share of the frame's duration for which the shutter is open, and moments drawn in it, each shifted in the pixel."""
BLUR_SIGMA_PX, READ_NOISE, SHOT_NOISE = 0.6, 0.006, 0.018
"""Blur of the lens, and standard deviation of the noise in the dark and, besides, in full light (white is 1)."""
GAMMA = 2.2
VIDEO_SIZE_PX = 960, 720
"""Width and height of a video that is written."""
VIDEO_FILE, MESH_FILE = "video.mp4", "mesh.obj"
BOX_MARGIN_PX = 4.0
"""Margin about the object of the box in the first frame."""


@dataclass(frozen=True)
class VideoLook:
    """Colours and patterns of a rendered video, drawn from its seed."""

    skin: Float[ndarray, "3"]
    sleeve: Float[ndarray, "3"]
    paint: Float[ndarray, "3"]
    label: Float[ndarray, "3"]
    table: Float[ndarray, "3"]
    waves: Float32[ndarray, "6 4"]
    """Directions and phases of the waves whose sum is the grain of all surfaces."""
    lamp: Float[ndarray, "3"] = field(default_factory=lambda: LAMP_DIRECTION)
    """Direction to the lamp in the world."""
    sleeve_start: float = SLEEVE_START_M
    """Distance from the wrist at which the sleeve begins [m]."""
    colours: Float[ndarray, "V 3"] | None = None
    """Colours of the object's vertices, of a scan, in place of paint."""

    @classmethod
    def draw(cls, seed: int) -> VideoLook:
        """Draw a look."""
        rng = np.random.default_rng([seed, *b"look"])
        tables = SKIN_TONES, CLOTH_TONES, OBJECT_TONES, OBJECT_TONES, TABLE_TONES
        skin, sleeve, paint, label, table = (np.array(tones[rng.integers(len(tones))]) for tones in tables)
        if np.abs(label - paint).sum() < 0.3:
            label = 1.0 - 0.8 * paint
        waves = np.concatenate([rng.normal(size=(6, 3)), rng.uniform(0.0, 2.0 * np.pi, (6, 1))], axis=1).astype(
            np.float32
        )
        return cls(skin, sleeve, paint, label, table, waves)

    def grain(self, points: Float[ndarray, "n 3"], period: float) -> Float32[ndarray, "n"]:
        """Compute a smooth pattern of waves about a ``period`` long [m], most of it in [-1, 1]."""
        pattern, frequency = np.zeros(len(points), np.float32), np.float32(2.0 * np.pi / period)
        for wave in self.waves:
            pattern += np.sin(points.astype(np.float32) @ (frequency * wave[:3]) + wave[3])
        return np.asarray(pattern / np.float32(np.sqrt(2.0 * len(self.waves))))


@dataclass(frozen=True)
class _Bodies:
    """Hand, forearm and object: what stays the same in all frames, by vertex.

    Attributes:
        faces: of all three.
        n_skin: vertices of hand and forearm; those of the object follow.
        place: a place that stays with the surface [m]; patterns are functions of it.
        red: how red the skin is, 0 to 1: at knuckles and fingertips.
        cloth: 1 where the sleeve covers the forearm.
        colours: of the vertices of a scan, else zero.
        table_height: height of the table's top in the world [m].
    """

    scene: Scene
    faces: Int[ndarray, "F 3"]
    n_skin: int
    place: Float[ndarray, "V 3"]
    red: Float[ndarray, "V"]
    cloth: Float[ndarray, "V"]
    colours: Float[ndarray, "V 3"]
    sleeve_start: float
    table_height: float

    @classmethod
    def of(cls, scene: Scene, look: VideoLook) -> _Bodies:
        """Make the bodies of a scene."""
        clip, truth = scene.clip, scene.clip.truth
        assert truth is not None
        assert clip.hand.joints is not None
        at_rest, joints = truth.hand_vertices[0], clip.hand.joints[0]
        tips = joints[[4, 8, 12, 16, 20]], joints[[3, 7, 11, 15, 19, 5, 9, 13, 17]]
        nearest = [np.linalg.norm(at_rest[:, None] - spots, axis=2).min(axis=1) for spots in tips]
        red = np.maximum(np.exp(-((nearest[0] / 0.012) ** 2)), 0.6 * np.exp(-((nearest[1] / 0.011) ** 2)))
        arm, arm_faces, along = _forearm(joints, look.sleeve_start)
        n_hand, n_skin = len(at_rest), len(at_rest) + len(arm)
        faces = np.concatenate([clip.hand.faces, arm_faces + n_hand, scene.object.faces + n_skin])
        place = np.concatenate([at_rest, arm, scene.object.vertices])
        rest = np.zeros(len(place) - n_hand)
        cloth = np.concatenate(
            [np.zeros(n_hand), (along > look.sleeve_start).astype(float), np.zeros(len(scene.object.vertices))]
        )
        colours = np.zeros((len(place), 3))
        colours[n_skin:] = 0.0 if look.colours is None else look.colours
        bodies = cls(scene, faces, n_skin, place, np.concatenate([red, rest]), cloth, colours, look.sleeve_start, 0.0)
        lowest = min(
            se3.transform(bodies.T_world_cam(n), bodies.vertices(float(n)))[:, 2].min() for n in range(0, len(clip), 3)
        )
        support = clip.world.support if clip.world is not None else None
        table = float(lowest) - TABLE_MARGIN_M if support is None else support
        return replace(bodies, table_height=table)

    def T_world_cam(self, n: int) -> Float[ndarray, "4 4"]:
        """Return the camera's pose in a frame."""
        assert self.scene.clip.world is not None
        return self.scene.clip.world.T_world_cam[n]

    def vertices(self, moment: float) -> Float[ndarray, "V 3"]:
        """Transform all vertices to the camera frame at a moment, in frames; between two frames they are blended."""
        n, last = int(np.floor(moment)), len(self.scene.clip) - 1
        first, second = (self._posed(min(max(k, 0), last)) for k in (n, n + 1))
        return np.asarray(first + (moment - n) * (second - first))

    def _posed(self, n: int) -> Float[ndarray, "V 3"]:
        clip, truth = self.scene.clip, self.scene.clip.truth
        assert truth is not None
        assert clip.hand.joints is not None
        hand = np.concatenate([truth.hand_vertices[n], _forearm(clip.hand.joints[n], self.sleeve_start)[0]])
        return np.concatenate(
            [se3.transform(truth.T_cam_hand[n], hand), se3.transform(truth.T_cam_obj[n], self.scene.object.vertices)]
        )


@dataclass(frozen=True)
class _Lamp:
    """The lamp: what the bodies hide of it, as depth maps from spots on it.

    Attributes:
        direction: to its middle, in the world.
        spots: rotation to each spot's frame, place of the spot, and its depth map.
    """

    direction: Float[ndarray, "3"]
    K: Float[ndarray, "3 3"]
    spots: tuple[tuple[Float[ndarray, "3 3"], Float[ndarray, "3"], Float32[ndarray, "s s"]], ...]

    @classmethod
    def over(cls, bodies: _Bodies, n: int, look: VideoLook) -> _Lamp:
        """Place the lamp over the bodies of a frame."""
        direction = look.lamp / np.linalg.norm(look.lamp)
        vertices = se3.transform(bodies.T_world_cam(n), bodies.vertices(float(n)))
        middle = vertices.mean(axis=0)
        radius = np.linalg.norm(vertices - middle, axis=1).max()
        away = 2.0 * radius + 1.0
        focal, centre = 0.5 * SHADOW_MAP_PX * np.sqrt(away**2 - radius**2) / radius, SHADOW_MAP_PX / 2
        K, size = (
            np.array([[focal, 0.0, centre], [0.0, focal, centre], [0.0, 0.0, 1.0]]),
            (SHADOW_MAP_PX, SHADOW_MAP_PX),
        )
        side = np.cross(direction, [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        spots = []
        for s in range(N_LAMP_SPOTS):
            angle, reach = (
                2.4 * s,
                LAMP_SPREAD * np.sqrt(s / N_LAMP_SPOTS),
            )  # a sunflower's spiral fills the disc evenly
            z = -(direction + reach * (np.cos(angle) * side + np.sin(angle) * np.cross(direction, side)))
            z /= np.linalg.norm(z)
            x = np.cross(side, z)
            x /= np.linalg.norm(x)
            R, spot = np.stack([x, np.cross(z, x), z]), middle - away * z
            spots.append((R, spot, depth_and_face((vertices - spot) @ R.T, bodies.faces, K, size)[0]))
        return cls(direction, K, tuple(spots))

    def lit(self, points: Float[ndarray, "n 3"]) -> Float32[ndarray, "n"]:
        """Compute the share of the lamp that points of the world see."""
        lit, near = np.zeros(len(points), np.float32), points.astype(np.float32)
        for R, spot, depth in self.spots:
            seen = near @ R.T.astype(np.float32) - (R @ spot).astype(np.float32)
            zoom = np.float32(self.K[0, 0]) / seen[:, 2]
            u, v = (zoom * seen[:, axis] + np.float32(SHADOW_MAP_PX / 2) for axis in (0, 1))
            column, row = (np.clip(x, 0, SHADOW_MAP_PX - 1).astype(np.int32) for x in (u, v))
            inside = (u >= 0) & (u < SHADOW_MAP_PX) & (v >= 0) & (v < SHADOW_MAP_PX)
            lit += ~inside | (seen[:, 2] < depth[row, column] + np.float32(SHADOW_BIAS_M))
        return lit / np.float32(N_LAMP_SPOTS)


def _forearm(
    joints: Float[ndarray, "21 3"], sleeve_start: float
) -> tuple[Float[ndarray, "A 3"], Int[ndarray, "G 3"], Float[ndarray, "A"]]:
    """Make a tapered tube behind the wrist, in the hand frame: vertices, faces, distance from the wrist [m]."""
    back = joints[0] - joints[9]
    back /= np.linalg.norm(back)
    across = np.cross(back, np.cross(joints[5] - joints[17], back))
    across /= np.linalg.norm(across)
    turn, along = np.linspace(0.0, 2.0 * np.pi, 33)[:-1], np.linspace(-0.015, FOREARM_LENGTH_M, 24)
    radius = np.interp(along, FOREARM_PROFILE_M[0], FOREARM_PROFILE_M[1]) + 0.004 * (along > sleeve_start)
    ring = 1.15 * np.cos(turn)[:, None] * across + 0.85 * np.sin(turn)[:, None] * np.cross(back, across)
    vertices = joints[0] + along[:, None, None] * back + radius[:, None, None] * ring
    r, c = np.meshgrid(np.arange(len(along) - 1), np.arange(32), indexing="ij")
    here, beside = r * 32 + c, r * 32 + (c + 1) % 32
    faces = np.stack([here, beside, here + 32, here + 32, beside, beside + 32], axis=-1).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces, np.repeat(along, 32)


def render_video(
    scene: Scene, size: tuple[int, int], seed: int = 0, look: VideoLook | None = None
) -> Iterator[UInt8[ndarray, "H W 3"]]:
    """Render the frames of a scene as pictures, one after the other.

    ``size`` is their width and height [px], to which the clip's camera is scaled; ``seed`` draws the noise and, where
    none is given, the look. Each frame is exposed about its moment in the clip: the clip's poses are those in the
    middle of its blur.
    """
    look = VideoLook.draw(seed) if look is None else look
    bodies, noise = _Bodies.of(scene, look), np.random.default_rng([seed, *b"sensor"])
    K = at_video_size(scene, size).clip.K[0]
    for n in range(len(scene.clip)):
        lamp = _Lamp.over(bodies, n, look)
        room = _draw_room(bodies, n, K, size, look, lamp)
        light = np.zeros_like(room)
        for s in range(N_SUBFRAMES):
            K_moved = K.copy()
            K_moved[:2, 2] += (s % 2 - 0.5) / 2.0, (s // 2 - 0.5) / 2.0
            moment = n + SHUTTER_FRACTION * ((s + 0.5) / N_SUBFRAMES - 0.5)
            light += _draw_bodies(bodies, moment, n, K_moved, look, lamp, room)
        yield _expose(light / N_SUBFRAMES, noise)


def _draw_room(
    bodies: _Bodies, n: int, K: Float[ndarray, "3 3"], size: tuple[int, int], look: VideoLook, lamp: _Lamp
) -> Float32[ndarray, "H W 3"]:
    """Render the light of the table and the wall behind the bodies, with the bodies' soft shadow."""
    import cv2

    T, half = bodies.T_world_cam(n), (size[0] // 2, size[1] // 2)  # it is out of focus: half of the pixels will do
    v, u = 2.0 * np.mgrid[: half[1], : half[0]].reshape(2, -1) + 1.0
    ray = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=1) @ T[:3, :3].T
    distance = np.minimum((bodies.table_height - T[2, 3]) / np.minimum(ray[:, 2], -1e-3), TABLE_DEPTH_M)
    on_table = (ray[:, 2] < -1e-3) & (distance < TABLE_DEPTH_M)
    ground = T[:3, 3] + distance[:, None] * ray
    lit = cv2.GaussianBlur(lamp.lit(ground).reshape(half[::-1]), (0, 0), SHADOW_BLUR_PX).ravel()
    wood = 1.0 + 0.06 * look.grain(ground * [1.0, 0.3, 1.0], 0.06) + 0.05 * look.grain(ground, 0.7)
    up = np.broadcast_to([0.0, 0.0, 1.0], ground.shape)
    table = _shade(ground, up, look.table * wood[:, None], lit, T[:3, 3], lamp.direction, np.full(len(ground), 0.03))
    wall = (0.6 * look.table) ** GAMMA * np.clip(0.9 + 0.5 * ray[:, 2:], 0.4, 1.2)
    light = np.where(on_table[:, None], table, wall).reshape(half[1], half[0], 3)
    return np.asarray(cv2.resize(light.astype(np.float32), size, interpolation=cv2.INTER_LINEAR))


def _draw_bodies(
    bodies: _Bodies,
    moment: float,
    n: int,
    K: Float[ndarray, "3 3"],
    look: VideoLook,
    lamp: _Lamp,
    room: Float32[ndarray, "H W 3"],
) -> Float32[ndarray, "H W 3"]:
    """Render the light of hand, forearm and object at a moment before the room, one sample a pixel."""
    T, vertices = bodies.T_world_cam(n), bodies.vertices(moment)
    _, face = depth_and_face(vertices, bodies.faces, K, (room.shape[1], room.shape[0]))
    shown = face >= 0
    normals = vertex_normals(vertices, bodies.faces) @ T[:3, :3].T
    columns = [se3.transform(T, vertices), normals, bodies.place, bodies.red[:, None], bodies.cloth[:, None]]
    columns.append(bodies.colours)
    values = interpolate_vertex_values(vertices, bodies.faces, K, face, np.concatenate(columns, axis=1))
    point, normal, place, red, cloth, own = np.split(values, [3, 6, 9, 10, 11], axis=1)
    is_object = bodies.faces[face[shown], 0] >= bodies.n_skin
    colour = _skin_colour(look, place, red[:, 0], cloth[:, 0])
    painted = look.colours is None
    colour[is_object] = _paint(look, place[is_object], bodies.place[bodies.n_skin :]) if painted else own[is_object]
    light = room.copy()
    shine = np.where(is_object, 0.25, 0.05)
    light[shown] = _shade(point, normal, colour, lamp.lit(point), T[:3, 3], lamp.direction, shine)
    return light


def _skin_colour(
    look: VideoLook, place: Float[ndarray, "n 3"], red: Float[ndarray, "n"], cloth: Float[ndarray, "n"]
) -> Float[ndarray, "n 3"]:
    """Colour skin, mottled and red at the knuckles, and the sleeve's weave."""
    mottled = 1.0 + 0.05 * look.grain(place, 0.02)[:, None] + 0.03 * look.grain(place, 0.004)[:, None]
    skin = look.skin * mottled + red[:, None] * np.array([0.05, -0.03, -0.02])
    weave = look.sleeve * (1.0 + 0.12 * look.grain(place, 0.003))[:, None]
    return np.asarray(np.where(cloth[:, None] > 0.5, weave, skin))


def _paint(look: VideoLook, place: Float[ndarray, "n 3"], vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "n 3"]:
    """Paint the object: a band around its middle, and a badge on one side of it, which tells front from back."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    x, y, z = ((place - low) / np.maximum(high - low, 1e-6)).T
    colour = look.paint * (1.0 + 0.04 * look.grain(place, 0.015))[:, None]
    band = (z > 0.32) & (z < 0.68)
    colour[band] = look.label
    stripe = np.abs(z - 0.5) > 0.155
    colour[band & stripe] = 0.35 * look.label
    badge = band & (np.hypot((y - 0.5) / 0.22, (z - 0.5) / 0.12) < 1.0) & (x > 0.5)
    colour[badge] = look.paint * 0.6
    bars = band & ~stripe & (x < 0.5) & (np.floor(z * 40.0) % 2 == 0) & (np.abs(y - 0.5) < 0.3)
    colour[bars] = 0.45 * look.label
    return np.asarray(colour)


def _shade(
    point: Float[ndarray, "n 3"],
    normal: Float[ndarray, "n 3"],
    colour: Float[ndarray, "n 3"],
    lit: Float[ndarray, "n"],
    eye: Float[ndarray, "3"],
    lamp: Float[ndarray, "3"],
    shine: Float[ndarray, "n"],
) -> Float[ndarray, "n 3"]:
    """Compute the light that leaves surfaces towards the eye: ambient light, the lamp's, and its highlight."""
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    to_eye = eye - point
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    normal = np.where(np.sum(normal * to_eye, axis=1, keepdims=True) < 0.0, -normal, normal)
    facing = np.clip(normal @ lamp, 0.0, 1.0)
    half = to_eye + lamp
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    highlight = shine * lit * np.clip(np.sum(normal * half, axis=1), 0.0, 1.0) ** 40
    ambient = AMBIENT_LIGHT * (0.8 + 0.2 * normal[:, 2])
    return np.asarray(colour**GAMMA * (ambient + LAMP_LIGHT * lit * facing)[:, None] + highlight[:, None])


def _expose(light: Float[ndarray, "H W 3"], rng: np.random.Generator) -> UInt8[ndarray, "H W 3"]:
    """Turn light into a picture: the lens blurs and darkens the corners, the sensor adds noise."""
    import cv2

    height, width = light.shape[:2]
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    light = cv2.GaussianBlur(light, (0, 0), BLUR_SIGMA_PX) * (1.0 - 0.12 * (x**2 + y**2))[..., None]
    picture = np.clip(light, 0.0, 1.0) ** (1.0 / GAMMA)
    noise = rng.normal(size=light.shape) * (READ_NOISE + SHOT_NOISE * np.sqrt(np.clip(light, 0.0, 1.0)))
    return np.asarray(np.round(255.0 * np.clip(picture + noise, 0.0, 1.0)), dtype=np.uint8)


@dataclass(frozen=True)
class RenderedVideo:
    """The files of a rendered video, and what a user would state about it."""

    video: Path
    mesh: Path
    K: tuple[float, float, float, float]
    """Focal lengths and principal point [px]."""
    box: tuple[float, float, float, float]
    """The object's box in the first frame: left, top, width, height [px]."""
    size_mm: float
    """The largest side of the object's bounding box."""

    def command(self) -> str:
        """Return the call that goes from the video to a result."""
        K, box = " ".join(f"{x:g}" for x in self.K), ",".join(f"{x:.0f}" for x in self.box)
        known = f"--object {self.mesh} --size-mm {self.size_mm:.0f} --K {K} --object-box {box}"
        return f"getagrip draft {self.video} {known} --no-page"


def at_video_size(scene: Scene, size: tuple[int, int]) -> Scene:
    """Return the scene as a camera of another size in pixels sees it."""
    clip = scene.clip
    zoom = np.diag([size[0] / clip.size[0], size[1] / clip.size[1], 1.0])
    return replace(scene, clip=replace(clip, size=size, K=zoom @ clip.K))


def write_rendered_video(
    scene: Scene,
    folder: Path,
    seed: int,
    on_frame: Callable[[], None] = lambda: None,
    size: tuple[int, int] = VIDEO_SIZE_PX,
    look: VideoLook | None = None,
    overwrite: bool = False,
) -> RenderedVideo:
    """Render a scene into a new folder, ``video.mp4`` and ``mesh.obj``; call ``on_frame`` after each frame.

    ``size``, ``seed`` and ``look`` are those of ``render_video``. With ``overwrite``, a folder with an older video is
    replaced.
    """

    def watched() -> Iterator[UInt8[ndarray, "H W 3"]]:
        for picture in render_video(scene, size, seed, look):
            yield picture
            on_frame()

    with files.new_folder(folder, (VIDEO_FILE, MESH_FILE) if overwrite and folder.exists() else ()) as made:
        rate = Fraction(scene.clip.fps).limit_denominator(1000)
        write_video(made / VIDEO_FILE, watched(), rate, size)
        write_mesh(scene.object, made / MESH_FILE)
    return describe_rendered_video(scene, folder, size)


def describe_rendered_video(scene: Scene, folder: Path, size: tuple[int, int] = VIDEO_SIZE_PX) -> RenderedVideo:
    """Return what a user would state about the video of a scene, in the folder that ``write_rendered_video`` made."""
    truth, K = scene.clip.truth, at_video_size(scene, size).clip.K[0]
    assert truth is not None
    uv = project(K, se3.transform(truth.T_cam_obj[0], scene.object.vertices))
    low, high = np.clip([uv.min(axis=0) - BOX_MARGIN_PX, uv.max(axis=0) + BOX_MARGIN_PX], 0.0, np.array(size))
    box = float(low[0]), float(low[1]), float(high[0] - low[0]), float(high[1] - low[1])
    pinhole = float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
    size_mm = 1e3 * float(np.ptp(scene.object.vertices, axis=0).max())
    return RenderedVideo(folder / VIDEO_FILE, folder / MESH_FILE, pinhole, box, size_mm)
