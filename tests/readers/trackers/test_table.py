"""Trackers are chosen by name, with their own options."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import UsageError
from getagrip.readers.trackers import TRACKERS, choose_tracker, read_tracked_hands
from getagrip.readers.trackers.hawor import HaWoR
from getagrip.readers.trackers.joints import Joints
from getagrip.readers.trackers.mano_parameters import ManoParameters
from helpers.environment import Run
from helpers.hand_files import request, write_npz


def test_what_no_file_states_is_asked_for(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "hands.npz", {"transl": np.zeros((3, 3))})
    for tracker, word in [
        (ManoParameters(mean="flat"), "--pose"),
        (ManoParameters(pose="pca"), "--mean"),
        (Joints(), "--order"),
    ]:
        with pytest.raises(UsageError, match=word):
            read_tracked_hands([path], tracker, request("right"))


def test_trackers_are_chosen_by_name() -> None:
    for name, tracker in TRACKERS.items():
        assert choose_tracker(name) is tracker
    with pytest.raises(UsageError, match="unknown --from 'hammer'; choose from hamer, wilor, hawor, frankmocap, mano,"):
        choose_tracker("hammer")


@pytest.mark.slow
def test_the_command_takes_what_the_table_lists(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    status, out, _ = run("import", "hands", "--help")
    assert status == 0
    assert f"--from {{{','.join(TRACKERS)}}}" in out
    for tracker in TRACKERS.values():
        for option in vars(tracker):
            assert f"--{option.replace('_', '-')} " in out
    status, _, err = run("import", "hands", "x.npz", "--from", "hammer", "--clip", "x")
    assert status == 2
    assert all(name in err for name in TRACKERS)


def test_options_of_another_tracker_are_refused() -> None:
    given = {**TRACKERS, "hawor": HaWoR(estimator_focal=600.0)}
    assert choose_tracker("hawor", given) == HaWoR(600.0)
    with pytest.raises(UsageError, match=r"--estimator-focal cannot be used with .*: it belongs to --from hawor"):
        choose_tracker("hamer", given)
