# SPDX-License-Identifier: BSD-3-Clause
"""A running map is seen from another process, or another computer."""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from calling import cli

import ndtree
from ndtree.base.callers import MOST_CONNECTIONS
from ndtree.live import LiveMapper, MapServer, ScansIntake, serving
from ndtree.live.serving import RunningMap, address_of
from ndtree.tuning.config import Config

SETTINGS = Config.of(no_return="free")


def test_a_map_that_grows_is_fetched_as_often_as_it_changes() -> None:
    server = MapServer()
    server.period = 0.0
    running = RunningMap(server.url)
    scans = list(ndtree.simulate("office", scans=20))
    fetched = 0
    try:
        assert running.newest() is None  # There is none yet.
        with LiveMapper(ScansIntake(SETTINGS, 2), sinks=[server]) as mapper:
            for scan in scans:
                mapper.put(scan)
                fetched += running.newest() is not None
        newest = running.newest() or fetched
        assert newest and running.newest() is None
        again = RunningMap(server.url + "/").newest()
        assert again is not None and again.to_bytes() == mapper.snapshot().to_bytes()
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{server.url}/other", timeout=10)
    finally:
        server.close()
    with pytest.raises(OSError, match=r"expected a live map of ndtree to answer$"):
        running.newest()


def test_a_file_is_made_only_for_who_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    class Counted:
        made = 0

        def to_bytes(self) -> bytes:
            Counted.made += 1
            return ndtree.AdaptiveMap(dim=2).to_bytes()

    server = MapServer()
    try:
        for _ in range(5):
            server.update(Counted(), 0.0)  # type: ignore[arg-type]
        assert Counted.made == 0
        for _ in range(3):
            assert RunningMap(server.url).newest() is not None
        assert Counted.made == 1
    finally:
        server.close()


