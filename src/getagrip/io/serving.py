"""HTTP to this machine: what the servers of our pages share."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

LOOPBACK = "127.0.0.1"
PATIENCE = 60.0
"""A connection without requests is closed after so long [s]."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'; base-uri 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
OF_PAGE = {"Content-Security-Policy": "frame-ancestors 'none'; base-uri 'none'"}
"""Headers of a page that names in itself which scripts may run, and what they may load."""


class QuietServer(ThreadingHTTPServer):
    """A thread for each connection, none of which keeps the program from ending."""

    daemon_threads = True
    allow_reuse_address = os.name != "nt"  # where two servers would share a port

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of connections that end early."""


class Handler(BaseHTTPRequestHandler):
    """Answers in one piece each, and prints nothing."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "getagrip", ""
    timeout = PATIENCE
    wbufsize = -1  # an answer in one piece: in two, the second waits for the first to be acknowledged
    disable_nagle_algorithm = True

    def send_json(self, content: Mapping[str, object], status: HTTPStatus = HTTPStatus.OK) -> None:
        """Answer with JSON."""
        self.send(json.dumps(content, allow_nan=False).encode(), "application/json", status=status)

    def send(
        self, content: bytes, kind: str, head: dict[str, str] | None = None, status: HTTPStatus = HTTPStatus.OK
    ) -> None:
        """Answer with some content of a media type; ``head`` adds to ``HEADERS``, or replaces them."""
        self.send_response(status)
        own = {"Content-Type": kind, "Content-Length": str(len(content))}
        for key, value in {**HEADERS, **own, **(head or {})}.items():
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing for each request."""
