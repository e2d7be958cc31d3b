"""A viser server that answers only who knows its address.

viser serves whoever reaches its port, and has no hook to do otherwise. Here every request must begin with a secret
path: ``http://127.0.0.1:PORT/SECRET/``. Other users of the machine, and pages of other sites that a browser has open,
do not know it. viser's page takes its own address for the connection that it opens, so any forwarded port works.
"""

from __future__ import annotations

import errno
import http
import io
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from getagrip.errors import GetagripError, UsageError

if TYPE_CHECKING:
    from viser import ViserServer

PORT = 8770
"""Where the page is served, if that is free."""
LOOPBACK = "127.0.0.1"
_starting = threading.Lock()


@dataclass(frozen=True)
class Served:
    """A server and the address of its page."""

    viser: ViserServer
    host: str
    port: int
    secret: str

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{self.host}:{self.port}/{self.secret}/"

    def stop(self) -> None:
        """Listen no more."""
        with redirect_stdout(io.StringIO()):  # viser says so otherwise
            self.viser.stop()


def serve(port: int | None = None, host: str = LOOPBACK) -> Served:
    """Start to listen on a port; without one on ``PORT``, or on any free one if that is taken.

    Raises ``UsageError`` for a port that is taken or an address that is not this machine's, and ``GetagripError`` where
    viser is not installed or can no longer be guarded.
    """
    try:
        import viser
    except ImportError as error:
        missing = f"view needs viser ({error}): pip install 'getagrip[view]'"
        raise GetagripError(missing) from error
    chosen, secret = _free(host, port), secrets.token_urlsafe(16)
    with _starting, _guarded(secret) as guards, redirect_stdout(io.StringIO()):
        started = viser.ViserServer(host, chosen, label="getagrip", verbose=False)
    served = Served(started, host, started.get_port(), secret)
    if not guards or (port and served.port != port):
        served.stop()
        raise GetagripError(f"viser {viser.__version__} serves in an unknown way; expected version 1.1.1 or later")
    return served


def _free(host: str, port: int | None) -> int:
    """The port to ask for: 0 stands for any free one. Raises ``UsageError``."""
    asked = PORT if port is None else port
    given = f"--port, --host: got {asked}, {host}"
    if not 0 <= asked < 2**16:
        raise UsageError(f"{given}, expected a port from 0, for any free one, to {2**16 - 1}")
    try:
        with socket.create_server((host, asked)) as probe:
            return int(probe.getsockname()[1])
    except OSError as error:
        if port is None and error.errno == errno.EADDRINUSE:
            return 0
        raise UsageError(f"{given}, expected a free port of this machine ({error})") from error


@contextmanager
def _guarded(secret: str) -> Iterator[list[str]]:
    """Servers that start meanwhile answer only requests below ``/secret``; each adds itself to the list."""
    import websockets.asyncio.server as sockets

    guards: list[str] = []
    listen = sockets.serve

    def guarded(*args: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        guards.append(secret)
        return listen(*args, process_request=only_below(secret, process_request), **options)

    setattr(sockets, "serve", guarded)  # noqa: B010  (mypy knows that it is a class)
    try:
        yield guards
    finally:
        setattr(sockets, "serve", listen)  # noqa: B010


def only_below(secret: str, process: Callable[..., Any]) -> Callable[..., Any]:
    """A function that answers HTTP requests and lets connections pass, but only those below ``/secret``."""
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response

    def answer(connection: Any, request: Request) -> Any:
        first, _, rest = request.path.partition("?")[0].removeprefix("/").partition("/")
        if not secrets.compare_digest(first.encode(), secret.encode()):
            body = b"This page opens only at the whole address that getagrip view has printed.\n"
            head = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body)), "Connection": "close"})
            return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", head, body)
        return process(connection, replace(request, path=f"/{rest}"))

    return answer