def test_view_draws_a_running_map(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    server = MapServer()
    try:
        m = ndtree.AdaptiveMap(dim=2)
        for scan in ndtree.simulate("office", scans=5):
            scan.insert_into(m)
        server.update(m.snapshot(), 0.0)
        done = cli("view", server.url, "--png", tmp_path / "m.png")
        assert done.exit_code == 0 and (tmp_path / "m.png").stat().st_size > 5000, done.stderr
    finally:
        server.close()
    done = cli("view", server.url)
    assert done.exit_code == 1 and server.url in done.stderr and "Traceback" not in done.stderr


def test_a_page_follows_a_running_map(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    m = ndtree.AdaptiveMap(dim=2)
    scans = list(ndtree.simulate("office", scans=5))
    scans[0].insert_into(m)
    asked = []

    class Server(MapServer):
        def file(self) -> Any:
            asked.append(self.number)
            return super().file()

    server = Server()
    server.update(m.snapshot(), 0.0)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "ndtree", "view", server.url, "--port", str(port)]
    page = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert page.stdout is not None
        assert f"{server.url}: http://" in page.stdout.readline()
        scans[1].insert_into(m)
        server.update(m.snapshot(), 1.0)
        deadline = time.monotonic() + 60
        while 2 not in asked and time.monotonic() < deadline:
            time.sleep(0.05)
        assert 2 in asked and page.poll() is None
        server.close()
        assert page.stderr is not None and "expected a live map" in page.stderr.readline()
        assert page.poll() is None  # The last map stays.
    finally:
        page.kill()
        page.communicate()


class Other(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200 if self.path.startswith("/web") else 500)
        self.end_headers()
        self.wfile.write(b"<html></html>")

    def log_message(self, format: str, *_: Any) -> None:
        pass


def test_what_is_no_live_map_is_said(tmp_path: Path) -> None:
    other = HTTPServer(("127.0.0.1", 0), Other)
    Thread(target=other.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{other.server_address[1]}"
    try:
        with pytest.raises(OSError, match="answers 500, expected a live map"):
            RunningMap(url).newest()
        with pytest.raises(OSError, match=r"not an ndtree map.*expected a live map"):
            RunningMap(url + "/web").newest()
    finally:
        other.shutdown()
        other.server_close()
    with pytest.raises(ValueError, match="expected an address"):
        RunningMap("http://")
    for text in ("", "here", "1:2:x", "70000", "-1"):
        with pytest.raises(ValueError, match="serve = "):
            address_of(text)
    assert address_of("0.0.0.0:80") == ("0.0.0.0", 80) and address_of("8090") == ("127.0.0.1", 8090)
    done = cli("live", "--world", "office", "--rate", 0, "--serve", "x")
    assert done.exit_code == 2 and "--serve x: must be" in done.stderr


def answer(server: MapServer, request: bytes) -> bytes:
    port = int(server.url.rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=60) as client:
        client.sendall(request)
        client.shutdown(socket.SHUT_WR)
        said = b""
        while part := client.recv(1 << 16):
            said += part
    return said


@pytest.mark.parametrize("host, open_to, status", [
    ("127.0.0.1", "127.0.0.1", 200), ("localhost:1", "127.0.0.1", 200), ("[::1]", "127.0.0.1", 200),
    ("evil.example", "127.0.0.1", 403), ("10.0.0.7", "127.0.0.1", 403), ("", "127.0.0.1", 403),
    ("10.0.0.7:8090", "0.0.0.0", 200), ("robot:8090", "0.0.0.0", 200), ("robot.local", "0.0.0.0", 200),
    ("evil.example:8090", "0.0.0.0", 403), ("a b", "0.0.0.0", 403),
])  # fmt: skip
def test_no_stranger_is_answered(host: str, open_to: str, status: int) -> None:
    server = MapServer(host=open_to)
    server.update(ndtree.AdaptiveMap(dim=2), 0.0)
    line = f"Host: {host}\r\n".encode() if host else b""
    try:
        for origin, expected in ((b"", status), (f"Origin: http://{host}\r\n".encode(), status),
                                 (b"Origin: http://evil.example\r\n", 403),
                                 (b"Host: localhost\r\n", 403)):  # fmt: skip
            if not host and origin:
                continue
            said = answer(server, b"GET /map.ndt HTTP/1.1\r\n" + line + origin + b"\r\n")
            assert said.split()[1] == str(expected).encode(), (origin, said[:80])
    finally:
        server.close()


def test_a_head_is_answered_without_the_map() -> None:
    server = MapServer()
    m = ndtree.AdaptiveMap(dim=2)
    server.update(m, 0.0)
    try:
        said = answer(server, b"HEAD /map.ndt HTTP/1.0\r\nHost: localhost\r\n\r\n")
        assert b" 200 " in said and said.endswith(b"\r\n\r\n")
        assert f"Content-Length: {len(m.to_bytes())}".encode() in said and b"ETag" in said
    finally:
        server.close()


def test_who_says_nothing_is_cut_off_and_nothing_is_printed(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Half requests, also those that go on byte by byte, and clients that leave."""
    monkeypatch.setattr(serving, "TIMEOUT", 0.5)
    monkeypatch.setattr(serving._Handler, "timeout", 0.5)
    server = MapServer()
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.05)
    m.insert(np.random.default_rng(1).normal(0, 8, (20_000, 3)), np.zeros(3))
    server.update(m, 0.0)
    address = ("127.0.0.1", int(server.url.rpartition(":")[2]))
    threads = threading.active_count()
    silent = [socket.create_connection(address, timeout=60) for _ in range(60)]
    try:
        deadline = time.monotonic() + 60
        while silent[-1].recv(1 << 16) and time.monotonic() < deadline:
            pass
        assert threading.active_count() <= threads + MOST_CONNECTIONS
        begin = time.monotonic()
        with contextlib.suppress(OSError):
            while time.monotonic() < begin + 60:
                silent[0].sendall(b"G")
                time.sleep(0.1)
        assert time.monotonic() - begin < 30
        while threading.active_count() > threads and time.monotonic() < deadline:
            time.sleep(0.05)
        assert threading.active_count() <= threads
        for _ in range(5):  # And who leaves without hearing the answer.
            with socket.create_connection(address) as client:
                client.sendall(b"GET /map.ndt HTTP/1.0\r\nHost: localhost\r\n\r\n")
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        running = RunningMap(server.url).newest()
        assert running is not None and running.to_bytes() == m.to_bytes()
    finally:
        for client in silent:
            client.close()
        server.close()
    assert capfd.readouterr().err == ""
