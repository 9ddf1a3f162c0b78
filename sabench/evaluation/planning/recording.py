"""Figures of the recording: data rate, buses, buffer and times of pulses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sabench.evaluation.planning.light import Sample
from sabench.evaluation.planning.quantities import Advice, Quantity, Section
from sabench.evaluation.planning.viewing import Viewing
from sabench.scenes import Scene
from sabench.utils.errors import InputError

_FAST = 99.0  # percentile of displacements


@dataclass(frozen=True)
class Recorder:
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
    scene: Scene, view: Viewing, recorder: Recorder, sample: Sample | None
) -> Section:
    """Compute data rates and times; a single frame and a target have none."""
    frame_mb = scene.cameras.rows * scene.cameras.columns * _bytes_per_pixel(scene) / 1e6
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
        Quantity("displacement_px", moved, "of fast particles, between frames", "v dt / dX")
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


def _bytes_per_pixel(scene: Scene) -> int:
    return 1 if scene.sensor.bit_depth <= 8 else 2


def _straddling(scene: Scene, recorder: Recorder) -> list[Quantity]:
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


def _displacement_px(scene: Scene, view: Viewing, sample: Sample) -> float | None:
    if not len(sample.particles):
        return None
    speed = np.linalg.norm(sample.particles.velocity_mm_s, axis=1)
    fast = float(np.percentile(speed, _FAST))
    return fast * shortest_step_s(scene) / view.pixel_mm(0.5)


def _advise(scene: Scene, recorder: Recorder, per_bus: int) -> list[Advice]:
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
