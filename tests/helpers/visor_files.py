"""Small files of exactly VISOR's schema, of whose masks the answer is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

HANDS = {"left": 300, "right": 301}


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    """The corners of a rectangle."""
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def thing(id_: str, name: str, class_id: int, *polygons: Any, **more: Any) -> dict[str, Any]:
    """An annotation."""
    return {"id": id_, "name": name, "class_id": class_id, "exhaustive": "y", "segments": list(polygons)} | more


def hand(side: str, touches: str | None, *polygons: Any) -> dict[str, Any]:
    """A hand that touches something."""
    return thing(f"{side}-hand", f"{side} hand", HANDS[side], *polygons, in_contact_object=touches)


def sparse(video: str, number: int, *annotations: dict[str, Any]) -> dict[str, Any]:
    """A frame that people have annotated."""
    name = f"{video}_frame_{number:010d}.jpg"
    image = {"image_path": f"{video}/{name}", "name": name, "subsequence": f"{video}_seq_00001", "video": video}
    return {"image": image, "annotations": list(annotations)}


def dense(video: str, number: int, ends: tuple[int, int], *annotations: dict[str, Any]) -> dict[str, Any]:
    """A frame that was interpolated between two others."""
    names = [f"{video}_frame_{n:010d}.jpg" for n in (number, *ends)]
    image = {
        "image_path": f"{video}/{names[0]}",
        "name": names[0],
        "video": video,
        "interpolation": f"{video}_interpolation_0001",
        "interpolation_start_frame": names[1],
        "interpolation_end_frame": names[2],
    }
    kind = int(number in ends)
    return {"image": image, "annotations": [{**annotation, "type": kind} for annotation in annotations]}


def write(path: Path, frames: list[dict[str, Any]]) -> Path:
    """A file of VISOR's."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"info": {"version": "1.1", "n": 1.5e3}, "video_annotations": frames}))
    return path


def write_mapping(path: Path, video: str, epic: dict[int, int]) -> Path:
    """A frame_mapping.json, with another video before."""
    names = {f"{video}_frame_{a:010d}.jpg": f"frame_{b:010d}.jpg" for a, b in epic.items()}
    path.write_text(json.dumps({"P00_01": {"P00_01_frame_0000000140.jpg": "frame_0000000138.jpg"}, video: names}))
    return path
