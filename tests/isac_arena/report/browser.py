"""A headless Chromium driven over its DevTools protocol through two pipes, for tests of pages."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from select import select
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--no-first-run", "--disable-extensions", "--disable-background-networking",
    "--hide-scrollbars", "--force-color-profile=srgb", "--remote-debugging-pipe",
)  # fmt: skip
PATIENCE_S = 60.0
LAUNCHER = """
import os, sys
pipes = [os.dup(int(number)) for number in sys.argv[1:3]]
for pipe, number in zip(pipes, (3, 4)):  # the protocol is spoken on these two
    os.dup2(pipe, number)
    os.set_inheritable(number, True)
os.execv(sys.argv[3], sys.argv[3:])
"""


def find_browser() -> str | None:
    """The program to run; None where this machine has none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Tab:
    """One page of the browser, with all that it asked the network for and all that it complained about."""

    def __init__(self, send_fd: int, receive_fd: int) -> None:
        self._send_fd, self._receive_fd = send_fd, receive_fd
        self._number, self._left = 0, b""
        self._answers: dict[int, dict[str, Any]] = {}
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []

    def attach(self) -> None:
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """What the browser answers to a command."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._send_fd, json.dumps(message).encode() + b"\0")
        number = self._number
        self._wait(lambda: number in self._answers, method)
        answer = self._answers.pop(number)
        assert "error" not in answer, (method, answer["error"])
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, address: str) -> None:
        """Load an address and wait until it has finished."""
        self.events.clear()
        self.call("Page.navigate", url=address)
        self._wait(lambda: self._saw("Page.loadEventFired"), address)

    def show(self, page: Path, fragment: str = "") -> None:
        """Load a page of ours from its file, and wait until it says that it is ready and has drawn itself."""
        self.open("about:blank")  # else another fragment of the same page would load nothing
        self.open(f"{page.as_uri()}{fragment}")
        self.settle()
        assert self.evaluate("document.documentElement.dataset.ready") == "yes"

    def is_silent(self) -> bool:
        """Whether nothing complained and nothing was asked for but the file itself and what stands in it."""
        assert self.evaluate("document.documentElement.dataset.errors ?? ''") == ""
        assert self.complaints == []
        assert {address.split(":")[0] for address in self.requests} <= {"file", "data", "blob"}
        return True

    def text(self, selector: str) -> str:
        """The text of the first element of that kind."""
        return str(self.evaluate(f"document.querySelector({selector!r}).innerText"))

    def count(self, selector: str) -> int:
        """How many elements there are of that kind."""
        return int(self.evaluate(f"document.querySelectorAll({selector!r}).length"))

    def evaluate(self, expression: str) -> Any:
        """The value of an expression in the page, a promise awaited."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, (expression, answer["exceptionDetails"])
        return answer["result"].get("value")

    def settle(self) -> None:
        """Wait until the page has drawn what it was told to."""
        frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))"
        self.evaluate(frame)

    def click(self, selector: str) -> None:
        """Press the middle of an element, with the mouse, where it really stands."""
        self.evaluate(f"document.querySelector({selector!r}).scrollIntoView({{block: 'center'}})")
        self.settle()
        box = self.evaluate(
            f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect();"
            " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        self.press(*box)

    def press(self, x: float, y: float) -> None:
        """Move the mouse to a place in the window and click there."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        self.settle()

    def key(self, key: str, text: str = "") -> None:
        """Press a key."""
        more = {"text": text} if text else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, **(more if kind == "keyDown" else {}))
        self.settle()

    def size(self, width: int, height: int, scale: float = 1.0, *, is_phone: bool = False) -> None:
        """Give the window a size in CSS pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale,
            mobile=is_phone,
        )  # fmt: skip

    def media(self, kind: str = "", **features: str) -> None:
        """Show the page as on this medium ('print'), with these features (prefers_color_scheme='dark')."""
        chosen = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
        self.call("Emulation.setEmulatedMedia", media=kind, features=chosen)

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Write what is seen, or the whole page, as a PNG file."""
        data = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"]
        path.write_bytes(b64decode(data))

    @property
    def requests(self) -> list[str]:
        """Addresses that the page asked for."""
        return [
            event["params"]["request"]["url"]
            for event in self.events
            if event["method"] == "Network.requestWillBeSent"
        ]

    @property
    def complaints(self) -> list[str]:
        """Errors in the console, and exceptions that nothing caught."""
        found = []
        for event in self.events:
            about = event.get("params", {})
            if event["method"] == "Runtime.exceptionThrown":
                found.append(json.dumps(about["exceptionDetails"]))
            elif event["method"] == "Runtime.consoleAPICalled" and about["type"] == "error":
                found.append(json.dumps(about["args"]))
            elif event["method"] == "Log.entryAdded" and about["entry"]["level"] == "error":
                found.append(about["entry"]["text"])
        return found

    def _saw(self, method: str) -> bool:
        return any(event["method"] == method for event in self.events)

    def _wait(self, done: Any, what: str) -> None:
        until = time.monotonic() + PATIENCE_S
        while not done():
            ready, _, _ = select([self._receive_fd], [], [], max(until - time.monotonic(), 0))
            if not ready:
                raise TimeoutError(f"the browser did not answer: {what}")
            received = os.read(self._receive_fd, 1 << 20)
            if not received:
                raise ConnectionError(f"the browser ended: {what}")
            *messages, self._left = (self._left + received).split(b"\0")
            for message in map(json.loads, messages):
                if "id" in message:
                    self._answers[message["id"]] = message
                else:
                    self.events.append(message)


@contextmanager
def open_browser(folder: Path) -> Iterator[Tab]:
    """A tab of a fresh browser whose profile and downloads lie in `folder`; it ends with the block."""
    program = find_browser()
    assert program is not None
    to_browser, from_us = os.pipe()
    to_us, from_browser = os.pipe()

    process = subprocess.Popen(
        [
            *(sys.executable, "-c", LAUNCHER, str(to_browser), str(from_browser)),
            *(program, *FLAGS, f"--user-data-dir={folder / 'profile'}", "about:blank"),
        ],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        pass_fds=(to_browser, from_browser),
    )  # fmt: skip
    os.close(to_browser)
    os.close(from_browser)
    try:
        tab = Tab(from_us, to_us)
        tab.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
        tab.attach()
        yield tab
    finally:
        process.terminate()
        process.wait(timeout=20)
        os.close(from_us)
        os.close(to_us)
