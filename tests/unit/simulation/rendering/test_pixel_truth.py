"""True view of bubbles per pixel, against equations solved in the test."""

import numpy as np
import trimesh

from sabench.api.truth import BODY, NOTHING, Solid
from sabench.simulation.rendering.pixel_truth import _meet, meets, see
from tests.unit.simulation.rendering.test_bubbles_traced import WALL, bubbles, camera


def test_a_contour_is_where_lines_of_sight_touch() -> None:
    lens = camera(80, 100, x=40.0)
    what = bubbles([[1.0, -2.0, 40.0], [-3.0, 3.0, 70.0]], [[2.0, 1.2, 1.7], [0.3, 0.3, 0.3]])
    seen = see(lens, what)
    for n in range(2):
        rays = lens.back_project(seen.contour[n].astype(np.float64))
        p = (rays.origins_mm - what.center_mm[n]) @ what.to_ball[n].T
        d = rays.directions @ what.to_ball[n].T
        along = np.sum(p * d, axis=1) / np.sum(d * d, axis=1)
        nearest = np.linalg.norm(p - along[:, None] * d, axis=1)
        # contours are stored in single precision
        np.testing.assert_allclose(nearest, 1.0, atol=2e-4)
        for part, met in ((0.98, True), (1.02, False)):
            near = lens.back_project(seen.pixel[n] + part * (seen.contour[n] - seen.pixel[n]))
            assert (meets(what[np.array([n])], near.origins_mm, near.directions) == met).all()


def test_pixels_see_the_first_bubble_at_its_depth() -> None:
    lens = camera(40, 60)
    what = bubbles([[0.0, 0.0, 40.0], [1.5, 0.0, 60.0]], [[1.5, 1.5, 1.5], [2.0, 2.0, 2.0]])
    seen = see(lens, what)
    rows, columns = np.mgrid[0:40, 0:60]
    rays = lens.back_project(np.column_stack([columns.ravel(), rows.ravel()]).astype(float))
    best, number = np.full(2400, np.inf), np.full(2400, NOTHING)
    for n in range(2):
        offset = rays.origins_mm - what.center_mm[n]
        b = np.sum(offset * rays.directions, axis=1)
        c = np.sum(offset**2, axis=1) - what.semi_axes_mm[n, 0] ** 2
        with np.errstate(invalid="ignore"):
            distance = -b - np.sqrt(b * b - c)
        closer = np.isfinite(distance) & (distance < best)
        best[closer], number[closer] = distance[closer], n
    np.testing.assert_array_equal(seen.number.ravel(), number)
    hit = number >= 0
    places = rays.origins_mm + np.where(hit, best, 0.0)[:, None] * rays.directions
    np.testing.assert_allclose(seen.depth_mm.ravel()[hit], WALL.depth_of(places)[hit], atol=1e-3)
    assert np.isnan(seen.depth_mm.ravel()[~hit]).all()
    straight = np.linalg.norm(places - np.asarray(lens.center_mm), axis=1)[hit]
    assert (seen.path_mm.ravel()[hit] >= straight - 1e-3).all()  # light's way is bent
    assert (seen.path_mm.ravel()[hit] <= straight * 1.001).all()


def test_shares_are_those_of_discs() -> None:
    """One hidden wholly by a larger one, one half outside the image."""
    lens = camera(80, 100)
    (a, b), _ = lens.project(np.array([[0.0, 0.0, 40.0], [1.0, 0.0, 40.0]]))
    edge = (99.5 - a[0]) / (b[0] - a[0])
    what = bubbles(
        [[0.0, 0.0, 40.0], [0.0, 0.0, 55.0], [edge, 0.0, 40.0], [0.0, 6.0, 40.0]],
        [[3.0] * 3, [1.0] * 3, [1.0] * 3, [1.0] * 3],
    )
    np.testing.assert_allclose(see(lens, what).visible, [1.0, 0.0, 0.5, 1.0], atol=0.03)


