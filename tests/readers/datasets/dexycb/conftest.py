"""A small scene in DexYCB's layouts."""

import shutil

import numpy as np
import pytest

from helpers.dexycb_files import packed, read, write_dexycb, write_models


@pytest.fixture(scope="session")
def kept(tmp_path_factory):
    """DexYCB's own layout, in which nothing may be changed."""
    return write_dexycb(tmp_path_factory.mktemp("dexycb"))


@pytest.fixture
def root(kept, tmp_path):
    """The same, to be broken."""
    return shutil.copytree(kept, tmp_path, dirs_exist_ok=True)


@pytest.fixture(scope="session")
def own(kept):
    """The one clip of it and its masks, and what was noted."""
    notes = []
    ((clip, masks),) = read(kept, note=notes.append)
    return clip, masks, notes


@pytest.fixture
def pack(tmp_path):
    """A folder with a packed file, and the folder of meshes."""
    write_models(tmp_path / "ycb")
    (tmp_path / "packed").mkdir()
    np.savez(tmp_path / "packed" / "sequences.npz", **packed())
    return tmp_path / "packed", tmp_path / "ycb"
