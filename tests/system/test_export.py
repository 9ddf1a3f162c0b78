"""What other programs get: read back by VTK itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.api import Velocity
from sabench.dataset.read import Dataset, open_dataset
from sabench.dataset.result import open_result, result_writer
from sabench.flows import vorticity
from sabench.motion import flow_of
from sabench.plugins import load
from sabench.scoring import true_field
from tests.conftest import Command

vtk = pytest.importorskip("vtkmodules.vtkIOHDF", reason="needs the package vtk")


def opened(path: Path) -> tuple[Any, dict[str, Any]]:
    """What VTK's reader makes of a file, and its point data."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader = vtk.vtkHDFReader()
    told: list[str] = []
    reader.AddObserver("ErrorEvent", lambda *_: told.append("error"))
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.Update()
    assert not told
    data = reader.GetOutputDataObject(0)
    points = data.GetPointData()
    return data, {points.GetArrayName(number): vtk_to_numpy(points.GetArray(number)) for number in range(points.GetNumberOfArrays())}


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    from sabench.generation import generate
    from tests.system.test_velocimetry_chain import vortex_scene

    scene = vortex_scene(frames=2, flow_grid_mm=[1.0, 1.0, 0.5])
    return generate(scene, tmp_path_factory.mktemp("moving") / "data", seed=1, backend="splat")


def test_truth_is_what_vtk_reads(moving: Dataset, tmp_path: Path, command: Command) -> None:
    done = command("export", moving.root, "-o", tmp_path / "vtk", "--to", "vtk")
    assert done.returncode == 0, done.stderr
    names = [f"{kind}_{frame:04d}.vtkhdf" for kind in ("flow", "particles", "volume") for frame in range(2)]
    assert sorted(path.name for path in (tmp_path / "vtk").iterdir()) == names
    particles, grid = moving.particles(1), moving.rig.grid
    cloud, about = opened(tmp_path / "vtk/particles_0001.vtkhdf")
    assert cloud.GetNumberOfCells() == cloud.GetNumberOfPoints() == len(particles)
    np.testing.assert_allclose([cloud.GetPoint(number) for number in range(5)], particles.position_mm[:5], rtol=1e-6)
    np.testing.assert_allclose(about["velocity_mm_s"], particles.velocity_mm_s)
    image, values = opened(tmp_path / "vtk/volume_0000.vtkhdf")
    assert image.GetDimensions() == grid.shape[::-1]
    np.testing.assert_allclose((image.GetOrigin(), image.GetSpacing()), (grid.low_mm, grid.voxel_mm))
    np.testing.assert_array_equal(values["intensity"].reshape(grid.shape), true_field(grid, moving.particles(0), moving.views(0)))
    image, values = opened(tmp_path / "vtk/flow_0001.vtkhdf")
    assert image.GetDimensions() == (9, 9, 9)
    flow, node = flow_of(moving.scene), image.ComputePointId((2, 7, 3))
    assert flow is not None
    place = np.array([image.GetPoint(node)])
    np.testing.assert_allclose(values["velocity_mm_s"][node], flow.velocity(place, moving.rig.time_s(1))[0])
    np.testing.assert_allclose(values["vorticity_1_s"][node], vorticity(flow.gradient(place, moving.rig.time_s(1)))[0], atol=1e-9)


def test_results_are_what_vtk_reads(moving: Dataset, tmp_path: Path) -> None:
    from sabench.export import export

    rng = np.random.default_rng(0)
    field = Velocity((-1.0, -2.0, -0.5), (0.5, 1.0, 0.25), rng.random((5, 5, 5, 3)), rng.random((5, 5, 5)) > 0.2)
    with result_writer(tmp_path / "piv.h5", moving, "piv3d", "velocimetry", {}) as writer:
        writer.add_velocity(0, field)
    export(moving, tmp_path / "vtk", tmp_path / "piv.h5")
    image, values = opened(tmp_path / "vtk/velocity_0000.vtkhdf")
    assert image.GetDimensions() == (5, 5, 5)
    np.testing.assert_allclose(values["velocity_mm_s"].reshape(5, 5, 5, 3), field.velocity_mm_s)
    np.testing.assert_allclose(values["exact_mm_s"] + values["error_mm_s"], values["velocity_mm_s"])
    np.testing.assert_array_equal(values["valid"].reshape(5, 5, 5) > 0, field.valid)
    assert open_result(tmp_path / "piv.h5", moving).track == "velocimetry"


def test_an_exported_flow_carries_particles_again(moving: Dataset, tmp_path: Path) -> None:
    """What one run exports, `from_field` of another one reads."""
    from sabench.export import export

    export(moving, tmp_path / "vtk")
    plugin = load("generators", "from_field")
    given = {"file": str(tmp_path / "vtk/flow_0000.vtkhdf"), "velocity": ["velocity_mm_s"], "length": "mm", "speed": "mm/s"}
    again, flow = plugin(plugin.Parameters(**given)), flow_of(moving.scene)
    assert flow is not None
    places = np.random.default_rng(0).uniform(-1.5, 1.5, (50, 3)) + np.asarray(moving.scene.volume.center_mm)
    exact = flow.velocity(places, 0.0)
    np.testing.assert_allclose(again.velocity(places, 0.0), exact, atol=0.05 * np.abs(exact).max())


def test_what_cannot_be_exported_is_named(moving: Dataset, tmp_path: Path, command: Command) -> None:
    done = command("export", moving.root, "--to", "tecplot")
    assert (done.returncode, done.stderr) == (2, "sabench: to: expected vtk, got 'tecplot'\n")
    done = command("export", moving.root, tmp_path / "none.h5")
    assert done.returncode == 2
    assert "none.h5: expected an HDF5 file, found none" in done.stderr
    assert not (tmp_path / "vtk").exists()
    assert open_dataset(moving.root).content_hash == moving.content_hash