def test_a_ball_is_seen_alike_as_a_bubble_and_as_a_body() -> None:
    """It hides half of what is behind it, and the second of two bodies has the next number."""
    lens = camera(60, 80, x=3.0)
    behind, ball, other = [1.4, 0.5, 60.0], [0.0, 0.5, 45.0], [4.0, -3.0, 50.0]
    mesh = trimesh.creation.icosphere(5, 1.5)
    bodies = [Solid(mesh.vertices + place, mesh.faces) for place in (ball, other)]
    plain = see(lens, bubbles([behind, ball, other], [[1.0] * 3, [1.5] * 3, [1.5] * 3]))
    seen = see(lens, bubbles([behind], [[1.0] * 3]), bodies)
    assert 0.2 < plain.visible[0] < 0.8
    np.testing.assert_allclose(seen.visible[0], plain.visible[0], atol=0.01)
    for number, body in ((0, 0), (1, BODY), (2, BODY - 1)):
        assert np.mean((plain.number == number) != (seen.number == body)) < 0.002
    both = (plain.number >= 0) & (seen.number != NOTHING)
    np.testing.assert_allclose(seen.depth_mm[both], plain.depth_mm[both], atol=0.03)
    np.testing.assert_allclose(seen.path_mm[both], plain.path_mm[both], atol=0.03)


def test_light_s_way_in_glass_is_longer_than_it_is_wide() -> None:
    """Path lengths follow from crossings of the wall's faces that are found one by one."""
    lens = camera(20, 30, focal=150.0)
    seen = see(lens, bubbles([[0.0, 0.0, 90.0]], [[70.0] * 3]))
    rows, columns = np.mgrid[0:20, 0:30]
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    leaving = lens.directions(pixels)[0]
    air = 550.0 / leaving[:, 2]  # the pinhole lies 550 mm in front of the wall
    sine = np.hypot(leaving[:, 0], leaving[:, 1]) / 1.52
    glass = 8.0 / np.sqrt(1.0 - sine**2)
    rays = lens.back_project(pixels)
    water = (seen.depth_mm.ravel() - 8.0) / rays.directions[:, 2]
    assert np.isfinite(water).sum() > 300
    np.testing.assert_allclose(seen.path_mm.ravel(), air + glass + water, rtol=1e-5)


def test_a_bubble_outside_the_image_is_not_seen_nor_one_that_is_not_there() -> None:
    seen = see(camera(40, 40), bubbles([[80.0, 0.0, 50.0]], [[1.0] * 3]))
    assert seen.visible.tolist() == [0.0]
    assert (seen.number == NOTHING).all()
    seen = see(camera(16, 16), bubbles([], []))
    assert seen.visible.shape == (0,)
    assert seen.contour.shape == (0, 48, 2)
    assert np.isnan(seen.path_mm).all()


def test_the_kernel_that_meets_bubbles_reads_nothing_beyond_its_arrays() -> None:
    """As plain Python, which refuses an index beyond an array, it finds the same."""
    rng = np.random.default_rng(5)
    what = bubbles(
        [[0.0, 0.0, 40.0], [6.0, -4.0, 55.0], [-5.0, 3.0, 70.0]],
        [[2.0, 1.2, 1.7], [3.0] * 3, [1.0] * 3],
    )
    starts = np.column_stack([rng.uniform(-8.0, 8.0, (60, 2)), np.zeros(60)])
    directions = np.column_stack([rng.normal(0.0, 0.05, (60, 2)), np.ones(60)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    plain = np.zeros(60, dtype=np.bool_)
    reach = what.semi_axes_mm.max(axis=1)
    _meet.py_func(slice(0, 60), starts, directions, what.center_mm, what.to_ball, reach, plain)
    assert 5 < plain.sum() < 55
    np.testing.assert_array_equal(meets(what, starts, directions), plain)
