"""A headless Chromium that shows the page: its tabs, and what can be seen in them."""

import base64
import contextlib
import io
import json
import re
import shutil
import subprocess
import time
import urllib.request

import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--disable-extensions",
    "--remote-debugging-port=0",
    "--window-size=1600,900",
    "about:blank",
)
CHEAP = ("--disable-gpu-compositing", "--webgl-antialiasing-mode=none")
"""For tests: pictures whose edges are not smoothed, at a fraction of the processor time."""
PATIENCE_S = 150.0
WIDTH = 960
HEIGHT = 480
"""Small: Chromium renders in software, which costs by the pixel."""


PICTURE_MS = 600
"""Between pictures; a viewer of more than two a second changes how coarse they are."""
SLOW_DISPLAY = f"""(() => {{
    const request = window.requestAnimationFrame.bind(window);
    let asked = new Map();
    let count = 0;
    const draw = time => {{
        const due = asked;
        asked = new Map();
        for (const callback of due.values()) callback(time);
    }};
    window.requestAnimationFrame = callback => {{
        if (asked.size === 0) setTimeout(() => request(draw), {PICTURE_MS});
        asked.set(++count, callback);
        return count;
    }};
    window.cancelAnimationFrame = handle => asked.delete(handle);
}})()"""
"""As on a slow display: Chromium, which renders in software, would keep a processor busy with
pictures that nobody looks at.
"""


PICTURES = """new Promise(done => {
    let left = %d;
    const draw = () => left-- > 0 ? requestAnimationFrame(draw) : done(true);
    draw();
})"""
BUTTON = "[...document.querySelectorAll('button')].find(b => b.textContent.trim() === '%s')"


