"""Worlds of a scene: particles, bubbles and bodies, or a calibration target.

Each answers `tracers`, `bubbles` and `solids`, which are None or empty where it has none.
"""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass
from typing import Any, ClassVar

from sabench.scenes.calibration import Detection
from sabench.scenes.illumination import Backlight, Illumination, Lighting, Tracer

GeneratorTable = dict[str, Any]  # `generator` names the plug-in, the other keys its parameters


@dataclass(frozen=True)
class ParticleWorld:
    """Tracer particles in a laser sheet.

    Attributes
    ----------
    particles : the generator of positions and diameters.
    illumination : the laser that lights them.
    tracer : their refractive index.
    flow : the generator of the flow that carries them; None: they move by themselves.
    """

    particles: GeneratorTable
    illumination: Illumination
    tracer: Tracer
    flow: GeneratorTable | None = None
    bubbles: ClassVar[None] = None
    solids: ClassVar[tuple[GeneratorTable, ...]] = ()

    @property
    def tracers(self) -> ParticleWorld:
        """The particles: this world has nothing else."""
        return self


@dataclass(frozen=True)
class BubbleWorld:
    """Bubbles, drops and bodies in the fluid.

    Attributes
    ----------
    bubbles : their generator; None: there are bodies only.
    solids : one generator for each body.
    backlight, lighting : at least one of them lights the scene.
    tracers : tracer particles between the bubbles; None without any.
    """

    bubbles: GeneratorTable | None
    solids: tuple[GeneratorTable, ...]
    backlight: Backlight | None
    lighting: Lighting | None
    tracers: ParticleWorld | None = None


@dataclass(frozen=True)
class TargetWorld:
    """A calibration target at another position in every frame.

    Attributes
    ----------
    target : its generator.
    lighting : lamps for the rendered images; None: the cameras give pixels of points, no images.
    detection : errors of those pixels; None: every point is detected exactly.
    """

    target: GeneratorTable
    lighting: Lighting | None = None
    detection: Detection | None = None
    tracers: ClassVar[None] = None
    bubbles: ClassVar[None] = None
    solids: ClassVar[tuple[GeneratorTable, ...]] = ()


World = ParticleWorld | BubbleWorld | TargetWorld


def world_faults(given: Set[str]) -> Iterator[tuple[str, str]]:
    """Find tables that are missing or that exclude one another.

    Missing tables are those that a given table requires. Yields pairs of a key and a sentence.
    """
    bodies = bool({"bubbles", "solids"} & given)
    if (bodies or "particles" in given) == ("targets" in given):
        got = "both" if bodies or "particles" in given else "none of these tables"
        yield "", f"expected either particles, bubbles or solids, or targets, got {got}"
    if bodies and not {"backlight", "lighting"} & given:
        yield "", "expected a backlight or a lighting for bubbles and solids, got neither"
    if "backlight" in given and not bodies:
        yield "backlight", "expected bubbles or solids in front of it, got neither"
    if "flow" in given and "particles" not in given:
        yield "flow", "expected particles that it carries, got none"
    if "inertia" in given and "flow" not in given:
        yield "inertia", "expected a flow, got none; a linear_flow without keys is fluid at rest"
    if "flow_grid_mm" in given and "flow" not in given:
        yield "flow_grid_mm", "expected a flow, got none"
    if "particles" in given and "illumination" not in given:
        yield "illumination", "this key is missing; particles need a laser"
