"""Charts: every curve and histogram is drawn at its position."""

import cv2
import numpy as np
import numpy.typing as npt

from sabench.plotting.drawing import Curve, Figure, Histogram, Panel, draw

_BLUE, _ORANGE = (0xB2, 0x72, 0x00), (0x00, 0x5E, 0xD5)  # as OpenCV orders them


def picture(*content: Curve | Histogram, log: str = "", panels: int = 1) -> npt.NDArray[np.uint8]:
    png = draw(Figure("f", "a figure", (Panel("a panel", "x", "y", content, log),) * panels))
    shown = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(shown, dtype=np.uint8)


def where(image: npt.NDArray[np.uint8], colour: tuple[int, int, int]) -> npt.NDArray[np.int64]:
    return np.argwhere((image == np.array(colour, dtype=np.uint8)).all(axis=2))


def test_curves_have_colours_and_directions() -> None:
    image = picture(
        Curve("rises", [0.0, 1.0, 2.0], [0.0, 1.0, 2.0]),
        Curve("falls", [0.0, 1.0, 2.0], [2.0, 1.0, 0.0], [0.1, 0.1, 0.1]),
    )
    for colour, sign in ((_BLUE, -1.0), (_ORANGE, 1.0)):
        row, column = where(image[:, :350], colour).T
        assert len(row) > 50
        assert np.sign(np.polyfit(column, row, 1)[0]) == sign


def test_powers_are_straight_on_logarithmic_axes() -> None:
    x = [1.0, 10.0, 100.0, 1000.0]
    row, column = where(picture(Curve("", x, [value**2 for value in x]), log="xy"), _BLUE).T
    assert abs(np.corrcoef(row, column)[0, 1]) > 0.999


def test_histograms_are_densities_over_common_bins() -> None:
    rng = np.random.default_rng(1)
    image = picture(
        Histogram("narrow", rng.normal(0.0, 1.0, 5000)),
        Histogram("wide", rng.normal(0.0, 3.0, 5000)),
    )
    tops = [where(image[60:], colour)[:, 0].min() for colour in (_BLUE, _ORANGE)]
    assert tops[0] < tops[1]


def test_panels_stand_three_or_four_beside_each_other() -> None:
    curve = Curve("", [0.0, 1.0], [0.0, 1.0])
    one, three, four, five = (picture(curve, panels=count).shape for count in (1, 3, 4, 5))
    assert three[1] == five[1] == 3 * one[1]
    assert four[1] == 4 * one[1]
    assert four[0] == three[0]
    assert five[0] > 1.5 * three[0]


def test_panels_with_the_same_labels_have_one_legend_below() -> None:
    one, other = (Curve(name, [0.0, 1.0], [0.5, 1.0]) for name in ("first", "second"))
    for panels, below in ((1, False), (2, True)):
        image = picture(one, other, panels=panels)
        lowest = where(image, _BLUE)[:, 0].max() / len(image)
        assert (lowest > 0.93) == below


def test_equal_figures_are_equal_pictures() -> None:
    figure = Figure("f", "t", (Panel("", "x", "y", (Curve("", [1.0, 2.0], [3.0, 4.0]),)),))
    assert draw(figure) == draw(figure)
