"""Settings of a grasp that the page comes back to: the object's mesh and size, the camera, the frame and the tool.

The last files and the last result of its labels are settings, too. A setting has a name and a JSON value; the newest
value counts.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields

from getagrip.geometry.lens import Lens
from getagrip.io.files import Json, shorten_value
from getagrip.studio.store.history import RefusedError, VersionDatabase
from getagrip.studio.store.labels import MAX_FRAME_INDEX, MIN_SHAPE_POINTS

SETTINGS_SCHEMA = """
CREATE TABLE settings (
    seq INTEGER PRIMARY KEY AUTOINCREMENT,
    grasp TEXT NOT NULL, name TEXT NOT NULL, value TEXT NOT NULL,
    UNIQUE (grasp, name) ON CONFLICT REPLACE
);
"""
MAX_MESH_PATH_LENGTH = 1000
"""Characters of a path."""
MAX_OBJECT_SIZE_MM = 10_000.0
TOOLS = ("joints", *MIN_SHAPE_POINTS)
"""The page's tools."""
PAGE_SETTINGS = frozenset({"mesh", "size_mm", "frame", "tool"})
"""Settings that the page may set."""


def _is_number(value: object, most: float) -> bool:
    return type(value) in (int, float) and isinstance(value, int | float) and 0 < value <= most


def _is_mesh(value: object) -> bool:
    return isinstance(value, str) and len(value) <= MAX_MESH_PATH_LENGTH and (value.isprintable() or not value)


def _is_lens(value: object) -> bool:
    if not isinstance(value, dict) or value.keys() != {field.name for field in fields(Lens)}:
        return False
    K, focal = value["K"], value["focal"]
    four = isinstance(K, list) and len(K) == 4 and all(type(x) in (int, float) for x in K)
    return (K is None or four) and (focal is None or _is_number(focal, 1e9)) and isinstance(value["guess_focal"], bool)


def _is_written(value: object) -> bool:
    if not isinstance(value, dict) or value.keys() != {"of", "confidence"} or not isinstance(value["of"], str):
        return False
    sure = value["confidence"]
    return isinstance(sure, dict) and all(n.isdigit() and type(x) in (int, float) for n, x in sure.items())


def _is_outcome(value: object) -> bool:
    kinds = {"of": str, "mesh": str, "size_mm": int | float | None, "said": str}
    return (
        isinstance(value, dict)
        and kinds.keys() == value.keys() - {"first"}
        and isinstance(value.get("first", False), bool)
        and all(isinstance(value[key], kind) for key, kind in kinds.items())
    )


SETTING_CHECKS: Mapping[str, tuple[Callable[[object], bool], str]] = {
    "mesh": (_is_mesh, "a file, or a kind such as plate or mug"),
    "size_mm": (lambda value: value is None or _is_number(value, MAX_OBJECT_SIZE_MM), "millimetres above 0, or null"),
    "frame": (lambda value: type(value) is int and 0 <= value <= MAX_FRAME_INDEX, "a frame"),
    "tool": (lambda value: value in TOOLS, f"one of {', '.join(TOOLS)}"),
    "lens": (_is_lens, "a lens"),
    "written": (_is_written, "a checksum of the labels, and the masks' confidence by frame"),
    "outcome": (_is_outcome, "a checksum of the labels, the mesh, its size, and a text"),
}
"""By the name of a setting: a function that tells its values from others, and what it expects in words."""


@dataclass(frozen=True)
class SettingStore:
    """The settings in a database."""

    database: VersionDatabase

    def of(self, grasp: str) -> Json:
        """Return the settings of a grasp by name. Raises ``InputError`` where the file is damaged."""
        rows = self.database.rows("SELECT name, value FROM settings WHERE grasp = ?", (grasp,))
        try:
            found = {name: json.loads(value) for name, value in rows}
            check_settings(found, frozenset(SETTING_CHECKS))
        except (RefusedError, ValueError, TypeError, RecursionError) as error:
            raise self.database.damaged(error) from error
        return found

    def put(self, grasp: str, settings: Mapping[str, object]) -> None:
        """Store some settings of a grasp in place of older ones. Raises ``RefusedError`` for a wrong one."""
        check_settings(settings, frozenset(SETTING_CHECKS))
        rows = [(grasp, name, json.dumps(value, allow_nan=False)) for name, value in settings.items()]
        with self.database.transaction() as db:
            db.executemany("INSERT INTO settings (grasp, name, value) VALUES (?, ?, ?)", rows)

    def lens(self, grasp: str) -> Lens | None:
        """Return the camera with which a grasp was worked on last; None if not known."""
        known = self.of(grasp).get("lens")
        return None if known is None else Lens(**known | {"K": None if known["K"] is None else tuple(known["K"])})

    def put_lens(self, grasp: str, lens: Lens) -> None:
        """Store the camera of a grasp, unless it is stored already."""
        if lens != self.lens(grasp):
            K, focal = lens.K, lens.focal
            numbers = {"K": None if K is None else [*map(float, K)], "focal": None if focal is None else float(focal)}
            self.put(grasp, {"lens": asdict(lens) | numbers})

    def newest(self, annotator: str) -> tuple[str, str] | None:
        """Return the task and the grasp at which an annotator was last; None without any."""
        query = (
            "SELECT task, grasp FROM settings JOIN (SELECT DISTINCT grasp AS one, task FROM keyframes WHERE annotator ="
            " ?1 UNION SELECT mark, task FROM marks WHERE annotator = ?1) ON grasp = one WHERE name = 'frame' "
            "ORDER BY seq DESC LIMIT 1"
        )
        rows = self.database.rows(query, (annotator,))
        return (str(rows[0][0]), str(rows[0][1])) if rows else None


def check_settings(settings: object, known: frozenset[str]) -> Json:
    """Check some settings with the names ``known``, and return them. Raises ``RefusedError``."""
    if not isinstance(settings, dict) or not settings.keys() <= known:
        raise RefusedError(f"set must be some of {', '.join(sorted(known))} (got {shorten_value(settings)})")
    for name, value in settings.items():
        is_fine, expected = SETTING_CHECKS[name]
        if not is_fine(value):
            raise RefusedError(f"{name} must be {expected} (got {shorten_value(value)})")
    return settings
