"""An object that jumps in the hand is found where it does; one that turns in it, also fast, is none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy import ndarray

from getagrip.checks import RESULT_CHECKS, Evidence, run_checks
from getagrip.checks.results import MIN_REGRASP_FRAMES, describe_largest_step, object_steps, regrasp_jump
from getagrip.geometry import se3
from helpers.scenes import scene

CHECK = [check for check in RESULT_CHECKS.values() if check.name == "regrasp"]


def held(T_hand_obj: ndarray) -> Evidence:
    clip, masks = scene("mug", 0)
    index = np.arange(len(T_hand_obj)) % len(clip)
    return Evidence(clip.take(index), masks.take(index), T_hand_obj)


def turning(by: ndarray) -> ndarray:
    """Turned by so many degrees."""
    return se3.rigid(se3.exp_so3(np.radians(by)[:, None] * [0.0, 0.0, 1.0]), np.zeros(3))


def test_an_object_that_is_held_still_does_not_move() -> None:
    it = held(turning(np.zeros(20)))
    assert np.allclose(object_steps(it), 0.0)
    assert regrasp_jump(it) == 0.0


@pytest.mark.parametrize("degrees", [30.0, 200.0])
def test_an_object_that_turns_evenly_does_not_jump(degrees: float) -> None:
    assert regrasp_jump(held(turning(np.linspace(0.0, degrees, 20)))) == 0.0


def test_an_object_that_turns_to_and_fro_does_not_jump() -> None:
    assert regrasp_jump(held(turning(30.0 * np.sin(np.linspace(0.0, 9.0, 30))))) == 0.0


def test_a_regrasp_is_found_where_it_is_and_named() -> None:
    it = held(turning(np.linspace(0.0, 20.0, 8) + np.where(np.arange(8) < 5, 0.0, 60.0)))
    assert int(np.argmax(object_steps(it))) == 4
    (finding,) = run_checks(CHECK, it)[1]
    assert not finding.serious
    assert describe_largest_step(it) == f"from frame {it.clip.frames[4]} to {it.clip.frames[5]}"
    assert describe_largest_step(it) in finding.message


def test_its_size_counts_in_diameters() -> None:
    T = turning(np.zeros(10))
    T[5:, 0, 3] = 0.3 * held(T).clip.mesh.diameter
    assert regrasp_jump(held(T)) == pytest.approx(0.3)


def test_few_frames_tell_nothing() -> None:
    assert np.isnan(regrasp_jump(held(turning(np.zeros(MIN_REGRASP_FRAMES - 1)))))
