"""Plan of an experiment: a design for a wanted depth, figures, warnings.

The calibration has the errors of nominal cameras in the images; the recording has data rate, buses,
buffer and times of pulses.
"""

import copy
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.apps.planning import optics
from sabench.apps.planning.expected_scores import plan_density, plan_scores
from sabench.apps.planning.viewing import Advice, Quantity, Section, Viewing, compute_viewing
from sabench.geometry.camera_model import describe_cameras
from sabench.geometry.common_view import lattice_of
from sabench.plotting.card import Card
from sabench.scenes import Rig, Scene, build_rig, load_scene, parse_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.scenes.usual import unusual_values
from sabench.simulation.frames import Frames
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError


def calibration_error_px(scene: Scene, view: Viewing) -> float:
    """Compute the RMS distance in the images between nominal and true cameras.

    Over a lattice of the volume and over all cameras, for seed 0.
    """
    points = lattice_of(view.rig.grid, 5)
    apart = [
        nominal.project(points)[0] - true.project(points)[0]
        for nominal, true in zip(
            nominal_cameras(scene, view.rig.cameras, 0), view.rig.cameras, strict=True
        )
    ]
    return float(np.sqrt(np.nanmean(np.sum(np.square(apart), axis=2))))


def plan_calibration(scene: Scene, view: Viewing) -> Section:
    """Compute the calibration error that the scene has."""
    error = calibration_error_px(scene, view)
    given = Quantity("calibration_px", error, "RMS error of nominal cameras", "calibration")
    return Section("calibration", (given,))


@dataclass(frozen=True)
class RecordingSystem:
    """Computer and cameras of a recording; by default the thesis's, 3.2.1.

    Attributes
    ----------
    bus_mb_s : transfer rate of one bus, MB/s.
    memory_gb : memory that holds the images of a recording.
    gap_us : shortest time between two exposures.
    """

    bus_mb_s: float = 80.0
    memory_gb: float = 8.0
    gap_us: float = 250.0

    def __post_init__(self) -> None:
        """Check the numbers; the names in errors are those of the command's options."""
        for option, value in (("bus-mb-s", self.bus_mb_s), ("memory-gb", self.memory_gb)):
            if not 0.0 < value < math.inf:
                raise InputError(f"--{option}: expected a positive number, got {value:g}")
        if not 0.0 <= self.gap_us < math.inf:
            raise InputError(f"--gap-us: expected 0 or more, got {self.gap_us:g}")


def plan_recording(
    scene: Scene, view: Viewing, recorder: RecordingSystem, sample: optics.ParticleSample | None
) -> Section:
    """Compute data rates and times; a single frame and a target have none."""
    frame_mb = (
        scene.cameras.rows * scene.cameras.columns * (1 if scene.sensor.bit_depth <= 8 else 2) / 1e6
    )
    data = Quantity("frame_mb", frame_mb, "data of a frame, MB", "8 or 16 bits a pixel")
    if scene.timing is None and (scene.frames == 1 or scene.targets is not None):
        return Section("recording", (data,))
    count, rate = len(view.rig.cameras), frames_per_s(scene)
    camera, whole = frame_mb * rate, frame_mb * rate * count
    per_bus = math.floor(recorder.bus_mb_s / camera)
    quantities = [
        Quantity("frames_per_s", rate, "frames of a camera", "timing or interval_s"),
        data,
        Quantity("camera_mb_s", camera, "data rate of a camera, MB/s", "(3.1)"),
        Quantity("array_mb_s", whole, "data rate of the array, MB/s", "(3.1)"),
        Quantity("cameras_per_bus", per_bus, f"at {recorder.bus_mb_s:g} MB/s a bus", "(3.2)"),
        Quantity(
            "buses", math.ceil(count / per_bus) if per_bus else None, "for all cameras", "(3.2)"
        ),
        Quantity(
            "buffer_s",
            1e3 * recorder.memory_gb / whole,
            f"that {recorder.memory_gb:g} GB hold",
            "3.2.1",
        ),
        *_straddling(scene, recorder),
    ]
    moved = None if sample is None else _displacement_px(scene, view, sample)
    quantities.append(
        Quantity("displacement_px", moved, "of the fastest particle, between frames", "v dt / dX")
    )
    return Section("recording", tuple(quantities), tuple(_advise(scene, recorder, per_bus)))


