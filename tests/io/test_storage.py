"""Object stores: folders copied within limits, and stores at http addresses."""

from __future__ import annotations

import io
import stat
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from getagrip.errors import GetagripError, InputError
from getagrip.io import storage
from getagrip.io.storage import RemotePath, parse_place
from helpers.folders import contents

FOLDER = RemotePath("memory://bucket/folder")


@pytest.fixture
def memory() -> Iterator[Any]:
    """A store in this process."""
    fs = pytest.importorskip("fsspec", reason="needs fsspec: pip install -e '.[s3]'").filesystem("memory")
    fs.store.clear()
    yield fs
    fs.store.clear()


def test_addresses() -> None:
    assert parse_place("clips/a") == Path("clips/a")
    assert parse_place("file:///clips/a%20b") == Path("/clips/a b")
    there = parse_place("s3://bucket/clips/")
    assert there == RemotePath("s3://bucket/clips")
    assert (there / "a").name == "a"
    assert (there / "a").parent == there


def test_a_copy_is_the_same_but_for_what_is_left_out(memory: Any, tmp_path: Path) -> None:
    there = {"a": b"1", "b/c/d.png": b"22", "empty": b"", "images/x.png": b"3", "truth.npz": b"4", ".hidden": b"5"}
    for name, content in there.items():
        (FOLDER / name).write(content)
    (RemotePath(f"{FOLDER}2") / "a").write(b"of another folder")
    FOLDER.copy_to(tmp_path / "copy", ("images", "truth.npz"))
    assert contents(tmp_path / "copy") == {"a": b"1", "b/c/d.png": b"22", "empty": b""}


@pytest.mark.parametrize("name", ["../up", "a/../../up", "a//b", "a\\b", "~/x", "/".join("abcdefghij"), "a\nb"])
def test_a_name_that_leads_out_is_refused(memory: Any, tmp_path: Path, name: str) -> None:
    memory.pipe_file("/bucket/folder/a", b"")
    memory.store[f"/bucket/folder/{name}"] = memory.store["/bucket/folder/a"]
    with pytest.raises(InputError, match="must be names of files inside the folder"):
        FOLDER.copy_to(tmp_path / "copy")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("limit", ["MAX_REMOTE_FILES", "MAX_REMOTE_BYTES"])
