"""Light from particles to cameras: polarisation, extinction, mixtures."""

from typing import Any

import numpy as np
import pytest

from sabench.api.truth import Particles
from sabench.scenes import Scene, build_rig
from sabench.simulation.rendering.particle_light import Scatterers, intensity, scatterers_of
from sabench.utils.arrays import F64
from sabench.worlds.tracers import lattice_diameters_mm, material_numbers, size_numbers
from tests.helpers.particle_scenes import cloud, make_scene


def lit(scene: Scene, particles: Particles, towards: F64) -> F64:
    """Send light from particles along unit directions (n, 3), through a narrow lens."""
    scatterers = Scatterers(scene, build_rig(scene).cameras, 0)
    return intensity(scene, particles, -towards, np.full(len(particles), 1e-4), scatterers)


def sideways(count: int) -> F64:
    """Directions near the cameras' that scatter under all azimuths."""
    towards = np.array([0.0, 0.0, -1.0]) + np.random.default_rng(1).uniform(-0.15, 0.15, (count, 3))
    return np.asarray(towards / np.linalg.norm(towards, axis=1, keepdims=True))


@pytest.mark.parametrize("field", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, -0.6, 0.8)])
def test_small_polarised_particles_shine_as_dipoles(field: tuple[float, float, float]) -> None:
    light = {"scattering": "mie", "polarisation": field}
    towards, small = sideways(50), cloud(np.tile([0.0, 0.0, 30.0], (50, 1)), 3e-6)
    found = lit(make_scene(illumination=light), small, towards)
    dipole = 1.0 - (towards @ np.asarray(field)) ** 2
    np.testing.assert_allclose(found / found.max(), dipole / dipole.max(), atol=2e-3)


def test_each_particle_has_its_own_series_in_place_of_a_mean() -> None:
    """Neighbours of other sizes change nothing; 2 % in diameter change a factor."""
    diameters = lattice_diameters_mm(size_numbers(np.linspace(0.02, 0.0204, 40)))
    particles, towards = cloud(np.tile([0.0, 0.0, 30.0], (40, 1)), diameters), sideways(1)
    scene = make_scene(illumination={"scattering": "mie"})
    light = lit(scene, particles, np.repeat(towards, 40, axis=0))
    alone = [lit(scene, cloud(np.array([[0.0, 0.0, 30.0]]), one), towards)[0] for one in diameters]
    np.testing.assert_allclose(light, alone, rtol=1e-6)
    assert light.max() > 1.5 * light.min()


def test_unpolarised_light_is_the_mean_of_two_polarisations() -> None:
    towards, particles = sideways(50), cloud(np.tile([0.0, 0.0, 30.0], (50, 1)), 0.02)
    found = [
        lit(make_scene(illumination={"scattering": "mie"} | light), particles, towards)
        for light in ({}, {"polarisation": (0.0, 1.0, 0.0)}, {"polarisation": (0.0, 0.0, 1.0)})
    ]
    np.testing.assert_allclose(found[0], (found[1] + found[2]) / 2.0, rtol=1e-12)


@pytest.mark.parametrize("scattering", ["isotropic", "mie"])
def test_a_cloud_attenuates_as_many_shadows_do(scattering: str) -> None:
    """Sum the shadows that each particle throws on a face of the volume, for light along x."""
    light = {"scattering": scattering}
    plain = make_scene(illumination=light)
    size, center = np.asarray(plain.volume.size_mm), np.asarray(plain.volume.center_mm)
    particles = cloud(center + (np.random.default_rng(2).random((20_000, 3)) - 0.5) * size, 0.02)
    towards = np.tile([0.0, 0.0, -1.0], (20_000, 1))
    scatterers = scatterers_of(plain, build_rig(plain).cameras, 0)
    half = np.full(20_000, 1e-3)
    before, after = (
        intensity(scene, particles, -towards, half, scatterers)
        for scene in (plain, make_scene(illumination=light | {"extinction": True}))
    )
    shadow = np.pi / 4.0 * 0.02**2 * (2.1 if scattering == "mie" else 1.0)  # efficiency near 2
    place = particles.position_mm - center
    along_x = shadow / (size[1] * size[2]) * (place[:, :1] > place[::40, 0]).sum(axis=1) * 40
    along_z = shadow / (size[0] * size[1]) * (place[:, 2:] > place[::40, 2]).sum(axis=1) * 40
    found = -np.log(after / before)
    assert found.max() > 0.05
    np.testing.assert_allclose(found, along_x + along_z, rtol=0.1, atol=0.006)


def test_a_particle_outside_the_volume_is_not_attenuated() -> None:
    positions = np.array([[0.0, 0.0, 30.0], [0.0, 0.0, 300.0]])
    scene = make_scene(illumination={"extinction": True, "thickness_mm": 1e4})
    arriving = np.tile([0.0, 0.0, 1.0], (2, 1))
    inside, outside = intensity(scene, cloud(positions), arriving, np.ones(2), None)
    assert inside < outside


MIXTURE: dict[str, Any] = {"mixture": [{"index": 1.4, "share": 0.3}, {"index": 2.0, "share": 0.2}]}


def test_a_mixture_has_its_shares_and_particles_keep_their_material() -> None:
    tracer = make_scene(tracer=MIXTURE).tracer
    ids = np.arange(100_000)
    numbers = material_numbers(tracer, 5, ids)
    np.testing.assert_allclose(np.bincount(numbers) / len(ids), [0.5, 0.3, 0.2], atol=0.006)
    np.testing.assert_array_equal(material_numbers(tracer, 5, ids[7::11]), numbers[7::11])
    assert 0.3 < np.mean(material_numbers(tracer, 6, ids) == numbers) < 0.45  # by chance: .38
    assert np.mean(numbers[1:] == numbers[:-1]) == pytest.approx(0.38, abs=0.01)


def test_each_particle_of_a_mixture_scatters_as_its_material() -> None:
    light = {"scattering": "mie"}
    scene = make_scene(illumination=light, tracer=MIXTURE)
    towards, particles = sideways(60), cloud(np.tile([0.0, 0.0, 30.0], (60, 1)), 0.02)
    found, numbers = lit(scene, particles, towards), material_numbers(scene.tracer, 0, particles.id)
    for number, index in enumerate((1.59, 1.4, 2.0)):
        alone = lit(make_scene(illumination=light, tracer={"index": index}), particles, towards)
        own = numbers == number
        assert own.any()
        np.testing.assert_allclose(found[own], alone[own], rtol=1e-12)
