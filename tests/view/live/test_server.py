"""The page answers nobody who does not know its whole address."""

from __future__ import annotations

import http.client
import socket
import sys
from collections.abc import Iterator

import pytest

from getagrip.errors import GetagripError, UsageError
from getagrip.view.live.server import LOOPBACK, Served, serve
from helpers.needs import needs

pytestmark = needs("viser", "view")


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    made = serve()
    yield made
    made.stop()


def status(served: Served, path: str) -> int:
    connection = http.client.HTTPConnection(served.host, served.port, timeout=10)
    connection.request("GET", path)
    answer = connection.getresponse().status
    connection.close()
    return answer


def test_the_page_is_below_the_secret_and_nowhere_else(served: Served) -> None:
    assert status(served, f"/{served.secret}/") == 200
    assert status(served, f"/{served.secret}") == 200
    assert status(served, f"/{served.secret}/?darkMode") == 200
    assert len(served.secret) >= 20
    wrong = ["/", "/index.html", f"/{served.secret[:-1]}/", f"/{served.secret}x/", f"//{served.secret}/", "/%00"]
    wrong += [f"/x/../{served.secret}/", f"/?{served.secret}", f"/{served.secret.swapcase()}/"]
    assert [status(served, path) for path in wrong] == [403] * len(wrong)
    assert status(served, f"/{served.secret}/../../_viser.py") == 404


def test_what_is_shown_comes_only_below_the_secret(served: Served) -> None:
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    own = [f"viser-v{viser.__version__}"]
    for path in ("/", "/index.html", f"/{served.secret}x"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://{served.host}:{served.port}{path}", subprotocols=own)
    with connect(f"ws://{served.host}:{served.port}/{served.secret}", subprotocols=own) as connection:
        assert connection.recv(timeout=10)


def test_it_listens_to_this_machine_alone(served: Served) -> None:
    assert served.host == LOOPBACK
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {LOOPBACK}
    for address in others:
        with pytest.raises(OSError):  # noqa: PT011
            socket.create_connection((address, served.port), timeout=2)


def test_a_second_page_finds_a_port_of_its_own_and_has_another_secret(served: Served) -> None:
    second = serve()
    try:
        assert second.port != served.port
        assert second.secret != served.secret
        assert status(second, f"/{served.secret}/") == 403
        assert str(second.port) in second.url
    finally:
        second.stop()


@pytest.mark.parametrize("port", [None, 70000, -1])
def test_ports_and_addresses_that_cannot_be_had_are_named(served: Served, port: int | None) -> None:
    with pytest.raises(UsageError, match="--port") as caught:
        serve(served.port if port is None else port)
    assert str(served.port if port is None else port) in str(caught.value)
    with pytest.raises(UsageError, match=r"203\.0\.113\.1"):
        serve(0, "203.0.113.1")


def test_without_viser_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(GetagripError, match=r"pip install 'getagrip\[view\]'"):
        serve()


def test_a_viser_that_serves_in_another_way_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    import viser
    import websockets.asyncio.server as sockets

    from getagrip.view.live import server

    listen = sockets.serve

    class Unguarded(viser.ViserServer):  # type: ignore[misc, name-defined]
        def __init__(self, *args: object, **options: object) -> None:
            sockets.serve = listen
            super().__init__(*args, **options)

    monkeypatch.setattr(viser, "ViserServer", Unguarded)
    with pytest.raises(GetagripError, match="in an unknown way"):
        server.serve(0)
    assert sockets.serve is listen
