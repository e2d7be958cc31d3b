"""Arrays that wait on disk: equal when they are read, and not in memory."""

import tracemalloc
from collections.abc import Iterator

import numpy as np

from getagrip.studio.masks.propagate_clip import _reversed_by_disk
from getagrip.studio.masks.propagate_frame import TrackedMask
from getagrip.studio.masks.small_frames import ArrayFile


def test_arrays_are_read_back_in_any_order_equal_in_every_bit() -> None:
    disk, rng = ArrayFile(), np.random.default_rng(0)
    put = [
        (rng.normal(size=(3, 4, 5)).astype(np.float32), rng.normal(size=(2, 2)).astype(np.float16)),
        (np.zeros((3, 0, 0), np.float32), np.array([np.nan, -0.0, np.inf])),
        (rng.normal(size=(6, 4))[::2, ::-1],),
    ]
    stored = [disk.put(*arrays) for arrays in put]
    for place in (2, 0, 1, 0):
        for read, array in zip(disk.get(stored[place]), put[place], strict=True):
            assert (read.shape, read.dtype, read.tobytes()) == (array.shape, array.dtype, array.tobytes())


def test_masks_that_are_followed_backwards_take_no_memory_that_grows_with_their_number() -> None:
    def mask(n: int) -> TrackedMask:
        layer = np.full((100, 100), float(n), np.float32)
        return TrackedMask(n, (n, 2 * n), np.stack([layer] * 3), layer, 1.0 / n, layer)

    def followed(count: int) -> Iterator[TrackedMask]:
        yield from map(mask, range(count, 0, -1))

    tracemalloc.start()
    for n, each in enumerate(_reversed_by_disk(followed(100), ArrayFile()), start=1):
        assert (each.frame, each.corner, each.trust) == (n, (n, 2 * n), 1.0 / n)
        assert all(np.array_equal(array, np.full((100, 100), n)) for array in (*each.inside, each.known, each.unlike))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert n == 100
    assert peak < 10 * 5 * mask(1).known.nbytes
