"""Particles followed over time, by predictions that are fitted to the images.

Shake-The-Box (D. Schanz, S. Gesemann and A. Schroeder, Exp. Fluids 57, 70, 2016) with the cost,
fits and penalties of `bayesian_ipr`, which says what they are.

Model. Along each axis a particle has position, velocity and acceleration s = (x, v, a), which a
white-noise jerk of power J changes: after an interval d, s becomes F s and its covariance P
becomes F P F' + J Q, with F and Q of d alone (`kalman_tracks`). A position found in the images has
the variance R that they give it. A miss has the expected square P_xx + R: J, and the variance of a
new track's acceleration, are those with which the median miss is as expected.

Prior. A new track has the median velocity of its neighbours and their variance; one that begins
with a link has the link's. First accelerations are those of turbulence, of the order of (u grad) u.

Start. The first two frames are searched by `bayesian_ipr` and linked by displacements that
neighbours share. If most links are wrong, six frames are searched together (`dense_start`).

Course of a later frame:

    predict   all tracks; those known to a pixel are put into the images where they are expected
    fit       light and position of these, and remove them as `bayesian_ipr` does; tracks of three
              positions or more that keep half of their light are not tried
    find      in what is left: find, fit, remove, twice; learn cameras' shifts; split, and remove
    recognise a particle is its track's if the sum of its squared misses over the expected ones is
              below 20; others are paired with tracks that were not found
    update    the tracks; frames that they missed get the positions of now, moved back in time
    end       tracks outside the box, or not found for more than `gap` frames

A particle seen in one frame alone, inside the box, is a ghost and dropped. Positions, velocities
and accelerations of a frame are the most probable ones given the three frames before and after
(`most_probable_motion`), so that a frame is given once these are there.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sabench.algorithms.particles import bayesian_ipr, candidate_search
from sabench.algorithms.particles.dense_start import (
    CONFIRMED,
    WINDOW_FRAMES,
    are_mostly_wrong,
    search_window,
)
from sabench.algorithms.particles.kalman_tracks import (
    MATURE,
    KalmanTracks,
    TrackedFrame,
    start_tracks,
    with_motion,
)
from sabench.algorithms.particles.learned_model import align_cameras, weigh_pixels
from sabench.algorithms.particles.linking import ENOUGH, GATE, NEIGHBOURS, link
from sabench.algorithms.particles.obstacles import hide_unseen
from sabench.algorithms.particles.particle_search import FLOORS, ParticleSearch, no_particles
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64, I64
from sabench.utils.threads import Deadline

# rounds of fits of the predicted particles before others are looked for: more, and they take the
# light of those others (F1 .73 in place of .80 at 0.18 particles per pixel)
_SHAKES = 3
_SLACK = 0.04  # of the distance between particles: misses of the same one, added to those expected
_KNOWN_PX = 1.0  # largest standard deviation of a prediction that is fitted
_FADED = 0.5  # light over the last light below which a particle may be a ghost
_LAG = 3  # frames before and after one for its particles' motion


@dataclass(frozen=True)
class ShakeTheBoxSettings:
    """Settings of the tracker.

    Attributes
    ----------
    first : of the search in the first two frames.
    searches : rounds of search and removal in every later frame.
    splits : rounds of splits after those.
    gap : frames in a row that a track may miss.
    """

    first: bayesian_ipr.BayesianIprSettings
    searches: int = 2
    splits: int = 1
    gap: int = 2


def track_particles(
    frames: Iterable[Observation],
    times_s: Sequence[float],
    maps: VolumePolynomials,
    settings: ShakeTheBoxSettings,
) -> Iterator[FoundParticles]:
    """Follow the particles of a sequence, and yield them frame after frame.

    A frame's are yielded once later frames no longer change them. Memory holds the images of one
    frame and the particles of some.
    """
    axes = candidate_search.rig_axes(maps)
    longest = float(np.diff(times_s).max(initial=0.0))
    tracker = _Tracker(candidate_search.turn_maps(maps, axes), settings, longest)
    for number, (case, time) in enumerate(zip(frames, times_s, strict=True)):
        tracker.take(case, time, len(times_s) - number - 1)
        while tracker.later >= _LAG + max(settings.gap, 1):
            yield candidate_search.turn_to_world(tracker.give(), axes)
    while tracker.later >= 0:
        yield candidate_search.turn_to_world(tracker.give(), axes)


class _Tracker:
    """State of the tracker: tracks that go on, and the last frames."""

    def __init__(
        self, maps: VolumePolynomials, settings: ShakeTheBoxSettings, longest_s: float
    ) -> None:
        self.maps, self.settings = maps, settings
        self.shares: F64 | None = None  # of the volume that pixels show
        self.longest_s = longest_s  # between two frames
        self.search: ParticleSearch | None = None
        self.before: tuple[Observation, float] | None = None  # last frame, if it has no tracks
        self.doubtful = False  # whether the first links are mostly wrong
        self.held: list[tuple[Observation, float]] = []  # frames that wait for those after them
        self.alone: list[ParticleSearch] = []  # the first of these
        self.tracks: KalmanTracks | None = None
        self.frames: list[TrackedFrame] = []
        self.given = 0  # of these frames
        self.born = 0
        self.motion: tuple[float, float] | None = None  # strengths of acceleration and jerk

    @property
    def later(self) -> int:
        """Number of frames after the next one to give; -1 if all were given."""
        return len(self.frames) - self.given - 1

    def give(self) -> FoundParticles:
        """Return the next frame's particles, and forget frames of no more use."""
        around = self.frames[max(self.given - _LAG, 0) : self.given + _LAG + 1]
        particles = with_motion(around, self.frames[self.given], self.motion)
        self.given += 1
        while self.given > _LAG:
            del self.frames[0]
            self.given -= 1
        return particles

    def take(self, case: Observation, time: float, coming: int) -> None:
        """Find the particles of the next frame, or hold it; so many others are coming."""
        if self.held:
            self.held.append((case, time))
            if len(self.held) == WINDOW_FRAMES or not coming:
                self._begin_together()
        elif self.search is not None and self.tracks is not None and len(self.tracks.number):
            self._follow(case, time, self.tracks, self.search)
        else:
            self._begin(case, time, coming)

    def _begin(self, case: Observation, time: float, coming: int) -> None:
        """Search a frame without predictions; hold it if most links are wrong.

        The links are those to the last frame.
        """
        last = self.search
        self.search = bayesian_ipr.search_frame(case, self.maps, self.settings.first)
        frame = self._join(last, time)
        held = self.doubtful and coming + 2 >= CONFIRMED
        if held and last is not None and self.search is not None and self.before is not None:
            self.held, self.alone = [self.before, (case, time)], [last, self.search]
            self.before = self.tracks = None
        else:
            self.before = (case, time) if self.tracks is None else None
            self._go_on(case, frame)

    def _begin_together(self) -> None:
        held, self.held = self.held, []
        cases, times = zip(*held, strict=True)
        first, self.search = search_window(cases, times, self.maps, self.settings.first, self.alone)
        self.alone = []
        self.frames[-1] = self._write(first, times[0])
        self._go_on(cases[1], self._join(first, times[1]))
        for case, time in held[2:]:
            self.take(case, time, 0)

    def _join(self, last: ParticleSearch | None, time: float) -> TrackedFrame:
        """Link the particles of a frame that was searched to those of the one before."""
        self.tracks, self.doubtful = None, False
        if self.search is None:
            nothing = no_particles(len(self.maps.coefficients))
            return TrackedFrame(time, nothing, np.zeros(0, np.int64), np.zeros(0, np.bool_))
        frame = self._write(self.search, time)
        if last is not None:
            light = last.light
            if (last.shown != self.search.shown).any():  # cameras left out get the typical light
                every = np.zeros((len(light), len(last.shown)))
                every[:, last.shown] = light
                light = every[:, self.search.shown]
                light = np.where(light > 0.0, light, self.search.typical)
            self.tracks = self._link_first(light, self.frames[-1], frame)
        return frame

    def _go_on(self, case: Observation, frame: TrackedFrame) -> None:
        if self.tracks is not None and self.search is not None:
            self._follow(case, frame.time, self.tracks, self.search)
        else:
            self.frames.append(frame)

    def _write(self, search: ParticleSearch, time: float) -> TrackedFrame:
        particles = search.found()
        numbers = self.born + np.arange(len(particles.position_mm))
        self.born += len(numbers)
        return TrackedFrame(time, particles, numbers, np.ones(len(numbers), dtype=np.bool_))

    def _link_first(
        self, light: F64, first: TrackedFrame, second: TrackedFrame
    ) -> KalmanTracks | None:
        positions = first.position, second.position
        sizes = [np.ones(len(position)) for position in positions]
        earlier, later = link(positions, sizes, [first.time, second.time])
        _, i, j = np.intersect1d(earlier, later, return_indices=True)
        if len(i) < ENOUGH:
            return None
        self.doubtful = are_mostly_wrong(first.position[i], second.position[j] - first.position[i])
        duration = second.time - first.time
        variance = first.variance
        velocity = (second.position[j] - first.position[i]) / duration
        # particles may stand still
        least = float(np.sqrt(np.median(variance))) / duration
        tracks = start_tracks(first.position[i], velocity, self.longest_s, least / duration)
        errors = 2.0 * variance[i] / duration**2 + tracks.acceleration * duration**2
        position = first.position[i]
        tracks.add(first.number[i], position, variance[i], light[i], velocity, errors, 2)
        alone = np.setdiff1d(np.arange(len(first.number)), i)
        self._begin_tracks(tracks, first, alone, light)
        tracks.sightings[:] = 1
        return tracks

    def _begin_tracks(
        self, tracks: KalmanTracks, frame: TrackedFrame, rows: I64, light: F64
    ) -> None:
        if len(rows):
            position, variance = frame.position[rows], frame.variance[rows]
            velocity, spread = tracks.neighbours_velocity(position)
            tracks.add(frame.number[rows], position, variance, light[rows], velocity, spread, 1)

    def _follow(
        self, case: Observation, time: float, tracks: KalmanTracks, search: ParticleSearch
    ) -> None:
        tracks.predict(time - self.frames[-1].time)
        self._shake(case, tracks, search)
        frame = self._write(search, time)
        variance = frame.variance
        self.frames.append(frame)
        row = self._recognise(tracks, search, frame.position, variance)
        hits = np.flatnonzero(row >= 0)
        frame.number[hits] = tracks.number[row[hits]]
        late = tracks.missed[row[hits]] > 1
        tracks.update(row[hits], frame.position[hits], variance[hits], search.light[hits])
        self._fill_gaps(tracks, row[hits[late]], frame.particles.rows(hits[late]))
        self._end_tracks(tracks)
        self._begin_tracks(tracks, frame, np.flatnonzero(row < 0), search.light)
        self.motion = tracks.acceleration, tracks.jerk

    def _shake(self, case: Observation, tracks: KalmanTracks, search: ParticleSearch) -> None:
        """Fit the predicted particles, and search what they leave of the images."""
        settings, error = self.settings, np.sqrt(tracks.variance)
        place = (tracks.state[:, 0] - self.maps.middle_mm) / self.maps.half_mm
        certain = np.median(error, axis=1) < _KNOWN_PX * candidate_search.pixel_mm(self.maps)
        rows = np.flatnonzero(certain & (np.abs(place) <= 1.0).all(axis=1))
        search.deadline = Deadline(settings.first.budget_s)
        clear = bayesian_ipr.dark_images(case)
        before, search.hidden = search.hidden, None
        search.show(clear)
        search.put(place[rows], tracks.light[rows], rows)
        if self.shares is None:
            self.shares = candidate_search.volume_shares(self.maps, clear.images.shape[1:])
        hide_unseen(search, clear, self.shares, before)
        weigh_pixels(search, bayesian_ipr.CAPS[0])
        search.refine(_SHAKES)
        weigh_pixels(search, bayesian_ipr.CAPS[1])
        search.refine(_SHAKES)
        bright = search.light.sum(axis=1) > _FADED * tracks.light[search.tag].sum(axis=1)
        search.trusted = bright & (tracks.sightings[search.tag] >= MATURE)
        search.remove(lone=True)
        for number in range(settings.searches):
            search.find(FLOORS[min(number, 1)])
            search.refine(search.fits)
            weigh_pixels(search, bayesian_ipr.CAPS[1])
            search.remove(lone=True)
        align_cameras(search)
        for _ in range(settings.splits):
            bayesian_ipr.split_and_find(search)
        weigh_pixels(search, bayesian_ipr.CAPS[1])
        search.remove(lone=True)

    def _recognise(
        self, tracks: KalmanTracks, search: ParticleSearch, position: F64, variance: F64
    ) -> I64:
        """Return the track (n,) of each particle found, -1 for new ones."""
        row = search.tag.copy()
        tagged = np.flatnonzero(row >= 0)
        slack = (_SLACK * candidate_search.mean_spacing(self.maps, len(position))) ** 2
        off = tracks.off(row[tagged], position[tagged], variance[tagged] + slack)
        row[tagged[off.sum(axis=1) > GATE]] = -1
        lost = np.setdiff1d(np.arange(len(tracks.number)), row)
        new = np.flatnonzero(row < 0)
        again, j = tracks.pair(lost, position[new], variance[new] + slack, NEIGHBOURS, GATE)
        row[new[j]] = again
        return row

    def _fill_gaps(self, tracks: KalmanTracks, rows: I64, particles: FoundParticles) -> None:
        """Add tracks to the frames which they missed, as they are found now."""
        numbers = tracks.number[rows]
        for frame in self.frames[-2 : -self.settings.gap - 2 : -1]:
            absent = ~np.isin(numbers, frame.number)
            # frames before the track's last position have its number
            rows, numbers, particles = rows[absent], numbers[absent], particles.rows(absent)
            back = frame.time - self.frames[-1].time
            terms = np.array([1.0, back, back**2 / 2.0])
            position = np.einsum("o,noa->na", terms, tracks.state[rows])
            low, high = (self.maps.middle_mm + sign * self.maps.half_mm for sign in (-1.0, 1.0))
            position = np.clip(position, low, high)
            frame.add(replace(particles, position_mm=position), numbers)

    def _end_tracks(self, tracks: KalmanTracks) -> None:
        """End tracks that left or were missed too often; drop particles seen once."""
        missed = tracks.missed > 0
        aside = np.abs(tracks.state[:, 0] - self.maps.middle_mm)
        inside = (aside + np.sqrt(GATE * tracks.variance) <= self.maps.half_mm).all(axis=1)
        self.frames[-2].drop(tracks.number[missed & inside & (tracks.sightings == 1)])
        outside = (aside > self.maps.half_mm).any(axis=1)
        over = (tracks.sightings < MATURE) | (tracks.missed > self.settings.gap) | outside
        tracks.select(~(missed & over))
