"""HTTP servers of local pages: few connections, no log, and headers that keep other sites out."""

from __future__ import annotations

import json
import math
import os
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

LOOPBACK = "127.0.0.1"
IDLE_TIMEOUT_S = 60.0
"""Time without requests after which a connection is closed [s]."""
MAX_CONNECTIONS = 64
"""Simultaneous connections, one thread each; further ones wait."""
BUSY_IDLE_TIMEOUT_S = 2.0
"""Time without requests after which a connection is closed while others wait [s]."""
CONNECTION_POLL_S = 0.1
SECURITY_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'; base-uri 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
SCRIPTED_PAGE_HEADERS = {"Content-Security-Policy": "frame-ancestors 'none'; base-uri 'none'"}
"""Headers of a page whose own policy states the scripts that may run and what they may load."""


class QuietServer(ThreadingHTTPServer):
    """A server with a daemon thread for each of at most ``MAX_CONNECTIONS`` connections."""

    daemon_threads = True
    allow_reuse_address = os.name != "nt"  # where two servers would share a port
    request_queue_size = 512

    def __init__(self, address: tuple[str, int], handler: type[QuietHandler]) -> None:
        """Listen. Raises ``OSError``, ``OverflowError``."""
        self._rest_since: dict[object, float] = {}
        """Time at which each connection began to wait for a request; infinity while a request is answered."""
        self._ended = threading.Condition()
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a thread, once there is room for it."""
        with self._ended:
            while len(self._rest_since) >= MAX_CONNECTIONS:
                for other, since in self._rest_since.items():
                    if time.monotonic() - since > BUSY_IDLE_TIMEOUT_S:
                        with suppress(OSError):  # it has ended by itself
                            other.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined]
                self._ended.wait(CONNECTION_POLL_S)
            self.note(request, at_work=False)
        super().process_request(request, client_address)

    def note(self, request: object, at_work: bool) -> None:
        """Note that a connection's request is being answered, or that the connection waits for the next request."""
        self._rest_since[request] = math.inf if at_work else time.monotonic()

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        super().shutdown_request(request)
        with self._ended:
            self._rest_since.pop(request, None)
            self._ended.notify()

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing for a connection that ends early."""


class QuietHandler(BaseHTTPRequestHandler):
    """A handler that sends each answer in one piece and prints nothing."""

    server: QuietServer
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "getagrip", ""
    timeout = IDLE_TIMEOUT_S
    wbufsize = -1  # an answer in one piece: in two, the second waits for the first to be acknowledged
    disable_nagle_algorithm = True

    def handle_one_request(self) -> None:
        """Wait for a request, and answer it."""
        self.server.note(self.connection, at_work=False)
        super().handle_one_request()

    def parse_request(self) -> bool:
        """Read the head of a request; until it is complete the connection counts as waiting."""
        whole = super().parse_request()
        self.server.note(self.connection, at_work=True)
        return whole

    def send_json(self, content: Mapping[str, object], status: HTTPStatus = HTTPStatus.OK) -> None:
        """Answer with JSON."""
        self.send(json.dumps(content, allow_nan=False).encode(), "application/json", status=status)

    def send(
        self, content: bytes, kind: str, head: dict[str, str] | None = None, status: HTTPStatus = HTTPStatus.OK
    ) -> None:
        """Answer with content of the media type ``kind``; ``head`` adds to ``SECURITY_HEADERS`` or replaces some."""
        self.send_response(status)
        own = {"Content-Type": kind, "Content-Length": str(len(content))}
        for key, value in {**SECURITY_HEADERS, **own, **(head or {})}.items():
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing for each request."""
