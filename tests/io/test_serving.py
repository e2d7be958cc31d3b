"""Connections of a page's server: a bounded number at once, and all are answered."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest

from getagrip.report import serving
from getagrip.report.serving import LOOPBACK, QuietHandler, QuietServer


class _Handler(QuietHandler):
    working, most = 0, 0

    def do_GET(self) -> None:
        _Handler.working += 1
        _Handler.most = max(_Handler.most, threading.active_count())
        time.sleep(0.001)
        self.send_json({"path": self.path})


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[QuietServer]:
    monkeypatch.setattr(serving, "MAX_CONNECTIONS", 4)
    monkeypatch.setattr(serving, "BUSY_IDLE_TIMEOUT_S", 0.05)
    monkeypatch.setattr(serving, "CONNECTION_POLL_S", 0.01)
    with QuietServer((LOOPBACK, 0), _Handler) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def connected(server: QuietServer) -> socket.socket:
    return socket.create_connection((LOOPBACK, server.server_port), timeout=30.0)


def asked(server: QuietServer) -> bytes:
    """The answer on a connection that stays open until the server closes it."""
    with connected(server) as client:
        client.sendall(b"GET /a HTTP/1.1\r\nHost: here\r\n\r\n")
        return client.recv(4096)


def test_many_at_once_are_all_answered_by_few_threads(server: QuietServer) -> None:
    before = threading.active_count()
    with ThreadPoolExecutor(60) as clients:
        answers = [*clients.map(lambda _: asked(server), range(120))]
    assert all(answer.startswith(b"HTTP/1.1 200") for answer in answers)
    assert _Handler.most <= before + 60 + serving.MAX_CONNECTIONS


def test_those_that_ask_nothing_make_room(server: QuietServer) -> None:
    with ExitStack() as stack:
        silent = [stack.enter_context(connected(server)) for _ in range(10)]
        silent[0].sendall(b"GET /a HTTP/1.1\r\nHost: he")  # half a request
        assert asked(server).startswith(b"HTTP/1.1 200")
