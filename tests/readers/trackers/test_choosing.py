"""Where an estimator found several hands of a side in a frame, one is chosen, and it is said."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.provenance import estimated
from getagrip.readers.trackers.estimates import Estimate, HandParameters, Request
from getagrip.readers.trackers.read_hands import choose_frame_hands
from helpers.hand_files import SIZE, K

SHAPE = np.random.default_rng(0).uniform(-0.06, 0.06, (21, 3))
FRAMES = tuple(f"{n:06d}" for n in range(1, 7))
HELD, OTHER = [np.stack([x + 0.01 * np.arange(6), np.zeros(6), np.full(6, z)], 1) for x, z in ((-0.1, 0.5), (0.2, 0.6))]


def hand(frame: int, at: ndarray) -> Estimate:
    return Estimate(Path("x"), frame, estimated(""), None, SHAPE + at)


def request(masks: tuple[Path | None, ...] = ()) -> Request:
    return Request("right", FRAMES, np.tile(K, (6, 1, 1)), SIZE, hand_masks=masks)


def chosen(hands: list[Estimate], masks: tuple[Path | None, ...] = ()) -> tuple[ndarray, str]:
    """Where the chosen hands are, and how they were."""
    found, how = choose_frame_hands(hands, request(masks))
    assert [each.frame for each in found] == sorted({each.frame for each in hands})
    return np.array([each.joints.mean(axis=0) - SHAPE.mean(axis=0) for each in found if each.joints is not None]), str(
        how or ""
    )


def test_one_hand_in_each_frame_is_no_choice() -> None:
    at, how = chosen([hand(n, HELD[n]) for n in (3, 0, 1)])
    np.testing.assert_allclose(at, HELD[[0, 1, 3]])
    assert how == ""


@pytest.mark.parametrize("alone", [[0], [5], [2], [0, 5]])
@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_nearest_to_that_of_frames_with_one(alone: list[int], seed: int) -> None:
    hands = [hand(n, HELD[n]) for n in range(6)] + [hand(n, OTHER[n]) for n in range(6) if n not in alone]
    at, how = chosen([hands[n] for n in np.random.default_rng(seed).permutation(len(hands))])
    np.testing.assert_allclose(at, HELD)
    assert f"several right hands in {6 - len(alone)} of 6 frames" in how
    assert "guess" in how


@pytest.mark.parametrize("larger", [0, 1])
def test_of_two_in_every_frame_the_larger_in_the_images_is_followed(larger: int) -> None:
    tracks = [HELD.copy(), OTHER.copy()]
    tracks[larger][:, 2] = 0.35
    both = [hand(n, tracks[row][n]) for n in range(6) for row in ((0, 1) if n % 2 else (1, 0))]
    at, how = chosen(both)
    np.testing.assert_allclose(at, tracks[larger])
    assert "the largest in the images" in how


def test_the_hands_mask_tells_first(tmp_path: Path) -> None:
    """In the frames whose mask shows it; from these on, the nearest."""
    masks: list[Path | None] = []
    for n in range(6):
        image = np.zeros(SIZE[::-1], np.uint8)
        u, v = (K @ OTHER[n])[:2] / OTHER[n][2]
        if n == 3:
            cv2.circle(image, (round(u), round(v)), 60, 255, -1)
        masks.append(tmp_path / f"{n}.png" if n > 1 else None)
        cv2.imwrite(str(tmp_path / f"{n}.png"), image)
    at, how = chosen([hand(n, track[n]) for n in range(6) for track in (HELD, OTHER)], tuple(masks))
    np.testing.assert_allclose(at, OTHER)
    assert "by the hand's mask in 1, the nearest to the hand of the frame before or after in 5" in how


def test_hands_without_joints_are_placed_by_their_pose() -> None:
    def of_mano(frame: int, at: ndarray) -> Estimate:
        return Estimate(Path("x"), frame, estimated(""), HandParameters(np.eye(3), np.zeros(45), np.zeros(10), at))

    hands = [of_mano(0, HELD[0]), of_mano(1, OTHER[1]), of_mano(1, HELD[1])]
    found, _ = choose_frame_hands(hands, request())
    assert [each.mano.t.tolist() for each in found if each.mano is not None] == HELD[:2].tolist()
