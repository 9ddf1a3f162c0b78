"""OpenLPT, an independent program for Lagrangian particle tracking."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import Field

from sabench.api import (
    Camera,
    FoundParticles,
    ImageSequence,
    Parameters,
    ParticleSolver,
    progress_bar,
)
from sabench.interop.image_statistics import FrameStatistics, measure_frame
from sabench.interop.openlpt import (
    Settings,
    derive_settings,
    missing,
    solve,
    unfit,
    write_frame,
    write_project,
)


class OpenLptParameters(Parameters):
    """Settings of OpenLPT that the images do not show.

    The other settings are derived from the images, or are the defaults of OpenLPT's own window:
    more rounds of shaking, wider shakes and a higher ghost threshold changed F1 by less than 0.002
    on seed 11. Peaks below 0.2 of a bright particle's are left out, as residuals become ghosts.
    """

    displacement_px: float = Field(
        10.0, gt=0.0, description="largest displacement from frame to frame, in the images"
    )
    tolerance_px: float = Field(
        0.8,
        gt=0.0,
        description="largest distance of a particle image from where its camera sees the "
        "particle, first round",
    )
    floor: float = Field(
        0.2,
        gt=0.0,
        lt=1.0,
        description="smallest peak of a particle image, over a bright particle's; more if noise "
        "demands it",
    )
    shake_px: float = Field(
        0.25,
        gt=0.0,
        description="by how much particles are moved at first to see whether they fit better",
    )
    ghost: float = Field(0.01, gt=0.0, lt=1.0, description="its ghost threshold")
    rounds: int = Field(4, ge=1, description="of reconstruction with all cameras")
    fits: int = Field(4, ge=1, description="of shaking in each")
    threads: int = Field(1, ge=0, description="0: all")


class OpenLpt(ParticleSolver):
    """OpenLPT of the Ni lab: iterative particle reconstruction and Shake-the-Box.

    The version is that of PyPI. Below five frames, only its reconstruction runs.
    """

    name = "openlpt"
    references = (
        "Tan, Salibindla, Masuk and Ni, Exp. Fluids 61 (2020) 47",
        "Schanz, Gesemann and Schroeder, Exp. Fluids 57 (2016) 70",
        "https://pypi.org/project/openlpt",
    )
    Parameters = OpenLptParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip if OpenLPT is not installed or cannot describe every camera."""
        if len(case.cameras) < 2:
            return "it needs two cameras"
        odd = next((camera.name for camera in case.cameras if not isinstance(camera, Camera)), None)
        if odd:
            return f"{odd} is no pinhole"
        unfits = (
            f"{camera.name}: {reason}"
            for camera in case.cameras
            if isinstance(camera, Camera) and (reason := unfit(camera))
        )
        return missing() or next(unfits, None)

    def solve(self, case: ImageSequence) -> list[FoundParticles]:
        """Write its files, run it, read its tracks."""
        cameras = tuple(camera for camera in case.cameras if isinstance(camera, Camera))
        with tempfile.TemporaryDirectory(prefix="openlpt-") as name:
            folder = Path(name)
            for number, frame in enumerate(progress_bar(case, "images for OpenLPT")):
                write_frame(folder, number, frame.normalised_images())
            measured = measure_frame(case[0])
            if not measured.particles:
                return [FoundParticles(np.zeros((0, 3))) for _ in range(len(case))]
            write_project(folder, cameras, case.grid, len(case), self._settings(measured))
            return solve(folder, len(case))

    def _settings(self, measured: FrameStatistics) -> Settings:
        """Derive settings from the first frame."""
        chosen = self.parameters
        return replace(
            derive_settings(measured, chosen.displacement_px, chosen.tolerance_px, chosen.floor),
            shake_px=chosen.shake_px,
            ghost=chosen.ghost,
            rounds=chosen.rounds,
            fits=chosen.fits,
            threads=chosen.threads,
        )
