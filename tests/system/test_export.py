"""Exported files, read back by VTK itself."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.api import Detections, FoundParticles, Velocity
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result, result_writer
from sabench.geometry.grid import vorticity
from sabench.interop import vtkhdf
from sabench.interop.export import export
from sabench.interop.vtkhdf import write_rig
from sabench.metrics.reconstruction_error import true_field
from sabench.plugins import load
from sabench.scenes import Scene
from sabench.simulation.pipeline import generate
from sabench.worlds.tracers import flow_of
from tests.conftest import Command
from tests.helpers.bubble_scenes import few_pixels, small
from tests.helpers.commands import refuse, succeed

vtk = pytest.importorskip("vtkmodules.vtkIOHDF", reason="needs the package vtk")


def opened(path: Path) -> tuple[Any, dict[str, Any]]:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader = vtk.vtkHDFReader()
    messages: list[str] = []
    reader.AddObserver("ErrorEvent", lambda *_: messages.append("error"))
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.Update()
    assert not messages
    data = reader.GetOutputDataObject(0)
    both = (data.GetPointData(), data.GetCellData())
    return data, {
        one.GetArrayName(number): vtk_to_numpy(one.GetArray(number))
        for one in both
        for number in range(one.GetNumberOfArrays())
    }


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    from tests.system.test_velocimetry_chain import vortex_scene

    scene = vortex_scene(frames=2, flow_grid_mm=[1.0, 1.0, 0.5])
    return generate(scene, tmp_path_factory.mktemp("moving") / "data", seed=1, backend="splat")


@pytest.mark.slow
def test_truth_is_what_vtk_reads(moving: Dataset, tmp_path: Path, command: Command) -> None:
    succeed(command("export", moving.root, "-o", tmp_path / "vtk", "--to", "vtk"))
    kinds = ("flow_0000", "flow_0001", "particles_0000", "particles_0001", "rig")
    names = {f"{kind}.vtkhdf" for kind in (*kinds, "volume_0000", "volume_0001")} | {"state.py"}
    assert {path.name for path in (tmp_path / "vtk").iterdir()} == names
    particles, grid = moving.particles(1), moving.setup.grid
    cloud, about = opened(tmp_path / "vtk/particles_0001.vtkhdf")
    assert cloud.GetNumberOfCells() == cloud.GetNumberOfPoints() == len(particles)
    np.testing.assert_allclose(
        [cloud.GetPoint(number) for number in range(5)], particles.position_mm[:5], rtol=1e-6
    )
    np.testing.assert_allclose(about["velocity_mm_s"], particles.velocity_mm_s)
    image, values = opened(tmp_path / "vtk/volume_0000.vtkhdf")
    assert image.GetDimensions() == grid.shape[::-1]
    np.testing.assert_allclose(
        (image.GetOrigin(), image.GetSpacing()), (grid.low_mm, grid.voxel_mm)
    )
    np.testing.assert_array_equal(
        values["intensity"].reshape(grid.shape),
        true_field(grid, moving.particles(0), moving.views(0)),
    )
    image, values = opened(tmp_path / "vtk/flow_0001.vtkhdf")
    assert image.GetDimensions() == (9, 9, 9)
    flow, node = flow_of(moving.scene), image.ComputePointId((2, 7, 3))
    assert flow is not None
    place = np.array([image.GetPoint(node)])
    np.testing.assert_allclose(
        values["velocity_mm_s"][node], flow.velocity(place, moving.setup.time_s(1))[0]
    )
    np.testing.assert_allclose(
        values["vorticity_1_s"][node],
        vorticity(flow.gradient(place, moving.setup.time_s(1)))[0],
        atol=1e-9,
    )


def test_results_are_what_vtk_reads(moving: Dataset, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    field = Velocity(
        (-1.0, -2.0, -0.5), (0.5, 1.0, 0.25), rng.random((5, 5, 5, 3)), rng.random((5, 5, 5)) > 0.2
    )
    with result_writer(tmp_path / "piv.h5", moving, "piv3d", "velocimetry", {}) as writer:
        writer.add(field, 0)
    export(moving, tmp_path / "vtk", tmp_path / "piv.h5")
    image, values = opened(tmp_path / "vtk/velocity_0000.vtkhdf")
    assert image.GetDimensions() == (5, 5, 5)
    np.testing.assert_allclose(values["velocity_mm_s"].reshape(5, 5, 5, 3), field.velocity_mm_s)
    np.testing.assert_allclose(values["exact_mm_s"] + values["error_mm_s"], values["velocity_mm_s"])
    np.testing.assert_array_equal(values["valid"].reshape(5, 5, 5) > 0, field.valid)
    assert open_result(tmp_path / "piv.h5", moving).task == "velocimetry"


def test_the_rig_is_lines_through_the_volume(moving: Dataset, tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.vtkhdf", moving.setup.cameras, moving.setup.grid)
    lines, about = opened(tmp_path / "rig.vtkhdf")
    camera = about["camera"]
    assert lines.GetNumberOfLines() == len(camera)
    assert set(camera) == {-1, *range(len(moving.setup.cameras))}
    points = np.array([lines.GetPoint(number) for number in range(lines.GetNumberOfPoints())])
    edges = points.reshape(-1, 2, 3)
    low, high = moving.setup.grid.box_mm
    volume = edges[camera == -1]
    lengths = np.linalg.norm(volume[:, 1] - volume[:, 0], axis=1)
    np.testing.assert_allclose(np.sort(lengths), np.sort(np.repeat(high - low, 4)), rtol=1e-5)
    for number, one in enumerate(moving.setup.cameras):
        assert np.linalg.norm(edges[camera == number] - one.center_mm, axis=2).min() < 1e-3
        seen, _ = one.project(edges[camera == number][:, 1])
        inner = (np.abs(seen - [one.columns / 2, one.rows / 2]) < [one.columns, one.rows]).all(
            axis=1
        )
        assert inner.mean() > 0.5


def test_missed_particles_are_those_that_no_found_one_is(moving: Dataset, tmp_path: Path) -> None:
    true = moving.particles(0)
    vtkhdf._write_particles(tmp_path, moving, 0, FoundParticles(true.position_mm[10:]))
    cloud, about = opened(tmp_path / "missed_0000.vtkhdf")
    grid = moving.setup.grid
    scored = grid.in_scored(grid.to_voxels(true.position_mm[:10]))
    assert set(about["id"]) == set(true.id[:10][scored]) if scored.any() else not cloud.GetPoints()
    assert opened(tmp_path / "particles_0000.vtkhdf")[1]["matched"].all()


def test_a_planar_result_lies_in_its_plane_in_vtk(moving: Dataset, tmp_path: Path) -> None:
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    shape = (1, 4, 5)
    plane = np.random.default_rng(0).random((*shape, 2)) @ axes
    field = Velocity((-1.0, -1.0, 0.5), (0.5, 0.25, 1.0), plane, np.ones(shape, bool), axes)
    with result_writer(tmp_path / "piv.h5", moving, "piv2d", "velocimetry", {}) as writer:
        writer.add(field, 0)
    again = open_result(tmp_path / "piv.h5", moving).read(Velocity, 0)
    np.testing.assert_array_equal(again.positions_mm, field.positions_mm)
    export(moving, tmp_path / "vtk", tmp_path / "piv.h5")
    image, values = opened(tmp_path / "vtk/velocity_0000.vtkhdf")
    points = [image.GetPoint(number) for number in range(image.GetNumberOfPoints())]
    np.testing.assert_allclose(points, field.positions_mm.reshape(-1, 3), atol=1e-12)
    np.testing.assert_allclose(values["velocity_mm_s"], plane.reshape(-1, 3))
    np.testing.assert_allclose(values["vorticity_1_s"] @ axes.T, 0.0, atol=1e-12)
    assert np.isfinite(values["vorticity_1_s"]).all()
    np.testing.assert_allclose(values["exact_mm_s"] @ field.axes[2], 0.0, atol=1e-9)


def test_an_exported_flow_carries_particles_again(moving: Dataset, tmp_path: Path) -> None:
    export(moving, tmp_path / "vtk")
    plugin = load("generators", "from_field")
    given = {"file": str(tmp_path / "vtk/flow_0000.vtkhdf"), "velocity": ["velocity_mm_s"]}
    given |= {"length": "mm", "speed": "mm/s"}
    again, flow = plugin(plugin.Parameters(**given)), flow_of(moving.scene)
    assert flow is not None
    places = np.random.default_rng(0).uniform(-1.5, 1.5, (50, 3)) + np.asarray(
        moving.scene.volume.center_mm
    )
    exact = flow.velocity(places, 0.0)
    np.testing.assert_allclose(again.velocity(places, 0.0), exact, atol=0.05 * np.abs(exact).max())


def tiny(**changes: Any) -> Scene:
    """A quick one: exports do not look at images."""
    return small(cameras=few_pixels(24, 30, 0.09), render={"relative_error": 0.2}, **changes)


@pytest.fixture(scope="module")
def bubbly(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    field = {"generator": "bubble_field", "count": 20, "radius_mm": 0.8, "tilt_deg": 30.0}
    field |= {"aspect_range": [0.4, 0.7], "velocity_mm_s": [0.0, -2.0, 0.0]}
    foil = {"generator": "hydrofoil", "points": 8, "chord_mm": 4.0, "span_mm": 3.0}
    tube = {"generator": "cylinder", "sections": 8, "radius_mm": 1.0, "length_mm": 2.0}
    bodies = [foil | {"place_mm": [0.0, 0.0, 80.0]}, tube | {"place_mm": [0.0, 0.0, 90.0]}]
    folder = tmp_path_factory.mktemp("bubbly") / "data"
    return generate(tiny(bubbles=field, solids=bodies), folder, seed=1)


@pytest.mark.slow
def test_bubbles_and_bodies_are_what_vtk_reads(bubbly: Dataset, tmp_path: Path) -> None:
    """Balls that VTK's tensor glyphs deform are the true ellipsoids."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTensorGlyph
    from vtkmodules.vtkFiltersSources import vtkSphereSource

    export(bubbly, tmp_path / "vtk")
    names = {"bodies_0000.vtkhdf", "bubbles_0000.vtkhdf", "rig.vtkhdf", "state.py"}
    assert {path.name for path in (tmp_path / "vtk").iterdir()} == names
    cloud, about = opened(tmp_path / "vtk/bubbles_0000.vtkhdf")
    true = bubbly.bubbles(0)
    assert cloud.GetNumberOfPoints() == cloud.GetNumberOfCells() == len(true) > 4
    for name in ("id", "radius_mm", "semi_axes_mm", "velocity_mm_s"):
        np.testing.assert_array_equal(about[name], getattr(true, name))
    np.testing.assert_array_equal(about["turn"].reshape(-1, 3, 3), true.turn)
    cloud.GetPointData().SetActiveTensors("shape_mm")
    ball, glyphs = vtkSphereSource(), vtkTensorGlyph()
    ball.SetRadius(1.0)
    glyphs.SetInputData(cloud)
    glyphs.SetSourceConnection(ball.GetOutputPort())
    glyphs.Update()
    drawn = (
        vtk_to_numpy(glyphs.GetOutput().GetPoints().GetData()).reshape(len(true), -1, 3)
        - true.center_mm[:, None]
    )
    np.testing.assert_allclose(
        np.linalg.norm(np.einsum("nij,nkj->nki", true.to_ball, drawn), axis=2), 1.0, atol=1e-4
    )
    assert (np.ptp(np.linalg.norm(drawn, axis=2), axis=1) > 0.2).all()
    bodies, about = opened(tmp_path / "vtk/bodies_0000.vtkhdf")
    solids = bubbly.solids(0)
    assert bodies.GetNumberOfPolys() == bodies.GetNumberOfCells()
    for number, solid in enumerate(solids):
        (own,) = np.nonzero(about["body"] == number)
        corners = [
            [bodies.GetPoint(bodies.GetCell(cell).GetPointId(corner)) for corner in range(3)]
            for cell in own
        ]
        np.testing.assert_allclose(corners, solid.vertices_mm[solid.faces], rtol=1e-6)


