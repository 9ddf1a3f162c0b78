"""Preview of preprocessing: one image after each step, and its peaks."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.dataset.reader import Dataset, open_dataset
from sabench.images.dark_noise import FALSE_ALARMS, DarkNoise, measure_dark_noise
from sabench.images.image_files import MOVIES, RAW
from sabench.images.image_reading import image_size, read_page
from sabench.images.levels import GreyValues
from sabench.images.peaks import find_above
from sabench.images.preprocessing import MatchHistograms, Step, preprocess, step_faults
from sabench.plotting.card import Card
from sabench.plotting.drawing import Figure, Panel, Picture, draw
from sabench.plotting.pictures import GAMMA
from sabench.utils.arrays import F64, U16, Bool
from sabench.utils.errors import InputError
from sabench.utils.number_text import format_number

_WINDOW_PX = 96  # edge of the part that is also shown enlarged
_INCH = 4.5  # width of a picture
_RING_PX = 3.0


@dataclass(frozen=True)
class PreviewStage:
    """Image after a step, and what is detected in it.

    Attributes
    ----------
    name : of the step.
    image : (row, column) grey values.
    dark : its dark level and noise.
    threshold_dn : median over its pixels of the grey value that a peak must reach.
    peaks : (n, 2) column and row of the peaks.
    expected_false : number of peaks that noise alone makes at most.
    """

    name: str
    image: U16
    dark: DarkNoise
    threshold_dn: float
    peaks: F64
    expected_false: float

    @property
    def black_dn(self) -> float:
        """Median of the dark level."""
        return float(np.median(self.dark.level))

    @property
    def noise_dn(self) -> float:
        """Median of the noise."""
        return float(np.median(self.dark.noise))


@dataclass(frozen=True, repr=False)
class Preview(Card):
    """Image of a camera after each step of preprocessing.

    Attributes
    ----------
    title : which image it is.
    stages : as it was recorded, after the repair of hot pixels and reflections, and after each
        step.
    """

    title: str
    stages: tuple[PreviewStage, ...]

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (f"{self.title}; medians over the pixels",)
        yield "after", "black", "noise", "threshold", "peaks", "false at most"
        for one in self.stages:
            figures = (one.black_dn, 1), (one.noise_dn, 2), (one.threshold_dn, 1)
            grey = (format_number(value, decimals) for value, decimals in figures)
            yield one.name, *grey, str(len(one.peaks)), format_number(one.expected_false, 1)

    def _picture(self) -> bytes:
        return draw(preview_figure(self))


def preview(
    source: Path,
    *,
    camera: str | None = None,
    frame: int = 0,
    steps: Sequence[Step] | None = None,
    false_alarms: float = FALSE_ALARMS,
) -> Preview:
    """Process one image of a data set or a file, and detect peaks after each step.

    Parameters
    ----------
    camera : name or number (from 0) of a camera of the data set; by default the first one.
    frame : of the data set, or page of the image file.
    steps : by default those of the data set, and none for an image file.
    false_alarms : probability that noise makes a peak of a pixel.

    Raises InputError for an unknown data set, image, camera or frame, an image without particles,
    or steps that need more images than there are.
    """
    if source.is_dir():
        return _of_dataset(open_dataset(source), camera, frame, steps, false_alarms)
    if camera is not None:
        raise InputError(f"--camera: expected a data set, got the image {source}")
    return _of_file(source, frame, steps or (), false_alarms)


def _of_dataset(
    data: Dataset, camera: str | None, frame: int, steps: Sequence[Step] | None, false_alarms: float
) -> Preview:
    if "particles" not in data.shows:
        raise InputError(
            f"{data.root}: expected images of particles, got images of {', '.join(data.shows)}"
        )
    chosen = data.setup.preprocessing if steps is None else steps
    _check(chosen, data.setup.frames)
    names = [one.name for one in data.setup.cameras]
    number = _number(camera, names)
    stages = [_stage("recorded", data.raw_image(number, frame), None, false_alarms)]
    for count, name in enumerate(["repaired", *(step.step for step in chosen)]):
        good = data.observation(frame, chosen[:count]).repaired
        unknown = good.flaws.unknown[number]
        stages.append(_stage(name, good.images[number], unknown, false_alarms))
    return Preview(f"{data.root.name}: {names[number]}, frame {frame}", tuple(stages))


def _number(camera: str | None, names: Sequence[str]) -> int:
    if camera is None:
        return 0
    if camera in names:
        return names.index(camera)
    if camera.isdecimal() and int(camera) < len(names):
        return int(camera)
    raise InputError(
        f"--camera: expected one of {', '.join(names)}, or 0 to {len(names) - 1}, got {camera!r}"
    )


def _check(steps: Sequence[Step], frames: int) -> None:
    for fault in step_faults(steps, frames):
        raise InputError(f"--step: {fault}")


def _of_file(path: Path, page: int, steps: Sequence[Step], false_alarms: float) -> Preview:
    from sabench.images.repair import repair  # numba is loaded at the first use

    _check(steps, 1)
    if any(isinstance(step, MatchHistograms) for step in steps):
        raise InputError(
            f"--step: match_histograms: expected a data set with several cameras, got {path}"
        )
    image = _read(path, page)
    values = GreyValues()
    values.add(image)
    levels = values.levels(values.bit_depth)
    good = repair(image[None], levels.black_dn, levels.white_dn)
    unknown = good.flaws.unknown[0]
    stages = [
        _stage("recorded", image, None, false_alarms),
        _stage("repaired", good.images[0], unknown, false_alarms),
    ]
    for count, step in enumerate(steps, 1):
        done = preprocess(good.images, levels.black_dn, levels.white_dn, steps[:count])[0]
        stages.append(_stage(step.step, done, unknown, false_alarms))
    return Preview(f"{path.name}, image {page}" if page else path.name, tuple(stages))


def _read(path: Path, page: int) -> U16:
    if not path.is_file():
        raise InputError(f"{path}: expected a data set folder or an image file, got none")
    if path.suffix.lower() in (*MOVIES, *RAW):
        raise InputError(
            f"{path}: expected a data set or a still image, got a movie or a raw file; make a data "
            "set of it with sabench import"
        )
    size = image_size(path)
    if size is None:
        raise InputError(f"{path}: expected an image, got none")
    return read_page(path, page, size)


def _stage(name: str, image: U16, unknown: Bool | None, false_alarms: float) -> PreviewStage:
    dark = measure_dark_noise(image[None], None if unknown is None else ~unknown)
    least = dark.threshold(false_alarms)
    counted = image.size if unknown is None else int((~unknown).sum())
    return PreviewStage(
        name,
        image,
        dark,
        float(np.median(least)),
        find_above(image, dark, least).pixels,
        false_alarms * counted,
    )


def preview_figure(shown: Preview) -> Figure:
    """Make a figure of the stages side by side, with an enlarged part below."""
    rows, columns = shown.stages[0].image.shape
    peaks = shown.stages[-1].peaks
    height, width = min(_WINDOW_PX, rows), min(_WINDOW_PX, columns)
    counts = np.zeros((rows // height, columns // width), dtype=np.int64)
    for column, row in peaks:
        i, j = int(row // height), int(column // width)
        if i < counts.shape[0] and j < counts.shape[1]:
            counts[i, j] += 1
    i, j = (int(n) for n in np.unravel_index(int(np.argmax(counts)), counts.shape))
    busy = slice(i * height, (i + 1) * height), slice(j * width, (j + 1) * width)
    wholes = [
        _panel(one, (slice(0, rows), slice(0, columns)), marked=False) for one in shown.stages
    ]
    parts = [_panel(one, busy, marked=True) for one in shown.stages]
    return Figure(
        "preview",
        shown.title,
        tuple(itertools.chain(wholes, parts)),
        across=len(shown.stages),
        inch=(_INCH, _INCH + 0.3),
    )


def _panel(stage: PreviewStage, window: tuple[slice, slice], *, marked: bool) -> Panel:
    """Draw part of an image; its peaks are marked by circles where it is enlarged."""
    down, across = window
    light = np.maximum(stage.image[window] - stage.dark.level[window], 0.0) ** GAMMA
    column, row = stage.peaks.T
    inside = (row >= down.start) & (row < down.stop)
    inside &= (column >= across.start) & (column < across.stop)
    rings = np.column_stack([stage.peaks[inside], np.full(inside.sum(), _RING_PX)])
    low = (float(across.start), float(down.start))
    high = (float(across.stop - 1), float(down.stop - 1))
    title = (
        f"{stage.name}, enlarged"
        if marked
        else f"{stage.name}: {len(stage.peaks)} peaks\nabove {stage.threshold_dn:.1f}; black "
        f"{stage.black_dn:.1f}, noise {stage.noise_dn:.2f}"
    )
    picture = Picture(light.astype(np.float64), low, high, rings if marked else None)
    return Panel(title, "column, px", "row, px", (picture,))