class Tab:
    """One tab of a headless Chromium, driven through the DevTools protocol."""

    def __init__(self, address, *, cheap=True):
        self._socket = connect(address, max_size=None)
        self._count = 0
        if cheap:
            self.call("Page.enable")
            self.call("Page.addScriptToEvaluateOnNewDocument", source=SLOW_DISPLAY)
        self.resize(WIDTH, HEIGHT)

    def resize(self, width, height):
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 500,
        )

    def call(self, method, **parameters):
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=120))
            if answer.get("id") == self._count:
                return answer["result"]

    def evaluate(self, script):
        answer = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        return answer["result"].get("value")

    def wait_for(self, script, what, timeout_s=PATIENCE_S):
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            value = self.evaluate(script)
            if value:
                return value
            time.sleep(0.1)
        shown = "[...document.querySelectorAll('.cablesense')].map(e => e.innerText).join('\\n')"
        return pytest.fail(f"the page never showed {what}; it shows:\n{self.evaluate(shown)}")

    def has_button(self, label):
        return self.evaluate(f"!!{BUTTON % label}")

    def click_button(self, label):
        assert self.has_button(label), f"no button {label!r}"
        self.evaluate(f"{BUTTON % label}.click()")

    def press(self, slider, key, pictures=0):
        """A key on a slider, found by its label: a busy page leaves some of many out."""
        focused = self.evaluate(
            "(() => { const label = [...document.querySelectorAll('label')]"
            f".find(l => l.textContent.trim() === {slider!r}); let at = label;"
            " while (at && !at.querySelector('[role=slider]')) at = at.parentElement;"
            " if (at) at.querySelector('[role=slider]').focus(); return !!at; })()"
        )
        assert focused, f"no slider {slider!r}"
        self.hold(key, pictures)

    def hold(self, key, pictures):
        """A key, wherever the focus is, until the page has drawn."""
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=key)
        self.wait_for_pictures(pictures)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, code=key)

    def wait_for_pictures(self, count=3):
        """Until the page has drawn: what came before the first of them is in the last."""
        assert self.evaluate(PICTURES % count)

    def mouse(self, kind, x, y, *, held=True):
        """Move, press or release the left button at a point of the page, px."""
        button = {"button": "left" if held else "none", "buttons": int(held), "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)

    def screenshot(self):
        return base64.b64decode(self.call("Page.captureScreenshot", optimizeForSpeed=True)["data"])

    def close(self):
        with contextlib.suppress(Exception):
            self.call("Page.close")
        self._socket.close()


class Browser(Tab):
    """A headless Chromium, and its first tab; a picture for people is not to be `cheap`."""

    def __init__(self, program, profile, *, cheap=True):
        flags = (*CHEAP, *FLAGS) if cheap else FLAGS
        self._process = subprocess.Popen(
            [program, f"--user-data-dir={profile}", *flags],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        lines = []
        for line in self._process.stderr:
            lines.append(line)
            address = re.search(r"DevTools listening on ws://([^/]+)/", line)
            if address:
                break
        else:
            pytest.fail(f"{program} did not start: {''.join(lines)[-500:]}")
        self._tabs = f"http://{address[1]}/json"
        with urllib.request.urlopen(self._tabs) as answer:
            tabs = json.load(answer)
        page = next(tab for tab in tabs if tab["type"] == "page")
        super().__init__(page["webSocketDebuggerUrl"], cheap=cheap)

    def new_tab(self, url):
        """Another tab, that shows a page."""
        request = urllib.request.Request(f"{self._tabs}/new?{url}", method="PUT")
        with urllib.request.urlopen(request) as answer:
            return Tab(json.load(answer)["webSocketDebuggerUrl"])

    def close(self):
        super().close()
        self._process.terminate()
        self._process.wait(10)
        self._process.stderr.close()


def chromium():
    """The program; skips where this machine has none."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"no Chromium on PATH ({', '.join(BROWSERS)}); install one to test the page")
    return program


STATUS = "document.querySelector('#cablesense-status').innerText"
WITHOUT_NOTICES = (
    "document.head.append(Object.assign(document.createElement('style'),"
    " {textContent: '.mantine-Notifications-root { display: none }'}))"
)
"""The viewer's notice of slow rendering lies above the arm on a busy machine."""


SCENE_RECT = (
    "(() => { const r = [...document.querySelectorAll('canvas')]"
    ".map(c => c.getBoundingClientRect()).sort((a, b) => b.height - a.height)[0];"
    " return [r.left, r.top, r.width, r.height]; })()"
)
SLIDER_VALUE = "document.activeElement.getAttribute('aria-valuenow')"
CUT_OFF = "[...document.querySelectorAll('.cablesense')].some(e => e.scrollWidth > e.clientWidth)"


def cells(browser, row):
    script = f"document.querySelector('#cablesense-{row}')?.innerText"
    return (browser.evaluate(script) or "").split("\t")[1:]


def canvas_pixels(browser):
    """Pixels (H, W, 3) of the middle of the page, where the panels do not reach."""
    image = np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"))
    return image[HEIGHT // 5 : -HEIGHT // 8, WIDTH // 3 : -WIDTH // 4].astype(int)


def eventually(found, accept, what, timeout_s=PATIENCE_S):
    """What is found, once it is accepted."""
    until = time.monotonic() + timeout_s
    while not accept(last := found()):
        assert time.monotonic() < until, f"{what}: {last}"
        time.sleep(0.1)
    return last


def wait_for_cells(browser, row, accept):
    return eventually(lambda: cells(browser, row), accept, f"row {row}")


def drawn(pixels):
    """Whether the arm is on the canvas: many colours, not one ground."""
    return len(np.unique(pixels.reshape(-1, 3), axis=0)) > 500 and pixels.std() > 10.0


def is_orange(pixels):
    """Where the true force is drawn."""
    return (pixels[..., 0] > 150) & (pixels[..., 2] < 60)


def arrow_px(browser):
    """The column of the true force's arrow, some pixels off where the estimate's covers it.

    NaN until it is drawn.
    """
    columns = np.argwhere(is_orange(canvas_pixels(browser)))[:, 1]
    return columns.mean() if len(columns) > 50 else np.nan
