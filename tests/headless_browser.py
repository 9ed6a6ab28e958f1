"""The console in a Chromium without a window: real key events and screenshots, for tests, benchmark and pictures."""

import base64
import contextlib
import itertools
import json
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
KEYS = {"ArrowUp": 38, "ArrowDown": 40, "ArrowLeft": 37, "ArrowRight": 39, "Shift": 16, " ": 32,
        "a": 65, "c": 67, "d": 68, "f": 70, "m": 77, "p": 80, "r": 82, "s": 83, "w": 87}  # fmt: skip
_PAUSE, _PATIENCE = 0.03, 30  # s between two looks, and until it is given up
_SHOWN = "window.consoleStatistics?.frame && {...consoleStatistics.frame, wire: 0, catheter: 0, pictures: 0}"


class BrowserError(RuntimeError):
    """The browser cannot be started, or does not do as asked."""


def find_browser() -> str | None:
    """A Chromium on this machine, or None."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


def wait_until(condition: Callable[[], Any]) -> Any:
    """Waits for a condition, which it asks again and again; returns its value, which is true.

    Raises:
        TimeoutError: it stayed false for half a minute, which a machine under load does not take either.
    """
    end = time.monotonic() + _PATIENCE
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError(f"waited {_PATIENCE} s in vain")
        time.sleep(_PAUSE)
    return value


@contextlib.contextmanager
def running_console(*arguments: str) -> Iterator[str]:
    """A console in a process of its own, at a free port, without the expert's scores.

    Args:
        arguments: of its command line.

    Yields:
        Its address.

    Raises:
        BrowserError: it did not start.
    """
    command = [sys.executable, "-m", "cathsim.console", "--port", "0", "--no-expert", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline() if process.stdout else ""
        found = re.search(r"http://\S+", line)
        if not found:
            raise BrowserError(f"the console did not start; it said {line!r}")
        yield found.group()
    finally:
        process.terminate()
        process.wait(20)


class Tab:
    """A page in a headless Chromium, steered through its debugging protocol; a context manager.

    Args:
        profile: an empty folder for the browser's files.

    Raises:
        BrowserError: there is no Chromium.
    """

    def __init__(self, profile: Path) -> None:
        from websockets.sync.client import connect

        browser = find_browser()
        if browser is None:
            raise BrowserError("no Chromium is installed (Debian: apt install chromium)")
        self._process = subprocess.Popen(
            [browser, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run",
             "--disable-background-networking", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
             "--hide-scrollbars", "--window-size=1440,900", "--remote-debugging-port=0",
             f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._open = contextlib.ExitStack()
        self._open.callback(self._end)
        try:
            port_file = profile / "DevToolsActivePort"
            wait_until(lambda: port_file.is_file() and "\n" in port_file.read_text())
            port = port_file.read_text().splitlines()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=10) as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            socket = connect(pages[0]["webSocketDebuggerUrl"], max_size=None, open_timeout=20)
            self._socket = self._open.enter_context(socket)
        except BaseException:
            self._open.close()
            raise
        self._numbers = itertools.count(1)

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(10)

    def __enter__(self) -> "Tab":
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Calls a method of the debugging protocol.

        Args:
            method: its name, e.g. "Page.navigate".
            parameters: its arguments.

        Returns:
            Its result.

        Raises:
            BrowserError: the browser refuses.
        """
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=30))
            if answer.get("id") == number:
                break
        if "error" in answer:
            raise BrowserError(f"{method}: {answer['error'].get('message')}")
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, address: str) -> None:
        """Opens a console and waits for its pictures.

        Args:
            address: as the console printed it.
        """
        self.call("Page.navigate", url=address)
        wait_until(lambda: self.value("window.consoleStatistics?.drawn > 5"))

    def value(self, expression: str) -> Any:
        """Evaluates JavaScript in the page.

        Args:
            expression: whose value JSON can hold.

        Returns:
            Its value.

        Raises:
            BrowserError: it threw.
        """
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise BrowserError(f"{expression}: {answer['exceptionDetails']['exception'].get('description')}")
        return answer["result"].get("value")

    def key(self, name: str, *, down: bool) -> None:
        """Presses or releases a key.

        Args:
            name: one of `KEYS`.
            down: pressed.
        """
        letter = f"Key{name.upper()}" if len(name) == 1 else name
        code = {"Shift": "ShiftLeft", " ": "Space"}.get(name, letter)
        kind = "rawKeyDown" if down else "keyUp"
        self.call("Input.dispatchKeyEvent", type=kind, key=name, code=code, windowsVirtualKeyCode=KEYS[name])

    def phone(self, width: int, height: int) -> None:
        """Makes the page that of a phone with a touch screen.

        Args:
            width, height: of the screen, px.
        """
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=2, mobile=True)
        self.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=5)

    def desktop(self) -> None:
        """Makes the page that of a desktop again."""
        self.call("Emulation.clearDeviceMetricsOverride")
        self.call("Emulation.setTouchEmulationEnabled", enabled=False)

    def touch(self, *selectors: str) -> None:
        """Puts a finger on each of some elements, and lifts all others.

        Args:
            selectors: of the elements; none lifts every finger.
        """
        places = [
            self.value(
                f"(() => {{ const box = document.querySelector({json.dumps(one)}).getBoundingClientRect();"
                " return [box.x + box.width / 2, box.y + box.height / 2]; })()"
            )
            for one in selectors
        ]
        points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
        self.call("Input.dispatchTouchEvent", type="touchStart" if points else "touchEnd", touchPoints=points)

    def drag(self, selector: str, by: tuple[float, float]) -> None:
        """Drags with the left mouse button from an element's middle.

        Args:
            selector: of the element.
            by: px to the right and down.
        """
        x, y = self.value(
            f"(() => {{ const box = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
            " return [box.x + box.width / 2, box.y + box.height / 2]; })()"
        )
        pressed = {"button": "left", "buttons": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, clickCount=1, **pressed)
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + by[0], y=y + by[1], **pressed)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=x + by[0], y=y + by[1], button="left")

    def frame(self) -> dict[str, Any]:
        """The numbers of the picture on the screen."""
        return self.value(_SHOWN) or {"state": "", "insertion_mm": 0.0, "step": 0}

    def screenshot(self, file: Path) -> None:
        """Writes what the page looks like.

        Args:
            file: the PNG.
        """
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
