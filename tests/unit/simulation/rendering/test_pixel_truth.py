"""True view of bubbles per pixel, against equations solved in the test."""

from __future__ import annotations

import numpy as np

from sabench.api.truth import NOTHING
from sabench.simulation.rendering.pixel_truth import meets, see
from tests.unit.simulation.rendering.test_bubbles_traced import WALL, bubbles, camera


def test_a_contour_is_where_lines_of_sight_touch() -> None:
    lens = camera(80, 100, x=40.0)
    what = bubbles([[1.0, -2.0, 40.0], [-3.0, 3.0, 70.0]], [[2.0, 1.2, 1.7], [0.3, 0.3, 0.3]])
    seen = see(lens, what)
    for n in range(2):
        rays = lens.back_project(seen.contour[n].astype(np.float64))
        p = (rays.origins_mm - what.center_mm[n]) @ what.to_ball[n].T
        d = rays.directions @ what.to_ball[n].T
        nearest = np.linalg.norm(
            p - (np.sum(p * d, axis=1) / np.sum(d * d, axis=1))[:, None] * d, axis=1
        )
        np.testing.assert_allclose(
            nearest, 1.0, atol=2e-4
        )  # contours are stored in single precision
        inwards = seen.pixel[n] + 0.98 * (seen.contour[n] - seen.pixel[n])
        assert meets(
            what[np.array([n])],
            *(lambda r: (r.origins_mm, r.directions))(lens.back_project(inwards)),
        ).all()


def test_pixels_see_the_first_bubble_at_its_depth() -> None:
    lens = camera(40, 60)
    what = bubbles([[0.0, 0.0, 40.0], [1.5, 0.0, 60.0]], [[1.5, 1.5, 1.5], [2.0, 2.0, 2.0]])
    seen = see(lens, what)
    rows, columns = np.mgrid[0:40, 0:60]
    rays = lens.back_project(np.column_stack([columns.ravel(), rows.ravel()]).astype(float))
    best, number = np.full(2400, np.inf), np.full(2400, NOTHING)
    for n in range(2):
        offset = rays.origins_mm - what.center_mm[n]
        b, c = (
            np.sum(offset * rays.directions, axis=1),
            np.sum(offset**2, axis=1) - what.semi_axes_mm[n, 0] ** 2,
        )
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
    """Three bubbles that are partly or wholly hidden.

    One half behind a larger one, one wholly behind it, one half outside the image.
    """
    lens = camera(80, 100)
    (a, b), _ = lens.project(np.array([[0.0, 0.0, 40.0], [1.0, 0.0, 40.0]]))
    edge = (99.5 - a[0]) / (b[0] - a[0])
    what = bubbles(
        [[0.0, 0.0, 40.0], [0.0, 0.0, 55.0], [edge, 0.0, 40.0], [0.0, 6.0, 40.0]],
        [[3.0] * 3, [1.0] * 3, [1.0] * 3, [1.0] * 3],
    )
    seen = see(lens, what)
    np.testing.assert_allclose(seen.visible, [1.0, 0.0, 0.5, 1.0], atol=0.03)


def test_a_bubble_outside_the_image_is_not_seen() -> None:
    lens = camera(40, 40)
    seen = see(lens, bubbles([[80.0, 0.0, 50.0]], [[1.0] * 3]))
    assert seen.visible.tolist() == [0.0]
    assert (seen.number == NOTHING).all()


def test_nothing_is_there() -> None:
    seen = see(camera(16, 16), bubbles([], []))
    assert seen.visible.shape == (0,)
    assert seen.contour.shape == (0, 48, 2)
    assert np.isnan(seen.path_mm).all()
