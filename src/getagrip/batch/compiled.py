"""The kernels, compiled once on a machine before its processes do anything: others wait, then load what is there."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from getagrip.io import code, files, locks


def compile_once() -> None:
    """Have all kernels of a reconstruction compiled, unless they are; they are kept on disk. Raises nothing.

    Of several processes one does it. A mark says that it is done.
    """
    mark = mark_file()
    if _is_set(mark):
        return
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
        with locks.holding(mark):
            if not _is_set(mark):
                reconstruct_small()
                files.write_text(mark, code.fingerprint())
    except Exception:  # a full disk, no room in memory: the clips will say what is wrong
        return


def reconstruct_small() -> None:
    """Reconstruct a small clip in memory: with it, all kernels are compiled, whatever the method."""
    from getagrip.datasets.synthetic.scene import synthesise
    from getagrip.datasets.synthetic.scene_options import SceneOptions
    from getagrip.timelines.reconstruct import reconstruct

    reconstruct(*synthesise("can", 0, SceneOptions(frames=6)))


def _is_set(mark: Path) -> bool:
    """Return whether the kernels of this code are compiled."""
    return mark.is_file() and files.read_bytes(mark) == code.fingerprint().encode()


def mark_file() -> Path:
    """Return the mark: beside numba's cache, named like it, and so removed with it.

    Its name says what kernels are compiled for, since several machines may see one folder.
    """
    import numba
    from numba.core.registry import cpu_target

    from getagrip.kernels.silhouette import silhouettes

    processor = cpu_target.target_context.codegen().magic_tuple()  # by which numba tells apart what it keeps
    kind = hashlib.sha256(repr((processor, numba.__version__, sys.version_info[:3])).encode()).hexdigest()
    return Path(silhouettes.stats.cache_path) / f"getagrip.{kind[:16]}.nbi"