def frames_per_s(scene: Scene) -> float:
    """Return the frames that a camera records in a second, one for each pulse."""
    if scene.timing is None:
        return 1.0 / scene.interval_s
    return scene.timing.rate_hz * len(scene.timing.pulses_s)


def shortest_step_s(scene: Scene) -> float:
    """Return the shortest time between two frames."""
    if scene.timing is None or len(scene.timing.pulses_s) < 2:
        return 1.0 / frames_per_s(scene)
    return float(np.diff(scene.timing.pulses_s).min())


def _straddling(scene: Scene, recorder: RecordingSystem) -> list[Quantity]:
    """Place two pulses evenly about the gap between two exposures, figure 3-3."""
    if scene.timing is None or len(scene.timing.pulses_s) != 2:
        return []
    step = 1e6 * shortest_step_s(scene)
    middle = 1e6 / frames_per_s(scene) - recorder.gap_us / 2.0
    after = "us after the start of the first exposure"
    return [
        Quantity("pulse_step_us", step, "time between the pulses", "timing.pulses_s"),
        Quantity("first_pulse_us", middle - step / 2.0, after, "figure 3-3"),
        Quantity("second_pulse_us", middle + step / 2.0, after, "figure 3-3"),
    ]


def _displacement_px(scene: Scene, view: Viewing, sample: optics.ParticleSample) -> float | None:
    if not len(sample.particles):
        return None
    fastest = float(np.linalg.norm(sample.particles.velocity_mm_s, axis=1).max())
    return fastest * shortest_step_s(scene) / view.pixel_mm(0.5)


def _advise(scene: Scene, recorder: RecordingSystem, per_bus: int) -> list[Advice]:
    advice, timed = [], scene.timing is not None
    step, gap = shortest_step_s(scene), 1e-6 * recorder.gap_us
    if not per_bus:
        key = "timing.rate_hz" if timed else "interval_s"
        problem = f"a bus of {recorder.bus_mb_s:g} MB/s takes less than one camera"
        advice.append(Advice(key, f"{problem}: change {key}, or record in the cameras' memory"))
    if step < gap:
        key = "timing.pulses_s" if timed else "interval_s"
        problem = f"frames are {1e6 * step:.4g} us apart and exposures {recorder.gap_us:g} us"
        advice.append(Advice(key, f"{problem}: raise {key}, or choose cameras with a shorter gap"))
    longest = 1.0 / frames_per_s(scene) - gap
    if 0.0 < longest < scene.sensor.exposure_s:
        key = "sensor.exposure_s"
        problem = f"an exposure of {scene.sensor.exposure_s:g} s does not fit between frames"
        advice.append(Advice(key, f"{problem}: reduce {key} to {longest:.3g}"))
    return advice


@dataclass(frozen=True, repr=False)
class Plan(Card):
    """Figures and warnings of a scene.

    Attributes
    ----------
    scene : with the laser as it is in the fluid.
    """

    scene: Scene
    rig: Rig
    viewing: Viewing
    sections: tuple[Section, ...]

    @property
    def advice(self) -> tuple[Advice, ...]:
        """Warnings of values that no rig has or, without any, of all sections."""
        unusual = tuple(Advice(key, sentence) for key, sentence in unusual_values(self.scene))
        return unusual or tuple(one for section in self.sections for one in section.advice)

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (f"Plan of {self.scene.title}",)
        yield "cameras", describe_cameras(self.rig.cameras)
        for section in self.sections:
            entry = section.quantities[0]
            yield section.title, f"{entry.text} {entry.meaning} ({entry.key})"
        yield "warnings", ", ".join(one.key for one in self.advice) or "none"

    def _picture(self) -> bytes:
        return self.rig._picture()

    def to_dict(self) -> dict[str, Any]:
        """Give all figures and warnings as JSON holds them."""
        return {
            "title": self.scene.title,
            "figures": {
                entry.key: {"value": entry.value, "meaning": entry.meaning, "source": entry.source}
                for section in self.sections
                for entry in section.quantities
            },
            "warnings": [{"key": entry.key, "sentence": entry.sentence} for entry in self.advice],
        }


