"""Bubbles by the outlines that all views vote for, and a fit of their appearance."""

from functools import partial

import numpy as np
from pydantic import Field

from sabench.algorithms.bubbles import (
    Limits,
    Profile,
    find_hypotheses,
    join_hypotheses,
    px_per_mm,
    radii_between,
    search_bubbles,
    transmission,
    turn_camera,
    turn_grid,
    viewing_axes,
    vote,
)
from sabench.api import BubbleSolver, Camera, Detections, Observation, Parameters, progress_bar


class RimFitParameters(Parameters):
    """Range of bubbles to search for, and known properties of the light."""

    radius_mm: tuple[float, float] = Field(
        (0.2, 4.5), description="radii, by volume, that are looked for"
    )
    index: float = Field(1.0, ge=1.0, le=4.0, description="refractive index in the bubbles")
    diffuser_deg: float | None = Field(
        None,
        gt=1.0,
        le=85.0,
        description="half angle of the diffuser as bubbles see it; by default what fits best",
    )
    blur_px: float = Field(0.4, gt=0.1, le=5.0, description="standard deviation of lens and pixel")
    aspects: tuple[float, ...] = Field(
        (1.0, 0.6),
        min_length=1,
        description="short over long axes of the ellipses that are voted for",
    )
    least_vote: float = Field(0.35, gt=0.0, lt=1.0, description="of an outline, mean over views")
    least_gain: float = Field(
        0.4,
        gt=0.0,
        lt=1.0,
        description="part of a bubble's image that must be dark and not explained by others",
    )
    sweeps: int = Field(2, ge=0, le=10, description="times that all bubbles are fitted again")


class RimFit(BubbleSolver):
    """Bubbles from outlines that most views vote for, fitted by an optical profile.

    Outlines vote by the direction of gradients; the strongest votes along a line of sight form a
    hypothesis, which is fitted to all images simultaneously, the largest first. The light that a
    bubble explains is removed for the others. A fit with a radius outside the range is the rest of
    another bubble's shadow. The diffuser's angle is the one that fits the cleanest bubbles best.
    """

    name = "rim_fit"
    references = ("Loy and Zelinsky, IEEE PAMI 25 (2003)",)
    Parameters = RimFitParameters

    def skip(self, case: Observation) -> str | None:
        """Skip cameras that are not pinholes behind a wall."""
        if not all(isinstance(camera, Camera) for camera in case.cameras):
            return "it needs cameras of the refractive pinhole model"
        return None if len(case.cameras) > 1 else "it needs two cameras at least"

    def solve(self, case: Observation) -> Detections:
        """Vote in every view, intersect lines of sight, and fit in the order of votes.

        Depth is along the world's axis that the cameras look along most.
        """
        chosen: RimFitParameters = self.parameters
        pinholes = [camera for camera in case.cameras if isinstance(camera, Camera)]
        axes = viewing_axes(pinholes)
        cameras = [turn_camera(camera, axes) for camera in pinholes]
        grid = turn_grid(case.grid, axes)
        images = transmission(case)
        middle = np.array([(along[0] + along[-1]) / 2.0 for along in grid.axes_mm])
        scale = float(np.median([px_per_mm(camera, middle[None])[0] for camera in cameras]))
        radii = radii_between(max(1.0, chosen.radius_mm[0] * scale), chosen.radius_mm[1] * scale)
        parts = []
        for aspect in chosen.aspects:
            votes = [
                vote(image, radii, aspect)
                for image in progress_bar(images, f"vote for outlines, aspect {aspect:g}")
            ]
            parts.append(
                find_hypotheses(cameras, votes, grid, 0.8 * chosen.least_vote, chosen.least_vote)
            )
        start = join_hypotheses(parts)
        fluid = cameras[0].wall.fluid_index if cameras[0].wall else 1.0
        angle = None if chosen.diffuser_deg is None else float(np.deg2rad(chosen.diffuser_deg))
        profile = partial(Profile.tabulate, chosen.index / fluid, blur_px=chosen.blur_px)
        bubbles = search_bubbles(
            images,
            cameras,
            profile,
            angle,
            start,
            Limits(*chosen.radius_mm, chosen.least_gain),
            chosen.sweeps,
        )
        return Detections(bubbles.center_mm @ axes, bubbles.semi_axes_mm, bubbles.turn @ axes)
