"""Moves of a search for the most probable particles of one frame.

A particle has a place, light with a prior that is learned from the images, and a price.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from sabench.algorithms.particles.all_particles import split_gains
from sabench.algorithms.particles.candidate_search import (
    BRIGHTEST,
    find_candidates,
    pixel_mm,
    split_directions,
    wide_enough,
)
from sabench.algorithms.particles.disjoint_groups import (
    disjoint_groups,
    order_in_memory,
    side_by_side,
)
from sabench.algorithms.particles.image_model import make_room
from sabench.algorithms.particles.joint_fit import refine, start_light
from sabench.algorithms.particles.light_prior import scatter_between
from sabench.algorithms.particles.model_moves import (
    count_meetings,
    find_neighbours,
    remove_ghosts,
)
from sabench.algorithms.particles.particle_splits import split_pairs
from sabench.algorithms.particles.search_state import SearchState
from sabench.utils.arrays import I64

_PORTIONS = 8  # of many rows whose order counts: the first are fitted before the next
# standard deviations of noise: the least floor of candidates; of faint particles, which would all
# be below it, just above the noise, or this share of a typical particle's light
_FLOOR, _LEAST_FLOOR, _FAINT = 2.0, 1.1, 0.2
_MANY, _FIRST = 16.0, 2.5  # of the estimated number: first candidates, times cameras, and least
_MORE = 0.5  # of the particles so far: candidates beside them
# images that share a pixel, at least and for each camera; where more do, the share of cameras in
# which neighbours take all light of a particle that is not found yet
_CROWDED, _EACH, _TAKEN = 1.25, 0.095, 0.2
_DIMMEST = 0.03  # of a typical peak: darker light is as good as none
_SETTLED = 0.03  # fall of the cost of a particle, on average: a round with less is the last one
_CONTESTED = 0.25  # of the cameras: meetings with others that have just earned their price
_TRIAL_FITS = 2  # rounds of fits of a particle's neighbours when it is taken out for trial
# units of the cost, and times what the median particle promises (images that are a little wider
# than the model's promise something everywhere): particles of which a split promises more are tried
_PROMISING, _COMMON = 3.0, 2.0
_APART = 1.1  # widths: distance of the two of a split from their middle


class ParticleSearch(SearchState):
    """Search that adds, fits, removes and splits particles."""

    def refine(self, rounds: int) -> None:
        """Fit all particles, one after the other, in several rounds, as time allows.

        A round that hardly lowers the cost is the last one.
        """
        model, particles = self.model(), self.particles()
        rows, changes = np.arange(len(self.position)), [0.0]
        turns = self._turns(rows, portions=1)

        def fit(some: I64) -> None:
            changes.append(refine(model, self.room, particles, some))

        for _ in range(rounds):
            changes.clear()
            self._work(fit, turns)
            if sum(changes) >= -_SETTLED * len(rows):
                break

    def _turns(
        self, rows: I64, neighbours: tuple[I64, I64] | None = None, portions: int = _PORTIONS
    ) -> list[list[I64]]:
        """List the groups of rows that share no pixel, turn by turn.

        Neighbours, if given, are changed, too. Rows of one portion come before those of the next.
        """
        window, pixel = make_room(self.widest).profiles.shape[2], pixel_mm(self.maps)
        return disjoint_groups(self.maps, self.position, rows, window, pixel, portions, neighbours)

    def _work(self, work: Callable[[I64], None], turns: list[list[I64]]) -> None:
        """Work on one turn after the other, as time allows."""
        side_by_side(work, itertools.takewhile(lambda _: not self.deadline.over, turns))

    def find(self, floor: float) -> None:
        """Add candidates from what is left of the images, the brightest.

        Many at once would take each other's light, and that of particles.
        """
        if self.deadline.over:
            return
        left, sigma = wide_enough(self.left, self.sigma)
        peaks = self.peaks(sigma)[:, None, None]
        dark = np.maximum(self.noise[:, None, None] / peaks, _DIMMEST)
        logs = np.log(np.clip(left / peaks, dark, BRIGHTEST))
        enough = self.saturated & (self.left <= 0.0)
        logs = np.where(self.covered | enough, np.nan, logs).astype(np.float32)
        cameras = len(logs)
        spread = (math.sqrt(2.0 * math.log(cameras)) + 0.5) * scatter_between(self.covariance)
        noise = float(dark.max())
        least = max(floor, min(_FLOOR * noise, max(_LEAST_FLOOR * noise, _FAINT)))
        first = len(self.position)
        crowded = self.overlap() > max(_CROWDED, _EACH * cameras)
        taken = int(_TAKEN * cameras) if first and crowded else 0
        found = find_candidates(self.maps, logs, math.log(least), spread, taken)
        share = max(_MANY / cameras, _FIRST)  # the more cameras, the fewer meet by chance
        most = _MORE * max(first, self.number) if first else share * self.number
        found = found[: int(most)]
        self.append(len(found), 0.0)
        self.position[first:] = found
        model, particles = self.model(), self.particles()

        def start(rows: I64) -> None:
            start_light(model, self.room, particles, rows)

        self._work(start, self._turns(np.arange(first, len(self.position)), portions=1))
        self.select(np.all(self.light > 0.0, axis=1))  # all, unless time was over
        self.select(order_in_memory(self.maps, self.position, pixel_mm(self.maps)))

    def remove(self, lone: bool) -> None:
        """Remove particles that do not earn their price, the darkest first.

        All are fitted before, or what neighbours gain by their own fits would count against a
        particle that is taken out. Those that earn several times their price are tried again only
        where others that newly do meet them in a share of the cameras: what they share with fewer
        is not all that they earn.
        """
        self.refine(self.fits)
        starts, near = find_neighbours(self.maps, self.sigma, self.position)
        particles, model = self.particles(), self.model()
        tried = ~self.sure & ~self.trusted

        def remove(rows: I64) -> None:
            each = self.room, particles, rows, starts, near
            remove_ghosts(model, *each, _TRIAL_FITS, lone, self.sure, self.odds)

        for _ in range(2):
            rows = np.flatnonzero(tried)
            order = rows[np.argsort(self.common_light()[rows], kind="stable")]
            self._work(remove, self._turns(order, (starts, near)))
            promoted = tried & self.sure & particles.alive
            meetings = count_meetings(self.maps, self.sigma, self.position, promoted, starts, near)
            tried = ~tried & ~self.trusted & (meetings >= _CONTESTED * len(self.sigma))
        self.select(particles.alive)
        self.refine(1)

    def split(self) -> None:
        """Replace particles by two where that is more probable.

        What is left of the images tells where it may be.
        """
        count, model = len(self.position), self.model()
        width = float(self.sigma.max())
        steps = _APART * width / self.maps.half_mm * split_directions(self.maps)
        gains = split_gains(model, self.widest, self.particles(), steps)
        least = _PROMISING + _COMMON * float(np.median(gains)) if count else 0.0
        order = np.argsort(-gains, kind="stable")
        order = order[gains[order] > least]
        self.sure[order] = False
        self.append(len(order), 1.0)
        spare = np.zeros(count, dtype=np.int64)
        spare[order] = np.arange(count, len(self.position))
        particles = self.particles()
        particles.alive[count:] = False

        def split(rows: I64) -> None:
            split_pairs(model, self.room, particles, rows, spare, steps)

        self._work(split, self._turns(order, portions=1))
        self.select(particles.alive)
