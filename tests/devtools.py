"""A headless Chromium that a test drives: opens pages, takes screenshots."""

import base64
import itertools
import json
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from websockets.sync.client import connect

PATIENCE = 180.0  # seconds


class Tab:
    """One page of the browser, over the DevTools protocol."""

    def __init__(self, address: str):
        """Talk to the tab at this websocket."""
        self._socket, self._numbers = connect(address, max_size=None), itertools.count()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The result of one method of the protocol."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(PATIENCE))
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]

    def screenshot(self) -> np.ndarray:
        """`[H, W, 3]` uint8."""
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def program() -> str | None:
    """The browser on this machine, if there is one."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@contextmanager
def browser(width: int, height: int) -> Iterator[Tab]:
    """A browser with one empty tab of this size; it ends with the block. Exits where there is none."""
    if program() is None:
        sys.exit("there is no Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program(), "--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader", "--hide-scrollbars",
            f"--user-data-dir={profile}", f"--window-size={width},{height}", "--remote-debugging-port=0",
            "--remote-allow-origins=*", "about:blank"]  # fmt: skip
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            tab = Tab(_first_tab(Path(profile) / "DevToolsActivePort"))
            tab.call(
                "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
            )
            yield tab
        finally:
            process.terminate()
            process.wait()


def _first_tab(file: Path) -> str:
    """The websocket of the tab, once the browser has written its port."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if file.exists() and (lines := file.read_text().split()):
            with urllib.request.urlopen(f"http://127.0.0.1:{lines[0]}/json") as answer:
                tabs = [tab for tab in json.load(answer) if tab["type"] == "page"]
            if tabs:
                return tabs[0]["webSocketDebuggerUrl"]
        time.sleep(0.1)
    sys.exit("the browser did not start")
