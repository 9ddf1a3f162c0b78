"""Positions from particle images, and maps of a box, against cameras' own projection."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.calibration.disparity import match_peaks, pair_up
from sabench.algorithms.particles import matching
from sabench.api import Observation
from sabench.geometry.volume_polynomials import VolumePolynomials, project_point, project_points
from sabench.images.peaks import Peaks, find_near, keep_peaks, sort_peaks
from sabench.simulation.in_memory import simulate
from sabench.utils.arrays import F64, Bool
from tests.helpers.particle_box import CAMERAS, COLUMNS, ROWS, Maps, distances, unit_points
from tests.helpers.particle_scenes import make_scene
from tests.helpers.refusals import check_sentence
from tests.helpers.small_particles import count_found, make_small


def images_of(points: F64, maps: Maps, cameras: int = 4) -> tuple[F64, ...]:
    """Exact pixels (n, 2) in each camera of points of the box from -1 to 1."""
    world = maps.middle_mm + maps.half_mm * points
    return tuple(one.project(world)[0] for one in CAMERAS[:cameras])


def peaks_of(pixels: tuple[F64, ...]) -> tuple[Peaks, ...]:
    return tuple(sort_peaks(own, (ROWS, COLUMNS)) for own in pixels)


def test_slopes_of_maps_are_their_differences(maps: Maps) -> None:
    pixel, slope = np.zeros(2), np.zeros((2, 3))
    for point in np.vstack([unit_points(5), np.zeros((1, 3))]):
        for number in range(4):
            project_point(maps, number, point, pixel, slope)
            assert_allclose(pixel, project_points(maps, number, point[None])[0])
            steps = 1e-5 * np.eye(3)
            ends = [project_points(maps, number, point + sign * steps) for sign in (1.0, -1.0)]
            assert_allclose(slope.T, (ends[0] - ends[1]) / 2e-5, atol=1e-4)


def open_sensors(cameras: int) -> Bool:
    return np.zeros((cameras, ROWS, COLUMNS), dtype=np.bool_)


@pytest.mark.slow
@pytest.mark.parametrize(("cameras", "count"), [(3, 1), (4, 30)])
def test_all_particles_are_found_where_they_are(maps: Maps, cameras: int, count: int) -> None:
    points = unit_points(count)
    peaks = peaks_of(images_of(points, maps, cameras))
    first = VolumePolynomials(np.ascontiguousarray(maps.coefficients[:cameras]), *maps[1:])
    found = matching.find_peak_sets(first, peaks, 0.1, open_sensors(cameras))
    assert distances(found.position, points, maps).max() < 2e-3
    assert found.error_px.max() < 0.1
    best = matching.select_best(found, peaks)
    assert len(best) == count
    for number in range(cameras):  # each particle image once
        assert sorted(found.hit[best, number]) == list(range(count))


@pytest.mark.slow
def test_a_camera_may_miss_a_particle_where_it_is_covered_or_off_its_sensor(maps: Maps) -> None:
    points = unit_points(10)
    pixels = images_of(points, maps)
    peaks = peaks_of((*pixels[:2], pixels[2][1:], pixels[3]))
    column, row = np.rint(pixels[2][0]).astype(int)
    covered = open_sensors(4)
    covered[2, row, column] = True
    strict, tolerant = (
        matching.find_peak_sets(maps, peaks, 0.1, area) for area in (open_sensors(4), covered)
    )
    assert distances(strict.position, points, maps)[0] > 0.1
    assert distances(strict.position, points[1:], maps).max() < 2e-3
    assert distances(tolerant.position, points, maps).max() < 2e-3
    lost = np.argmin(np.linalg.norm(tolerant.position - points[0], axis=1))
    assert np.flatnonzero(tolerant.hit[lost] < 0).tolist() == [2]
    # a sensor that ends before the particle's image misses nothing
    cut = matching.find_peak_sets(maps, peaks, 0.1, open_sensors(4)[:, :, : int(pixels[2][0, 0])])
    assert distances(cut.position, points[:1], maps)[0] < 2e-3


def test_each_peak_goes_to_the_complete_set_that_fits_best() -> None:
    hit = np.array([[0, 0, 0], [0, 1, 1], [1, 1, -1], [1, 2, 2], [2, 0, -1]])
    error = np.array([0.3, 0.1, 0.0, 0.2, 0.0])
    peaks = tuple(Peaks(np.zeros((3, 2)), np.zeros(2, dtype=np.int64), 1, 1) for _ in range(3))
    kept = matching.select_best(matching.PeakSets(np.zeros((5, 3)), hit, error), peaks)
    assert kept.tolist() == [1, 3, 4]


def matched(maps: Maps, peaks: tuple[Peaks, ...], radius: float) -> Any:
    """Positions and errors of the sets that self-calibration matches."""
    positions, errors = np.zeros((500, 3)), np.zeros((500, 4, 2))
    hits, order = np.zeros((500, 4), dtype=np.int64), np.arange(len(peaks[0].pixels))
    count = match_peaks(maps, peaks, order, radius, 2, 200, positions, hits, errors)
    return positions[:count], errors[:count]


@pytest.mark.slow
def test_matches_fit_their_images_best(maps: Maps) -> None:
    """The errors of a match have no part along the slopes of its position: least squares."""
    points = unit_points(12)
    pixels = images_of(points, maps)
    positions, errors = matched(maps, peaks_of(pixels), 0.5)
    assert distances(positions, points, maps).max() < 2e-3
    assert np.abs(errors[np.linalg.norm(errors, axis=2).max(axis=1) < 0.01]).max() < 0.01
    off = (*pixels[:-1], pixels[-1] + np.array([0.0, 0.5]))
    positions, errors = matched(maps, peaks_of(off), 0.7)
    assert distances(positions, points, maps).max() < 0.1
    near = np.linalg.norm((positions - points[:, None]) * maps.half_mm, axis=2).argmin(axis=1)
    for number, point in zip(near, points, strict=True):
        pixel, slope, gradient = np.zeros(2), np.zeros((2, 3)), np.zeros(3)
        for one in range(4):
            project_point(maps, one, point, pixel, slope)
            gradient += slope.T @ errors[number, one]
        assert np.abs(gradient).max() < 0.02 * np.abs(slope).max()
    assert len(matched(maps, peaks_of((*pixels[:-1], pixels[-1] + [0.0, 3.0])), 0.5)[0]) < 12


def test_a_line_of_sight_is_followed_as_far_as_the_box_goes(maps: Maps) -> None:
    here, slope = np.zeros(2), np.zeros((2, 3))
    for goal in ([0.3, 0.4, -0.5], [0.3, 1.3, -0.5], [-1.2, 0.2, 0.6], [0.9, -1.1, 0.0]):
        pixel = project_points(maps, 0, np.array([goal]))[0]
        position = np.array([0.0, 0.0, goal[2]])
        inside = matching.move_to_pixel(maps, pixel, position, 2, here, slope)
        assert inside == (max(np.abs(goal)) <= 1.0)
        if inside:
            assert_allclose(position, goal, atol=1e-4)


def test_pairs_are_those_within_the_radius_until_the_room_is_full() -> None:
    rng = np.random.default_rng(4)
    peaks = sort_peaks(rng.uniform(0.0, 60.0, (40, 2)), (60, 60))
    pixels, out = rng.uniform(0.0, 60.0, (50, 2)), np.zeros((500, 2), dtype=np.int64)
    count = pair_up(peaks, pixels, 5.0, out)
    near = np.linalg.norm(pixels[:, None] - peaks.pixels[None], axis=2) <= 5.0
    assert {*map(tuple, out[:count].tolist())} == {*map(tuple, np.argwhere(near).tolist())}
    assert pair_up(peaks, pixels, 5.0, out[:7]) == 7


def test_particles_are_looked_for_in_whole_border_voxels() -> None:
    case = simulate(make_scene(particles={"count": 5}), seed=1).observation
    maps, grid = matching.fit_cameras(case), case.grid
    low = np.asarray(grid.low_mm) - np.asarray(grid.voxel_mm) / 2.0
    assert (maps.middle_mm - maps.half_mm < low).all()
    high = low + np.asarray(grid.shape[::-1]) * np.asarray(grid.voxel_mm)
    assert (maps.middle_mm + maps.half_mm > high).all()


def straight_and_oblique(*tilts: float) -> VolumePolynomials:
    """Cameras that see z as a displacement by so many pixels, and one that sees y so."""
    axes = [[[70.0, 60.0], [40.0, 0.0], [0.0, 30.0], [tilt, 0.0]] for tilt in tilts]
    axes.append([[70.0, 60.0], [40.0, 0.0], [0.0, 30.0], [0.0, 20.0]])
    powers = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return VolumePolynomials(np.array(axes), powers, np.zeros(3), np.ones(3))


@pytest.mark.slow
@pytest.mark.parametrize("tilts", [(25.0, 0.0), (0.0, 25.0), (25.0, -25.0)])
def test_lines_of_sight_are_followed_closely(tilts: tuple[float, float]) -> None:
    maps = straight_and_oblique(*tilts)
    for point in np.array([[0.1, -0.2, z] for z in (-0.99, -0.4, 0.1, 0.63, 0.99)]):
        peaks = peaks_of(tuple(project_points(maps, number, point[None]) for number in range(3)))
        found = matching.find_peak_sets(maps, peaks, 0.5, open_sensors(3))
        assert len(found.position) == 1
        assert_allclose(found.position[0], point, atol=1e-6)


@pytest.mark.slow
def test_steps_along_a_line_of_sight_run_from_the_front_of_the_box_to_its_back() -> None:
    maps = straight_and_oblique(0.0, 25.0, -10.0)
    for point in ([0.1, -0.2, -0.99], [0.1, -0.2, 0.01], [0.1, -0.2, 0.99]):
        pixels = [project_points(maps, number, np.array([point])) for number in range(4)]
        peaks = peaks_of(tuple(pixels))
        positions, errors = np.zeros((5, 3)), np.zeros((5, 4, 2))
        hits, order = np.zeros((5, 4), dtype=np.int64), np.arange(1)
        assert match_peaks(maps, peaks, order, 0.5, 2, 3, positions, hits, errors) == 1
        assert_allclose(positions[0], point, atol=1e-6)


CLOCK = "sabench.utils.threads.time.monotonic"


def solve(case: Observation, **changes: Any) -> Any:
    return matching.triangulate_particles(
        case, matching.fit_cameras(case), matching.TriangulationSettings(**changes)
    )


def noisy(case: Observation, black: float = 0.0) -> Observation:
    """The same cameras with noise that is cut at black, and no particles."""
    rng = np.random.default_rng(1)
    images = np.clip(np.rint(rng.normal(black, 0.8, case.images.shape)), 0, 255).astype(np.uint16)
    return replace(case, images=images, black_dn=black, white_dn=255.0)


@pytest.mark.slow
def test_a_long_budget_changes_nothing() -> None:
    case = make_small(3).observation
    found, limited = solve(case), solve(case, budget_s=1e6)
    assert len(found.position_mm) > 10
    assert np.array_equal(found.position_mm, limited.position_mm)


@pytest.mark.slow
def test_a_spent_budget_is_said_and_gives_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    shot = make_small(3)
    counts = []
    monkeypatch.setattr(matching, "_BATCH", 8)
    for ticks in (1.0, 8.0):
        monkeypatch.setattr(CLOCK, itertools.count().__next__)
        with pytest.warns(UserWarning, match=f"{ticks:g} s") as heard:
            found = solve(shot.observation, budget_s=ticks)
        check_sentence(str(heard[0].message))
        counts.append(len(found.position_mm))
        if len(found.position_mm):
            assert count_found(shot, found).precision > 0.9
    assert counts[0] == 0 < counts[1] < len(solve(shot.observation).position_mm)


def test_noise_without_particles_makes_none() -> None:
    assert len(solve(noisy(make_small(3).observation), floor=1e-6).position_mm) == 0


@pytest.mark.slow
def test_peaks_that_agree_by_chance_are_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    case = noisy(make_small(3).observation, black=20.0)
    monkeypatch.setattr(matching, "_MOST_BY_CHANCE", 0.01)
    with pytest.warns(UserWarning, match="camera_00") as heard:
        many = solve(case, floor=1e-6, false_alarms=0.3)
    check_sentence(str(heard[0].message), "0.01")
    monkeypatch.undo()
    assert len(many.position_mm) < len(solve(case, floor=1e-6, false_alarms=0.3).position_mm)


def test_the_number_of_sets_by_chance_is_about_right() -> None:
    case = make_small(3).observation
    rng, maps = np.random.default_rng(2), matching.fit_cameras(case)
    rows, columns = case.images.shape[1:]
    peaks = tuple(
        sort_peaks(rng.uniform([1.0, 1.0], [columns - 2.0, rows - 2.0], (400, 2)), (rows, columns))
        for _ in case.cameras
    )
    found = matching.find_peak_sets(maps, peaks, 0.8, np.zeros(case.images.shape, dtype=np.bool_))
    expected = matching.count_by_chance(maps, peaks, 0.8, rows * columns)
    assert 0.2 < len(found.position) / 400.0 / expected < 1.5


def test_peaks_that_are_kept_are_found_near() -> None:
    rng = np.random.default_rng(3)
    peaks = sort_peaks(rng.uniform(0.0, 60.0, (200, 2)), (60, 60))
    numbers = np.flatnonzero(rng.random(200) < 0.3)
    kept = keep_peaks(peaks, numbers)
    assert np.array_equal(kept.pixels, peaks.pixels[numbers])
    room = np.zeros(64, dtype=np.int64)
    for number, pixel in enumerate(kept.pixels):
        assert room[: find_near(kept, pixel, 0.01, room)].tolist() == [number]
    none: Peaks = keep_peaks(peaks, np.zeros(0, dtype=np.int64))
    assert find_near(none, np.array([30.0, 30.0]), 20.0, room) == 0
