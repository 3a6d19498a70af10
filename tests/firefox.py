"""Firefox for tests through its own WebDriver BiDi (w3c.github.io/webdriver-bidi), without other software."""

import asyncio
import json
import re
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from tornado.websocket import WebSocketClientConnection, websocket_connect

NAMES = ("firefox", "firefox-esr")
PATIENCE = 60.0
QUIET = {
    "app.normandy.enabled": False,
    "browser.newtabpage.enabled": False,
    "browser.startup.homepage_override.mstone": "ignore",
    "datareporting.policy.dataSubmissionEnabled": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "services.settings.server": "data:,",
    "toolkit.telemetry.enabled": False,
}


def binary() -> str | None:
    """Return the path of the installed Firefox, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Firefox:
    """One page in one Firefox: `heard` holds the console messages, `asked` the requested URLs."""

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.asked: list[str] = []
        self._number = 0
        self._socket: WebSocketClientConnection
        self._context = ""

    async def begin(self, folder: str) -> subprocess.Popen[str]:
        """Start Firefox with a fresh profile in `folder` and open a session."""
        result = binary()
        assert result is not None
        prefs = [f"user_pref({json.dumps(name)}, {json.dumps(value)});" for name, value in QUIET.items()]
        Path(folder, "user.js").write_text("\n".join(prefs))
        words = [
            result,
            "--headless",
            "--no-remote",
            "--profile",
            folder,
            "--remote-debugging-port",
            "0",
            "about:blank",
        ]
        process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        assert process.stderr is not None
        address = ""
        while not address:
            line = await asyncio.wait_for(asyncio.to_thread(process.stderr.readline), PATIENCE)
            assert line, "Firefox ended"
            match = re.search(r"WebDriver BiDi listening on (ws://\S+)", line)
            address = match[1] if match else ""
        # Firefox continues to write. The output has to be read so that its pipe does not fill up.
        self._rest = asyncio.create_task(asyncio.to_thread(process.stderr.read))
        self._socket = await websocket_connect(f"{address}/session", max_message_size=1 << 28)
        await self.call("session.new", capabilities={})
        await self.call("session.subscribe", events=["log.entryAdded", "network.beforeRequestSent"])
        tree = await self.call("browsingContext.getTree")
        self._context = tree["contexts"][0]["context"]
        return process

    async def call(self, method: str, **parameters: Any) -> Any:
        """Send a command and return its result. Record the events that arrive meanwhile."""
        self._number += 1
        await self._socket.write_message(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            text = await asyncio.wait_for(self._socket.read_message(), PATIENCE)
            assert text is not None, "Firefox went away"
            message = json.loads(text)
            if message.get("id") == self._number:
                assert message["type"] == "success", message
                return message["result"]
            if message.get("method") == "log.entryAdded":
                self.heard.append(str(message["params"]["text"]))
            if message.get("method") == "network.beforeRequestSent" and message["params"]["context"] == self._context:
                self.asked.append(message["params"]["request"]["url"])

    async def open(self, address: str, width: int = 1280) -> None:
        """Open a page and wait until it shows its first cell."""
        viewport = {"width": width, "height": 900}
        await self.call("browsingContext.setViewport", context=self._context, viewport=viewport)
        await self.call("browsingContext.navigate", context=self._context, url=address, wait="complete")
        await self.evaluate(
            "new Promise(done => { const look = () => document.querySelector('[data-ready]') ? done(1) "
            ": setTimeout(look, 20); look(); })"
        )

    async def evaluate(self, script: str) -> Any:
        """Return the value of an expression in the page, through JSON."""
        wrapped = f"Promise.resolve({script}).then(value => JSON.stringify(value) ?? 'null')"
        target = {"context": self._context}
        result = await self.call("script.evaluate", expression=wrapped, target=target, awaitPromise=True)
        assert result["type"] == "success", result
        return json.loads(result["result"]["value"])

    async def press(self, *keys: str) -> None:
        """Press keys one after another in the focused element."""
        actions = [{"type": kind, "value": key} for key in keys for kind in ("keyDown", "keyUp")]
        source = [{"type": "key", "id": "keyboard", "actions": actions}]
        await self.call("input.performActions", context=self._context, actions=source)

    async def click(self, x: float, y: float) -> None:
        """Click at a position in the window."""
        actions = [{"type": "pointerMove", "x": round(x), "y": round(y)}]
        actions += [{"type": kind, "button": 0} for kind in ("pointerDown", "pointerUp")]
        source = [{"type": "pointer", "id": "mouse", "actions": actions}]
        await self.call("input.performActions", context=self._context, actions=source)

    async def leave(self, process: subprocess.Popen[str]) -> None:
        """Close the connections to a process that has ended."""
        assert process.stderr is not None
        self._socket.close()
        await self._rest
        process.stderr.close()

    async def screenshot(self) -> str:
        """Return the whole page as PNG in base64."""
        shot = await self.call("browsingContext.captureScreenshot", context=self._context, origin="document")
        return str(shot["data"])


def in_firefox(work: Any) -> None:
    """Run the coroutine `work(firefox)` and close the browser, even after an error."""

    async def whole() -> None:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            firefox, process = Firefox(), None
            try:
                process = await firefox.begin(folder)
                await work(firefox)
            finally:
                if process is not None:
                    with suppress(Exception):
                        await firefox.call("browser.close")
                    process.terminate()
                    await asyncio.to_thread(process.wait, PATIENCE)
                    await firefox.leave(process)

    # In a separate thread, because playwright keeps an event loop running in the thread of the tests.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, whole()).result()
