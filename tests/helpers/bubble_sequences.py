"""Image sequences of moving bubbles with known ids, to test and measure linking."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles.linking import link
from sabench.utils.arrays import F64, I64

EDGE = 60.0


@dataclass
class BubbleSequence:
    """Detections of some frames with the ids of their bubbles. The ids of ghosts are negative."""

    center: list[F64] = field(default_factory=list)
    radius: list[F64] = field(default_factory=list)
    id: list[I64] = field(default_factory=list)

    def add(self, center: F64, radius: F64, identity: I64, rng: np.random.Generator) -> None:
        order = rng.permutation(len(center))
        self.center.append(center[order])
        self.radius.append(radius[order])
        self.id.append(identity[order])


def make_sequence(
    relative: float,
    kind: str = "stream",
    count: int = 300,
    frames: int = 6,
    missing: float = 0.0,
    ghosts: float = 0.0,
    noise: float = 0.0,
) -> BubbleSequence:
    """Make an image sequence of bubbles in a box. The bubbles move on average by `relative` mean
    distances of nearest neighbours a frame. A new bubble replaces each one that leaves the box."""
    rng = np.random.default_rng(5)
    position, radius, identity = (
        EDGE * rng.random((count, 3)),
        0.8 * np.exp(0.3 * rng.standard_normal(count)),
        np.arange(count),
    )
    spacing = float(cKDTree(position).query(position, 2)[0][:, 1].mean())
    direction, made = rng.standard_normal((count, 3)), BubbleSequence()
    for frame in range(frames):
        there, extra = rng.random(count) >= missing, int(ghosts * count)
        seen = np.concatenate([position[there], EDGE * rng.random((extra, 3))])
        seen = seen + noise * spacing * np.array([1.0, 1.0, 3.0]) * rng.standard_normal(seen.shape)
        size = np.concatenate([radius[there], rng.choice(radius, extra)])
        made.add(
            seen,
            size * np.exp(0.03 * rng.standard_normal(len(size))),
            np.concatenate([identity[there], -1 - np.arange(extra)]),
            rng,
        )
        shift = {
            "stream": np.column_stack(
                [
                    0.7 + 0.6 * position[:, 1] / EDGE,
                    0.1 * np.sin(position[:, 0] / 10.0 + frame),
                    np.zeros(count),
                ]
            ),
            "two streams": np.where(
                np.arange(count)[:, None] % 2, [1.0, 0.0, 0.0], [-0.5, 0.8, 0.3]
            ),
            "random": direction / np.linalg.norm(direction, axis=1)[:, None],
        }[kind]
        position = position + relative * spacing * shift
        left = ((position < 0.0) | (position > EDGE)).any(axis=1)
        position, identity = np.mod(position, EDGE), np.where(left, identity + count, identity)
    return made


def link_scores(made: BubbleSequence, track: list[I64]) -> tuple[float, float]:
    """Return the recall and the precision of links. Recall is the share of the true links that were
    found, precision the share of the found links that are true. Links join pairs of detections in
    consecutive frames."""
    true = found = both = 0
    for frame in range(len(track) - 1):
        same = (made.id[frame][:, None] == made.id[frame + 1]) & (made.id[frame] >= 0)[:, None]
        joined = track[frame][:, None] == track[frame + 1]
        true, found, both = true + same.sum(), found + joined.sum(), both + (same & joined).sum()
    return both / true, both / found


def link_sequence(made: BubbleSequence, gap: int = 1) -> list[I64]:
    return link(made.center, made.radius, [0.01 * frame for frame in range(len(made.center))], gap)
