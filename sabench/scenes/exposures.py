"""Exposures of cameras that are not triggered at the same time."""

from collections.abc import Iterator

from sabench.scenes.illumination import Timing
from sabench.scenes.sensor import Sensor
from sabench.scenes.world import ParticleWorld, World


def recorded_part(
    timing: Timing, sensor: Sensor, frame: int, camera: int
) -> tuple[float, float] | None:
    """Compute which part of a frame's pulse a camera records; None: nothing of it.

    Returns start and end in seconds from the pulse's middle, the same for a short pulse.

    Parameters
    ----------
    timing : with `skew_s` of every camera.
    camera : its number in the rig.
    """
    pulse, half = frame % len(timing.pulses_s), timing.duration_s / 2.0
    exposure = sensor.of_camera(camera).exposure_s
    opens = _opening(timing, exposure, pulse) + (timing.skew_s or (0.0,) * (camera + 1))[camera]
    start = max(opens - timing.pulses_s[pulse], -half)
    end = min(opens + exposure - timing.pulses_s[pulse], half)
    return (start, end) if start < end or (half == 0.0 and start <= end) else None


def _opening(timing: Timing, exposure_s: float, pulse: int) -> float:
    """Compute when an exposure without delay opens, from the start of the group."""
    if timing.gap_s is None:
        return timing.pulses_s[pulse] - exposure_s / 2.0
    middle = sum(timing.pulses_s) / 2.0
    edge = timing.gap_s / 2.0
    return middle - edge - exposure_s if pulse == 0 else middle + edge


def exposure_faults(
    timing: Timing | None, sensor: Sensor, world: World
) -> Iterator[tuple[str, str]]:
    """Find delays in other worlds, and exposures that hold another pulse.

    Yields pairs of a key and a sentence.
    """
    if timing is None or timing.skew_s is None:
        return
    if not isinstance(world, ParticleWorld):
        yield "timing.skew_s", "expected a scene of particles alone: only their light is timed"
    same = len(sensor.camera_exposure or timing.skew_s) == len(timing.skew_s)
    for camera, skew in enumerate(timing.skew_s if same else ()):
        exposure = sensor.of_camera(camera).exposure_s
        other = _other_pulse(timing, exposure, skew)
        if other is not None:
            yield (
                "timing.skew_s",
                f"expected exposures that hold one pulse, got one of camera_{camera:02d} that also "
                f"holds a pulse {other:.3g} s from its own: reduce sensor.exposure_s or skew_s",
            )
            return


def _other_pulse(timing: Timing, exposure_s: float, skew_s: float) -> float | None:
    """Find another pulse in an exposure; gives its time from the own pulse."""
    period, times = 1.0 / timing.rate_hz, timing.pulses_s
    every = [time + shift for shift in (-period, 0.0, period) for time in times]
    for pulse, pulse_time in enumerate(times):
        opens = _opening(timing, exposure_s, pulse) + skew_s
        for time in every:
            early, late = time - timing.duration_s / 2.0, time + timing.duration_s / 2.0
            if abs(time - pulse_time) > 1e-12 and early < opens + exposure_s and late > opens:
                return time - pulse_time
    return None
