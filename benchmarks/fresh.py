"""Costs of a reconstruction in a new process, imports included: ``python -m benchmarks.fresh CLIP`` prints JSON."""

import json
import sys
import time
from pathlib import Path


def peak_memory() -> float:
    """Return the peak memory of this process [MB].

    Read from Linux's VmHWM: a process inherits the maximum of ``getrusage`` from its parent.
    """
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6


def main(folder: str) -> dict[str, float]:
    """Import, read the clip, reconstruct it twice; return CPU times [s] and peak memory [MB] of the steps."""
    from getagrip.clip import read_clip, read_masks
    from getagrip.reconstruct import reconstruct

    imported, memory_imported = time.process_time(), peak_memory()
    clip = read_clip(folder)
    masks = read_masks(clip)
    read, memory_read = time.process_time(), peak_memory()
    reconstruct(clip, masks)
    first = time.process_time()
    reconstruct(clip, masks)
    memory = {"memory imports": memory_imported, "memory read": memory_read, "memory": peak_memory()}
    seconds = [imported, read - imported, first - read, time.process_time() - first]
    return dict(zip(("imports", "read", "first", "second"), seconds, strict=True)) | memory


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1])))
