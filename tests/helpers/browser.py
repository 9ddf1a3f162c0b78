"""Headless Chromium, driven by as much of WebDriver as tests and benchmarks need."""

import contextlib
import gzip
import json
import re
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-quic"),
    *("--no-proxy-server", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
]


_PATIENCE_S = 30.0
AXE = Path(__file__).resolve().parents[1] / "data" / "axe-core-4.14.1.min.js.gz"
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]


class Browser:
    def __init__(self, port: int, binary: str, profile: Path) -> None:
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        self._base = f"http://127.0.0.1:{port}/session"
        options = {"binary": binary, "args": [*_FLAGS, f"--user-data-dir={profile}"]}
        own = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        wanted = {"capabilities": {"alwaysMatch": own}}
        self._base += "/" + self.send("POST", "", wanted)["sessionId"]

    def send(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self._base + path, data, {"Content-Type": "application/json"}, method=method
        )
        with self._opener.open(request, timeout=60) as answer:
            return json.load(answer)["value"]

    def devtools(self, command: str, **parameters: Any) -> Any:
        return self.send("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def prefer(self, mode: str | None) -> None:
        features = [{"name": "prefers-color-scheme", "value": mode}] if mode else []
        self.devtools("Emulation.setEmulatedMedia", features=features)

    def violations(self) -> list[str]:
        source = gzip.decompress(AXE.read_bytes()).decode()
        self.devtools("Runtime.evaluate", expression=source)
        found: list[str] = self.ask(
            f"axe.run(document, {{runOnly: {RULES}}})"
            ".then(result => result.violations.map(one => "
            "`${one.impact} ${one.id}: ${one.nodes[0].html} (${one.nodes.length})`))"
        )
        return found

    def open(self, page: Path, fragment: str = "", width: int = 1200) -> None:
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self.devtools("Emulation.setDeviceMetricsOverride", **size)
        for address in ("about:blank", page.as_uri() + fragment):
            self.send("POST", "/url", {"url": address})
            self._wait_for(address.partition("#")[0])

    def _wait_for(self, address: str) -> None:
        """Wait until an address is loaded: on a busy machine, `/url` may return before."""
        shown = "[location.href.split('#')[0], document.readyState]"
        end = time.monotonic() + _PATIENCE_S
        while self.ask(shown) != [address, "complete"]:
            if time.monotonic() > end:
                raise TimeoutError(f"{address}: expected it to be loaded, got {self.ask(shown)}")
            time.sleep(0.02)

    def ask(self, script: str) -> Any:
        return self.send("POST", "/execute/sync", {"script": f"return {script};", "args": []})

    def _find(self, path: str) -> str:
        found = self.send("POST", "/element", {"using": "xpath", "value": path})
        return str(next(iter(found.values())))

    def count(self, selector: str) -> int:
        return int(self.ask(f"document.querySelectorAll('{selector}').length"))

    def texts(self, selector: str) -> list[str]:
        found = f"[...document.querySelectorAll('{selector}')].map(one => one.textContent)"
        return list(self.ask(found))

    def press(self, path: str, key: str | None = None) -> None:
        element = f"/element/{self._find(path)}"
        if key is None:
            self.send("POST", f"{element}/click", {})
        else:
            self.send("POST", f"{element}/value", {"text": key})

    def follow(self, path: str) -> None:
        """Press a link to a view of the page: the click returns before the page has moved."""
        moved = "new Promise(done => addEventListener('hashchange', done, { once: true }))"
        self.ask(f"void (window.moved = {moved})")
        self.press(path)
        self.ask("window.moved.then(() => true)")

    def hover(self, path: str) -> None:
        target = {"element-6066-11e4-a52e-4f735466cecf": self._find(path)}
        move = {"type": "pointerMove", "duration": 0, "x": 0, "y": 0, "origin": target}
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}}
        self.send("POST", "/actions", {"actions": [mouse | {"actions": [move]}]})

    def wait(self, script: str) -> None:
        look = (
            f"const look = () => ({script}) ? done() : left-- ? requestAnimationFrame(look) : "
            "fail(new Error('never so'));"
        )
        self.ask(f"new Promise((done, fail) => {{ let left = 600; {look} look(); }})")

    def complaints(self) -> list[str]:
        return [entry["message"] for entry in self.send("POST", "/se/log", {"type": "browser"})]

    def close(self) -> None:
        self.send("DELETE", "")


@contextlib.contextmanager
def _driver(program: str) -> Iterator[int]:
    """A chromedriver on a free port; it is gone when the block ends."""
    with subprocess.Popen(
        [program, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            started = (
                re.search(r"started successfully on port (\d+)", line) for line in process.stdout
            )
            yield next(int(match[1]) for match in started if match)
        finally:
            process.terminate()


@contextlib.contextmanager
def chromium() -> Iterator[Browser | None]:
    binary, program = shutil.which("chromium"), shutil.which("chromedriver")
    if binary is None or program is None:
        yield None
        return
    with contextlib.ExitStack() as stack:
        profile = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        port = stack.enter_context(_driver(program))
        yield stack.enter_context(contextlib.closing(Browser(port, binary, Path(profile))))
