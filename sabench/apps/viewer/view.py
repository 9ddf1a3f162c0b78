"""Views of rigs, data sets and results: pages, and what notebooks show.

A page is one HTML file of data, script and library. Drawings along two edges of the volume need no
script.
"""

from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

from markupsafe import Markup

from sabench.apps.viewer.contents import PageContents, of_cameras, of_dataset, of_scene
from sabench.apps.viewer.outlines import STYLE
from sabench.apps.viewer.page_content import encode_contents
from sabench.apps.viewer.surroundings import draw_surroundings
from sabench.dataset.reader import Dataset, datasets_in, open_dataset
from sabench.dataset.results import open_result, read_dataset_names
from sabench.dataset.schema import MANIFEST
from sabench.dataset.verification import probe, probe_dataset
from sabench.interop.cameras import read_camera_source
from sabench.plotting.kinds import COLOURS
from sabench.plotting.page import escape_code, inline_code, inline_json, render_page
from sabench.scenes import Scene, load_scene
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing, is_file, is_folder
from sabench.utils.version import __version__

_FOLDER = Path(__file__).with_name("page")
_SCRIPTS = ("base", "colours", "raster", "space", "rig", "objects", "planes", "images", "main")


def render_contents(contents: PageContents) -> tuple[str, list[str]]:
    """Render contents as a self-contained page; say also what is left out."""
    values, arrays, notes = encode_contents(contents)
    content = {
        "title": contents.title,
        "facts": contents.facts,
        "notes": notes,
        "counts": _count_rows(contents),
        "frames": [f"{frame.time_s:.6g}" for frame in contents.frames],
        "cameras": _camera_rows(contents),
        "drawings": [Markup(svg) for _, svg in draw_surroundings(contents.surroundings)],
        "version": __version__,
        "data": inline_json(values),
        "arrays": arrays,
    }
    colours = "".join(f"--{kind}: {colour}; " for kind, colour in COLOURS.items())
    code = inline_code(_FOLDER, _SCRIPTS, _library(), f"{STYLE}:root {{ {colours}}}\n")
    template = (_FOLDER / "page.html.j2").read_text(encoding="utf-8")
    return render_page(template, content | code), notes


@cache
def _library() -> str:
    return escape_code((_FOLDER / "three.min.js").read_text(encoding="utf-8"))


def _count_rows(contents: PageContents) -> list[tuple[str, list[int]]]:
    """List the kinds of particles and bubbles with their numbers in every frame."""
    return [
        (f"{sort}: {contents.labels.get(kind, kind)}", numbers)
        for sort, kinds in contents.totals().items()
        for kind, numbers in kinds.items()
    ]


def _camera_rows(contents: PageContents) -> list[tuple[str, str, Any]]:
    """List name, position and image size of each camera."""
    return [
        (
            camera.name,
            ", ".join(f"{value:.5g}" for value in camera.center_mm),
            f"{camera.rows} x {camera.columns}",
        )
        for camera in contents.surroundings.cameras
    ]


_RESULTS = (".h5", ".hdf5")
_HEIGHT_PX = 760  # height of a view in a notebook


@dataclass(frozen=True)
class View:
    """Page that shows a rig, a data set or a result in space.

    A notebook shows it as the last value of a cell.

    Attributes
    ----------
    html : the page, which needs no other file.
    notes : sentences on what it leaves out.
    summary : numbers of what it shows.
    """

    html: str
    notes: tuple[str, ...]
    summary: dict[str, int]

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the page to a file.

        Raises an InputError if there is one that may not be replaced.
        """
        with complete_or_nothing(Path(path), overwrite=overwrite) as partial:
            partial.write_text(self.html, encoding="utf-8")
        return Path(path)

    def _repr_html_(self) -> str:
        """Return a frame that holds the page, apart from the notebook's own scripts."""
        return (
            f'<iframe sandbox="allow-scripts" srcdoc="{escape(self.html)}" title="sabench view" '
            f'style="width: 100%; height: {_HEIGHT_PX}px; border: 0"></iframe>'
        )


def view(source: Scene | Dataset | str | Path, result: str | Path | None = None) -> View:
    """Show a rig, a data set or a result in space.

    Parameters
    ----------
    source : a scene, a scene file or the name of a bundled scene; `cameras.json` of calibrated
        cameras, or the folder with it; a data set; or a result file with its data set in the same
        folder or directly below it.
    result : result of the data set.

    Raises
    ------
    InputError
        Something else, a result of another data set, or none where it is looked for.
    """
    contents = _collect(source, result)
    html, notes = render_contents(contents)
    summary = {
        "cameras": len(contents.surroundings.cameras),
        "frames": len(contents.frames),
        "particles": sum(len(frame.particles) for frame in contents.frames),
        "bubbles": sum(len(frame.bubbles) for frame in contents.frames),
        "bytes": len(html.encode()),
    }
    return View(html, tuple(notes), summary)


def _collect(source: Scene | Dataset | str | Path, result: str | Path | None) -> PageContents:
    if result is not None and isinstance(source, Scene):
        raise InputError(f"{source.title}: expected the data set of {result}, got a scene")
    if isinstance(source, Scene):
        return of_scene(source, source.title)
    if isinstance(source, Dataset) or is_file(Path(source) / MANIFEST):
        return _of_dataset(source, result)
    if result is not None:
        raise InputError(f"{source}: expected the data set of {result}, found none there")
    path = Path(source)
    if path.suffix in _RESULTS:
        return _of_dataset(_find_dataset(path), path)
    if path.suffix == ".json" or is_folder(path):
        cameras, grid = read_camera_source(path)
        return of_cameras(cameras, grid, str(source))
    return of_scene(load_scene(source), str(source))


def _of_dataset(source: Dataset | str | Path, result: str | Path | None) -> PageContents:
    """Collect a data set and a result, after probing the files of both."""
    if not isinstance(source, Dataset):
        probe_dataset(Path(source))
    data = source if isinstance(source, Dataset) else open_dataset(source)
    if result is None:
        return of_dataset(data)
    if is_file(Path(result)):
        probe(Path(result))
    return of_dataset(data, open_result(result, data))


def _find_dataset(result: Path) -> Dataset:
    """Find a result's data set in its folder, or directly below it."""
    if not is_file(result):
        raise InputError(f"{result}: expected a result file, found none")
    probe(result)
    names = read_dataset_names(result)
    home = result.absolute().parent
    for data in datasets_in(home):
        if names.fits(data):
            probe_dataset(data.root)
            return data
    raise InputError(
        f"{result}: expected its data set in {home} or directly below it, found none: "
        "run `sabench view DATASET RESULT`"
    )
