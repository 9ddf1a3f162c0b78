"""Figures 2-3 to 2-5, 2-14, 2-15: grey values of single and refocused images.

A refocused image is a mean over cameras. The central limit theorem makes the light of particles
elsewhere a nearly normal noise, whose deviation is that of one image over the root of the number
of cameras; particles in focus are outliers, which a threshold keeps (section 2.2.3).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import kstest

from sabench.algorithms.refocus import refocus_sum
from sabench.evaluation.reproduction import Item, Row
from sabench.geometry.grid import Grid
from sabench.plotting.drawing import Curve, Figure, Panel
from sabench.scenes import load_scene
from sabench.simulation.in_memory import Shot
from sabench.utils.arrays import F32, F64, Bool

from .chapter_2_cameras import CAMERAS, by_cameras
from .common import cases, claim, coarsen, image_panel, make_row, per_pixel, simulate_frame

_ARRAY, _EXPERIMENT = "50x50x10-D0.4", "vortex-ring-experiment"
_NINE = 9  # cameras of figure 2-15 b to d
_PLANES = 5  # refocused, in the middle of the volume
_K = 3.0  # standard deviations of the threshold: "around three"
_NEAR, _AWAY = 1.5, 4  # voxels from a true particle
_BINS = 60
_CROPS = {"fig-2-3": 250, "fig-2-14": 140}  # pixels of the thesis's zoomed views


@dataclass(frozen=True)
class _Grey:
    """Grey values of planes (plane, row, column) in the part that all cameras see.

    Attributes
    ----------
    single, refocused : of the mapped image of one camera, and of the mean over all.
    bright : particles' own values in the refocused planes.
    near, away : voxels of the refocused planes that are close to a true particle, and far from all.
    raw : that camera's image.
    """

    single: F32
    refocused: F32
    bright: F64
    near: Bool
    away: Bool
    raw: F32
    cameras: int

    @property
    def signal_to_noise(self) -> float:
        """Mean value of particles over the planes' mean, in standard deviations."""
        return float((self.bright.mean() - self.refocused.mean()) / self.refocused.std())


