"""The whole scene: the world, its light, the cameras and the wall between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import tomli_w
from pydantic import Field, ModelWrapValidatorHandler, ValidationError, model_validator

from sabench.images.preprocessing import Step, step_faults
from sabench.scenes.calibration import Calibration, Detection
from sabench.scenes.cameras import Cameras
from sabench.scenes.exposures import exposure_faults
from sabench.scenes.illumination import (
    Background,
    Backlight,
    Illumination,
    Lighting,
    Timing,
    Tracer,
)
from sabench.scenes.materials import Inertia, fill_indices
from sabench.scenes.sensor import Render, Sensor
from sabench.scenes.variation import Vary
from sabench.scenes.wall import (
    CylinderSpec,
    LayerSpec,
    OccluderSpec,
    WallSpec,
    WallTable,
    wall_tables,
)
from sabench.scenes.world import BubbleWorld, ParticleWorld, TargetWorld, World, world_faults
from sabench.utils.errors import InputError
from sabench.utils.files import digest
from sabench.utils.validation import (
    LensNumber,
    Positive,
    Table,
    Vector,
    WallNumber,
    join_faults,
    nearest_word,
    refuse,
)


class Volume(Table):
    """Box that the generators fill, world frame."""

    center_mm: Vector = Field(description="centre of the box")
    size_mm: tuple[Positive, Positive, Positive] = Field(
        description="edge lengths along x, y and z"
    )


class GridSpec(Table):
    """Voxels that solvers reconstruct; they fill the volume."""

    voxel_mm: tuple[Positive, Positive, Positive] = Field(description="voxel size along x, y and z")
    crop_mm: tuple[
        Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]
    ] = Field((0.0, 0.0, 0.0), description="margin on each side that scores leave out")


def idle_keys(
    world: World,
    walls: Sequence[WallSpec | CylinderSpec],
    cameras: Cameras,
    light: Illumination | None,
) -> Iterator[tuple[str, str]]:
    """Find keys without effect or in conflict: pairs of a key and a sentence."""
    alone = isinstance(world, ParticleWorld)
    for number, wall in enumerate(walls):
        if isinstance(wall, WallSpec) and wall.mirrors and not alone:
            key = "wall.mirrors" if len(walls) == 1 else f"wall.{number}.mirrors"
            yield key, "expected a scene of particles alone: only theirs are mirrored"
    if cameras.airy_rings and not alone:
        expected = "expected a scene of particles alone: only their images have rings"
        yield "cameras.airy_rings", expected
    if cameras.airy_rings and cameras.particle_sigma_px is not None:
        yield "cameras.airy_rings", "expected none beside particle_sigma_px, which sets the image"
    if light and light.scattering == "isotropic" and light.polarisation is not None:
        yield "illumination.polarisation", 'expected none with scattering = "isotropic"'


WORLDS = ("particles", "targets", "flow", "bubbles")  # tables with a plug-in as `generator`


class Scene(Table):
    """Whole scene: the world, its light, the wall and the cameras."""

    title: str = Field(
        description="one line that says what the scene shows", examples=["A jet, 9 cameras"]
    )
    frames: int = Field(1, ge=1, description="number of frames", examples=[1, 10])
    interval_s: Positive = Field(1e-3, description="time between frames")
    timing: Timing | None = Field(
        None, description="times of frames and pulses, instead of frames at equal intervals"
    )
    volume: Volume = Field(description="box that the generators fill")
    grid: GridSpec = Field(description="voxels that solvers reconstruct")
    wall: WallTable | None = Field(
        None,
        description="wall between the cameras and the fluid: a plane, a cylinder, or a list of "
        "plane faces; by default everything is in air",
    )
    occluders: tuple[OccluderSpec, ...] | None = Field(
        None, description="discs that hide a part of the volume from some cameras"
    )
    cameras: Cameras = Field(description="array of cameras that records the volume")
    calibration: Calibration | None = Field(
        None, description="errors of the nominal cameras; by default solvers receive the true ones"
    )
    illumination: Illumination | None = Field(
        None, description="laser; needed where there are particles"
    )
    tracer: Tracer = Field(Tracer(), description="optical material of the particles")
    particles: dict[str, Any] | None = Field(
        None, description="tracer particles: `generator` and its parameters"
    )
    flow: dict[str, Any] | None = Field(
        None, description="flow that carries the particles: `generator` and its parameters"
    )
    inertia: Inertia | None = Field(
        None, description="particles that do not follow the flow exactly; by default they do"
    )
    flow_grid_mm: tuple[Positive, Positive, Positive] | None = Field(
        None,
        description="spacing along x, y, z of a lattice over the volume; the data set stores the "
        "exact flow of every frame on it",
        examples=[(1.0, 1.0, 1.0)],
    )
    targets: dict[str, Any] | None = Field(
        None,
        description="instead of particles, a calibration target at another position in each "
        "frame: `generator` and its parameters",
    )
    bubbles: dict[str, Any] | None = Field(
        None, description="bubbles or droplets: `generator` and its parameters"
    )
    solids: tuple[dict[str, Any], ...] | None = Field(
        None, description="bodies in the fluid: `generator` and its parameters for each"
    )
    backlight: Backlight | None = Field(None, description="diffuser behind the volume")
    lighting: Lighting | None = Field(None, description="lamps; needed to render a target")
    detection: Detection | None = Field(
        None,
        description="errors of detected points of a target; by default every point is detected "
        "exactly",
    )
    background: Background | None = Field(
        None, description="static light on the sensors that does not come from the volume"
    )
    sensor: Sensor = Field(Sensor(), description="sensor that all cameras have")
    preprocessing: tuple[Step, ...] | None = Field(
        None,
        description="steps applied to the images before solvers receive them; "
        "stored images are raw",
    )
    render: Render = Field(Render(), description="accuracy of images by Mitsuba")
    vary: Vary | None = Field(
        None, description="keys whose values every sample of a stream draws anew"
    )

    @model_validator(mode="wrap")
    @classmethod
    def _check_world(cls, values: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Check which tables are there, also where some of them have faults of their own."""
        faults: list[tuple[str, str]] = []
        if isinstance(values, dict):
            values, faults = fill_indices(values)
            faults += world_faults(_name_tables(values))
        try:
            scene = handler(values)
        except ValidationError as error:
            raise join_faults(error, faults) from None
        steps = step_faults(scene.preprocessing or (), scene.frames)
        faults += [("preprocessing", fault) for fault in steps]
        faults += idle_keys(scene.world, scene.walls, scene.cameras, scene.illumination)
        if scene.calibration and scene.calibration.errs_in_wall and scene.plane is None:
            faults.append(
                ("calibration", "errors of the wall: expected one plane wall in the scene")
            )
        faults += exposure_faults(scene.timing, scene.sensor, scene.world)
        refuse(faults)
        return scene

    @property
    def world(self) -> World:
        """World that the tables describe, with the fields that its kind needs."""
        if self.targets is not None:
            return TargetWorld(self.targets, self.lighting, self.detection)
        tracers = None
        if self.particles is not None and self.illumination is not None:
            tracers = ParticleWorld(self.particles, self.illumination, self.tracer, self.flow)
            if self.bubbles is None and not self.solids:
                return tracers
        return BubbleWorld(self.bubbles, self.solids or (), self.backlight, self.lighting, tracers)

    @property
    def particle_world(self) -> ParticleWorld:
        """Tracer particles of a scene that has some.

        Raises InputError: a scene without particles.
        """
        if (tracers := self.world.tracers) is None:
            raise InputError(f"{self.title}: particles: expected a scene with particles, got none")
        return tracers

    @property
    def walls(self) -> tuple[WallSpec | CylinderSpec, ...]:
        """Tables of all walls; none in plain air."""
        return wall_tables(self.wall)

    @property
    def plane(self) -> WallSpec | None:
        """The only wall of a scene, where it is plane."""
        only = self.walls[0] if len(self.walls) == 1 else None
        return only if isinstance(only, WallSpec) else None

    @property
    def rear(self) -> tuple[LayerSpec, ...]:
        """Layers of the back wall behind a single plane wall, the fluid's side first."""
        return (self.plane.rear or ()) if self.plane else ()

    @property
    def fluid_index(self) -> float:
        """Refractive index of the fluid, 1 in plain air."""
        return self.walls[0].fluid_index if self.walls else 1.0

    @property
    def light(self) -> Illumination:
        """Laser of a scene with particles."""
        return self.particle_world.illumination

    @property
    def unknown(self) -> tuple[LensNumber | WallNumber, ...]:
        """Unmeasured numbers of the lenses and the wall."""
        return (self.calibration.unknown if self.calibration else None) or ()

    def time_s(self, frame: int) -> float:
        """Give the time of a frame, from the start of the first group."""
        if self.timing is None:
            return frame * self.interval_s
        group, pulse = divmod(frame, len(self.timing.pulses_s))
        return group / self.timing.rate_hz + self.timing.pulses_s[pulse]

    def with_frames(self, frames: int) -> Scene:
        """Copy the scene with another number of frames."""
        return Scene.model_validate({**self.model_dump(exclude_none=True), "frames": frames})

    def to_dict(self) -> dict[str, Any]:
        """Give all keys with their values, defaults included, as TOML holds them."""
        return dict(plain(self.model_dump(mode="json", exclude_none=True)))

    def to_toml(self) -> str:
        """Write the resolved scene as TOML; loading it gives an equal scene."""
        return tomli_w.dumps(self.to_dict())

    @property
    def hash(self) -> str:
        """SHA-256 of the resolved scene; it does not depend on how the file was written."""
        values = self.to_dict()
        for given in (*(values.get(table, {}) for table in WORLDS), *values.get("solids", ())):
            if "sha256" in given:
                del given["file"]  # its content counts, not its name
        return digest(values)

    @property
    def files(self) -> dict[str, Path]:
        """Files of other programs that the generators read, by the table that names them."""
        tables = {table: getattr(self, table) or {} for table in WORLDS} | {
            f"solids.{number}": given for number, given in enumerate(self.solids or ())
        }
        return {table: Path(given["file"]) for table, given in tables.items() if "sha256" in given}

    def with_files(self, paths: dict[str, Path]) -> Scene:
        """Copy the scene with other paths of its files, by table."""
        worlds = {
            table: {**getattr(self, table), "file": str(path)}
            for table, path in paths.items()
            if table in WORLDS
        }
        solids = tuple(
            {**given, "file": str(paths[key])} if (key := f"solids.{number}") in paths else given
            for number, given in enumerate(self.solids or ())
        )
        return self.model_copy(update=worlds | ({"solids": solids} if solids else {}))


def _name_tables(values: dict[str, Any]) -> set[str]:
    """Name the tables that a file gives; a misspelt one counts as its nearest match."""
    tables = Scene.model_fields
    keys = {str(key) for key, value in values.items() if value not in (None, [], ())}
    return {key if key in tables else nearest_word(key, tables) or key for key in keys}


def plain(value: Any) -> Any:
    """Turn nested tuples into lists, as TOML and JSON give them back."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    return [plain(inner) for inner in value] if isinstance(value, list | tuple) else value
