"""Hidden areas, partly hidden particles, and cameras that contradict the others.

A large dark area of an image where other cameras' particles should be seen is hidden by
something in front of it.

A body hides what is behind it and shows what is in front, so that no area of an image shows which
particles a camera misses. They are searched for in the light that the others leave: in all cameras
but one, in all but two, and so on. Of larger sets of cameras, those are tried that contain one
which hides particles, the most promising first.

A camera with a calibration off by many pixels shows little where the particles of the others
are: the search leaves much of its image.
"""

import math
import warnings
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from sabench.algorithms.particles.all_particles import light_gains, paint_particles
from sabench.algorithms.particles.candidate_search import FEWEST, shared_views
from sabench.algorithms.particles.image_model import without_margins
from sabench.algorithms.particles.learned_model import FEW
from sabench.algorithms.particles.particle_search import FLOORS, MOST_TILT, ParticleSearch
from sabench.images.background import ClearImages
from sabench.images.flaws import Flaws
from sabench.images.peaks import CLEAR
from sabench.utils.arrays import F32, F64, FROM_MAD, Bool

# Hidden areas:
_LEAST = 0.02  # of the pixels that show the volume: less is chance
_HIDDEN = 0.5  # of the light expected in an area by particles that are found without it
_EXPECTED = 8.0  # particles in a window that may be dark for a reason
_DARK = 0.05  # of the light that is expected there

# Partly hidden particles:
_TRIED = 100  # sets of so many blind cameras, the most promising ones
_DENIED = -10.0  # decrease of the cost by a particle's light in a camera that does not see it

# Cameras that contradict the others:
_LEFT = 0.1  # of the squared light of an image: more that is left has a reason
_WORST = 2.0  # times the median camera's: what a camera leaves that contradicts the others

_Cameras = tuple[int, ...]


def find_dark_views(search: ParticleSearch, clear: ClearImages, shares: F64) -> Bool:
    """Mark a search's large dark areas (camera, row, column), by `volume_shares`."""
    dark = find_dark_areas(clear.images, clear.flaws, shares, search.number)
    large = dark.sum(axis=(1, 2)) > _LEAST * (shares > 0.0).sum(axis=(1, 2))
    dark[~(large & search.shown)] = False
    return dark & ~clear.flaws.unknown


def keep_hidden(search: ParticleSearch, dark: Bool) -> Bool:
    """Keep the areas that hide the particles of a search that did without them.

    Other dark areas show few particles, which are seen. None is kept if fewer than three cameras
    are left: then nothing was lit, or a frame is missing.
    """
    hidden = _seen_shares(search, dark) < _HIDDEN
    few = search.shown.sum() - hidden.sum() < FEWEST
    return np.zeros_like(dark) if few else dark & hidden[:, None, None]


def hide_unseen(
    search: ParticleSearch, clear: ClearImages, shares: F64, before: Bool | None
) -> None:
    """Hide dark areas that should show particles, or that were hidden `before`."""
    dark = find_dark_views(search, clear, shares)
    if not dark.any():
        return
    hidden = keep_hidden(search, dark)
    if before is not None:
        hidden |= dark & before
    if hidden.any():
        search.hide(hidden)


def _seen_shares(search: ParticleSearch, dark: Bool) -> F64:
    """Compute the share (camera,) of light expected in dark areas that is seen, or 1."""
    # images of the particles with the mean light of all other cameras
    logs = np.log(search.light / search.typical)
    others = (logs.sum(axis=1, keepdims=True) - logs) / (logs.shape[1] - 1)
    particles = search.particles()._replace(light=search.typical * np.exp(others))
    model = search.model()
    blank = model._replace(left=np.zeros_like(model.left))
    paint_particles(blank, search.widest, particles, 1.0)
    expected = without_margins(blank.left)
    shares = np.ones(len(dark))
    for row, camera in enumerate(np.flatnonzero(search.shown)):
        area = dark[camera]
        light = expected[row][area].astype(np.float64)
        if light.any():
            shares[camera] = light @ search.images[row][area] / (light @ light)
    return shares


