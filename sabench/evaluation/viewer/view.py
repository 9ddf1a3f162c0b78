"""Views of rigs, data sets and results: pages, and what notebooks show."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path

from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result, read_dataset_names
from sabench.dataset.schema import MANIFEST
from sabench.dataset.verification import probe, probe_dataset
from sabench.evaluation.viewer.contents import Contents, of_cameras, of_dataset, of_scene
from sabench.evaluation.viewer.page import render
from sabench.interop.cameras import read_camera_source
from sabench.scenes import Scene, load_scene
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing, is_file, is_folder

_RESULTS = (".h5", ".hdf5")
_HEIGHT_PX = 760  # in a notebook


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
        cameras, or the folder with it; a data set; or a result file, whose data set lies in the
        same folder or directly below it.
    result : result of the data set.

    Raises
    ------
    InputError
        Something else, a result of another data set, or none where it is looked for.
    """
    contents = _collect(source, result)
    html, notes = render(contents)
    summary = {
        "cameras": len(contents.surroundings.cameras),
        "frames": len(contents.frames),
        "particles": sum(len(one.particles) for one in contents.frames),
        "bubbles": sum(len(one.bubbles) for one in contents.frames),
        "bytes": len(html.encode()),
    }
    return View(html, tuple(notes), summary)


def _collect(source: Scene | Dataset | str | Path, result: str | Path | None) -> Contents:
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


def _of_dataset(source: Dataset | str | Path, result: str | Path | None) -> Contents:
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
    for root in (home, *sorted(home.iterdir())):
        if is_file(root / MANIFEST):
            try:
                data = open_dataset(root)
            except InputError:
                continue  # a broken one next to it is not asked for
            if names.fits(data):
                probe_dataset(root)
                return data
    raise InputError(
        f"{result}: expected its data set in {home} or directly below it, found none: "
        "run `sabench view DATASET RESULT`"
    )
