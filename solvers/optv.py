"""OpenPTV, an independent program for particle tracking velocimetry."""

import tempfile
from pathlib import Path

from pydantic import Field

from sabench.api import (
    Camera,
    FoundParticles,
    ImageSequence,
    Parameters,
    ParticleSolver,
    progress_bar,
)
from sabench.interop.image_statistics import measure_frame
from sabench.interop.openptv import (
    MOST_CAMERAS,
    derive_settings,
    missing,
    solve,
    unfit,
    unlike,
    write_frame,
    write_project,
)


class OptvParameters(Parameters):
    """Settings of OpenPTV that the images do not show.

    The others were chosen on seed 11, at 0.02 particles per pixel: a band of 1 px about epipolar
    lines (F1 0.882; with 0.4 px 0.831), and a discontinuity of 5 of 255 (15 loses overlaps).
    """

    displacement_px: float = Field(
        10.0, gt=0.0, description="largest displacement from frame to frame, in the images"
    )
    tolerance_px: float = Field(
        1.0, gt=0.0, description="half the width of the band about an epipolar line"
    )
    discontinuity: int = Field(
        5,
        ge=0,
        le=255,
        description="rise of grey values, of 255, away from a peak that begins another particle "
        "image",
    )
    change: float = Field(
        0.5, gt=0.0, description="largest change of a displacement, over the largest displacement"
    )
    angle_gon: float = Field(100.0, gt=0.0, le=200.0, description="largest change of its direction")


class Optv(ParticleSolver):
    """OpenPTV's library: particle tracking in images and space.

    It finds particle images by thresholds and correspondences along epipolar lines through the
    glass.
    """

    name = "optv"
    references = (
        "Maas, Gruen and Papantoniou, Exp. Fluids 15 (1993) 133-146",
        "Willneff, ETH Zurich, Dissertation 15276 (2003)",
        "https://pypi.org/project/optv",
    )
    Parameters = OptvParameters

    def skip(self, case: ImageSequence) -> str | None:
        """Skip if OpenPTV is not installed or cannot describe every camera.

        Its correspondences are between four cameras at most.
        """
        if not 2 <= len(case.cameras) <= MOST_CAMERAS:
            return f"it needs two to {MOST_CAMERAS} cameras"
        odd = next((camera.name for camera in case.cameras if not isinstance(camera, Camera)), None)
        if odd:
            return f"{odd} is no pinhole"
        cameras = [camera for camera in case.cameras if isinstance(camera, Camera)]
        unfits = (f"{camera.name}: {reason}" for camera in cameras if (reason := unfit(camera)))
        return missing() or next(unfits, None) or unlike(cameras)

    def solve(self, case: ImageSequence) -> list[FoundParticles]:
        """Write its files, run it, read what it found."""
        chosen = self.parameters
        cameras = tuple(camera for camera in case.cameras if isinstance(camera, Camera))
        measured = measure_frame(case[0])
        settings = derive_settings(
            measured,
            chosen.displacement_px,
            chosen.tolerance_px,
            chosen.discontinuity,
            chosen.change,
            chosen.angle_gon,
        )
        with tempfile.TemporaryDirectory(prefix="optv-") as name:
            folder = Path(name)
            for number, frame in enumerate(progress_bar(case, "images for OpenPTV")):
                write_frame(folder, number, frame.normalised_images())
            write_project(folder, cameras, case.grid, len(case), settings)
            return solve(folder, case.grid, len(case))
