"""Drops of a liquid jet in a cross-flow."""

import numpy as np
from pydantic import Field

from sabench.api import F64, I64, Bool, BubbleGenerator, BubbleParameters, Bubbles, Domain, stream
from sabench.worlds.library.implicit_surfaces import capsules
from sabench.worlds.library.jet_in_crossflow import Cones, Crossflow, Spray
from sabench.worlds.library.overlaps import overlapping
from sabench.worlds.library.random_packing import place_ellipsoids
from sabench.worlds.library.sizes import Spectrum, spheroids, within

_GAP = 0.1  # between drops and the column, in nozzle diameters: its surface is rippled


class JetInCrossflowParameters(BubbleParameters, Spectrum, Crossflow):
    """Parameters of the jet, as in `liquid_column`, and of its drops.

    Drops are distributed uniformly over the time that they have been in the gas.
    """

    index: float = Field(1.333, ge=1.0, le=4.0, description="refractive index of the liquid")
    radius_mm: float = Field(0.35, gt=0.0, description="median radius of a ball of the same volume")
    radius_range_mm: tuple[float, float] = Field(
        (0.1, 1.2), description="range of radii; those beyond it are drawn again"
    )
    count: int = Field(
        400,
        ge=0,
        le=100_000,
        description="number of drops between where the column breaks and the volume's end",
    )
    lower_part: float = Field(
        0.4, ge=0.0, lt=1.0, description="the spray's lower edge over its upper one"
    )
    gas_mm_s: float = Field(40_000.0, gt=0.0, description="speed of the gas")
    response_s: float = Field(
        5e-3, gt=0.0, description="time in which a drop takes on the gas's speed"
    )


class JetInCrossflow(BubbleGenerator):
    """Drops of a broken liquid jet that a gas accelerates.

    They fly between the measured edges of such sprays.
    """

    name = "jet_in_crossflow"
    references = (
        "Wu, Kirkendall, Fuller and Nejad, J. Propul. Power 14, 173 (1998)",
        "J. Belden, MIT thesis, chapter 6",
    )
    Parameters = JetInCrossflowParameters

    def bubbles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Bubbles:
        """Return the bubbles wholly in the volume and off the column.

        A drop that reaches the end of the volume starts again with another number.
        """
        chosen: JetInCrossflowParameters = self.parameters
        rng, cones, spray = stream(seed, "bubbles"), chosen.cones(seed), self._spray(domain)
        semi_axes, rotation = spheroids(chosen, rng, chosen.count)
        extent = semi_axes.max(axis=1)

        def propose(which: I64, tries: int) -> F64:
            return self._propose(rng, spray, extent[which], tries, cones)

        first = (
            propose(np.arange(chosen.count), 1)[:, 0]
            if chosen.overlap
            else place_ellipsoids(semi_axes, rotation, propose, "jet_in_crossflow")
        )
        age, line = spray.ages_and_lines(first)
        rounds, age = np.divmod(age + time_s, spray.ages[0][-1])
        position = spray.positions(age, line)
        identity = np.arange(chosen.count) + chosen.count * rounds.astype(np.int64)
        center, velocity = position + np.asarray(chosen.nozzle_mm), spray.velocities(age, position)
        bubbles = Bubbles(identity, center, semi_axes, rotation, velocity, chosen.index)
        bubbles = bubbles[within(domain, bubbles) & self._off(position, extent, cones)]
        if not chosen.overlap and time_s:
            bubbles = bubbles[np.setdiff1d(np.arange(len(bubbles)), overlapping(bubbles)[:, 1])]
        return bubbles

    def _spray(self, domain: Domain) -> Spray:
        chosen: JetInCrossflowParameters = self.parameters
        end = float(domain.low_mm[0] + domain.size_mm[0]) - chosen.nozzle_mm[0]
        return Spray(
            chosen,
            chosen.lower_part,
            chosen.gas_mm_s,
            chosen.response_s,
            max(end, chosen.break_mm[0] + chosen.diameter_mm),
        )

    def _propose(
        self, rng: np.random.Generator, spray: Spray, extent: F64, tries: int, cones: Cones
    ) -> F64:
        """Draw candidates (k, m, 3) from the nozzle, off the column.

        They are uniform over age and between the spray's edges.
        """
        out = np.empty((len(extent) * tries, 3))
        number = np.arange(len(out))
        while len(number):
            positions = spray.positions(
                rng.random(len(number)) * spray.ages[0][-1], rng.random((len(number), 2))
            )
            good = self._off(positions, extent[number // tries], cones)
            out[number[good]] = positions[good]
            number = number[~good]
        return out.reshape(len(extent), tries, 3)

    def _off(self, positions: F64, extent: F64, cones: Cones) -> Bool:
        """Mark drops that are clear of the column and its ligaments."""
        return np.asarray(capsules(positions, *cones) > extent + _GAP * self.parameters.diameter_mm)
