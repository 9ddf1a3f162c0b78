"""Column and ligaments of a liquid jet in a cross-flow."""

from collections.abc import Callable

import numpy as np
from pydantic import Field

from sabench.api import F64, Material, Solid, SolidGenerator, SolidParameters, stream
from sabench.worlds.library.implicit_surfaces import capsules, largest_part, surface_of
from sabench.worlds.library.jet_in_crossflow import Crossflow

_BLEND = 0.04  # how round joints are, in nozzle diameters
_ROUGH = 0.03  # amplitude of the surface's ripples, in the same
_RIPPLES = 24  # plane waves that make them


class LiquidColumnParameters(SolidParameters, Crossflow):
    """Parameters of the jet; use equal ones in `jet_in_crossflow` for its drops.

    `nozzle_mm` is the position of the nozzle.
    """

    step_mm: float = Field(
        0.2, gt=0.0, description="spacing of the lattice on which its surface is found"
    )
    material: Material = Field(
        Material(kind="liquid"), description="optical material of its surface"
    )


class LiquidColumn(SolidGenerator):
    """A liquid jet that gas bends.

    Its column along a measured law up to where it breaks, with waves, ripples and ligaments; one
    closed surface.
    """

    name = "liquid_column"
    references = ("Wu, Kirkendall, Fuller and Nejad, J. Propul. Power 13, 64 (1997)",)
    Parameters = LiquidColumnParameters

    def body(self, seed: int) -> Solid:
        """Make the column from the nozzle; `place_mm` is added to `nozzle_mm`."""
        chosen: LiquidColumnParameters = self.parameters
        cones, ripples = chosen.cones(seed), self._ripples(seed)
        blend = _BLEND * chosen.diameter_mm

        def body(points_mm: F64) -> F64:
            return capsules(points_mm, *cones, blend) + ripples(points_mm)

        extent = chosen.diameter_mm
        low, high = (end(np.concatenate(cones[:2]), axis=0) for end in (np.min, np.max))
        mesh = largest_part(surface_of(body, low - extent, high + extent, chosen.step_mm))
        return Solid(mesh.vertices_mm + np.asarray(chosen.nozzle_mm), mesh.faces)

    def _ripples(self, seed: int) -> Callable[[F64], F64]:
        """Sum plane waves of all directions, a third to one nozzle diameter long."""
        rng, diameter = stream(seed, "ripples"), self.parameters.diameter_mm
        wave = rng.normal(size=(_RIPPLES, 3))
        wave *= (
            2.0 * np.pi / rng.uniform(0.33, 1.0, _RIPPLES) / diameter / np.linalg.norm(wave, axis=1)
        )[:, None]
        phase = rng.uniform(0.0, 2.0 * np.pi, _RIPPLES)

        def height(points_mm: F64) -> F64:
            return np.asarray(
                _ROUGH
                * diameter
                * np.sqrt(2.0 / _RIPPLES)
                * np.sin(points_mm @ wave.T + phase).sum(axis=1)
            )

        return height
