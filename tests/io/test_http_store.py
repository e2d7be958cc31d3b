"""Servers that ignore ranges, never end, or lead elsewhere."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from getagrip.errors import GetagripError, InputError
from getagrip.io import storage
from getagrip.io.storage import RemotePath

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
