"""A headless Chromium with one page, driven by its DevTools protocol."""

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Any

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
"""Path of the browser; empty where there is none."""
_OPTIONS = ("--headless=new", "--no-sandbox", "--no-first-run", "--remote-debugging-port=0", "--window-size=1200,800")
_GRAPHICS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_START_S = 60.0
_FIND = """(() => {
  const fits = [...document.querySelectorAll(%s)].filter((each) => %s);
  if (!fits.length) return null;
  const box = fits[0].getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2];
})()"""


class Browser:
    """A browser with one page.

    Args:
        folder: Empty folder for the browser's own files.
        address: Page to open.
    """

    def __init__(self, folder: Path, address: str) -> None:
        from websockets.sync.client import connect

        self._process = subprocess.Popen(
            [CHROMIUM, *_OPTIONS, *_GRAPHICS, f"--user-data-dir={folder}", address],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        file, deadline = folder / "DevToolsActivePort", time.monotonic() + _START_S
        while not file.exists() or not file.read_text():
            assert self._process.poll() is None, "the browser has ended"
            assert time.monotonic() < deadline, "the browser does not start"
            time.sleep(0.1)
        port = file.read_text().splitlines()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=_START_S) as answer:
            (target,) = (each for each in json.load(answer) if each["type"] == "page")
        self._socket = connect(target["webSocketDebuggerUrl"], max_size=None, compression=None)
        self._number = 0

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        self._process.wait(30.0)

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        return self._call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def text(self) -> str:
        """Return the text of the page."""
        return str(self.evaluate("document.body.innerText"))

    def wait_for(self, words: str, timeout: float = 60.0) -> None:
        """Wait until the page has some words."""
        deadline = time.monotonic() + timeout
        while words not in (text := self.text()):
            assert time.monotonic() < deadline, text
            time.sleep(0.2)

    def find(self, kind: str, test: str, timeout: float = 30.0) -> tuple[float, float]:
        """Return the middle of the first element of a CSS selector that fits a JavaScript test of `each` [pixels]."""
        deadline = time.monotonic() + timeout
        while (place := self.evaluate(_FIND % (json.dumps(kind), test))) is None:
            assert time.monotonic() < deadline, f"no {kind} with {test}"
            time.sleep(0.2)
        return place[0], place[1]

    def press(self, label: str) -> None:
        """Click the button with a label."""
        self.click(*self.find("button", f"each.innerText.trim() === {json.dumps(label)}"))

    def fill(self, label: str, text: str) -> None:
        """Replace the text of the field with a label."""
        named = f"each.closest('.mantine-Flex-root')?.innerText.trim() === {json.dumps(label)}"
        self.click(*self.find("input", named))
        self.evaluate("document.activeElement.select()")
        self._call("Input.insertText", text=text)

    def click(self, x: float, y: float) -> None:
        """Click a point [pixels]."""
        self._call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
            time.sleep(0.05)

    def screenshot(self, file: Path) -> None:
        """Write a picture of the page, as PNG."""
        file.write_bytes(base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"]))

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv(_START_S))).get("id") != self._number:
            pass
        assert "error" not in answer, answer
        return dict(answer["result"])


def send_as_intruder(address: str, *buttons: str) -> None:
    """Visit the page without a browser, and send what no button of this visitor sends.

    Args:
        address: Address of the page.
        buttons: Identifiers of other visitors' buttons, which are pressed.
    """
    import msgspec
    from viser import __version__
    from websockets.sync.client import connect

    camera = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 3.0), "fov": 1.0, "near": 0.1, "far": 10.0}
    camera |= {"image_height": 600, "image_width": 800, "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0)}
    click = {"event_type": "click", "ray_origin": (1.0, 0.5, 3.0), "ray_direction": (0.0, 0.0, -1.0)}
    messages: list[dict[str, object]] = [
        {"type": "ViewerCameraMessage", **camera},
        *({"type": "GuiUpdateMessage", "uuid": each, "updates": {"value": True}} for each in buttons),
        {"type": "ScenePointerMessage", **click, "screen_pos": ((0.5, 0.5),), "modifier": None},
        {"type": "ShareUrlRequest"},
        {"type": "nonsense"},
    ]
    protocol: Any = f"viser-v{__version__}"
    with connect(address.replace("http", "ws"), subprotocols=[protocol]) as socket:
        for message in messages:
            socket.send(msgspec.msgpack.encode(message))
        time.sleep(1.0)
