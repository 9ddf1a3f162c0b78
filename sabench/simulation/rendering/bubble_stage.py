"""Stage of a render: everything that light meets, in the frame of the render."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sabench.geometry.occluders import Disc
from sabench.simulation.rendering.lamps import Lamps
from sabench.utils.arrays import F64

if TYPE_CHECKING:
    from sabench.simulation.rendering.particle_integrator import Cloud  # needs the variant


@dataclass(frozen=True)
class Stack:
    """Plane layers between the fluid and the air, in the order light leaves.

    Attributes
    ----------
    faces_mm : (m,) positions of the interfaces along the wall's normal, in the frame of the render.
    indices : (m + 1,) refractive indices, the fluid's first.
    """

    faces_mm: F64
    indices: F64


@dataclass(frozen=True)
class Panel:
    """Diffuser: centre in the frame of the render, half edges (2, 3), radiance."""

    center: F64
    edges: F64
    radiance: float


@dataclass(frozen=True)
class Stage:
    """Everything that light meets, in the frame of the render.

    Attributes
    ----------
    scene : Mitsuba's, with a shape for the bubbles (`bubbles`), one for glowing balls (`balls`) and
        the bodies; any may be missing.
    opaque_scene : Mitsuba's, of the bodies that throw shadows alone; None without lamps.
    centers, to_ball : of the bubbles (n, 3), (n, 3, 3), as in `world.Bubbles`.
    eta : refractive index in the bubbles over the fluid's; fluid : the fluid's over the air's.
    normal : of the walls, from the cameras into the tank; front, rear None: no wall there.
    radius : of a ball around the frame's origin that holds all of it.
    """

    scene: Any
    centers: F64
    to_ball: F64
    eta: float
    fluid: float
    normal: F64
    front: Stack | None
    rear: Stack | None
    panel: Panel | None
    radius: float
    bubbles: Any = None
    balls: Any = None
    cloud: Cloud | None = None
    lamps: Lamps | None = None
    opaque_scene: Any = None
    bodies: bool = False
    occluders: tuple[Disc, ...] = ()
