"""Refractive auto-calibration: all cameras and all boards simultaneously."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pydantic import Field

from sabench.algorithms.calibration import (
    CalibrationProblem,
    FreeParameters,
    adjust,
    check_fit,
    make_anchors,
)
from sabench.api import Calibration, CalibrationCase, CalibrationSolver, Parameters


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


class RefractiveAutocal(CalibrationSolver):
    """Joint bundle adjustment of refractive cameras and boards.

    It is robust against outliers. The known points are observations.

    A wall's position is not free: the images only show the positions of the cameras and boards
    relative to it. The known points determine its position in the world.
    """

    name = "refractive_autocal"
    references = (
        "J. Belden, PhD thesis, MIT 2011, chapter 4",
        "B. Triggs et al., Bundle adjustment - a modern synthesis, LNCS 1883, 2000",
    )
    Parameters = RefractiveAutocalParameters

    def solve(self, case: CalibrationCase) -> Calibration:
        """Adjust, then again with anchors.

        The known coordinates are weighed against the measured noise.
        """
        chosen: RefractiveAutocalParameters = self.parameters
        lenses = FreeParameters.from_names(
            {
                *case.unknown,
                *chosen.distortion,
                *["principal_point"] * chosen.principal_point,
                *["tilt"] * chosen.tilt,
            }
        )
        free = replace(lenses, indices=chosen.indices, thicknesses=chosen.thicknesses)
        problem = CalibrationProblem.from_case(case, free)
        found = adjust(problem.start, problem.seen, free)
        anchors = make_anchors(case, problem.frame, found.noise_px)
        if anchors:
            found = adjust(
                problem.align_to_nominal(found.fit.state),
                replace(problem.seen, anchors=anchors),
                free,
            )
        state = problem.align_to_nominal(found.fit.state)
        check_fit(case, state, problem.frame, problem.seen, found.used, found.noise_px)
        return problem.answer(state, found.used)
