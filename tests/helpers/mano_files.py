"""Random numbers in the layout of MANO's published files, pickled as they are."""

from __future__ import annotations

import pickle
import sys
import types
from typing import Any

import numpy as np
import pytest

from getagrip.hands import generic, mano
from getagrip.hands.model import KNUCKLES, PARENTS, Side


def make_class(monkeypatch: pytest.MonkeyPatch, module: str, name: str) -> type:
    """A class that pickles under the name of one of chumpy's or old scipy's."""
    kind = type(name, (), {"__module__": module})
    where = types.ModuleType(module)
    setattr(where, name, kind)
    for parent in (module.split(".", maxsplit=1)[0], module):
        if parent not in sys.modules or parent == module:
            monkeypatch.setitem(sys.modules, parent, where)
    return kind


def holding(kind: type, **state: Any) -> Any:
    it = kind()
    it.__dict__.update(state)
    return it


def fake_mano(monkeypatch: pytest.MonkeyPatch, side: Side = "right") -> dict[str, Any]:
    """Random numbers in the layout of the published file; vertices and weights are some of the generic hand's."""
    ch = make_class(monkeypatch, "chumpy.ch", "Ch")
    select = make_class(monkeypatch, "chumpy.reordering", "Select")
    csc = make_class(monkeypatch, "scipy.sparse.csc", "csc_matrix")
    rng = np.random.default_rng(0)
    hand = generic.load(side)
    some = rng.permutation(len(hand.template))[:778]
    v, weights = hand.template[some], hand.weights[some]
    J_regressor = np.zeros((16, 778))
    for j in range(16):  # each joint is the mean of two vertices
        pair = np.array([2 * j, 2 * j + 1])
        J_regressor[j, pair] = 0.5
        v[pair] = hand.joints[j] + 0.01 * np.array([[1.0], [-1.0]])
    for n, tip in enumerate(mano.FINGERTIP_VERTICES[side]):
        v[tip] = hand.template[hand.tips[n]]
        weights[tip] = np.arange(16) == KNUCKLES[n] + 2
    cols, rows = np.nonzero(J_regressor.T)
    x = rng.normal(scale=1e-3, size=(778, 3, 20))
    kept = np.arange(x.size).reshape(x.shape)[:, :, :10].ravel()
    return {
        "hands_components": rng.normal(size=(45, 45)),
        "hands_coeffs": rng.normal(size=(1554, 45)),
        "hands_mean": rng.normal(scale=0.2, size=45),
        "f": rng.integers(0, 778, size=(1538, 3)).astype(np.uint32),
        "J_regressor": holding(
            csc,
            _shape=(16, 778),
            maxprint=50,
            data=J_regressor[rows, cols],
            indices=rows.astype(np.int32),
            indptr=np.searchsorted(cols, np.arange(779)).astype(np.int32),
        ),
        "kintree_table": np.array([[2**32 - 1, *PARENTS[1:]], range(16)], dtype=np.uint32),
        "J": J_regressor @ v,
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "posedirs": rng.normal(scale=1e-3, size=(778, 3, 135)),
        "shapedirs": holding(select, a=holding(ch, x=x), idxs=kept, preferred_shape=(778, 3, 10)),
        "v_template": v,
        "bs_style": "lbs",
        "bs_type": "lrotmin",
        "pose_training_info": {"gender": set()},
    }


def python2(content: object) -> bytes:
    """A protocol 2 pickle with the module names of that time."""
    return pickle.dumps(content, protocol=2).replace(b"cnumpy._core.", b"cnumpy.core.")
