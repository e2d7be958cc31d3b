"""A batch on a Ray cluster, from an object store and back, while a node and then the driver are killed.

``python -m benchmarks.killed`` prints what became of the clips; ``--write`` puts it into docs/scale.md. Cluster
and store (moto) run on this machine. Needs the extras ray and s3, and moto.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import page
from getagrip.clip import write_clip
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.io.storage import Remote

CLIPS, NODES = 24, 3
NODE_DIES, DRIVER_DIES = 5, 12
"""After so many results."""
SCENE = SceneOptions(frames=10)
RECONSTRUCT = (sys.executable, "-m", "getagrip", "reconstruct", "--quiet")
DOCTOR = (sys.executable, "-m", "getagrip", "doctor", "--quiet")
STORE = "s3://bucket"


def section(folder: Path) -> str:
    """Do it; what to say of it."""
    sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
    from helpers.object_store import BUCKET, s3_server
    from helpers.ray_cluster import ray_cluster

    with s3_server() as env:
        os.environ.update(env, XDG_STATE_HOME=str(folder / "state"))
        import s3fs

        store = s3fs.S3FileSystem(use_listings_cache=False)
        store.mkdir(BUCKET)
        subprocess.run(DOCTOR, check=False)  # kernels compiled in the run itself give other bits (docs/scale.md)
        _make_clips(folder / "clips")
        with ray_cluster(NODES) as cluster:
            call = [*RECONSTRUCT, f"{STORE}/clips", "--out", f"{STORE}/out", "--engine", "ray"]
            call += ["--address", cluster.address]
            driver = subprocess.Popen(call)
            node = len(_wait_for(store, NODE_DIES))
            cluster.kill_node()
            _wait_for(store, DRIVER_DIES)
            driver.send_signal(signal.SIGKILL)
            driver.wait()
            before = _results(store)
            subprocess.run(call, check=True)
            after = _results(store)
        subprocess.run([*RECONSTRUCT, str(folder / "clips"), "--out", str(folder / "here")], check=True)
        Remote(f"{STORE}/out").copy_to(folder / "there")
    kept = sum(after[name] == when for name, when in before.items())
    equal = sum(_equal(folder / "here" / name, folder / "there" / name) for name in after)
    return (
        f"{CLIPS} clips from a store on a Ray cluster of {NODES + 1} nodes, one CPU each. A node was killed after "
        f"{node} clips, the driver after {len(before)}. The second call left {kept} of these as they were, and did "
        f"{len(after) - len(before)}. In the end {len(after)} results, {equal} of them equal to those of one machine, "
        "to the bit (but for times and the clip's place)."
    )


def _make_clips(folder: Path) -> None:
    """On the disk and in the store."""
    for n in range(CLIPS):
        clip, masks = synthesise(list(CATEGORIES)[n % len(CATEGORIES)], n, SCENE)
        made = write_clip(replace(clip, name=f"clip-{n:02d}"), masks, folder / f"clip-{n:02d}")
        for path in made.rglob("*"):
            if path.is_file():
                (Remote(f"{STORE}/clips/{made.name}") / str(path.relative_to(made))).write(path.read_bytes())


def _results(store: Any) -> dict[str, Any]:
    """When each result in the store was written."""
    there = store.find(f"{STORE}/out", detail=True).items()
    return {path.split("/")[-2]: entry["LastModified"] for path, entry in there if path.endswith("/result.json")}


def _wait_for(store: Any, count: int) -> dict[str, Any]:
    while len(there := _results(store)) < count:
        time.sleep(0.2)
    return there


def _equal(one: Path, other: Path) -> bool:
    records = [json.loads((folder / "result.json").read_text()) for folder in (one, other)]
    for record in records:
        del record["seconds"], record["clip_folder"]
    return records[0] == records[1] and (one / "result.npz").read_bytes() == (other / "result.npz").read_bytes()


if __name__ == "__main__":
    before = page.circumstances()
    with tempfile.TemporaryDirectory() as place:
        text = section(Path(place))
    print(f"{before}\n\n{text}")
    if "--write" in sys.argv[1:]:
        page.write("killed", f"{before}\n\n{text}")