def plan(scene: Scene | str | Path, recorder: RecordingSystem | None = None) -> Plan:
    """Plan an experiment.

    Parameters
    ----------
    scene : a scene, a scene file, or the name of a bundled one.
    recorder : computer and cameras; by default those of the thesis.

    Raises
    ------
    InputError
        As `generate`: a bad scene, or an impossible geometry.
    """
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    rig = build_rig(loaded, loaded.title if isinstance(scene, Scene) else str(scene))
    viewing = compute_viewing(loaded, rig)
    sections = [optics.plan_view(loaded, viewing), optics.plan_depth(loaded, viewing)]
    sections += [optics.plan_sharpness(loaded, viewing), plan_calibration(loaded, viewing)]
    sample, lit = None, loaded
    if loaded.world.tracers is not None:
        frame = Frames(loaded, rig, 0, "splat").at(0)
        lit = frame.scene
        sample = optics.sample_images(frame, frame.tracers) if frame.tracers else None
    if sample is not None:
        sections += [optics.plan_light(sample), plan_density(loaded, viewing, sample)]
        expected = plan_scores(sections)
        sections += [expected] if expected is not None else []
    sections.append(plan_recording(loaded, viewing, recorder or RecordingSystem(), sample))
    return Plan(lit, rig, viewing, tuple(sections))


_STEPS = 20  # steps of the search for a distance
_CLOSE = 1e-4  # relative error of the resolution
_LENGTHS = ("spacing_mm", "radius_mm", "x_mm", "y_mm")  # lengths of layouts
_DENSITIES = ("count", "per_mm3", "per_pixel")

_Values = dict[str, Any]


@dataclass(frozen=True)
class Wanted:
    """Wanted volume.

    Attributes
    ----------
    depth_mm : length of the volume along the lines of sight.
    per_mm3 : particles per mm3.
    pixel_mm : width of the innermost camera's pixel at the middle of the volume.
    """

    depth_mm: float
    per_mm3: float
    pixel_mm: float

    def __post_init__(self) -> None:
        """Check the numbers; the names in errors are those of the command's options."""
        given = {"depth": self.depth_mm, "density": self.per_mm3, "resolution": self.pixel_mm}
        for option, value in given.items():
            if not 0.0 < value < math.inf:
                raise InputError(f"--{option}: expected a positive number, got {value:g}")


def design_scene(base: Scene, wanted: Wanted) -> Scene:
    """Change a scene of particles to another depth, density and resolution.

    Sensors, lenses, arrangement and angles of the cameras, wall and flow stay those of the base.
    The cameras move along their viewing direction, the volume keeps its share of the images, the
    f-number rises where the depth of field would be too small, the laser gives as many electrons
    as in the base, and the margin that scores leave out is what not all cameras see.

    Raises
    ------
    InputError
        A base without particles of a given density, with cameras at listed places or behind more
        than one plane wall, or a wanted scene that cannot be built.
    """
    given = base.particle_world.particles
    if not any(key in given for key in _DENSITIES):
        raise InputError(
            f"{base.title}: particles.generator: expected one with per_mm3, got "
            f"{given['generator']}"
        )
    if base.cameras.layout.kind == "list":
        raise InputError(
            f"{base.title}: cameras.layout.kind: expected grid, ring, line or cross to scale, got "
            "list"
        )
    if base.walls and base.plane is None:
        raise InputError(f"{base.title}: wall: expected one plane wall or none to move")
    electrons = _figure(base, "peak_e")
    viewing = compute_viewing(base, build_rig(base, base.title))
    start = _with_volume(base, viewing, wanted)
    values = _move_cameras(start, viewing, wanted, base)
    # choose the f-number with the wanted depth of field, or the base's. The depth of field grows
    # with its square
    scene = _scene(values)
    field = _figure(scene, "depth_of_field_mm")
    values["cameras"]["f_number"] = scene.cameras.f_number * max(
        1.0, math.sqrt(wanted.depth_mm / field)
    )
    values["illumination"]["pulse_energy_mj"] *= electrons / _figure(_scene(values), "peak_e")
    return _scene(_with_crop(values, viewing, wanted))


