"""A headless Chromium on one page, driven over the DevTools protocol through a pipe: no port, no further package.

Keeps what the page logged, what it asked the network for, and the bytes that came over its websockets.
Source: https://chromedevtools.github.io/devtools-protocol.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_ANSWER_S = 60.0
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
    "--remote-debugging-pipe",
)


def chromium() -> str | None:
    """Where a browser is installed; None if none is."""
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page. Use as a context manager."""

    def __init__(self, program: str) -> None:
        self._profile = tempfile.TemporaryDirectory(prefix="netlab-browser-", ignore_cleanup_errors=True)
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        # The protocol's descriptors are 3 (it reads) and 4 (it writes).
        script = f'exec 3<&{theirs_in} 4>&{theirs_out}; exec "$@"'
        command = ["bash", "-c", script, "bash", program, *_FLAGS, f"--user-data-dir={self._profile.name}"]
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(
            [*command, "about:blank"], pass_fds=(theirs_in, theirs_out), stdin=quiet, stdout=quiet, stderr=quiet
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._rest = b""
        self._number = 0
        self._session: str | None = None
        self.logged: list[str] = []
        self.requested: list[str] = []
        self.received = b""
        target = next(t for t in self._send("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self._send("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._send(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session = None
        with contextlib.suppress(OSError, EOFError):
            self._send("Browser.close")
        self._process.wait(_ANSWER_S)
        os.close(self._in)
        os.close(self._out)
        self._profile.cleanup()

    def show(self, page: Path | str, *, width: int, height: int = 900, dark: bool = False, scale: float = 1.0) -> None:
        """Open a file or a URL in a window of that many CSS pixels, light or dark, and wait until it is there."""
        self._send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=False
        )
        self.colours(dark=dark)
        self.logged, self.requested = [], []
        self._loaded = False
        self._send("Page.navigate", url=page if isinstance(page, str) else page.resolve().as_uri())
        deadline = time.monotonic() + _ANSWER_S
        while not self._loaded:
            self._event(deadline)
        self.ask("document.fonts.ready.then(() => 1)")

    def colours(self, *, dark: bool, media: str = "") -> None:
        """Prefer dark or light, on a screen or (``media="print"``) on paper."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._send("Emulation.setEmulatedMedia", media=media, features=[scheme])

    def blindness(self, kind: str) -> None:
        """See colours as by ``deuteranopia``, ``protanopia``, ``tritanopia`` or ``achromatopsia``; or ``none``."""
        self._send("Emulation.setEmulatedVisionDeficiency", type=kind)

    def ask(self, expression: str) -> Any:
        """The value of a JavaScript expression, a promise's when it is kept."""
        answer = self._send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise AssertionError(answer["exceptionDetails"])
        return answer["result"].get("value")

    def picture(self, target: Path, *, selector: str | None = None, whole: bool = True) -> None:
        """Save the page, or one element of it, as PNG."""
        clip = {}
        if selector is not None:
            box = self.ask(
                f"(() => {{ const b = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
                "return {x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height} })()"
            )
            clip = {"clip": {**box, "scale": 1}}
        shot = self._send("Page.captureScreenshot", format="png", captureBeyondViewport=whole, **clip)
        target.write_bytes(base64.b64decode(shot["data"]))

    def pdf(self, target: Path) -> None:
        """Print the page on A4."""
        size = {"paperWidth": 8.27, "paperHeight": 11.69}
        told = self._send("Page.printToPDF", preferCSSPageSize=True, printBackground=False, **size)
        target.write_bytes(base64.b64decode(told["data"]))

    def _send(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + _ANSWER_S
        while True:
            answer = self._event(deadline)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise AssertionError(f"{method}: {answer['error']}")
                return dict(answer["result"])

    def _event(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            if not select.select([self._in], [], [], max(deadline - time.monotonic(), 0.0))[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._in, 1 << 20)
            if not part:
                raise EOFError("the browser ended")
            self._rest += part
        line, _, self._rest = self._rest.partition(b"\0")
        event = dict(json.loads(line))
        self._note(event.get("method", ""), event.get("params", {}))
        return event

    def _note(self, method: str, told: dict[str, Any]) -> None:
        match method:
            case "Page.loadEventFired":
                self._loaded = True
            case "Runtime.consoleAPICalled":
                self.logged.append(str([argument.get("value") for argument in told["args"]]))
            case "Runtime.exceptionThrown":
                self.logged.append(str(told["exceptionDetails"]))
            case "Log.entryAdded":
                self.logged.append(told["entry"]["text"])
            case "Network.requestWillBeSent" if not told["request"]["url"].startswith("data:"):
                self.requested.append(told["request"]["url"])
            case "Network.webSocketCreated":
                self.requested.append(told["url"])
            case "Network.webSocketFrameReceived" if told["response"]["opcode"] == 2:
                self.received += base64.b64decode(told["response"]["payloadData"])


def main(argv: Sequence[str]) -> None:
    """``browser.py PAGE PICTURE [WIDTH] [dark]``: a picture of a whole page."""
    page, target, *rest = argv
    program = chromium()
    assert program is not None, "no chromium"
    with Browser(program) as browser:
        width = next((int(word) for word in rest if word.isdigit()), 1200)
        browser.show(Path(page), width=width, dark="dark" in rest)
        browser.picture(Path(target))
        print(browser.logged, browser.requested)


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
