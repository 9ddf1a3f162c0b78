"""Speed of the leaderboard page with many records.

`python -m benchmarks.page [records ...]` prints JSON; it needs chromium and chromedriver.

The records are made up: as many cases as it takes for 20 solvers with five seeds each (`rows` of
five records), and again with one seed each. In the browser, `ranking_ms` and `first_row_ms` are
from the start of the navigation to the ranking and to the first rows of all results on the screen,
`sorted_ms` and `filtered_ms` from the click or letter to the new rows on the screen: the middle of
five.
"""

import json
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from sabench import tasks
from sabench.evaluation.leaderboard import board
from sabench.evaluation.record_schema import Record
from tests.helpers.browser import Browser, chromium

_COUNTS, _SOLVERS = (100, 1_000, 10_000), 20
_SORTED = ("solver", "q", "peak_f1", "intensity_error", "seconds")
_SHOWN = "requestAnimationFrame(() => setTimeout(() => done(performance.now() - start)))"
_FRAME = f"new Promise(done => {{{{ const start = performance.now(); {{act}}; {_SHOWN}; }}}})"
_SORT = "document.querySelector('th[data-key=\"{key}\"] button').click()"
_TYPE = (
    "const field = document.querySelector('input[type=search]'); "
    "field.value = '{text}'; field.dispatchEvent(new Event('input'))"
)
_OPENED = "(performance.getEntriesByName('first row')[0]?.startTime ?? null)"


def made_up(count: int, seeds: int) -> list[Record]:
    """Make records of the reconstruction task with all scores and long hashes."""
    rng = random.Random(1)
    return [
        _record(rng, number // (_SOLVERS * seeds), number // seeds % _SOLVERS, number % seeds)
        for number in range(count)
    ]


def _record(rng: random.Random, case: int, solver: int, seed: int) -> Record:
    def digest() -> str:
        return f"{rng.getrandbits(256):064x}"

    return {
        "suite": "made up",
        "case": f"tank-{case}",
        "scene": "tank",
        "difficulty": ("easy", "standard", "hard")[case % 3],
        "axis": None,
        "axes": {"particles.per_pixel": case / 1000.0},
        "scene_hash": f"{case:064x}",
        "dataset": f"{case:032x}{seed:032x}",
        "seed": seed,
        "split": "public",
        "renderer": "mitsuba",
        "task": "reconstruction",
        "solver": f"solver_{solver}",
        "parameters": {"k": "auto", "floor": 0.01, "passes": solver},
        "code_hash": f"{solver:064x}",
        "run_hash": digest(),
        "versions": {"numpy": "2.4.6", "mitsuba": "3.9.1", "sabench": "0.1.0"},
        "machine": {"cpu": "some processor", "cores": 8, "backend": "llvm"},
        "pictures": None,
        "error": None,
        "command": f"sabench run made-up --case tank-{case} --solver solver_{solver}",
        **{column.key: rng.random() for column in tasks.of("reconstruction").columns},
    }


def _middle(browser: Browser, acts: list[str]) -> float:
    return round(
        sorted(float(browser.ask(_FRAME.format(act=act))) for act in acts)[len(acts) // 2], 1
    )


def in_browser(browser: Browser, file: Path) -> dict[str, float]:
    """Measure milliseconds of a page in the browser, and count its elements."""
    opened = {}
    for name, view in (("ranking_ms", ""), ("first_row_ms", "#view=table")):
        browser.open(file, view)
        browser.wait(f"{_OPENED} !== null")
        opened[name] = round(float(browser.ask(_OPENED)), 1)
    return {
        "elements": int(browser.ask("document.querySelectorAll('*').length")),
        **opened,
        "sorted_ms": _middle(browser, [_SORT.format(key=key) for key in _SORTED]),
        "filtered_ms": _middle(
            browser,
            [_TYPE.format(text="tank-1 solver"[:length]) for length in range(4, 4 + len(_SORTED))],
        ),
    }


def measure(browser: Browser | None, count: int, seeds: int, folder: Path) -> dict[str, Any]:
    """Build one page and use it."""
    records, file = made_up(count, seeds), folder / "index.html"
    start = time.perf_counter()
    board.build_page(records, folder, file)
    built = {
        "records": count,
        "rows": count // seeds,
        "build_s": round(time.perf_counter() - start, 3),
        "page_mb": round(file.stat().st_size / 1e6, 2),
    }
    return built | (in_browser(browser, file) if browser else {})


def main() -> None:
    """Print one line for every number of records and seeds."""
    counts = [int(word) for word in sys.argv[1:]] or list(_COUNTS)
    start = time.perf_counter()
    print(
        json.dumps(
            {
                "library_mb": round(len(board.library()) / 1e6, 2),
                "library_s": round(time.perf_counter() - start, 3),
            }
        )
    )
    with chromium() as browser, tempfile.TemporaryDirectory() as folder:
        for count in counts:
            for seeds in (5, 1):
                print(json.dumps(measure(browser, count, seeds, Path(folder))), flush=True)


if __name__ == "__main__":
    main()
