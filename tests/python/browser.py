# SPDX-License-Identifier: BSD-3-Clause
"""A page in headless Chromium, by its debugging protocol: pictures, clicks, and what is written on it."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest


class Browser:
    """One page, 1280 by 800 pixels, drawn without a graphics card."""

    def __init__(self, url: str) -> None:
        websockets = pytest.importorskip("websockets.sync.client")
        program = shutil.which("chromium") or shutil.which("chromium-browser")
        if program is None:
            pytest.skip("no chromium on PATH")
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        flags = (
            *("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"),
            *("--enable-unsafe-swiftshader", "--window-size=1280,800", "--hide-scrollbars"),
            *("--remote-debugging-port=0", f"--user-data-dir={self._folder.name}", "about:blank"),
        )
        self._program = subprocess.Popen(
            [program, *flags], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        )
        assert self._program.stderr is not None
        for line in self._program.stderr:
            found = re.search(r"ws://\S+", line)
            if found:
                break
        else:
            pytest.skip("chromium does not start")
        self._socket = websockets.connect(found[0], max_size=None)
        self._count, self._session = 0, None
        self.errors: list[str] = []
        target = self._call("Target.createTarget", url=url)["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._call("Runtime.enable")
        size = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **size)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._program.terminate()
        self._program.wait(20)
        self._folder.cleanup()

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("method") == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(answer["params"])[:300])
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]

    def picture(self) -> np.ndarray:
        """What is seen: (800, 1280, 3) uint8."""
        from PIL import Image

        data = self._call("Page.captureScreenshot", format="png")["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))

    def text(self) -> str:
        """What is written on the page."""
        return self._call("Runtime.evaluate", expression="document.body?.innerText ?? ''")["result"]["value"]

    def click(self, x: float, y: float) -> None:
        """Press and release the left button."""
        at = {"x": x, "y": y}
        self._call("Input.dispatchMouseEvent", type="mouseMoved", **at)
        for kind in ("mousePressed", "mouseReleased"):
            self._call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, buttons=1, **at)

    def click_label(self, text: str) -> None:
        """Click what belongs to a label on the panel."""
        expression = (
            "(() => {const all = [...document.querySelectorAll('label')];"
            f"const l = all.find(e => e.innerText.trim() === {text!r});"
            "const b = document.getElementById(l.htmlFor).getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2];})()"
        )
        places: list[Any] = []
        while len(places) < 3 or places[-1] != places[-3]:  # The panel moves while it is made.
            found = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
            places.append(found["result"]["value"])
            time.sleep(0.3)
        self.click(*places[-1])

    def until(self, is_there: Callable[[Browser], Any], seconds: float = 90.0) -> Any:
        """What `is_there` says as soon as it says anything; fails when it takes too long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found = is_there(self)
            if found:
                return found
            time.sleep(0.2)
        raise AssertionError(f"nothing after {seconds:g} s on a page that says: {self.text()!r}")


def coloured(picture: np.ndarray) -> np.ndarray:
    """Which pixels have a color, left of the panel and below messages."""
    some = picture[200:, :930].astype(int)
    return some.max(axis=2) - some.min(axis=2) > 40