def fig_2_4(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure how normal refocused images are, and how far particles stand out."""
    (case,) = [case for case in cases("table-2-1") if case.name == _ARRAY]
    frames = [_look(simulate_frame(coarsen(case.scene, pixels), seed)) for seed in seeds]
    yield from _rows_of_shape(frames)
    yield from _pictures("fig-2-3", frames[0])
    yield _histograms("fig-2-4", frames[0])
    scene = coarsen(load_scene(_EXPERIMENT), pixels)
    recorded = [_look(simulate_frame(scene, seed)) for seed in seeds]
    yield from _pictures("fig-2-14", recorded[0])
    panels = {f"experiment, {recorded[0].cameras} cameras": recorded}
    for cameras, setup in by_cameras(CAMERAS):
        if cameras == _NINE:
            name = f"{cameras} cameras, {per_pixel(setup.scene):.3f} ppp"
            coarse = coarsen(setup.scene, pixels)
            panels[name] = [_look(simulate_frame(coarse, seed)) for seed in seeds]
    yield from _rows_of_density(panels)
    yield Figure(
        "fig-2-15",
        "Figure 2-15: grey values of refocused images",
        tuple(_histogram(name, greys[0].refocused) for name, greys in panels.items()),
    )


def _look(shot: Shot) -> _Grey:
    """Refocus planes in the middle of the volume, with all and with one camera."""
    case = shot.observation
    grid = _middle_of(case.grid)
    images = case.normalised_images()
    centers = np.array([camera.center_mm for camera in case.cameras])
    central = int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmin())
    middle = np.s_[central : central + 1]
    refocused = refocus_sum(images, case.cameras, grid) / np.float32(len(images))
    single = refocus_sum(images[middle], case.cameras[middle], grid)
    voxels = grid.to_voxels(shot.particles.position_mm)
    inside = grid.in_scored(voxels)
    x, y, z = np.rint(voxels[inside]).astype(int).T
    distance = _distance(grid, voxels)
    _, rows, columns = grid.scored
    return _Grey(
        single[:, rows, columns],
        refocused[:, rows, columns],
        refocused[z, y, x].astype(np.float64),
        distance[:, rows, columns] <= _NEAR,
        distance[:, rows, columns] >= _AWAY,
        images[central],
        len(images),
    )


def _middle_of(grid: Grid) -> Grid:
    first = (grid.shape[0] - _PLANES) // 2
    low = (*grid.low_mm[:2], grid.low_mm[2] + first * grid.voxel_mm[2])
    return replace(
        grid, low_mm=low, shape=(_PLANES, *grid.shape[1:]), crop=(grid.crop[0], grid.crop[1], 0)
    )


def _distance(grid: Grid, voxels: F64) -> F64:
    """Measure distances of voxels (z, y, x) to the nearest particle, in voxels."""
    from scipy.ndimage import distance_transform_edt

    padded = np.ones([n + 2 * _AWAY for n in grid.shape], dtype=np.bool_)
    nearest = np.rint(voxels).astype(int) + _AWAY
    inside = ((nearest >= 0) & (nearest < padded.shape[::-1])).all(axis=1)
    x, y, z = nearest[inside].T
    padded[z, y, x] = False
    inner = tuple(np.s_[_AWAY:-_AWAY] for _ in range(3))
    return np.asarray(distance_transform_edt(padded)[inner])


def _rows_of_shape(frames: Sequence[_Grey]) -> Iterator[Row]:
    single = [_distance_to_normal(frame.single) for frame in frames]
    refocused = [_distance_to_normal(frame.refocused) for frame in frames]
    yield make_row("one mapped image: largest distance to a normal distribution", None, single)
    yield make_row("refocused image: largest distance to a normal distribution", None, refocused)
    yield claim(
        "refocusing makes grey values normal",
        "one image is not Gaussian, the refocused one quite well",
        float(np.mean(refocused) / np.mean(single)),
        max(refocused) < 0.5 * min(single),
        "distance of the refocused image over that of one image (Kolmogorov and Smirnov's)",
    )
    yield make_row(
        "standard deviation of the refocused image over that of one image, times root N",
        1.0,
        [_ratio(frame, np.ones_like(frame.near)) for frame in frames],
        "1 for independent images",
    )
    yield make_row(
        "the same without particles in focus",
        1.0,
        [_ratio(frame, frame.away) for frame in frames],
        f"at {_AWAY} voxels or more from all particles",
    )
    above = [frame.refocused > _threshold(frame) for frame in frames]
    yield make_row(
        f"threshold at {_K:g} standard deviations: particles that stay, %",
        None,
        [float(100.0 * np.mean(frame.bright > _threshold(frame))) for frame in frames],
    )
    yield make_row(
        f"threshold at {_K:g} standard deviations: light that is near particles, %",
        None,
        [
            float(100.0 * frame.refocused[mask & frame.near].sum() / frame.refocused[mask].sum())
            for frame, mask in zip(frames, above, strict=True)
        ],
        f"by chance {100.0 * frames[0].near.mean():.1f}",
    )


def _ratio(frame: _Grey, where: Bool) -> float:
    """Divide the deviation by that of a mean of N independent images."""
    expected = frame.single[where].std() / np.sqrt(frame.cameras)
    return float(frame.refocused[where].std() / expected)


def _threshold(frame: _Grey) -> float:
    return float(frame.refocused.mean() + _K * frame.refocused.std())


def _distance_to_normal(values: F32) -> float:
    """Compute Kolmogorov and Smirnov's distance to a normal distribution.

    The normal one has the mean and standard deviation of the values.
    """
    scaled = (values.ravel().astype(np.float64) - values.mean()) / values.std()
    return float(kstest(scaled, "norm", method="asymp").statistic)


def _rows_of_density(panels: dict[str, list[_Grey]]) -> Iterator[Row]:
    ratios, levels = {}, []
    for name, frames in panels.items():
        values = [frame.signal_to_noise for frame in frames]
        ratios[name] = float(np.mean(values))
        yield make_row(f"{name}: particles over the mean, in standard deviations", None, values)
        scale = [float(frame.bright.mean()) for frame in frames]
        pairs = list(zip(frames, scale, strict=True))
        mean = [float(frame.refocused.mean()) / size for frame, size in pairs]
        std = [float(frame.refocused.std()) / size for frame, size in pairs]
        yield make_row(f"{name}: mean over a particle's value", None, mean)
        yield make_row(f"{name}: standard deviation over a particle's value", None, std)
        levels.append((float(np.mean(mean)), float(np.mean(std))))
    simulated = np.array(levels[1:])
    yield claim(
        "mean and standard deviation of refocused images",
        "increase with the density",
        None,
        bool((np.diff(simulated, axis=0) > 0.0).all()),
    )
    experiment, *others = ratios.values()
    yield claim(
        "particles stand out in simulated images over those in the experiment's",
        "much less",
        max(others) / experiment,
        max(others) < 0.5 * experiment,
    )


def _pictures(name: str, frame: _Grey) -> Iterator[Figure]:
    """Draw zoomed views of an image, a refocused plane, and what a threshold keeps."""
    plane = frame.refocused[_PLANES // 2]
    shown = {
        "one image": frame.raw,
        "refocused": plane,
        "above the threshold": np.where(plane > _threshold(frame), plane, np.float32(0.0)),
    }
    panels = tuple(_zoom(title, values, _CROPS[name]) for title, values in shown.items())
    yield Figure(name, f"Figure {name[4:]}: zoomed views", panels)


def _zoom(title: str, values: F32, size: int) -> Panel:
    top, left = (max((length - size) // 2, 0) for length in values.shape)
    part = values[top : top + size, left : left + size].astype(np.float64)
    part = np.minimum(part, np.quantile(part, 0.999))
    return image_panel(title, part)


def _histograms(name: str, frame: _Grey) -> Figure:
    return Figure(
        name,
        "Figure 2-4: grey values, and normal distributions of the same mean and deviation",
        (_histogram("one mapped image", frame.single), _histogram("refocused", frame.refocused)),
    )


def _histogram(title: str, values: F32) -> Panel:
    high = float(np.quantile(values, 0.9995))
    density, edges = np.histogram(values, bins=_BINS, range=(float(values.min()), high))
    middle = (edges[1:] + edges[:-1]) / 2.0
    share = density / values.size / np.diff(edges)
    mean, std = float(values.mean()), float(values.std())
    normal = np.exp(-0.5 * ((middle - mean) / std) ** 2) / std / np.sqrt(2.0 * np.pi)
    levels = list(middle)
    curves = Curve("measured", levels, list(share)), Curve("normal", levels, list(normal))
    return Panel(title, "value, 1 = a bright particle", "density", curves)
