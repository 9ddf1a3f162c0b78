"""What a TOML scene may say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, model_validator

from sabench.images.preprocessing import Step
from sabench.utils.fields import Direction, Index, LensNumber, Positive, Vector
from sabench.utils.files import digest

WORLDS = ("particles", "targets", "flow", "bubbles")  # tables whose `generator` is a plug-in


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Volume(_Table):
    """The box that the generator fills, in the world frame."""

    center_mm: Vector = Field(description="centre of the box")
    size_mm: tuple[Positive, Positive, Positive] = Field(
        description="edge lengths along x, y and z"
    )


class GridSpec(_Table):
    """The voxels that solvers reconstruct: they fill the volume."""

    voxel_mm: tuple[Positive, Positive, Positive] = Field(description="voxel size along x, y and z")
    crop_mm: tuple[
        Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]
    ] = Field((0.0, 0.0, 0.0), description="margin at either side that scores leave out")


class LayerSpec(_Table):
    """One solid layer of the wall."""

    name: str = "glass"
    index: Index = Field(description="refractive index")
    thickness_mm: Positive


class WallSpec(_Table):
    """The tank wall between the cameras and the fluid; a scene without this table is in plain air."""

    point_mm: Vector = Field((0.0, 0.0, 0.0), description="a point on the outer face")
    normal: Direction = Field(
        (0.0, 0.0, 1.0), description="direction from the cameras into the tank"
    )
    air_index: Index = Field(1.0, description="refractive index on the cameras' side")
    layers: tuple[LayerSpec, ...] = Field((), description="solid layers, the cameras' side first")
    fluid_index: Index = Field(description="refractive index of the fluid")
    depth_mm: Positive | None = Field(
        None, description="distance from the inner face to the back wall"
    )
    rear: tuple[LayerSpec, ...] | None = Field(
        None, description="solid layers of the back wall, the fluid's side first; air is behind it"
    )


class OccluderSpec(_Table):
    """An opaque, black, thin disc between the cameras and the wall or, in plain air, between the cameras and the volume."""

    center_mm: Vector
    normal: Direction = Field((0.0, 0.0, 1.0), description="at right angles to the disc")
    radius_mm: Positive


class GridLayout(_Table):
    """Cameras in columns and rows; evenly by count and spacing, or unevenly by lists of offsets."""

    kind: Literal["grid"]
    columns: int | None = Field(None, ge=1)
    rows: int | None = Field(None, ge=1)
    spacing_mm: tuple[Positive, Positive] | None = Field(
        None, description="between columns, between rows"
    )
    x_mm: tuple[float, ...] | None = Field(None, min_length=1, description="offsets of the columns")
    y_mm: tuple[float, ...] | None = Field(None, min_length=1, description="offsets of the rows")

    @model_validator(mode="after")
    def _even_or_uneven(self) -> GridLayout:
        even = [self.columns, self.rows, self.spacing_mm]
        uneven = [self.x_mm, self.y_mm]
        if (None in even) == (None in uneven) or any(
            v is not None for v in (even if None in even else uneven)
        ):
            raise ValueError("expected either columns, rows and spacing_mm or x_mm and y_mm")
        return self


class RingLayout(_Table):
    """Cameras on a circle."""

    kind: Literal["ring"]
    count: int = Field(ge=1)
    radius_mm: Positive
    start_deg: float = 0.0


class LineLayout(_Table):
    """Cameras on a straight line."""

    kind: Literal["line"]
    count: int = Field(ge=1)
    spacing_mm: Positive
    angle_deg: float = 0.0


class CrossLayout(_Table):
    """A camera in the centre and four arms."""

    kind: Literal["cross"]
    arm: int = Field(ge=1, description="cameras per arm")
    spacing_mm: Positive


class Place(_Table):
    """One camera of an explicit list, aimed at a point (by default the array's) or turned by a rotation matrix."""

    center_mm: Vector
    aim_mm: Vector | None = None
    rotation: tuple[Vector, Vector, Vector] | None = Field(
        None, description="world to camera; rows are its X, Y, Z axes"
    )


class ListLayout(_Table):
    """Cameras one by one."""

    kind: Literal["list"]
    places: tuple[Place, ...] = Field(min_length=1)


class DistortionSpec(_Table):
    """Radial-tangential (Brown-Conrady) coefficients."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0


class Cameras(_Table):
    """An array of equal cameras."""

    rows: int = Field(ge=8, le=20000)
    columns: int = Field(ge=8, le=20000)
    pixel_mm: float = Field(gt=0.0, le=10.0, description="pixel pitch")
    focal_length_mm: Positive
    f_number: Positive
    focus_mm: Positive | None = Field(
        None,
        description="distance of sharp points in air; by default each camera's aim point is sharp",
    )
    distortion: DistortionSpec = DistortionSpec()
    particle_sigma_px: Positive | None = Field(
        None,
        description="standard deviation of every particle's image; by default it follows from diffraction, size and defocus",
    )
    center_mm: Vector = Field((0.0, 0.0, 0.0), description="centre of the array (not for lists)")
    x_axis: Direction = Field((1.0, 0.0, 0.0), description="direction of the array's columns")
    y_axis: Direction = Field((0.0, 1.0, 0.0), description="direction of the array's rows")
    aim_mm: Vector | None = Field(
        None, description="point that images at every image centre; by default the volume's centre"
    )
    layout: GridLayout | RingLayout | LineLayout | CrossLayout | ListLayout = Field(
        discriminator="kind"
    )


class KnownPoint(_Table):
    """A point of a target whose place was measured by other means."""

    frame: int = Field(0, ge=0, description="which placing of the target")
    point: int = Field(ge=0, description="which of its points")
    axes: Annotated[str, Field(pattern="^x?y?z?$", min_length=1)] = Field(
        "xyz", description="coordinates that are known"
    )
    sigma_mm: Positive = Field(0.05, description="standard deviation of each of them")


class Calibration(_Table):
    """How wrongly solvers are told the cameras, and a target's places; without this table they are told the truth.

    Errors are normally distributed, each number of each camera or point on its own.
    """

    shift_px: float = Field(
        0.0,
        ge=0.0,
        description="every principal point is told this far from the true one, in a random direction of its own",
    )
    center_mm: float = Field(
        0.0, ge=0.0, description="standard deviation of each coordinate of the pinholes"
    )
    turn_deg: float = Field(
        0.0,
        ge=0.0,
        description="standard deviation of each component of the cameras' rotation vectors",
    )
    focal_percent: float = Field(
        0.0, ge=0.0, lt=100.0, description="standard deviation of the principal distances"
    )
    points: float = Field(
        0.0,
        ge=0.0,
        description="standard deviation of each coordinate of the target's points, over the volume's largest edge",
    )
    blank: bool = Field(
        False,
        description="places of the target are told as all alike: unturned, at the volume's centre",
    )
    known: tuple[KnownPoint, ...] = Field((), description="points whose places are known")
    unknown: tuple[LensNumber, ...] | None = Field(
        None,
        description="what nobody has measured of the lenses: solvers are told so, and coefficients of distortion as zero",
    )


class Detection(_Table):
    """How a target's points come out of the cameras' images, where no images are rendered."""

    noise_px: float = Field(0.0, ge=0.0, description="standard deviation of each pixel coordinate")
    missing: float = Field(
        0.0, ge=0.0, lt=1.0, description="share of points that are not found, at random"
    )
    hidden: float = Field(
        0.0,
        ge=0.0,
        lt=1.0,
        description="share of a camera's views of a target in which something hides a part of it",
    )
    outliers: float = Field(
        0.0, ge=0.0, lt=1.0, description="share of found points that are elsewhere"
    )
    outlier_px: Positive = Field(20.0, description="standard deviation of each coordinate of where")


class Illumination(_Table):
    """One laser pulse per frame, as a sheet or slab."""

    wavelength_nm: Positive = Field(532.0, description="in vacuum")
    pulse_energy_mj: Positive
    direction: Vector = Field((1.0, 0.0, 0.0), description="in which the light travels")
    sheet_normal: Vector = Field((0.0, 0.0, 1.0), description="across the sheet")
    thickness_mm: Positive = Field(description="full width (top-hat) or e^-2 width (gaussian)")
    height_mm: Positive = Field(
        description="width of the sheet at right angles to its direction and normal"
    )
    shift_mm: float | None = Field(
        None, description="how far the sheet's middle lies from the volume's, along its normal"
    )
    profile: Literal["top-hat", "gaussian"] = "top-hat"
    scattering: Literal["mie", "isotropic"] = "mie"

    @model_validator(mode="after")
    def _crossed(self) -> Illumination:
        lengths = math.hypot(*self.direction) * math.hypot(*self.sheet_normal)
        dot = sum(a * b for a, b in zip(self.direction, self.sheet_normal, strict=True))
        if lengths < 1e-9 or abs(dot) > 1e-6 * lengths:
            raise ValueError(
                "expected direction and sheet_normal of non-zero length and at right angles"
            )
        return self


class Timing(_Table):
    """When frames are taken: groups of pulses, one frame each, and what differs from pulse to pulse.

    One pulse a group is a time-resolved sequence, two are frame straddling (double frames), four a
    four-pulse system.
    """

    rate_hz: Positive = Field(description="of the groups")
    pulses_s: tuple[Annotated[float, Field(ge=0.0)], ...] = Field(
        (0.0,), min_length=1, description="times of a group's pulses, from its start"
    )
    energy: tuple[Positive, ...] | None = Field(
        None, description="of each of a group's pulses, over the illumination's"
    )
    energy_spread: float = Field(
        0.0, ge=0.0, lt=1.0, description="standard deviation of each pulse's energy, over its mean"
    )
    shift_mm: tuple[float, ...] | None = Field(
        None,
        description="of each of a group's sheets along its normal: lasers are never aligned exactly",
    )
    duration_s: float = Field(0.0, ge=0.0, description="of a pulse: particles leave streaks")

    @model_validator(mode="after")
    def _ordered(self) -> Timing:
        if list(self.pulses_s) != sorted(set(self.pulses_s)):
            raise ValueError(f"pulses_s: expected rising times, got {list(self.pulses_s)}")
        if self.pulses_s[-1] - self.pulses_s[0] >= 1.0 / self.rate_hz and len(self.pulses_s) > 1:
            raise ValueError(
                f"pulses_s: expected a group shorter than 1 / rate_hz = {1.0 / self.rate_hz:g} s, got {list(self.pulses_s)}"
            )
        for name in ("energy", "shift_mm"):
            given = getattr(self, name)
            if given is not None and len(given) != len(self.pulses_s):
                raise ValueError(
                    f"{name}: expected one value for each of {len(self.pulses_s)} pulses, got {len(given)}"
                )
        return self


class Lamp(_Table):
    """A small lamp; light from in front of the wall is taken to cross it steeply."""

    center_mm: Vector
    power: Positive = 1.0


class Lighting(_Table):
    """What lights a calibration target."""

    lamps: tuple[Lamp, ...] = Field(min_length=1)
    exposure: Positive = Field(
        0.7,
        description="what a white surface at the volume's centre that faces the wall gives, as a part of the full well",
    )
    even: float | None = Field(
        None,
        ge=0.0,
        le=1.0,
        description="part of the light that comes evenly from everywhere, as from balls that glow",
    )
    wavelength_nm: Positive = Field(550.0, description="for diffraction")


class Backlight(_Table):
    """A diffuser behind the volume that shines evenly in all directions, as large as it is and dark beyond its edges."""

    center_mm: Vector
    size_mm: tuple[Positive, Positive] = Field(
        description="along x_axis, and at right angles to that"
    )
    normal: Direction = Field((0.0, 0.0, 1.0), description="at right angles to the diffuser")
    x_axis: Direction = Field(
        (1.0, 0.0, 0.0),
        description="along one of its edges, as far as it is at right angles to the normal",
    )
    exposure: Positive = Field(
        0.7, description="what it gives where nothing is in front of it, as a part of the full well"
    )
    wavelength_nm: Positive = Field(550.0, description="for diffraction")


class Tracer(_Table):
    """What the particles are made of: complex refractive index m = index - i absorption."""

    index: float = Field(1.59, ge=1.0, le=4.0)
    absorption: float = Field(0.0, ge=0.0, le=5.0)


class Sensor(_Table):
    """From photons to grey values."""

    exposure_s: Positive = 1e-3
    quantum_efficiency: float = Field(0.6, gt=0.0, le=1.0)
    dark_current_e_s: float = Field(0.0, ge=0.0)
    read_noise_e: float = Field(0.0, ge=0.0)
    full_well_e: Positive = 20000.0
    gain_dn_e: Positive = Field(0.2, description="grey values per electron")
    black_level_dn: float = Field(0.0, ge=0.0, description="grey value of no light")
    bit_depth: int = Field(12, ge=1, le=16)
    shot_noise: bool = True

    @property
    def white_dn(self) -> int:
        """Grey value of a saturated pixel: the lower limit of full well and converter."""
        full = round(self.black_level_dn + self.gain_dn_e * self.full_well_e)
        return min((1 << self.bit_depth) - 1, full)


class Render(_Table):
    """How the images are computed."""

    relative_error: float | None = Field(
        None,
        ge=1e-4,
        le=0.2,
        description="of pixels of bubbles and solids, mean over an image: standard error over value; by default 0.01",
    )

    samples_per_pixel: int = Field(
        9, ge=1, le=4096, description="a square number: a regular grid of rays in each pixel"
    )

    @model_validator(mode="after")
    def _square(self) -> Render:
        if math.isqrt(self.samples_per_pixel) ** 2 != self.samples_per_pixel:
            raise ValueError(
                f"samples_per_pixel: expected a square number, got {self.samples_per_pixel}"
            )
        return self


class Scene(_Table):
    """A whole scene: the world, what lights it, who looks at it through what."""

    title: str
    frames: int = Field(1, ge=1)
    interval_s: Positive = Field(1e-3, description="time between frames")
    timing: Timing | None = Field(None, description="instead of frames at equal intervals")
    volume: Volume
    grid: GridSpec
    wall: WallSpec | None = None
    occluders: tuple[OccluderSpec, ...] | None = Field(
        None, description="discs that hide some of the volume from some cameras"
    )
    cameras: Cameras
    calibration: Calibration | None = None
    illumination: Illumination | None = Field(
        None, description="the laser; needed where there are particles"
    )
    tracer: Tracer = Tracer()
    particles: dict[str, Any] | None = Field(
        None, description="`generator` names a generator; the other keys are its parameters"
    )
    flow: dict[str, Any] | None = Field(
        None, description="what carries the particles: `generator` and its parameters"
    )
    flow_grid_mm: tuple[Positive, Positive, Positive] | None = Field(
        None,
        description="spacing along x, y, z of a lattice over the volume on which the data set stores the exact flow of every frame",
    )
    targets: dict[str, Any] | None = Field(
        None,
        description="instead of particles, a calibration target that each frame shows at another place: `generator` and its parameters",
    )
    bubbles: dict[str, Any] | None = Field(
        None, description="bubbles or droplets: `generator` and its parameters"
    )
    solids: tuple[dict[str, Any], ...] | None = Field(
        None, description="bodies in the fluid: `generator` and its parameters for each"
    )
    backlight: Backlight | None = Field(None, description="a diffuser behind the volume")
    lighting: Lighting | None = Field(None, description="lamps; needed to render a target")
    detection: Detection | None = Field(
        None, description="by default every point of a target is found where it is"
    )
    sensor: Sensor = Sensor()
    preprocessing: tuple[Step, ...] | None = Field(
        None, description="what is done to the images before solvers see them; those stored are raw"
    )
    render: Render = Render()

    @model_validator(mode="after")
    def _one_world(self) -> Scene:
        bodies = self.bubbles is not None or bool(self.solids)
        if (self.particles is None and not bodies) == (self.targets is None):
            raise ValueError("expected either particles, bubbles or solids, or targets")
        if bodies and self.backlight is None and self.lighting is None:
            raise ValueError("expected a backlight or a lighting for bubbles and solids")
        if self.backlight is not None and not bodies:
            raise ValueError("backlight: expected bubbles or solids in front of it")
        if self.flow is not None and self.particles is None:
            raise ValueError("flow: expected particles that it carries")
        if self.flow_grid_mm is not None and self.flow is None:
            raise ValueError("flow_grid_mm: expected a flow")
        if self.particles is not None and self.illumination is None:
            raise ValueError("expected an illumination for the particles")
        return self

    @property
    def light(self) -> Illumination:
        """The laser of a scene with particles."""
        if self.illumination is None:
            raise ValueError(f"{self.title}: expected a scene with an illumination")
        return self.illumination

    @property
    def unknown(self) -> tuple[LensNumber, ...]:
        """What nobody has measured of the lenses."""
        return (self.calibration.unknown if self.calibration else None) or ()

    def time_s(self, frame: int) -> float:
        """When a frame is taken, from the first group's start."""
        if self.timing is None:
            return frame * self.interval_s
        group, pulse = divmod(frame, len(self.timing.pulses_s))
        return group / self.timing.rate_hz + self.timing.pulses_s[pulse]

    def with_frames(self, frames: int) -> Scene:
        """The same scene, longer or shorter."""
        return Scene.model_validate({**self.model_dump(exclude_none=True), "frames": frames})

    def to_dict(self) -> dict[str, Any]:
        """All keys with their values, defaults included, as TOML holds them."""
        values: dict[str, Any] = plain(self.model_dump(mode="json", exclude_none=True))
        return values

    def to_toml(self) -> str:
        """The resolved scene as TOML; loading it gives an equal scene."""
        return tomli_w.dumps(self.to_dict())

    @property
    def hash(self) -> str:
        """SHA-256 of the resolved scene: equal scenes have equal hashes, however they were written."""
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

    def with_files(self, places: dict[str, Path]) -> Scene:
        """The same scene, its files elsewhere."""
        worlds = {
            table: {**getattr(self, table), "file": str(place)}
            for table, place in places.items()
            if table in WORLDS
        }
        solids = tuple(
            {**given, "file": str(places[key])} if (key := f"solids.{number}") in places else given
            for number, given in enumerate(self.solids or ())
        )
        return self.model_copy(update=worlds | ({"solids": solids} if solids else {}))


def plain(value: Any) -> Any:
    """Nested tuples as lists, as TOML and JSON give them back."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    return [plain(inner) for inner in value] if isinstance(value, list | tuple) else value
