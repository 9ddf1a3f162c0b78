"""Reader of data sets for napari: images, and where true particles are in them.

napari finds it by `napari.yaml` and the entry point of that name; it needs napari (extra `napari`),
which is not imported here. Layers are as napari's readers return them: (data, options, type).
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from sabench.dataset.reader import Dataset, open_dataset
from sabench.utils.arrays import F64, U16
from sabench.utils.errors import InputError

_Layer = tuple[Any, dict[str, Any], str]


class _Frames:
    """Images (frame, row, column) of one camera, each read when it is asked for."""

    dtype = np.dtype(np.uint16)
    ndim = 3

    def __init__(self, data: Dataset, camera: int) -> None:
        self._data, self._camera = data, camera
        self.shape = (data.setup.frames, *data.raw_image(camera, 0).shape)

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, key: Any) -> U16:
        first, *others = key if isinstance(key, tuple) else (key,)
        frames = np.arange(len(self))[first]
        if np.ndim(frames) == 0:
            image: U16 = self._data.raw_image(self._camera, int(frames))[tuple(others)]
            return image
        images = [self._data.raw_image(self._camera, int(frame))[tuple(others)] for frame in frames]
        return np.stack(images)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> U16:
        return np.asarray(self[:], dtype=dtype)


def get_reader(path: str | list[str]) -> Callable[[str | list[str]], list[_Layer]] | None:
    """Return the reader of a data set's folder, or None for anything else."""
    try:
        open_dataset(_first(path))
    except InputError:  # a folder of another program, for another reader
        return None
    return read_layers


def read_layers(path: str | list[str]) -> list[_Layer]:
    """Return a layer of images of each camera, and one of its true particles.

    Raises InputError if the folder is no data set.
    """
    data = open_dataset(_first(path))
    layers: list[_Layer] = []
    for number, camera in enumerate(data.setup.cameras):
        shown = {"name": camera.name, "visible": number == 0}
        layers.append((_Frames(data, number), shown | {"colormap": "gray"}, "image"))
        if data.has_truth and "particles" in data.shows:
            shown = shown | {"name": f"{camera.name} particles"}
            style = {"size": 3, "face_color": "transparent", "border_color": "cyan"}
            places: list[F64] = []
            for frame in range(data.setup.frames):
                view = data.views(frame)[number]
                column, row = view.pixel[view.visible].T
                places.append(np.column_stack([np.full(len(row), frame), row, column]))
            layers.append((np.concatenate(places), shown | style, "points"))
    return layers


def _first(path: str | list[str]) -> str:
    return path if isinstance(path, str) else path[0]
