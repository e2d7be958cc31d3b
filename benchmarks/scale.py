"""What a clip costs a cluster, and what a million would: ``python -m benchmarks.scale`` prints tables.

``--write`` puts them into docs/scale.md. Clips and results go through a server of S3's protocol on this machine (moto),
tasks through a Ray cluster of this machine. Times are processor seconds of the process that is measured, so that other
load counts little; what the server and Ray's own processes take is not in them. Needs the extras ray and s3, and moto.
"""

from __future__ import annotations

import os
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import page
from benchmarks.scale_driver import ledger_cost, listing_cost, ray_cost
from getagrip.batch.job import Job, reconstruct_one
from getagrip.batch.streamed import LEFT_OUT, POSES, RECORD
from getagrip.clip import write_clip
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.fitting.energy.mask import MaskTerm
from getagrip.fitting.options import Options
from getagrip.io import files
from getagrip.io.storage import Remote

MILLION = 1_000_000
CLIPS = 8
SCENE = SceneOptions(frames=30, size=(854, 480))
CORES = (64, 1000, 10_000)
PRICES = {"core": 0.04, "GPU": 3.0, "GetObject": 0.4e-6, "PutObject": 5e-6, "ListObjectsV2": 5e-6}
"""In USD, of an hour or of a request: our assumption, in the order of list prices of large providers."""
GPU = {"bytes a second": 2e12, "operations a second": 2e13}
"""Of a large GPU, our assumption: what memory and arithmetic give on loops that are written well."""
PER_VERTEX, PER_FACE = 20, 8
"""Arithmetic operations of ``kernels.silhouette`` in its loops over vertices (project) and faces (the side test)."""


@dataclass
class Masks:
    """What the mask term of a reconstruction does, counted."""

    seconds: float = 0.0
    evaluations: int = 0
    operations: float = 0.0
    bytes: float = 0.0

    def count(self, evaluate: Callable[..., Any], term: MaskTerm, poses: Any, bound: Any) -> Any:
        """One call of the term."""
        since = time.process_time()
        found = evaluate(term, poses, bound)
        self.seconds += time.process_time() - since
        count = poses.R.shape[0] * poses.R.shape[1]
        self.evaluations += count
        vertices, planes = term.mesh.vertices.shape[1], term.mesh.planes.shape[1]
        self.operations += count * (PER_VERTEX * vertices + PER_FACE * planes)
        self.bytes += count * (24.0 * vertices + 32.0 * planes + 5 * term.level**2 / 8)  # coordinates, planes, bits
        return found


def section() -> str:
    """Measure; the section's text."""
    with _server(), tempfile.TemporaryDirectory() as folder:
        return "\n\n".join(_tables(Path(folder)))


def _tables(folder: Path) -> Iterator[str]:
    cost = _clip_costs(folder)
    driver = {"ledger": ledger_cost(folder), "Ray": ray_cost(), "listing": listing_cost()}
    yield from _clip_tables(cost)
    yield from _driver_table(driver, cost["CPU"])
    yield _gpu_table(cost)


