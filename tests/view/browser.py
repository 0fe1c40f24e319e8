"""A browser without a screen for tests of pages: Chromium, told what to do by its DevTools protocol."""

import base64
import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 60.0  # s: a loaded machine draws slowly
POLL = 0.05  # s
SIZE = (700, 520)  # pixels of a page
COARSE = 0.25  # of them so many are drawn each way: a processor does it
SELDOM = (
    "requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 250);"
    "cancelAnimationFrame = clearTimeout;"
)
"""Pages draw four pictures in a second at most, also in windows behind others."""
QUIET = (
    *("--no-first-run", "--no-default-browser-check", "--disable-extensions", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--disable-default-apps"),
    *("--disable-background-timer-throttling", "--disable-renderer-backgrounding"),
    *("--disable-backgrounding-occluded-windows", "--mute-audio", "--password-store=basic"),
)
MOUSE = {"button": "left", "buttons": 1, "clickCount": 1}


def find_browser():
    """Where the browser is, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """A running browser.

    Attributes:
        pages: Its pages.
    """

    def __init__(self, binary, folder):
        self.pages = []
        self._process = subprocess.Popen(
            [
                *(binary, "--headless=new", "--no-sandbox", "--remote-debugging-port=0"),
                *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"),
                # A loaded processor compiles shaders for longer than the watchdog waits.
                "--disable-gpu-watchdog",
                *(f"--window-size={SIZE[0]},{SIZE[1]}", f"--user-data-dir={folder}", *QUIET, "about:blank"),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._port = self._wait_for_port(Path(folder) / "DevToolsActivePort")
        with urllib.request.urlopen(
            f"http://127.0.0.1:{self._port}/json/version", timeout=PATIENCE
        ) as answer:
            self._session = Session(json.load(answer)["webSocketDebuggerUrl"])

    def _wait_for_port(self, file):
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline and self._process.poll() is None:
            with contextlib.suppress(OSError, IndexError):
                return int(file.read_text().split()[0])
            time.sleep(POLL)
        self.close()
        raise TimeoutError("the browser does not start")

    def open(self, url):
        """A page in a window of its own."""
        target = self._session.call("Target.createTarget", url="about:blank", newWindow=True)["targetId"]
        self.pages.append(Page(f"ws://127.0.0.1:{self._port}/devtools/page/{target}", url))
        return self.pages[-1]

    def close(self):
        """End it, and all that it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait(PATIENCE)


class Session:
    """A connection to the browser or to a page of it.

    Attributes:
        patience: So long it waits for an answer [s].
    """

    patience = PATIENCE

    def __init__(self, address):
        self._socket = connect(address, max_size=None, compression=None, ping_interval=None)
        self._numbers = itertools.count(1)

    def call(self, method, **params):
        """Do something and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv(timeout=self.patience))
            if message.get("id") == number:
                assert "error" not in message, (method, message)
                return message["result"]
            self.heard(message.get("method"), message.get("params", {}))

    def heard(self, event, params):
        """Something has happened."""

    def close(self):
        """Hang up."""
        self._socket.close()


class Page(Session):
    """An open page.

    Attributes:
        errors: What it has complained of.
        hosts: Who it has asked for anything.
    """

    def __init__(self, address, url):
        super().__init__(address)
        self.errors, self.hosts = [], set()
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(*SIZE)
        self.call("Page.addScriptToEvaluateOnNewDocument", source=SELDOM)
        self.call("Page.navigate", url=url)

    def heard(self, event, params):
        if event == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif event == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(arg.get("value", arg)) for arg in params["args"]))
        elif event == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        elif event in ("Network.requestWillBeSent", "Network.webSocketCreated"):
            parts = urlsplit(params["url"] if "url" in params else params["request"]["url"])
            if parts.scheme not in ("data", "blob", "about"):
                self.hosts.add(parts.netloc)

    def js(self, expression):
        """The value of an expression in the page."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait(self, condition):
        """Wait until an expression, or what a function returns, is true; return it."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            value = self.js(condition) if isinstance(condition, str) else condition()
            if value:
                return value
            time.sleep(POLL)
        raise AssertionError(f"in vain: {condition}; the page says: {self.text()[-1500:]}; {self.errors}")

    def text(self):
        """What stands on it."""
        return self.js("document.body?.innerText ?? ''")

    def wait_for_text(self, text, *, there=True):
        """Wait until a text stands on it, or does no more."""
        self.wait(lambda: (text in self.text()) == there)

    def find(self, selector, text="", then=""):
        """Wait for the first visible element of a selector with that text, and do something with it, `e`."""
        return self.wait(
            f"(() => {{ for (const e of document.querySelectorAll({json.dumps(selector)})) {{"
            f" if ({json.dumps(text)} && e.textContent.trim() !== {json.dumps(text)}) continue;"
            f" if (!e.getClientRects().length) continue; {then}; return true; }} }})()"
        )

    def place(self, selector):
        """Where the middle of a visible element is [pixels], once it is in sight."""
        self.find(selector, then="e.scrollIntoView({block: 'center'})")
        return self.js(
            f"(() => {{ const r = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
            " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )

    def press(self, place):
        """Press the mouse's button down somewhere [pixels]."""
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=place[0], y=place[1], **MOUSE)

    def release(self, place):
        """Let the mouse's button go."""
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=place[0], y=place[1], **MOUSE)

    def click(self, selector, text):
        """Click the first visible element of a selector with a text."""
        self.find(selector, text, "e.click()")

    def tick(self, label):
        """Click what a label is for."""
        self.find("label", label, "document.getElementById(e.htmlFor).click()")

    def choose(self, label, option):
        """Choose from a list as soon as that is in it."""
        click = (
            "(() => { for (const e of document.querySelectorAll('[role=option]'))"
            f" if (e.textContent === {json.dumps(option)}) {{ e.click(); return true; }} }})()"
        )

        def chosen():
            self.tick(label)
            deadline = time.monotonic() + 1.0
            while time.monotonic() < deadline:
                if self.js(click):
                    return True
                time.sleep(POLL)
            return False

        self.wait(chosen)

    def key(self, code, down=True):
        """Press or release a key."""
        key = code.removeprefix("Key").lower() if code.startswith("Key") else code
        self.call("Input.dispatchKeyEvent", type="keyDown" if down else "keyUp", code=code, key=key)

    def unfold(self, title, inside):
        """Open a folder, unless what is inside can be seen."""
        if inside not in self.text():
            self.click("div", title)
            self.wait_for_text(inside)

    def resize(self, width, height, *, mobile=False):
        """Give it another size [pixels]."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": COARSE, "mobile": mobile}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)
        self.call("Emulation.setTouchEmulationEnabled", enabled=mobile)

    def leave(self):
        """Close its window."""
        self.call("Page.close")
        self.close()

    def screenshot(self, file):
        """Keep what it looks like."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        Path(file).write_bytes(base64.b64decode(data))
