"""Bubbles below a plunging jet, drawn from the laws of the thesis."""

from functools import cached_property

import numpy as np
from pydantic import Field

from sabench.api import F64, I64, Bool, BubbleGenerator, BubbleParameters, Bubbles, Domain, stream
from sabench.worlds.library.overlaps import overlapping
from sabench.worlds.library.plunging_jet import LN2, JetLaw, rotation_from_y
from sabench.worlds.library.random_packing import place_ellipsoids
from sabench.worlds.library.sizes import Spectrum, spheroids, within

_NODES = 4001  # of the distribution over depth
_CORE = 6.2  # a turbulent jet's speed on its axis: 6.2 diameters over the depth (Rajaratnam 1976)


class PlungingJetParameters(BubbleParameters, Spectrum):
    """Parameters of table 5.2 and equations 5.18 to 5.23.

    Sizes above Y_p are those of the spectrum. Below it, no size exceeds `cutoff_mm`.
    """

    impact_mm: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0),
        description="point at which the jet meets the surface; it points down, along +Y",
    )
    inclination_deg: tuple[float, float] = Field(
        (0.0, 0.0), description="angles of the jet to +Y, towards +X and towards +Z"
    )
    penetration_mm: float = Field(120.0, gt=0.0, description="Y_p, depth that the bubbles reach")
    equivalent_mm: float = Field(48.1, gt=0.0, description="D_eq, diameter of the cloud at Y_p")
    total_percent: float = Field(
        0.34, gt=0.0, le=5.0, description="C_tot, mean void fraction of the cone down to Y_p"
    )
    weight: float = Field(0.903, gt=0.0, lt=1.0, description="weight A of equation 5.18")
    width: float = Field(0.1894, gt=0.0, description="width s of equation 5.18")
    cutoff_mm: float = Field(
        0.525, gt=0.0, description="largest radius below Y_p, half the diameter of figure 5-23"
    )
    speed_mm_s: float = Field(
        3780.0,
        ge=0.0,
        description="V_i, speed of the jet at impact; bubbles sink with the rest of it",
    )
    jet_mm: float = Field(6.01, gt=0.0, description="D_i, the jet's diameter at impact")
    rise_mm_s: float = Field(250.0, ge=0.0, description="terminal velocity of bubbles, upwards")


