"""Refractive auto-calibration: all cameras and all boards simultaneously."""

from dataclasses import replace
from typing import Literal

from pydantic import Field

from sabench.algorithms.calibration import (
    CalibrationProblem,
    FreeParameters,
    check_fit,
    fit_jointly,
)
from sabench.api import Calibration, CalibrationCase, CalibrationSolver, Parameters

REMARKS = {
    "richer model": "With these unknowns, the images would put boards into the wall, so k1, k2, "
    "p1, p2, tilt and bend were fitted, too: take them as unknowns, or measure the distance of one "
    "point of the target from the wall.",
    "initial guess": "The images would put boards into the wall, so their depth was held near the "
    "initial guess: measure the distance of one point of the target from the wall.",
}


class RefractiveAutocalParameters(Parameters):
    """Unknowns besides rotation, centre and focal length of cameras, and the boards.

    Parameters that the case declares unknown are always free.
    """

    principal_point: bool = Field(
        False, description="of every camera, whether the case calls it unknown or not"
    )
    distortion: tuple[Literal["k1", "k2", "p1", "p2", "k3"], ...] = Field(
        (), description="coefficients of every camera, in the same way"
    )
    tilt: bool = Field(False, description="angles between every sensor and its lens, likewise")
    indices: tuple[int, ...] = Field(
        (),
        description="refractive indices of these media, the cameras' side first, starting with 0",
    )
    thicknesses: tuple[int, ...] = Field(
        (), description="thicknesses of these layers of the wall, starting with 0"
    )
    wall: bool = Field(
        False, description="tilt and position of the wall, which known points of every frame show"
    )


class RefractiveAutocal(CalibrationSolver):
    """Joint bundle adjustment of refractive cameras and boards.

    It is robust against outliers. The known points are observations.

    Images only show the positions of the cameras and boards relative to the wall. Known points
    determine its position in the world. Free indices, thicknesses and walls stay near their nominal
    values where the data do not show them. Known cameras stay as they are.
    """

    name = "refractive_autocal"
    references = (
        "J. Belden, PhD thesis, MIT 2011, chapter 4",
        "B. Triggs et al., Bundle adjustment - a modern synthesis, LNCS 1883, 2000",
    )
    Parameters = RefractiveAutocalParameters

    def solve(self, case: CalibrationCase) -> Calibration:
        """Adjust, then again with what is known, weighed against the measured noise."""
        free = self._unknowns(case)
        problem = CalibrationProblem.from_case(case, free)
        robust = fit_jointly(problem, free)
        state = problem.align_to_nominal(robust.fit.state)
        check_fit(case, state, problem.frame, problem.seen, robust.used, robust.noise_px)
        answer = problem.answer(state, robust.used)
        return replace(answer, remarks=(REMARKS[robust.held],)) if robust.held else answer

    def _unknowns(self, case: CalibrationCase) -> FreeParameters:
        """Join the unknowns of the case and of the parameters."""
        chosen: RefractiveAutocalParameters = self.parameters
        flags = {"principal_point": chosen.principal_point, "tilt": chosen.tilt}
        names = {*case.unknown, *chosen.distortion, *(name for name in flags if flags[name])}
        wall = case.cameras[0].wall
        free = FreeParameters.from_names(names, len(wall.layers) if wall else 0)
        return replace(
            free,
            indices=tuple(sorted({*free.indices, *chosen.indices})),
            thicknesses=tuple(sorted({*free.thicknesses, *chosen.thicknesses})),
            wall=free.wall or chosen.wall,
            cameras=not case.known_cameras,
        )
