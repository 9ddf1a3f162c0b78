"""Bubbles and bodies of a scene's frames, checked for impossible ones.

bubbles_and_bodies: Bubbles and bodies of a scene's frames, checked for impossible ones.

Refused are bubbles that a wall cuts, two objects in one place, and bodies that are not closed.

readable_codes: Readable codes on bodies: dark cells and their world positions.
"""

from __future__ import annotations

import numpy as np

from sabench import plugins
from sabench.api import (
    BubbleGenerator,
    Code,
    CodeGenerator,
    Material,
    SolidGenerator,
    SolidParameters,
)
from sabench.api.make import generator_of
from sabench.api.truth import Bubbles, Solid
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import Pose, rotation_matrices
from sabench.scenes import BubbleWorld, Scene
from sabench.scenes.build import domain_of
from sabench.scenes.tank import build_wall, check_one_plane
from sabench.scenes.world import GeneratorTable
from sabench.utils.arrays import I64
from sabench.utils.errors import InputError
from sabench.worlds.library.overlaps import overlapping, touching

_SMALL, _LARGE = (
    0.01,
    20.0,
)  # of the volume's largest edge: a body beyond these is taken to be in another unit
_NAMED = 3  # bubbles that an error names


class Phases:
    """Bubbles and bodies of all frames of a scene and seed."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self.scene, self.seed = scene, seed
        world = scene.world
        given = world.bubbles if isinstance(world, BubbleWorld) else None
        self._bubbles: BubbleGenerator | None = generator_of(given) if given else None
        self._solids: list[SolidGenerator] = [generator_of(one) for one in bodies_of(scene)]
        self._bodies = [
            _check_closed(generator.body(seed), f"{scene.title}: solids.{n}", scene)
            for n, generator in enumerate(self._solids)
        ]

    def bubbles(self, frame: int) -> Bubbles:
        """Make the bubbles of a frame.

        Raises
        ------
        InputError
            One that a wall cuts, that reaches into a body, or into another one although the scene
            does not ask for that.
        """
        if self._bubbles is None:
            return Bubbles(
                np.zeros(0, dtype=np.int64),
                np.zeros((0, 3)),
                np.zeros((0, 3)),
                np.zeros((0, 3, 3)),
                np.zeros((0, 3)),
            )
        made = self._bubbles.bubbles(
            domain_of(self.scene), self.seed, frame, self.scene.time_s(frame)
        )
        where = f"{self.scene.title}: bubbles of frame {frame}"
        _check_walls(made, self.scene, where)
        if not self._bubbles.parameters.overlap:
            _check_apart(made, where)
        for number, (solid, _) in enumerate(self.bodies(frame)):
            _check_beside(made, solid, where, f"solids.{number}")
        return made

    def bodies(self, frame: int) -> list[tuple[Solid, Material]]:
        """Make the bodies of a frame, each at its position.

        Raises
        ------
        InputError
            One that reaches out of the tank.
        """
        out = []
        for number, (generator, body) in enumerate(zip(self._solids, self._bodies, strict=True)):
            pose = pose_of(generator.parameters, self.scene.time_s(frame))
            solid = Solid(pose(body.vertices_mm), body.faces)
            _check_tank(solid, self.scene, f"{self.scene.title}: solids.{number} in frame {frame}")
            out.append((solid, generator.parameters.material))
        return out


def bodies_of(scene: Scene) -> tuple[GeneratorTable, ...]:
    """Give the generators of a scene's bodies; none in a scene of another world."""
    world = scene.world
    return world.solids if isinstance(world, BubbleWorld) else ()


def pose_of(parameters: SolidParameters, time_s: float) -> Pose:
    """Compute position and rotation of a body at a time."""
    rotation = rotation_matrices(np.deg2rad(parameters.turn_deg)) @ rotation_matrices(
        np.deg2rad(parameters.spin_deg_s) * time_s
    )
    return Pose(
        rotation, np.asarray(parameters.place_mm) + np.asarray(parameters.velocity_mm_s) * time_s
    )


