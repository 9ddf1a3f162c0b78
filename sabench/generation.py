"""From a scene to a data set: generate the world, light it, record it, store it with its truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from sabench import backend as compute
from sabench import memory, targets
from sabench.api import Observation
from sabench.arrays import F64, U16
from sabench.dataset.read import Dataset, View, observed, open_dataset
from sabench.dataset.write import DatasetWriter, dataset_writer
from sabench.errors import InputError
from sabench.imaging.particle_images import ParticleImages, image_particles, scattering_table
from sabench.imaging.scattering import MieTable
from sabench.imaging.sensor import expose, white_level
from sabench.imaging.splat import splat
from sabench.motion import Motion, lattice, moments, pulse
from sabench.multiphase import Worlds, record
from sabench.optics.camera import Camera
from sabench.progress import track
from sabench.rig import Rig, build_rig, load_scene, told_cameras
from sabench.scene import Scene
from sabench.seeds import stream
from sabench.targets import Placed
from sabench.world import Particles

Renderer = Literal["auto", "mitsuba", "splat"]
_STREAK_PX = 0.5  # of a streak for each place that stands for it


def generate(
    scene: Scene | str | Path, out: str | Path, *, seed: int = 0, backend: Renderer = "auto", name: str | None = None, overwrite: bool = False
) -> Dataset:
    """Make a data set.

    Parameters
    ----------
    scene : a scene, a scene file, or the name of a bundled one.
    out : the folder to make.
    seed : of all random numbers.
    backend : the renderer: "mitsuba" (rays through the real wall), "splat" (analytic), or "auto": Mitsuba where it runs, else splat.
    name : of the scene in the manifest; by default the file's stem.
    overwrite : replace an existing data set.

    Raises
    ------
    InputError
        A bad scene or seed, an existing folder, or no working Mitsuba when it was asked for.
    """
    if not 0 <= seed < 2**63:
        raise InputError(f"seed: expected 0 to 2^63 - 1, got {seed}")
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    label = name or (loaded.title if isinstance(scene, Scene) else Path(scene).stem)
    rig, renderer = build_rig(loaded, label), _renderer(loaded, backend, label)
    told = told_cameras(loaded, rig.cameras, seed)
    with dataset_writer(Path(out), label, loaded, rig, told, seed, renderer, overwrite=overwrite) as writer:
        if loaded.targets:
            _show_targets(writer, loaded, rig, told, seed, renderer, label)
        elif loaded.bubbles is not None or loaded.solids:
            _record_phases(writer, loaded, rig, seed, label)
        else:
            _record_particles(writer, loaded, rig, seed, renderer, label)
    return open_dataset(out)


def _record_particles(writer: DatasetWriter, scene: Scene, rig: Rig, seed: int, renderer: str, label: str) -> None:
    steps = [(frame, camera) for frame in range(scene.frames) for camera in rig.cameras]
    motion, world = Motion(scene, seed), None
    for frame, camera in track(steps, f"render {label} with {renderer}"):
        if world is None or world.frame != frame:
            world = _make_world(motion, rig, frame, renderer)
            writer.add_particles(frame, world.particles)
            if scene.flow_grid_mm:
                writer.add_flow(frame, *lattice(scene, frame, scene.flow_grid_mm))
        images, grey, photons, radiance = _shoot(world, camera)
        writer.add_view(frame, camera, images)
        writer.add_image(camera, frame, grey, (_radiance(camera, photons) if radiance is None else radiance).astype(np.float32))
        memory.trim()


def _record_phases(writer: DatasetWriter, scene: Scene, rig: Rig, seed: int, label: str) -> None:
    steps, every, world = [(frame, camera) for frame in range(scene.frames) for camera in rig.cameras], Worlds(scene, rig, seed), None
    for frame, camera in track(steps, f"render {label} with mitsuba"):
        if world is None or world.frame != frame:
            world = every.at(frame)
            writer.add_phases(frame, world.bubbles, world.solids)
            if world.particles is not None:
                writer.add_particles(frame, world.particles)
            if scene.flow_grid_mm:
                writer.add_flow(frame, *lattice(scene, frame, scene.flow_grid_mm))
        view = record(world, camera)
        writer.add_sight(frame, camera, view.sight, view.error)
        if view.images is not None:
            writer.add_view(frame, camera, view.images)
        writer.add_image(camera, frame, view.grey, _radiance(camera, view.photons).astype(np.float32))
        memory.trim()


def _show_targets(writer: DatasetWriter, scene: Scene, rig: Rig, told: tuple[Camera, ...], seed: int, renderer: str, label: str) -> None:
    """Store what every camera finds of a calibration target at all its places, in pictures or without."""
    placed = targets.place(scene, seed)
    known, found = targets.prior(scene, placed, seed), []
    writer.add_target(placed)
    for number, (camera, rough) in enumerate(zip(track(rig.cameras, f"show the target of {label} with {renderer}"), told, strict=True)):
        exact = targets.exact_pixels(camera, placed.points_mm)
        if renderer == "mitsuba":
            expected = rough.project(known.rough_mm.reshape(-1, 3))[0].reshape(exact.shape)
            pixels, outliers = _photographed(writer, scene, camera, placed, seed, number, expected), np.zeros(exact.shape[:2], dtype=np.bool_)
        else:
            pixels, outliers = targets.found_pixels(scene.detection, exact, seed, number)
        writer.add_sighting(camera, exact, outliers)
        found.append(pixels)
    writer.add_points(np.stack(found), known)


def _photographed(writer: DatasetWriter, scene: Scene, camera: Camera, placed: Placed, seed: int, number: int, expected: F64) -> F64:
    """Photograph the target in every frame, store the pictures, and return what is found in them (frame, point, 2)."""
    from sabench.detection import detect
    from sabench.imaging.target_pictures import photograph

    lighting = scene.lighting
    assert lighting is not None  # `_renderer` has checked it
    full, found = scene.sensor.full_well_e / scene.sensor.quantum_efficiency, []
    for frame, pose in enumerate(placed.poses):
        photons = full * photograph(camera, placed.target, pose, lighting, np.asarray(scene.volume.center_mm), scene.render.samples_per_pixel)
        grey = expose(scene.sensor, photons.copy(), stream(seed, "sensor", frame, number))
        writer.add_image(camera, frame, grey, _radiance(camera, photons).astype(np.float32))
        found.append(detect(grey, placed.target, expected[frame]))
        memory.trim()
    return np.stack(found)


def _renderer(scene: Scene, asked: Renderer, label: str) -> str:
    """What makes the data set: a target without lamps needs no pictures."""
    if scene.bubbles is not None or scene.solids:
        if asked == "splat":
            raise InputError(f"{label}: backend: expected mitsuba for bubbles and solids, got splat, which renders particles only")
        return choose_renderer("mitsuba")
    if scene.targets is None or scene.lighting is not None:
        return choose_renderer(asked)
    if asked == "mitsuba":
        raise InputError(f"{label}: lighting: expected lamps to render a target by, got none; the backend splat needs none")
    return "splat"


@dataclass(frozen=True)
class Shot:
    """One frame in memory: what a solver may see, and the truth that it is scored with."""

    observation: Observation
    particles: Particles
    views: list[View]


def simulate(scene: Scene, *, seed: int = 0, frame: int = 0, backend: Renderer = "splat") -> Shot:
    """One frame of the data set that `generate` would make of the scene and seed, without writing anything.

    Raises
    ------
    InputError
        As `generate`.
    """
    rig = build_rig(scene, scene.title)
    world = _make_world(Motion(scene, seed), rig, frame, choose_renderer(backend))
    pictures, views = [], []
    for camera in rig.cameras:
        images, grey, _, _ = _shoot(world, camera)
        pictures.append(grey)
        views.append(View(images.pixel, images.photons, images.sigma_px, images.visible.astype(np.float64)))
    told = told_cameras(scene, rig.cameras, seed)
    levels = scene.sensor.black_level_dn, white_level(scene.sensor)
    observation = observed(np.stack(pictures), told, rig.grid, levels, scene.preprocessing or ())
    return Shot(observation, world.particles, views)


def make_particles(scene: Scene, seed: int, frame: int) -> Particles:
    """The particles of one frame, whatever else is generated."""
    return Motion(scene, seed).at(frame)


def choose_renderer(asked: Renderer) -> str:
    """mitsuba or splat; "auto" falls back to splat where nothing runs Mitsuba."""
    if asked not in ("auto", "mitsuba", "splat"):
        raise InputError(f"backend: expected auto, mitsuba or splat, got {asked!r}")
    if asked == "splat":
        return asked
    try:
        compute.choose()
    except InputError:
        if asked == "mitsuba":
            raise
        return "splat"
    return "mitsuba"


@dataclass(frozen=True)
class _World:
    """One frame's world, and what records it.

    Attributes
    ----------
    scene : with the laser as it is in this frame.
    streaks : places of the particles in equal parts of the pulse; one, in its middle, for a short pulse.
    """

    scene: Scene
    rig: Rig
    seed: int
    frame: int
    renderer: str
    particles: Particles
    table: MieTable | None
    streaks: tuple[F64, ...]


def _make_world(motion: Motion, rig: Rig, frame: int, renderer: str) -> _World:
    particles = motion.at(frame)
    scene = motion.scene.model_copy(update={"illumination": pulse(motion.scene, motion.seed, frame)})
    table = scattering_table(scene, rig.cameras, particles)
    return _World(scene, rig, motion.seed, frame, renderer, particles, table, _streaks(motion, rig, particles, frame))


def _streaks(motion: Motion, rig: Rig, particles: Particles, frame: int) -> tuple[F64, ...]:
    """As many places along each path as its longest image has halves of a pixel."""
    duration = motion.scene.timing.duration_s if motion.scene.timing else 0.0
    if duration == 0.0 or not len(particles):
        return (particles.position_mm,)
    ends = [motion.moved(particles, frame, delay) for delay in (-duration / 2.0, duration / 2.0)]
    seen = [[camera.project(end)[0] for end in ends] for camera in rig.cameras]
    longest = max(float(np.nanmax(np.linalg.norm(late - early, axis=1))) for early, late in seen)
    steps = max(1, int(np.ceil(longest / _STREAK_PX)))
    return tuple(motion.moved(particles, frame, delay) for delay in moments(duration, steps))


def _shoot(world: _World, camera: Camera) -> tuple[ParticleImages, U16, F64, F64 | None]:
    """Render one camera's picture and expose its sensor: the particles' images, grey values, photons, and the radiance if the renderer gives it."""
    images = image_particles(world.scene, camera, world.particles, world.table, world.rig.occluders)
    photons, radiance = _exposed(world, camera, images)
    number = int(camera.name.rsplit("_", 1)[1])
    grey = expose(world.scene.sensor, photons, stream(world.seed, "sensor", world.frame, number))
    return images, grey, photons, radiance


def _exposed(world: _World, camera: Camera, images: ParticleImages) -> tuple[F64, F64 | None]:
    """Photons on the sensor, and the radiance if the renderer gives it: the mean over the parts of the pulse."""
    parts = len(world.streaks)
    photons, radiance = np.zeros((camera.rows, camera.columns)), None if world.renderer == "splat" else np.zeros((camera.rows, camera.columns))
    for places in world.streaks:
        there = replace(world.particles, position_mm=places)
        own = images if parts == 1 else image_particles(world.scene, camera, there, world.table, world.rig.occluders)
        if radiance is None:
            photons += splat(camera, own) / parts
        else:
            radiance += _render(world, camera, own, places) / parts
    return (photons, None) if radiance is None else (radiance * camera.etendue(), radiance)


def _render(world: _World, camera: Camera, images: ParticleImages, places: F64) -> F64:
    from sabench.imaging.pathtrace import render

    picture: F64 = render(camera, images, places, world.scene.render.samples_per_pixel, world.rig.occluders)
    return picture


def _radiance(camera: Camera, photons: F64) -> F64:
    """Photons / (mm2 sr) in front of the lens; 0 where a distorted lens shows nothing."""
    etendue = camera.etendue()
    return np.divide(photons, etendue, out=np.zeros_like(photons), where=etendue > 0.0)
