"""Readable codes on bodies: dark cells and their world positions."""

from __future__ import annotations

import numpy as np

from sabench import plugins
from sabench.api import Code, CodeGenerator
from sabench.api.make import generator_of
from sabench.scenes import Scene
from sabench.utils.errors import InputError
from sabench.worlds.bubbles_and_bodies import bodies_of, pose_of


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
