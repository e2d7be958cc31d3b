"""A robot's dataset: hand and object on a stage with z up, as LeRobot or MCAP, and without their libraries as tables.

    python examples/09_robot_dataset.py [OUT]

Writes OUT/<format> (out/robot by default): LeRobot and MCAP where `pip install -e '.[lerobot,mcap]'` has put their
libraries, CSV and npz in any case. docs/robots.md goes on from here.
"""

import json
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import getagrip
from getagrip.export import Scene, export

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/robot")
clip, masks = getagrip.synthesise("bottle", seed=0)
result = getagrip.reconstruct(clip, masks)
if result.findings:  # a demonstration with findings is worth a look before a robot learns from it
    print("\n".join(map(str, result.findings)))

scene = Scene.of(result, clip)
needs = {"lerobot": "pyarrow", "mcap": "mcap", "csv": "csv", "npz": "numpy"}
formats = [name for name, library in needs.items() if find_spec(library) is not None]
for name in formats:
    folder = export(scene, out / name, name, overwrite=True)
    about = json.loads((folder / "about.json").read_text(encoding="utf-8"))  # every file with its units and axes
    for file, words in about["files"].items():
        print(f"{folder / file}: {words}")

with np.load(out / "npz" / "scene.npz") as stored:
    path = stored["T_cam_obj"][:, :3, 3]
print(f"{len(path)} frames; the object moves {np.linalg.norm(np.diff(path, axis=0), axis=1).sum():.2f} m")