def test_a_folder_that_is_too_large_is_refused_before_it_is_read(
    memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    for n in range(3):
        (FOLDER / str(n)).write(b"123")
    monkeypatch.setattr(storage, limit, 2)
    monkeypatch.setattr(RemotePath, "_contents", None)
    with pytest.raises(InputError, match=r"must be at most.*got 3 files of 9 bytes"):
        FOLDER.copy_to(tmp_path)
    with pytest.raises(InputError, match="got more than 2 bytes"):
        (FOLDER / "0").read(2)
    assert (FOLDER / "0").read(3) == b"123"
    assert (FOLDER / "no").read(3) is None


@pytest.mark.parametrize("content", [b"12", b"1234", b"abc"])
def test_a_folder_that_changes_while_it_is_copied_is_refused(
    memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes
) -> None:
    (FOLDER / "a").write(b"123")
    contents_of = RemotePath._contents

    def meanwhile(self: RemotePath, *args: Any) -> dict[str, bytes]:
        (FOLDER / "a").write(content)
        return contents_of(self, *args)

    monkeypatch.setattr(RemotePath, "_contents", meanwhile)
    with pytest.raises(InputError, match="files that changed while they were read"):
        FOLDER.copy_to(tmp_path / "copy")


def zipped(*members: tuple[str | zipfile.ZipInfo, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return out.getvalue()


@pytest.mark.parametrize("top", ["", "clip/"])
def test_an_archive_is_unpacked_as_its_folder_would_be_copied(memory: Any, tmp_path: Path, top: str) -> None:
    names = ("a", "b/c/d.png", "images/x.png", ".hidden")
    FOLDER.write(zipped(*((top + name, name.encode()) for name in names)))
    FOLDER.unpack_to(tmp_path / "copy", ("images",))
    assert contents(tmp_path / "copy") == {"a": b"a", "b/c/d.png": b"b/c/d.png"}


@pytest.mark.parametrize("name", ["../up", "a/../../up", "/up", "a\\b", "~/x", "/".join("abcdefghij")])
def test_a_member_that_leads_out_is_refused(memory: Any, tmp_path: Path, name: str) -> None:
    FOLDER.write(zipped(("a", b""), (name, b"")))
    with pytest.raises(InputError, match="must be names of files inside the folder"):
        FOLDER.unpack_to(tmp_path / "copy")
    assert not any(tmp_path.iterdir())


def test_links_doubles_bombs_and_damage_are_refused(
    memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = zipfile.ZipInfo("a")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with pytest.warns(UserWarning, match="Duplicate"):
        twice = zipped(("a", b"1"), ("a", b"2"))
    vast = zipped(("a", bytes(10**6)))
    lying = vast.replace((10**6).to_bytes(4, "little"), (100).to_bytes(4, "little"))
    monkeypatch.setattr(storage, "MAX_REMOTE_BYTES", 5 * 10**5)
    given = {"a link": zipped((link, b"/etc/passwd")), "a name twice": twice, "1 files of 1000000 bytes": vast}
    for why, content in (given | {"Bad CRC-32": lying, "does not unpack": vast[:-9], "not a zip file": b""}).items():
        FOLDER.write(content)
        with pytest.raises(InputError, match=why):
            FOLDER.unpack_to(tmp_path / "copy")
    with pytest.raises(InputError, match="no such archive"):
        (FOLDER / "none.zip").unpack_to(tmp_path / "copy")
    assert not any(tmp_path.iterdir())


pytest.importorskip("fsspec", reason="needs fsspec: pip install -e '.[s3]'")
pytest.importorskip("aiohttp", reason="needs aiohttp: pip install -e '.[s3]'")
SMALL = b"a small file"


class Hostile(BaseHTTPRequestHandler):
    """Ignores ranges."""

    def do_GET(self) -> None:
        port = self.server.server_address[1]
        redirects = {"/host": f"http://localhost:{port}/small", "/port": "http://127.0.0.1:1/small", "/same": "/small"}
        if self.path in redirects:
            self.send_response(302)
            self.send_header("Location", redirects[self.path])
            self.end_headers()
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        try:
            while self.path in {"/endless", "/"}:
                self.wfile.write(b"x" * 2**16)
            self.wfile.write(SMALL)
        except OSError:  # the other side has enough
            pass

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def server() -> Iterator[RemotePath]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Hostile) as it:
        it.daemon_threads = True
        threading.Thread(target=it.serve_forever, daemon=True).start()
        yield RemotePath(f"http://127.0.0.1:{it.server_port}")
        it.shutdown()


def test_small_files_and_redirects_on_the_server_are_read(server: RemotePath) -> None:
    assert (server / "small").read(100) == (server / "same").read(100) == SMALL


def test_bodies_that_never_end_are_cut_at_the_limit(server: RemotePath, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="got more than 1000 bytes"):
        (server / "endless").read(1000)
    server.fetch(["endless", "small"], 1000, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["small"]


def test_a_listing_that_never_ends_is_refused(server: RemotePath, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "MAX_LISTING_BYTES", 2**20)
    with pytest.raises(InputError, match="at most that in a listing"):
        server.children()


@pytest.mark.parametrize("to", ["host", "port"])
def test_redirects_to_another_server_are_not_followed(server: RemotePath, to: str) -> None:
    with pytest.raises(GetagripError, match="a redirect to 'http"):
        (server / to).read(100)


def test_chained_addresses_are_bounded_too(server: RemotePath) -> None:
    with pytest.raises(GetagripError, match="a redirect to 'http"):
        RemotePath(f"simplecache::{server}/host").read(100)
