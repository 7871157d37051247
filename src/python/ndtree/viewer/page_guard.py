# SPDX-License-Identifier: BSD-3-Clause
"""Who may open the page of a map, which is no page from elsewhere."""

from __future__ import annotations

import contextlib
import errno
import http
import io
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

import viser
from websockets.asyncio import server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from ndtree.base.callers import MOST_CONNECTIONS, why_not

#: What a page says is where its camera is, and what was clicked.
MOST_SAID = 1 << 20
_SAFER = {
    "Content-Security-Policy": "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_PATCHING = threading.Lock()

Answer = Callable[[server.ServerConnection, Request], "Response | None"]
Handler = Callable[[server.ServerConnection], Awaitable[None]]


@contextmanager
def guarded() -> Iterator[None]:
    """Servers that begin within check who asks: viser, which begins one, has no place for that."""
    with _PATCHING:
        serve = server.serve

        def guarded_serve(handler: Handler, *place: Any, process_request: Answer, **more: Any) -> Any:
            more["max_size"] = MOST_SAID
            return serve(_limited(handler), *place, process_request=_checked(process_request), **more)

        server.serve = guarded_serve
        try:
            yield
        finally:
            server.serve = serve


def _checked(answer: Answer) -> Answer:
    def checked(connection: server.ServerConnection, request: Request) -> Response | None:
        reason = why_not(request.headers.get_all("Host"), request.headers.get_all("Origin"))
        if reason is not None:
            return _said(http.HTTPStatus.FORBIDDEN, reason)
        response = answer(connection, request)
        if response is not None and response.status_code == http.HTTPStatus.OK:
            response.headers.update(_SAFER)
        return response

    return checked


def _said(status: http.HTTPStatus, text: str) -> Response:
    body = f"{text}\n".encode()
    headers = Headers(
        {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), **_SAFER}
    )
    return Response(status.value, status.phrase, headers, body)


def _limited(handler: Handler) -> Handler:
    """At most this many pages at once; further ones get an answer to try again later."""
    pages: set[int] = set()

    async def limited(connection: server.ServerConnection) -> None:
        if len(pages) >= MOST_CONNECTIONS:
            await connection.close(1013, f"{MOST_CONNECTIONS} pages are open")
            return
        pages.add(id(connection))
        try:
            await handler(connection)
        finally:
            pages.discard(id(connection))

    return limited


HOST = "127.0.0.1"
#: Lights: from where, and how bright.
_LIGHTS = (((0.15, -0.45, 0.9), 2.3), ((0.9, -0.3, 0.1), 0.6), ((-0.3, 0.6, -0.5), 0.5))


def started(port: int) -> viser.ViserServer:
    if not 0 <= port <= 65535:
        raise ValueError(f"port = {port}: must be from 0 to 65535")
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
    except OSError as error:
        raise _unusable(port, error.errno, error.strerror) from None
    with guarded(), contextlib.redirect_stdout(io.StringIO()):  # viser introduces itself.
        server = viser.ViserServer(host=HOST, port=port, verbose=False)
    if port and server.get_port() != port:  # Somebody was faster, and viser took another.
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
        raise _unusable(port, errno.EADDRINUSE, None)
    return server


def light_up(scene: viser.SceneApi) -> None:
    """Faces are told apart by their brightness, and none is black."""
    scene.set_up_direction("+z")
    scene.configure_environment_map(hdri=None)
    scene.configure_default_lights(enabled=False)
    scene.add_light_ambient("/light", intensity=1.0)
    for i, (direction, intensity) in enumerate(_LIGHTS):
        scene.add_light_directional(f"/light/{i}", intensity=intensity, cast_shadow=False, position=direction)


def _unusable(port: int, number: int | None, reason: str | None) -> OSError:
    found = "in use by another program" if number == errno.EADDRINUSE else reason
    return OSError(number, f"port {port} is {found}, expected a free one", f"{HOST}:{port}")
