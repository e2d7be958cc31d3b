"""Cases: the files of a reader that were changed. Findings are kept in ``cases/``, one JSON file each."""

from __future__ import annotations

import base64
import json
import os
import shutil
import zlib
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from fuzz import clip_readers, dataset_readers, estimate_readers, service_readers
from fuzz.child import Child, Finding, Reader
from fuzz.mutations import Changes

READERS: dict[str, Reader] = {
    name: reader
    for kind in (clip_readers, estimate_readers, dataset_readers, service_readers)
    for name, reader in kind.READERS.items()
}
"""Every reader of the package by name, in the order of their turns."""
CASES = Path(__file__).parent / "cases"
LARGEST = 64 * 2**10
"""Bytes of a kept case."""


@dataclass
class Seed:
    """A valid input of a reader in a folder, with nothing beside it but a file that no reader may touch."""

    reader: Reader
    folder: Path
    files: dict[str, bytes]
    child: Child

    @staticmethod
    def write(name: str, parent: Path) -> Seed:
        """Make it anew, in a folder of its own."""
        reader, place = READERS[name], parent / name.replace(" ", "-")
        (place / "outside").mkdir(parents=True)
        (place / "outside" / "secret").write_text("{}")
        folder = place / "in"
        folder.mkdir()
        reader.write(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        given = {str(path.relative_to(folder)): path.read_bytes() for path in paths}
        return Seed(reader, folder, given, Child(reader.read, folder, reader.writable))

    @property
    def changeable(self) -> dict[str, bytes]:
        """The files that cases change: of many that are alike, the first and the last."""
        alike: dict[tuple[str, str], list[str]] = {}
        for path in self.files:
            alike.setdefault((os.path.dirname(path), os.path.splitext(path)[1]), []).append(path)
        return {path: self.files[path] for paths in alike.values() for path in {paths[0], paths[-1]}}

    def attempt(self, changes: Changes) -> Finding | None:
        """What is wrong with reading it with some files changed; it is mended afterwards."""
        try:
            for path, content in changes.items():
                _put(self.folder / path, content)
            return self.child.attempt()
        finally:
            self._mend(changes)

    def _mend(self, changes: Changes) -> None:
        for path in changes:
            _remove(self.folder / path)
        for found in sorted(self.folder.rglob("*"), reverse=True):
            if found.is_file() and str(found.relative_to(self.folder)) not in self.files:
                found.unlink()
        for path in changes:
            (self.folder / path).write_bytes(self.files[path])


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _put(path: Path, content: bytes | str) -> None:
    """Bytes, or one of ``mutations.PLACES``, in place of a file."""
    if isinstance(content, bytes):
        path.write_bytes(content)
        return
    path.unlink()
    if content == "folder":
        path.mkdir()
    elif content == "fifo":
        os.mkfifo(path)
    elif content == "link to itself":
        path.symlink_to(path.name)


def keep(name: str, changes: Changes, what: str) -> Path | None:
    """Write a case; None where it is too large to be kept."""
    packed = {path: _packed(content) for path, content in changes.items()}
    text = json.dumps({"reader": name, "finding": what, "files": packed}, indent=1)
    if len(text) > LARGEST:
        return None
    CASES.mkdir(exist_ok=True)
    path = CASES / f"{name.replace(' ', '-')}-{sha256(text.encode()).hexdigest()[:8]}.json"
    path.write_text(text + "\n")
    return path


def read(path: Path) -> tuple[str, Changes]:
    """The reader and the changes of a kept case."""
    content = json.loads(path.read_text())
    return content["reader"], {path: _unpacked(packed) for path, packed in content["files"].items()}


def _packed(content: bytes | str) -> dict[str, str]:
    if isinstance(content, str):
        return {"is": content}
    try:
        text = content.decode()
        if len(text) < 2000 and "\r" not in text:
            return {"text": text}
    except UnicodeDecodeError:
        pass
    return {"zlib": base64.b64encode(zlib.compress(content, 9)).decode()}


def _unpacked(packed: dict[str, str]) -> bytes | str:
    if "is" in packed:
        return packed["is"]
    return packed["text"].encode() if "text" in packed else zlib.decompress(base64.b64decode(packed["zlib"]))
