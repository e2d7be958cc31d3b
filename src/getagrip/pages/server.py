"""The page of ``getagrip view`` over HTTP, for who knows its whole address.

Every path begins with a secret, new at each start: other users of the machine and pages of other sites that a browser
has open do not know it. What follows is the name of a method of ``Library`` with whole numbers: no path names a file.
A site that takes this machine's address for its own name (DNS rebinding) is recognised by that name (``Host``), and
requests from pages of other sites by what the browser says of them (``Sec-Fetch-Site``).
"""

from __future__ import annotations

import errno
import ipaddress
import json
import re
import secrets
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from getagrip.errors import GetagripError, UsageError
from getagrip.io import files
from getagrip.pages.served import Library

PORT, LOOPBACK = 8770, "127.0.0.1"
"""Where the page is served, if that is free."""
PATIENCE = 60.0
"""A connection without requests is closed after so long [s]."""
ASKED: dict[str, tuple[Callable[..., dict[str, Any]], int]] = {
    "entry": (Library.entry, 1),
    "frame": (Library.frame, 4),
    "gap": (Library.gap, 2),
    "candidates": (Library.candidates, 2),
}
"""What a path may ask for, and by how many numbers."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Server(ThreadingHTTPServer):
    """Serves one library."""

    daemon_threads = True

    def __init__(self, library: Library, port: int | None = None, host: str = LOOPBACK) -> None:
        """Listen on a port, 0 for any free one; without one on ``PORT``, or on any free one if that is taken.

        Raises ``UsageError`` for a port that is taken or an address that is not this machine's.
        """
        self.library, self.host, self.secret = library, host, secrets.token_urlsafe(16)
        try:
            super().__init__((host, PORT if port is None else port), _Handler)
        except (OSError, OverflowError) as error:
            if port is None and isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
                super().__init__((host, 0), _Handler)
            else:
                given = f"{PORT if port is None else port}, {host}: {error}"
                raise UsageError(f"--port, --host must be a free port of this machine (got {given})") from error

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{self.host}:{self.server_port}/{self.secret}/"

    def admits(self, host: str) -> bool:
        """Whether a request names this machine: by an address, or as the user did."""
        name = re.sub(r":\d{1,5}$", "", host)
        if name in (self.host, "localhost"):
            return True
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of connections that end early."""


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "getagrip", ""
    timeout = PATIENCE
    wbufsize = -1  # an answer in one piece: in two, the second waits for the first to be acknowledged
    disable_nagle_algorithm = True

    def do_GET(self) -> None:
        """Answer with the page or a part of it; errors become one line of JSON, never a traceback."""
        try:
            if not self.server.admits(self.headers.get("Host") or ""):
                self._refuse("requests to another host are refused", HTTPStatus.FORBIDDEN)
            elif (rest := self._below_secret()) is None:
                self._refuse("this page opens only at the whole address that getagrip view has printed")
            elif rest == "":
                self._send(self.server.library.page(), "text/html")
            elif self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
                self._refuse("requests from other sites are refused")
            else:
                self._part(rest)
        except ConnectionError:
            self.close_connection = True
        except GetagripError as error:
            self._refuse(str(error), HTTPStatus.UNPROCESSABLE_ENTITY)
        except Exception as error:  # without an answer the page would wait for ever
            self._refuse(f"{type(error).__name__}: {error}", HTTPStatus.INTERNAL_SERVER_ERROR)

    def _below_secret(self) -> str | None:
        """What follows the secret in the path, without a query."""
        first, _, rest = self.path.partition("?")[0].removeprefix("/").partition("/")
        return rest if secrets.compare_digest(first.encode(), self.server.secret.encode()) else None

    def _part(self, path: str) -> None:
        """Answer with what a method of the library gives."""
        name, *numbers = path.split("/")
        method, count = ASKED.get(name, (None, 0))
        if method is None or len(numbers) != count or not all(re.fullmatch("[0-9]{1,6}", one) for one in numbers):
            self._refuse("no such page", HTTPStatus.NOT_FOUND)
            return
        try:
            content = method(self.server.library, *map(int, numbers))
        except IndexError:
            self._refuse("no such page", HTTPStatus.NOT_FOUND)
            return
        self._send(json.dumps(json.loads(files.to_json(content))).encode(), "application/json")

    def _refuse(self, why: str, status: HTTPStatus = HTTPStatus.FORBIDDEN) -> None:
        self.close_connection = True
        self._send(json.dumps({"error": why}).encode(), "application/json", status)

    def _send(self, content: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        about = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(content))}
        for key, value in {**HEADERS, **about}.items():
            self.send_header(key, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing for each request."""
