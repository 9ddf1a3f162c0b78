"""Unknowns of a calibration as arrays, and cameras and points of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sabench.algorithms.calibration.kernels import BEND, CAMERA
from sabench.api import CalibrationCase
from sabench.geometry.camera import Camera
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.rigid_motion import (
    RigidMotion,
    fit_rigid_motion,
    frame_of_normal,
    rotation_matrices,
)
from sabench.utils.arrays import F64, I64, triple
from sabench.utils.errors import DeclinedError


def check_plane_wall(cameras: Sequence[Camera]) -> None:
    """Refuse cameras that are not behind one plane wall, or in plain air.

    Raises
    ------
    DeclinedError
        A cylinder, or cameras that look through different walls.
    """
    if not has_plane_wall(cameras):
        alike = len({camera.wall for camera in cameras}) == 1
        got = "a cylinder" if alike else "cameras behind different walls"
        raise DeclinedError(f"it needs one plane wall in front of all cameras, got {got}")


def has_plane_wall(cameras: Sequence[Camera]) -> bool:
    """Return whether all cameras are behind one plane wall, or all in plain air."""
    return common_plane(cameras) is not None or not any(camera.wall for camera in cameras)


def common_plane(cameras: Sequence[Camera]) -> Wall | None:
    """Return the plane wall of all cameras; None where there is no such wall."""
    wall = cameras[0].wall
    same = all(camera.wall == wall for camera in cameras)
    return wall if same and isinstance(wall, Wall) else None


def fit_similarity(points: F64, targets: F64) -> F64:
    """Fit the similarity (4, 4) of points (n, 3) to targets by least squares."""
    motion = fit_rigid_motion(points, targets)
    rotated = (points - points.mean(axis=0)) @ motion.rotation.T
    scale = float(np.sum(rotated * (targets - targets.mean(axis=0))) / np.sum(rotated**2))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * motion.rotation
    matrix[:3, 3] = targets.mean(axis=0) - scale * motion.rotation @ points.mean(axis=0)
    return matrix


_DISTORTION = ("k1", "k2", "p1", "p2", "k3")
WALL = 3  # rotations about X and Y, shift along Z


@dataclass(frozen=True)
class FreeParameters:
    """Unknowns of the optics besides each camera's rotation, centre and focal length.

    Attributes
    ----------
    principal_point : of every camera.
    distortion : names of coefficients.
    tilt : of every sensor.
    indices : numbers of media along the way of light from a camera, 0 for the cameras' own.
    thicknesses : numbers of layers.
    wall : tilt and position of the wall, which only known places in the world show.
    bend : of the board, the same in all frames: a quadratic of three terms.
    cameras : rotation, centre and focal length of every camera; otherwise all cameras are known, in
        the world's frame, and have no unknowns.
    """

    principal_point: bool = False
    distortion: tuple[str, ...] = ()
    indices: tuple[int, ...] = ()
    thicknesses: tuple[int, ...] = ()
    tilt: bool = False
    wall: bool = False
    bend: bool = False
    cameras: bool = True

    @classmethod
    def from_case(cls, case: CalibrationCase) -> FreeParameters:
        """Make from a case's unknowns, its wall and whether its cameras are known."""
        wall = case.cameras[0].wall
        free = cls.from_names(case.unknown, len(wall.layers) if wall else 0)
        return replace(free, cameras=not case.known_cameras)

    @classmethod
    def from_names(cls, unknown: Iterable[str], layers: int = 0) -> FreeParameters:
        """Make from the names of a case's unknowns, with a wall of some layers."""
        names = set(unknown)
        solids = tuple(range(1, layers + 1)) if "layer_index" in names else ()
        return cls(
            "principal_point" in names,
            tuple(name for name in _DISTORTION if name in names),
            solids + ((layers + 1,) if "fluid_index" in names else ()),
            tuple(range(layers)) if "thickness" in names else (),
            "tilt" in names,
            "wall" in names,
            "bend" in names,
        )

    @property
    def of_lenses(self) -> FreeParameters:
        """The unknowns of the lenses alone."""
        return replace(self, indices=(), thicknesses=(), wall=False, bend=False)

    @property
    def per_camera(self) -> int:
        """Unknowns of one camera."""
        return 7 + 2 * self.principal_point + len(self.distortion) + 2 * self.tilt

    def columns(self, media: int) -> tuple[I64, I64]:
        """Index a camera's unknowns and the shared ones, as `equations` takes them."""
        camera = [*range(7), *[7, 8] * self.principal_point]
        camera += [9 + _DISTORTION.index(name) for name in self.distortion] + [14, 15] * self.tilt
        shared = [*self.indices, *(media + layer for layer in self.thicknesses)]
        shared += [2 * media - 2 + number for number in range(WALL)] * self.wall
        shared += [2 * media + 1 + number for number in range(BEND)] * self.bend
        return np.array(camera, dtype=np.int64), np.array(shared, dtype=np.int64)


