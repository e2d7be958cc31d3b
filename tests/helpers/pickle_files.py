"""Arrays to pickle, pickles read as users have them read, and a process of its own to read forged ones in."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from getagrip.io import pickles

PATH = Path("a.pkl")


PROTOCOLS = range(6)


HERE = np.arange(24.0).reshape(2, 3, 4)


ARRAYS = {
    **{kind: np.arange(6).reshape(2, 3).astype(kind) for kind in ("?", "i1", "u1", "i2", "u4", "i8", "u8", "f2", "f4")},
    "big-endian": np.arange(6.0).reshape(2, 3).astype(">f8"),
    "Fortran": np.asfortranarray(HERE),
    "turned": HERE.transpose(1, 0, 2),
    "every other": HERE[:, ::2],
    "0-d": np.array(2.5),
    "empty": np.zeros((0, 3)),
    "text": np.array([["plate", "böwl"]]),
    "bytes": np.array([b"plate", b"a\0b"]),
}


def read(content: bytes) -> dict[str, object]:
    return pickles.read_pickle_dict(PATH, content, "a dictionary")


def same(got: Any, given: np.ndarray) -> bool:
    """Whether an array is what it was, layout and byte order included, and can be written to."""
    layout = all(got.flags[flag] == given.flags[flag] for flag in ("C_CONTIGUOUS", "F_CONTIGUOUS"))
    own = type(got) is np.ndarray and got.flags.writeable and got.flags.aligned
    return own and layout and got.dtype == given.dtype and got.shape == given.shape and bool((got == given).all())


CHILD = """
import json, pickle, sys
from pathlib import Path
import numpy as np
from getagrip.errors import InputError
from getagrip.hands.mano import read_mano_pickle

def touch(value):
    repr(value)
    if isinstance(value, np.ndarray):
        value.copy().tolist()
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ():
        touch(part)

done = {"read": 0, "refused": 0}
for content in pickle.load(sys.stdin.buffer):
    try:
        touch(read_mano_pickle(Path("a.pkl"), content))
        done["read"] += 1
    except InputError as error:
        assert not isinstance(error.__cause__, MemoryError), content[:100]
        done["refused"] += 1
print(json.dumps(done))
"""


def in_a_child(contents: list[bytes], before: str = "") -> dict[str, int]:
    """How many of the pickles another process reads and refuses; it must survive them all."""
    child = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", before + CHILD],
        input=pickle.dumps(contents), capture_output=True, timeout=120, check=False, env=os.environ,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr.decode()[-2000:]
    done: dict[str, int] = json.loads(child.stdout)
    assert sum(done.values()) == len(contents)
    return done
