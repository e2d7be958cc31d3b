"""The page over HTTP, for this machine and this user only.

The server listens on 127.0.0.1, to which a tunnel may lead from any port of another machine. Since other users of this
machine can reach it, too, it answers only a browser that has opened the address with the token, which becomes a cookie.
Requests sent by pages of other sites are recognised by their host (``Host``) and origin (``Origin``,
``Sec-Fetch-Site``), and are refused.
"""

from __future__ import annotations

import json
import os
import secrets
import sqlite3
import stat
from collections.abc import Callable
from contextlib import suppress
from hmac import compare_digest
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files as package_files
from pathlib import Path
from urllib.parse import parse_qs, quote, urlsplit

from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.report.serving import LOOPBACK, SCRIPTED_PAGE_HEADERS, QuietHandler, QuietServer
from getagrip.studio.project import Project
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.shapes import kind_picture

LOCAL_HOST_NAMES = (LOOPBACK, "localhost")
"""Names of this machine in its own browser."""
DEFAULT_PORT, N_PORTS_TRIED = 8765, 20
"""First of the ports that are tried without ``--port``, and their number."""
MIN_TOKEN_LENGTH = 20
"""Minimum number of characters of a token."""
MISSING_TOKEN_MESSAGE = "open the address that getagrip annotate has printed: its token is missing here"
MAX_BODY_BYTES = 256 * 2**10
"""Maximum size of a request's body."""
MAX_SKIPPED_BODY_BYTES = 64 * 2**20
"""Bytes of a larger body that are read before the answer, so that the sender receives it."""
STUDIO_STYLESHEETS = ("page", "labels")
STUDIO_SCRIPTS = (
    "app", "grasps", "joints", "labelling", "labels", "outlines", "overlay", "page", "panel", "player", "results",
    "saving", "segments", "settings", "states", "strokes", "tasks", "timeline", "view",
)  # fmt: skip
STUDIO_PAGE, REPORT_PARTS = ("getagrip.studio", "page"), ("getagrip.report.pages", "parts")
"""Packages of files of the page, and their folders."""
PAGE_ROUTES = {
    "/": (STUDIO_PAGE, "index.html", "text/html"),
    "/tokens.css": (REPORT_PARTS, "tokens.css", "text/css"),
    **{f"/{name}.css": (STUDIO_PAGE, f"{name}.css", "text/css") for name in STUDIO_STYLESHEETS},
    **{f"/{name}.js": (STUDIO_PAGE, f"{name}.js", "text/javascript") for name in STUDIO_SCRIPTS},
}
DATA_ROUTES: dict[str, Callable[[Project, dict[str, str]], dict[str, object]]] = {
    "/api/tasks": lambda project, asked: project.overview(asked.get("annotator")),
    "/api/task": lambda project, asked: project.task(asked.get("task")),
    "/api/marks": lambda project, asked: project.marks(asked.get("task"), asked.get("annotator")),
    "/api/labels": lambda project, asked: project.labels(asked),
    "/api/drafts": lambda project, asked: project.drafts(asked, _parse_whole_number(asked.get("since"))),
    "/api/outlines": lambda project, asked: project.outlines(
        asked, _parse_whole_number(asked.get("candidate")), _parse_whole_number(asked.get("first"))
    ),
    "/api/agreement": lambda project, _: project.agreement(),
}
"""Functions that answer with JSON, by path."""
CHANGE_ROUTES = {
    "/api/change": "change",
    "/api/undo": "undo",
    "/api/label": "label",
    "/api/unlabel": "unlabel",
    "/api/set": "set",
    "/api/shape": "check_shape",
    "/api/work": "work",
}
"""Methods of the project, by the path of their requests."""
FILE_ROUTES = {"/grasps.csv": "csv", "/grasps.json": "json", "/segments.json": "segments"}
"""Kinds of files of an annotator's marks, by path."""
REPORT_ROUTES = {"/report.png": "image/png", "/report.html": "text/html; charset=utf-8"}
"""Content types of a report's files, by path."""
REPORT_HEADERS = {
    "Content-Security-Policy": f"{SCRIPTED_PAGE_HEADERS['Content-Security-Policy']}; sandbox allow-scripts"
}
"""Headers of a report: its scripts run as another site's, so they reach neither marks nor cookies."""
STUDIO_PAGE_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'"
}
"""Headers of the page: only its own scripts run."""