def _clip_costs(folder: Path) -> dict[str, Any]:
    """Medians over clips: processor seconds by step, bytes, requests; and what the mask term does."""
    rows: list[dict[str, float]] = []
    copying, unpacking, others = Counter[str](), Counter[str](), Counter[str]()
    masks = Masks()
    evaluate = MaskTerm.__call__
    for n in range(CLIPS + 1):  # the first one compiles and loads
        clip, pixels = synthesise(list(CATEGORIES)[n % len(CATEGORIES)], n, SCENE)
        name = f"clip-{n}"
        made = write_clip(replace(clip, name=name), pixels, folder / "made" / name)
        there, out = Remote(f"s3://bucket/clips/{name}"), Remote(f"s3://bucket/results/{name}")
        for path in made.rglob("*"):
            if path.is_file():
                (there / str(path.relative_to(made))).write(path.read_bytes())
        packed = Path(shutil.make_archive(str(made), "zip", made))
        archive = Remote(f"s3://bucket/packed/{name}.zip")
        archive.write(packed.read_bytes())
        local, result = folder / "clips" / name, folder / "results" / name
        times = [time.process_time()]
        with _counted() as unpacked:
            archive.unpack_to(folder / "unpacked" / name, LEFT_OUT)
        times.append(time.process_time())
        with _counted() as copied:
            there.copy_to(local, LEFT_OUT)
        times.append(time.process_time())
        with _counted() as besides:
            (out / RECORD).read(files.LARGEST_JSON)
            outcome = reconstruct_one(Job(name, local, result, Options(), overwrite=False))
            times.append(time.process_time())
            for each in (POSES, RECORD):
                (out / each).write((result / each).read_bytes())
            times.append(time.process_time())
        assert outcome.state == "done", outcome.message
        if n == 0:
            MaskTerm.__call__ = lambda term, poses, bound: masks.count(evaluate, term, poses, bound)  # type: ignore[method-assign]
            continue
        copying, unpacking, others = copying + copied, unpacking + unpacked, others + besides
        steps = ("unpack", "copy", "reconstruct", "upload")
        rows.append(dict(zip(steps, (b - a for a, b in pairwise(times)), strict=True)))
        rows[-1] |= {"bytes in": _size(local), "packed": packed.stat().st_size, "bytes out": _size(result)}
    MaskTerm.__call__ = evaluate  # type: ignore[method-assign]
    middle = {key: median(row[key] for row in rows) for key in rows[0]}
    total = sum(middle[key] for key in ("copy", "reconstruct", "upload"))
    requests = [copying + others, unpacking + others]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {**middle, "CPU": total, "requests": requests, "masks": masks, "memory": memory}


def _clip_tables(cost: dict[str, Any]) -> Iterator[str]:
    """Of a clip and of a million, each in a folder and as an archive."""
    reading, sizes = (cost["copy"], cost["unpack"]), (cost["bytes in"], cost["packed"])
    requests = [{name: of[name] / CLIPS for name in sorted(cost["requests"][0])} for of in cost["requests"]]
    hours = [(cost["CPU"] - cost["copy"] + read) * MILLION / 3600.0 for read in reading]
    asked = [sum(of.values()) for of in requests]
    bills = [sum(PRICES[name] * count for name, count in of.items()) * MILLION for of in requests]

    def row(label: str, form: str, *values: float) -> list[str]:
        return [label, *(form.format(value) for value in (values if len(values) == 2 else 2 * values))]

    rows = [
        row("copy the clip from the store, CPU s", "{:.3f}", *reading),
        row("reconstruct, CPU s", "{:.3f}", cost["reconstruct"]),
        row("copy the result to the store, CPU s", "{:.3f}", cost["upload"]),
        row("bytes in, kB", "{:.0f}", *(size / 1e3 for size in sizes)),
        row("bytes out, kB", "{:.0f}", cost["bytes out"] / 1e3),
        *(row(f"requests: {name}", "{:.1f}", *(of[name] for of in requests)) for name in requests[0]),
        row("memory of the process at most, MB", "{:.0f}", cost["memory"] / 1e6),
    ]
    form = ["in a folder", "as an archive"]
    yield page.table([f"a clip of {SCENE.frames} frames, {SCENE.size[0]} x {SCENE.size[1]}", *form], rows)
    a_second = [CORES[1] * MILLION / 3600.0 / each for each in hours]
    rows = [
        row("core hours", "{:,.0f}", *hours),
        *(row(f"hours on {cores:,} cores", "{:,.2f}", *(each / cores for each in hours)) for cores in CORES),
        row("read, GB", "{:,.0f}", *(size * MILLION / 1e9 for size in sizes)),
        row("written, GB", "{:,.0f}", cost["bytes out"] * MILLION / 1e9),
        row("requests, millions", "{:,.0f}", *(count * MILLION / 1e6 for count in asked)),
        row(
            f"at {CORES[1]:,} cores: requests a second",
            "{:,.0f}",
            *(n * t for n, t in zip(asked, a_second, strict=True)),
        ),
        row(
            f"at {CORES[1]:,} cores: MB a second in",
            "{:,.0f}",
            *(n * t / 1e6 for n, t in zip(sizes, a_second, strict=True)),
        ),
        row(f"cores, at {PRICES['core']} USD an hour", "{:,.0f} USD", *(each * PRICES["core"] for each in hours)),
        row("requests, at the prices assumed", "{:,.1f} USD", *bills),
    ]
    yield page.table(["a million of them", *form], rows)