@dataclass(frozen=True)
class State:
    """Cameras and boards in the wall's frame.

    Attributes
    ----------
    rotations, centers, lenses : (M, 3, 3), (M, 3), (M, 10) as in `kernels.observe`.
    indices, thicknesses : of the media (m,) and layers (m - 2,).
    board_rotations, board_positions : (K, 3, 3), (K, 3).
    wall : from the frame of the wall as it is to that of the nominal wall.
    bend : (BEND,) lifts of the board's edges along its normal, mm: see `bend_lifts`.
    """

    rotations: F64
    centers: F64
    lenses: F64
    indices: F64
    thicknesses: F64
    board_rotations: F64
    board_positions: F64
    wall: RigidMotion = field(default_factory=RigidMotion.none)
    bend: F64 = field(default_factory=lambda: np.zeros(BEND))

    @property
    def shared(self) -> F64:
        """Indices, thicknesses, tilt (rad) and shift of the wall, and the board's bend."""
        turn = self.wall.rotation
        tilt = [turn[2, 1], -turn[2, 0], self.wall.shift[2]]
        return np.concatenate([self.indices, self.thicknesses, tilt, self.bend])

    def array(self) -> tuple[F64, F64, F64, tuple[F64, F64]]:
        """Return the cameras as arrays for the kernels."""
        return self.rotations, self.centers, self.lenses, (self.indices, self.thicknesses)

    def points(self, board: F64) -> F64:
        """Return a board's points (m, 3) as world points (K, m, 3), in the wall's frame."""
        bent = self.bend_board(board)
        return np.asarray(
            np.einsum("kij,mj->kmi", self.board_rotations, bent) + self.board_positions[:, None]
        )

    def bend_board(self, board: F64) -> F64:
        """Bend a board's points (m, 3) in its own frame."""
        if not self.bend.any():
            return board
        return np.asarray(board + np.outer(bend_lifts(board) @ self.bend, [0.0, 0.0, 1.0]))

    def boards(self, board: F64) -> tuple[F64, F64, F64, F64]:
        """Return the boards as arrays for the kernels."""
        lifts = bend_lifts(board)
        return self.board_rotations, self.board_positions, self.bend_board(board), lifts

    def apply_steps(self, cameras: F64, shared: F64, boards: F64, free: FreeParameters) -> State:
        """Apply steps of the cameras' unknowns (M, f), the shared (s,) and the boards'.

        The boards' steps are (K, 6). Known cameras stay in the world when the wall moves, boards
        move with it.
        """
        columns, common = free.columns(len(self.indices))
        full = np.zeros((len(self.rotations), CAMERA))
        full[:, columns] = cameras
        media = np.concatenate([self.indices, self.thicknesses, np.zeros(WALL), self.bend])
        media[common] += shared
        count = len(self.indices)
        media, (right, down, along), bend = np.split(media, [2 * count - 2, 2 * count + 1])
        turn = rotation_matrices(np.array([right, down, 0.0]))
        shift = self.wall.shift + np.array([0.0, 0.0, along])
        wall = RigidMotion(turn @ self.wall.rotation, shift)
        motion = RigidMotion.none() if free.cameras else wall.inverse().after(self.wall)
        turned = rotation_matrices(full[:, :3]) @ self.rotations @ motion.rotation.T
        return State(
            np.ascontiguousarray(turned),
            motion(self.centers + full[:, 3:6]),
            self.lenses + full[:, 6:],
            media[:count].copy(),
            media[count:].copy(),
            np.ascontiguousarray(rotation_matrices(boards[:, :3]) @ self.board_rotations),
            self.board_positions + boards[:, 3:],
            wall,
            bend,
        )

    def move(self, motion: RigidMotion) -> State:
        """Move the state by a motion that leaves the wall unchanged."""
        return replace(
            self,
            rotations=np.ascontiguousarray(self.rotations @ motion.rotation.T),
            centers=motion(self.centers),
            board_rotations=np.ascontiguousarray(motion.rotation @ self.board_rotations),
            board_positions=motion(self.board_positions),
        )


