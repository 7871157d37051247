# SPDX-License-Identifier: BSD-3-Clause
"""The page of a map answers this computer's own pages of it, and no stranger's."""

from __future__ import annotations

import http.client
import http.server
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("viser", reason="viser is not installed")

import viser
from browser import Browser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import ndtree
from ndtree import viewer as view
from ndtree.base.callers import MOST_CONNECTIONS
from ndtree.viewer import page_guard

PROTOCOL = [f"viser-v{viser.__version__}"]


@pytest.fixture(scope="module")
def viewer() -> Iterator[view.Viewer]:
    m = ndtree.AdaptiveMap(dim=2)
    m.insert(np.random.default_rng(1).normal(0, 3, (50, 2)), np.zeros(2))
    with view.Viewer(m, port=0) as made:
        yield made


def port_of(viewer: view.Viewer) -> int:
    return int(viewer.url.rpartition(":")[2])


def got(viewer: view.Viewer, path: str = "/", **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port_of(viewer), timeout=20)
    connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
    for name, value in {"Host": f"127.0.0.1:{port_of(viewer)}", **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    return response.status, dict(response.getheaders()), response.read()


def handshake(viewer: view.Viewer, **headers: str) -> str:
    """The first line of the answer to a browser that wants to speak with the page."""
    lines = [
        "GET / HTTP/1.1", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", f"Sec-WebSocket-Protocol: {PROTOCOL[0]}",
        *(f"{name}: {value}" for name, value in headers.items()),
    ]  # fmt: skip
    with socket.create_connection(("127.0.0.1", port_of(viewer)), timeout=20) as raw:
        raw.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        return raw.recv(4096).split(b"\r\n")[0].decode()


def opened(viewer: view.Viewer, origin: str | None) -> Any:
    url = f"ws://127.0.0.1:{port_of(viewer)}"
    return connect(url, origin=origin, subprotocols=PROTOCOL, max_size=None)


GOOD_HOSTS = ("127.0.0.1:{}", "localhost:{}", "LOCALHOST:{}", "[::1]:{}", "localhost:9", "localhost")
BAD_HOSTS = (
    *("localhost/evil", "localhost?evil", "localhost#evil", "127.0.0.1:{}/..", "localhost\\evil"),
    *("evil.example:{}", "evil.example", "127.0.0.1.evil.example", "localhost.evil.example:{}", ""),
    *("10.0.0.1:{}", "localhost@evil.example", "evil.example@localhost", "[::1", "0.0.0.0:{}"),
)
BAD_ORIGINS = (
    *("http://evil.example", "https://127.0.0.1:{}", "http://127.0.0.1", "http://127.0.0.1:1", "null", ""),
    *("http://localhost:{}", "http://127.0.0.1:{}.evil.example", "file://", "http://127.0.0.1:{}/"),
)


@pytest.mark.parametrize("host", GOOD_HOSTS)
def test_names_of_this_computer_are_answered(host: str, viewer: view.Viewer) -> None:
    host = host.format(port_of(viewer))
    assert got(viewer, Host=host)[0] == 200
    assert got(viewer, Host=host, Origin=f"http://{host}")[0] == 200
    assert handshake(viewer, Host=host, Origin=f"http://{host}") == "HTTP/1.1 101 Switching Protocols"


@pytest.mark.parametrize("host", BAD_HOSTS)
def test_other_names_are_refused(host: str, viewer: view.Viewer) -> None:
    """As a name of a stranger's is, that was made to lead to this computer."""
    host = host.format(port_of(viewer))
    status, _, body = got(viewer, Host=host)
    assert status in (400, 403) and b"viser" not in body.lower()
    assert handshake(viewer, Host=host, Origin=f"http://{host}").split()[1] in ("400", "403")


@pytest.mark.parametrize("origin", BAD_ORIGINS)
def test_pages_from_elsewhere_are_refused(origin: str, viewer: view.Viewer) -> None:
    origin = origin.format(port_of(viewer))
    host = f"127.0.0.1:{port_of(viewer)}"
    assert got(viewer, Origin=origin)[0] == 403
    assert handshake(viewer, Host=host, Origin=origin).split()[1] == "403"


def test_its_own_page_is_served(viewer: view.Viewer) -> None:
    for origin in (viewer.url, None):  # None: what calls is no browser.
        with opened(viewer, origin) as page:
            assert page.recv(timeout=20)
    with pytest.raises(InvalidStatus) as caught:
        opened(viewer, "http://evil.example")
    assert caught.value.response.status_code == 403


def test_two_hosts_are_refused(viewer: view.Viewer) -> None:
    with socket.create_connection(("127.0.0.1", port_of(viewer)), timeout=20) as raw:
        raw.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n")
        assert raw.recv(100).startswith((b"HTTP/1.1 403", b"HTTP/1.1 400"))


def test_other_pages_may_not_show_it(viewer: view.Viewer) -> None:
    status, headers, body = got(viewer, **{"Accept-Encoding": "gzip"})
    assert status == 200 and int(headers["Content-Length"]) == len(body)
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert "frame-ancestors" in headers["Content-Security-Policy"]
    assert got(viewer, "/../../etc/passwd")[0] == 404


def test_a_page_too_many_is_sent_away(viewer: view.Viewer) -> None:
    pages: list[Any] = []
    try:
        for _ in range(MOST_CONNECTIONS):
            pages.append(opened(viewer, viewer.url))
            assert pages[-1].recv(timeout=20)
        with opened(viewer, viewer.url) as late, pytest.raises(ConnectionClosed) as caught:
            while True:
                late.recv(timeout=20)
        assert caught.value.rcvd is not None and caught.value.rcvd.code == 1013
    finally:
        for page in pages:
            page.close()
    end = time.monotonic() + 20
    while time.monotonic() < end:  # The places are free again, soon.
        with opened(viewer, viewer.url) as page:
            try:
                assert page.recv(timeout=20)
                return
            except ConnectionClosed:
                time.sleep(0.1)
    pytest.fail("no place became free")


def test_a_page_that_says_too_much_is_closed(viewer: view.Viewer) -> None:
    with opened(viewer, viewer.url) as page, pytest.raises(ConnectionClosed):
        page.send(bytes(2 * page_guard.MOST_SAID))
        while True:
            page.recv(timeout=20)


def test_a_stranger_s_page_gets_nothing_in_a_browser(viewer: view.Viewer) -> None:
    """A page on another port of this computer has another origin, too."""
    script = f"""<body>asking<script>
      const s = new WebSocket("ws://127.0.0.1:{port_of(viewer)}", "{PROTOCOL[0]}");
      s.onopen = () => document.body.innerText = "let in";
      s.onerror = () => document.body.innerText = "refused";
    </script></body>"""

    class Page(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(script.encode())

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            with Browser(f"http://127.0.0.1:{server.server_port}") as browser:
                assert browser.until(lambda b: {"let in", "refused"} & {b.text()}) == {"refused"}
        finally:
            server.shutdown()