def find_dark_areas(images: F32, flaws: Flaws, shares: F64, number: float) -> Bool:
    """Mark areas (camera, row, column) without light where several particles belong.

    Each image holds `number` particles, distributed over the pixels as the shares of the volume
    that these show. Pixels that show little of it count only as part of a larger area.
    """
    dark = np.zeros(images.shape, dtype=np.bool_)
    for camera, share in enumerate(shares):
        lit = share > 0.0
        edge = math.ceil(math.sqrt(2.0 * _EXPECTED * lit.sum() / max(number, 1.0)))
        if not 0 < 2 * edge <= min(lit.shape):
            continue
        valid = lit & ~flaws.unknown[camera]
        expected = np.where(valid, number / share.sum() * share, 0.0)
        light = np.where(valid, images[camera], 0.0)
        each = float(light.sum()) / max(float(expected.sum()), 1.0)
        sums, counts = (
            cv2.boxFilter(image.astype(np.float32), -1, (edge, edge), normalize=False)
            for image in (light, expected)
        )
        empty = lit & (sums < _DARK * each * np.maximum(counts, 1.0))
        window = np.ones((edge, edge), np.uint8)
        wide = cv2.dilate(empty.astype(np.uint8), window)
        sure = cv2.dilate((empty & (counts > _EXPECTED)).astype(np.uint8), window)
        _, area = cv2.connectedComponents(wide)
        dark[camera] = (wide > 0) & np.isin(area, area[sure > 0])
    return dark