def _check_closed(body: Solid, where: str, scene: Scene) -> Solid:
    """Check that a body is closed and of plausible size; turn its faces outwards."""
    import trimesh

    mesh = trimesh.Trimesh(body.vertices_mm, body.faces, process=False)
    merged = trimesh.Trimesh(
        body.vertices_mm, body.faces, process=True
    )  # joins vertices that files list once for every face
    if not merged.is_watertight or not merged.is_winding_consistent:
        open_edges = int((np.bincount(merged.edges_unique_inverse) != 2).sum())
        raise InputError(
            f"{where}: expected a closed surface, but {open_edges} of its edges do not have two "
            "faces"
        )
    largest, volume = float(np.ptp(body.vertices_mm, axis=0).max()), max(scene.volume.size_mm)
    if not _SMALL * volume <= largest <= _LARGE * volume:
        raise InputError(
            f"{where}: expected a body of a size like the volume's ({volume:g} mm), got "
            f"{largest:.3g} mm: is its unit right?"
        )
    faces = mesh.faces if merged.volume > 0.0 else mesh.faces[:, ::-1]
    return Solid(np.asarray(body.vertices_mm, dtype=np.float64), np.asarray(faces, dtype=np.int64))


def _wall_of(scene: Scene) -> Wall | None:
    check_one_plane(scene)
    return build_wall(scene.plane) if scene.plane else None


def _depths(wall: Wall) -> tuple[float, float]:
    inner = wall.thickness_mm
    return inner, inner + wall.depth_mm if wall.depth_mm is not None else np.inf


def _check_walls(bubbles: Bubbles, scene: Scene, where: str) -> None:
    wall = _wall_of(scene)
    if wall is None or not len(bubbles):
        return
    depth, extent, (near, far) = (
        wall.depth_of(bubbles.center_mm),
        bubbles.reach_mm(wall.normal),
        _depths(wall),
    )
    cut = np.flatnonzero((depth - extent < near) | (depth + extent > far))
    if len(cut):
        raise InputError(
            f"{where}: expected all of them in the fluid, but a wall cuts {len(cut)}: "
            f"{_describe(bubbles, cut)}"
        )


def _check_apart(bubbles: Bubbles, where: str) -> None:
    pairs = overlapping(bubbles)
    if len(pairs):
        first, second = (_describe(bubbles, pairs[:1, side]) for side in (0, 1))
        raise InputError(
            f"{where}: expected none to reach into another (overlap = true allows it), but "
            f"{len(pairs)} pairs do: {first} and {second}"
        )


def _check_beside(bubbles: Bubbles, solid: Solid, where: str, name: str) -> None:
    if not len(bubbles):
        return
    bad = np.flatnonzero(touching(bubbles, solid))
    if len(bad):
        raise InputError(
            f"{where}: expected none to reach into a body, but {len(bad)} reach into {name}: "
            f"{_describe(bubbles, bad)}"
        )


def _check_tank(solid: Solid, scene: Scene, where: str) -> None:
    wall = _wall_of(scene)
    if wall is None:
        return
    depth, (near, far) = wall.depth_of(solid.vertices_mm), _depths(wall)
    if depth.min() < near or depth.max() > far:
        got = f"{depth.min():.4g} to {depth.max():.4g}"
        raise InputError(
            f"{where}: expected it in the tank, {near:g} to {far:g} mm behind the wall's outer "
            f"face, but it reaches from {got} mm"
        )


def _describe(bubbles: Bubbles, which: I64) -> str:
    shown = [
        f"{bubbles.id[n]} at {np.round(bubbles.center_mm[n], 3).tolist()} mm with semi-axes "
        f"{np.round(bubbles.semi_axes_mm[n], 3).tolist()} mm"
        for n in which[:_NAMED]
    ]
    return "; ".join(shown) + (" ..." if len(which) > _NAMED else "")


def has_code(scene: Scene) -> bool:
    """Return whether one of a scene's bodies has a code."""
    return any(
        issubclass(plugins.load("generators", given["generator"]), CodeGenerator)
        for given in bodies_of(scene)
    )


def code_of(scene: Scene, seed: int, frame: int) -> Code:
    """Make all cells of a frame's codes, world frame: truth, not for solvers."""
    parts = []
    for generator in (generator_of(given) for given in bodies_of(scene)):
        if isinstance(generator, CodeGenerator):
            own, pose = generator.code(seed), pose_of(generator.parameters, scene.time_s(frame))
            parts.append(
                Code(pose(own.points_mm.reshape(-1, 3)).reshape(own.points_mm.shape), own.dark)
            )
    if not parts:
        raise InputError(f"{scene.title}: expected a body with a code, got none")
    return Code(
        np.concatenate([part.points_mm for part in parts]),
        np.concatenate([part.dark for part in parts]),
    )
