"""Packages of other people, installed into a folder."""

from __future__ import annotations

from pathlib import Path


def write_package(folder: Path, name: str, version: str, code: str, **entries: str) -> Path:
    """Install a package of one module, with the lines of each group of its entry points; returns the module's file."""
    about = folder / f"{name}-{version}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8")
    groups = "".join(f"[getagrip.{group}]\n{lines}\n" for group, lines in entries.items())
    (about / "entry_points.txt").write_text(groups, encoding="utf-8")
    file = folder / f"{name}.py"
    file.write_text(code, encoding="utf-8")
    return file
