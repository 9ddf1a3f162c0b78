"""Physically based synthetic data and benchmarks for volumetric velocimetry."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from sabench.utils.kernel_cache import stamp_kernels
from sabench.utils.version import __version__

if TYPE_CHECKING:
    from sabench import (
        algorithms,
        api,
        evaluation,
        geometry,
        images,
        metrics,
        plotting,
        tasks,
    )
    from sabench.api.truth import Bubbles, Particles
    from sabench.dataset.import_recording import ImportOptions, import_recording
    from sabench.dataset.reader import Dataset, open_dataset
    from sabench.dataset.results import Result, open_result
    from sabench.dataset.sample_set import SampleSet, open_samples
    from sabench.dataset.shards import split_of
    from sabench.dataset.verification import verify
    from sabench.evaluation.gates.comparison import check_file as check
    from sabench.evaluation.leaderboard.submissions import submit
    from sabench.evaluation.runner import run_suite
    from sabench.evaluation.thesis import reproduce
    from sabench.evaluation.viewer.view import View, view
    from sabench.geometry.camera import Camera
    from sabench.geometry.grid import Grid
    from sabench.geometry.refraction import Layer, Wall
    from sabench.interop.camera_sources import read_camera_source
    from sabench.interop.export import export
    from sabench.plugins import list_generators, list_scenes, list_solvers, list_suites
    from sabench.scenes import Scene, load_scene
    from sabench.simulation.in_memory import simulate
    from sabench.simulation.pipeline import generate
    from sabench.simulation.sample_shards import generate_samples
    from sabench.simulation.streaming import stream_key
    from sabench.simulation.streaming import stream_samples as stream
    from sabench.tasks.own_calibration import calibrate
    from sabench.tasks.quality import quality
    from sabench.tasks.solve_and_score import score, solve


# Names of the public face and the modules that define them; the imports above are the same for
# type checkers.
_HOMES = {
    "Bubbles": "api.truth",
    "Camera": "geometry.camera",
    "Dataset": "dataset.reader",
    "Grid": "geometry.grid",
    "ImportOptions": "dataset.import_recording",
    "Layer": "geometry.refraction",
    "Particles": "api.truth",
    "Result": "dataset.results",
    "SampleSet": "dataset.sample_set",
    "Scene": "scenes",
    "View": "evaluation.viewer.view",
    "Wall": "geometry.refraction",
    "calibrate": "tasks.own_calibration",
    "check": "evaluation.gates.comparison:check_file",
    "export": "interop.export",
    "generate": "simulation.pipeline",
    "generate_samples": "simulation.sample_shards",
    "import_recording": "dataset.import_recording",
    "list_generators": "plugins",
    "list_scenes": "plugins",
    "list_solvers": "plugins",
    "list_suites": "plugins",
    "load_scene": "scenes",
    "open_dataset": "dataset.reader",
    "open_result": "dataset.results",
    "open_samples": "dataset.sample_set",
    "quality": "tasks.quality",
    "read_camera_source": "interop.camera_sources",
    "reproduce": "evaluation.thesis",
    "run_suite": "evaluation.runner",
    "score": "tasks.solve_and_score",
    "simulate": "simulation.in_memory",
    "solve": "tasks.solve_and_score",
    "split_of": "dataset.shards",
    "stream": "simulation.streaming:stream_samples",
    "stream_key": "simulation.streaming",
    "submit": "evaluation.leaderboard.submissions",
    "verify": "dataset.verification",
    "view": "evaluation.viewer.view",
}
_NAMESPACES = (
    "algorithms",
    "api",
    "evaluation",
    "geometry",
    "images",
    "metrics",
    "plotting",
    "tasks",
)
__all__ = [
    "Bubbles",
    "Camera",
    "Dataset",
    "Grid",
    "ImportOptions",
    "Layer",
    "Particles",
    "Result",
    "SampleSet",
    "Scene",
    "View",
    "Wall",
    "__version__",
    "algorithms",
    "api",
    "calibrate",
    "check",
    "evaluation",
    "export",
    "generate",
    "generate_samples",
    "geometry",
    "images",
    "import_recording",
    "list_generators",
    "list_scenes",
    "list_solvers",
    "list_suites",
    "load_scene",
    "metrics",
    "open_dataset",
    "open_result",
    "open_samples",
    "plotting",
    "quality",
    "read_camera_source",
    "reproduce",
    "run_suite",
    "score",
    "simulate",
    "solve",
    "split_of",
    "stream",
    "stream_key",
    "submit",
    "tasks",
    "verify",
    "view",
]


stamp_kernels()

if not TYPE_CHECKING:  # type checkers would take any name for one of the module's

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use: `import sabench` stays light."""
        if name in _NAMESPACES:
            return importlib.import_module(f"sabench.{name}")
        if name not in _HOMES:
            raise AttributeError(f"module 'sabench' has no attribute {name!r}")
        module, _, original = _HOMES[name].partition(":")
        value = getattr(importlib.import_module(f"sabench.{module}"), original or name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    """List the public names, for tab completion."""
    return sorted(__all__)
