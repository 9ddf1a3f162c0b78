"""Slow flow around the bodies of a scene."""

from collections.abc import Sequence

import numpy as np
from pydantic import Field, field_validator

from sabench.api import F64, BodyFlow, Domain, InputError, Parameters, Solid, Vector
from sabench.worlds.library.slow_flow import PeriodicBox, SlowFlow, solve_oseen

_MOST = 4_000_000  # nodes: a gigabyte while the flow is solved


class FlowAroundParameters(Parameters):
    """Mean flow, fluid and lattice."""

    velocity_mm_s: Vector = Field(
        (10.0, 0.0, 0.0), description="mean velocity over the box, bodies included"
    )
    viscosity_mm2_s: float = Field(
        10.0, gt=0.0, description="kinematic viscosity of the fluid: 1 for water"
    )
    box_mm: Vector = Field(
        (36.0, 24.0, 24.0),
        description="periodic box around the volume's centre; the bodies' images in it stand this "
        "far apart",
    )
    step_mm: float = Field(
        0.4, gt=0.0, description="spacing of the lattice; edges of the box are rounded to it"
    )

    @field_validator("box_mm")
    @classmethod
    def _is_a_box(cls, size: Vector) -> Vector:
        if min(size) <= 0.0:
            raise ValueError(f"expected positive lengths, got {min(size):g}")
        return size


class FlowAround(BodyFlow):
    """Steady viscous flow around bodies at rest, free of divergence.

    It solves Oseen's equations; the fluid rests at the bodies.
    """

    name = "flow_around"
    references = (
        "C. W. Oseen, Ark. Mat. Astron. Fys. 6 (1910), no. 29",
        "H. Hasimoto, J. Fluid Mech. 5, 317-328, 1959",
    )
    Parameters = FlowAroundParameters

    def surround(self, bodies: Sequence[Solid], domain: Domain) -> None:
        """Solve the flow on the lattice."""
        chosen: FlowAroundParameters = self.parameters
        shape = [max(4, round(edge / chosen.step_mm)) for edge in chosen.box_mm]
        if np.prod(shape, dtype=np.float64) > _MOST:
            raise InputError(
                f"flow.step_mm: expected a lattice of at most {_MOST} nodes, got "
                f"{' x '.join(map(str, shape))}"
            )
        size = chosen.step_mm * np.array(shape)
        centre = np.asarray(domain.low_mm) + np.asarray(domain.size_mm) / 2.0
        low = centre - size / 2.0
        for body in bodies:
            if (body.vertices_mm < low).any() or (body.vertices_mm > low + size).any():
                raise InputError(
                    "flow.box_mm: expected a box that holds the bodies, got one from "
                    f"{np.round(low, 2).tolist()} to {np.round(low + size, 2).tolist()} mm around "
                    f"a body from {np.round(body.vertices_mm.min(axis=0), 2).tolist()} to "
                    f"{np.round(body.vertices_mm.max(axis=0), 2).tolist()} mm"
                )
        box = PeriodicBox(low, chosen.step_mm, (shape[0], shape[1], shape[2]))
        mean = np.asarray(chosen.velocity_mm_s)
        self._flow: SlowFlow = solve_oseen(bodies, box, mean, chosen.viscosity_mm2_s)

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute the mean flow and the curl of the vector potential."""
        return self._flow.velocity(points_mm)

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute the derivatives of the velocity."""
        return self._flow.gradient(points_mm)
