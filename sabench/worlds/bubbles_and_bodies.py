"""Bubbles and bodies of a scene's frames, and readable codes on bodies.

Refused are bubbles that a wall cuts, two objects in one place, and bodies that are not closed.
"""

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
from sabench.scenes import Scene
from sabench.scenes.build import build_wall, check_one_plane, domain_of
from sabench.utils.arrays import I64
from sabench.utils.errors import InputError
from sabench.worlds.library.overlaps import overlapping, touching

# of the volume's largest edge: a body beyond these is taken to be in another unit
_SMALL, _LARGE = 0.01, 20.0
_NAMED = 3  # bubbles that an error names


class Phases:
    """Bubbles and bodies of all frames of a scene and seed."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self.scene, self.seed = scene, seed
        world = scene.world
        given = world.bubbles
        self._bubbles: BubbleGenerator | None = generator_of(given) if given else None
        self._solids: list[SolidGenerator] = [generator_of(given) for given in world.solids]
        self._bodies = [
            _check_closed(generator.body(seed), f"{scene.title}: solids.{n}", scene)
            for n, generator in enumerate(self._solids)
        ]

    def bubbles(self, frame: int) -> Bubbles:
        """Make the bubbles of a frame.

        Raises InputError: one that a wall cuts, that reaches into a body, or into another one
        although the scene does not allow that.
        """
        if self._bubbles is None:
            none = np.zeros((0, 3))
            return Bubbles(np.zeros(0, dtype=np.int64), none, none, np.zeros((0, 3, 3)), none)
        bubbles = self._bubbles.bubbles(
            domain_of(self.scene), self.seed, frame, self.scene.time_s(frame)
        )
        where = f"{self.scene.title}: bubbles of frame {frame}: expected"
        if (wall := _wall_of(self.scene)) is not None:
            depth, extent = wall.depth_of(bubbles.center_mm), bubbles.reach_mm(wall.normal)
            near, far = _depths(wall)
            cut = np.flatnonzero((depth - extent < near) | (depth + extent > far))
            if len(cut):
                raise InputError(
                    f"{where} all of them in the fluid, but a wall cuts {len(cut)}: "
                    f"{_describe(bubbles, cut)}"
                )
        if not self._bubbles.parameters.overlap and len(pairs := overlapping(bubbles)):
            first, second = (_describe(bubbles, pairs[:1, side]) for side in (0, 1))
            raise InputError(
                f"{where} none to reach into another (overlap = true allows it), but "
                f"{len(pairs)} pairs do: {first} and {second}"
            )
        for number, (solid, _) in enumerate(self.bodies(frame)):
            if len(bad := np.flatnonzero(touching(bubbles, solid))):
                raise InputError(
                    f"{where} none to reach into a body, but {len(bad)} reach into "
                    f"solids.{number}: {_describe(bubbles, bad)}"
                )
        return bubbles

    def bodies(self, frame: int) -> list[tuple[Solid, Material]]:
        """Make a frame's bodies in place; raises InputError for one outside the tank."""
        out = []
        for number, (generator, body) in enumerate(zip(self._solids, self._bodies, strict=True)):
            pose = pose_of(generator.parameters, self.scene.time_s(frame))
            solid = Solid(pose(body.vertices_mm), body.faces)
            out.append((solid, generator.parameters.material))
            if (wall := _wall_of(self.scene)) is None:
                continue
            depth, (near, far) = wall.depth_of(solid.vertices_mm), _depths(wall)
            if depth.min() < near or depth.max() > far:
                raise InputError(
                    f"{self.scene.title}: solids.{number} in frame {frame}: expected it in the "
                    f"tank, {near:g} to {far:g} mm behind the wall's outer face, but it reaches "
                    f"from {depth.min():.4g} to {depth.max():.4g} mm"
                )
        return out


def pose_of(parameters: SolidParameters, time_s: float) -> Pose:
    """Compute position and rotation of a body at a time."""
    first = rotation_matrices(np.deg2rad(parameters.turn_deg))
    spin = rotation_matrices(np.deg2rad(parameters.spin_deg_s) * time_s)
    shift = np.asarray(parameters.velocity_mm_s) * time_s
    return Pose(first @ spin, np.asarray(parameters.place_mm) + shift)


def _check_closed(body: Solid, where: str, scene: Scene) -> Solid:
    """Check that a body is closed and of plausible size; turn its faces outwards."""
    import trimesh

    mesh = trimesh.Trimesh(body.vertices_mm, body.faces, process=False)
    # join vertices that files list once for every face
    merged = trimesh.Trimesh(body.vertices_mm, body.faces, process=True)
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
        for given in scene.world.solids
    )


def code_of(scene: Scene, seed: int, frame: int) -> Code:
    """Make all cells of a frame's codes, world frame: truth, not for solvers."""
    parts = []
    for generator in (generator_of(given) for given in scene.world.solids):
        if isinstance(generator, CodeGenerator):
            code, pose = generator.code(seed), pose_of(generator.parameters, scene.time_s(frame))
            points = pose(code.points_mm.reshape(-1, 3)).reshape(code.points_mm.shape)
            parts.append(Code(points, code.dark))
    if not parts:
        raise InputError(f"{scene.title}: expected a body with a code, got none")
    points_mm = np.concatenate([part.points_mm for part in parts])
    return Code(points_mm, np.concatenate([part.dark for part in parts]))
