"""Plan of an experiment: all figures of a scene and its warnings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.evaluation.planning.calibration import plan_calibration
from sabench.evaluation.planning.density import plan_density
from sabench.evaluation.planning.expected_scores import plan_scores
from sabench.evaluation.planning.light import plan_light, sample_images
from sabench.evaluation.planning.optics import plan_depth, plan_sharpness, plan_view
from sabench.evaluation.planning.quantities import Advice, Section
from sabench.evaluation.planning.recording import Recorder, plan_recording
from sabench.evaluation.planning.viewing import Viewing, view
from sabench.scenes import Rig, Scene, build_rig, load_scene
from sabench.simulation.frames import Frames


@dataclass(frozen=True)
class Plan:
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
        """Warnings of all sections."""
        return tuple(one for section in self.sections for one in section.advice)

    def to_dict(self) -> dict[str, Any]:
        """Give all figures and warnings as JSON holds them."""
        return {
            "title": self.scene.title,
            "figures": {
                one.key: {"value": one.value, "meaning": one.meaning, "source": one.source}
                for section in self.sections
                for one in section.quantities
            },
            "warnings": [{"key": one.key, "sentence": one.sentence} for one in self.advice],
        }


def plan(scene: Scene | str | Path, recorder: Recorder | None = None) -> Plan:
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
    viewing = view(loaded, rig)
    sections = [plan_view(loaded, viewing), plan_depth(loaded, viewing)]
    sections += [plan_sharpness(loaded, viewing), plan_calibration(loaded, viewing)]
    sample, lit = None, loaded
    if loaded.tracers is not None:
        frame = Frames(loaded, rig, 0, "splat").at(0)
        lit = frame.scene
        sample = sample_images(frame, frame.tracers) if frame.tracers else None
    if sample is not None:
        sections += [plan_light(sample), plan_density(loaded, viewing, sample)]
        expected = plan_scores(loaded, sections)
        sections += [expected] if expected is not None else []
    sections.append(plan_recording(loaded, viewing, recorder or Recorder(), sample))
    return Plan(lit, rig, viewing, tuple(sections))