class Server(QuietServer):
    """The server of one project."""

    closed = False

    def __init__(self, project: Project, port: int, token: str = "") -> None:
        """Listen on a port, for 0 on any free port. Raises ``UsageError`` for a port in use.

        Without a ``token`` a new one is made.
        """
        self.project, self.token = project, token or secrets.token_urlsafe(18)
        try:
            super().__init__((LOOPBACK, port), _StudioHandler)
        except (OSError, OverflowError) as error:
            raise UsageError(f"--port must be a free port (got {port}: {error})") from error
        self.cookie = f"getagrip-{project.name}-{self.server_port}"  # a browser sends cookies to all ports

    @property
    def url(self) -> str:
        """Address of the page, with the token that opens it."""
        return f"http://{LOOPBACK}:{self.server_port}/?token={self.token}"

    def admits(self, token: str) -> bool:
        """Return whether a token is this server's."""
        return compare_digest(token.encode("utf-8", "replace"), self.token.encode())

    def server_close(self) -> None:
        """Stop listening, and answer no further requests on open connections."""
        self.closed = True
        super().server_close()


def serve_on_free_port(project: Project, token: str) -> Server:
    """Start a server at the default port, else at the next free port. Raises ``UsageError`` without a free port."""
    for port in range(DEFAULT_PORT, DEFAULT_PORT + N_PORTS_TRIED):
        with suppress(UsageError):
            return Server(project, port, token)
    return Server(project, 0, token)


def persistent_token(path: Path) -> str:
    """Read the token in the user's private file, or make it, so that open pages survive a restart of the server.

    Links are not followed, and short tokens are replaced: the sender of a folder may know either.
    """
    with suppress(OSError, ValueError):
        about = path.lstat()
        if stat.S_ISREG(about.st_mode) and about.st_mode & 0o077 == 0 and about.st_uid == os.geteuid():
            token = path.read_text("ascii").strip()
            if len(token) >= MIN_TOKEN_LENGTH:
                return token
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):
        path.unlink()
    token = secrets.token_urlsafe(18)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(token)
    return token


