"""The page of ``getagrip view`` over HTTP, for whoever knows its whole address.

Every path begins with a secret, new at each start: other users of the machine and pages of other sites that a browser
has open do not know it. What follows is the name of a method of ``ViewerLibrary`` with whole numbers: no path names a file.
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

from getagrip.errors import GetagripError, UsageError
from getagrip.io import files
from getagrip.io.serving import LOOPBACK, SCRIPTED_PAGE_HEADERS, QuietHandler, QuietServer
from getagrip.pages.served import ViewerLibrary

VIEWER_PORT = 8770
"""Port of the page, if that is free."""
VIEWER_ROUTES: dict[str, tuple[Callable[..., dict[str, object]], int]] = {
    "entry": (ViewerLibrary.entry, 1),
    "frame": (ViewerLibrary.frame, 4),
    "gap": (ViewerLibrary.gap, 2),
    "candidates": (ViewerLibrary.candidates, 2),
}
"""Paths that may be asked for, and the number of numbers in each."""


class ViewerServer(QuietServer):
    """Serves one library."""

    def __init__(self, library: ViewerLibrary, port: int | None = None, host: str = LOOPBACK) -> None:
        """Listen on a port, 0 for any free one; without one on ``VIEWER_PORT``, or on any free one if that is taken.

        Raises ``UsageError`` for a port that is taken or an address that is not this machine's.
        """
        self.library, self.host, self.secret = library, host, secrets.token_urlsafe(16)
        try:
            super().__init__((host, VIEWER_PORT if port is None else port), _ViewerHandler)
        except (OSError, OverflowError) as error:
            if port is None and isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
                super().__init__((host, 0), _ViewerHandler)
            else:
                got = f"{VIEWER_PORT if port is None else port}, {host}: {error}"
                raise UsageError(f"--port, --host must be a free port of this machine (got {got})") from error

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self.host}:{self.server_port}/{self.secret}/"

    def admits(self, host: str) -> bool:
        """Return whether a request names this machine: by an address, or as the user did."""
        name = re.sub(r":\d{1,5}$", "", host)
        if name in (self.host, "localhost"):
            return True
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True


class _ViewerHandler(QuietHandler):
    server: ViewerServer

    def do_GET(self) -> None:
        """Answer with the page or a part of it; errors become one line of JSON, never a traceback."""
        try:
            if not self.server.admits(self.headers.get("Host") or ""):
                self._refuse("requests to another host are refused", HTTPStatus.FORBIDDEN)
            elif (rest := self._below_secret()) is None:
                self._refuse("this page opens only at the whole address that getagrip view has printed")
            elif rest == "":
                self.send(self.server.library.page(), "text/html; charset=utf-8", SCRIPTED_PAGE_HEADERS)
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
        """Return the part of the path behind the secret, without a query."""
        first, _, rest = self.path.partition("?")[0].removeprefix("/").partition("/")
        return rest if secrets.compare_digest(first.encode(), self.server.secret.encode()) else None

    def _part(self, path: str) -> None:
        """Answer with what a method of the library gives."""
        name, *numbers = path.split("/")
        method, count = VIEWER_ROUTES.get(name, (None, 0))
        if method is None or len(numbers) != count or not all(re.fullmatch("[0-9]{1,6}", one) for one in numbers):
            self._refuse("no such page", HTTPStatus.NOT_FOUND)
            return
        try:
            content = method(self.server.library, *map(int, numbers))
        except IndexError:
            self._refuse("no such page", HTTPStatus.NOT_FOUND)
            return
        self.send_json(json.loads(files.to_json(content)))

    def _refuse(self, why: str, status: HTTPStatus = HTTPStatus.FORBIDDEN) -> None:
        self.close_connection = True
        self.send_json({"error": why}, status)
