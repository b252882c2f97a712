"""A browser without a window, driven through a pipe: Chromium, where there is one.

It needs no library: commands and answers of the DevTools protocol are JSON that ends with a zero byte, and go
through the file descriptors 3 and 4 (`--remote-debugging-pipe`).
"""

import contextlib
import json
import os
import select
import shutil
import subprocess
import time

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-quic", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars"),
)
SECONDS = 60  # to wait for anything, at most


class Browser:
    """A page in a browser.

    Attributes:
        messages: what was written to its console, and errors that nobody caught.
        requests: the addresses that it asked for.
    """

    def __init__(self, profile, width=1200, height=900):
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        arguments = [
            CHROMIUM,
            *OPTIONS,
            f"--user-data-dir={profile}",
            "--remote-debugging-pipe",
            "about:blank",
        ]
        shell = f'exec "$@" 3<&{to_read} 4>&{to_write}'
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "bash", *arguments],
            pass_fds=(to_read, to_write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_read), os.close(to_write)
        self._rest, self._number, self._session = b"", 0, None
        self.messages, self.requests = [], []
        targets = self._ask("Target.getTargets")["targetInfos"]
        target = next(x["targetId"] for x in targets if x["type"] == "page")
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._ask(f"{domain}.enable")
        self.resize(width, height)

    def resize(self, width, height=900, *, phone=False):
        """The size of the window; a phone has no mouse."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone}
        self._ask("Emulation.setDeviceMetricsOverride", **size)
        self._ask("Emulation.setTouchEmulationEnabled", enabled=phone)

    def media(self, kind="screen", colours="light"):
        """ "print" or "screen", and whether the system is "light" or "dark"."""
        features = [{"name": "prefers-color-scheme", "value": colours}]
        self._ask("Emulation.setEmulatedMedia", media=kind, features=features)

    def read_out(self):
        """What a screen reader finds: (role, name, description) of each node that is not ignored."""
        self._ask("Accessibility.enable")
        nodes = self._ask("Accessibility.getFullAXTree")["nodes"]
        self._ask("Accessibility.disable")
        parts = ("role", "name", "description")
        return [
            tuple(node.get(part, {}).get("value", "") for part in parts)
            for node in nodes
            if not node["ignored"]
        ]

    def scripts(self, on):
        self._ask("Emulation.setScriptExecutionDisabled", value=not on)

    def open(self, file, address=""):
        self._ask("Page.navigate", url="about:blank")  # else a new address in the same file loads nothing
        self.requests.clear()
        self._ask("Page.navigate", url=f"file://{file}{address}")

    def __call__(self, expression):
        """What an expression of JavaScript is, as JSON has it. `$` and `$$` find elements, the first and all."""
        how = {"returnByValue": True, "awaitPromise": True, "includeCommandLineAPI": True}
        answer = self._ask("Runtime.evaluate", expression=expression, **how)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, expression):
        """Waits until an expression is true."""
        end = time.monotonic() + SECONDS
        while not (value := self(expression)):
            assert time.monotonic() < end, f"never: {expression}; {self.messages}"
            time.sleep(0.02)
        return value

    def key(self, key, text=""):
        for kind in ("keyDown", "keyUp"):
            code = {
                "ArrowLeft": 37,
                "ArrowUp": 38,
                "ArrowRight": 39,
                "ArrowDown": 40,
                "Home": 36,
                "End": 35,
                "Tab": 9,
            }
            more = {"windowsVirtualKeyCode": code.get(key, 13 if key == "Enter" else 0)}
            self._ask(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                text=text if kind == "keyDown" else "",
                **more,
            )

    def drag(self, *places):
        """Presses the mouse at the first place (x, y), and lets it go at the last."""
        kinds = ["mousePressed", *["mouseMoved"] * (len(places) - 1), "mouseReleased"]
        for kind, (x, y) in zip(kinds, [*places, places[-1]], strict=True):
            self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def tap(self, x, y):
        """A touch of the screen at a place."""
        self._ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        self._ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def close(self):
        with contextlib.suppress(OSError):
            self._ask("Browser.close")
        os.close(self._write), os.close(self._read)
        self._process.wait(SECONDS)

    def _ask(self, method, **params):
        self._number += 1
        command = {"id": self._number, "method": method, "params": params}
        if self._session:
            command["sessionId"] = self._session
        os.write(self._write, json.dumps(command).encode() + b"\0")
        while True:
            message = self._next()
            if message.get("id") == self._number:
                assert "error" not in message, (method, message["error"])
                return message["result"]
            self._note(message)

    def _note(self, message):
        params = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"])
            case "Runtime.exceptionThrown":
                self.messages.append(
                    params["exceptionDetails"].get("exception", {}).get("description", "an error")
                )
            case "Runtime.consoleAPICalled":
                self.messages.append(str([x.get("value", x.get("description")) for x in params["args"]]))
            case "Log.entryAdded":
                self.messages.append(params["entry"]["text"])

    def _next(self):
        while b"\0" not in self._rest:
            assert select.select([self._read], [], [], SECONDS)[0], "the browser does not answer"
            more = os.read(self._read, 2**20)
            assert more, "the browser has ended"
            self._rest += more
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)
