"""Figure 5-22: penetration depth over the jet's height, both in diameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_5 import FRAMES, NOZZLE_MM, detect_jets, jet_rows
from sabench.evaluation.thesis.common import Item, claim
from sabench.plotting.charts import Cloud, Figure, Panel

SEEDS = 10


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure Y_p / D over h / D with the diameters of impact and of the nozzle."""
    points: dict[str, list[tuple[float, float]]] = {}
    depths = []
    for jet in detect_jets(seeds, pixels):
        every = jet.analyse()
        depths.append(every["many"].penetration_mm)
        for name, diameter in (("D_i", jet.printed.diameter_mm), ("D_N", NOZZLE_MM)):
            own = [figures.penetration_mm / diameter for figures in every.values()]
            points.setdefault(name, []).append((jet.height / diameter, own[0]))
            yield from jet_rows(
                f"h / {name} = {jet.height / diameter:.2f}: Y_p / {name}",
                jet.printed.penetration_mm / diameter,
                *own,
            )
    finite = [depth for depth in depths if np.isfinite(depth)]
    yield claim(
        f"Y_p of the highest over that of the lowest nozzle, true bubbles of {FRAMES} frames",
        "a higher jet penetrates less",
        finite[-1] / finite[0] if finite else None,
        len(finite) == len(depths) and all(np.diff(finite) < 0.0),
    )
    clouds = tuple(
        Cloud(f"over {name}", *np.array(own, dtype=np.float64).T) for name, own in points.items()
    )
    panel = Panel("", "h / D", "Y_p / D", clouds, log="xy")
    yield Figure("fig-5-22", "penetration depth of found bubbles", (panel,))