@pytest.mark.slow
def test_found_bubbles_say_what_they_are(bubbly: Dataset, tmp_path: Path) -> None:
    true = bubbly.bubbles(0)
    shift = np.array([0.05, 0.0, -0.1])
    order = np.array([4, 0, 2])
    # three of them, and a ghost
    center = np.concatenate([true.center_mm[order] + shift, [[0.0, 0.0, 20.0]]])
    found = Detections.balls(center, np.append(true.radius_mm[order] * 1.1, 0.5))
    for name, detections in {
        "some": found,
        "none": Detections.balls(np.zeros((0, 3)), np.zeros(0)),
    }.items():
        with result_writer(tmp_path / f"{name}.h5", bubbly, "rim_fit", "bubbles", {}) as writer:
            writer.add(detections, 0)
        export(bubbly, tmp_path / name, tmp_path / f"{name}.h5")
    cloud, about = opened(tmp_path / "some/bubbles_0000.vtkhdf")
    np.testing.assert_allclose([cloud.GetPoint(number) for number in range(4)], found.center_mm)
    np.testing.assert_array_equal(about["matched"], [1, 1, 1, 0])
    np.testing.assert_array_equal(about["true_id"], [*true.id[order], -1])
    np.testing.assert_allclose(
        about["error_mm"], np.array([shift, shift, shift, np.full(3, np.nan)]), atol=1e-12
    )
    np.testing.assert_allclose(about["radius_error_mm"], [*(0.1 * true.radius_mm[order]), np.nan])
    np.testing.assert_array_equal(about["semi_axes_mm"], found.semi_axes_mm)
    assert opened(tmp_path / "none/bubbles_0000.vtkhdf")[0].GetNumberOfPoints() == 0


def test_what_is_not_exported_is_named(moving: Dataset, tmp_path: Path, command: Command) -> None:
    refuse(command("export", moving.root, "--to", "tecplot"), "to", "tecplot")
    refuse(command("export", moving.root, tmp_path / "none.h5"), "none.h5")
    assert not (tmp_path / "vtk").exists()
    assert open_dataset(moving.root).content_hash == moving.content_hash
