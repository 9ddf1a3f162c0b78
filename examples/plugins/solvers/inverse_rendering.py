"""Particles by inverse rendering with automatic derivatives."""

from pydantic import Field
from sabench.plugins.solvers._inverse_rendering.descent import (
    InverseRenderingSettings,
    reconstruct_by_descent,
)

from sabench.algorithms.particles import fit_cameras
from sabench.api import (
    Camera,
    CameraModel,
    FoundParticles,
    ImageSequence,
    Parameters,
    ParticleSolver,
    Wall,
    progress_bar,
)


class InverseRenderingParameters(Parameters):
    """Parameters of the descent."""

    steps: int = Field(
        200, ge=1, description="most steps of a descent, before windows are laid out again"
    )
    descents: int = Field(
        5, ge=1, description="most descents; those after the first follow particles that moved far"
    )
    slope: float = Field(
        0.01,
        gt=0.0,
        description="largest derivative of the cost at the end, by a standard deviation of a "
        "particle's position or light",
    )


class InverseRendering(ParticleSolver):
    """Inverse rendering of particles (experimental, small scenes).

    The particles that `bayesian_ipr` finds are moved together to the least cost, with derivatives
    that Dr.Jit takes of a renderer. No particle is added or removed. Positions agree with those of
    40 more rounds of the search's own fit (benchmarks/inverse_rendering.py): automatic derivatives
    check its kernels, and take unknowns without new formulas. The harness links the frames.
    """

    name = "inverse_rendering"
    references = (
        "Liu and Nocedal, Math. Programming 45 (1989) 503-528",
        "Jakob, Speierer, Roussel and Vicini, ACM Trans. Graph. 41 (2022) 124",
    )
    Parameters = InverseRenderingParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip fewer than three cameras, and those that the renderer has no model of."""
        if len(case.cameras) < 3:
            return "it needs three cameras"
        return next((reason for camera in case.cameras if (reason := _unfit(camera))), None)

    def solve(self, case: ImageSequence) -> list[FoundParticles]:
        """Reconstruct each frame on its own."""
        chosen = self.parameters
        settings = InverseRenderingSettings(chosen.steps, chosen.descents, chosen.slope)
        maps = fit_cameras(case[0])
        return [
            reconstruct_by_descent(frame, maps, settings)
            for frame in progress_bar(case, "inverse rendering")
        ]


def _unfit(camera: CameraModel) -> str | None:
    """Say why the renderer cannot describe a camera; None if it can."""
    if not isinstance(camera, Camera):
        return f"{camera.name} is no pinhole"
    if camera.wall is not None and not isinstance(camera.wall, Wall):
        return f"{camera.name} looks through a wall that is not plane"
    return None