class _StudioHandler(QuietHandler):
    server: Server

    def do_GET(self) -> None:
        """Answer with the page, a frame, or data."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Make a change."""
        self._answer(self._post)

    def _answer(self, act: Callable[[], None]) -> None:
        """Answer a request; errors become one line of JSON, never a traceback."""
        if self.server.closed:
            self.close_connection = True
            return
        try:
            if (reason := self._foreign()) is not None:
                self._fail(reason, HTTPStatus.FORBIDDEN, close=True)
            elif not self._may_enter():
                self._fail(MISSING_TOKEN_MESSAGE, HTTPStatus.UNAUTHORIZED, close=True)
            else:
                act()
        except RefusedError as error:
            self._fail(error, HTTPStatus.CONFLICT)
        except InputError as error:
            self._fail(error, HTTPStatus.UNPROCESSABLE_ENTITY)
        except (GetagripError, ValueError) as error:
            self._fail(error, HTTPStatus.BAD_REQUEST)
        except ConnectionError:
            self.close_connection = True
        except (OSError, sqlite3.Error) as error:  # a full disk or a locked file: the page tries again
            self._fail(error, HTTPStatus.SERVICE_UNAVAILABLE, close=True)
        except Exception as error:  # without an answer the page would try for ever
            message = f"an error of the program: {type(error).__name__}: {error}"
            self._fail(message, HTTPStatus.INTERNAL_SERVER_ERROR, close=True)

    def _fail(self, error: object, status: HTTPStatus, close: bool = False) -> None:
        self.close_connection = self.close_connection or close
        self.send_json({"error": str(error)}, status)

    def _foreign(self) -> str | None:
        """Return why a request of another site is refused; None for requests of the page."""
        host = self.headers.get("Host") or ""
        name, _, port = host.rpartition(":")
        if name not in LOCAL_HOST_NAMES or not port.isdigit():
            return "requests to another host are refused"
        origin = self.headers.get("Origin")
        if origin is not None and origin not in {f"http://{name}:{port}" for name in LOCAL_HOST_NAMES}:
            return "requests from other sites are refused"
        site = self.headers.get("Sec-Fetch-Site", "same-origin")
        if site not in ("same-origin", "none") and urlsplit(self.path).path != "/":
            return "requests from other sites are refused"
        return None

    def _may_enter(self) -> bool:
        """Return whether a request has the token, in its cookie or, for the page itself, in its address."""
        url = urlsplit(self.path)
        if url.path == "/" and self.server.admits("".join(parse_qs(url.query).get("token", [])[-1:])):
            return True
        try:
            cookie = SimpleCookie(self.headers.get("Cookie", "")).get(self.server.cookie)
        except CookieError:
            return False
        return cookie is not None and self.server.admits(cookie.value)

    def _get(self) -> None:
        url = urlsplit(self.path)
        asked = {key: values[-1] for key, values in parse_qs(url.query).items()}
        project = self.server.project
        if url.path == "/" and "token" in asked:  # remove it from the address, which others may see
            kept = f"{self.server.cookie}={self.server.token}; Path=/; HttpOnly; SameSite=Lax"
            self.send(b"", "text/plain", {"Location": "/", "Set-Cookie": kept}, HTTPStatus.SEE_OTHER)
        elif url.path in PAGE_ROUTES:
            (package, folder), name, kind = PAGE_ROUTES[url.path]
            content = (package_files(package) / folder / name).read_bytes()
            self.send(content, f"{kind}; charset=utf-8", STUDIO_PAGE_HEADERS)
        elif url.path == "/frame":
            image, time, number = project.frame(
                asked.get("task"), _parse_whole_number(asked.get("n")), "whole" in asked
            )
            self.send(image, "image/jpeg", {"X-Time": f"{time:.6f}", "X-Number": str(number)})
        elif url.path in DATA_ROUTES:
            self.send_json(DATA_ROUTES[url.path](project, asked))
        elif url.path == "/kind.png":
            self.send(kind_picture(asked.get("kind", "")), "image/png")
        elif url.path == "/labels.json":
            text, name = project.labels_file(asked)
            self._send_file(text, "json", name)
        elif url.path in REPORT_ROUTES:
            name = url.path.removeprefix("/")
            self.send(project.result_file(asked, name), REPORT_ROUTES[url.path], REPORT_HEADERS)
        elif url.path in FILE_ROUTES:
            text = project.exported(FILE_ROUTES[url.path], asked.get("annotator"))
            self._send_file(text, url.path.rpartition(".")[2], f"{asked.get('annotator')}-{url.path[1:]}")
        else:
            self._fail("no such page", HTTPStatus.NOT_FOUND)

    def _post(self) -> None:
        length = _parse_whole_number(self.headers.get("Content-Length"))
        if length > MAX_BODY_BYTES or self.headers.get("Content-Type") != "application/json":
            self.close_connection = True
            for _ in range(0, min(length, MAX_SKIPPED_BODY_BYTES), MAX_BODY_BYTES):
                self.rfile.read(min(length, MAX_BODY_BYTES))
                length -= MAX_BODY_BYTES
            raise UsageError(f"body must be JSON of at most {MAX_BODY_BYTES} bytes")
        try:
            content = json.loads(self.rfile.read(length))
        except RecursionError as error:
            raise UsageError("body must be a JSON object") from error
        if not isinstance(content, dict):
            raise UsageError("body must be a JSON object")
        if content.get("project", self.server.project.name) != self.server.project.name:
            self._fail("another database of marks is open", HTTPStatus.SERVICE_UNAVAILABLE)
        elif self.path in CHANGE_ROUTES:
            self.send_json(getattr(self.server.project, CHANGE_ROUTES[self.path])(content))
        else:
            self._fail("no such page", HTTPStatus.NOT_FOUND)

    def _send_file(self, text: str, kind: str, name: str) -> None:
        head = {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(name)}"}
        self.send(text.encode(), f"text/{kind}; charset=utf-8", head)


def _parse_whole_number(text: str | None) -> int:
    """Parse a whole number of a request. Raises ``UsageError``."""
    if text is None or not text.isascii() or not text.isdigit() or len(text) > 9:
        raise UsageError("length must be a whole number")
    return int(text)
