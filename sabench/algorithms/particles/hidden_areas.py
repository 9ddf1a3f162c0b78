"""Areas of images from which something hides the particles behind it."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.particles.all_particles import paint_particles
from sabench.algorithms.particles.background import ClearImages, find_dark_areas
from sabench.algorithms.particles.image_model import Particles, without_margins
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.utils.arrays import F32, F64, Bool

_LEAST = 0.02  # of the pixels in which a camera sees the volume: less is chance
_DOUBTFUL = 0.8  # of the light expected in an area: less may be hidden, or ghosts are expected
_HIDDEN = 0.5  # the same, of particles that are found without the area
_FEWEST = 3  # cameras without a hidden area


def find_dark_views(search: ParticleSearch, clear: ClearImages, shares: F64) -> Bool:
    """Mark large dark areas (camera, row, column) of a search's cameras.

    Parameters
    ----------
    clear : images of all cameras, also those that the search leaves out.
    shares : (camera, row, column) of the volume that pixels show (`volume_shares`).
    """
    dark = find_dark_areas(clear.images, clear.flaws, shares, search.number)
    large = dark.sum(axis=(1, 2)) > _LEAST * (shares > 0.0).sum(axis=(1, 2))
    dark[~(large & search.shown)] = False
    return dark & ~clear.flaws.unknown


def are_doubtful(search: ParticleSearch, dark: Bool) -> bool:
    """Say whether a search's particles should be seen in a dark area, but are not."""
    return bool((_seen_shares(search, dark) < _DOUBTFUL).any())


def keep_hidden(search: ParticleSearch, dark: Bool) -> Bool:
    """Keep the areas that hide the particles of a search that did without them.

    There are hardly any particles in other dark areas, and what other cameras show of them is seen.
    None is kept if fewer than three cameras are left: then nothing was lit, or a frame is missing.
    """
    hidden = _seen_shares(search, dark) < _HIDDEN
    few = search.shown.sum() - hidden.sum() < _FEWEST
    return np.zeros_like(dark) if few else dark & hidden[:, None, None]


def hide_unseen(
    search: ParticleSearch, clear: ClearImages, shares: F64, before: Bool | None
) -> None:
    """Hide dark areas in which a search's particles should be seen, but are not.

    An area that is dark and was hidden `before` is hidden, too.
    """
    dark = find_dark_views(search, clear, shares)
    if not dark.any():
        return
    hidden = keep_hidden(search, dark)
    if before is not None:
        hidden |= dark & before
    if hidden.any():
        search.hide(hidden)


def _seen_shares(search: ParticleSearch, dark: Bool) -> F64:
    """Compute the share (camera,) of the light expected in dark areas that is there.

    It is 1 where none is expected.
    """
    seen, expected = np.ones(len(dark)), _expected_images(search)
    for own, camera in enumerate(np.flatnonzero(search.shown)):
        area = dark[camera]
        light = expected[own][area].astype(np.float64)
        if light.any():
            seen[camera] = light @ search.images[own][area] / (light @ light)
    return seen


def _expected_images(search: ParticleSearch) -> F32:
    """Render the images that particles have with the mean light of all other cameras."""
    logs = np.log(search.light / search.typical)
    others = (logs.sum(axis=1, keepdims=True) - logs) / (logs.shape[1] - 1)
    light = search.typical * np.exp(others)
    model = search.model()
    blank = model._replace(left=np.zeros_like(model.left))
    alive = np.ones(len(light), dtype=np.bool_)
    paint_particles(blank, search.widest, Particles(search.position, light, alive), 1.0)
    expected: F32 = without_margins(blank.left)
    return expected