@dataclass(frozen=True)
class WallFrame:
    """World's position in the wall's frame, and the constants that a state lacks.

    `wall` is the plane wall of all cameras; None in plain air, or without a common wall.
    """

    motion: RigidMotion
    cameras: tuple[Camera, ...]
    wall: Wall | None

    @property
    def beyond_kernels(self) -> WallFrame | None:
        """The frame itself where the kernels of one plane wall do not hold, else None."""
        return None if has_plane_wall(self.cameras) else self

    @classmethod
    def from_cameras(cls, cameras: tuple[Camera, ...], points_mm: F64) -> WallFrame:
        """Make the frame with the outer face of the cameras' wall at Z = 0.

        The normal is +Z. Without a common plane wall a plane without meaning, between the cameras
        and the points, replaces the face.
        """
        if wall := common_plane(cameras):
            rotation = frame_of_normal(np.asarray(wall.normal, dtype=np.float64))
            shift = -rotation @ np.asarray(wall.point_mm) * np.array([0.0, 0.0, 1.0])
            return cls(RigidMotion(rotation, shift), cameras, wall)
        centers = np.array([camera.center_mm for camera in cameras])
        normal = np.mean([camera.rotation[2] for camera in cameras], axis=0)
        length = np.linalg.norm(normal)  # 0 for cameras that face each other
        normal = normal / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
        middle = ((centers @ normal).max() + np.nanmin(points_mm.reshape(-1, 3) @ normal)) / 2.0
        return cls(
            RigidMotion(frame_of_normal(normal), np.array([0.0, 0.0, -middle])), cameras, None
        )

    def select(self, cameras: I64) -> WallFrame:
        """Select some of the cameras."""
        return replace(self, cameras=tuple(self.cameras[number] for number in cameras.tolist()))

    def state(self, board: F64, points_mm: F64) -> State:
        """Make the cameras' state, with boards (m, 3) fitted to points (K, m, 3)."""
        rotations = np.stack(
            [np.asarray(camera.rotation) @ self.motion.rotation.T for camera in self.cameras]
        )
        centers = self.motion(np.array([camera.center_mm for camera in self.cameras]))
        lenses = []
        for camera in self.cameras:
            distortion = (getattr(camera.distortion, name) for name in _DISTORTION)
            tilt = np.deg2rad(camera.tilt_deg)
            lenses.append([camera.focal_px, *camera.principal_point_px, *distortion, *tilt])
        layers = self.wall.layers if self.wall else ()
        finite = np.asarray(np.isfinite(points_mm).all(axis=2))
        poses = [
            fit_rigid_motion(board[rows], self.motion(points)[rows])
            for points, rows in zip(points_mm, finite, strict=True)
        ]
        return State(
            rotations,
            centers,
            np.array(lenses),
            self.wall.indices if self.wall else np.ones(2),
            np.array([layer.thickness_mm for layer in layers], dtype=np.float64),
            np.stack([pose.rotation for pose in poses]),
            np.stack([pose.shift for pose in poses]),
        )

    def to_wall(self, state: State) -> RigidMotion:
        """Return the motion from the world to the frame of the wall of a state."""
        return state.wall.inverse().after(self.motion)

    def build_cameras(self, state: State) -> tuple[Camera, ...]:
        """Make the cameras of a state, in the world's frame."""
        wall, motion, cameras = self._wall(state), self.to_wall(state), []
        for camera, rotation, center, lens in zip(
            self.cameras, state.rotations, state.centers, state.lenses.tolist(), strict=True
        ):
            turn = rotation @ motion.rotation
            cameras.append(
                replace(
                    camera,
                    center_mm=triple(motion.inverse()(center)),
                    rotation=(triple(turn[0]), triple(turn[1]), triple(turn[2])),
                    wall=wall or camera.wall,
                    principal_distance_mm=lens[0] * camera.pixel_mm,
                    principal_point_px=(lens[1], lens[2]),
                    distortion=Distortion(**dict(zip(_DISTORTION, lens[3:8], strict=True))),
                    tilt_deg=(math.degrees(lens[8]), math.degrees(lens[9])),
                )
            )
        return tuple(cameras)

    def points(self, state: State, board: F64) -> F64:
        """Return world points (K, m, 3) of a state's boards."""
        return self.to_wall(state).inverse()(state.points(board))

    def _wall(self, state: State) -> Wall | None:
        if self.wall is None:
            return None
        first, *inner, last = state.indices.tolist()
        layers = tuple(
            Layer(layer.name, n, d)
            for layer, n, d in zip(self.wall.layers, inner, state.thicknesses.tolist(), strict=True)
        )
        wall = replace(self.wall, air_index=first, layers=layers, fluid_index=last)
        if state.wall.is_none:
            return wall
        pose = self.to_wall(state)
        face = self.motion(np.asarray(wall.point_mm)) * np.array([1.0, 1.0, 0.0])
        return replace(wall, point_mm=triple(pose.inverse()(face)), normal=triple(pose.rotation[2]))


def bend_lifts(board: F64) -> F64:
    """Compute lifts (m, BEND) of points by bends of 1 mm: X^2, X Y, Y^2."""
    x, y = board[:, :2].T / max(float(np.abs(board[:, :2]).max()), 1e-300)
    return np.column_stack([x * x, x * y, y * y])


def steps_of(vector: F64, cameras: int, free: FreeParameters, media: int) -> tuple[F64, F64]:
    """Split a vector into steps of cameras (M, f), or 0, and shared ones (s,)."""
    camera_columns, _ = free.columns(media)
    if not free.cameras:
        return np.zeros((cameras, len(camera_columns))), vector
    split = cameras * len(camera_columns)
    return vector[:split].reshape(cameras, len(camera_columns)), vector[split:]