def _scene(values: Mapping[str, Any]) -> Scene:
    return parse_scene(dict(values), "wanted scene")


def _figure(scene: Scene, key: str) -> float:
    figures = {entry.key: entry.value for part in plan(scene).sections for entry in part.quantities}
    value = figures.get(key)
    if not value:
        raise InputError(f"{scene.title}: illumination: expected light on the particles, got none")
    return value


def _with_volume(base: Scene, viewing: Viewing, wanted: Wanted) -> _Values:
    """Change volume, voxels, density, light and the wall's position."""
    values, ratio = base.to_dict(), wanted.pixel_mm / viewing.pixel_mm(0.5)
    deeper = wanted.depth_mm - viewing.depth_mm
    size = [edge * ratio for edge in base.volume.size_mm]
    size[viewing.axis] = wanted.depth_mm
    values["title"] = (
        f"{wanted.depth_mm:g} mm deep, {wanted.per_mm3:g} particles per mm3, "
        f"{wanted.pixel_mm:g} mm per pixel, after: {base.title}"
    )
    values["volume"]["size_mm"] = size
    values["grid"]["voxel_mm"] = [edge * ratio for edge in base.grid.voxel_mm]
    values["grid"]["crop_mm"] = [0.0, 0.0, 0.0]
    if base.plane is not None:
        moved = np.asarray(base.plane.point_mm) - deeper / 2.0 * viewing.forward
        values["wall"]["point_mm"] = moved.tolist()
        if base.plane.depth_mm is not None:
            values["wall"]["depth_mm"] = max(base.plane.depth_mm + deeper, 1.01 * wanted.depth_mm)
    grown = max(wanted.depth_mm / viewing.depth_mm, ratio)
    for key in ("thickness_mm", "height_mm"):
        values["illumination"][key] *= grown
    for key in _DENSITIES:
        values["particles"].pop(key, None)
    values["particles"]["per_mm3"] = wanted.per_mm3
    return values


def _move_cameras(values: _Values, viewing: Viewing, wanted: Wanted, base: Scene) -> _Values:
    """Move the cameras back or forth until a pixel has the wanted width."""
    middle, place = viewing.center_mm, np.asarray(base.cameras.center_mm)
    scale = wanted.pixel_mm / viewing.pixel_mm(0.5)
    for _ in range(_STEPS):
        moved = _scaled(values, base, middle, place, scale)
        scene = _scene(moved)
        got = compute_viewing(scene, build_rig(scene, "wanted scene")).pixel_mm(0.5)
        if abs(got / wanted.pixel_mm - 1.0) < _CLOSE:
            return moved
        scale *= wanted.pixel_mm / got
    raise InputError(
        f"--resolution: expected one that this lens reaches, got {wanted.pixel_mm:g} mm per pixel"
    )


def _scaled(values: _Values, base: Scene, middle: F64, place: F64, scale: float) -> _Values:
    """Scale the distances of the cameras from the volume and from each other."""
    moved = copy.deepcopy(values)
    moved["cameras"]["center_mm"] = (middle + scale * (place - middle)).tolist()
    layout = moved["cameras"]["layout"]
    for key in _LENGTHS:
        if key in layout:
            lengths = layout[key]
            many = isinstance(lengths, list)
            layout[key] = [length * scale for length in lengths] if many else lengths * scale
    if base.cameras.focus_mm is not None:
        moved["cameras"]["focus_mm"] = base.cameras.focus_mm * scale
    return moved


def _with_crop(values: _Values, viewing: Viewing, wanted: Wanted) -> _Values:
    """Widen the margin sideways until all cameras see what it leaves."""
    across = [edge for edge in range(3) if edge != viewing.axis]
    size = values["volume"]["size_mm"]
    for share in np.arange(0.0, 0.45, 0.05):
        cropped = copy.deepcopy(values)
        for edge in across:
            cropped["grid"]["crop_mm"][edge] = float(share) * min(size[side] for side in across)
        scene = _scene(cropped)
        seen = compute_viewing(scene, build_rig(scene, "wanted scene"))
        if seen.share_scored >= optics.NEARLY_ALL:
            return cropped
    raise InputError(
        f"--depth: expected one over which the cameras' views meet, got {wanted.depth_mm:g} mm"
    )
