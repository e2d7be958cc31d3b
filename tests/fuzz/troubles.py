"""Impossible troubles of clips: what no recording should have, and some have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from getagrip.bench.inputs.wrong_inputs import INPUT_MISTAKES, Mistake
from getagrip.clip import Clip, Masks
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MAX_MESH_EXTENT_M, MIN_MESH_EXTENT_M


def behind(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The hand behind the camera in some frames."""
    T = clip.hand.T_cam_hand.copy()
    T[rng.random(len(T)) < 0.5, 2, 3] *= -1.0
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def through(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The hand so near that the camera's plane cuts hand and object."""
    T = clip.hand.T_cam_hand.copy()
    T[:, 2, 3] = rng.uniform(-0.05, 0.1)
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def giant_focal(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """A focal length of a million pixels, or of one."""
    K = clip.K.copy()
    K[:, [0, 1], [0, 1]] = rng.choice([1e6, 1.0])
    return replace(clip, K=K), masks


def contradicting(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The mask here in one frame and there in the next."""
    shown = masks.object.copy()
    shown[::2] = np.roll(shown[::2], shown.shape[2] // 3, axis=2)
    return clip, Masks(shown, masks.ignore & ~shown)


def leaving(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The object leaves the image after the first two frames, or but for a column of pixels."""
    shown = masks.object.copy()
    shown[2:, :, : rng.choice([shown.shape[2], shown.shape[2] - 1])] = False
    shown[2:, :, -1:] |= masks.object[2:].any(axis=2, keepdims=True) & bool(rng.random() < 0.5)
    return clip, Masks(shown, masks.ignore & ~shown)


def all_ignored(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Nothing known but the object's pixels."""
    return clip, Masks(masks.object, ~masks.object)


def whole_image(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The object covers every pixel."""
    return clip, Masks(np.ones_like(masks.object), np.zeros_like(masks.ignore))


def soup(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Triangles at random where the mesh was: no surface, edges of one face or of many."""
    low, high = clip.mesh.vertices.min(axis=0), clip.mesh.vertices.max(axis=0)
    vertices = rng.uniform(low, high, (60, 3))
    faces = np.array([rng.choice(60, 3, replace=False) for _ in range(200)])
    return replace(clip, mesh=Mesh(vertices, faces)), masks


def inside_out(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Half of the faces wound the other way."""
    faces = clip.mesh.faces.copy()
    turned = rng.random(len(faces)) < 0.5
    faces[turned] = faces[turned, ::-1]
    return replace(clip, mesh=Mesh(clip.mesh.vertices, faces)), masks


def one_triangle(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """One triangle for a mesh."""
    return replace(clip, mesh=Mesh(clip.mesh.vertices[clip.mesh.faces[0]], np.array([[0, 1, 2]]))), masks


def large_mesh(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Every face cut into sixteen, three times over: hundreds of thousands of them."""
    mesh = clip.mesh
    while len(mesh.faces) < 200_000:
        mesh = quartered(mesh)
    return replace(clip, mesh=mesh), masks


def quartered(mesh: Mesh) -> Mesh:
    """Each face as four."""
    a, b, c = mesh.faces.T
    V = len(mesh.vertices)
    pairs = np.sort(np.concatenate([np.stack(ends, axis=1) for ends in ((a, b), (b, c), (c, a))]), axis=1)
    edges, of = np.unique(pairs, axis=0, return_inverse=True)
    ab, bc, ca = V + of.reshape(3, -1)
    corners = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    faces = np.concatenate([np.stack(ids, axis=1) for ids in corners])
    return Mesh(np.concatenate([mesh.vertices, mesh.vertices[edges].mean(axis=1)]), faces)


def million_faces(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Every face cut into four, until there are a million."""
    mesh = clip.mesh
    while len(mesh.faces) < 1_000_000:
        mesh = quartered(mesh)
    return replace(clip, mesh=mesh), masks


def fins(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Edges of three faces and more: on every tenth face stands another, on its edge."""
    mesh = clip.mesh
    chosen = mesh.faces[:: max(1, len(mesh.faces) // 40)]
    tips = 1.3 * mesh.vertices[chosen].mean(axis=1)
    ids = len(mesh.vertices) + np.arange(len(tips))
    stand = np.stack([chosen[:, 0], chosen[:, 1], ids], axis=1)
    return replace(clip, mesh=Mesh(np.concatenate([mesh.vertices, tips]), np.concatenate([mesh.faces, stand]))), masks


def any_size(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """A mesh of any size that is allowed, at any distance from its own origin."""
    extent = np.ptp(clip.mesh.vertices, axis=0).max()
    size = np.exp(rng.uniform(np.log(1.01 * MIN_MESH_EXTENT_M), np.log(0.99 * MAX_MESH_EXTENT_M)))
    shift = rng.choice([0.0, 1.0, 100.0]) * rng.normal(size=3)
    return replace(clip, mesh=Mesh(clip.mesh.vertices * (size / extent) + shift, clip.mesh.faces)), masks


def two_thousand_frames(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The clip to and fro, until it has 2,000 frames."""
    there = np.arange(len(clip))
    index = np.resize(np.concatenate([there, there[::-1]]), 2000)
    frames = tuple(f"{n:06d}" for n in range(len(index)))
    hand = clip.hand
    hand = replace(
        hand, vertices=hand.vertices[index], T_cam_hand=hand.T_cam_hand[index],
        joints=None if hand.joints is None else hand.joints[index],
    )  # fmt: skip
    world = None if clip.world is None else clip.world.take(index)
    times = np.arange(len(index)) / clip.fps
    return replace(clip, frames=frames, K=clip.K[index], hand=hand, times=times, world=world), masks.take(index)


def blobs(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """For masks, rectangles anywhere, of any size."""
    shown = np.zeros_like(masks.object)
    for mask in shown:
        (top, bottom), (left, right) = (np.sort(rng.integers(0, side + 1, 2)) for side in mask.shape)
        mask[top:bottom, left:right] = True
    return clip, Masks(shown, masks.ignore & ~shown)


def blinking(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The object is not visible in most frames."""
    shown = masks.object & (rng.random(len(masks.object)) < 0.4)[:, None, None]
    return clip, Masks(shown, masks.ignore)


def at_the_border(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Of each mask what lies in one row or column of the image."""
    shown = np.zeros_like(masks.object)
    if rng.random() < 0.5:
        shown[:, rng.choice([0, -1])] = masks.object.any(axis=1)
    else:
        shown[:, :, rng.choice([0, -1])] = masks.object.any(axis=2)
    return clip, Masks(shown, masks.ignore & ~shown)


def tumbling(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The hand turned at random in each frame."""
    T = clip.hand.T_cam_hand.copy()
    T[:, :3, :3] = se3.from_quaternion(rng.normal(size=(len(T), 4)))
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def standing_still(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The first frame again and again."""
    index = np.zeros(len(clip), dtype=int)
    hand = clip.hand
    joints = None if hand.joints is None else hand.joints[index]
    still = replace(hand, vertices=hand.vertices[index], T_cam_hand=hand.T_cam_hand[index], joints=joints)
    return replace(clip, hand=still), masks.take(index)


def crumpled_hand(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The hand's vertices in a lump a hundredth as large, or each where another one was."""
    vertices = clip.hand.vertices
    middle = vertices.mean(axis=1, keepdims=True)
    lump = middle + 0.01 * (vertices - middle)
    other = vertices[:, rng.permutation(vertices.shape[1])]
    return replace(clip, hand=replace(clip.hand, vertices=other if rng.random() < 0.7 else lump)), masks


TROUBLES: dict[str, Mistake] = {
    **INPUT_MISTAKES,
    "behind the camera": behind,
    "through the camera": through,
    "giant focal length": giant_focal,
    "contradicting masks": contradicting,
    "leaving the image": leaving,
    "all ignored": all_ignored,
    "whole image": whole_image,
    "soup": soup,
    "inside out": inside_out,
    "one triangle": one_triangle,
    "large mesh": large_mesh,
    "million faces": million_faces,
    "fins": fins,
    "any size": any_size,
    "2,000 frames": two_thousand_frames,
    "blobs": blobs,
    "blinking": blinking,
    "at the border": at_the_border,
    "tumbling": tumbling,
    "standing still": standing_still,
    "crumpled hand": crumpled_hand,
}
RARE = ("large mesh", "million faces", "2,000 frames")
"""These take seconds: they are drawn a tenth as often."""
