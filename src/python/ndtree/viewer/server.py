# SPDX-License-Identifier: BSD-3-Clause
"""The server of the pages: its port, and its lights."""

from __future__ import annotations

import contextlib
import errno
import io
import socket

import viser

from ndtree.viewer.page_guard import guarded

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
