"""Frames a second of `sabench view` in a headless Chromium.

`python -m benchmarks.view [particles ...]` prints JSON; it needs chromium and chromedriver.

A page with 25 cameras and made up particles of all kinds in one frame is turned in space for five
seconds, with all frusta, the wall and the light. `gl` names the renderer: without a graphics card
it is software. More than 200,000 particles are thinned. `cpu_ms` is the CPU time of a frame, of all
processes of the browser: on a busy machine it tells more than the frames a second.
"""

import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from sabench.apps.viewer.contents import Frame, PageContents, of_scene
from sabench.apps.viewer.points import ObjectCloud
from sabench.apps.viewer.view import render_contents
from sabench.plotting.kinds import KINDS
from sabench.scenes import Scene, load_scene
from tests.helpers.browser import Browser, chromium

_COUNTS, _SECONDS = (20_000, 200_000, 2_000_000), 5
_SHARES = (0.4, 0.4, 0.05, 0.1, 0.05)  # of the kinds
_TURN = f"""new Promise(done => {{
  const {{ space, state, changed }} = sabenchView;
  state.frusta = "all"; changed("rig");
  const times = [], start = performance.now();
  const step = now => {{
    times.push(now);
    space.camera.position.sub(space.controls.target).applyAxisAngle(space.camera.up, .02)
      .add(space.controls.target);
    space.camera.lookAt(space.controls.target);
    if (space.software) space.hurry(); else space.invalidate();
    if (performance.now() - start < {_SECONDS}e3) requestAnimationFrame(step);
    else done(times);
  }};
  requestAnimationFrame(step);
}})"""
_GL = """(() => { const gl = sabenchView.space.renderer.getContext();
  return gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL);
})()"""


def rig_of_25() -> Scene:
    """Make the standard scene with 5 x 5 cameras."""
    scene = load_scene("standard-particles").to_dict()
    scene["cameras"]["layout"] = {
        "kind": "grid",
        "columns": 5,
        "rows": 5,
        "spacing_mm": [60.0, 60.0],
    }
    return Scene.model_validate(scene)


def made_up(count: int) -> PageContents:
    """Make contents of particles of all kinds at random places of the volume."""
    rng, contents = np.random.default_rng(1), of_scene(rig_of_25(), "made up")
    around = contents.surroundings
    position = rng.uniform(around.low_mm, around.high_mm, (count, 3))
    kind = rng.choice(len(KINDS), count, p=_SHARES).astype(np.uint8)
    cloud = ObjectCloud.of_kind(position, kind, velocity_mm_s=rng.normal(0.0, 10.0, (count, 3)))
    nothing = ObjectCloud.of_kind(np.zeros((0, 3)), 0)
    labels = {name: name for name in KINDS}
    return replace(contents, frames=(Frame(0, 0.0, cloud, nothing),), labels=labels)


def in_browser(browser: Browser, file: Path) -> dict[str, Any]:
    """Measure frames a second of turning the page's drawing."""
    start = time.perf_counter()
    browser.open(file, width=1400)
    browser.wait("document.documentElement.dataset.ready")
    ready = time.perf_counter() - start
    before = _cpu_seconds()
    times = np.diff(browser.ask(_TURN))
    used = _cpu_seconds() - before
    return {
        "ready_s": round(ready, 2),
        "frames_per_s": round(1e3 / float(times.mean()), 1),
        "cpu_ms": round(1e3 * used / len(times), 1),
        "slowest_20th_ms": round(float(np.percentile(times, 95.0)), 1),
        "gl": browser.ask(_GL),
    }


def _cpu_seconds() -> float:
    """Sum the CPU time of all child processes, the browser's."""
    times = [one.cpu_times() for one in psutil.Process().children(recursive=True)]
    return float(sum(one.user + one.system for one in times))


def main() -> None:
    """Print one line for every number of particles."""
    counts = [int(word) for word in sys.argv[1:]] or list(_COUNTS)
    with chromium() as browser, tempfile.TemporaryDirectory() as folder:
        for count in counts:
            start = time.perf_counter()
            html, notes = render_contents(made_up(count))
            file = Path(folder) / "view.html"
            file.write_text(html, encoding="utf-8")
            made: dict[str, Any] = {
                "particles": count,
                "built_s": round(time.perf_counter() - start, 2),
            }
            made |= {"page_mb": round(len(html) / 1e6, 2), "notes": notes}
            print(json.dumps(made | (in_browser(browser, file) if browser else {})), flush=True)


if __name__ == "__main__":
    main()