class PlungingJet(BubbleGenerator):
    """Bubbles below a plunging jet by the thesis's laws.

    Concentration, sizes, depth and angle follow them; bubbles sink on the axis and rise around it.
    """

    name = "plunging_jet"
    references = ("J. Belden, MIT thesis, chapter 5", "Clanet and Lasheras, Phys. Fluids 9 (1997)")
    Parameters = PlungingJetParameters

    @cached_property
    def law(self) -> JetLaw:
        """Law of the drawn bubbles."""
        chosen: PlungingJetParameters = self.parameters
        return JetLaw(
            chosen.penetration_mm,
            chosen.equivalent_mm,
            chosen.total_percent / 100.0,
            chosen.weight,
            chosen.width,
        )

    @cached_property
    def rotation(self) -> F64:
        """Rotation (3, 3) from +Y to the jet's axis."""
        return rotation_from_y(self.parameters.inclination_deg)

    def bubbles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Bubbles:
        """Return the bubbles in the volume at a time.

        They are drawn at the first time and moved until then. Where two bubbles meet, the larger
        one stays.
        """
        chosen: PlungingJetParameters = self.parameters
        rng, impact = stream(seed, "bubbles"), np.asarray(chosen.impact_mm)
        semi_axes, rotation, deep = self._shapes(rng, domain)
        extent = np.linalg.norm(semi_axes[:, None, :] * rotation.transpose(0, 2, 1), axis=2)

        def propose(which: I64, tries: int) -> F64:
            return self._propose(rng, domain, deep[which], extent[which], tries)

        center = (
            propose(np.arange(len(deep)), 1)[:, 0]
            if chosen.overlap
            else place_ellipsoids(semi_axes, rotation, propose, "plunging_jet")
        )
        velocity = self._velocities(center - impact)
        now = center + velocity * time_s
        bubbles = Bubbles(np.arange(len(center)), now, semi_axes, rotation, velocity, chosen.index)
        bubbles = bubbles[within(domain, bubbles)]
        if not chosen.overlap and time_s:
            bubbles = bubbles[np.setdiff1d(np.arange(len(bubbles)), overlapping(bubbles)[:, 1])]
        return bubbles

    def _shapes(self, rng: np.random.Generator, domain: Domain) -> tuple[F64, F64, Bool]:
        """Draw bubbles with volumes that add up to the air above Y_p, and below it."""
        chosen: PlungingJetParameters = self.parameters
        top, bottom = self._depths(domain)
        parts = []
        for low, high, largest in (
            (top, min(bottom, chosen.penetration_mm), np.inf),
            (max(top, chosen.penetration_mm), bottom, chosen.cutoff_mm),
        ):
            y = np.linspace(low, max(low, high), _NODES)
            wanted = float(np.trapezoid(self.law.air_mm2(y), y)) * self._share(domain, y)
            semi_axes, rotation = spheroids(chosen, rng, 0)
            while len(semi_axes) == 0 or 4.0 / 3.0 * np.pi * semi_axes.prod(axis=1).sum() < wanted:
                if wanted <= 0.0:
                    break
                more = spheroids(chosen, rng, 64, largest)
                semi_axes, rotation = (
                    np.concatenate(pair) for pair in zip((semi_axes, rotation), more, strict=True)
                )
            volume = np.cumsum(4.0 / 3.0 * np.pi * semi_axes.prod(axis=1))
            enough = int(np.searchsorted(volume, wanted))
            parts.append((semi_axes[:enough], rotation[:enough]))
        deep = np.repeat([False, True], [len(part[0]) for part in parts])
        return (
            np.concatenate([part[0] for part in parts]),
            np.concatenate([part[1] for part in parts]),
            deep,
        )

    def _depths(self, domain: Domain) -> tuple[float, float]:
        """Compute the depths of the volume's top and bottom below the surface."""
        top = float(domain.low_mm[1]) - self.parameters.impact_mm[1]
        return max(top, 0.0), top + domain.size_mm[1]

    def _share(self, domain: Domain, y: F64) -> float:
        """Compute the part of the air that is within the volume's sides."""
        from scipy.special import erf

        if len(y) < 2 or y[-1] <= y[0]:
            return 0.0
        impact, half = self.parameters.impact_mm, self.law.half_radius_mm(y) / np.sqrt(LN2)
        inside = np.ones(len(y))
        for axis in (0, 2):
            low = domain.low_mm[axis] - impact[axis]
            inside = inside * 0.5 * (erf((low + domain.size_mm[axis]) / half) - erf(low / half))
        air = self.law.air_mm2(y)
        return float(np.trapezoid(air * inside, y) / np.trapezoid(air, y))

    def _propose(
        self, rng: np.random.Generator, domain: Domain, deep: Bool, extent: F64, tries: int
    ) -> F64:
        """Draw candidates (k, m, 3), wholly in the volume.

        Depths follow the law's distribution above or below Y_p, distances equation 5.19.
        """
        chosen: PlungingJetParameters = self.parameters
        top, bottom = self._depths(domain)
        low, high = domain.low_mm, domain.low_mm + np.asarray(domain.size_mm)
        out = np.empty((len(deep), tries, 3))
        for part, (start, end) in (
            (~deep, (top, min(bottom, chosen.penetration_mm))),
            (deep, (max(top, chosen.penetration_mm), bottom)),
        ):
            number = np.flatnonzero(np.repeat(part, tries))
            y = np.linspace(start, end, _NODES)
            air = self.law.air_mm2(y)
            cumulated = np.concatenate([[0.0], np.cumsum(0.5 * (air[1:] + air[:-1]))])
            while len(number):
                depth = np.interp(rng.random(len(number)) * cumulated[-1], cumulated, y)
                spread = self.law.half_radius_mm(depth) / np.sqrt(2.0 * LN2)
                x, z = spread * rng.standard_normal((2, len(number)))
                along_jet = np.column_stack([x, depth, z])
                position_mm = along_jet @ self.rotation.T + np.asarray(chosen.impact_mm)
                reach = extent[number // tries]
                good = ((position_mm - reach >= low) & (position_mm + reach <= high)).all(axis=1)
                out.reshape(-1, 3)[number[good]] = position_mm[good]
                number = number[~good]
        return out

    def _velocities(self, positions: F64) -> F64:
        """Compute velocities down a cone: the jet's remaining speed, less the rise."""
        chosen: PlungingJetParameters = self.parameters
        positions = positions @ self.rotation
        depth = np.maximum(positions[:, 1], 1e-3)
        radius = np.hypot(positions[:, 0], positions[:, 2])
        left = (
            chosen.speed_mm_s
            * np.minimum(1.0, _CORE * chosen.jet_mm / depth)
            * np.maximum(0.0, 1.0 - depth / chosen.penetration_mm)
        )
        down = left * np.exp(-LN2 * radius**2 / self.law.half_radius_mm(depth) ** 2)
        velocity = (down[:, None] * positions / depth[:, None]) @ self.rotation.T
        velocity[:, 1] -= chosen.rise_mm_s
        return np.asarray(velocity)
