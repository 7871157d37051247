# SPDX-License-Identifier: BSD-3-Clause
"""A running map by HTTP: a sink that gives it to who asks, and who asks, as ``ndtree view`` elsewhere."""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
import urllib.error
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from ndtree._errors import WrongValue
from ndtree._native._core import AdaptiveMap, FixedMap, OccupancyMap, from_bytes
from ndtree.base.callers import LOCAL_NAMES, MOST_CONNECTIONS, why_not

#: Where it listens unless it is told: to this computer alone.
HOST = "127.0.0.1"
#: From one snapshot to the next that is kept for who asks [s].
PERIOD = 0.5
#: The map's file.
PATH = "/map.ndt"
#: A request is whole within this time, and each part of an answer is taken within it [s].
TIMEOUT = 10.0
#: Bytes of such a part.
_PART = 1 << 16
_BUSY = b"HTTP/1.0 503 Service Unavailable\r\nContent-Length: 0\r\n\r\n"


class MapServer:
    """Answers ``GET /map.ndt`` with the file of the map as it is now.

    It has the number of the map's state as its ETag, so that a caller that has it already is told so (304);
    without a map it is 503. A file is made only when it is asked for. A request with a stranger's name, or
    from a stranger's page, is refused (403); of more than 16 at once, the others have to come again (503).

    `port`: 0 takes any free port.
    `host`: Who may ask: "127.0.0.1" this computer, "0.0.0.0" all that reach it. There is no password.
    Raises OSError if the port is in use, or the host not one of this computer.
    """

    period = PERIOD

    def __init__(self, port: int = 0, *, host: str = HOST) -> None:
        self._lock = threading.Lock()
        self._map: OccupancyMap | None = None
        self._number = 0
        self._made: tuple[int, bytes] | None = None
        handler = type("Handler", (_Handler,), {"served": self})
        try:
            self._server = _Server((host, port), handler)
        except OverflowError:
            raise OSError(f"port = {port}: must be from 0 to 65535") from None
        except OSError as error:
            raise OSError(error.errno, f"cannot listen there: {error.strerror}", f"{host}:{port}") from None
        self._host = host
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="ndtree-serve", daemon=True
        )
        self._thread.start()

    @property
    def is_only_here(self) -> bool:
        """Whether only this computer can ask."""
        return self._host in LOCAL_NAMES

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


class _Server(ThreadingHTTPServer):
    """Bounds how many ask at once, and for how long."""

    daemon_threads = True

    def __init__(self, *arguments: Any) -> None:
        self._open: dict[socket.socket, float] = {}  # By when the request has to be whole.
        super().__init__(*arguments)

    def process_request(self, request: Any, client_address: Any) -> None:
        if len(self._open) >= MOST_CONNECTIONS:
            with contextlib.suppress(OSError):
                request.setblocking(False)
                request.send(_BUSY)
            self.shutdown_request(request)
            return
        self._open[request] = time.monotonic() + TIMEOUT
        super().process_request(request, client_address)

    def is_whole(self, request: Any) -> None:
        """The request has been read: its answer may take longer."""
        if request in self._open:
            self._open[request] = float("inf")

    def service_actions(self) -> None:
        """Cut off who says half a request, however slowly."""
        now = time.monotonic()
        for request, until in list(self._open.items()):
            if now > until:
                with contextlib.suppress(OSError):
                    request.shutdown(socket.SHUT_RDWR)

    def shutdown_request(self, request: Any) -> None:
        self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that leaves is no error of ours."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    served: MapServer
    server: _Server
    timeout = TIMEOUT

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        self.server.is_whole(self.request)
        hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
        reason = why_not(hosts, origins, only_here=self.served.is_only_here)
        if reason is not None:
            self._answer(403, f"{reason}\n".encode())
            return
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
            kind = "application/octet-stream" if status == 200 else "text/plain; charset=utf-8"
            self.send_header("Content-Type", kind)
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "HEAD":
            return
        for begin in range(0, len(body), _PART):  # The time is of each part: a large map may take longer.
            self.wfile.write(body[begin : begin + _PART])

    def log_message(self, format: str, *_: Any) -> None:
        """Print nothing."""


def address_of(text: str) -> tuple[str, int]:
    """Host and port of ``[HOST:]PORT``; ValueError says what is wrong."""
    host, _, port = text.rpartition(":")
    if not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise WrongValue.of("serve", text, "PORT or HOST:PORT, with a port from 0 to 65535")
    return host or HOST, int(port)


#: A server that says nothing for so long counts as gone [s].
PATIENCE = 10.0
#: The largest file that is taken [bytes].
MOST = 1 << 32


class RunningMap:
    """The map of a live mapper on this or another computer.

    `url`: As the mapper says it: ``http://robot:8090``.
    Raises ValueError if it is no address.
    """

    def __init__(self, url: str) -> None:
        if not is_address(url) or not urlsplit(url).hostname:
            raise ValueError(f"{url}: expected an address as http://robot:8090")
        self.url = url.rstrip("/")
        self._tag = ""

    def newest(self) -> AdaptiveMap | FixedMap | None:
        """The map as it is now; None where it is as it was, or where there is none yet.

        Raises OSError if there is no answer, or one that is no map.
        """
        request = urllib.request.Request(f"{self.url}{PATH}", headers={"If-None-Match": self._tag})
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
                data, tag = answer.read(MOST), answer.headers.get("ETag", "")
        except urllib.error.HTTPError as error:
            if error.code in (304, 503):
                return None
            raise OSError(f"{self.url}: answers {error.code}, expected a live map of ndtree") from None
        except OSError as error:
            reason = getattr(error, "reason", error)
            reason = getattr(reason, "strerror", None) or reason
            raise OSError(f"{self.url}: {reason}, expected a live map of ndtree to answer") from None
        try:
            m = from_bytes(data)
        except (RuntimeError, ValueError) as error:
            raise OSError(f"{self.url}: {error}, expected a live map of ndtree") from None
        self._tag = tag
        return m


def is_address(name: str) -> bool:
    """Whether something is an address, and no file."""
    return name.startswith(("http://", "https://"))