def _driver_table(driver: dict[str, dict[str, float]], clip: float) -> Iterator[str]:
    ledger, ray, listing = driver["ledger"], driver["Ray"], driver["listing"]
    seconds = ledger["seconds"] + ray["seconds"]
    rows = [
        ["ledger: a claim and an entry, CPU ms", f"{ledger['seconds'] * 1e3:.2f}"],
        ["ledger: bytes of an entry", f"{ledger['bytes']:.0f}"],
        ["Ray: a task that does nothing, CPU ms of the driver", f"{ray['seconds'] * 1e3:.2f}"],
        ["Ray: such tasks a second on this machine", f"{ray['tasks a second']:.0f}"],
        ["listing: a folder, CPU ms", f"{listing['seconds'] * 1e3:.3f}"],
        ["listing: a folder, bytes of memory", f"{listing['bytes']:.0f}"],
        ["a million: ledger, MB", f"{ledger['bytes'] * MILLION / 1e6:.0f}"],
        ["a million: memory of the listing, GB", f"{listing['bytes'] * MILLION / 1e9:.1f}"],
        ["a million: CPU h of the driver", f"{(seconds + listing['seconds']) * MILLION / 3600.0:.1f}"],
        ["cores that keep a driver's one core busy", f"{clip / seconds:.0f}"],
    ]
    yield page.table(["the driver", ""], rows)


def _gpu_table(cost: dict[str, Any]) -> str:
    masks, clip = cost["masks"], cost["reconstruct"]
    seconds, operations, moved = masks.seconds / CLIPS, masks.operations / CLIPS, masks.bytes / CLIPS
    bound = max(operations / GPU["operations a second"], moved / GPU["bytes a second"])
    least = PRICES["GPU"] / PRICES["core"] / seconds
    rows = [
        ["mask term: evaluations (a pose in a frame)", f"{masks.evaluations / CLIPS:,.0f}"],
        ["mask term: CPU s", f"{seconds:.3f}"],
        ["its share of the reconstruction", f"{seconds / clip:.2f}"],
        ["arithmetic over vertices and faces, millions of operations", f"{operations / 1e6:,.0f}"],
        ["moved by these and by bit planes, MB", f"{moved / 1e6:,.0f}"],
        ["at the rates assumed of a GPU, ms", f"{bound * 1e3:.2f}"],
        ["clips a second that these rates would allow", f"{1.0 / bound:,.0f}"],
        [f"clips a second from which a GPU of {PRICES['GPU']:g} USD an hour pays", f"{least:,.0f}"],
        ["cores that do all else of so many clips", f"{least * (clip - seconds):,.0f}"],
        ["all of a clip for nothing but that: times as fast at most", f"{clip / (clip - seconds):.1f}"],
    ]
    return page.table(["a clip's mask term", ""], rows)


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@contextmanager
def _counted() -> Iterator[Counter[str]]:
    """The requests that are made meanwhile, by their names."""
    from aiobotocore.client import AioBaseClient

    counted, call = Counter[str](), AioBaseClient._make_api_call

    async def counting(self: Any, operation: str, arguments: Any) -> Any:
        counted[operation] += 1
        return await call(self, operation, arguments)

    AioBaseClient._make_api_call = counting
    try:
        yield counted
    finally:
        AioBaseClient._make_api_call = call


@contextmanager
def _server() -> Iterator[None]:
    """S3 on this machine, with a bucket."""
    sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
    from helpers.object_store import BUCKET, s3_server

    with s3_server() as env:
        os.environ.update(env)
        import s3fs

        s3fs.S3FileSystem().mkdir(BUCKET)
        yield


if __name__ == "__main__":
    before = page.circumstances()
    with redirect_stdout(sys.stderr):
        text = section()
    print(f"{before}\n\n{text}")
    if "--write" in sys.argv[1:]:
        page.write("scale", f"{before}\n\n{text}")