def find_partly_hidden(search: ParticleSearch) -> list[ParticleSearch]:
    """Find particles that up to a third of the cameras, rounded, do not see.

    They are found in what a search leaves of the images, or among its particles, and subtracted
    from its images. Returns a search for each set of cameras that sees some.
    """
    parts: list[ParticleSearch] = []
    hidden: dict[_Cameras, int] = {(): 1}  # how many particles sets of cameras hide
    number = len(search.typical)
    cameras = np.arange(number)
    most = min((number + 1) // 3, number - FEWEST)
    for _ in range(most):
        before, hidden = hidden, {}
        for blind in _promising(number, before):
            if search.deadline.over:
                break
            part = search.rest(np.setdiff1d(cameras, blind))
            if _find(part):
                parts.append(part)
                _subtract(search, part)
            if len(part.position):
                hidden[blind] = len(part.position)
    # particles that up to `most` cameras deny, by these cameras
    denied = light_gains(search.model(), search.widest, search.particles()) < _DENIED
    count = denied.sum(axis=1)
    rows: dict[_Cameras, list[int]] = {}
    for n in np.flatnonzero((count > 0) & (count <= most)).tolist():
        rows.setdefault(tuple(np.flatnonzero(denied[n]).tolist()), []).append(n)
    taken = {blind: (search.position[those], search.light[those]) for blind, those in rows.items()}
    search.keep((count == 0) | (count > most))
    for blind, (position, light) in taken.items():
        part = search.rest(np.setdiff1d(cameras, blind))
        part.put(position, np.delete(light, blind, axis=1), np.full(len(light), -1))
        part.refine(part.fits)
        part.remove(lone=True)
        if len(part.position):
            parts.append(part)
            _subtract(search, part)
    search.refine(search.fits)
    return parts


def _promising(number: int, before: dict[_Cameras, int]) -> list[_Cameras]:
    """List sets of cameras to try, supersets of those that hide most particles first."""
    promise: dict[_Cameras, int] = {}
    for smaller, many in before.items():
        for camera in set(range(number)).difference(smaller):
            blind = tuple(sorted((*smaller, camera)))
            promise[blind] = promise.get(blind, 0) + many
    return sorted(promise, key=lambda blind: (-promise[blind], blind))[:_TRIED]


def _find(part: ParticleSearch) -> bool:
    for floor in FLOORS:
        part.find(floor)
        part.refine(part.fits)
        part.remove(lone=True)
        if not len(part.position):
            return False
    part.refine(part.fits)
    return True


def _subtract(search: ParticleSearch, part: ParticleSearch) -> None:
    seeing = np.flatnonzero(part.shown[search.shown])
    search.framed[seeing] -= part.framed - part.framed_left
    search.framed_left[seeing] = part.framed_left


def without_wrong_cameras(
    search: ParticleSearch,
    names: Sequence[str],
    search_without: Callable[[Bool], ParticleSearch | None],
) -> ParticleSearch:
    """Search again without the cameras that contradict the others, and warn of each.

    If no choice of cameras explains the images, one warning says so, and the search stays.
    `search_without` searches the frame without the cameras (all cameras,) that are marked.
    """
    wrong = np.zeros(len(search.shown), dtype=np.bool_)
    now: ParticleSearch | None = search
    while now is not None and not explains(now):
        left, worst = left_of_images(now), _worst(now)
        if now.shown.sum() <= FEWEST or left.max() < _WORST * np.median(left):
            now = None
        else:
            wrong[worst] = True
            now = search_without(wrong)
    if now is None:
        warnings.warn(
            f"{names[_worst(search)]}: expected light of particles in the grid, got light that "
            "they do not explain, as in other cameras; check the calibration, and that the grid "
            "holds all particles that the cameras see",
            stacklevel=1,
        )
        return search
    for camera in np.flatnonzero(wrong).tolist():
        warnings.warn(
            f"{names[camera]}: expected light where the other cameras' particles are, got it "
            "elsewhere; the camera is left out: check its calibration",
            stacklevel=1,
        )
    return now


def warn_of_tilt(search: ParticleSearch, names: Sequence[str]) -> None:
    """Warn of cameras with images that are longer streaks than the model's.

    Cameras with too few particles are left out.
    """
    if search.number < FEW:
        return
    for camera, tilt in zip(np.flatnonzero(search.shown).tolist(), search.tilt, strict=True):
        if abs(tilt) > MOST_TILT:
            warnings.warn(
                f"{names[camera]}: expected particle images that are spots, got streaks across "
                f"rows and columns (correlation {tilt:+.2f}, up to {MOST_TILT} is fitted); some "
                "particles may be missed or found as two: check the focus, the camera's angle to "
                "the wall, and that particles do not move while they are lit",
                stacklevel=1,
            )


def explains(search: ParticleSearch) -> bool:
    """Return whether the particles explain the images."""
    by_chance = 1.0 / math.sqrt(max(len(search.position), 1))
    return float(left_of_images(search).max()) < _LEFT + by_chance


def left_of_images(search: ParticleSearch) -> F64:
    """Compute the share (camera,) of each image's squared light that is left.

    Light that is not clear of noise does not count, nor that of a single pixel, which may be hot.
    If much is left, pixels count only where enough cameras see the box. Without particles,
    noise is the scatter of all pixels about their median, as a background may look like light.
    """
    if not len(search.position):
        lights = [image[valid] for image, valid in zip(search.images, search.known, strict=True)]
        away = [light - np.median(light) for light in lights]
        return np.array(
            [float((off > FROM_MAD * CLEAR * np.median(np.abs(off))).any()) for off in away]
        )
    shares = _left_where(search, search.known)
    if shares.max() < _LEFT:
        return shares
    shape = search.images.shape[1:]
    return _left_where(search, search.known & shared_views(search.maps, shape, FEWEST))


def _left_where(search: ParticleSearch, counts: Bool) -> F64:
    shares = []
    views = zip(search.images, counts, search.noise, strict=True)
    for camera, (image, valid, noise) in enumerate(views):
        both = search.miss(camera), image
        rest, whole = (_squares(np.where(valid, values, 0.0), CLEAR * noise) for values in both)
        shares.append(rest / max(whole, rest, 1e-6))
    return np.array(shares)


def _squares(light: F32, floor: float) -> float:
    """Add up squares of light above a floor, where a neighbour is above it, too."""
    above = np.abs(light) > floor
    together = cv2.boxFilter(above.astype(np.float32), -1, (3, 3), normalize=False) > 1.5
    return float(np.square(light[above & together], dtype=np.float64).sum())


def _worst(search: ParticleSearch) -> int:
    return int(np.flatnonzero(search.shown)[np.argmax(left_of_images(search))])
