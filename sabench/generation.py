"""From a scene to a data set: generate the world, light it, record it, store it with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from sabench import backend as compute
from sabench import memory, plugins
from sabench.arrays import F64
from sabench.dataset.read import Dataset, open_dataset
from sabench.dataset.write import DatasetWriter, dataset_writer
from sabench.errors import InputError
from sabench.imaging.particle_images import ParticleImages, image_particles, scattering_table
from sabench.imaging.sensor import expose
from sabench.imaging.splat import splat
from sabench.optics.camera import Camera
from sabench.progress import track
from sabench.rig import Rig, build_rig, load_scene
from sabench.scene import Scene
from sabench.seeds import stream
from sabench.world import Domain, Particles

Renderer = Literal["auto", "mitsuba", "splat"]


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
    rig, renderer = build_rig(loaded, label), choose_renderer(backend)
    with dataset_writer(Path(out), label, loaded, rig, seed, renderer, overwrite=overwrite) as writer:
        steps = [(frame, camera) for frame in range(loaded.frames) for camera in rig.cameras]
        world: _Frame | None = None
        for frame, camera in track(steps, f"render {label} with {renderer}"):
            if world is None or world.frame != frame:
                world = _Frame(loaded, rig, seed, frame, writer)
            _record(loaded, writer, world, camera, seed, renderer)
            memory.trim()
    return open_dataset(out)


def make_particles(scene: Scene, seed: int, frame: int) -> Particles:
    """The particles of one frame, whatever else is generated."""
    given = dict(scene.particles)
    plugin = plugins.load("generators", given.pop("generator"))
    domain = Domain(scene.volume.center_mm, scene.volume.size_mm, scene.cameras.rows * scene.cameras.columns)
    made: Particles = plugin(plugin.Parameters(**given)).particles(domain, seed, frame, frame * scene.interval_s)
    return made


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


class _Frame:
    """One frame's world, stored as soon as it is made."""

    def __init__(self, scene: Scene, rig: Rig, seed: int, frame: int, writer: DatasetWriter) -> None:
        self.frame = frame
        self.particles = make_particles(scene, seed, frame)
        self.table = scattering_table(scene, rig.cameras, self.particles)
        writer.add_particles(frame, self.particles)


def _record(scene: Scene, writer: DatasetWriter, world: _Frame, camera: Camera, seed: int, renderer: str) -> None:
    """Render one camera's picture, expose its sensor, and store both with the truth of this view."""
    images = image_particles(scene, camera, world.particles, world.table)
    photons, radiance = _picture(scene, camera, world.particles, images, renderer)
    number = int(camera.name.rsplit("_", 1)[1])
    grey = expose(scene.sensor, photons, stream(seed, "sensor", world.frame, number))
    writer.add_view(world.frame, camera, images)
    writer.add_image(camera, world.frame, grey, radiance.astype(np.float32))


def _picture(scene: Scene, camera: Camera, particles: Particles, images: ParticleImages, renderer: str) -> tuple[F64, F64]:
    """Photons per pixel and radiance, (rows, columns) each."""
    etendue = camera.etendue()
    if renderer == "splat":
        photons = splat(camera, images)
        return photons, np.divide(photons, etendue, out=np.zeros_like(photons), where=etendue > 0.0)
    from sabench.imaging.pathtrace import render

    radiance = render(camera, images, particles.position_mm, scene.render.samples_per_pixel)
    return radiance * etendue, radiance
