"""Linking of bubbles: recall and precision by displacement, and seconds.

    python benchmarks/linking.py

Prints one JSON value: for four motions, by mean displacement a frame in mean distances of nearest
neighbours, recall and precision of links (300 bubbles, 6 frames); and seconds for 2,000 bubbles in
50 frames.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.helpers.bubble_sequences import link_scores, link_sequence, make_sequence

_FAULTS = {"missing": 0.2, "ghosts": 0.2, "noise": 0.03}
_MOTIONS: dict[str, tuple[str, dict[str, float]]] = {
    "sheared stream": ("stream", {}),
    "sheared stream, faults": ("stream", _FAULTS),
    "two streams": ("two streams", {}),
    "random": ("random", {}),
}
_STEPS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)


def measure_links(kind: str, faults: Any, relative: float) -> list[float]:
    """Measure recall and precision of links."""
    made = make_sequence(relative, kind, **faults)
    return [round(share, 3) for share in link_scores(made, link_sequence(made))]


def measure_time(kind: str, faults: Any) -> float:
    """Measure the seconds for a long image sequence.

    The displacement is one mean distance of neighbours a frame.
    """
    made = make_sequence(1.0, kind, count=2000, frames=50, **faults)
    start = time.perf_counter()
    link_sequence(made)
    return round(time.perf_counter() - start, 2)


def main() -> None:
    """Print everything."""
    links = {
        name: {str(step): measure_links(*how, step) for step in _STEPS}
        for name, how in _MOTIONS.items()
    }
    print(
        json.dumps(
            {
                "links": links,
                "seconds": {name: measure_time(*how) for name, how in _MOTIONS.items()},
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
