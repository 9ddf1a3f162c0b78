"""The bubbles track: one observation in, bubbles out, frame by frame."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from sabench.algorithms.particles.linking import link
from sabench.api import BubbleSolver, Detections
from sabench.api.truth import Bubbles
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.dataset.schema import CamerasFile, frame_group
from sabench.metrics.averages import finite_or_none, mean_of_each
from sabench.metrics.bubble_detection import AnyBubbles, detection_scores
from sabench.metrics.plunging_jet import JetFigures, analyse
from sabench.metrics.trajectories import trajectory_scores
from sabench.plotting import pictures
from sabench.scenes import Scene
from sabench.tasks.solver_call import attempt
from sabench.utils import memory
from sabench.utils.arrays import I64
from sabench.utils.errors import InputError
from sabench.utils.progress import track
from sabench.worlds.library.plunging_jet import EDGE

JET = {
    "penetration_percent": "penetration_mm",
    "angle_percent": "angle_deg",
    "weight_percent": "weight",
    "width_percent": "width",
}


def run(algorithm: BubbleSolver, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
    """Find every frame's bubbles; returns the seconds that each took.

    Raises
    ------
    InputError
        A solver that declines, raises, or returns something else.
    """
    seconds, every = [], []
    for frame in range(data.rig.frames):
        case = data.observation(frame)
        start = time.perf_counter()
        found: Detections = attempt(algorithm, name, case, Detections, f" on frame {frame}")
        seconds.append(time.perf_counter() - start)
        writer.add_bubbles(frame, found)
        every.append(found)
        memory.trim()
    for frame, number in enumerate(linked(data.rig, every)):
        writer.add_tracks(frame, number)
    return seconds


def linked(rig: CamerasFile, found: Sequence[AnyBubbles]) -> list[I64]:
    """Numbers (n,) of the tracks of every frame's bubbles; no track goes from one group of pulses to the next."""
    out: list[I64] = []
    for frames in rig.sequences():
        part = link(
            [found[f].center_mm for f in frames],
            [found[f].radius_mm for f in frames],
            [rig.time_s(f) for f in frames],
        )
        first = max((int(one.max(initial=-1)) for one in out), default=-1) + 1
        out.extend(first + one for one in part)
    return out


def copy(data: Dataset, result: Result, writer: ResultWriter) -> None:
    """Write the bubbles of every frame of a foreign result anew, with its tracks or those that `linked` makes; reading checks it."""
    found = [result.bubbles(frame) for frame in range(data.rig.frames)]
    for frame, number in enumerate(tracks(data, result, found)):
        writer.add_bubbles(frame, found[frame])
        writer.add_tracks(frame, number)


def score_result(data: Dataset, result: Result | str) -> dict[str, float | None]:
    """All scores: means over the frames, and the figures of a jet and of tracks from all frames together."""
    frames, found, every = [], [], []
    for frame in track(range(data.rig.frames), "score"):
        guess, true = estimate(data, result, frame), data.bubbles(frame)
        seen = np.mean([data.sight(frame, camera).visible for camera in data.rig.cameras], axis=0)
        frames.append(detection_scores(guess, true, seen))
        found.append(guess)
        every.append(true)
    number, times = (
        tracks(data, result, found),
        [data.rig.time_s(frame) for frame in range(data.rig.frames)],
    )
    over_time = {
        key: finite_or_none(value)
        for key, value in trajectory_scores(
            found, number, every, times, data.rig.sequences()
        ).items()
    }
    return mean_of_each(frames) | _jet_scores(data, found, every) | over_time


def estimate(data: Dataset, result: Result | str, frame: int) -> AnyBubbles:
    """The estimate of a frame: a result's, or the one that the word `truth` or `empty` stands for."""
    if isinstance(result, Result):
        return result.bubbles(frame)
    return (
        data.bubbles(frame)
        if result == "truth"
        else Detections.balls(np.zeros((0, 3)), np.zeros(0))
    )


def tracks(data: Dataset, result: Result | str, found: Sequence[AnyBubbles]) -> list[I64]:
    """Numbers of the tracks of every frame's estimate: the result's own, those of the true bubbles for `truth`, or else what `linked` makes of it.

    Raises
    ------
    InputError
        A result that has tracks in some frames only.
    """
    if not isinstance(result, Result):
        return [
            one.id if isinstance(one, Bubbles) else np.arange(len(one.center_mm)) for one in found
        ]
    given = [result.tracks(frame) for frame in range(data.rig.frames)]
    own = [number for number in given if number is not None]
    if own and len(own) < len(given):
        missing = next(frame for frame, number in enumerate(given) if number is None)
        raise InputError(
            f"{result.path}: {frame_group(missing)}/bubbles/track: expected one in every frame or in none, found none here"
        )
    return own if own else linked(data.rig, found)


def _jet_scores(
    data: Dataset, found: Sequence[AnyBubbles], true: Sequence[AnyBubbles]
) -> dict[str, float | None]:
    """Errors of a jet's figures against the same analysis of the true bubbles; None where the scene has no jet."""
    if (data.scene.bubbles or {}).get("generator") != "plunging_jet":
        return dict.fromkeys(JET)
    guess, known = (jet_figures(data.scene, one) for one in (found, true))
    pairs = {key: (getattr(guess, name), getattr(known, name)) for key, name in JET.items()}
    return {
        key: finite_or_none(100.0 * abs(one / other - 1.0)) if other else None
        for key, (one, other) in pairs.items()
    }


def jet_figures(scene: Scene, balls: Sequence[AnyBubbles]) -> JetFigures:
    """What the bubbles of some frames say of a scene's jet."""
    assert scene.bubbles is not None
    impact, volume = np.asarray(scene.bubbles["impact_mm"]), scene.volume
    depth = volume.center_mm[1] + volume.size_mm[1] / 2.0 - impact[1]
    return analyse(
        np.concatenate([one.center_mm for one in balls]),
        np.concatenate([one.radius_mm for one in balls]),
        impact,
        depth,
        EDGE,
        len(balls),
    )


def images(data: Dataset) -> bytes:
    """What the cameras saw, as a PNG."""
    seen = data.observation(0)
    return pictures.backlit(seen.images, seen.black_dn, seen.white_dn)


def picture(data: Dataset, result: Result | str) -> bytes:
    """The bubbles that were found, from the front and from the side, as a PNG."""
    from sabench.plotting.charts import draw
    from sabench.tasks.figures.bubbles import bubble_figure

    return draw(bubble_figure(estimate(data, result, 0), "bubbles"))


def error_picture(data: Dataset, result: Result) -> bytes:
    """Bubbles that were found, missed, and found where there are none, as a PNG."""
    from sabench.plotting.charts import draw
    from sabench.tasks.figures.bubbles import detection_figure

    return draw(detection_figure(result.bubbles(0), data.bubbles(0)))
