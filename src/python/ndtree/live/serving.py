# SPDX-License-Identifier: BSD-3-Clause
"""A sink that gives a running map to who asks for it by HTTP, as ``ndtree view`` of another computer does."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from ndtree._native._core import OccupancyMap

#: Where it listens unless it is told: to this computer alone.
HOST = "127.0.0.1"
#: From one snapshot to the next that is kept for who asks [s].
PERIOD = 0.5
#: The map's file.
PATH = "/map.ndt"


class MapServer:
    """Answers ``GET /map.ndt`` with the file of the map as it is now.

    It has the number of the map's state as its ETag, so that who has it already is told so (304); without a
    map it is 503. A file is made only when somebody asks for it.

    Parameters
    ----------
    port : int
        0 takes any free port.
    host : str
        Who may ask: "127.0.0.1" this computer, "0.0.0.0" all that reach it. There is no password.

    Raises
    ------
    OSError
        If the port is in use, or the host not one of this computer.
    """

    period = PERIOD

    def __init__(self, port: int = 0, *, host: str = HOST) -> None:
        self._lock = threading.Lock()
        self._map: OccupancyMap | None = None
        self._number = 0
        self._made: tuple[int, bytes] | None = None
        handler = type("Handler", (_Handler,), {"served": self})
        try:
            self._server = ThreadingHTTPServer((host, port), handler)
        except OverflowError:
            raise OSError(f"port = {port}: must be from 0 to 65535") from None
        self._server.daemon_threads = True
        self._host = host
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="ndtree-serve", daemon=True
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """What ``ndtree view`` is given."""
        return f"http://{self._host}:{self._server.server_address[1]}"

    def update(self, m: OccupancyMap, stamp: float) -> None:
        """Keep a snapshot for who asks."""
        with self._lock:
            self._map, self._number = m, self._number + 1

    def file(self) -> tuple[int, bytes] | None:
        """The number of the newest map, and its file; None before there is one."""
        with self._lock:
            m, number, made = self._map, self._number, self._made
        if m is None:
            return None
        if made is None or made[0] != number:
            made = number, m.to_bytes()
            with self._lock:
                self._made = made
        return made

    @property
    def number(self) -> int:
        """Of the newest map; 0 before there is one."""
        return self._number

    def close(self) -> None:
        """Answer no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(BaseHTTPRequestHandler):
    served: MapServer

    def do_GET(self) -> None:
        if self.path not in ("/", PATH):
            self._answer(404, b"")
            return
        if self.served.number and self.headers.get("If-None-Match") == f'"{self.served.number}"':
            self._answer(304, b"")
            return
        made = self.served.file()
        if made is None:
            self._answer(503, b"")
        else:
            self._answer(200, made[1], ETag=f'"{made[0]}"')

    def _answer(self, status: int, body: bytes, **headers: str) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        if status != 304:
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if body:
            self.wfile.write(body)

    def log_message(self, format: str, *_: Any) -> None:
        """Print nothing."""


def address_of(text: str) -> tuple[str, int]:
    """Host and port of ``[HOST:]PORT``; ValueError says what is wrong."""
    host, _, port = text.rpartition(":")
    if not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"serve = {text}: must be PORT or HOST:PORT, with a port from 0 to 65535")
    return host or HOST, int(port)
