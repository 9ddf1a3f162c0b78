"""What the tables and figures of bubbles share: frames rendered in memory."""

from __future__ import annotations

import numpy as np

from sabench.api import Observation
from sabench.dataset.read import observed
from sabench.imaging.sensor import white_level
from sabench.multiphase import PhaseWorld, Worlds, record
from sabench.progress import track
from sabench.rig import build_rig, told_cameras
from sabench.scene import Scene


def photographed(scene: Scene, seed: int) -> tuple[PhaseWorld, Observation]:
    """The first frame of the data set that `generate` would make, in memory: what is there, and what a solver may see of it."""
    rig = build_rig(scene, scene.title)
    world = Worlds(scene, rig, seed).at(0)
    images = [record(world, camera).grey for camera in track(rig.cameras, f"render {scene.title}, seed {seed}")]
    levels = scene.sensor.black_level_dn, white_level(scene.sensor)
    return world, observed(np.stack(images), told_cameras(scene, rig.cameras, seed), rig.grid, levels, scene.preprocessing or ())
